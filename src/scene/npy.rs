//! NumPy's `.npy` files: one array of numbers, header and values.
//!
//! Only the arrays that occur here are understood: little- or big-endian floats, integers and booleans, in C or
//! Fortran order. Sizes are checked against the length of the file before memory is asked for, so a damaged header
//! cannot ask for more than the file holds. Source: NumPy Enhancement Proposal 1.

use crate::error::{Error, Result};
use crate::output::write_atomically;
use ndarray::{Array, ArrayD, ArrayView, Dimension, IxDyn, ShapeBuilder};
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;

/// What every file begins with.
const MAGIC: &[u8] = b"\x93NUMPY";
/// Headers of plain arrays have about 100 bytes; NumPy itself refuses more than this.
const LONGEST_HEADER: usize = 10_000;

/// An array as it was stored: integers of up to 16 bits become single precision, longer ones double (exact up to 2⁵³).
#[derive(Clone, Debug, PartialEq)]
pub enum Numbers {
    /// Single precision.
    F32(ArrayD<f32>),
    /// Double precision.
    F64(ArrayD<f64>),
}

/// The content of a file or of an entry of an archive.
#[derive(Clone, Debug, PartialEq)]
pub struct Npy {
    /// The values, in C order.
    pub numbers: Numbers,
    /// The largest value of the stored type, if that is an integer type: 255 for bytes.
    pub full_scale: Option<f64>,
}

impl Numbers {
    /// Lengths of the axes.
    pub fn shape(&self) -> &[usize] {
        match self {
            Self::F32(values) => values.shape(),
            Self::F64(values) => values.shape(),
        }
    }

    /// Whether the file held double precision or long integers.
    pub fn is_double(&self) -> bool {
        matches!(self, Self::F64(_))
    }

    /// In single precision, rounded to nearest.
    pub fn into_f32(self) -> ArrayD<f32> {
        match self {
            Self::F32(values) => values,
            Self::F64(values) => values.mapv(|value| value as f32),
        }
    }

    /// In double precision, exactly.
    pub fn into_f64(self) -> ArrayD<f64> {
        match self {
            Self::F32(values) => values.mapv(f64::from),
            Self::F64(values) => values,
        }
    }
}

/// Reads a file.
///
/// # Errors
/// [`Error::Read`] or, for anything but a complete array of numbers, [`Error::Format`].
pub fn read(path: &Path) -> Result<Npy> {
    let file = File::open(path).map_err(|source| Error::read(path, source))?;
    let length = file.metadata().map_err(|source| Error::read(path, source))?.len();
    decode(BufReader::new(file), length, path, "file")
}

/// Reads an array with as many axes as `D` has, in single precision; `axes` names them in the error, as in `[x, y, z]`.
///
/// # Errors
/// Those of [`read`], and [`Error::Format`] for another number of axes.
pub fn read_f32<D: Dimension>(path: &Path, axes: &str) -> Result<Array<f32, D>> {
    with_axes(read(path)?.numbers.into_f32(), path, "array", axes)
}

/// Reads an array with as many axes as `D` has, in double precision; `axes` names them in the error.
///
/// # Errors
/// Those of [`read`], and [`Error::Format`] for another number of axes.
pub fn read_f64<D: Dimension>(path: &Path, axes: &str) -> Result<Array<f64, D>> {
    with_axes(read(path)?.numbers.into_f64(), path, "array", axes)
}

/// Writes an array in C order, atomically.
///
/// # Errors
/// [`Error::Write`].
pub fn write<T: Element, D: Dimension>(path: &Path, array: ArrayView<'_, T, D>) -> Result<()> {
    write_atomically(path, |file| encode(file, array))
}

/// A number that can be written: f32 or f64.
pub trait Element: Copy {
    /// NumPy's name of the type.
    const DESCRIPTION: &'static str;
    /// Its bytes, little-endian.
    fn to_bytes(self) -> impl AsRef<[u8]>;
}

impl Element for f32 {
    const DESCRIPTION: &'static str = "<f4";
    fn to_bytes(self) -> impl AsRef<[u8]> {
        self.to_le_bytes()
    }
}

impl Element for f64 {
    const DESCRIPTION: &'static str = "<f8";
    fn to_bytes(self) -> impl AsRef<[u8]> {
        self.to_le_bytes()
    }
}

