//! Odd volumes: what is read, remarked on or refused.
//!
//! `reference/FORMATS.md` is the table of this test's inputs; the test fails when it is outdated.

pub(crate) mod build;
mod cases;

use glam::DVec3;
use ndarray::Array3;
use std::fmt::Write;
use std::path::Path;
use trgs::scan::volume_file::{self, VolumeFile};

/// What must happen.
#[derive(Clone)]
enum Outcome {
    /// Read without a remark.
    Plain,
    /// Read with a remark that contains this.
    Odd(&'static str),
    /// Refused with a message that contains this.
    Refused(&'static str),
}

/// An input and what must be read from it.
#[derive(Clone)]
struct Case {
    input: &'static str,
    path: &'static str,
    /// Names below the folder, and contents.
    files: Vec<(String, Vec<u8>)>,
    values: Array3<f32>,
    spacing: Option<DVec3>,
    origin: Option<DVec3>,
    outcome: Outcome,
}

impl Case {
    /// A case whose volume has the usual values, spacing and origin.
    fn new(input: &'static str, path: &'static str, files: Vec<(String, Vec<u8>)>) -> Self {
        let (spacing, origin) = (Some(DVec3::new(0.5, 0.75, 1.25)), Some(DVec3::new(-3.0, 7.0, 0.5)));
        Self { input, path, files, values: build::volume(), spacing, origin, outcome: Outcome::Plain }
    }

    fn changed(mut self, change: impl FnOnce(&mut Vec<u8>)) -> Self {
        change(&mut self.files[0].1);
        self
    }

    fn with(mut self, name: &str, content: Vec<u8>) -> Self {
        self.files.push((name.into(), content));
        self
    }

    fn odd(self, part: &'static str) -> Self {
        Self { outcome: Outcome::Odd(part), ..self }
    }

    fn refused(self, part: &'static str) -> Self {
        Self { outcome: Outcome::Refused(part), ..self }
    }

    fn values(self, values: Array3<f32>) -> Self {
        Self { values, ..self }
    }

    fn spacing(self, spacing: [f64; 3]) -> Self {
        Self { spacing: Some(spacing.into()), ..self }
    }

    fn no_spacing(self) -> Self {
        Self { spacing: None, ..self }
    }

    fn no_origin(self) -> Self {
        Self { origin: None, ..self }
    }

    /// Multiplies spacing and origin.
    fn scaled(self, factor: f64) -> Self {
        let [spacing, origin] = [self.spacing, self.origin].map(|vector| vector.map(|vector| vector * factor));
        Self { spacing, origin, ..self }
    }

    /// The row of the table; panics if the outcome is another one.
    fn row(&self) -> String {
        let folder = tempfile::tempdir().unwrap();
        // Data beside a header's folder must not be reached.
        let inner = folder.path().join("folder");
        for (name, content) in &self.files {
            let path = inner.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, content).unwrap();
        }
        let result = volume_file::read(inner.join(self.path)).map_err(|error| shown(&error.to_string(), &inner));
        let what = self.input;
        let (outcome, remark) = match (&self.outcome, result) {
            (Outcome::Plain | Outcome::Odd(_), Ok(found)) => {
                self.assert_right(&found);
                let remark = found.oddities.join("; ");
                match self.outcome {
                    Outcome::Odd(part) => assert!(remark.contains(part), "{what}: {remark}"),
                    _ => assert!(remark.is_empty(), "{what}: {remark}"),
                }
                (if remark.is_empty() { "read" } else { "oddity" }, remark)
            }
            (Outcome::Refused(part), Err(message)) => {
                assert!(message.contains(part), "{what}: {message}");
                let blames_damage = message.contains("copy or export the file again");
                assert!(!(message.contains("not supported") && blames_damage), "{what}: {message}");
                ("error", message)
            }
            (_, Ok(found)) => panic!("{what}: read, {:?}", found.oddities),
            (_, Err(message)) => panic!("{what}: {message}"),
        };
        let place = |vector: Option<DVec3>| match vector {
            Some(v) => format!("{}, {}, {}", short(v.x), short(v.y), short(v.z)),
            None => "none".into(),
        };
        let (spacing, origin) = match self.outcome {
            Outcome::Refused(_) => (String::new(), String::new()),
            _ => (place(self.spacing), place(self.origin)),
        };
        let cell = |text: &str| text.replace('|', "\\|");
        format!("| {} | {outcome} | {spacing} | {origin} | {} |", cell(self.input), cell(&remark))
    }

    fn assert_right(&self, found: &VolumeFile) {
        let what = self.input;
        assert_eq!(found.values, self.values, "{what}");
        for (found, expected) in [(found.spacing, self.spacing), (found.origin, self.origin)] {
            assert_eq!(found.is_some(), expected.is_some(), "{what}");
            if let (Some(found), Some(expected)) = (found, expected) {
                let error = (found - expected).length() / expected.length().max(f64::MIN_POSITIVE);
                within!(error, "{what}: {found:?} instead of {expected:?}");
            }
        }
    }
}

/// A number with few digits.
fn short(x: f64) -> String {
    format!("{}", (x * 1e8).round() / 1e8)
}

/// A message without the temporary folder.
fn shown(message: &str, folder: &Path) -> String {
    message.replace(&format!("{}/", folder.display()), "")
}

#[test]
fn the_table_of_odd_volumes_is_right() {
    let rows: Vec<String> = cases::all().iter().map(Case::row).collect();
    assert!(rows.len() > 60, "{} rows", rows.len());
    let mut table = String::from("| input | result | spacing | origin | remark or error |\n|---|---|---|---|---|\n");
    rows.iter().for_each(|row| writeln!(table, "{row}").unwrap());
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("reference/FORMATS.md");
    let page = std::fs::read_to_string(path).unwrap();
    assert!(page.contains(&table), "reference/FORMATS.md is outdated; its table should be:\n{table}");
}
