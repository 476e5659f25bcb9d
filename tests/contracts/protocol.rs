//! `reference/PROTOCOL.md`: every stage of the manifest, its settings, inputs and outputs; functions of the generator.

use crate::common::vectors::vectors;
use crate::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use trgs::oracle::manifest::{PROTOCOL, PROTOCOL_FILE, protocol_sections};
use trgs::oracle::{Case, Level, Vectors};

/// The columns of the row of a stage.
fn row(stage: &str) -> Vec<&'static str> {
    let start = format!("| `{stage}` | ");
    let mut rows = PROTOCOL.lines().filter(|line| line.starts_with(&start));
    let found = rows.next().unwrap_or_else(|| panic!("no row for {stage}"));
    assert_eq!(rows.next(), None, "{stage} has two rows");
    found.trim_matches('|').split('|').map(str::trim).collect()
}

/// The words in backquotes, each with the text up to the next one.
fn quoted(column: &str) -> BTreeMap<&str, &str> {
    let parts: Vec<&str> = column.split('`').collect();
    parts[1..].chunks(2).map(|pair| (pair[0], pair.get(1).unwrap_or(&"").trim_matches([',', ' ']))).collect()
}

/// The kind of a file as in the table: `npz`, `json`, or its number of axes.
fn kind(vectors: &Vectors, case: &Case, role: &str) -> String {
    let file = case.inputs.get(role).or_else(|| case.outputs.get(role)).unwrap();
    match file.file.rsplit('.').next().unwrap() {
        "npy" => vectors.arrays(file).unwrap()[""].ndim().to_string(),
        ending => ending.to_owned(),
    }
}

fn assert_roles<'a>(vectors: &Vectors, case: &Case, column: &str, roles: impl Iterator<Item = &'a String>) {
    let listed = quoted(column);
    let roles: BTreeSet<&str> = roles.map(String::as_str).collect();
    assert_eq!(listed.keys().copied().collect::<BTreeSet<_>>(), roles, "{}", case.id);
    for (role, shape) in listed {
        let expected = match shape.strip_prefix('[') {
            Some(axes) => axes.split(',').count().to_string(),
            None => shape.to_owned(),
        };
        assert_eq!(expected, kind(vectors, case, role), "{} {role}: {shape}", case.id);
    }
}

#[test]
fn every_stage_has_a_row_with_its_settings_inputs_outputs_and_number_of_cases() {
    let vectors = vectors();
    let mut counts: BTreeMap<&str, [usize; 3]> = BTreeMap::new();
    for case in &vectors.manifest.cases {
        let level = Level::ALL.iter().position(|level| *level == case.level).unwrap();
        counts.entry(&case.stage).or_default()[level] += 1;
        let columns = row(&case.stage);
        let settings: BTreeSet<&str> = case.settings.keys().map(String::as_str).collect();
        assert_eq!(quoted(columns[3]).keys().copied().collect::<BTreeSet<_>>(), settings, "{}", case.id);
        assert_roles(&vectors, case, columns[4], case.inputs.keys());
        assert_roles(&vectors, case, columns[5], case.outputs.keys());
        let section: String = columns[1].parse::<u32>().map(|number| format!("\n## {number}. ")).unwrap();
        let text = PROTOCOL.split_once(&section).unwrap().1.split("\n## ").next().unwrap();
        let stage = case.stage.as_str();
        let general = ["projected-kernel-", "gradient-image-"].iter().find(|start| stage.starts_with(**start));
        assert!(text.contains(general.unwrap_or(&stage)), "section {} does not name {stage}", columns[1]);
    }
    for (stage, [core, optional, stress]) in &counts {
        assert_eq!(row(stage)[2], format!("{core}/{optional}/{stress}"), "{stage}");
    }
    let rows = PROTOCOL.lines().filter(|line| line.starts_with("| `") && line.matches('|').count() == 7).count();
    assert_eq!(rows, counts.len(), "rows of stages");
}

#[test]
fn every_function_of_the_generator_that_is_named_exists() {
    let folder = root().join("reference/generate");
    let mut found = 0;
    for name in PROTOCOL.split('`').skip(1).step_by(2) {
        let Some((module, function)) = name.split_once('.') else { continue };
        if function == "npz" {
            continue;
        }
        let Ok(source) = fs::read_to_string(folder.join(format!("{module}.py"))) else { continue };
        let defined = ["def ", "class "].iter().any(|word| {
            source.contains(&format!("{word}{function}(")) || source.contains(&format!("{word}{function}:"))
        });
        assert!(defined, "{name} is not in the generator");
        found += 1;
    }
    assert!(found >= 30, "{found} functions of the generator are named");
}

#[test]
fn the_newest_version_is_that_of_the_manifest_and_each_case_has_the_digest_of_its_section() {
    let (vectors, folder) = (vectors(), tempfile::tempdir().unwrap());
    let versions = PROTOCOL.split("\n## 18. ").nth(1).unwrap();
    let newest: Vec<&str> = versions.lines().nth(6).unwrap().split('|').map(str::trim).collect();
    assert_eq!(newest[2].trim_matches('`'), vectors.digest, "a change of the vectors is a version: {newest:?}");
    let stages: BTreeSet<&str> = vectors.manifest.cases.iter().map(|case| &*case.stage).collect();
    assert_eq!(newest[3], format!("{}, {}", vectors.manifest.cases.len(), stages.len()));
    let cases: Vec<_> = vectors.manifest.cases.iter().collect();
    vectors.export(&folder.path().join("vectors"), true, &cases).unwrap();
    let exported = Vectors::open(folder.path().join("vectors")).unwrap();
    let sections = protocol_sections();
    assert!(sections["adam"].starts_with("10. Optimisers") && sections["image-exact"].starts_with("4. Projections"));
    for case in &exported.manifest.cases {
        let expected = trgs::scan::digest::digest_bytes(sections[&*case.stage].as_bytes());
        assert_eq!(case.protocol.as_ref(), Some(&expected), "{}", case.id);
    }
}

#[test]
fn an_export_has_the_page_with_equal_bytes() {
    let (vectors, folder) = (vectors(), tempfile::tempdir().unwrap());
    let page = fs::read(root().join("reference/PROTOCOL.md")).unwrap();
    for (name, blind) in [("blind", true), ("open", false)] {
        let folder = folder.path().join(name);
        vectors.export(&folder, blind, &[&vectors.manifest.cases[0]]).unwrap();
        assert_eq!(fs::read(folder.join(PROTOCOL_FILE)).unwrap(), page);
    }
}
