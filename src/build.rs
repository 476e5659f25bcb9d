//! Tells the program which commit it was built from, for `provenance.json`. Without git it knows none. A program for every
//! x86-64 gets one for AVX2 and FMA, which it carries (`src/second.rs`).

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn variable(name: &str) -> String {
    std::env::var(name).unwrap_or_default()
}

/// Whether the program `trgs` is built to be used, on this machine, for CPUs without the instructions that it is fast with.
fn needs_second_program() -> bool {
    let features = variable("CARGO_CFG_TARGET_FEATURE");
    let lacks = |name: &str| features.split(',').all(|feature| feature != name);
    // The folder has the name of the profile. Programs of others are for tests.
    let is_used = Path::new(&variable("OUT_DIR")).iter().any(|part| part == "release" || part == "portable");
    // Other packages use the library alone.
    option_env!("CARGO_PRIMARY_PACKAGE").is_some()
        && std::env::var_os("CARGO_FEATURE_CLI").is_some()
        && is_used
        && variable("TARGET") == variable("HOST")
        && (variable("CARGO_CFG_TARGET_ARCH"), variable("CARGO_CFG_TARGET_OS")) == ("x86_64".into(), "linux".into())
        && (lacks("avx2") || lacks("fma"))
}

/// Builds the program with the same features for AVX2 and FMA, and returns its path.
fn second_program() -> Result<PathBuf, String> {
    let (target, folder) = (variable("TARGET"), PathBuf::from(variable("OUT_DIR")).join("v3"));
    let of = |name: &String| name.strip_prefix("CARGO_FEATURE_").map(str::to_lowercase);
    let features: Vec<String> = std::env::vars().filter_map(|(name, _)| of(&name)).collect();
    let flags = format!("{}\x1f-Ctarget-cpu=x86-64-v3", variable("CARGO_ENCODED_RUSTFLAGS"));
    let status = Command::new(variable("CARGO"))
        .args(["build", "--release", "--locked", "--bin", "trgs", "--no-default-features", "--features"])
        .arg(features.join(","))
        .args(["--target", &target, "--target-dir"])
        .arg(&folder)
        .env("CARGO_ENCODED_RUSTFLAGS", flags.trim_start_matches('\x1f'))
        .status();
    match status {
        Ok(status) if status.success() => Ok(folder.join(target).join("release/trgs")),
        Ok(status) => Err(status.to_string()),
        Err(error) => Err(error.to_string()),
    }
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
    println!("cargo:rustc-check-cfg=cfg(carries_second)");
    if needs_second_program() {
        match second_program() {
            Ok(program) => {
                println!("cargo:rustc-env=TRGS_SECOND={}", program.display());
                println!("cargo:rustc-cfg=carries_second");
            }
            Err(error) => println!("cargo:warning=the program is slow: that for AVX2 and FMA was not built ({error})"),
        }
    }
}
