//! NumPy's `.npy` files: one array of numbers, header and values.
//!
//! Only arrays that occur here are understood: little- or big-endian floats, integers and booleans, in C or Fortran order.
//! Sizes are checked against the length of the file before memory is asked for, so a damaged header cannot ask for more than
//! the file holds.

mod header;

use crate::error::{Error, Result};
use crate::output::write_atomically;
use header::Header;
use ndarray::{Array, ArrayD, ArrayView, Dimension, IxDyn, ShapeBuilder};
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;

/// Numbers that are read or written at once.
const BLOCK: usize = 8192;

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
    decode(file, length, path, "file")
}

/// Reads the content of a file; `path` names it in errors.
///
/// # Errors
/// [`Error::Format`] for anything but a complete array of numbers.
pub fn parse(content: &[u8], path: &Path) -> Result<Npy> {
    decode(content, content.len() as u64, path, "file")
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
    /// NumPy's name of the type, little-endian on every machine.
    const DESCRIPTION: &'static str;

    /// Appends its bytes, the lowest first.
    fn append_to(self, bytes: &mut Vec<u8>);
}

impl Element for f32 {
    const DESCRIPTION: &'static str = "<f4";

    fn append_to(self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.to_le_bytes());
    }
}

impl Element for f64 {
    const DESCRIPTION: &'static str = "<f8";

    fn append_to(self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.to_le_bytes());
    }
}

/// Writes header and values.
pub(crate) fn encode<T: Element, D: Dimension>(mut file: impl Write, array: ArrayView<'_, T, D>) -> io::Result<()> {
    let mut block = header::bytes(T::DESCRIPTION, array.shape());
    for (i, value) in array.iter().enumerate() {
        if i.is_multiple_of(BLOCK) {
            file.write_all(&block)?;
            block.clear();
        }
        value.append_to(&mut block);
    }
    file.write_all(&block)
}

/// Reads `length` bytes of header and values; `what` and `path` name the source in errors.
pub(crate) fn decode(source: impl Read, length: u64, path: &Path, what: &str) -> Result<Npy> {
    let mut source = BufReader::new(source);
    decode_dyn(&mut source, length, path, what)
}

/// [`decode`], compiled once for all sources.
fn decode_dyn(source: &mut dyn Read, length: u64, path: &Path, what: &str) -> Result<Npy> {
    let (start, text) = header::read(source).map_err(|source| unreadable(source, path, what))?;
    let text = text.trim_matches(['\0', ' ', '\n']);
    let wrong = |reason: &str| {
        let expected = "a NumPy array (.npy) of floats of 2, 4 or 8 bytes, integers or booleans";
        let remedy = "check that this is the file you meant, or convert it with numpy's astype";
        Error::format(path, what, format!("the header {text:?} ({reason})"), expected, remedy)
    };
    let incomplete = |expected: String| {
        let remedy = "it is truncated or damaged: copy or make it again";
        Error::format(path, what, format!("{length} bytes"), expected, remedy)
    };
    let header = Header::parse(text).map_err(wrong)?;
    let Some(count) = header.numbers() else {
        return Err(incomplete(format!("more bytes than any file has for the header {text:?}")));
    };
    let other = || wrong(&format!("values of type '{}'", header.descr));
    let (order, kind) = header.descr.split_at_checked(1).ok_or_else(other)?;
    let item = match (order, kind) {
        ("<" | ">" | "|", "b1" | "u1" | "i1") => 1,
        ("<" | ">", "f2" | "u2" | "i2") => 2,
        ("<" | ">", "f4" | "u4" | "i4") => 4,
        ("<" | ">", "f8" | "u8" | "i8") => 8,
        _ => return Err(other()),
    };
    let bytes = count.checked_mul(item).and_then(|bytes| bytes.checked_add(start));
    if bytes != Some(length) {
        let size = bytes.map_or_else(|| "more bytes than any file has".into(), |bytes| format!("{bytes} bytes"));
        return Err(incomplete(format!("{size} for shape {:?} of '{}'", header.shape, header.descr)));
    }
    macro_rules! numbers {
        ($stored:ty, $variant:path, $number:expr) => {
            match order {
                ">" => values(&header, source, |bytes| $number(<$stored>::from_be_bytes(bytes))).map($variant),
                _ => values(&header, source, |bytes| $number(<$stored>::from_le_bytes(bytes))).map($variant),
            }
        };
    }
    let (numbers, full_scale) = match kind {
        "f2" => (numbers!(u16, Numbers::F32, from_half), None),
        "f4" => (numbers!(f32, Numbers::F32, |v| v), None),
        "f8" => (numbers!(f64, Numbers::F64, |v| v), None),
        "b1" => (numbers!(u8, Numbers::F32, f32::from).and_then(only_booleans), Some(1.0)),
        "u1" => (numbers!(u8, Numbers::F32, f32::from), Some(f64::from(u8::MAX))),
        "i1" => (numbers!(i8, Numbers::F32, f32::from), Some(f64::from(i8::MAX))),
        "u2" => (numbers!(u16, Numbers::F32, f32::from), Some(f64::from(u16::MAX))),
        "i2" => (numbers!(i16, Numbers::F32, f32::from), Some(f64::from(i16::MAX))),
        "u4" => (numbers!(u32, Numbers::F64, f64::from), Some(f64::from(u32::MAX))),
        "i4" => (numbers!(i32, Numbers::F64, f64::from), Some(f64::from(i32::MAX))),
        "u8" => (numbers!(u64, Numbers::F64, |v| v as f64), Some(u64::MAX as f64)),
        _ => (numbers!(i64, Numbers::F64, |v| v as f64), Some(i64::MAX as f64)),
    };
    Ok(Npy { numbers: numbers.map_err(|source| unreadable(source, path, what))?, full_scale })
}

