//! Finds the files of `reference` that are built in, and lists the conformance vectors.
//!
//! The folder `reference` beside this file has links to them, which `cargo package` replaces with the files. Where links
//! are not supported, the files are read from the repository.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

/// All files below a folder.
fn files(folder: &Path, found: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in folder.read_dir()? {
        let path = entry?.path();
        if path.is_dir() { files(&path, found)? } else { found.push(path) }
    }
    Ok(())
}

/// A variable that cargo sets.
fn variable(name: &str) -> PathBuf {
    PathBuf::from(env::var_os(name).expect("cargo sets it"))
}

/// Writes a slice of (path with `/`, content), in the order of the paths.
fn embed_vectors(root: &Path) -> io::Result<()> {
    let mut found = Vec::new();
    files(root, &mut found)?;
    let name = |path: &PathBuf| {
        let parts = path.strip_prefix(root).expect("below the root").iter();
        parts.map(|part| part.to_string_lossy()).collect::<Vec<_>>().join("/")
    };
    let mut named: Vec<_> = found.iter().map(|path| (name(path), path)).collect();
    named.sort();
    let entries: String = named.iter().map(|(name, path)| format!("({name:?}, include_bytes!({path:?})),\n")).collect();
    fs::write(variable("OUT_DIR").join("vectors.rs"), format!("&[\n{entries}]\n"))
}

fn main() {
    let places = ["reference", "../../reference"].map(|place| variable("CARGO_MANIFEST_DIR").join(place));
    let reference = places.iter().find(|place| place.join("vectors").is_dir()).expect("a folder with the vectors");
    println!("cargo:rustc-env=TRGS_REFERENCE={}", reference.display());
    if env::var_os("CARGO_FEATURE_VECTORS").is_some() {
        embed_vectors(&reference.join("vectors")).expect("the vectors can be read");
    }
    // Files that are added are built in, too.
    println!("cargo:rerun-if-changed={}", reference.join("vectors").display());
    println!("cargo:rerun-if-changed=build.rs");
}