/// Writes header and values.
pub(crate) fn encode<T: Element, D: Dimension>(mut file: impl Write, array: ArrayView<'_, T, D>) -> io::Result<()> {
    let shape: String = array.shape().iter().map(|n| format!("{n}, ")).collect();
    // One axis keeps its comma, as in a Python tuple.
    let shape = if array.ndim() == 1 { shape.trim_end() } else { shape.trim_end_matches(", ") };
    let header = format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({shape}), }}", T::DESCRIPTION);
    // The values begin at a multiple of 64 bytes: magic, version and length take 10, the line end 1.
    let length = (header.len() + 11).next_multiple_of(64) - 10;
    file.write_all(MAGIC)?;
    file.write_all(&[1, 0])?;
    file.write_all(&u16::try_from(length).map_err(io::Error::other)?.to_le_bytes())?;
    writeln!(file, "{header:width$}", width = length - 1)?;
    array.iter().try_for_each(|value| file.write_all(value.to_bytes().as_ref()))
}

/// Reads `length` bytes of header and values; `what` and `path` name the source in errors.
pub(crate) fn decode(mut source: impl Read, length: u64, path: &Path, what: &str) -> Result<Npy> {
    let (header, header_bytes) = Header::read(&mut source, path, what)?;
    let numeric = |got: &str| {
        Error::format(
            path,
            what,
            format!("values of type {got:?}"),
            "floats of 4 or 8 bytes, integers or booleans",
            "convert it with numpy's astype",
        )
    };
    let kind = header.kind.as_str();
    let item: usize = kind.get(1..).and_then(|size| size.parse().ok()).ok_or_else(|| numeric(&header.description))?;
    let count = header.shape.iter().try_fold(1_usize, |product, &n| product.checked_mul(n));
    let bytes = count.and_then(|count| u64::try_from(count.checked_mul(item)?).ok()?.checked_add(header_bytes));
    let (Some(count), true) = (count, bytes == Some(length)) else {
        let size = bytes.map_or_else(|| "more bytes than any file has".into(), |bytes| format!("{bytes} bytes"));
        return Err(Error::format(
            path,
            what,
            format!("{length} bytes"),
            format!("{size} for shape {:?} of {:?}", header.shape, header.description),
            "it is truncated or damaged: copy or make it again",
        ));
    };

    let mut reader = Values { source: &mut source, count, big_endian: header.big_endian };
    let layout = IxDyn(&header.shape).set_f(header.fortran);
    let single =
        |values: io::Result<Vec<f32>>| values.map(|v| ArrayD::from_shape_vec(layout.clone(), v).map(Numbers::F32));
    let double =
        |values: io::Result<Vec<f64>>| values.map(|v| ArrayD::from_shape_vec(layout.clone(), v).map(Numbers::F64));
    let (array, full_scale) = match kind {
        "f4" => (single(reader.read(f32::from_le_bytes)), None),
        "f8" => (double(reader.read(f64::from_le_bytes)), None),
        "b1" => (single(reader.read(|[byte]| f32::from(byte))), Some(1.0)),
        "u1" => (single(reader.read(|[byte]| f32::from(byte))), Some(f64::from(u8::MAX))),
        "i1" => (single(reader.read(|b| f32::from(i8::from_le_bytes(b)))), Some(f64::from(i8::MAX))),
        "u2" => (single(reader.read(|b| f32::from(u16::from_le_bytes(b)))), Some(f64::from(u16::MAX))),
        "i2" => (single(reader.read(|b| f32::from(i16::from_le_bytes(b)))), Some(f64::from(i16::MAX))),
        "u4" => (double(reader.read(|b| f64::from(u32::from_le_bytes(b)))), Some(f64::from(u32::MAX))),
        "i4" => (double(reader.read(|b| f64::from(i32::from_le_bytes(b)))), Some(f64::from(i32::MAX))),
        "u8" => (double(reader.read(|b| u64::from_le_bytes(b) as f64)), Some(u64::MAX as f64)),
        "i8" => (double(reader.read(|b| i64::from_le_bytes(b) as f64)), Some(i64::MAX as f64)),
        _ => return Err(numeric(&header.description)),
    };
    let numbers = array.map_err(|source| unreadable(source, path, what))?.map_err(|shape| {
        Error::format(
            path,
            what,
            format!("shape {:?}: {shape}", header.shape),
            "an array that fits into memory",
            "check what wrote it",
        )
    })?;
    let numbers = match numbers {
        Numbers::F32(values) => Numbers::F32(in_c_order(values)),
        Numbers::F64(values) => Numbers::F64(in_c_order(values)),
    };
    Ok(Npy { numbers, full_scale })
}

/// Converts to a fixed number of axes, or says which were expected.
pub(crate) fn with_axes<T, D: Dimension>(array: ArrayD<T>, path: &Path, what: &str, axes: &str) -> Result<Array<T, D>> {
    let shape = array.shape().to_vec();
    array.into_dimensionality().map_err(|_| {
        Error::format(path, what, format!("shape {shape:?}"), format!("axes {axes}"), "reshape it or give another file")
    })
}

