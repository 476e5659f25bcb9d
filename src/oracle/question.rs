//! A case with its inputs: the question to a backend.

use super::manifest::{Arrays, Case, Vectors, decode};
use ndarray::{Array, ArrayD, Dimension};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::Scanner;
use trgs_core::primitives::{Activation, Group, KernelKind, Parameters, Primitives, activation::Interval};
use trgs_core::projector::Projection;
use trgs_core::wavelet;
use trgs_scan::dataset::Description;

/// Inputs in this program's types. A diagnosis changes one of them and recomputes the outputs.
#[derive(Clone, Debug)]
pub struct Question {
    pub(super) id: String,
    pub(super) stage: String,
    pub(super) settings: Map<String, Value>,
    pub(super) scanner: Option<Scanner>,
    arrays: BTreeMap<String, Arrays>,
}

impl Question {
    /// Reads the inputs of a case.
    ///
    /// # Errors
    /// Those of [`Vectors::bytes`] and of the readers.
    pub fn new(vectors: &Vectors, case: &Case) -> Result<Self> {
        let mut scanner = None;
        let mut arrays = BTreeMap::new();
        for (role, file) in &case.inputs {
            let (bytes, path) = (vectors.bytes(file)?, vectors.path(file));
            if role == "scanner" {
                scanner = Some(Description::parse(&bytes, &path)?.scanner);
            } else {
                arrays.insert(role.clone(), decode(&bytes, &path)?);
            }
        }
        let (id, stage, settings) = (case.id.clone(), case.stage.clone(), case.settings.clone());
        Ok(Self { id, stage, settings, scanner, arrays })
    }

    /// A question from its parts.
    pub(super) fn of(
        id: String,
        stage: String,
        settings: Map<String, Value>,
        scanner: Option<Scanner>,
        arrays: BTreeMap<String, Arrays>,
    ) -> Self {
        Self { id, stage, settings, scanner, arrays }
    }

    /// The arrays of all inputs, by role.
    pub(super) fn arrays_mut(&mut self) -> &mut BTreeMap<String, Arrays> {
        &mut self.arrays
    }

    /// Whether a primitive, or an element of a list of ν, has infinite degrees of freedom.
    pub(super) fn has_infinite_nu(&self) -> bool {
        self.arrays.iter().any(|(role, arrays)| {
            arrays.iter().any(|(name, array)| {
                let what = if name.is_empty() { role } else { name };
                what == "nu" && array.iter().any(|nu| *nu == f64::INFINITY)
            })
        })
    }

    /// Refuses NaN in any input, and degrees of freedom that are not positive.
    pub(super) fn refuse_nonsense(&self) -> Result<()> {
        let refuse = |what: &str, got: &str, expected: &str| {
            let remedy = "such a question has no answer: change the inputs";
            Err(Error::invalid(format!("{what} of case {}", self.id), got, expected, remedy))
        };
        for (role, arrays) in &self.arrays {
            for (name, array) in arrays {
                let what = if name.is_empty() { role } else { name };
                if array.iter().any(|x| x.is_nan()) {
                    return refuse(what, "NaN", "numbers");
                }
                if what == "nu"
                    && !matches!(role.as_str(), "raw" | "first" | "second")
                    && array.iter().any(|x| *x <= 0.0)
                {
                    return refuse(what, "numbers that are not positive", "positive numbers");
                }
            }
        }
        Ok(())
    }

    fn missing(&self, what: &str) -> Error {
        Error::invalid(
            format!("case {}", self.id),
            "a manifest without it",
            what,
            "export the vectors again with this version: `trgs oracle export`",
        )
    }

    pub(super) fn scanner(&self) -> Result<Scanner> {
        self.scanner.ok_or_else(|| self.missing("input scanner"))
    }

    /// An input that is one array.
    pub(super) fn array<D: Dimension>(&self, role: &str) -> Result<Array<f64, D>> {
        let array = self.arrays.get(role).and_then(|arrays| arrays.get(""));
        let array = array.ok_or_else(|| self.missing(&format!("input {role}")))?;
        array
            .clone()
            .into_dimensionality()
            .map_err(|_| self.missing(&format!("input {role} with another number of axes")))
    }

    /// An input that is one row of numbers.
    pub(super) fn numbers(&self, role: &str) -> Result<Vec<f64>> {
        Ok(self.array::<ndarray::Ix1>(role)?.to_vec())
    }

    /// The arrays of an input that is an archive, by name and shape, one after the other.
    pub(super) fn joined(
        &self,
        role: &str,
        parts: impl Iterator<Item = (&'static str, &'static [usize])>,
    ) -> Result<Vec<f64>> {
        let arrays = self.arrays.get(role).ok_or_else(|| self.missing(&format!("input {role}")))?;
        let mut all = Vec::new();
        for (name, shape) in parts {
            let array = arrays.get(name).filter(|array| array.shape() == shape);
            all.extend(array.ok_or_else(|| self.missing(&format!("input {role} with {name}")))?.iter());
        }
        Ok(all)
    }

