//! `reference/tolerances.toml`: allowed errors by stage, format and norm, with reasons.

use super::difference::Difference;
use super::format::Format;
use super::fresh::{Ask, relations};
use super::manifest::{Case, Vectors};
use ndarray::{ArrayD, Dimension};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_scan::digest::digest_bytes;

const FILE: &str = "reference/tolerances.toml";
const TEXT: &str = include_str!(concat!(env!("TRGS_REFERENCE"), "/tolerances.toml"));

/// The whole table.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerances {
    /// Stages with matrix products.
    #[serde(default)]
    pub products: Vec<String>,
    /// Rules in order: the last rule that matches an array applies.
    #[serde(rename = "rule")]
    pub rules: Vec<Rule>,
    /// Limits of single elements, which hold beside the rules; the last one that matches an array applies.
    #[serde(rename = "element", default)]
    pub elements: Vec<ElementRule>,
    /// The file of rules that were added.
    #[serde(skip)]
    pub added: Option<String>,
}

/// The limit of an element: `factor`·u·condition, u half a unit in the last place of 1 in the format.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElementRule {
    /// Stages that it applies to.
    pub stages: Vec<String>,
    /// Arrays that it applies to, by their names in the archive or the output's role; empty means all.
    #[serde(default)]
    pub parts: Vec<String>,
    /// The factor; without one the norms alone judge these stages.
    pub factor: Option<f64>,
    /// The largest error in units of u·condition of correct backends in single precision throughout.
    pub measured: Option<f64>,
    /// The reason for the factor, or for its absence.
    pub reason: String,
}

/// The element with the largest error in units of u·condition.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Element {
    /// Its error in units of u·condition.
    #[serde(serialize_with = "super::difference::as_number_or_text")]
    pub ratio: f64,
    /// Its index.
    pub index: Vec<usize>,
    /// The truth.
    pub expected: f64,
    /// The backend's value.
    #[serde(serialize_with = "super::difference::as_number_or_text")]
    pub got: f64,
    /// Its condition.
    pub condition: f64,
}

impl Element {
    /// Finds it; `None` if no error counts: those below u³ of the peak do not. Elements without a finite condition are left to the norms.
    pub fn worst(
        expected: &ArrayD<f64>,
        got: &ArrayD<f64>,
        allowance: Option<&ArrayD<f64>>,
        condition: &ArrayD<f64>,
        format: Format,
    ) -> Option<Self> {
        let unit = format.ulp(1.0) / 2.0;
        let finite = expected.iter().filter(|e| e.is_finite());
        // A fast exponential may be zero there.
        let floor =
            format.smallest_normal().max(unit * unit * unit * finite.fold(0.0_f64, |peak, e| peak.max(e.abs())));
        let mut worst: Option<Self> = None;
        for ((index, &expected), (&got, &condition)) in expected.indexed_iter().zip(got.iter().zip(condition)) {
            let allowed = allowance.map_or(0.0, |allowance| allowance[index.clone()]);
            let error = (got - expected).abs() - allowed - floor;
            if !(error > 0.0 && condition.is_finite()) {
                continue;
            }
            let ratio = error / (unit * condition);
            if worst.as_ref().is_none_or(|worst| ratio > worst.ratio) {
                let index = index.as_array_view().to_vec();
                worst = Some(Self { ratio, index, expected, got, condition });
            }
        }
        worst
    }
}

/// One rule.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rule {
    /// Stages that it applies to.
    pub stages: Vec<String>,
    /// Cases that it applies to, as `stage/name` or `*/name`; empty means all cases of the stages.
    #[serde(default)]
    pub cases: Vec<String>,
    /// Arrays that it applies to, by their names in the archive or the output's role; empty means all.
    #[serde(default)]
    pub parts: Vec<String>,
    /// The reason for these limits.
    pub reason: String,
    /// Limits per format.
    pub limits: BTreeMap<Format, Limits>,
    /// Largest errors of this program's own answers (for f16 and bf16: its f64 answers, rounded).
    #[serde(default)]
    pub measured: BTreeMap<Format, Limits>,
}

/// A limit per norm of [`Difference`]; a norm without a limit is only reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Largest error relative to the peak.
    pub peak: Option<f64>,
    /// Largest error of a significant element, in its own ulp.
    pub ulp: Option<f64>,
    /// Largest error of an element relative to its own truth.
    pub relative: Option<f64>,
    /// Relative L2 error.
    pub l2: Option<f64>,
    /// 1 - cosine.
    pub cosine: Option<f64>,
    /// Magnitude of the signed bias.
    pub bias: Option<f64>,
    /// Fraction of wrong zeros.
    pub zeros: Option<f64>,
}

/// A norm above its limit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Excess {
    /// Name of the norm.
    pub norm: &'static str,
    /// Its value.
    #[serde(serialize_with = "super::difference::as_number_or_text")]
    pub value: f64,
    /// The limit.
    pub limit: f64,
}

