//! NumPy's `.npy` files: one array of numbers, header and values.
//!
//! The crate npyz parses the format; here its numbers become arrays. Supported are little- or big-endian floats,
//! integers and booleans, in C or Fortran order. Sizes are checked against the length of the file before memory is
//! allocated, so a damaged header cannot request more than the file holds.

use crate::output::write_atomically;
use crate::{input, limit};
use ndarray::{Array, ArrayD, ArrayView, Dimension, IxDyn, Shape, ShapeBuilder, ShapeError};
use npyz::{DType, Deserialize, NpyHeader, NpyWriter, Order, TypeRead, WriteOptions, WriterBuilder};
use std::io::{self, BufReader, Read, Write};
use std::path::Path;
use trgs_core::error::{Error, Result};

/// First bytes of every file.
const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header accepted. Headers of plain arrays have about 100 bytes; NumPy rejects longer ones.
const LONGEST_HEADER: usize = 10_000;
/// The types that are read.
const KINDS: [&str; 12] = ["f2", "f4", "f8", "b1", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8"];
/// Numbers read at once, of at most 8 bytes each.
const BLOCK: usize = 4096;

/// The values of an array.
///
/// Integers of up to 16 bits are read as f32, longer ones as f64 (exact up to 2⁵³).
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
    /// The largest value of the stored type if that is an integer type: 255 for bytes.
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

    /// The values in single precision, rounded to nearest.
    pub fn into_f32(self) -> ArrayD<f32> {
        match self {
            Self::F32(values) => values,
            Self::F64(values) => values.mapv(|value| value as f32),
        }
    }

    /// The values in double precision, exact.
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
/// [`Error::Read`], or [`Error::Format`] for anything but a complete array of numbers.
pub fn read(path: impl AsRef<Path>) -> Result<Npy> {
    let path = path.as_ref();
    let file = input::open(path).map_err(|source| Error::read(path, source))?;
    let length = file.metadata().map_err(|source| Error::read(path, source))?.len();
    decode(file, length, path, "file")
}

/// Reads the content of a file; `path` names it in errors.
///
/// # Errors
/// [`Error::Format`] for anything but a complete array of numbers.
pub fn parse(content: &[u8], path: &Path) -> Result<Npy> {
    decode(content, content.len() as u64, path, "file")
}

/// Reads a single-precision array with as many axes as `D`; `axes` names them in errors: `[x, y, z]`.
///
/// # Errors
/// Those of [`read`], and [`Error::Format`] for another number of axes.
pub fn read_f32<D: Dimension>(path: impl AsRef<Path>, axes: &str) -> Result<Array<f32, D>> {
    let path = path.as_ref();
    with_axes(read(path)?.numbers.into_f32(), path, "array", axes)
}

/// Reads a double-precision array with as many axes as `D`; `axes` names them in errors.
///
/// # Errors
/// Those of [`read`], and [`Error::Format`] for another number of axes.
pub fn read_f64<D: Dimension>(path: impl AsRef<Path>, axes: &str) -> Result<Array<f64, D>> {
    let path = path.as_ref();
    with_axes(read(path)?.numbers.into_f64(), path, "array", axes)
}

/// NumPy's name of the type of a file's numbers, `<f4` for example; `None` for a file that cannot be read.
pub(super) fn type_of(path: &Path) -> Option<String> {
    let header = header_bytes(&mut BufReader::new(input::open(path).ok()?)).ok()?;
    match NpyHeader::from_reader(&header[..]).ok()?.dtype() {
        DType::Plain(kind) => Some(kind.to_string()),
        _ => None,
    }
}

/// Writes an array in C order, atomically.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system.
pub fn write<T: Element, D: Dimension>(path: impl AsRef<Path>, array: ArrayView<'_, T, D>) -> Result<()> {
    let path = path.as_ref();
    write_atomically(path, |file| encode(file, array))
}

/// Writes an array in C order, atomically, from what `parts` gives to its argument one after the other.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system, or for another number of values than the shape has.
pub fn write_parts<T: Element>(
    path: impl AsRef<Path>,
    shape: &[usize],
    parts: impl FnOnce(&mut dyn FnMut(&[T]) -> io::Result<()>) -> io::Result<()>,
) -> Result<()> {
    write_atomically(path.as_ref(), |file| {
        let mut writer = begun(file, shape)?;
        parts(&mut |values| writer.extend(values.iter().copied()))?;
        writer.finish()
    })
}

/// A number type that can be written: f32 or f64.
pub trait Element: npyz::Serialize + Copy {
    /// NumPy's name of the type, little-endian on every machine.
    const DESCRIPTION: &'static str;
}

impl Element for f32 {
    const DESCRIPTION: &'static str = "<f4";
}

impl Element for f64 {
    const DESCRIPTION: &'static str = "<f8";
}

/// Writes header and values to a stream.
///
/// # Errors
/// That of the stream.
pub fn encode<T: Element, D: Dimension>(file: impl Write, array: ArrayView<'_, T, D>) -> io::Result<()> {
    let mut writer = begun(file, array.shape())?;
    writer.extend(array.iter().copied())?;
    writer.finish()
}

/// The writer of an array's values, with its header written.
fn begun<T: Element, W: Write>(file: W, shape: &[usize]) -> io::Result<NpyWriter<T, W>> {
    let shape: Vec<u64> = shape.iter().map(|&n| n as u64).collect();
    let description = DType::Plain(T::DESCRIPTION.parse().map_err(io::Error::other)?);
    WriteOptions::new().dtype(description).shape(&shape).writer(file).begin_nd()
}

/// Reads `length` bytes of header and values; `what` and `path` name the source in errors.
pub(crate) fn decode(source: impl Read, length: u64, path: &Path, what: &str) -> Result<Npy> {
    let mut source = BufReader::new(source);
    let stream = Stream::begin(&mut source, length, path, what)?;
    // As f32 or f64, and once more where another order is stored.
    let (copies, bytes) = (if stream.is_fortran() { 2 } else { 1 }, stream.item);
    let size = stream.header.len().saturating_mul(copies * if bytes > 2 && bytes != 4 { 8 } else { 4 });
    let shape = stream.shape();
    limit::allow(format!("{what} of shape {shape:?}"), size).map_err(|error| error.in_file(path))?;
    let read = stream.values(source, stream.header.len() as usize);
    let (numbers, full_scale) = read.map_err(|source| unreadable(source, path, what))?;
    let layout = IxDyn(&shape).set_f(stream.is_fortran());
    let numbers = match numbers {
        Numbers::F32(values) => in_c_order(values, layout).map(Numbers::F32),
        Numbers::F64(values) => in_c_order(values, layout).map(Numbers::F64),
    };
    let numbers = numbers.map_err(|error| unreadable(invalid(format!("shape {shape:?}: {error}")), path, what))?;
    Ok(Npy { numbers, full_scale })
}

/// Values in a row as an array in C order.
fn in_c_order<T: Clone>(values: ArrayD<T>, layout: Shape<IxDyn>) -> std::result::Result<ArrayD<T>, ShapeError> {
    let array = ArrayD::from_shape_vec(layout, values.into_raw_vec_and_offset().0)?;
    Ok(if array.is_standard_layout() { array } else { array.as_standard_layout().into_owned() })
}

fn invalid(error: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, error)
}

