//! NumPy's `.npz` archives: named arrays in a zip file.
//!
//! Archives are written without compression and with one fixed date, so equal arrays give equal bytes.

use super::npy::{self, Npy};
use crate::limit;
use crate::output::write_atomically;
use ndarray::{Array, ArrayViewD, Dimension};
use std::collections::BTreeMap;
use std::io::{self, BufReader, Cursor, Read, Seek, Write};
use std::path::{Path, PathBuf};
use trgs_core::error::{Error, Result};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

/// Largest expansion of a deflated entry; an entry that claims more is rejected.
const LARGEST_EXPANSION: u64 = 1032;

/// The arrays of an archive.
#[derive(Clone, Debug)]
pub struct Npz {
    path: PathBuf,
    arrays: BTreeMap<String, Npy>,
}

impl Npz {
    /// Reads all arrays of an archive.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for anything but a complete archive of arrays of numbers.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let file = crate::input::open(path).map_err(|source| Error::read(path, source))?;
        Self::decode(BufReader::new(file), path)
    }

    /// Parses the content of an archive; `path` names it in errors.
    ///
    /// # Errors
    /// [`Error::Format`] for anything but a complete archive of arrays of numbers.
    pub fn parse(content: &[u8], path: &Path) -> Result<Self> {
        Self::decode(Cursor::new(content), path)
    }

    /// [`Self::read`] from memory or an open file; `path` names the source in errors.
    ///
    /// # Errors
    /// Those of [`Self::read`].
    pub(crate) fn decode(source: impl Read + Seek, path: &Path) -> Result<Self> {
        let damaged = |error: ZipError| match error {
            ZipError::Io(source) => npy::unreadable(source, path, "archive"),
            error => Error::format(
                path,
                "archive",
                error,
                "a NumPy archive (.npz)",
                "the file is truncated, damaged or of another kind: copy or write it again",
            ),
        };
        let mut archive = ZipArchive::new(source).map_err(damaged)?;
        let (mut arrays, mut places, mut held) = (BTreeMap::new(), BTreeMap::new(), 0_u64);
        for index in 0..archive.len() {
            let mut entry = archive.by_index(index).map_err(damaged)?;
            let name = entry.name().map_err(damaged)?.into_owned();
            let Some(key) = name.strip_suffix(".npy") else { continue };
            let (size, packed) = (entry.size(), entry.compressed_size());
            if size / LARGEST_EXPANSION > packed {
                return Err(Error::format(
                    path,
                    name,
                    format!("{size} bytes packed into {packed}"),
                    "a possible size",
                    "the archive is damaged: copy or write it again",
                ));
            }
            // Entries that share their bytes would make any amount of a small archive.
            if let Some(start) = entry.data_start() {
                let end = start.saturating_add(packed);
                let before = places.range(..end).next_back();
                if let Some((_, (_, other))) = before.filter(|(_, (stop, _))| *stop > start) {
                    let got = format!("the bytes of {other} again");
                    let remedy = "the archive is damaged: copy or write it again";
                    return Err(Error::format(path, name, got, "bytes of its own", remedy));
                }
                places.insert(start, (end, name.clone()));
            }
            held = held.saturating_add(size.saturating_mul(2));
            limit::allow("arrays", held).map_err(|error| error.in_file(path))?;
            let array = npy::decode(&mut entry, size, path, &name)?;
            // The archive compares its checksum only once the entry is read to the end.
            io::copy(&mut entry, &mut io::sink()).map_err(|source| npy::unreadable(source, path, &name))?;
            arrays.insert(key.to_owned(), array);
        }
        Ok(Self { path: path.into(), arrays })
    }

    /// The names of the arrays, sorted.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.arrays.keys().map(String::as_str)
    }

    /// The array named `key` as stored, if there is one.
    pub fn entry(&self, key: &str) -> Option<&Npy> {
        self.arrays.get(key)
    }

    /// The array named `key` in double precision; `axes` names its axes in errors, as in `[M, 3]`.
    ///
    /// # Errors
    /// [`Error::Format`] when it is missing (the message lists those present) or has another number of axes.
    pub fn get<D: Dimension>(&self, key: &str, axes: &str) -> Result<Array<f64, D>> {
        let array = self.entry(key).ok_or_else(|| {
            let keys = self.keys().collect::<Vec<_>>().join(", ");
            Error::format(
                &self.path,
                "archive",
                format!("arrays [{keys}]"),
                format!("one called {key}"),
                "give an archive that holds this array",
            )
        })?;
        npy::with_axes(array.numbers.clone().into_f64(), &self.path, key, axes)
    }
}

