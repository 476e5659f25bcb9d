//! Figures of a table that were predicted before its scans were at hand.

use super::summary::Summary;
use super::table::Table;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Predicted figures, read from a file.
#[derive(Clone, Debug)]
pub struct Predictions {
    path: PathBuf,
    all: Vec<Prediction>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    predictions: Vec<Prediction>,
}

/// A row's mean of a metric over the cases, or how far it is above another row's, as an interval.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prediction {
    /// Name of the table.
    pub table: String,
    /// Whether it is of measured scans, as the table that [`Table::measured`] returns.
    pub measured: bool,
    /// Name of the row.
    pub row: String,
    /// Name of the row whose mean is subtracted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub minus: Option<String>,
    /// Number of training views.
    pub views: usize,
    /// Level of noise.
    pub noise: String,
    /// One of [`METRICS`](super::METRICS).
    pub metric: String,
    /// Lower end of the interval.
    pub low: f64,
    /// The middle of the interval.
    pub expected: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// A prediction beside the figure of the finished table.
#[derive(Clone, Debug, Serialize)]
pub struct Judged {
    /// What was predicted.
    #[serde(flatten)]
    pub prediction: Prediction,
    /// The figure of the table; `None` if it has none, or only for some cells.
    pub found: Option<f64>,
    /// Whether the figure is in the interval.
    pub is_inside: bool,
}

impl Predictions {
    /// Reads a file of JSON: an object whose `predictions` is a list of [`Prediction`].
    ///
    /// # Errors
    /// For a file that cannot be read or has another form, and for an interval that does not hold what is expected.
    pub fn read(path: &Path) -> Result<Self> {
        let wrong = |got: String| {
            let expected = "an object with \"predictions\", a list of table, measured, row, views, noise, metric, low, \
                            expected and high, with low at most expected and expected at most high";
            Error::format(
                path,
                "predictions",
                got,
                expected,
                "correct it; reference/results/predictions.json has this form",
            )
        };
        let text = std::fs::read(path).map_err(|source| Error::read(path, source))?;
        let all = serde_json::from_slice::<Content>(&text).map_err(|error| wrong(error.to_string()))?.predictions;
        match all.iter().find(|p| !(p.low <= p.expected && p.expected <= p.high)) {
            Some(p) => Err(wrong(format!("{} to {}, expected {}, for {:?}", p.low, p.high, p.expected, p.row))),
            None => Ok(Self { path: path.to_owned(), all }),
        }
    }

    /// The predictions for a table.
    ///
    /// # Errors
    /// If there are none, and for a row, number of views, level of noise or metric that the table does not have.
    pub fn of(&self, table: &Table) -> Result<Vec<Prediction>> {
        let found: Vec<_> =
            self.all.iter().filter(|p| p.table == table.name && p.measured == table.is_measured()).cloned().collect();
        let wrong = |got: String, expected: String| {
            Error::format(&self.path, "predictions", got, expected, "give a file with predictions for this table")
        };
        let kind = if table.is_measured() { "measured" } else { "simulated" };
        if found.is_empty() {
            return Err(wrong("none for it".into(), format!("some for table {:?}, {kind}", table.name)));
        }
        let has = |p: &Prediction| {
            p.rows().all(|name| table.rows.iter().any(|row| row.name == *name))
                && table.views.contains(&p.views)
                && table.noise.contains(&p.noise)
                && table.metrics.contains(&p.metric)
        };
        match found.iter().find(|p| !has(p)) {
            Some(p) => {
                let rows: Vec<_> = p.rows().collect();
                let got = format!("rows {rows:?}, {} views, noise {:?}, metric {:?}", p.views, p.noise, p.metric);
                Err(wrong(got, format!("what table {:?} has", table.name)))
            }
            None => Ok(found),
        }
    }
}

impl Prediction {
    /// The rows that it needs.
    fn rows(&self) -> impl Iterator<Item = &String> {
        std::iter::once(&self.row).chain(&self.minus)
    }

    /// Compares with a table that [`Predictions::of`] has found to have the figure.
    pub fn judged(self, summary: &Summary) -> Judged {
        let table = &summary.table;
        let mean = |name: &String| {
            let row = table.rows.iter().position(|row| row.name == *name)?;
            let metric = table.metrics.iter().position(|metric| *metric == self.metric)?;
            let block = summary.blocks.iter().find(|block| block.views == self.views && block.noise == self.noise)?;
            block.figures[row][metric].complete().map(|estimate| estimate.mean)
        };
        let found = match &self.minus {
            None => mean(&self.row),
            Some(minus) => mean(&self.row).zip(mean(minus)).map(|(row, minus)| row - minus),
        };
        let is_inside = found.is_some_and(|found| (self.low..=self.high).contains(&found));
        Judged { prediction: self, found, is_inside }
    }
}
