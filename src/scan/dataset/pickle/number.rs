//! Number types of NumPy's arrays.

use super::Parsed;

/// A NumPy number type.
#[derive(Clone, Copy)]
pub(super) struct Number {
    kind: u8,
    pub(super) size: usize,
    pub(super) big_endian: bool,
}

impl Number {
    /// Parses a name such as `f4`, `<i8`, `|u1`.
    pub(super) fn parse(name: &str) -> Parsed<Self> {
        let (big_endian, name) = match name.as_bytes().first() {
            Some(b'<' | b'|' | b'=') => (false, &name[1..]),
            Some(b'>') => (true, &name[1..]),
            _ => (false, name),
        };
        let known = ["f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1"];
        match known.contains(&name) {
            true => Ok(Self { kind: name.as_bytes()[0], size: usize::from(name.as_bytes()[1] - b'0'), big_endian }),
            false => Err(format!("an array of {name}")),
        }
    }

    /// The number stored in `bytes`.
    pub(super) fn read(self, bytes: &[u8]) -> f64 {
        let mut word = [0_u8; 8];
        for (i, &byte) in bytes.iter().enumerate() {
            word[if self.big_endian { self.size - 1 - i } else { i }] = byte;
        }
        let bits = u64::from_le_bytes(word);
        let unused = 64 - 8 * self.size as u32;
        match (self.kind, self.size) {
            (b'f', 4) => f64::from(f32::from_bits(bits as u32)),
            (b'f', _) => f64::from_bits(bits),
            (b'i', _) => ((bits << unused).cast_signed() >> unused) as f64,
            _ => bits as f64,
        }
    }
}
