//! The header of a `.npy` file: magic, version, length, and a Python dictionary padded to a multiple of 64 bytes.

use std::io::{self, Read};

/// What every file begins with.
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";
/// Headers of plain arrays have about 100 bytes; NumPy itself refuses more than this.
const LONGEST: usize = 10_000;
/// The values begin at a multiple of this.
const ALIGNMENT: usize = 64;

/// The dictionary of a plain array.
#[derive(Debug, PartialEq)]
pub(super) struct Header {
    /// Byte order, kind and bytes of a number: `<f4`.
    pub(super) descr: String,
    pub(super) fortran_order: bool,
    pub(super) shape: Vec<u64>,
}

impl Header {
    /// Numbers in the array; none if there are more than a file can hold.
    pub(super) fn numbers(&self) -> Option<u64> {
        // Lengths beside a 0 count, too: an array cannot have them either.
        self.shape.iter().map(|&n| n.max(1)).try_fold(1, u64::checked_mul)?;
        Some(self.shape.iter().product())
    }

    /// Parses the text of a header.
    pub(super) fn parse(text: &str) -> Result<Self, &'static str> {
        let mut text = Text(text);
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        text.expect('{')?;
        while !text.take('}') {
            let key = text.string()?;
            text.expect(':')?;
            match key {
                "descr" => descr = Some(text.string()?.to_owned()),
                "fortran_order" => fortran_order = Some(text.boolean()?),
                "shape" => shape = Some(text.integers()?),
                _ => return Err("an unknown key"),
            }
            if !text.take(',') {
                text.expect('}')?;
                break;
            }
        }
        match (descr, fortran_order, shape) {
            _ if !text.0.trim_matches(['\0', ' ', '\n']).is_empty() => Err("something after the dictionary"),
            (Some(descr), Some(fortran_order), Some(shape)) => Ok(Self { descr, fortran_order, shape }),
            _ => Err("a key is missing"),
        }
    }
}

/// The bytes before the values of an array in C order.
pub(super) fn bytes(descr: &str, shape: &[usize]) -> Vec<u8> {
    let shape: String = shape.iter().map(|n| format!("{n}, ")).collect();
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    let start = MAGIC.len() + 4;
    let length = (start + text.len() + 1).next_multiple_of(ALIGNMENT) - start;
    let size = u16::try_from(length).expect("an array has few axes").to_le_bytes();
    [MAGIC, &[1, 0], &size, format!("{text:width$}\n", width = length - 1).as_bytes()].concat()
}

/// Reads a header: the number of its bytes, and its text.
pub(super) fn read(source: &mut dyn Read) -> io::Result<(u64, String)> {
    let invalid = |what: String| Err(io::Error::new(io::ErrorKind::InvalidData, what));
    let mut start = [0; 8];
    source.read_exact(&mut start)?;
    if !start.starts_with(MAGIC) {
        return invalid("a file that does not begin like a NumPy array (.npy)".into());
    }
    // From version 2 on the length has 4 bytes.
    let mut size = match start[6..] {
        [1, 0] => vec![0; 2],
        [2 | 3, 0] => vec![0; 4],
        _ => return invalid(format!("version {}.{}", start[6], start[7])),
    };
    source.read_exact(&mut size)?;
    let length = size.iter().rfold(0, |length, &byte| length << 8 | usize::from(byte));
    if length > LONGEST {
        return invalid(format!("a header of {length} bytes"));
    }
    let mut text = vec![0; length];
    source.read_exact(&mut text)?;
    // Python 2 wrote long integers as 3L.
    text.iter_mut().filter(|byte| **byte == b'L').for_each(|byte| *byte = b' ');
    Ok(((start.len() + size.len() + length) as u64, String::from_utf8_lossy(&text).into_owned()))
}

/// What is left of a header's text.
struct Text<'a>(&'a str);

impl<'a> Text<'a> {
    /// Whether this character comes next; it is taken then.
    fn take(&mut self, character: char) -> bool {
        let rest = self.0.trim_start();
        let taken = rest.strip_prefix(character);
        self.0 = taken.unwrap_or(rest);
        taken.is_some()
    }

    fn expect(&mut self, character: char) -> Result<(), &'static str> {
        if self.take(character) { Ok(()) } else { Err("not the dictionary of a plain array") }
    }

    /// A string without escapes.
    fn string(&mut self) -> Result<&'a str, &'static str> {
        let quote = ['\'', '"'].into_iter().find(|&quote| self.take(quote)).ok_or("not that of a plain array")?;
        let (string, rest) = self.0.split_once(quote).ok_or("a string without end")?;
        self.0 = rest;
        Ok(string)
    }

    fn boolean(&mut self) -> Result<bool, &'static str> {
        let rest = self.0.trim_start();
        for (word, value) in [("True", true), ("False", false)] {
            if let Some(rest) = rest.strip_prefix(word) {
                self.0 = rest;
                return Ok(value);
            }
        }
        Err("fortran_order is neither True nor False")
    }

    /// A tuple or a list of integers that are not negative. Those beyond u64 become its largest.
    fn integers(&mut self) -> Result<Vec<u64>, &'static str> {
        let is_tuple = self.take('(');
        if !is_tuple {
            self.expect('[')?;
        }
        let end = if is_tuple { ')' } else { ']' };
        let mut integers = Vec::new();
        while !self.take(end) {
            let rest = self.0.trim_start();
            let (digits, after) = rest.split_at(rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len()));
            if digits.is_empty() {
                return Err("a length is not an integer from 0 on");
            }
            integers.push(digits.parse().unwrap_or(u64::MAX));
            self.0 = after;
            if !self.take(',') {
                // In Python, (3) is a number.
                let is_number = is_tuple && integers.len() == 1;
                self.expect(end)?;
                return if is_number { Err("shape is no tuple") } else { Ok(integers) };
            }
        }
        Ok(integers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_forms_that_numpy_writes_are_understood() {
        let header =
            |fortran_order, shape: &[u64]| Ok(Header { descr: "<f4".into(), fortran_order, shape: shape.into() });
        for (text, expected) in [
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (3, 2), }   \n", header(false, &[3, 2])),
            ("{'descr': '<f4', 'fortran_order': True, 'shape': (3,), }", header(true, &[3])),
            ("{\"shape\":[3],\"fortran_order\":True,\"descr\":\"<f4\"}\0\0", header(true, &[3])),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (), }", header(false, &[])),
        ] {
            assert_eq!(Header::parse(text), expected, "{text}");
        }
    }

    #[test]
    fn anything_else_is_refused() {
        let good = "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 2), }";
        Header::parse(good).unwrap();
        for end in 0..good.len() {
            assert!(Header::parse(&good[..end]).is_err(), "{}", &good[..end]);
        }
        for (from, to) in [
            ("'<f4'", "[('x', '<f4')]"),
            ("False", "0"),
            ("(3, 2)", "(3)"),
            ("(3, 2)", "(-3, 2)"),
            ("(3, 2)", "(3, 2]"),
            ("(3, 2)", "(3, 0x2)"),
            ("(3, 2)", "((3,), 2)"),
            ("'shape'", "'size'"),
            ("'shape': (3, 2), ", ""),
            ("}", "}}"),
        ] {
            assert!(Header::parse(&good.replace(from, to)).is_err(), "{to}");
        }
    }
}
