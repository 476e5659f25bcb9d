//! A folder with one slice per file.

use super::detached::whole;
use super::pages::Pages;
use super::{FOREIGN, VolumeFile, damaged, images, raw, tiff};
use crate::limit;
use ndarray::{Array3, Axis, Slice};
use std::ops::Range;
use std::path::{Path, PathBuf};
use trgs_core::error::{Error, Result};
use trgs_core::words::counted;

/// Extensions of the files of slices, in order of preference: a folder is read as the first kind that it holds.
pub(crate) const SLICES: [&[&str]; 4] = [&["tif", "tiff"], &["png"], &["jpg", "jpeg"], &["raw"]];

pub(super) fn read(folder: &Path) -> Result<VolumeFile> {
    let files = files(folder)?;
    match Slices::among(&files) {
        Some(slices) => slices.read(&slices.paths, |_| ()),
        None => dicom_series(folder, &files).unwrap_or_else(|| Err(nothing(folder, &files))),
    }
}

/// The files of slices in a folder.
pub(super) struct Slices {
    /// One for each z.
    pub(super) paths: Vec<PathBuf>,
    /// Images of other kinds.
    others: usize,
}

impl Slices {
    /// None where the files are no images.
    pub(super) fn among(files: &[PathBuf]) -> Option<Self> {
        let mut kinds = SLICES.iter().map(|kind| with_extension(files, kind)).filter(|found| !found.is_empty());
        let paths = kinds.next()?.into_iter().map(Path::to_owned).collect();
        Some(Self { paths, others: kinds.map(|other| other.len()).sum() })
    }

    /// `[x, y, z]`, by the first file.
    pub(super) fn shape(&self) -> Result<[usize; 3]> {
        let (x, y, _) = self.read(&self.paths[..1], |_| ())?.values.dim();
        Ok([x, y, self.paths.len()])
    }

    /// The whole volume without its values: each file is read and checked.
    pub(super) fn metadata(&self) -> Result<VolumeFile> {
        self.read(&self.paths, Pages::forget)
    }

    fn read(&self, paths: &[PathBuf], after_each: impl Fn(&mut Pages)) -> Result<VolumeFile> {
        let mut pages = Pages::default();
        for path in paths {
            add(path, &mut pages)?;
            after_each(&mut pages);
        }
        // Pages of ImageJ state the distance to other pages of their own file.
        pages.spacing = None;
        if self.others > 0 {
            let (kind, others) = (self.paths[0].extension().unwrap_or_default().to_string_lossy(), self.others);
            pages.remark(format!("images of other kinds than .{kind} are in the folder ({others}); they are not read"));
        }
        if let Some(gap) = gap(&self.paths) {
            pages.remark(gap);
        }
        Ok(pages.volume())
    }

    /// The values of a box, `[x, y, z]`.
    pub(super) fn part(&self, [x, y, z]: [Range<usize>; 3]) -> Result<Array3<f32>> {
        let shape = [z.len(), y.len(), x.len()];
        let mut values = limit::room("slab", shape.iter().product())?;
        for path in &self.paths[z] {
            let mut pages = Pages::default();
            add(path, &mut pages)?;
            let slice = pages.volume().values;
            let (columns, rows, _) = slice.dim();
            if x.end > columns || y.end > rows {
                return Err(damaged(path, &format!("{rows} rows and {columns} columns, fewer than it had at first")));
            }
            let part = slice.slice_axis(Axis(0), Slice::from(x.clone()));
            values.extend(part.slice_axis(Axis(1), Slice::from(y.clone())).t());
        }
        Ok(Array3::from_shape_vec(shape, values).expect("every slice has its values").reversed_axes())
    }
}

/// Adds the one slice of a file.
fn add(path: &Path, pages: &mut Pages) -> Result<()> {
    let content = &crate::input::read(path).map_err(|source| Error::read(path, source))?;
    let before = pages.count();
    match path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).as_deref() {
        Some("tif" | "tiff") => {
            tiff::add_all(content, path, pages)?;
        }
        Some("raw") => {
            let slice = whole(raw::describe(content.len(), path)?, content, path)?;
            let (columns, rows, _) = slice.values.dim();
            pages.check(rows, columns, path)?;
            pages.add(slice.values.t().iter().copied());
        }
        _ => images::add(content, path, pages)?,
    }
    match pages.count() - before {
        1 => Ok(()),
        count => {
            let remedy = "give the path of that file instead of the folder";
            Err(Error::format(path, "file in a folder", format!("{count} pages"), "one", remedy))
        }
    }
}

/// The error for a folder without slices.
fn nothing(folder: &Path, files: &[PathBuf]) -> Error {
    let expected = "slices .tif, .png, .jpg or .raw in it, or those of a DICOM series";
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let foreign = files.iter().find_map(|path| FOREIGN.iter().find(|(ending, _)| name(path).ends_with(ending)));
    let (got, remedy) = match foreign {
        Some((ending, how)) => (format!("files {ending}, which are not supported"), format!("convert them: {how}")),
        None => (counted(files.len(), "file"), "name another folder, or convert its files to TIFF".into()),
    };
    Error::format(folder, "folder", got, expected, remedy)
}

/// How the remark on a gap begins.
pub(crate) const GAP: &str = "slices seem to be missing";

/// A remark on the first gap in the numbers at the end of the names, if they are otherwise evenly spaced.
fn gap(paths: &[PathBuf]) -> Option<String> {
    let numbered = |path: &Path| -> Option<(String, u64)> {
        let stem = path.file_stem()?.to_str()?;
        let prefix = stem.trim_end_matches(|c: char| c.is_ascii_digit());
        // In a decimal fraction the last digits are no count.
        (!prefix.ends_with('.')).then_some(())?;
        Some((prefix.to_owned(), stem[prefix.len()..].parse().ok()?))
    };
    let names: Option<Vec<_>> = paths.iter().map(|path| numbered(path)).collect();
    let names = names?;
    let steps: Vec<u64> = names.windows(2).filter_map(|pair| pair[1].1.checked_sub(pair[0].1)).collect();
    let usual = steps.iter().min().filter(|step| **step > 0)?;
    let is_one_pattern = steps.len() + 1 == names.len() && names.iter().all(|(prefix, _)| *prefix == names[0].0);
    let at = steps.iter().position(|step| step != usual).filter(|_| is_one_pattern)?;
    let missing: u64 = steps.iter().map(|step| step / usual - 1).sum();
    let name = |i: usize| paths[i].file_name().unwrap_or_default().to_string_lossy();
    Some(format!("{GAP} ({missing}): {} comes after {}", name(at + 1), name(at)))
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
pub(crate) fn files(folder: &Path) -> Result<Vec<PathBuf>> {
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
pub(crate) fn with_extension<'a>(files: &'a [PathBuf], extensions: &[&str]) -> Vec<&'a Path> {
    let matches = |path: &&PathBuf| {
        path.extension().is_some_and(|found| extensions.iter().any(|known| found.eq_ignore_ascii_case(known)))
    };
    files.iter().filter(matches).map(PathBuf::as_path).collect()
}
