//! Slices of equal size, from the pages of a file or from the files of a folder.

use super::{VolumeFile, damaged};
use crate::limit;
use glam::DVec3;
use ndarray::Array3;
use std::path::Path;
use trgs_core::error::{Error, Result};

/// Pages of equal size, row by row.
#[derive(Default)]
pub(super) struct Pages {
    /// Rows and columns.
    shape: (usize, usize),
    count: usize,
    values: Vec<f32>,
    pub(super) spacing: Option<DVec3>,
    /// Whether the spacing is in millimetres.
    pub(super) in_millimetres: bool,
    oddities: Vec<String>,
}

impl Pages {
    /// Checks the size of the next page.
    ///
    /// # Errors
    /// [`Error::Format`] for another size than that of the pages before, and for a page without pixels;
    /// [`Error::Memory`] when all pages together are too large.
    pub(super) fn check(&mut self, rows: usize, columns: usize, path: &Path) -> Result<()> {
        if self.count == 0 {
            self.shape = (rows, columns);
        }
        if rows == 0 || columns == 0 {
            return Err(damaged(path, &format!("a page of {rows} rows and {columns} columns")));
        }
        if (rows, columns) != self.shape {
            let (r, c) = self.shape;
            let got =
                format!("a page of {rows} rows and {columns} columns after {} of {r} rows and {c} columns", self.count);
            let remedy = "take out the page, or crop all to one size";
            return Err(Error::format(path, "page", got, "pages of equal size", remedy));
        }
        // The values, and their copy in another order.
        let pixels = (self.values.len() as u64).saturating_add((rows as u64).saturating_mul(columns as u64));
        let what = format!("pages of {rows} rows and {columns} columns, {} of them", self.count + 1);
        limit::allow(what, pixels.saturating_mul(2 * size_of::<f32>() as u64)).map_err(|error| error.in_file(path))
    }

    /// Adds the values of a checked page, or of several at once.
    pub(super) fn add(&mut self, values: impl IntoIterator<Item = f32>) {
        let before = self.values.len();
        self.values.extend(values);
        self.count += (self.values.len() - before) / (self.shape.0 * self.shape.1).max(1);
    }

    /// Forgets the values of the pages so far, but not their number and size.
    pub(super) fn forget(&mut self) {
        self.values.clear();
    }

    /// Adds a remark, once.
    pub(super) fn remark(&mut self, oddity: String) {
        if !self.oddities.contains(&oddity) {
            self.oddities.push(oddity);
        }
    }

    /// Number of pages.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// The volume `[x, y, z]` = column, row, page; columns are fastest in memory. It has no slice where values were forgotten.
    pub(super) fn volume(self) -> VolumeFile {
        let (rows, columns) = self.shape;
        let count = if self.values.is_empty() { 0 } else { self.count };
        let pages = Array3::from_shape_vec((count, rows, columns), self.values);
        let values = pages.expect("every page has the shape of the first").reversed_axes();
        let is_stated = self.in_millimetres && self.spacing.is_some();
        let mut volume = VolumeFile::new(self.spacing, None, None).in_millimetres(is_stated);
        volume.oddities.extend(self.oddities);
        VolumeFile { values, ..volume }
    }
}
