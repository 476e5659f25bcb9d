//! A question that is not among the vectors: inputs that can be cut and simplified.

use super::Ask;
use super::dimensions::{Dimension, Of, dimensions};
use super::flags::{REFUSALS, RELATIONS, VALUES};
use crate::manifest::{Arrays, Case, FileRef, Level, Manifest, SCHEMA_VERSION, Vectors, decode, encode};
use crate::question::Question;
use crate::{iteration, recycling, run};
use ndarray::Axis;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Beam, Scanner};
use trgs_scan::dataset::Description;
use trgs_scan::digest::digest_bytes;

/// The key of the manifest's `generator` that marks generated questions, whose truth is computed when it is needed.
pub(crate) const COMPUTED: &str = "truth";

/// The object `scanner` of `meta_data.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct ScannerFile {
    pub(crate) mode: String,
    #[serde(rename = "DSO")]
    pub(crate) dso: f64,
    #[serde(rename = "DSD")]
    pub(crate) dsd: f64,
    pub(crate) n_detector: [usize; 2],
    pub(crate) s_detector: [f64; 2],
    pub(crate) n_voxel: [usize; 3],
    pub(crate) s_voxel: [f64; 3],
    pub(crate) off_origin: [f64; 3],
    pub(crate) off_detector: [f64; 2],
}

impl From<&Scanner> for ScannerFile {
    fn from(Scanner { beam, detector, grid }: &Scanner) -> Self {
        let (mode, dso, dsd) = match *beam {
            Beam::Cone { dso, dsd } => ("cone", dso, dsd),
            Beam::Parallel { dso } => ("parallel", dso, 2.0 * dso),
        };
        Self {
            mode: mode.into(),
            dso,
            dsd,
            n_detector: [detector.rows, detector.columns],
            s_detector: [detector.rows as f64 * detector.pitch_v, detector.columns as f64 * detector.pitch_u],
            n_voxel: grid.shape,
            s_voxel: grid.size().to_array(),
            off_origin: (grid.min + grid.size() / 2.0).to_array(),
            off_detector: [detector.offset_u, -detector.offset_v],
        }
    }
}

/// The inputs of a question.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Draft {
    pub(crate) id: String,
    pub(crate) stage: String,
    pub(crate) title: String,
    pub(crate) level: Level,
    pub(crate) flags: Vec<String>,
    pub(crate) settings: Map<String, Value>,
    pub(crate) scanner: Option<ScannerFile>,
    pub(crate) arrays: BTreeMap<String, Arrays>,
}

impl Draft {
    /// Reads a question of a manifest.
    pub(crate) fn read(vectors: &Vectors, case: &Case) -> Result<Self> {
        let (mut scanner, mut arrays) = (None, BTreeMap::new());
        for (role, file) in &case.inputs {
            let bytes = vectors.bytes(file)?;
            if role == "scanner" {
                let value: Value = serde_json::from_slice(&bytes).unwrap_or_default();
                scanner = serde_json::from_value(value["scanner"].clone()).ok();
            } else {
                arrays.insert(role.clone(), decode(&bytes, Path::new(&file.file))?);
            }
        }
        let Case { id, stage, title, level, flags, settings, .. } = case.clone();
        Ok(Self { id, stage, title, level, flags, settings, scanner, arrays })
    }

    fn scanner_text(&self) -> Option<Vec<u8>> {
        let text = self.scanner.as_ref().map(|scanner| json!({ "scanner": scanner }));
        text.map(|text| serde_json::to_vec_pretty(&text).expect("numbers and words are JSON"))
    }

    /// The question in this program's types.
    ///
    /// # Errors
    /// For inputs that no backend needs to accept.
    pub(crate) fn question(&self) -> Result<Question> {
        let scanner = match self.scanner_text() {
            Some(text) => Some(Description::parse(&text, Path::new("meta_data.json"))?.scanner),
            None => None,
        };
        let question =
            Question::of(self.id.clone(), self.stage.clone(), self.settings.clone(), scanner, self.arrays.clone());
        if self.arrays.contains_key("model") {
            question.primitives()?;
        }
        Ok(question)
    }

    /// The number of elements along a dimension.
    pub(crate) fn length(&self, of: &Dimension) -> usize {
        match (of.of, &self.scanner) {
            (Of::Views, _) => self.settings["angles"].as_array().map_or(0, Vec::len),
            (Of::Rows, Some(scanner)) => scanner.n_detector[0],
            (Of::Columns, Some(scanner)) => scanner.n_detector[1],
            (Of::Voxels(axis), Some(scanner)) => scanner.n_voxel[axis],
            _ => {
                let (role, axis) = of.inputs[0];
                let array = self.arrays.get(role).and_then(|arrays| arrays.values().next());
                array.map_or(0, |array| array.len_of(Axis(axis)))
            }
        }
    }

