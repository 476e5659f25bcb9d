//! Checkpoint files: a header with magic, format, kind and a SHA-256 digest over the rest, then MessagePack.
//!
//! | bytes | content |
//! |---|---|
//! | 0–7 | `trgs-ck` and a line feed |
//! | 8–11 | format, little-endian |
//! | 12–15 | kind, little-endian: 1 primitives, 2 voxels and networks |
//! | 16–47 | SHA-256 of format, kind and content |
//! | 48– | content |
//!
//! [`open`] is the only function that reads such a file. The digest finds damage. It does not protect against a changed
//! file with a right digest, so each kind also checks the lengths and the ranges of what it reads.

use crate::error::{Error, Result, start_again};
use crate::limit;
use crate::output::{create_folder, write_atomically};
use crate::setting::Text;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

const MAGIC: &[u8; 8] = b"trgs-ck\n";
/// Changes with the meaning of the content.
const FORMAT: u32 = 3;
/// Bytes before the content, and before the digest.
const HEADER: usize = 48;
const BEFORE_DIGEST: usize = 16;
/// MessagePack's map without entries.
const EMPTY_MAP: u8 = 0x80;

/// What a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// The state of a method that fits primitives.
    Primitives = 1,
    /// The state of a method on voxels or of a network.
    Voxels = 2,
}

/// A file whose digest is that of its content.
#[derive(Debug)]
pub(crate) struct Sealed {
    pub(crate) kind: Kind,
    bytes: Vec<u8>,
}

impl Sealed {
    /// Decodes the content.
    ///
    /// # Errors
    /// [`Error::Format`] for content of another form.
    pub(crate) fn decode<'a, T: Deserialize<'a>>(&'a self, path: &Path) -> Result<T> {
        rmp_serde::from_slice(&self.bytes[HEADER..])
            .map_err(|error| Error::format(path, "content", error, "a checkpoint of trgs", start_again()))
    }
}

/// Reads a file and compares its digest.
///
/// # Errors
/// [`Error::Read`], or [`Error::Format`] for a file of another kind or format, and for a damaged one.
pub(crate) fn open(path: &Path) -> Result<Sealed> {
    let failed = |source| Error::read(path, source);
    if !std::fs::metadata(path).map_err(failed)?.is_file() {
        return Err(Error::format(path, "checkpoint", "a folder or a special file", "a file", start_again()));
    }
    let content = std::fs::File::open(path).and_then(limit::read_to_end);
    unseal(content.map_err(failed)?, path)
}

fn unseal(bytes: Vec<u8>, path: &Path) -> Result<Sealed> {
    let refused = |what: &str, got: &str, expected: &str, remedy: &str| {
        Err(Error::format(path, what, got, expected, Text::from(remedy) + start_again()))
    };
    let format = FORMAT.to_string();
    // Formats 1 and 2 were a MessagePack array that began with its format.
    if matches!(bytes[..], [0x90..=0x9f, 1 | 2, ..]) {
        let remedy = "finish the run with the version that began it, or ";
        return refused("format", "that of an older version of trgs", &format, remedy);
    }
    let Some((header, content)) = bytes.split_at_checked(HEADER).filter(|(header, _)| header.starts_with(MAGIC)) else {
        return refused("content", "no header of a checkpoint", "a checkpoint of trgs", "");
    };
    let number = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|k| header[at + k]));
    if digest(&header[8..BEFORE_DIGEST]).chain_update(content).finalize()[..] != header[BEFORE_DIGEST..] {
        let expected = "that of the content: the file is damaged or was changed";
        return refused("digest", "another one", expected, "restore the file from a copy, or ");
    }
    if number(8) != FORMAT {
        return refused("format", &number(8).to_string(), &format, "use the version of trgs that wrote it, or ");
    }
    let kind = match number(12) {
        1 => Kind::Primitives,
        2 => Kind::Voxels,
        other => return refused("kind", &other.to_string(), "1 or 2", ""),
    };
    Ok(Sealed { kind, bytes })
}

/// Writes a file as a whole or not at all.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system.
pub(crate) fn write(path: &Path, kind: Kind, content: &impl Serialize) -> Result<()> {
    write_atomically(path, |file| seal(file, kind, |hashed| encode(hashed, content)))
}