    /// An input with the arrays of a model: parameters, gradients or moments.
    pub(super) fn parameters(&self, role: &str) -> Result<Parameters> {
        let arrays = self.arrays.get(role).ok_or_else(|| self.missing(&format!("input {role}")))?;
        let m = arrays.get("density").map_or(0, ArrayD::len);
        let mut parameters = Parameters::zeros(m);
        for group in Group::ALL {
            let array = arrays.get(group.key()).filter(|array| array.len() == m * group.width());
            let array = array.ok_or_else(|| self.missing(&format!("input {role} with {}", group.key())))?;
            parameters
                .group_mut(group)
                .copy_from_slice(array.as_standard_layout().as_slice().expect("standard layout"));
        }
        Ok(parameters)
    }

    pub(super) fn primitives(&self) -> Result<Primitives> {
        Primitives::new(self.parameters("model")?)
    }

    /// Replaces the parameters of the model.
    pub(super) fn set_model(&mut self, parameters: &Parameters) -> Result<()> {
        let mut missing = None;
        for group in Group::ALL {
            match self.arrays.get_mut("model").and_then(|arrays| arrays.get_mut(group.key())) {
                Some(array) => array.iter_mut().zip(parameters.group(group)).for_each(|(old, new)| *old = *new),
                None => missing = Some(group.key()),
            }
        }
        missing.map_or(Ok(()), |key| Err(self.missing(&format!("input model with {key}"))))
    }

    pub(super) fn setting(&self, key: &str) -> Result<f64> {
        self.settings.get(key).and_then(Value::as_f64).ok_or_else(|| self.missing(&format!("setting {key}")))
    }

    pub(super) fn integer(&self, key: &str) -> Result<u64> {
        self.settings.get(key).and_then(Value::as_u64).ok_or_else(|| self.missing(&format!("setting {key}")))
    }

    pub(super) fn word(&self, key: &str) -> Result<&str> {
        self.settings.get(key).and_then(Value::as_str).ok_or_else(|| self.missing(&format!("setting {key}")))
    }

    pub(super) fn list(&self, key: &str) -> Result<Vec<f64>> {
        let values = self.settings.get(key).and_then(Value::as_array);
        let values = values.and_then(|values| values.iter().map(Value::as_f64).collect::<Option<Vec<_>>>());
        values.ok_or_else(|| self.missing(&format!("setting {key}")))
    }

    pub(super) fn triple(&self, key: &str) -> Result<[f64; 3]> {
        self.list(key)?.try_into().map_err(|_| self.missing(&format!("setting {key} with three numbers")))
    }

    pub(super) fn angles(&self) -> Result<Vec<f64>> {
        self.list("angles")
    }

    /// The projection given by the stage's name or by a setting.
    pub(super) fn projection(&self) -> Result<Projection> {
        match self.settings.get("projection").and_then(Value::as_str) {
            Some("affine") => Ok(Projection::Affine),
            Some("exact") => Ok(Projection::Exact),
            Some(_) => Err(self.missing("setting projection: exact or affine")),
            None => Ok(if self.stage.ends_with("affine") { Projection::Affine } else { Projection::Exact }),
        }
    }

    pub(super) fn interval(&self, key: &str) -> Result<Interval> {
        match self.list(key)?[..] {
            [min, max] => Ok(Interval { min, max }),
            _ => Err(self.missing(&format!("setting {key} with two numbers"))),
        }
    }

    pub(super) fn activation(&self) -> Result<Activation> {
        let kernel = if self.word("kernel")? == "gaussian" { KernelKind::Gaussian } else { KernelKind::StudentT };
        Ok(Activation { kernel, scale: self.interval("scale_range")?, nu: self.interval("nu_range")? })
    }

    /// The settings of the wavelet loss, with defaults for those that are not stated.
    pub(super) fn wavelet_settings(&self) -> Result<wavelet::Settings> {
        let default = wavelet::Settings::default();
        let or =
            |key: &str, default: f64| if self.settings.contains_key(key) { self.setting(key) } else { Ok(default) };
        Ok(wavelet::Settings {
            neighbours: self.integer("neighbours")? as usize,
            threshold: or("threshold", default.threshold)?,
            enhancement: or("enhancement", default.enhancement)?,
            suppress: or("suppress", default.suppress)?,
            enhance: or("enhance", default.enhance)?,
            levels: or("levels", default.levels as f64)? as usize,
        })
    }
}
