//! Images in the order in which both the voxel projector and filtered backprojection go through them.

use ndarray::{Array3, ArrayView3, Axis};

/// Images of some views: `[view][column][row from below]`. What a line of voxels along z needs lies side by side, in the
/// order of the voxels.
pub(super) struct Columns<T> {
    pub(super) values: Vec<T>,
    pub(super) rows: usize,
    pub(super) columns: usize,
}

impl<T: Copy> Columns<T> {
    /// From `[view, v, u]`.
    pub(super) fn from_images(images: ArrayView3<'_, T>) -> Self {
        let (_, rows, columns) = images.dim();
        let mut upwards = images.permuted_axes([0, 2, 1]);
        upwards.invert_axis(Axis(2));
        Self { values: upwards.iter().copied().collect(), rows, columns }
    }

    /// To `[view, v, u]`.
    pub(super) fn images(&self) -> Array3<T> {
        let (rows, columns) = (self.rows, self.columns);
        Array3::from_shape_fn((self.values.len() / (rows * columns), rows, columns), |(view, row, column)| {
            self.values[(view * columns + column) * rows + rows - 1 - row]
        })
    }

    /// Columns of one view.
    pub(super) fn view(&self, number: usize) -> &[T] {
        let pixels = self.rows * self.columns;
        &self.values[number * pixels..][..pixels]
    }
}
