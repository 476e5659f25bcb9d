//! Conversion between bytes and arrays of numbers.

use flate2::read::{MultiGzDecoder, ZlibDecoder};
use ndarray::Array3;
use std::io::Read;

/// Largest expansion of a byte of deflated data.
const MOST_INFLATION: usize = 1032;

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

/// Compression of the bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Raw,
    Gzip,
    Zlib,
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
    fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }
}

impl Element {
    fn numbers(self, bytes: &[u8], means: impl Fn(f64) -> f64) -> Vec<f32> {
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

    /// A volume `[x, y, z]` from bytes with x fastest; the memory order is kept.
    ///
    /// `means` maps a stored number to its value. Memory is bounded by what the bytes can expand to.
    pub(super) fn volume(
        self,
        bytes: &[u8],
        encoding: Encoding,
        shape: [usize; 3],
        means: impl Fn(f64) -> f64,
    ) -> std::result::Result<Array3<f32>, String> {
        let size = self.size(shape)?;
        let unpacked;
        let bytes = match encoding {
            Encoding::Raw => bytes,
            _ if size / MOST_INFLATION > bytes.len() => {
                return Err(format!("{} compressed bytes for shape {shape:?}", bytes.len()));
            }
            Encoding::Gzip => {
                unpacked = unpack(MultiGzDecoder::new(bytes), size)?;
                &unpacked
            }
            Encoding::Zlib => {
                unpacked = unpack(ZlibDecoder::new(bytes), size)?;
                &unpacked
            }
        };
        if bytes.len() < size {
            return Err(format!("{} bytes for shape {shape:?} of {} bytes each", bytes.len(), self.number.size()));
        }
        let [x, y, z] = shape;
        let values = self.numbers(&bytes[..size], means);
        Ok(Array3::from_shape_vec((z, y, x), values).expect("the size was checked").reversed_axes())
    }
}

/// Decompresses at most `size` bytes.
pub(super) fn unpack(packed: impl Read, size: usize) -> std::result::Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    packed.take(size as u64).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// The bytes of a volume `[x, y, z]` with x fastest, f32, little-endian.
pub(super) fn x_fastest(values: &Array3<f32>) -> Vec<u8> {
    values.t().iter().flat_map(|value| value.to_le_bytes()).collect()
}
