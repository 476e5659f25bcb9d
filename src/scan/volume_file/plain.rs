//! Plain numbers in a file, of which boxes are read.

use crate::limit;
use ndarray::Array3;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::PathBuf;

/// The values of the bytes of numbers.
pub(super) type Values = Box<dyn Fn(&[u8]) -> io::Result<Vec<f32>> + Send + Sync>;

/// Plain numbers in a file.
pub(super) struct Plain {
    pub(super) file: File,
    pub(super) path: PathBuf,
    /// Position of the first number.
    pub(super) start: u64,
    /// `[x, y, z]`.
    pub(super) shape: [usize; 3],
    /// Whether x is fastest in the file; otherwise z is.
    pub(super) x_is_fastest: bool,
    /// Bytes of a number.
    pub(super) item: usize,
    pub(super) values: Values,
}

impl Plain {
    /// The values of a box, `[x, y, z]`.
    pub(super) fn read(&mut self, ranges: [Range<usize>; 3]) -> io::Result<Array3<f32>> {
        // From the slowest axis to the fastest.
        let order = if self.x_is_fastest { [2, 1, 0] } else { [0, 1, 2] };
        let [_, rows, columns] = order.map(|axis| self.shape[axis]);
        let [planes, rows_read, columns_read] = order.map(|axis| ranges[axis].clone());
        let shape = [planes.len(), rows_read.len(), columns_read.len()];
        let at = |plane: usize, row: usize, column: usize| ((plane * rows + row) * columns + column) * self.item;
        let mut values = limit::room("slab", shape.iter().product()).map_err(io::Error::other)?;
        let (mut span, mut picked) = (Vec::new(), Vec::new());
        for plane in planes {
            let first = at(plane, rows_read.start, columns_read.start);
            span.resize(at(plane, rows_read.end - 1, columns_read.end) - first, 0);
            self.file.seek(SeekFrom::Start(self.start + first as u64))?;
            self.file.read_exact(&mut span)?;
            if columns_read.len() == columns {
                values.extend((self.values)(&span)?);
                continue;
            }
            picked.clear();
            for row in span.chunks(columns * self.item) {
                picked.extend_from_slice(&row[..columns_read.len() * self.item]);
            }
            values.extend((self.values)(&picked)?);
        }
        let values = Array3::from_shape_vec(shape, values).expect("every plane has its values");
        Ok(if self.x_is_fastest { values.reversed_axes() } else { values })
    }
}
