//! Rules that no compiler checks: operations in numerical code, use of threads, file lengths.

use crate::root;
use std::fs;
use std::path::{Path, PathBuf};

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// Lines of code, without comments and without the tests at the end of a file.
fn code(path: &Path) -> Vec<(usize, String)> {
    let text = fs::read_to_string(path).unwrap();
    let lines = text.lines().take_while(|line| !line.starts_with("#[cfg(test)]")).enumerate();
    lines.map(|(i, line)| (i + 1, line.split("//").next().unwrap().to_owned())).collect()
}

fn assert_absent(words: &[&str], folders: &[&str], exempt: &[&str], why: &str) {
    let mut searched = 0;
    for folder in folders {
        for path in rust_files(&root().join("src").join(folder)) {
            let name = path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned();
            if exempt.contains(&name.as_str()) {
                continue;
            }
            searched += 1;
            for (line, text) in code(&path) {
                for word in words {
                    assert!(!text.contains(word), "{name}:{line}: {word} ({why})");
                }
            }
        }
    }
    assert!(searched >= 5, "only {searched} files searched");
}

const NUMERICAL: [&str; 3] = ["core", "methods", "scan"];

#[test]
fn numerical_code_uses_nothing_whose_bits_depend_on_the_build() {
    let words = ["mul_neg_add", ".recip(", ".recip_sqrt(", ".reduce_add(", "powf(", ".powi("];
    assert_absent(&words, &NUMERICAL, &[], "not the same bits on every build");
    let fused = "of registers fused where the build has an instruction for it; Lanes::fma is fused everywhere";
    // That of the scalars, in the second file, is fused always.
    assert_absent(&[".mul_add("], &NUMERICAL, &["src/core/numeric/lanes.rs", "src/core/numeric/fused.rs"], fused);
}

#[test]
fn numerical_code_knows_no_time_no_hash_order_and_no_thread() {
    assert_absent(
        &["HashMap", "HashSet", "std::time", "thread::current", "current_thread_index"],
        &NUMERICAL,
        // The times at which files were changed.
        &["src/scan/input.rs", "src/scan/output/mark.rs"],
        "not reproducible",
    );
}

#[test]
fn only_one_module_uses_threads() {
    assert_absent(
        &["rayon", "std::thread", "par_iter"],
        &[""],
        &["src/core/numeric/threads.rs", "src/cli/interrupt.rs"],
        "threads have one user",
    );
}

#[test]
fn commands_do_no_arithmetic_on_pixels() {
    assert_absent(
        &["ndarray::Zip", ".sqrt()", "exp("],
        &["cli"],
        &[],
        "arithmetic belongs to the library's numerical modules",
    );
}

#[test]
fn no_file_is_longer_than_600_lines() {
    for folder in ["src", "tests", "benches"] {
        for path in rust_files(&root().join(folder)) {
            let lines = fs::read_to_string(&path).unwrap().lines().count();
            assert!(lines <= 600, "{}: {lines} lines", path.display());
        }
    }
}

#[test]
fn unsafe_code_is_forbidden() {
    for root_file in
        ["src/lib.rs", "src/main.rs", "src/core/lib.rs", "src/methods/lib.rs", "src/oracle/lib.rs", "src/scan/lib.rs"]
    {
        let text = fs::read_to_string(root().join(root_file)).unwrap();
        assert!(text.contains("#![forbid(unsafe_code)]"), "{root_file}");
    }
}
