//! Images of slices: the choice of cuts, the mapping of values to colours, and PNG.
//!
//! An image shows two axes of the volume, the first to the right and the second upwards, so z is always up:
//!
//! | cut across | to the right | upwards |
//! |---|---|---|
//! | x | y | z |
//! | y | x | z |
//! | z | x | y |

use crate::error::Result;
use crate::geometry::Volume;
use crate::scan::limit;
use crate::scan::volume_file::Stored;
use ndarray::{Array2, Axis};
use std::convert::Infallible;

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
    /// The range from 0, or from a negative minimum, to the 99.9th percentile of a volume's values that are finite.
    ///
    /// Both ends are rounded to two digits.
    ///
    /// # Errors
    /// Those of [`Stored::each`].
    pub fn of(volume: &mut Stored) -> Result<Self> {
        let axis = volume.slowest();
        let mut low = 0.0_f32;
        let high = quantile(0.999, |count| {
            let mut finite = |value: f32| {
                low = low.min(value);
                count(value);
            };
            volume.each(axis, |_, slab| {
                slab.iter().copied().filter(|value| value.is_finite()).for_each(&mut finite);
                Ok(())
            })
        })?;
        let (low, high) = (f64::from(low), significant(high, 2));
        Ok(Self { low, high: if high > low { high } else { low + 1.0 } })
    }
}