impl Limits {
    /// The norms of `difference` with their limits.
    fn pairs(&self, difference: &Difference) -> [(&'static str, f64, Option<f64>); 7] {
        [
            ("peak", difference.peak, self.peak),
            ("ulp", difference.ulp, self.ulp),
            ("relative", difference.relative, self.relative),
            ("l2", difference.l2, self.l2),
            ("cosine", difference.cosine, self.cosine),
            ("bias", difference.bias.abs(), self.bias),
            ("zeros", difference.zeros, self.zeros),
        ]
    }

    /// The norms that are above their limit or NaN.
    pub fn exceeded(&self, difference: &Difference) -> Vec<Excess> {
        let pairs = self.pairs(difference).into_iter();
        let limited = pairs.filter_map(|(norm, value, limit)| Some((norm, value, limit?)));
        let above = limited.filter(|&(_, value, limit)| value.is_nan() || value > limit);
        above.map(|(norm, value, limit)| Excess { norm, value, limit }).collect()
    }
}

impl Tolerances {
    /// The table built into the program.
    ///
    /// # Errors
    /// None in a program that passed its tests.
    pub fn embedded() -> Result<Self> {
        Self::parse(TEXT, Path::new(FILE))
    }

    /// Parses the text of a table; `path` names it in errors.
    ///
    /// # Errors
    /// [`Error::Format`] for anything but such a table, or for a rule without a limit.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let remedy = "correct it after the example reference/tolerances.toml of this version";
        let table: Self = toml::from_str(text)
            .map_err(|error| Error::format(path, "tolerances", error.message(), "a list of [[rule]]", remedy))?;
        let empty = table.rules.iter().position(|rule| rule.limits.values().any(|limits| limits.peak.is_none()));
        match empty {
            Some(i) => {
                let got = format!("no `peak` for {:?}", table.rules[i].stages);
                Err(Error::format(path, format!("rule {i}"), got, "at least `peak` for each format", remedy))
            }
            None => Ok(table),
        }
    }

    /// Adds the rules of a file, which come after those that are there and apply before them.
    ///
    /// # Errors
    /// For a file that cannot be read, and as [`Self::parse`].
    pub fn add(&mut self, path: &Path) -> Result<()> {
        let bytes = trgs_scan::input::read(path).map_err(|source| Error::read(path, source))?;
        let more = Self::parse(&String::from_utf8_lossy(&bytes), path)?;
        self.rules.extend(more.rules);
        self.elements.extend(more.elements);
        self.added = Some(format!("{} (SHA-256 {})", path.display(), digest_bytes(&bytes)));
        Ok(())
    }

    /// The limits for the questions of these vectors.
    ///
    /// Allowances of generated questions hold the condition of each element: there norms that know no allowances are not
    /// judged, and elements have no second limit. Answers with relations have the limit of the peak alone.
    ///
    /// # Errors
    /// As [`Self::embedded`].
    pub fn of(vectors: &Vectors) -> Result<Self> {
        Ok(Self::embedded()?.made_for(vectors))
    }

    /// [`Self::of`] for this table.
    #[must_use]
    pub fn made_for(mut self, vectors: &Vectors) -> Self {
        if crate::fresh::is_generated(vectors) {
            let ask = Ask::of(vectors);
            for limits in self.rules.iter_mut().flat_map(|rule| rule.limits.values_mut()) {
                limits.cosine = None;
                if ask == Ask::Relations {
                    let peak = limits.peak.map(|peak| relations::FACTOR * peak);
                    *limits = Limits { peak, ..Limits::default() };
                }
            }
            self.elements.clear();
        }
        self
    }

    /// The format whose limits a stage has: where only factors of products are rounded, that of the factors in the stages with
    /// products, and single precision in the others.
    pub fn judged_as(&self, stage: &str, format: Format) -> Format {
        match format {
            Format::Tf32 | Format::F16F32 if self.products.iter().any(|known| known == stage) => Format::F16,
            Format::Tf32 | Format::F16F32 => Format::F32,
            format => format,
        }
    }

    /// The rule for one array of a case's output.
    pub fn rule(&self, case: &Case, part: &str, format: Format) -> Option<&Rule> {
        let format = self.judged_as(&case.stage, format);
        self.rules.iter().rev().find(|rule| rule.fits(case, part) && rule.limits.contains_key(&format))
    }

    /// The factor of u·condition that limits each element of an array, if its condition is known.
    pub fn factor(&self, case: &Case, part: &str) -> Option<f64> {
        let fits = |rule: &&ElementRule| {
            rule.stages.contains(&case.stage) && (rule.parts.is_empty() || rule.parts.iter().any(|p| p == part))
        };
        self.elements.iter().rev().find(fits)?.factor
    }
}

impl Rule {
    fn fits(&self, case: &Case, part: &str) -> bool {
        let name = case.id.rsplit('/').next();
        self.stages.contains(&case.stage)
            && (self.parts.is_empty() || self.parts.iter().any(|p| p == part))
            && (self.cases.is_empty()
                || self.cases.iter().any(|c| *c == case.id || c.strip_prefix("*/").is_some_and(|c| Some(c) == name)))
    }
}