/// Writes `from` as `to` with `last` in the place of its last field, an empty map. Neither is in memory as a whole.
///
/// # Errors
/// [`Error::Format`] if `from` is damaged or has another last field, and those of reading and of [`write()`].
pub(crate) fn write_with_last(from: &Path, to: &Path, last: &impl Serialize) -> Result<()> {
    let failed = |source| Error::read(from, source);
    let mut file = std::fs::File::open(from).map_err(failed)?;
    let mut header = [0; HEADER];
    let length = file.metadata().map_err(failed)?.len().saturating_sub(HEADER as u64 + 1);
    let mut end = Vec::new();
    let mut hasher = Sha256::new();
    let mut read = || {
        file.read_exact(&mut header)?;
        hasher = digest(&header[8..BEFORE_DIGEST]);
        io::copy(&mut (&file).take(length), &mut hasher)?;
        file.read_to_end(&mut end)
    };
    read().map_err(failed)?;
    let kind = [Kind::Primitives, Kind::Voxels].into_iter().find(|kind| header[12..16] == (*kind as u32).to_le_bytes());
    let whole = hasher.chain_update(&end).finalize()[..] == header[BEFORE_DIGEST..];
    let Some(kind) = kind.filter(|_| whole && end == [EMPTY_MAP]) else {
        return Err(Error::format(from, "checkpoint", "other content", "what the run wrote last", start_again()));
    };
    to.parent().map_or(Ok(()), create_folder)?;
    write_atomically(to, |out| {
        seal(out, kind, |hashed| {
            file.seek(SeekFrom::Start(HEADER as u64))?;
            io::copy(&mut file.take(length), hashed)?;
            encode(hashed, last)
        })
    })
}

/// Writes header and content; the digest is put in its place at the end.
fn seal<W: Write + Seek>(
    file: &mut W,
    kind: Kind,
    content: impl FnOnce(&mut Hashed<'_, W>) -> io::Result<()>,
) -> io::Result<()> {
    let head = [FORMAT.to_le_bytes(), (kind as u32).to_le_bytes()].concat();
    file.write_all(MAGIC)?;
    file.write_all(&head)?;
    file.write_all(&[0; HEADER - BEFORE_DIGEST])?;
    let mut hashed = Hashed { file, hasher: digest(&head), failure: None };
    content(&mut hashed)?;
    let digest = hashed.hasher.finalize();
    file.seek(SeekFrom::Start(BEFORE_DIGEST as u64))?;
    file.write_all(&digest)?;
    file.seek(SeekFrom::End(0)).map(drop)
}

fn digest(head: &[u8]) -> Sha256 {
    Sha256::new().chain_update(head)
}

/// Encodes the content; an error of the system is returned as it is, not as one of MessagePack.
fn encode<W: Write>(hashed: &mut Hashed<'_, W>, content: &impl Serialize) -> io::Result<()> {
    let encoded = rmp_serde::encode::write(hashed, content);
    encoded.map_err(|error| hashed.failure.take().unwrap_or_else(|| io::Error::other(error)))
}

/// A writer that hashes what it writes and keeps the first error.
struct Hashed<'a, W> {
    file: &'a mut W,
    hasher: Sha256,
    failure: Option<io::Error>,
}

impl<W: Write> Write for Hashed<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.file.write(bytes) {
            Ok(count) => {
                self.hasher.update(&bytes[..count]);
                Ok(count)
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Err(error),
            Err(error) => {
                let kind = error.kind();
                self.failure = Some(error);
                Err(kind.into())
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Rejects a value of a checkpoint whose digest is right.
pub(crate) fn require(holds: bool, what: &str, got: impl ToString, expected: &str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::invalid(what, got, expected, start_again())) }
}

/// Whether all numbers are finite.
pub(crate) fn are_finite<'a>(values: impl IntoIterator<Item = &'a f64>) -> bool {
    values.into_iter().all(|value| value.is_finite())
}

/// The content of a file, and the same file with other content and a right digest.
#[cfg(test)]
pub(crate) mod reseal {
    use super::{HEADER, Kind, Write, seal};
    use std::io::Cursor;

    pub(crate) fn content(file: &[u8]) -> &[u8] {
        &file[HEADER..]
    }