/// Tells damaged content from trouble of the system.
pub(crate) fn unreadable(source: io::Error, path: &Path, what: &str) -> Error {
    match source.kind() {
        io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput => {
            Error::format(path, what, source, "a complete NumPy array", "it is truncated, damaged or something else")
        }
        _ => Error::read(path, source),
    }
}

fn in_c_order<T: Clone>(array: ArrayD<T>) -> ArrayD<T> {
    if array.is_standard_layout() { array } else { array.as_standard_layout().into_owned() }
}

/// The values of a file, read in pieces and converted on the way.
struct Values<'a, R> {
    source: &'a mut R,
    count: usize,
    big_endian: bool,
}

impl<R: Read> Values<'_, R> {
    /// `number` makes a value of its N little-endian bytes.
    fn read<const N: usize, T>(&mut self, number: impl Fn([u8; N]) -> T) -> io::Result<Vec<T>> {
        let mut values = Vec::with_capacity(self.count);
        let mut piece = vec![0; N << 13];
        while values.len() < self.count {
            let bytes = &mut piece[..N * (self.count - values.len()).min(1 << 13)];
            self.source.read_exact(bytes)?;
            values.extend(bytes.as_chunks::<N>().0.iter().map(|&chunk| {
                let mut chunk = chunk;
                if self.big_endian {
                    chunk.reverse();
                }
                number(chunk)
            }));
        }
        Ok(values)
    }
}

/// What stands before the values.
struct Header {
    /// Type as written, such as `<f4`.
    description: String,
    /// Type without byte order, such as `f4`.
    kind: String,
    big_endian: bool,
    fortran: bool,
    shape: Vec<usize>,
}

impl Header {
    /// The header and its length in bytes.
    fn read(source: &mut impl Read, path: &Path, what: &str) -> Result<(Self, u64)> {
        let wrong = |got: String| {
            Error::format(path, what, got, "a NumPy array (.npy)", "check that this is the file you meant")
        };
        let io = |source| unreadable(source, path, what);
        let mut start = [0; 10];
        source.read_exact(&mut start).map_err(io)?;
        if &start[..6] != MAGIC {
            return Err(wrong("something else".into()));
        }
        let mut length = usize::from(u16::from_le_bytes([start[8], start[9]]));
        let mut before = start.len();
        if start[6] > 1 {
            let mut high = [0; 2];
            source.read_exact(&mut high).map_err(io)?;
            length += usize::from(u16::from_le_bytes(high)) << 16;
            before += high.len();
        }
        if length > LONGEST_HEADER {
            return Err(wrong(format!("a header of {length} bytes")));
        }
        let mut text = vec![0; length];
        source.read_exact(&mut text).map_err(io)?;
        let text = String::from_utf8_lossy(&text);
        let header = Self::parse(&text).ok_or_else(|| wrong(format!("the header {:?}", text.trim_end())))?;
        Ok((header, (before + length) as u64))
    }

