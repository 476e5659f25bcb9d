//! Tells the program which commit it was built from, for `provenance.json`. Without git it knows none.

use std::process::Command;

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn main() {
    // Files that are added are built in, too.
    println!("cargo:rerun-if-changed=reference/vectors");
    // The log of HEAD grows with every commit and checkout.
    println!("cargo:rerun-if-changed=.git/logs/HEAD");
    println!("cargo:rerun-if-changed=src");
    if let Some(commit) = git(&["rev-parse", "HEAD"]) {
        let changed = git(&["status", "--porcelain", "--", "src", "Cargo.toml", "Cargo.lock"])
            .is_some_and(|files| !files.is_empty());
        println!("cargo:rustc-env=TRGS_COMMIT={commit}{}", if changed { " with changes" } else { "" });
    }
}
