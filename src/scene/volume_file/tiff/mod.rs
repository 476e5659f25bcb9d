//! TIFF: grey pages, several in one file or one in each file of a folder.

mod lengths;

use super::{VolumeFile, damaged};
use crate::error::{Error, Result};
use crate::output::write_atomically;
use ndarray::{Array3, Axis};
use std::io::{self, Cursor, Seek, Write};
use std::path::Path;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::encoder::colortype::Gray32Float;
use tiff::encoder::{TiffEncoder, TiffKind};
use tiff::{ColorType, TiffError, TiffResult};

/// Largest expansion of a compressed byte: twelve bits of LZW for all of its four thousand codes.
const MOST_INFLATION: usize = 2731;
/// Array size in bytes from which BigTIFF is written; classic TIFF ends at 4 GiB, directories included.
const LARGE: usize = 4_000_000_000;

pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    let mut pages = Pages::default();
    pages.add_all(content, path)?;
    Ok(VolumeFile::bare(pages.volume()))
}

/// Pages of equal size.
#[derive(Default)]
pub(super) struct Pages {
    /// Rows and columns.
    shape: (usize, usize),
    count: usize,
    values: Vec<f32>,
}

impl Pages {
    /// Adds the pages of a file and returns their number.
    ///
    /// Memory is bounded by what the content can expand to.
    pub(super) fn add_all(&mut self, content: &[u8], path: &Path) -> Result<usize> {
        let broken = |error: TiffError| damaged(path, &error.to_string());
        lengths::check(content).map_err(|found| damaged(path, &found))?;
        let mut left = content.len().saturating_mul(MOST_INFLATION);
        let mut decoder = Decoder::new(Cursor::new(content)).map_err(broken)?;
        for count in 1.. {
            let kind = decoder.colortype().map_err(broken)?;
            if !matches!(kind, ColorType::Gray(8 | 16 | 32 | 64)) {
                return Err(damaged(path, &format!("a page of {kind:?} instead of grey numbers of 8 to 64 bits")));
            }
            let (columns, rows) = decoder.dimensions().map_err(broken)?;
            let shape = (rows as usize, columns as usize);
            if self.count == 0 {
                self.shape = shape;
            }
            if shape != self.shape || rows == 0 || columns == 0 {
                let found =
                    format!("a page of {rows} rows and {columns} columns after {} of {:?}", self.count, self.shape);
                return Err(damaged(path, &found));
            }
            // A tile may be wider than the page, and the decoder holds a row of it.
            if (decoder.chunk_dimensions().0 as usize).saturating_mul(8) > left {
                return Err(damaged(path, &format!("tiles of {:?} pixels", decoder.chunk_dimensions())));
            }
            let mut limits = Limits::default();
            (limits.decoding_buffer_size, limits.intermediate_buffer_size) = (left, left);
            decoder = decoder.with_limits(limits);
            let page = decoder.read_image().map_err(broken)?;
            left -= self.add(&page).min(left);
            if !decoder.more_images() {
                return Ok(count);
            }
            decoder.next_image().map_err(broken)?;
        }
        unreachable!("a file has an end")
    }

    /// Adds a page and returns its size in bytes.
    fn add(&mut self, page: &DecodingResult) -> usize {
        macro_rules! add {
            ($values:expr) => {{
                self.values.extend($values.iter().map(|&value| value as f32));
                size_of_val(&$values[..])
            }};
        }
        self.count += 1;
        match page {
            DecodingResult::U8(values) => add!(values),
            DecodingResult::I8(values) => add!(values),
            DecodingResult::U16(values) => add!(values),
            DecodingResult::I16(values) => add!(values),
            DecodingResult::U32(values) => add!(values),
            DecodingResult::I32(values) => add!(values),
            DecodingResult::U64(values) => add!(values),
            DecodingResult::I64(values) => add!(values),
            DecodingResult::F32(values) => add!(values),
            DecodingResult::F64(values) => add!(values),
            DecodingResult::F16(values) => {
                self.values.extend(values.iter().map(|value| value.to_f32()));
                size_of_val(&values[..])
            }
        }
    }

    /// The volume `[x, y, z]` = column, row, page; columns are fastest in memory.
    pub(super) fn volume(self) -> Array3<f32> {
        let (rows, columns) = self.shape;
        let pages = Array3::from_shape_vec((self.count, rows, columns), self.values);
        pages.expect("every page has the shape of the first").reversed_axes()
    }
}

/// Writes one single-precision page per z.
pub(super) fn write(path: &Path, values: &Array3<f32>) -> Result<()> {
    let (columns, rows, _) = values.dim();
    let sides = [columns, rows].map(u32::try_from);
    let [Ok(columns), Ok(rows)] = sides else {
        return Err(Error::invalid("volume", format!("{:?}", values.dim()), "sides below 2^32", "take another format"));
    };
    write_atomically(path, |file| {
        let written = if 4 * values.len() > LARGE {
            TiffEncoder::new_big(file).and_then(|encoder| write_pages(encoder, values, columns, rows))
        } else {
            TiffEncoder::new(file).and_then(|encoder| write_pages(encoder, values, columns, rows))
        };
        written.map_err(|error| match error {
            TiffError::IoError(error) => error,
            other => io::Error::other(other.to_string()),
        })
    })
}

fn write_pages<W: Write + Seek, K: TiffKind>(
    mut encoder: TiffEncoder<W, K>,
    values: &Array3<f32>,
    columns: u32,
    rows: u32,
) -> TiffResult<()> {
    for page in values.axis_iter(Axis(2)) {
        let page: Vec<f32> = page.t().iter().copied().collect();
        encoder.write_image::<Gray32Float>(columns, rows, &page)?;
    }
    Ok(())
}
