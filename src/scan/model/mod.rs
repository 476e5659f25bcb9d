//! Model files. The format follows from the file's name, and for an archive from its keys:
//!
//! | file | content |
//! |---|---|
//! | MODEL.npz, GRAD.npz | `mean [M,3]`, `scale [M,3]`, `quaternion [M,4]`, `density [M]`, `nu [M]`, physical values |
//! | `.ply` | the same as vertex properties, and a colour: [`ply`] |
//! | `.ply` of splats | Gaussians for viewers of 3D Gaussian splatting; written only: [`splat`] |
//! | R²-Gaussian's `.pickle`, or its arrays as `.npz` | `xyz`, `density`, `scale`, `rotation`, `scale_bound`, raw values: [`r2`] |

pub mod ply;
pub mod r2;
pub mod splat;

use crate::npz::{self, Entry, Npz};
use ndarray::{Array1, Array2, ArrayView, IxDyn};
use std::ffi::OsStr;
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::primitives::{Group, Parameters, Primitives};

/// Reads a model in any of the formats. Without `nu`, or with infinite ν only, the kernel is Gaussian.
///
/// # Errors
/// [`Error::Read`], or [`Error::Format`] for a damaged file or the first value that cannot be used.
pub fn read(path: impl AsRef<Path>) -> Result<Primitives> {
    let path = path.as_ref();
    let content = crate::input::read(path).map_err(|source| Error::read(path, source))?;
    parse(&content, path)
}

/// Parses the content of a model file; `path` determines the format and names it in errors.
///
/// # Errors
/// [`Error::Format`] for a damaged file or the first value that cannot be used.
pub fn parse(content: &[u8], path: &Path) -> Result<Primitives> {
    match path.extension().and_then(OsStr::to_str) {
        Some("ply") => return ply::parse(content, path).map(|(primitives, _)| primitives),
        Some("pickle" | "pkl") => return r2::parse_pickle(content, path),
        _ => {}
    }
    let npz = Npz::parse(content, path)?;
    if npz.entry("mean").is_none() && npz.entry("xyz").is_some() {
        return r2::of_archive(path, &npz);
    }
    let density: Array1<f64> = npz.get("density", "[M]")?;
    let nu: Array1<f64> =
        if npz.entry("nu").is_some() { npz.get("nu", "[M]")? } else { Array1::from_elem(density.len(), f64::INFINITY) };
    Primitives::new(Parameters {
        mean: rows(path, &npz, Group::Mean)?,
        scale: rows(path, &npz, Group::Scale)?,
        quaternion: rows(path, &npz, Group::Quaternion)?,
        density: density.to_vec(),
        nu: nu.to_vec(),
    })
    .map_err(|error| error.in_file(path))
}

/// An `[M, N]` array as rows.
fn rows<const N: usize>(path: &Path, npz: &Npz, group: Group) -> Result<Vec<[f64; N]>> {
    let array: Array2<f64> = npz.get(group.key(), &format!("[M, {N}]"))?;
    if array.ncols() != N {
        return Err(Error::format(
            path,
            group.key(),
            format!("shape {:?}", array.shape()),
            format!("[M, {N}]"),
            "one row per primitive",
        ));
    }
    Ok(array.rows().into_iter().map(|row| std::array::from_fn(|k| row[k])).collect())
}

/// Writes parameters or a gradient as f64 arrays.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system.
pub fn write(path: impl AsRef<Path>, parameters: &Parameters) -> Result<()> {
    let m = parameters.len();
    let entry = |group: Group| {
        let shape = if group.width() == 1 { IxDyn(&[m]) } else { IxDyn(&[m, group.width()]) };
        let values = ArrayView::from_shape(shape, parameters.group(group)).expect("a group has M·width numbers");
        (group.key(), Entry::F64(values))
    };
    npz::write(path, &Group::ALL.map(entry))
}

#[cfg(test)]
mod tests {
    use super::*;
    use trgs_core::primitives::KernelKind;

    fn parameters() -> Parameters {
        Parameters {
            mean: vec![[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]],
            scale: vec![[0.1, 0.2, 0.3]; 2],
            quaternion: vec![[2.0, 0.0, -1.0, 0.5]; 2],
            density: vec![0.5, 0.25],
            nu: vec![3.0, 30.0],
        }
    }

    #[test]
    fn what_is_written_is_read_back_to_the_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.npz");
        write(&path, &parameters()).unwrap();
        assert_eq!(read(&path).unwrap(), Primitives { kernel: KernelKind::StudentT, parameters: parameters() });
    }

    #[test]
    fn a_missing_key_is_named_together_with_those_that_are_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.npz");
        let one = Array1::<f64>::zeros(1).into_dyn();
        npz::write(&path, &[("density", Entry::F64(one.view()))]).unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("mean") && message.contains("density"), "{message}");
    }

    #[test]
    fn an_impossible_scale_is_refused_with_its_row() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.npz");
        let mut bad = parameters();
        bad.scale[1][2] = -0.1;
        write(&path, &bad).unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("scale of primitive 1"), "{message}");
    }
}
