//! Names of arrays within files: `FILE.h5:/group/name`.

use std::path::{Path, PathBuf};

/// Endings of files that hold several named arrays: HDF5, NeXus and MATLAB.
pub(super) const ENDINGS: [&str; 6] = [".h5", ".hdf5", ".hdf", ".nxs", ".nx", ".mat"];

/// Whether a path is that of an HDF5 file, or of an array in one.
pub fn is_hdf5(path: &Path) -> bool {
    split(path).is_some()
}

/// The file, and the name of the array, if the path has one.
pub(super) fn parts(path: &Path) -> (PathBuf, Option<String>) {
    split(path).unwrap_or_else(|| (path.to_owned(), None))
}

fn split(path: &Path) -> Option<(PathBuf, Option<String>)> {
    let ends = |path: &Path, with: &str| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        ENDINGS.iter().any(|ending| name.ends_with(&format!("{ending}{with}")))
    };
    if ends(path, "") {
        return Some((path.to_owned(), None));
    }
    // The folder-like part that ends with a colon; a name that is not UTF-8 stays as it is.
    let file = path.ancestors().filter(|part| ends(part, ":") && *part != path).last()?;
    let array = path.strip_prefix(file).ok()?.to_str()?;
    let ending = file.extension()?.to_str()?.strip_suffix(':')?;
    Some((file.with_extension(ending), Some(format!("/{array}"))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_has_the_name_after_the_colon() {
        let of = |text: &str| split(Path::new(text)).map(|(file, name)| (file.to_string_lossy().into_owned(), name));
        let whole = |file: &str| Some((file.to_owned(), None));
        assert_eq!(of("a/scan.h5"), whole("a/scan.h5"));
        assert_eq!(of("scan.NXS"), whole("scan.NXS"));
        assert_eq!(of("a.h5:/exchange/data"), Some(("a.h5".into(), Some("/exchange/data".into()))));
        assert_eq!(of("a.h5/b.mat:/data"), Some(("a.h5/b.mat".into(), Some("/data".into()))));
        assert_eq!((of("a.h5/b.npy"), of("C:/scans/a.tif"), of("scan.h5x")), (None, None, None));
    }
}
