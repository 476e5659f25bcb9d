//! R²-Gaussian's point cloud: `point_cloud.pickle`, and the same arrays as `.npz`.
//!
//! | key | shape | physical value |
//! |---|---|---|
//! | `xyz` | `[M,3]` | μ, itself |
//! | `density` | `[M,1]` | `ρ = ln(1+e^density)` |
//! | `scale` | `[M,3]` | `s = min + (max-min)/(1+e^-scale)`; `s = e^scale` without bounds |
//! | `rotation` | `[M,4]` | q (w,x,y,z), of any length |
//! | `scale_bound` | `[2]`, or none | min and max of s |
//! | `nu` | `[M]` | ν, physical; this project's own key for Student's t; R²-Gaussian ignores it and uses Gaussians |
//!
//! Both projects scale the longest side of the scene to 2, so lengths are unchanged. Not in the paper: the formulas are
//! R²-Gaussian's. R²-Gaussian itself reads the pickle, which Python makes from the archive:
//! `pickle.dump(dict(numpy.load("point_cloud.npz")), open("point_cloud.pickle", "wb"))`.

use crate::dataset::pickle::{self, Value};
use crate::npz::{self, Entry, Npz};
use ndarray::{ArrayView, IxDyn};
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::numeric::elementary::{exp, logit, sigmoid, softplus, softplus_inverse};
use trgs_core::primitives::{KernelKind, Parameters, Primitives};
use trgs_core::setting::Setting;

/// R²-Gaussian's own bounds of scales, scene units.
const BOUND: [f64; 2] = [0.001, 1.0];

/// The array of a key: shape and values.
type Found = Option<(Vec<usize>, Vec<f64>)>;

/// Parses R²-Gaussian's pickle without running its code.
///
/// # Errors
/// [`Error::Format`] for anything but a point cloud, or for the first value that cannot be used.
pub(super) fn parse_pickle(content: &[u8], path: &Path) -> Result<Primitives> {
    let data = pickle::parse(content, path)?;
    let array = |key: &str| match data.get(key) {
        Some(Value::Array(array)) => Some((array.shape.clone(), array.values.clone())),
        _ => None,
    };
    let bound = data.get("scale_bound").and_then(Value::numbers);
    interpret(path, array, bound)
}

/// Reads the same arrays from an archive.
pub(super) fn of_archive(path: &Path, npz: &Npz) -> Result<Primitives> {
    let array = |key: &str| {
        let array = npz.entry(key)?.numbers.clone().into_f64();
        Some((array.shape().to_vec(), array.into_iter().collect()))
    };
    interpret(path, array, array("scale_bound").map(|(_, values)| values))
}

fn interpret(path: &Path, array: impl Fn(&str) -> Found, bound: Option<Vec<f64>>) -> Result<Primitives> {
    let wrong = |key: &str, got: String, expected: &str| {
        let remedy = "give R²-Gaussian's point cloud, or name a folder to convert a scan";
        Error::format(path, key, got, expected, remedy)
    };
    let rows = |key: &str, width: usize, expected: &str| {
        let (shape, values) = array(key).ok_or_else(|| wrong(key, "no such array".into(), expected))?;
        let count = shape.iter().product::<usize>();
        let fits = match shape.len() {
            1 => width == 1,
            2 => shape[1] == width,
            _ => false,
        };
        if fits && count == values.len() { Ok(values) } else { Err(wrong(key, format!("shape {shape:?}"), expected)) }
    };
    let bound = match bound.as_deref() {
        None => None,
        Some(&[min, max]) if min >= 0.0 && min < max && max.is_finite() => Some([min, max]),
        Some(other) => {
            let got: Vec<f64> = other.iter().copied().take(3).collect();
            return Err(wrong("scale_bound", format!("{got:?}"), "two lengths, the first below the second"));
        }
    };
    let density = rows("density", 1, "[M, 1]")?;
    let nu = if array("nu").is_some() { rows("nu", 1, "[M]")? } else { vec![f64::INFINITY; density.len()] };
    let scale = |raw: f64| match bound {
        Some([min, max]) => min + (max - min) * sigmoid(raw),
        None => exp(raw),
    };
    Primitives::new(Parameters {
        mean: rows("xyz", 3, "[M, 3]")?.as_chunks().0.to_vec(),
        scale: rows("scale", 3, "[M, 3]")?.as_chunks().0.iter().map(|row: &[f64; 3]| row.map(scale)).collect(),
        quaternion: rows("rotation", 4, "[M, 4]")?.as_chunks().0.to_vec(),
        density: density.into_iter().map(softplus).collect(),
        nu,
    })
    .map_err(|error| error.in_file(path))
}

/// Writes the arrays as `.npz`, f64. The bounds are R²-Gaussian's, widened if a scale is outside.
///
/// # Errors
/// [`Error::Write`], or [`Error::Invalid`] for a density that is not positive, which the format cannot store.
pub fn write(path: impl AsRef<Path>, primitives: &Primitives) -> Result<()> {
    write_path(path.as_ref(), primitives)
}

