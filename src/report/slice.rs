//! Images of slices: the choice of cuts, the mapping of values to colours, and PNG.
//!
//! An image shows two axes of the volume, the first to the right and the second upwards, so z is always up:
//!
//! | cut across | to the right | upwards |
//! |---|---|---|
//! | x | y | z |
//! | y | x | z |
//! | z | x | y |

use crate::geometry::Volume;
use ndarray::{Array2, ArrayView3, Axis};

/// Names of the axes of a volume.
pub const AXES: [&str; 3] = ["x", "y", "z"];

/// A slice of a volume: all voxels with one index along one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// The axis it is perpendicular to: 0, 1, 2 for x, y, z.
    pub axis: usize,
    /// Voxel along that axis.
    pub index: usize,
}

/// The range of values displayed from black to white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Displayed as black, as is everything below.
    pub low: f64,
    /// Displayed as white, as is everything above.
    pub high: f64,
}

/// A small image in grey: `[row, column]`, top row first.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture(Array2<u8>);

impl Cut {
    /// The values in image order, `[row, column]`, top row first.
    pub fn values(&self, volume: &Volume) -> Array2<f32> {
        let mut slice = volume.values.index_axis(Axis(self.axis), self.index).reversed_axes();
        slice.invert_axis(Axis(0));
        slice.to_owned()
    }
}

impl Window {
    /// The range from 0, or from a negative minimum, to the 99.9th percentile of a volume.
    ///
    /// Both ends are rounded to two digits.
    pub fn of(values: ArrayView3<f32>) -> Self {
        let values: Vec<f32> = values.iter().copied().filter(|value| value.is_finite()).collect();
        let low = f64::from(values.iter().copied().fold(0.0, f32::min));
        let high = significant(quantile(values, 0.999), 2);
        Self { low, high: if high > low { high } else { low + 1.0 } }
    }
}

/// Slices across z side by side, `[row, column]`, from the top left, in about as many rows as columns: at most `most` of them,
/// evenly spaced with both ends, and the index of each. `signs` are 1 where x runs to the right and y downwards, or else -1.
///
/// # Panics
/// For a volume without voxels.
pub fn contact_sheet(values: ArrayView3<f32>, most: usize, signs: [i8; 2]) -> (Array2<f32>, Vec<usize>) {
    let (width, height, depth) = values.dim();
    let count = depth.min(most);
    let indices: Vec<usize> = (0..count).map(|i| (i * (depth - 1) + (count - 1) / 2) / (count - 1).max(1)).collect();
    let columns = (1..).find(|columns| columns * columns >= count).expect("a number has a root");
    let mut sheet = Array2::zeros((height * count.div_ceil(columns), width * columns));
    for (place, &index) in indices.iter().enumerate() {
        let (row, column) = (place / columns * height, place % columns * width);
        let mut slice = values.index_axis(Axis(2), index).reversed_axes();
        signs.into_iter().zip([1, 0]).filter(|(sign, _)| *sign < 0).for_each(|(_, axis)| slice.invert_axis(Axis(axis)));
        slice.indexed_iter().for_each(|((v, u), value)| sheet[[row + v, column + u]] = *value);
    }
    (sheet, indices)
}

impl Picture {
    /// Values in grey.
    pub fn grey(values: &Array2<f32>, window: Window) -> Self {
        let level = |&v: &f32| ((f64::from(v) - window.low) / (window.high - window.low) * 255.0).round() as u8;
        Self(values.map(level))
    }

    /// The picture as a PNG file, one pixel per value.
    pub fn png(&self) -> Vec<u8> {
        let (rows, columns) = self.0.dim();
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, columns as u32, rows as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        let mut writer = encoder.write_header().expect("a picture has pixels and memory takes all bytes");
        writer.write_image_data(&self.0.iter().copied().collect::<Vec<_>>()).expect("memory takes all bytes");
        writer.finish().expect("memory takes all bytes");
        file
    }
}

/// The `q`-quantile of the values; 0 for no values.
pub(super) fn quantile(mut values: Vec<f32>, q: f64) -> f64 {
    let rank = ((values.len() as f64 * q).ceil() as usize).saturating_sub(1);
    if values.is_empty() { 0.0 } else { f64::from(*values.select_nth_unstable_by(rank, f32::total_cmp).1) }
}

/// A number rounded to `digits` significant digits.
pub(super) fn significant(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

/// A number with three significant digits and a typographic minus.
pub(super) fn short(value: f64) -> String {
    significant(value, 3).to_string().replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use glam::DVec3;
    use ndarray::{Array3, array};

    fn volume() -> Volume {
        let grid = Grid { shape: [2, 3, 4], min: DVec3::new(-1.0, 0.0, 2.0), spacing: DVec3::new(1.0, 0.5, 0.25) };
        Volume::new(grid, Array3::from_shape_fn((2, 3, 4), |(x, y, z)| (x * 100 + y * 10 + z) as f32)).unwrap()
    }

    #[test]
    fn the_second_axis_of_a_slice_points_upwards() {
        let values = |axis| Cut { axis, index: 1 }.values(&volume());
        assert_eq!(values(0), array![[103., 113., 123.], [102., 112., 122.], [101., 111., 121.], [100., 110., 120.]]);
        assert_eq!(values(1), array![[13., 113.], [12., 112.], [11., 111.], [10., 110.]]);
        assert_eq!(values(2), array![[21., 121.], [11., 111.], [1., 101.]]);
    }

    #[test]
    fn a_png_reads_back_with_the_right_size_and_colours() {
        let picture = Picture::grey(&Cut { axis: 0, index: 1 }.values(&volume()), Window { low: 100.0, high: 123.0 });
        let file = picture.png();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&file)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height, info.color_type), (3, 4, png::ColorType::Grayscale));
        assert_eq!([pixels[9], pixels[2]], [0, 255]);
    }

    #[test]
    fn numbers_are_shown_with_three_significant_digits() {
        let shown = [0.0, 1.0, -0.12, 0.5, 12.345, 0.000_123_4, f64::INFINITY].map(short);
        assert_eq!(shown, ["0", "1", "−0.12", "0.5", "12.3", "0.000123", "inf"]);
        assert_eq!(significant(0.0873, 2), 0.087);
    }

    #[test]
    fn a_volume_of_zeros_still_has_a_window() {
        let zeros = Array3::zeros((2, 2, 2));
        assert_eq!(Window::of(zeros.view()), Window { low: 0.0, high: 1.0 });
    }

    #[test]
    fn a_contact_sheet_has_the_slices_from_the_top_left() {
        let values = volume().values;
        let (sheet, indices) = contact_sheet(values.view(), 64, [1, -1]);
        assert_eq!(indices, [0, 1, 2, 3]);
        let rows = [[20., 120., 21., 121.], [10., 110., 11., 111.], [0., 100., 1., 101.]];
        let below = rows.map(|row| row.map(|value| value + 2.0));
        assert_eq!(sheet, ndarray::arr2(&[rows, below].concat()));
        // Of three, the ends and the middle; a place is left free.
        let (sheet, indices) = contact_sheet(values.view(), 3, [-1, 1]);
        assert_eq!(indices, [0, 2, 3]);
        assert_eq!([sheet.row(0).to_vec(), sheet.row(3).to_vec()], [[100., 0., 102., 2.], [103., 3., 0., 0.]]);
    }
}
