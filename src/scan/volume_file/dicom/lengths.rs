//! Checks that the lengths in a DICOM file are possible.
//!
//! The library that reads the file allocates as much memory as the lengths claim, so this check must interpret the file
//! exactly as the library does.

use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_core::{Tag, VR};
use dicom_object::StandardDataDictionary;
use std::borrow::Cow;

/// The bytes after the 128-byte preamble.
pub(super) const MARK: &[u8] = b"DICM";
/// The value of a length that is not given: the content has an end mark.
const UNDEFINED: u32 = u32::MAX;
const ITEM: Tag = Tag(0xFFFE, 0xE000);
const END_OF_ITEM: Tag = Tag(0xFFFE, 0xE00D);
const END_OF_SEQUENCE: Tag = Tag(0xFFFE, 0xE0DD);
const PIXELS: Tag = Tag(0x7FE0, 0x0010);
/// Largest nesting depth of sequences; real files have five.
const DEEPEST: usize = 32;

type Parsed<T> = Result<T, String>;

/// Why a file is not read.
pub(super) enum Defect {
    /// Its pixels are stored in a form that is not supported.
    Syntax(String),
    /// A length in it is impossible.
    Damage(String),
}

impl<T: Into<String>> From<T> for Defect {
    fn from(found: T) -> Self {
        Self::Damage(found.into())
    }
}

/// The file with the length of its own group, which some writers leave out and the library requires.
pub(super) fn with_group_length(content: &[u8]) -> Cow<'_, [u8]> {
    const OWN: [u8; 2] = [2, 0];
    let Some(rest) = content.get(128..).and_then(|rest| rest.strip_prefix(MARK)) else { return content.into() };
    if !rest.starts_with(&OWN) || rest.get(2..4) == Some(&[0, 0]) {
        return content.into();
    }
    let mut walk = Walk { rest, explicit: true };
    while walk.rest.starts_with(&OWN) {
        let length = walk.header().map(|(_, _, length)| length);
        if length.and_then(|length| walk.take(length)).is_err() {
            return content.into();
        }
    }
    let length = (rest.len() - walk.rest.len()) as u32;
    let element = [&OWN[..], &[0, 0], b"UL", &[4, 0], &length.to_le_bytes()].concat();
    [&content[..128], MARK, &element, rest].concat().into()
}

/// Walks through a file and returns the first defect.
pub(super) fn check(content: &[u8]) -> Result<(), Defect> {
    let rest = content.get(128..).and_then(|rest| rest.strip_prefix(MARK)).ok_or("no DICM behind 128 bytes")?;
    // The file's own group: its length, then its elements, including the transfer syntax.
    let mut walk = Walk { rest, explicit: true };
    let (tag, _, length) = walk.header()?;
    if (tag, length) != (Tag(2, 0), 4) {
        return Err(format!("{tag} of {length} bytes instead of the length of group 2").into());
    }
    let length = walk.number()?;
    let mut group = Walk { rest: walk.take(length)?, explicit: true };
    let mut syntax = Vec::new();
    while !group.rest.is_empty() {
        let (tag, _, length) = group.header()?;
        let value = group.take(length)?;
        if tag == Tag(2, 0x10) {
            syntax = value.to_vec();
        }
    }
    walk.explicit = match String::from_utf8_lossy(&syntax).trim_end_matches(['\0', ' ']) {
        "1.2.840.10008.1.2" => false,
        "1.2.840.10008.1.2.1" => true,
        "" => return Err("no transfer syntax".into()),
        other => return Err(Defect::Syntax(other.into())),
    };
    Ok(walk.elements(false, 0)?)
}

struct Walk<'a> {
    rest: &'a [u8],
    /// Whether elements state the type of their values.
    explicit: bool,
}

impl<'a> Walk<'a> {
    fn take(&mut self, count: u32) -> Parsed<&'a [u8]> {
        let (taken, rest) = self
            .rest
            .split_at_checked(count as usize)
            .ok_or_else(|| format!("an element of {count} bytes where {} are left", self.rest.len()))?;
        self.rest = rest;
        Ok(taken)
    }

    fn short(&mut self) -> Parsed<u16> {
        Ok(u16::from_le_bytes(self.take(2)?.try_into().expect("two bytes")))
    }

    fn number(&mut self) -> Parsed<u32> {
        Ok(u32::from_le_bytes(self.take(4)?.try_into().expect("four bytes")))
    }

    /// Tag, type and length of an element.
    fn header(&mut self) -> Parsed<(Tag, VR, u32)> {
        let tag = Tag(self.short()?, self.short()?);
        if tag.group() == ITEM.group() {
            return Ok((tag, VR::UN, self.number()?));
        }
        if !self.explicit {
            let known = StandardDataDictionary.by_tag(tag).map(|entry| entry.vr().relaxed());
            return Ok((tag, known.unwrap_or(VR::UN), self.number()?));
        }
        let kind = VR::from_binary(self.take(2)?.try_into().expect("two bytes")).unwrap_or(VR::UN);
        let is_long = "OB OD OF OL OV OW SQ SV UC UN UR UT UV".contains(kind.to_string());
        let length = if is_long {
            self.short()?;
            self.number()?
        } else {
            self.short()?.into()
        };
        Ok((tag, kind, length))
    }

    /// Reads elements up to the end, or up to the end of an item.
    fn elements(&mut self, in_item: bool, depth: usize) -> Parsed<()> {
        if depth > DEEPEST {
            return Err(format!("sequences within sequences, more than {DEEPEST} deep"));
        }
        while !self.rest.is_empty() {
            match self.header()? {
                (END_OF_ITEM, _, _) if in_item => return Ok(()),
                (tag, _, _) if tag.group() == ITEM.group() => return Err(format!("{tag} outside of a sequence")),
                (PIXELS, _, UNDEFINED) => return Err("packed pixels".into()),
                (_, _, UNDEFINED) => self.items(true, depth)?,
                (_, VR::SQ, length) => {
                    let rest = self.take(length)?;
                    Walk { rest, explicit: self.explicit }.items(false, depth)?;
                }
                // The library keeps the rest of a number that is cut in two, and reads it as the next element.
                (tag, kind, length) if length % size(kind) != 0 => {
                    return Err(format!("{length} bytes of {tag} with numbers of {}", size(kind)));
                }
                (_, _, length) => {
                    self.take(length)?;
                }
            }
        }
        if in_item { Err("an item without an end".into()) } else { Ok(()) }
    }

    /// Reads items up to the end, or up to the end of the sequence.
    fn items(&mut self, in_sequence: bool, depth: usize) -> Parsed<()> {
        while !self.rest.is_empty() {
            match self.header()? {
                (ITEM, _, UNDEFINED) => self.elements(true, depth + 1)?,
                (ITEM, _, length) => {
                    let rest = self.take(length)?;
                    Walk { rest, explicit: self.explicit }.elements(false, depth + 1)?;
                }
                (END_OF_SEQUENCE, _, _) if in_sequence => return Ok(()),
                (tag, _, _) => return Err(format!("{tag} where an item of a sequence should be")),
            }
        }
        if in_sequence { Err("a sequence without an end".into()) } else { Ok(()) }
    }
}

/// Bytes of a number of a type; 1 for text and bytes.
fn size(kind: VR) -> u32 {
    match kind {
        VR::OW | VR::SS | VR::US => 2,
        VR::AT | VR::FL | VR::OF | VR::OL | VR::SL | VR::UL => 4,
        VR::FD | VR::OD | VR::OV | VR::SV | VR::UV => 8,
        _ => 1,
    }
}
