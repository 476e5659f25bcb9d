//! SHA-256 digests of files and bytes.

use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io;
use std::path::Path;
use trgs_core::error::{Error, Result};

/// Opens a regular file.
pub fn open_unrecorded(path: &Path) -> io::Result<File> {
    // Opening a pipe would wait for its writer.
    let found = fs::metadata(path)?;
    if found.is_file() || found.is_dir() {
        return File::open(path);
    }
    Err(io::Error::new(io::ErrorKind::Unsupported, "it is a pipe, a socket or a device"))
}

/// SHA-256 of a regular file, 64 hexadecimal digits.
///
/// # Errors
/// [`Error::Read`] with the error of the operating system, and for a pipe or a device.
pub fn digest_file(path: &Path) -> Result<String> {
    let mut hasher = Sha256::new();
    let copied = open_unrecorded(path).and_then(|mut file| io::copy(&mut file, &mut hasher));
    copied.map_err(|source| Error::read(path, source))?;
    Ok(hex(hasher))
}

/// SHA-256 of bytes, 64 hexadecimal digits.
pub fn digest_bytes(bytes: &[u8]) -> String {
    hex(Sha256::new().chain_update(bytes))
}

/// [`digest_bytes`] of a text and numbers. On every processor the numbers count as little-endian.
pub fn digest_numbers(text: &str, numbers: &[f32]) -> String {
    let mut hasher = Sha256::new().chain_update(text);
    let mut bytes = [[0; 4]; 1024];
    for block in numbers.chunks(bytes.len()) {
        bytes.iter_mut().zip(block).for_each(|(bytes, number)| *bytes = number.to_le_bytes());
        hasher.update(bytes[..block.len()].as_flattened());
    }
    hex(hasher)
}

fn hex(hasher: Sha256) -> String {
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digest_of_a_file_is_the_published_one_of_abc() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc.txt");
        std::fs::write(&path, "abc").unwrap();
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(digest_file(&path).unwrap(), expected);
    }

    #[test]
    fn numbers_are_digested_as_little_endian() {
        let expected = digest_bytes(b"ab\0\0\x80\x3f\0\0\0\x80");
        assert_eq!(digest_numbers("ab", &[1.0, -0.0]), expected);
        let many: Vec<f32> = (0..3000).map(|i| i as f32).collect();
        let bytes: Vec<u8> = many.iter().flat_map(|number| number.to_le_bytes()).collect();
        assert_eq!(digest_numbers("", &many), digest_bytes(&bytes));
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = digest_file(Path::new("/nowhere/at/all")).unwrap_err().to_string();
        assert!(message.contains("/nowhere/at/all"), "{message}");
    }
}