    pub(crate) fn sealed(kind: Kind, content: &[u8]) -> Vec<u8> {
        let mut file = Cursor::new(Vec::new());
        seal(&mut file, kind, |hashed| hashed.write_all(content)).unwrap();
        file.into_inner()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn message(bytes: &[u8]) -> String {
        unseal(bytes.into(), Path::new("last.msgpack")).unwrap_err().to_string()
    }

    #[test]
    fn a_file_is_read_back_and_any_flipped_bit_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("last.msgpack");
        let content = (7_u32, vec![1.5_f64, f64::INFINITY], "text".to_owned());
        write(&path, Kind::Voxels, &content).unwrap();
        let sealed = open(&path).unwrap();
        assert_eq!((sealed.kind, sealed.decode::<(u32, Vec<f64>, String)>(&path).unwrap()), (Kind::Voxels, content));
        let bytes = std::fs::read(&path).unwrap();
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(message(&damaged).contains("start again without"), "bit {bit}");
        }
        for length in 0..bytes.len() {
            message(&bytes[..length]);
        }
        message(&[&bytes[..], b"\0"].concat());
    }

    #[test]
    fn the_last_field_is_replaced_in_a_sound_file_alone() {
        let folder = tempfile::tempdir().unwrap();
        let [path, other, whole] =
            ["last.msgpack", "other.msgpack", "whole.msgpack"].map(|name| folder.path().join(name));
        let (content, last) = (vec![0.5_f64; 3000], BTreeMap::from([("volume.npy", "digest")]));
        write(&path, Kind::Voxels, &(&content, BTreeMap::<&str, &str>::new())).unwrap();
        write(&whole, Kind::Voxels, &(&content, &last)).unwrap();
        write_with_last(&path, &other, &last).unwrap();
        assert_eq!(std::fs::read(&other).unwrap(), std::fs::read(&whole).unwrap());
        let refused = |path: &Path| write_with_last(path, &other, &last).unwrap_err().to_string();
        assert!(refused(&whole).contains("other content"), "{}", refused(&whole));
        let mut damaged = std::fs::read(&path).unwrap();
        damaged[2000] ^= 1;
        std::fs::write(&path, damaged).unwrap();
        assert!(refused(&path).contains("other content"));
        std::fs::write(&path, b"short").unwrap();
        assert!(matches!(write_with_last(&path, &other, &last), Err(Error::Read { .. })));
    }

    #[test]
    fn other_files_are_refused_with_their_reason() {
        let kind = |kind: u32| {
            let head = [FORMAT.to_le_bytes(), kind.to_le_bytes()].concat();
            [MAGIC, &head[..], &digest(&head).finalize()].concat()
        };
        let newer = {
            let head = [9_u32.to_le_bytes(), 1_u32.to_le_bytes()].concat();
            [MAGIC, &head[..], &digest(&head).finalize()].concat()
        };
        for (bytes, names) in [
            (b"hello".to_vec(), ["no header", "a checkpoint of trgs"]),
            (vec![0x94, 2, 0xda], ["format: got that of an older version", "the version that began it"]),
            (vec![0x96, 2, 0xda], ["format: got that of an older version", "start again without"]),
            (kind(3), ["kind: got 3", "expected 1 or 2"]),
            (newer, ["format: got 9", "expected 3"]),
        ] {
            let message = message(&bytes);
            assert!(names.iter().all(|name| message.contains(name)), "{message}");
        }
        let folder = tempfile::tempdir().unwrap();
        assert!(open(folder.path()).unwrap_err().to_string().contains("a folder or a special file"));
    }

    #[test]
    fn a_full_disk_is_an_error_of_the_system() {
        struct Full(u64);
        impl Write for Full {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                self.0 += bytes.len() as u64;
                if self.0 > 100 { Err(io::ErrorKind::StorageFull.into()) } else { Ok(bytes.len()) }
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        impl Seek for Full {
            fn seek(&mut self, _: SeekFrom) -> io::Result<u64> {
                Ok(0)
            }
        }
        let content = vec![0.5_f64; 1000];
        let error = seal(&mut Full(0), Kind::Primitives, |hashed| encode(hashed, &content)).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
    }
}
