//! Images in the memory order that the voxel projector and filtered backprojection use.

use ndarray::{Array3, ArrayView3, Axis};

/// Images of several views: `[view][column][row from below]`.
///
/// The pixels that a line of voxels along z needs are contiguous and in the order of the voxels.
pub(super) struct Columns<T> {
    pub(super) values: Vec<T>,
    pub(super) rows: usize,
    pub(super) columns: usize,
}

impl<T: Copy> Columns<T> {
    /// Converts from `[view, v, u]`.
    pub(super) fn from_images(images: ArrayView3<'_, T>) -> Self {
        let (_, rows, columns) = images.dim();
        let mut upwards = images.permuted_axes([0, 2, 1]);
        upwards.invert_axis(Axis(2));
        Self { values: upwards.iter().copied().collect(), rows, columns }
    }

    /// Converts to `[view, v, u]`.
    pub(super) fn images(&self) -> Array3<T> {
        let (rows, columns) = (self.rows, self.columns);
        Array3::from_shape_fn((self.values.len() / (rows * columns), rows, columns), |(view, row, column)| {
            self.values[(view * columns + column) * rows + rows - 1 - row]
        })
    }

    /// The columns of one view.
    pub(super) fn view(&self, number: usize) -> &[T] {
        let pixels = self.rows * self.columns;
        &self.values[number * pixels..][..pixels]
    }
}
