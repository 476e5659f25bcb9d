//! Checks that the counts in a TIFF file are possible.
//!
//! The library that reads the file allocates as much memory as the counts claim.

/// Bytes of a value of each type; readers skip other types.
const SIZES: [(u64, u64); 16] = [
    (1, 1),
    (2, 1),
    (3, 2),
    (4, 4),
    (5, 8),
    (6, 1),
    (7, 1),
    (8, 2),
    (9, 4),
    (10, 8),
    (11, 4),
    (12, 8),
    (13, 4),
    (16, 8),
    (17, 8),
    (18, 8),
];

type Parsed<T> = Result<T, String>;

/// Walks along the directories of a file and returns the first list of values longer than the file.
pub(super) fn check(content: &[u8]) -> Parsed<()> {
    let big_endian = content.starts_with(b"MM");
    let number = |at: u64, size: u64| -> Parsed<u64> {
        let bytes =
            at.checked_add(size).and_then(|end| content.get(usize::try_from(at).ok()?..usize::try_from(end).ok()?));
        let bytes = bytes.ok_or("a directory after the end of the file")?;
        let join = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        Ok(if big_endian { bytes.iter().fold(0, join) } else { bytes.iter().rfold(0, join) })
    };
    // Sizes of an offset, of the number of entries and of an entry.
    let (offset, entries, entry) = if number(2, 2)? == 43 { (8, 8, 20) } else { (4, 2, 12) };
    let mut directory = number(if offset == 8 { 8 } else { 4 }, offset)?;
    // A cyclic chain is left to the library, which detects it.
    for _ in 0..content.len() {
        if directory == 0 {
            break;
        }
        let count = number(directory, entries)?;
        if count > content.len() as u64 / entry {
            return Err(format!("a directory of {count} entries"));
        }
        for i in 0..count {
            let at = directory + entries + i * entry;
            let (tag, kind, values) = (number(at, 2)?, number(at + 2, 2)?, number(at + 4, offset)?);
            let size = SIZES.iter().find(|(known, _)| *known == kind).map_or(0, |(_, size)| *size);
            if values.checked_mul(size).is_none_or(|bytes| bytes > content.len() as u64) {
                return Err(format!("{values} values of tag {tag} in a file of {} bytes", content.len()));
            }
        }
        directory = number(directory + entries + count * entry, offset)?;
    }
    Ok(())
}