/// Slices across z side by side, `[row, column]`, from the top left, in about as many rows as columns: at most `most` of them,
/// evenly spaced with both ends, and the index of each. `signs` are 1 where x runs to the right and y downwards, or else -1.
///
/// # Errors
/// Those of [`Stored::each`], and [`Error::Memory`](crate::Error::Memory) for a sheet beyond the limit.
///
/// # Panics
/// For a volume without voxels.
pub fn contact_sheet(volume: &mut Stored, most: usize, signs: [i8; 2]) -> Result<(Array2<f32>, Vec<usize>)> {
    let [width, height, depth] = volume.shape();
    let count = depth.min(most);
    let indices: Vec<usize> = (0..count).map(|i| (i * (depth - 1) + (count - 1) / 2) / (count - 1).max(1)).collect();
    let columns = (1..).find(|columns| columns * columns >= count).expect("a number has a root");
    let shape = [height * count.div_ceil(columns), width * columns];
    // The values, and their colours.
    limit::allow_array("contact sheet", &shape, size_of::<f32>() + 1)?;
    let mut sheet = Array2::zeros(shape);
    let along = |i: usize, count: usize, sign: i8| if sign < 0 { count - 1 - i } else { i };
    let axis = volume.slowest();
    volume.each(axis, |first, slab| {
        let start = |of: usize| if of == axis { first } else { 0 };
        for (place, &index) in indices.iter().enumerate() {
            let Some(index) = index.checked_sub(start(2)).filter(|&index| index < slab.len_of(Axis(2))) else {
                continue;
            };
            for ((x, y), &value) in slab.index_axis(Axis(2), index).indexed_iter() {
                let row = place / columns * height + along(start(1) + y, height, signs[1]);
                sheet[[row, place % columns * width + along(start(0) + x, width, signs[0])]] = value;
            }
        }
        Ok(())
    })?;
    Ok((sheet, indices))
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

/// The `q`-quantile of values in the order of `total_cmp`; 0 for no values. `pass` gives all of them to its argument.
///
/// Values are counted by the upper and then by the lower half of their bits: a volume needs no sorted copy.
///
/// # Errors
/// That of `pass`.
pub(super) fn quantile<E>(
    q: f64,
    mut pass: impl FnMut(&mut dyn FnMut(f32)) -> std::result::Result<(), E>,
) -> std::result::Result<f64, E> {
    const SIGN: u32 = 1 << 31;
    // In the order of the numbers.
    let key = |value: f32| match value.to_bits() {
        bits if bits & SIGN == 0 => bits | SIGN,
        bits => !bits,
    };
    let mut upper = vec![0_usize; 1 << 16];
    pass(&mut |value| upper[(key(value) >> 16) as usize] += 1)?;
    let n: usize = upper.iter().sum();
    if n == 0 {
        return Ok(0.0);
    }
    let (high, rank) = entry(&upper, ((n as f64 * q).ceil() as usize).saturating_sub(1));
    let mut lower = vec![0_usize; 1 << 16];
    pass(&mut |value| lower[(key(value) & 0xffff) as usize] += usize::from(key(value) >> 16 == high))?;
    let key = high << 16 | entry(&lower, rank).0;
    Ok(f32::from_bits(if key & SIGN == 0 { !key } else { key & !SIGN }).into())
}

/// [`quantile`] of values in memory.
pub(super) fn quantile_of(q: f64, values: impl Iterator<Item = f32> + Clone) -> f64 {
    let Ok(value) = quantile(q, |count| -> std::result::Result<(), Infallible> {
        values.clone().for_each(count);
        Ok(())
    });
    value
}

/// The number that is at `rank` of all that are counted, and the rank among its equals.
fn entry(counts: &[usize], mut rank: usize) -> (u32, usize) {
    let mut number = 0;
    while counts[number] <= rank {
        rank -= counts[number];
        number += 1;
    }
    (number as u32, rank)
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
    use crate::scan::volume_file::VolumeFile;
    use glam::DVec3;
    use ndarray::{Array3, array};

    fn volume() -> Volume {
        let grid = Grid { shape: [2, 3, 4], min: DVec3::new(-1.0, 0.0, 2.0), spacing: DVec3::new(1.0, 0.5, 0.25) };
        Volume::new(grid, Array3::from_shape_fn((2, 3, 4), |(x, y, z)| (x * 100 + y * 10 + z) as f32)).unwrap()
    }

    fn stored(values: Array3<f32>) -> Stored {
        VolumeFile { values, ..VolumeFile::default() }.into()
    }

    #[test]
    fn a_quantile_is_that_of_the_sorted_values() {
        let mut values: Vec<f32> = (0..4000_i32).map(|i| ((i * 7919 % 4001) as f32 - 900.0) * 1.0003).collect();
        values.extend([0.0, -0.0, 1e-42, -1e-42, f32::MAX, f32::INFINITY, f32::NEG_INFINITY, 7.0, 7.0]);
        let mut sorted = values.clone();
        sorted.sort_by(f32::total_cmp);
        for q in [0.0, 0.01, 0.2245, 0.2246, 0.5, 0.995, 0.999, 1.0] {
            let rank = ((values.len() as f64 * q).ceil() as usize).saturating_sub(1);
            let found = quantile_of(q, values.iter().copied());
            assert_eq!(found.to_bits(), f64::from(sorted[rank]).to_bits(), "{q}");
        }
        assert_eq!(quantile_of(0.5, [].into_iter()), 0.0);
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
        let window = |values: Array3<f32>| Window::of(&mut stored(values)).unwrap();
        assert_eq!(window(Array3::zeros((2, 2, 2))), Window { low: 0.0, high: 1.0 });
        let mut values = Array3::from_shape_fn((10, 10, 20), |(x, y, z)| (x * 200 + y * 20 + z) as f32);
        (values[[3, 2, 1]], values[[0, 0, 0]], values[[0, 0, 1]]) = (-1.5, f32::NAN, f32::INFINITY);
        assert_eq!(window(values), Window { low: -1.5, high: 2000.0 });
    }

    #[test]
    fn a_contact_sheet_has_the_slices_from_the_top_left() {
        let values = || stored(volume().values);
        let (sheet, indices) = contact_sheet(&mut values(), 64, [1, -1]).unwrap();
        assert_eq!(indices, [0, 1, 2, 3]);
        let rows = [[20., 120., 21., 121.], [10., 110., 11., 111.], [0., 100., 1., 101.]];
        let below = rows.map(|row| row.map(|value| value + 2.0));
        assert_eq!(sheet, ndarray::arr2(&[rows, below].concat()));
        // Of three, the ends and the middle; a place is left free.
        let (sheet, indices) = contact_sheet(&mut values(), 3, [-1, 1]).unwrap();
        assert_eq!(indices, [0, 2, 3]);
        assert_eq!([sheet.row(0).to_vec(), sheet.row(3).to_vec()], [[100., 0., 102., 2.], [103., 3., 0., 0.]]);
    }
}