/// An array whose values are still to be read.
pub(crate) struct Stream {
    header: NpyHeader,
    /// Position of the first number.
    pub(crate) start: u64,
    /// Bytes of a number.
    pub(crate) item: usize,
    kind: String,
}

impl Stream {
    /// Reads the header of a source of `length` bytes, and checks that these are its header and values.
    pub(crate) fn begin(source: &mut impl Read, length: u64, path: &Path, what: &str) -> Result<Self> {
        let header = header_bytes(source).map_err(|source| unreadable(source, path, what))?;
        let text = String::from_utf8_lossy(&header[10..]);
        let text = text.trim_matches(['\0', ' ', '\n']);
        let wrong = |reason: &str| {
            let expected = "a NumPy array (.npy) of floats of 2, 4 or 8 bytes, integers or booleans";
            let remedy = "give a file of this kind, or convert the array with numpy's astype";
            Error::format(path, what, format!("the header {text:?} ({reason})"), expected, remedy)
        };
        let incomplete = |expected: String| {
            let remedy = "the file is truncated or damaged: copy or write it again";
            Error::format(path, what, format!("{length} bytes"), expected, remedy)
        };
        // npyz recurses as deeply as the header nests brackets, evaluates sums, and multiplies the shape unchecked.
        if text.matches(['(', '[', '{']).count() > 2 || text.contains(['+', '-']) {
            return Err(wrong("not that of a plain array"));
        }
        let numbers = text
            .split(['(', '[', ',', ']', ')'])
            .map(str::trim)
            .filter(|n| n.starts_with(|c: char| c.is_ascii_digit()));
        if numbers.map(|n| n.parse().unwrap_or(u64::MAX).max(1)).try_fold(1, u64::checked_mul).is_none() {
            return Err(incomplete(format!("more bytes than any file has for the header {text:?}")));
        }

        let npy = NpyHeader::from_reader(&header[..]);
        let npy = npy.map_err(|error| wrong(error.to_string().lines().next().unwrap_or_default()))?;
        let other = |dtype: DType| wrong(&format!("values of type {}", dtype.descr()));
        let (DType::Plain(kind), Some(item)) = (npy.dtype(), npy.dtype().num_bytes()) else {
            return Err(other(npy.dtype()));
        };
        let bytes = npy.len().checked_mul(item as u64).and_then(|bytes| bytes.checked_add(header.len() as u64));
        if bytes != Some(length) {
            let size = bytes.map_or_else(|| "more bytes than any file has".into(), |bytes| format!("{bytes} bytes"));
            return Err(incomplete(format!("{size} for shape {:?} of '{kind}'", npy.shape())));
        }
        let kind = kind.to_string()[1..].to_owned();
        if !KINDS.contains(&kind.as_str()) {
            return Err(other(npy.dtype()));
        }
        Ok(Self { header: npy, start: header.len() as u64, item, kind })
    }