fn write_path(path: &Path, primitives: &Primitives) -> Result<()> {
    let Parameters { mean, scale, quaternion, density, nu } = &primitives.parameters;
    if let Some(i) = density.iter().position(|density| *density <= 0.0) {
        let expected = "a positive number, as R²-Gaussian has no other";
        let remedy = "write a .ply, or a .npz without " + Setting::R2;
        return Err(Error::invalid(format!("density of primitive {i}"), density[i], expected, remedy));
    }
    let ends = scale
        .as_flattened()
        .iter()
        .fold(BOUND, |[min, max], &s| [if s <= min { s / 2.0 } else { min }, if s >= max { s * 2.0 } else { max }]);
    let [min, max] = ends;
    let raw_scale: Vec<f64> = scale.as_flattened().iter().map(|s| logit((s - min) / (max - min))).collect();
    let raw_density: Vec<f64> = density.iter().map(|&density| softplus_inverse(density)).collect();
    let m = density.len();
    let entry = |shape: &[usize], values| {
        Entry::F64(ArrayView::from_shape(IxDyn(shape), values).expect("a row for each primitive"))
    };
    let mut arrays = vec![
        ("xyz", entry(&[m, 3], mean.as_flattened())),
        ("density", entry(&[m, 1], &raw_density)),
        ("scale", entry(&[m, 3], &raw_scale)),
        ("rotation", entry(&[m, 4], quaternion.as_flattened())),
        ("scale_bound", entry(&[2], &ends)),
    ];
    if primitives.kernel == KernelKind::StudentT {
        arrays.push(("nu", entry(&[m], nu)));
    }
    npz::write(path, &arrays)
}

#[cfg(test)]
mod tests {
    use super::super::read;
    use super::*;
    use crate::tolerances::relative;
    use trgs_core::primitives::Group;

    fn primitives(nu: [f64; 3]) -> Primitives {
        let parameters = Parameters {
            mean: vec![[0.1, -0.2, 0.3], [0.4, 0.5, 0.6], [-1.0, 0.0, 1.0]],
            scale: vec![[0.1, 0.2, 0.3], [0.002, 0.02, 0.7], [0.001, 0.0003, 1.5]],
            quaternion: vec![[2.0, 0.0, -1.0, 0.5], [0.1, 0.2, 0.3, -0.4], [1.0, 0.0, 0.0, 0.0]],
            density: vec![0.5, 1e-5, 40.0],
            nu: nu.into(),
        };
        Primitives::new(parameters).unwrap()
    }

    #[test]
    fn what_is_written_is_read_back_with_and_without_nu() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("point_cloud.npz");
        for nu in [[3.0, 30.0, 2.5], [f64::INFINITY; 3]] {
            let written = primitives(nu);
            write(&path, &written).unwrap();
            let found = read(&path).unwrap();
            assert_eq!(found.kernel, written.kernel);
            for group in Group::ALL {
                for (x, y) in found.parameters.group(group).iter().zip(written.parameters.group(group)) {
                    // The precision of a scale is that of the upper end of its interval.
                    match group {
                        Group::Scale => within!("scale", (x - y).abs(), "{x} instead of {y}"),
                        _ => within!(relative(*x, *y), "{group:?}: {x} instead of {y}"),
                    }
                }
            }
        }
    }

    #[test]
    fn the_formulas_are_those_of_the_table() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("point_cloud.npz");
        let (xyz, raw, q, bound) = ([1.0, 2.0, 3.0], [0.0, 1.0, -2.0], [0.0, 3.0, 0.0, 4.0], [0.001, 1.0]);
        let of =
            |shape: &[usize], values: &'static [f64]| Entry::F64(ArrayView::from_shape(IxDyn(shape), values).unwrap());
        let view = |shape: &[usize], values| Entry::F64(ArrayView::from_shape(IxDyn(shape), values).unwrap());
        let arrays = |bounds: bool| {
            let all = [
                ("xyz", view(&[1, 3], &xyz[..])),
                ("density", of(&[1, 1], &[0.0])),
                ("scale", view(&[1, 3], &raw[..])),
                ("rotation", view(&[1, 4], &q[..])),
                ("scale_bound", view(&[2], &bound[..])),
            ];
            all.into_iter().take(if bounds { 5 } else { 4 }).collect::<Vec<_>>()
        };
        npz::write(&path, &arrays(true)).unwrap();
        let found = read(&path).unwrap();
        assert_eq!(found.kernel, KernelKind::Gaussian);
        let e = std::f64::consts::E;
        within!(relative(found.parameters.density[0], std::f64::consts::LN_2));
        within!(relative(found.parameters.scale[0][0], 0.5005));
        within!(relative(found.parameters.scale[0][1], 0.001 + 0.999 * e / (1.0 + e)));
        npz::write(&path, &arrays(false)).unwrap();
        within!(relative(read(&path).unwrap().parameters.scale[0][1], e));
    }

    #[test]
    fn what_the_format_does_not_have_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("point_cloud.npz");
        let mut negative = primitives([3.0; 3]);
        negative.parameters.density[1] = -0.5;
        let message = write(&path, &negative).unwrap_err().to_string();
        assert!(message.contains("density of primitive 1") && !path.exists(), "{message}");
        write(&path, &primitives([3.0; 3])).unwrap();
        let scan = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/naf_4.pickle");
        let message = read(Path::new(scan)).unwrap_err().to_string();
        assert!(message.contains("density") && message.contains("folder"), "{message}");
    }
}
