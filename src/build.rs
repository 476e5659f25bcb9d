//! Tells the program which commit it was built from, for `provenance.json`. Without git it knows none. Lists the conformance
//! vectors that are built in.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, io};

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// All files below a folder.
fn files(folder: &Path, found: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in folder.read_dir()? {
        let path = entry?.path();
        if path.is_dir() { files(&path, found)? } else { found.push(path) }
    }
    Ok(())
}

/// Writes a slice of (path with `/`, content), in the order of the paths.
fn embed_vectors() -> io::Result<()> {
    let variable = |name| PathBuf::from(env::var_os(name).expect("cargo sets it"));
    let root = variable("CARGO_MANIFEST_DIR").join("reference/vectors");
    let mut found = Vec::new();
    files(&root, &mut found)?;
    let name = |path: &PathBuf| {
        let parts = path.strip_prefix(&root).expect("below the root").iter();
        parts.map(|part| part.to_string_lossy()).collect::<Vec<_>>().join("/")
    };
    let mut named: Vec<_> = found.iter().map(|path| (name(path), path)).collect();
    named.sort();
    let entries: String = named.iter().map(|(name, path)| format!("({name:?}, include_bytes!({path:?})),\n")).collect();
    fs::write(variable("OUT_DIR").join("vectors.rs"), format!("&[\n{entries}]\n"))
}

fn main() {
    if env::var_os("CARGO_FEATURE_VECTORS").is_some() {
        embed_vectors().expect("the vectors can be read");
    }
    // Files that are added are built in, too.
    println!("cargo:rerun-if-changed=reference/vectors");
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
