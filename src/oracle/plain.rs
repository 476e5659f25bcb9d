//! Vectors for languages without readers of JSON and ZIP: each array is a `.npy` of its own, all else is in one table.
//!
//! `manifest.tsv` has one fact a line, its parts separated by tabs: case, kind, name, values. PROTOCOL.md lists the kinds.

use super::manifest::{Arrays, Case, FileRef, PROTOCOL, PROTOCOL_FILE, Vectors, decode, encode, write_file};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::{ErrorKind, Write as _};
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_scan::output::{Destination, Kind, stage_folder, write_atomically};

/// The table's file name.
pub const TABLE: &str = "manifest.tsv";

/// As [`Vectors::export`], with the table in place of the manifest and each array in a `.npy` of its own.
///
/// # Errors
/// Those of [`Vectors::export`].
///
/// Tests: `tests/contracts/protocol.rs`.
pub fn export(vectors: &Vectors, folder: impl Into<Destination>, blind: bool, cases: &[&Case]) -> Result<usize> {
    let staged = stage_folder(folder.into().of(Kind::Vectors))?;
    let folder = &staged.path();
    let mut table = format!("*\tvectors\t\t{}\n", vectors.origin());
    let mut written = BTreeSet::new();
    for case in cases {
        let mut line = |kind: &str, name: &str, value: &str| {
            writeln!(table, "{}\t{kind}\t{name}\t{value}", case.id).expect("a text can be written to");
        };
        line("level", "", &flat(&serde_json::json!(case.level)));
        case.settings.iter().for_each(|(name, value)| line("setting", name, &flat(value)));
        for (role, file) in &case.inputs {
            if file.file.ends_with(".json") {
                let content: Value = serde_json::from_slice(&vectors.bytes(file)?).map_err(|e| {
                    Error::format(&vectors.path(file), "input", e.to_string(), "JSON", "export it again")
                })?;
                let scanner = content["scanner"].as_object().into_iter().flatten();
                scanner.for_each(|(key, value)| line("scanner", key, &flat(value)));
                continue;
            }
            for (name, part, array) in parts(role, file, vectors.arrays(file)?) {
                line("input", &name, &part);
                if written.insert(part.clone()) {
                    write_file(&folder.join(part), &encode(&array))?;
                }
            }
        }
        let known = |kind: &'static str, files: &BTreeMap<String, FileRef>| -> Result<Vec<_>> {
            let arrays = files.iter().map(|(role, file)| Ok(parts(role, file, vectors.arrays(file)?)));
            Ok(arrays.collect::<Result<Vec<_>>>()?.into_iter().flatten().map(|part| (kind, part)).collect())
        };
        for (kind, (name, part, array)) in
            [known("output", &case.outputs)?, known("allowance", &case.allowances)?].concat()
        {
            if !blind || kind == "output" {
                line(kind, &name, &part);
            }
            if !blind && written.insert(part.clone()) {
                write_file(&folder.join("expected").join(part), &encode(&array))?;
            }
        }
    }
    for (name, text) in [(TABLE, &*table), (PROTOCOL_FILE, PROTOCOL)] {
        write_atomically(&folder.join(name), |out| out.write_all(text.as_bytes()))?;
    }
    staged.commit()?;
    Ok(written.len())
}

/// Name, file and arrays of what one role has.
fn parts(role: &str, file: &FileRef, arrays: Arrays) -> Vec<(String, String, Arrays)> {
    let part = |(name, array): (String, _)| match file.file.strip_suffix(".npz") {
        Some(stem) => (format!("{role}.{name}"), format!("{stem}/{name}.npy"), [(String::new(), array)].into()),
        None => (role.to_owned(), file.file.clone(), [(name, array)].into()),
    };
    arrays.into_iter().map(part).collect()
}

/// Numbers or a word, separated by spaces.
fn flat(value: &Value) -> String {
    match value {
        Value::String(word) => word.clone(),
        Value::Array(values) => values.iter().map(flat).collect::<Vec<_>>().join(" "),
        other => other.to_string(),
    }
}

/// The arrays of an answer: of its file, or of the `.npy` files in the folder that has the name of an absent archive.
///
/// `None` where there is neither.
pub(super) fn answered(path: &Path) -> Result<Option<Arrays>> {
    match trgs_scan::input::read(path) {
        Ok(bytes) => decode(&bytes, path).map(Some),
        Err(error) if error.kind() == ErrorKind::NotFound => separate(path),
        Err(source) => Err(Error::read(path, source)),
    }
}

fn separate(path: &Path) -> Result<Option<Arrays>> {
    let folder = path.with_extension("");
    if path.extension().is_none_or(|ending| ending != "npz") || !folder.is_dir() {
        return Ok(None);
    }
    let unread = |source| Error::read(&folder, source);
    let mut arrays = Arrays::new();
    for entry in std::fs::read_dir(&folder).map_err(unread)? {
        let file = entry.map_err(unread)?.path();
        let name = file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        if let (Some(name), true) = (name, file.extension().is_some_and(|ending| ending == "npy")) {
            let bytes = trgs_scan::input::read(&file).map_err(|source| Error::read(&file, source))?;
            arrays.extend(decode(&bytes, &file)?.into_values().map(|array| (name.clone(), array)));
        }
    }
    Ok(Some(arrays))
}
