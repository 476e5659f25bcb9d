//! The directories of a TIFF file: one list of tags for each page.
//!
//! The library that decodes the pages allocates as much memory as their counts claim, so the counts are checked first.

/// A pair of 32-bit numbers, numerator and denominator.
const RATIONAL: u64 = 5;

type Parsed<T> = Result<T, String>;

/// The form of a file: byte order, and sizes of an offset, of the number of entries and of an entry.
#[derive(Clone, Copy, Debug)]
pub(super) struct Form {
    pub(super) big_endian: bool,
    pub(super) offset: u64,
    entries: u64,
    entry: u64,
}

/// A tag with the position of its values.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub(super) tag: u64,
    pub(super) kind: u64,
    pub(super) count: u64,
    /// Position of the entry in the file.
    pub(super) at: u64,
    /// Position of the first value.
    pub(super) values: u64,
}

/// The tags of a page.
pub(super) type Directory = Vec<Entry>;

impl Form {
    fn of(content: &[u8]) -> Parsed<Self> {
        let big_endian = content.starts_with(b"MM");
        let classic = Self { big_endian, offset: 4, entries: 2, entry: 12 };
        let is_big = classic.number(content, 2, 2)? == 43;
        Ok(if is_big { Self { offset: 8, entries: 8, entry: 20, ..classic } } else { classic })
    }

    /// A number of up to eight bytes.
    pub(super) fn number(&self, content: &[u8], at: u64, size: u64) -> Parsed<u64> {
        let bytes = slice(content, at, size).ok_or("a directory after the end of the file")?;
        let join = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        Ok(if self.big_endian { bytes.iter().fold(0, join) } else { bytes.iter().rfold(0, join) })
    }

    /// The bytes of a number of `size` bytes.
    pub(super) fn bytes(&self, number: u64, size: u64) -> Vec<u8> {
        let size = size as usize;
        if self.big_endian { number.to_be_bytes()[8 - size..].to_vec() } else { number.to_le_bytes()[..size].to_vec() }
    }

    /// The whole numbers of a tag.
    pub(super) fn numbers(&self, content: &[u8], entry: &Entry) -> Parsed<Vec<u64>> {
        let size = entry.size();
        if size == 0 {
            return Err(format!("tag {} of the unknown type {}", entry.tag, entry.kind));
        }
        (0..entry.count).map(|i| self.number(content, entry.values + i * size, size)).collect()
    }

    /// The fraction of a tag, if it holds one with a positive finite value.
    pub(super) fn fraction(&self, content: &[u8], entry: &Entry) -> Option<f64> {
        let part = |at| self.number(content, at, 4).ok().map(|number| number as f64);
        let value = (entry.kind == RATIONAL).then(|| Some(part(entry.values)? / part(entry.values + 4)?))??;
        (value > 0.0 && value.is_finite()).then_some(value)
    }
}

impl Entry {
    /// Bytes of a value; 0 for types that readers skip.
    fn size(&self) -> u64 {
        match self.kind {
            1 | 2 | 6 | 7 => 1,
            3 | 8 => 2,
            4 | 9 | 11 | 13 => 4,
            5 | 10 | 12 | 16..=18 => 8,
            _ => 0,
        }
    }

    /// The bytes of the values.
    pub(super) fn content<'a>(&self, content: &'a [u8]) -> Option<&'a [u8]> {
        slice(content, self.values, self.count * self.size())
    }
}

/// A part of the file, if it is there.
pub(super) fn slice(content: &[u8], at: u64, size: u64) -> Option<&[u8]> {
    let end = usize::try_from(at.checked_add(size)?).ok()?;
    content.get(usize::try_from(at).ok()?..end)
}

/// The directories of a file, or the first list of values that is longer than the file.
pub(super) fn read(content: &[u8]) -> Parsed<(Form, Vec<Directory>)> {
    let form = Form::of(content)?;
    let number = |at, size| form.number(content, at, size);
    let mut directories = Vec::new();
    let mut at = number(if form.offset == 8 { 8 } else { 4 }, form.offset)?;
    let mut visited = std::collections::BTreeSet::new();
    // The library reports a chain that leads back to itself.
    while at != 0 && visited.insert(at) {
        let count = number(at, form.entries)?;
        if count > content.len() as u64 / form.entry {
            return Err(format!("a directory of {count} entries"));
        }
        let mut directory = Directory::new();
        for i in 0..count {
            let at = at + form.entries + i * form.entry;
            let (tag, kind, count) = (number(at, 2)?, number(at + 2, 2)?, number(at + 4, form.offset)?);
            let mut entry = Entry { tag, kind, count, at, values: at + 4 + form.offset };
            let size = count.checked_mul(entry.size()).filter(|bytes| *bytes <= content.len() as u64);
            let size =
                size.ok_or_else(|| format!("{count} values of tag {tag} in a file of {} bytes", content.len()))?;
            if size > form.offset {
                entry.values = number(entry.values, form.offset)?;
            }
            directory.push(entry);
        }
        directories.push(directory);
        at = number(at + form.entries + count * form.entry, form.offset)?;
    }
    Ok((form, directories))
}
