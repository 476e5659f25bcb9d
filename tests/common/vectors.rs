//! The committed vectors: 50-digit truth made by `reference/generate`, independent of this code.

use ndarray::Array3;
use std::path::PathBuf;
use trgs::primitives::{Group, Kernel, Parameters, Primitives, model};
use trgs::scene::npz::Npz;
use trgs::scene::{Scanner, dataset, npy};

/// One case of `reference/vectors/manifest.json`.
pub(crate) struct Case {
    pub(crate) id: String,
    pub(crate) angles: Vec<f64>,
    pub(crate) scanner: Scanner,
    pub(crate) primitives: Primitives,
    folder: PathBuf,
}

impl Case {
    pub(crate) fn array(&self, name: &str) -> Array3<f64> {
        npy::read_f64(&self.folder.join(name), "[a, b, c]").unwrap()
    }

    pub(crate) fn gradient(&self, name: &str) -> Parameters {
        let npz = Npz::read(&self.folder.join(name)).unwrap();
        let mut gradient = Parameters::zeros(self.primitives.len());
        for group in Group::ALL {
            let values = npz.entry(group.key()).unwrap().numbers.clone().into_f64();
            gradient.group_mut(group).copy_from_slice(values.as_standard_layout().as_slice().unwrap());
        }
        gradient
    }
}

/// All cases; an empty list fails.
pub(crate) fn cases() -> Vec<Case> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("reference/vectors");
    let manifest: serde_json::Value =
        serde_json::from_slice(&std::fs::read(root.join("manifest.json")).unwrap()).unwrap();
    let cases: Vec<Case> = manifest["cases"]
        .as_array()
        .unwrap()
        .iter()
        .map(|case| {
            let id = case["id"].as_str().unwrap().to_owned();
            let folder = root.join(&id);
            let primitives = model::read(&folder.join("model.npz")).unwrap();
            assert_eq!(case["kernel"] == "gaussian", primitives.kernel == Kernel::Gaussian, "{id}");
            Case {
                angles: case["angles"].as_array().unwrap().iter().map(|a| a.as_f64().unwrap()).collect(),
                scanner: dataset::read_scanner(&folder.join("meta_data.json")).unwrap(),
                primitives,
                folder,
                id,
            }
        })
        .collect();
    assert!(cases.len() >= 19, "{} cases", cases.len());
    cases
}
