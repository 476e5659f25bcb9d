//! A folder with one slice per file.

use super::VolumeFile;
use super::tiff::Pages;
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

pub(super) fn read(folder: &Path) -> Result<VolumeFile> {
    let files = files(folder)?;
    let tiffs = with_extension(&files, &["tif", "tiff"]);
    if tiffs.is_empty() {
        if let Some(volume) = dicom_series(folder, &files) {
            return volume;
        }
        let expected = "pages .tif or .tiff in it, or the slices of a DICOM series";
        return Err(Error::format(
            folder,
            "folder",
            format!("{} files", files.len()),
            expected,
            "name another folder, or convert its files to TIFF",
        ));
    }
    let mut pages = Pages::default();
    for path in tiffs {
        let content = std::fs::read(path).map_err(|source| Error::read(path, source))?;
        let count = pages.add_all(&content, path)?;
        if count != 1 {
            let remedy = "give the path of that file instead of the folder";
            return Err(Error::format(path, "file in a folder", format!("{count} pages"), "one", remedy));
        }
    }
    Ok(VolumeFile::bare(pages.volume()))
}

/// The DICOM series of a folder, if it holds one.
#[cfg(any(feature = "dicom", test))]
fn dicom_series(folder: &Path, files: &[PathBuf]) -> Option<Result<VolumeFile>> {
    let slices: Vec<PathBuf> = files.iter().filter(|path| super::dicom::is_dicom(path)).cloned().collect();
    (!slices.is_empty()).then(|| super::dicom::read(folder, &slices))
}

#[cfg(not(any(feature = "dicom", test)))]
fn dicom_series(folder: &Path, files: &[PathBuf]) -> Option<Result<VolumeFile>> {
    (!with_extension(files, &["dcm", "ima"]).is_empty()).then(|| Err(super::no_dicom(folder)))
}

/// The files of a folder in natural order, without hidden files.
pub(in crate::scene) fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let failed = |source| Error::read(folder, source);
    let mut files = Vec::new();
    for entry in folder.read_dir().map_err(failed)? {
        let entry = entry.map_err(failed)?;
        if !entry.file_name().as_encoded_bytes().starts_with(b".") && entry.path().is_file() {
            files.push(entry.path());
        }
    }
    files.sort_by(|a, b| alphanumeric_sort::compare_path(a, b).then_with(|| a.cmp(b)));
    Ok(files)
}

/// The files with one of the extensions, ignoring case.
pub(in crate::scene) fn with_extension<'a>(files: &'a [PathBuf], extensions: &[&str]) -> Vec<&'a Path> {
    let matches = |path: &&PathBuf| {
        path.extension().is_some_and(|found| extensions.iter().any(|known| found.eq_ignore_ascii_case(known)))
    };
    files.iter().filter(matches).map(PathBuf::as_path).collect()
}
