//! The register `reference/equations.md` is complete: equations, functions, tests and vectors.

use crate::common::vectors::vectors;
use crate::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Entry for an equation without code; it replaces the functions and stands alone.
const NOT_YET: &str = "not yet";
/// Folders and files whose public functions must be in the register.
const NUMERICAL: [&str; 10] = [
    "src/core/primitives",
    "src/core/projector",
    "src/core/confidence",
    "src/core/density",
    "src/core/loss",
    "src/core/wavelet",
    "src/core/optim",
    "src/methods/classical",
    "src/methods/neural",
    "src/methods/evaluation.rs",
];

fn text(path: impl AsRef<Path>) -> String {
    fs::read_to_string(root().join(&path)).unwrap_or_else(|error| panic!("{}: {error}", path.as_ref().display()))
}

fn rust_files(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.to_owned()];
    }
    let mut all: Vec<PathBuf> = fs::read_dir(path).unwrap().flat_map(|e| rust_files(&e.unwrap().path())).collect();
    all.retain(|path| path.extension().is_some_and(|extension| extension == "rs"));
    all.sort();
    all
}

/// A row of the register.
struct Row {
    tag: String,
    functions: Vec<String>,
    tests: Vec<String>,
    stages: Vec<String>,
}

/// The quoted words of a cell.
fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(Into::into).collect()
}

fn register() -> Vec<Row> {
    let text = text("reference/equations.md");
    let rows = text.lines().filter(|line| line.starts_with("| `"));
    let rows = rows.map(|line| {
        let cells: Vec<&str> = line.trim().trim_matches('|').split(" | ").map(str::trim).collect();
        assert_eq!(cells.len(), 5, "five cells: {line}");
        assert!(cells[1].len() > 10, "a statement: {line}");
        let row = Row {
            tag: quoted(cells[0]).remove(0),
            functions: quoted(cells[2]),
            tests: quoted(cells[3]),
            stages: quoted(cells[4]),
        };
        assert_eq!(row.functions.is_empty(), cells[2] == NOT_YET, "{}: functions or `{NOT_YET}`", row.tag);
        row
    });
    rows.collect()
}

/// Whether a tag is an equation of the paper or one of the three exact additions to it.
fn is_equation(tag: &str) -> bool {
    tag == "A" || ["Eq. ", "X"].iter().any(|p| tag.strip_prefix(p).is_some_and(|n| n.parse::<u32>().is_ok()))
}

/// Whether a text contains a tag.
fn mentions(text: &str, tag: &str) -> bool {
    text.contains(&format!("[{tag}]")) || text.contains(&format!("[{tag} "))
}

/// The source file of a path such as `projector::naive::forward`, and the function's name.
fn resolve(function: &str) -> (PathBuf, String) {
    let parts: Vec<&str> = function.split("::").collect();
    let name = *parts.last().unwrap();
    for depth in (1..parts.len()).rev() {
        for folder in ["src", "src/core", "src/methods"] {
            let stem = root().join(folder).join(parts[..depth].join("/"));
            for path in [stem.with_extension("rs"), stem.join("mod.rs")] {
                if path.is_file() && fs::read_to_string(&path).unwrap().contains(&format!("fn {name}")) {
                    return (path, name.into());
                }
            }
        }
    }
    panic!("{function}: no such function");
}

/// The doc comment above `fn name`, and the page of its module.
fn documentation(path: &Path, name: &str) -> String {
    let text = fs::read_to_string(path).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let is_it =
        |line: &str| line.split_once(&format!("fn {name}")).is_some_and(|(_, after)| after.starts_with(['(', '<']));
    let at = lines.iter().position(|line| is_it(line)).unwrap_or_else(|| panic!("{}: fn {name}", path.display()));
    let above = lines[..at].iter().rev().map(|line| line.trim());
    let above = above.take_while(|line| line.starts_with("///") || line.starts_with("#[") || line.starts_with("//"));
    above.collect::<Vec<_>>().join("\n")
}

fn page(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    text.lines().take_while(|line| line.starts_with("//!")).collect::<Vec<_>>().join("\n")
}

#[test]
fn every_equation_of_the_paper_and_of_ours_has_a_row() {
    let tags: Vec<String> = register().into_iter().map(|row| row.tag).collect();
    let expected = (1..=15).map(|n| format!("Eq. {n}")).chain(["A", "X1", "X2", "X3"].map(Into::into));
    for tag in expected {
        assert_eq!(tags.iter().filter(|t| **t == tag).count(), 1, "rows of {tag}");
    }
    let unique: BTreeSet<&String> = tags.iter().collect();
    assert_eq!(unique.len(), tags.len(), "a tag has two rows");
}