    /// Understands the Python dictionary of a plain array; structured types give `None`.
    fn parse(text: &str) -> Option<Self> {
        let value = |key: &str| Some(text.split_once(&format!("'{key}':"))?.1.trim_start());
        let description = value("descr")?.strip_prefix('\'')?.split('\'').next()?;
        let fortran = match value("fortran_order")? {
            text if text.starts_with("True") => true,
            text if text.starts_with("False") => false,
            _ => return None,
        };
        let shape = value("shape")?.strip_prefix('(')?.split_once(')')?.0.split(',').map(str::trim);
        // Python 2 wrote long integers as 3L.
        let shape =
            shape.filter(|n| !n.is_empty()).map(|n| n.trim_end_matches('L').parse().ok()).collect::<Option<_>>()?;
        Some(Self {
            description: description.into(),
            kind: description.trim_start_matches(['<', '>', '=', '|']).into(),
            big_endian: description.starts_with('>'),
            fortran,
            shape,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, Array3, Ix2, Ix3, arr0};

    /// A file's bytes as NumPy would write them.
    fn file(description: &str, fortran: &str, shape: &str, values: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{description}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
        let mut bytes = [MAGIC, &[1, 0], &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat();
        bytes.extend_from_slice(values);
        bytes
    }

    fn decoded(bytes: &[u8]) -> Result<Npy> {
        decode(bytes, bytes.len() as u64, Path::new("test.npy"), "file")
    }

    #[test]
    fn what_is_written_is_read_again_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let array =
            Array3::from_shape_fn((3, 5, 2), |(x, y, z)| (x as f32 - 1.3) * (y as f32 + 0.1) / (z as f32 + 0.7));
        // A transposed view is written in C order of its own axes.
        write(&path, array.t()).unwrap();
        assert_eq!(read_f32::<Ix3>(&path, "[z, y, x]").unwrap(), array.t());
        assert!(!read(&path).unwrap().numbers.is_double());
        let double = Array2::from_shape_fn((2, 40_000), |(i, j)| 1.0 / (i + 3 * j + 1) as f64);
        write(&path, double.view()).unwrap();
        assert_eq!(read_f64::<Ix2>(&path, "[i, j]").unwrap(), double);
        write(&path, arr0(2.5).view()).unwrap();
        assert_eq!(read(&path).unwrap().numbers, Numbers::F64(arr0(2.5).into_dyn()));
    }

    #[test]
    fn an_independent_reader_accepts_what_is_written() {
        for n in [0_usize, 1, 7, 123_456] {
            let mut bytes = Vec::new();
            encode(&mut bytes, Array2::from_elem((n, 2), 1.5_f32).view()).unwrap();
            let npy = npyz::NpyFile::new(&bytes[..]).unwrap();
            assert_eq!(npy.shape(), [n as u64, 2]);
            assert_eq!((bytes.len() - 8 * n) % 64, 0);
            assert_eq!(npy.into_vec::<f32>().unwrap(), vec![1.5; 2 * n]);
        }
    }

    #[test]
    fn every_type_order_and_byte_order_is_understood() {
        type Case = (&'static str, &'static [u8], [f64; 2], Option<f64>);
        let cases: [Case; 8] = [
            ("|u1", &[1, 255], [1.0, 255.0], Some(255.0)),
            ("|i1", &[1, 255], [1.0, -1.0], Some(127.0)),
            ("|b1", &[1, 0], [1.0, 0.0], Some(1.0)),
            ("<i2", &[2, 1, 0xFE, 0xFF], [258.0, -2.0], Some(32_767.0)),
            (">u2", &[2, 1, 0xFF, 0xFE], [513.0, 65_534.0], Some(65_535.0)),
            ("<i4", &[0, 0, 0, 1, 0xFF, 0xFF, 0xFF, 0xFF], [16_777_216.0, -1.0], Some(2_147_483_647.0)),
            (">f4", &[0x3F, 0xC0, 0, 0, 0xBF, 0x80, 0, 0], [1.5, -1.0], None),
            (">f8", &[0x3F, 0xF8, 0, 0, 0, 0, 0, 0, 0xBF, 0xF0, 0, 0, 0, 0, 0, 0], [1.5, -1.0], None),
        ];
        for (description, bytes, expected, full_scale) in cases {
            let npy = decoded(&file(description, "False", "(2,)", bytes)).unwrap();
            assert_eq!(npy.full_scale, full_scale, "{description}");
            assert_eq!(npy.numbers.into_f64().as_slice().unwrap(), expected, "{description}");
        }
        let npy = decoded(&file("|u1", "True", "(2, 3)", &[1, 2, 3, 4, 5, 6])).unwrap();
        let array = npy.numbers.into_f32();
        assert!(array.is_standard_layout());
        assert_eq!(array, ndarray::arr2(&[[1.0, 3.0, 5.0], [2.0, 4.0, 6.0]]).into_dyn());
    }

    #[test]
    fn damaged_files_are_one_clear_error_and_never_a_huge_allocation() {
        let good = file("<f4", "False", "(1, 2)", &[0; 8]);
        decoded(&good).unwrap();
        for end in 0..good.len() {
            assert!(matches!(decoded(&good[..end]), Err(Error::Format { .. })), "cut at {end}");
        }
        let cases = [
            (b"PK\x03\x04 an archive".to_vec(), "a NumPy array"),
            ([MAGIC, &[2, 0, 255, 255, 255, 255]].concat(), "a header of 4294967295 bytes"),
            (file("<f4", "False", "(1000000000, 1000000000)", &[0; 8]), "truncated or damaged"),
            (file("<f8", "False", "(4294967296, 4294967296, 0)", &[]), "more bytes than any file has"),
            (file("<f4", "False", "(-1, 2)", &[0; 8]), "the header"),
            (file("<f4", "False", "(3,)", &[0; 16]), "for shape [3]"),
            (file("<c8", "False", "(1,)", &[0; 8]), "astype"),
            (file("|O", "False", "(1,)", &[0; 8]), "astype"),
            (file("[('x", "False", "(1,)", &[0; 8]), "astype"),
        ];
        for (bytes, part) in cases {
            let message = decoded(&bytes).unwrap_err().to_string();
            assert!(message.contains(part) && message.starts_with("test.npy: file: got"), "{message}");
        }
    }

    #[test]
    fn a_wrong_number_of_axes_names_the_right_ones() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        write(&path, Array2::<f32>::zeros((4, 3)).view()).unwrap();
        let message = read_f32::<Ix3>(&path, "[x, y, z]").unwrap_err().to_string();
        assert!(message.contains("got shape [4, 3], expected axes [x, y, z]"), "{message}");
    }
}