    /// The question with only these elements of a dimension, in this order.
    ///
    /// Pixels stay where they are, so indices of rows and columns must follow each other. Voxels grow.
    pub(crate) fn select(&self, of: &Dimension, indices: &[usize]) -> Self {
        let mut draft = self.clone();
        let (length, kept) = (self.length(of) as f64, indices.len());
        let first = indices.first().copied().unwrap_or(0) as f64;
        let shift = first + kept as f64 / 2.0 - length / 2.0;
        match (of.of, &mut draft.scanner) {
            (Of::Views, _) => {
                let angles = self.settings["angles"].as_array().expect("a list of angles");
                draft.settings["angles"] = indices.iter().map(|&i| angles[i].clone()).collect();
            }
            (Of::Rows, Some(scanner)) => {
                let pitch = scanner.s_detector[0] / length;
                scanner.n_detector[0] = kept;
                scanner.s_detector[0] = pitch * kept as f64;
                scanner.off_detector[1] -= shift * pitch;
            }
            (Of::Columns, Some(scanner)) => {
                let pitch = scanner.s_detector[1] / length;
                scanner.n_detector[1] = kept;
                scanner.s_detector[1] = pitch * kept as f64;
                scanner.off_detector[0] += shift * pitch;
            }
            (Of::Voxels(axis), Some(scanner)) => scanner.n_voxel[axis] = kept,
            _ => {}
        }
        for (role, axis) in &of.inputs {
            for array in draft.arrays.get_mut(*role).into_iter().flat_map(BTreeMap::values_mut) {
                *array = array.select(Axis(*axis), indices);
            }
        }
        draft
    }

    /// The number of elements along a dimension by what it counts: `Of::Primitives`, or the pixels of all views.
    pub(crate) fn size(&self) -> [usize; 2] {
        let all = dimensions(&self.stage);
        let of = |wanted: fn(&Of) -> bool| {
            let lengths = all.iter().filter(|dimension| wanted(&dimension.of)).map(|dimension| self.length(dimension));
            lengths.product::<usize>()
        };
        let primitives = all.iter().find(|dimension| dimension.of == Of::Primitives);
        [primitives.map_or(0, |dimension| self.length(dimension)), of(|of| *of != Of::Primitives)]
    }
}

/// Questions in memory, without truth.
pub(crate) fn vectors(drafts: &[Draft], generator: &[(&str, Value)]) -> Vectors {
    let (mut files, mut cases) = (BTreeMap::new(), Vec::new());
    for draft in drafts {
        let folder = draft.id.replace('/', "-");
        let mut inputs = BTreeMap::new();
        let mut add = |role: &str, name: String, bytes: Vec<u8>| {
            let file = format!("inputs/{folder}/{name}");
            inputs.insert(role.to_owned(), FileRef { file: file.clone(), sha256: Some(digest_bytes(&bytes)) });
            files.insert(file, bytes);
        };
        for (role, arrays) in &draft.arrays {
            add(role, file_name(role, arrays), encode(arrays));
        }
        if let Some(text) = draft.scanner_text() {
            add("scanner", "meta_data.json".into(), text);
        }
        let output = |role: &&str| {
            let is_archive = matches!(*role, "grad" | "physical" | "model" | "metrics");
            let traced = [&iteration::ARCHIVES[..], &recycling::ARCHIVES, &run::OUTPUTS[1..]];
            let kind = if is_archive || traced.iter().any(|archives| archives.contains(role)) { "npz" } else { "npy" };
            ((*role).to_owned(), FileRef { file: format!("{}/{role}.{kind}", draft.id), sha256: None })
        };
        let Draft { id, stage, title, level, flags, settings, .. } = draft.clone();
        let outputs = super::dimensions::outputs(&draft.stage).iter().map(output).collect();
        let (equations, allowances) = (Vec::new(), BTreeMap::new());
        let protocol = None;
        cases.push(Case { id, stage, title, equations, level, flags, protocol, settings, inputs, outputs, allowances });
    }
    let mut about: Map<String, Value> =
        [("program".to_owned(), json!(concat!("trgs ", env!("CARGO_PKG_VERSION"))))].into_iter().collect();
    about.insert(COMPUTED.into(), json!("the f64 path of this program, when the answers are checked"));
    about.extend(generator.iter().map(|(key, value)| ((*key).to_owned(), value.clone())));
    let flags = VALUES
        .iter()
        .chain(&RELATIONS)
        .chain(&REFUSALS)
        .map(|(word, text)| ((*word).to_owned(), (*text).to_owned()))
        .collect();
    Vectors::of(Manifest { schema_version: SCHEMA_VERSION, generator: about, flags, cases }, files)
}

fn file_name(role: &str, arrays: &Arrays) -> String {
    format!("{role}.{}", if arrays.contains_key("") { "npy" } else { "npz" })
}

/// An error about a stage for which no questions are generated.
pub(crate) fn unknown_stage(stage: &str, ask: Ask) -> Error {
    use trgs_core::setting::Setting;
    let known = ask.stages().join(", ");
    Error::invalid(Setting::Stage, stage, format!("one of {known}"), "name a stage for which questions are generated")
}