/// An array to be written in its own precision.
#[derive(Clone, Debug)]
pub enum Entry<'a> {
    /// Single precision.
    F32(ArrayViewD<'a, f32>),
    /// Double precision.
    F64(ArrayViewD<'a, f64>),
}

/// Writes named arrays, in the given order, atomically.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system.
pub fn write(path: impl AsRef<Path>, arrays: &[(&str, Entry<'_>)]) -> Result<()> {
    write_atomically(path.as_ref(), |file| encode(file, arrays))
}

/// Writes named arrays to a stream.
///
/// # Errors
/// That of the stream.
pub fn encode(file: impl Write + Seek, arrays: &[(&str, Entry<'_>)]) -> io::Result<()> {
    let mut archive = ZipWriter::new(file);
    for (key, array) in arrays {
        let values = match array {
            Entry::F32(values) => values.len() / 2,
            Entry::F64(values) => values.len(),
        };
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644)
            // Sizes from 4 GiB need the longer records of zip64; the threshold leaves a margin.
            .large_file(values >= 500_000_000);
        archive.start_file(format!("{key}.npy"), options)?;
        match array {
            Entry::F32(values) => npy::encode(&mut archive, values.view())?,
            Entry::F64(values) => npy::encode(&mut archive, values.view())?,
        }
    }
    archive.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array1, Array2, Ix1, Ix2};

    fn sample() -> (Array2<f32>, Array1<f64>) {
        (
            Array2::from_shape_fn((4, 3), |(i, j)| i as f32 - 0.3 * j as f32),
            Array1::from_shape_fn(4, |i| 1.0 / (i + 3) as f64),
        )
    }

    #[test]
    fn what_is_written_is_read_again_and_equal_arrays_give_equal_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let (mean, density) = sample();
        let bytes = ["a.npz", "b.npz"].map(|name| {
            let path = folder.path().join(name);
            let entries =
                [("mean", Entry::F32(mean.view().into_dyn())), ("density", Entry::F64(density.view().into_dyn()))];
            write(&path, &entries).unwrap();
            std::fs::read(path).unwrap()
        });
        assert_eq!(bytes[0], bytes[1]);
        let npz = Npz::read(folder.path().join("a.npz")).unwrap();
        assert_eq!(npz.keys().collect::<Vec<_>>(), ["density", "mean"]);
        assert_eq!(npz.get::<Ix2>("mean", "[M, 3]").unwrap(), mean.mapv(f64::from));
        assert_eq!(npz.get::<Ix1>("density", "[M]").unwrap(), density);
        assert!(npz.entry("density").unwrap().numbers.is_double() && !npz.entry("mean").unwrap().numbers.is_double());
    }

    #[test]
    fn a_missing_key_names_those_that_are_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        let (mean, _) = sample();
        write(&path, &[("mean", Entry::F32(mean.view().into_dyn()))]).unwrap();
        let npz = Npz::read(&path).unwrap();
        let message = npz.get::<Ix1>("nu", "[M]").unwrap_err().to_string();
        assert!(message.contains("arrays [mean], expected one called nu"), "{message}");
        let message = npz.get::<Ix1>("mean", "[M]").unwrap_err().to_string();
        assert!(message.contains("mean: got shape [4, 3], expected axes [M]"), "{message}");
    }

    #[test]
    fn deflated_archives_are_read_and_cut_ones_are_clear_errors() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        let mut archive = ZipWriter::new(std::fs::File::create(&path).unwrap());
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
        archive.start_file("zeros.npy", options).unwrap();
        npy::encode(&mut archive, Array2::<f32>::zeros((300, 300)).view()).unwrap();
        archive.start_file("notes.txt", options).unwrap();
        archive.write_all(b"not an array").unwrap();
        archive.finish().unwrap();
        let npz = Npz::read(&path).unwrap();
        assert_eq!(npz.get::<Ix2>("zeros", "[i, j]").unwrap(), Array2::<f64>::zeros((300, 300)));
        assert_eq!(npz.keys().count(), 1);

        let bytes = std::fs::read(&path).unwrap();
        for end in (0..bytes.len()).step_by(7) {
            std::fs::write(&path, &bytes[..end]).unwrap();
            assert!(matches!(Npz::read(&path), Err(Error::Format { .. } | Error::Read { .. })), "cut at {end}");
        }
    }
}
