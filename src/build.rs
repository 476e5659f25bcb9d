//! Tells the program which commit it was built from, for `provenance.json`. Without git it knows none.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;
use std::process::Command;

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn main() {
    // The log of HEAD grows with every commit and checkout.
    // A file that does not exist would build everything anew each time, and that of a worktree lies elsewhere.
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|log| Path::new(log).exists()) {
        println!("cargo:rerun-if-changed={log}");
    }
    println!("cargo:rerun-if-changed=src");
    if let Some(commit) = git(&["rev-parse", "HEAD"]) {
        // What is changed since tells two programs of one commit apart, and so the cells of their tables.
        let sources = ["src", "reference/paper", "Cargo.toml", "Cargo.lock"];
        let of = |command: &[&str]| git(&[command, &["--"], &sources].concat()).unwrap_or_default();
        let changes = [of(&["status", "--porcelain"]), of(&["diff", "HEAD"])];
        let mut hasher = DefaultHasher::new();
        changes.hash(&mut hasher);
        let changed = changes.iter().any(|text| !text.is_empty());
        let suffix = if changed { format!(" with changes {:016x}", hasher.finish()) } else { String::new() };
        println!("cargo:rustc-env=TRGS_COMMIT={commit}{suffix}");
    }
}