/// All values in C order, each made of its bytes by `number`.
fn values<const N: usize, T: Clone>(
    header: &Header,
    source: &mut dyn Read,
    number: impl Fn([u8; N]) -> T,
) -> io::Result<ArrayD<T>> {
    let shape: Vec<usize> = header.shape.iter().map(|&n| n as usize).collect();
    let count = shape.iter().product();
    let mut values = Vec::with_capacity(count);
    let mut block = vec![0; BLOCK * N];
    while values.len() < count {
        let bytes = &mut block[..(count - values.len()).min(BLOCK) * N];
        source.read_exact(bytes)?;
        values.extend(bytes.as_chunks().0.iter().map(|bytes| number(*bytes)));
    }
    let array = ArrayD::from_shape_vec(IxDyn(&shape).set_f(header.fortran_order), values)
        .map_err(|error| invalid(format!("shape {shape:?}: {error}")))?;
    Ok(if array.is_standard_layout() { array } else { array.as_standard_layout().into_owned() })
}

/// Refuses booleans that are neither 0 nor 1.
fn only_booleans(numbers: Numbers) -> io::Result<Numbers> {
    match &numbers {
        Numbers::F32(values) if values.iter().any(|&value| value > 1.0) => {
            Err(invalid("a boolean that is neither 0 nor 1".into()))
        }
        _ => Ok(numbers),
    }
}

fn invalid(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

/// A number in half precision, exactly.
fn from_half(bits: u16) -> f32 {
    let (sign, exponent, fraction) = (u32::from(bits & 0x8000) << 16, bits >> 10 & 0x1F, u32::from(bits & 0x3FF));
    let magnitude = match exponent {
        // Subnormal numbers are multiples of 2⁻²⁴.
        0 => (fraction as f32 / 16_777_216.0).to_bits(),
        0x1F => 0x7F80_0000 | fraction << 13,
        _ => (u32::from(exponent) + 112) << 23 | fraction << 13,
    };
    f32::from_bits(sign | magnitude)
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

#[cfg(test)]
mod tests {
    use super::header::MAGIC;
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
    fn half_precision_is_read_as_the_hardware_type() {
        for bits in 0..=u16::MAX {
            let (ours, expected) = (from_half(bits), half::f16::from_bits(bits).to_f32());
            assert!(ours.to_bits() == expected.to_bits() || ours.is_nan() && expected.is_nan(), "{bits:x}");
        }
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
