//! Conversion between bytes and arrays of numbers.

use super::damaged;
use super::header::{lossy, shown};
use crate::limit;
use bzip2::read::MultiBzDecoder;
use flate2::read::{MultiGzDecoder, ZlibDecoder};
use ndarray::Array3;
use std::io::Read;
use std::path::Path;
use trgs_core::error::Error;

/// Largest expansion of a byte of deflated data.
pub(super) const MOST_INFLATION: usize = 1032;
/// Largest expansion of a byte of bzip2: a block of 900 kB of one value takes some forty bytes.
const MOST_BZIP2: usize = 1 << 15;

/// A number type and its byte order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) number: Number,
    pub(super) big_endian: bool,
}

/// A number type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Number {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

/// How numbers became the bytes of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Raw,
    Gzip,
    Zlib,
    Bzip2,
    /// Decimal numbers, separated by white space.
    Text,
}

/// Where the numbers are among the decoded bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Start {
    /// After a number of bytes.
    After(usize),
    /// At the end: whatever precedes them is skipped.
    AtEnd,
}

/// How a volume with x fastest is stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub(super) element: Element,
    pub(super) encoding: Encoding,
    /// `[x, y, z]`.
    pub(super) shape: [usize; 3],
    pub(super) start: Start,
}

/// Why bytes are not read.
pub(super) enum Defect {
    /// They are not what their header states.
    Damage(String),
    /// They need more memory than the limit.
    Memory(Error),
}

impl From<String> for Defect {
    fn from(found: String) -> Self {
        Self::Damage(found)
    }
}

impl From<&str> for Defect {
    fn from(found: &str) -> Self {
        Self::Damage(found.into())
    }
}

impl From<Error> for Defect {
    fn from(error: Error) -> Self {
        Self::Memory(error)
    }
}

impl Defect {
    /// The error about a file.
    pub(super) fn of(self, path: &Path) -> Error {
        match self {
            Self::Damage(found) => damaged(path, &found),
            Self::Memory(error) => error.in_file(path),
        }
    }
}

/// A volume `[x, y, z]` with x fastest in memory.
pub(super) struct Voxels {
    pub(super) values: Array3<f32>,
    /// Whether bytes follow the last number.
    pub(super) has_more: bool,
}