    /// Lengths of the axes.
    pub(crate) fn shape(&self) -> Vec<usize> {
        self.header.shape().iter().map(|&n| n as usize).collect()
    }

    /// Whether the first axis is fastest.
    pub(crate) fn is_fortran(&self) -> bool {
        self.header.order() == Order::Fortran
    }

    /// The next `count` values, and the largest one of their type if that is an integer type.
    pub(crate) fn values(&self, source: impl Read, count: usize) -> io::Result<(Numbers, Option<f64>)> {
        let npy = &self.header;
        let (numbers, full_scale) = match self.kind.as_str() {
            "f2" => (values(npy, source, count, |v: half::f16| f32::from(v)).map(Numbers::F32), None),
            "f4" => (values(npy, source, count, |v: f32| v).map(Numbers::F32), None),
            "f8" => (values(npy, source, count, |v: f64| v).map(Numbers::F64), None),
            "b1" => (values(npy, source, count, |v: bool| f32::from(v)).map(Numbers::F32), Some(1.0)),
            "u1" => (values(npy, source, count, |v: u8| f32::from(v)).map(Numbers::F32), Some(f64::from(u8::MAX))),
            "i1" => (values(npy, source, count, |v: i8| f32::from(v)).map(Numbers::F32), Some(f64::from(i8::MAX))),
            "u2" => (values(npy, source, count, |v: u16| f32::from(v)).map(Numbers::F32), Some(f64::from(u16::MAX))),
            "i2" => (values(npy, source, count, |v: i16| f32::from(v)).map(Numbers::F32), Some(f64::from(i16::MAX))),
            "u4" => (values(npy, source, count, |v: u32| f64::from(v)).map(Numbers::F64), Some(f64::from(u32::MAX))),
            "i4" => (values(npy, source, count, |v: i32| f64::from(v)).map(Numbers::F64), Some(f64::from(i32::MAX))),
            "u8" => (values(npy, source, count, |v: u64| v as f64).map(Numbers::F64), Some(u64::MAX as f64)),
            "i8" => (values(npy, source, count, |v: i64| v as f64).map(Numbers::F64), Some(i64::MAX as f64)),
            other => unreachable!("{other} was refused"),
        };
        Ok((numbers?, full_scale))
    }
}

/// Magic, version, length and text, as stored in the file.
fn header_bytes(source: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut header = vec![0; 10];
    source.read_exact(&mut header)?;
    if !header.starts_with(MAGIC) {
        return Err(invalid("a file that does not begin like a NumPy array (.npy)".into()));
    }
    // From version 2 on, the length has 4 bytes.
    let start = if header[6] > 1 { 12 } else { 10 };
    header.resize(start, 0);
    source.read_exact(&mut header[10..])?;
    let length = header[8..].iter().rfold(0, |length, &byte| length << 8 | usize::from(byte));
    if length > LONGEST_HEADER {
        return Err(invalid(format!("a header of {length} bytes")));
    }
    header.resize(start + length, 0);
    source.read_exact(&mut header[start..])?;
    // Python 2 wrote long integers as 3L.
    header[start..].iter_mut().filter(|byte| **byte == b'L').for_each(|byte| *byte = b' ');
    Ok(header)
}