#[test]
fn every_row_has_functions_that_name_it_and_tests_that_exist() {
    for row in register() {
        if row.functions.is_empty() {
            assert!(row.tests.is_empty() && row.stages.is_empty(), "{}: tests or vectors of nothing", row.tag);
            continue;
        }
        for function in &row.functions {
            let (path, name) = resolve(function);
            let said = documentation(&path, &name) + &page(&path);
            let ours = said.contains("Not in the paper") && !is_equation(&row.tag);
            assert!(mentions(&said, &row.tag) || ours, "{function} does not say [{}]", row.tag);
        }
        assert!(!row.tests.is_empty(), "{}: no test", row.tag);
        for test in &row.tests {
            let (file, name) = test.split_once("::").unwrap_or_else(|| panic!("{test}: file::test"));
            assert!(text(file).contains(&format!("fn {name}(")), "{test}: no such test");
        }
    }
}

#[test]
fn every_tag_in_the_source_has_a_row_with_code() {
    let rows: BTreeMap<String, bool> = register().into_iter().map(|row| (row.tag, !row.functions.is_empty())).collect();
    let mut found = 0;
    for path in rust_files(&root().join("src")) {
        let text = fs::read_to_string(&path).unwrap();
        for candidate in text.split('[').skip(1).filter_map(|rest| rest.split(']').next()) {
            // A citation such as FDK84: capitals and two digits.
            let digits = candidate.trim_start_matches(|c: char| c.is_ascii_uppercase());
            let is_reference = candidate.len() >= 4 && digits.len() == 2 && digits.parse::<u32>().is_ok();
            if is_equation(candidate) || is_reference {
                found += 1;
                assert_eq!(rows.get(candidate), Some(&true), "{}: [{candidate}] has no row with code", path.display());
            }
        }
    }
    assert!(found > 30, "only {found} tags found");
}

#[test]
fn every_public_numerical_function_is_in_the_register_or_says_why_not() {
    let listed: BTreeSet<(PathBuf, String)> =
        register().iter().flat_map(|row| row.functions.iter().map(|f| resolve(f))).collect();
    let mut functions = 0;
    for path in NUMERICAL.iter().flat_map(|folder| rust_files(&root().join(folder))) {
        let text = fs::read_to_string(&path).unwrap();
        for line in text.lines().take_while(|line| !line.starts_with("#[cfg(test)]")) {
            let Some(rest) = line.strip_prefix("pub fn ") else { continue };
            let name: String = rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            // It states memory and computes no number of a result.
            if name == "arrays" {
                continue;
            }
            functions += 1;
            let said = documentation(&path, &name) + &page(&path);
            let tagged = said.contains("[Eq. ") || said.contains("[X") || said.contains("Not in the paper");
            assert!(tagged || said.contains("[FDK84]"), "{}: {name} has no tag", path.display());
            assert!(listed.contains(&(path.clone(), name.clone())), "{}: {name} is in no row", path.display());
        }
    }
    assert!(functions >= 20, "only {functions} functions");
}

#[test]
fn every_stage_of_the_vectors_is_in_a_row_and_the_equations_of_its_cases_list_it() {
    let rows = register();
    let vectors = vectors();
    let stages: BTreeSet<&str> = vectors.manifest.cases.iter().map(|case| case.stage.as_str()).collect();
    let listed: BTreeSet<&str> = rows.iter().flat_map(|row| row.stages.iter().map(String::as_str)).collect();
    assert_eq!(listed, stages, "stages in the register, stages of the vectors");
    for case in &vectors.manifest.cases {
        for tag in &case.equations {
            let row = rows.iter().find(|row| row.tag == *tag).unwrap_or_else(|| panic!("{}: no row {tag}", case.id));
            assert!(
                row.stages.contains(&case.stage),
                "{}: the row of {tag} does not list the stage {}",
                case.id,
                case.stage
            );
        }
    }
}

/// Each fault of `reference/mutations` applies in exactly one place, and the README beside it lists its result.
#[test]
fn every_mutation_still_applies_and_has_its_result() {
    let table: toml::Table = text("reference/mutations/mutations.toml").parse().unwrap();
    let (mutations, readme) = (table["mutation"].as_array().unwrap(), text("reference/mutations/README.md"));
    assert!(mutations.len() >= 30, "{} mutations", mutations.len());
    for mutation in mutations {
        let of = |key: &str| mutation[key].as_str().unwrap();
        assert_eq!(text(of("file")).matches(of("find")).count(), 1, "{}: {:?}", of("file"), of("find"));
        assert_ne!(of("find"), of("replace"));
        let row = format!("| {} | `{}` |", of("what"), of("file"));
        assert!(readme.lines().any(|line| line.contains(&row) && !line.contains("survived")), "no result: {row}");
    }
}
