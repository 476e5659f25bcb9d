//! Floats of 16 bits, which the crate hdf5-reader leaves to its callers.

use hdf5_reader::error::{ByteOrder, Error, Result};
use hdf5_reader::{Datatype, H5Type};

/// A float that the file holds in 16 bits.
#[derive(Clone, Copy)]
pub(super) struct Half(pub(super) f32);

impl H5Type for Half {
    fn hdf5_type() -> Datatype {
        Datatype::FloatingPoint { size: 2, byte_order: ByteOrder::LittleEndian }
    }

    fn from_bytes(bytes: &[u8], dtype: &Datatype) -> Result<Self> {
        let (Datatype::FloatingPoint { size: 2, byte_order }, &[a, b]) = (dtype, bytes) else {
            return Err(Error::InvalidData(format!("expected a float of 2 bytes, got {} bytes", bytes.len())));
        };
        let value = match byte_order {
            ByteOrder::LittleEndian => ::half::f16::from_le_bytes([a, b]),
            ByteOrder::BigEndian => ::half::f16::from_be_bytes([a, b]),
        };
        Ok(Self(value.to_f32()))
    }

    fn element_size(_: &Datatype) -> usize {
        2
    }
}