/// The next values, each converted by `number`. Bytes are read in blocks: a call for each number costs more than the
/// number.
fn values<S: Deserialize, T: Clone>(
    header: &NpyHeader,
    mut source: impl Read,
    length: usize,
    number: impl Fn(S) -> T,
) -> io::Result<ArrayD<T>> {
    let reader = S::reader(&header.dtype()).map_err(|error| invalid(error.to_string()))?;
    let mut values = Vec::new();
    values.try_reserve_exact(length)?;
    let mut block = [0; 8 * BLOCK];
    while values.len() < length {
        let bytes = &mut block[..size_of::<S>() * BLOCK.min(length - values.len())];
        source.read_exact(bytes)?;
        let mut bytes = &bytes[..];
        while !bytes.is_empty() {
            values.push(number(reader.read_one(&mut bytes)?));
        }
    }
    Ok(Array::from_vec(values).into_dyn())
}

/// Converts to a fixed number of axes, or returns an error that names the expected axes.
pub(crate) fn with_axes<T, D: Dimension>(array: ArrayD<T>, path: &Path, what: &str, axes: &str) -> Result<Array<T, D>> {
    let shape = array.shape().to_vec();
    array.into_dimensionality().map_err(|_| {
        Error::format(
            path,
            what,
            format!("shape {shape:?}"),
            format!("axes {axes}"),
            "reshape the array, or give a file with these axes",
        )
    })
}

/// Distinguishes damaged content from an error of the operating system.
pub(crate) fn unreadable(source: io::Error, path: &Path, what: &str) -> Error {
    match source.kind() {
        io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput => Error::format(
            path,
            what,
            source,
            "a complete NumPy array",
            "the file is truncated, damaged or of another kind: copy or write it again",
        ),
        _ => Error::read(path, source),
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
    fn numpys_own_bytes_are_read_and_the_same_array_is_written_in_one_fixed_form() {
        let array = Array2::from_shape_fn((3, 2), |(i, j)| (2 * i + j) as f32 - 1.5);
        // `numpy.save` leaves out the last comma; for the rest the forms are the same.
        let bytes = |shape: &str| {
            let text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
            let mut bytes = [b"\x93NUMPY\x01\x00\x76\x00", format!("{text:117}\n").as_bytes()].concat();
            array.iter().for_each(|value: &f32| bytes.extend(value.to_le_bytes()));
            bytes
        };
        assert_eq!(decoded(&bytes("(3, 2)")).unwrap().numbers, Numbers::F32(array.clone().into_dyn()));
        let mut written = Vec::new();
        encode(&mut written, array.view()).unwrap();
        assert_eq!(written, bytes("(3, 2, )"));
        for n in [0_usize, 1, 7, 123_456] {
            let mut bytes = Vec::new();
            encode(&mut bytes, Array2::from_elem((n, 2), 1.5_f32).view()).unwrap();
            assert_eq!((bytes.len() - 8 * n) % 64, 0);
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
    fn headers_that_a_parser_could_trip_over_are_errors_or_harmless() {
        let nested = ["(".repeat(4000), "[".repeat(4000), "{1:".repeat(3000), "((((1,),),),)".into()];
        let sums =
            ["(4294967295+4294967295, 4294967295)", "(--5,)", "(0xffffffffffff, 0xffffffffffff)", "(1_0, 2, 0.5)"];
        for shape in nested.iter().map(String::as_str).chain(sums) {
            assert!(matches!(decoded(&file("<f4", "False", shape, &[0; 8])), Err(Error::Format { .. })), "{shape}");
        }
        assert_eq!(decoded(&file("<f4", "False", "(2L, 1L)", &[0; 8])).unwrap().numbers.shape(), [2, 1]);
        let ones = format!("({})", "1, ".repeat(32));
        assert_eq!(decoded(&file("<f8", "False", &ones, &[0; 8])).unwrap().numbers.shape(), [1; 32]);
        assert!(matches!(decoded(&file("|b1", "False", "(1,)", &[7])), Err(Error::Format { .. })));
        assert!(matches!(decoded(&file("<f4", "False", "(18446744073709551615, 0)", &[])), Err(Error::Format { .. })));
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