impl Number {
    /// The type with a NumPy name.
    pub(super) fn named(name: &str) -> Option<Self> {
        Some(match name {
            "uint8" => Self::U8,
            "int8" => Self::I8,
            "uint16" => Self::U16,
            "int16" => Self::I16,
            "uint32" => Self::U32,
            "int32" => Self::I32,
            "uint64" => Self::U64,
            "int64" => Self::I64,
            "float32" => Self::F32,
            "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes per number.
    pub(super) fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }
}

impl Element {
    pub(super) fn numbers(self, bytes: &[u8], means: impl Fn(f64) -> f64) -> Vec<f32> {
        macro_rules! read {
            ($kind:ty) => {{
                let (chunks, _) = bytes.as_chunks();
                let from = if self.big_endian { <$kind>::from_be_bytes } else { <$kind>::from_le_bytes };
                chunks.iter().map(|chunk| means(from(*chunk) as f64) as f32).collect()
            }};
        }
        match self.number {
            Number::U8 => read!(u8),
            Number::I8 => read!(i8),
            Number::U16 => read!(u16),
            Number::I16 => read!(i16),
            Number::U32 => read!(u32),
            Number::I32 => read!(i32),
            Number::U64 => read!(u64),
            Number::I64 => read!(i64),
            Number::F32 => read!(f32),
            Number::F64 => read!(f64),
        }
    }

    /// Bytes of an array of a shape, or an error message for an impossible shape.
    pub(super) fn size(self, shape: [usize; 3]) -> std::result::Result<usize, String> {
        let voxels = shape.iter().try_fold(1_usize, |product, &n| product.checked_mul(n));
        let size = voxels.and_then(|voxels| voxels.checked_mul(self.number.size())).filter(|&size| size > 0);
        size.ok_or_else(|| format!("shape {shape:?}"))
    }
}

impl Layout {
    /// Bytes before the numbers and bytes of them, or an error message where a file of `length` bytes cannot hold them.
    fn extent(&self, length: usize) -> std::result::Result<(usize, usize), String> {
        let (shape, size) = (self.shape, self.element.size(self.shape)?);
        let skip = if let Start::After(skip) = self.start { skip } else { 0 };
        let total = size.checked_add(skip).ok_or_else(|| format!("{skip} bytes to skip"))?;
        let (expansion, kind) = match self.encoding {
            Encoding::Raw => (1, ""),
            Encoding::Gzip | Encoding::Zlib => (MOST_INFLATION, "compressed "),
            Encoding::Bzip2 => (MOST_BZIP2, "compressed "),
            // Its numbers are counted.
            Encoding::Text => return Ok((skip, size)),
        };
        if total / expansion > length {
            return Err(format!("{length} {kind}bytes for shape {shape:?}"));
        }
        Ok((skip, size))
    }

    /// Where plain numbers begin in `length` bytes, and whether bytes follow the last one; or an error message.
    pub(super) fn plain(&self, length: usize) -> std::result::Result<(usize, bool), String> {
        let (skip, size) = self.extent(length)?;
        let start = if self.start == Start::AtEnd { length - size } else { skip };
        Ok((start, length - start > size))
    }

    /// The volume in the bytes of a file, or an error message.
    ///
    /// `means` maps a stored number to its value. Memory is bounded by what the bytes can expand to, and by the limit.
    pub(super) fn read(&self, bytes: &[u8], means: impl Fn(f64) -> f64) -> std::result::Result<Voxels, Defect> {
        let (shape, encoding) = (self.shape, self.encoding);
        let (skip, size) = self.extent(bytes.len())?;
        if encoding == Encoding::Text {
            return Ok(self.read_text(bytes.get(skip..).unwrap_or_default(), means)?);
        }
        let unpacked = if encoding == Encoding::Raw { 0 } else { skip + size };
        limit::allow(format!("volume of shape {shape:?}"), self.memory(bytes.len().saturating_add(unpacked)))?;
        // A byte more shows whether there are more.
        let limit = unpacked.saturating_add(1);
        let unpacked = match encoding {
            Encoding::Raw | Encoding::Text => None,
            // All of it, in order to know its end.
            _ if self.start == Start::AtEnd => return Err("compressed numbers at an unknown place".into()),
            Encoding::Gzip => Some(unpack(MultiGzDecoder::new(bytes), limit)?),
            Encoding::Zlib => Some(unpack(ZlibDecoder::new(bytes), limit)?),
            Encoding::Bzip2 => Some(unpack(MultiBzDecoder::new(bytes), limit)?),
        };
        let bytes = unpacked.as_deref().unwrap_or(bytes);
        let found = bytes.len().saturating_sub(skip);
        if found < size {
            let after = if skip > 0 { format!(" after the first {skip}") } else { String::new() };
            let each = self.element.number.size();
            return Err(format!("{found} bytes{after} for shape {shape:?} of {each} bytes each").into());
        }
        let (start, has_more) = Self { encoding: Encoding::Raw, ..*self }.plain(bytes.len())?;
        let values = self.element.numbers(&bytes[start..start + size], means);
        Ok(Voxels { values: with_x_fastest(values, shape), has_more })
    }

    /// Memory for the values, their copy in another order, and the bytes they are read from.
    fn memory(&self, bytes: usize) -> u64 {
        let voxels = self.shape.iter().fold(2 * size_of::<f32>() as u64, |size, &n| size.saturating_mul(n as u64));
        voxels.saturating_add(bytes as u64)
    }

    fn read_text(&self, text: &[u8], means: impl Fn(f64) -> f64) -> std::result::Result<Voxels, String> {
        let count: usize = self.shape.iter().product();
        let separates = |byte: &u8| byte.is_ascii_whitespace() || *byte == b',';
        let mut words = text.split(separates).filter(|word| !word.is_empty());
        let mut values = Vec::new();
        for word in words.by_ref().take(count) {
            let number = std::str::from_utf8(word).ok().and_then(|word| word.parse::<f64>().ok());
            let number = number.ok_or_else(|| format!("{} where a number should be", shown(&lossy(word))))?;
            values.push(means(number) as f32);
        }
        if values.len() < count {
            return Err(format!("{} numbers for shape {:?}", values.len(), self.shape));
        }
        Ok(Voxels { values: with_x_fastest(values, self.shape), has_more: words.next().is_some() })
    }
}

/// The array `[x, y, z]` of values with x fastest.
fn with_x_fastest(values: Vec<f32>, [x, y, z]: [usize; 3]) -> Array3<f32> {
    Array3::from_shape_vec((z, y, x), values).expect("the size was checked").reversed_axes()
}

/// Decompresses at most `size` bytes.
pub(super) fn unpack(packed: impl Read, size: usize) -> std::result::Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    packed.take(size as u64).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    Ok(bytes)
}
