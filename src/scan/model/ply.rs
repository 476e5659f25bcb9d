//! Primitives as vertices of a PLY file, for programs that display point clouds.
//!
//! | property | type | |
//! |---|---|---|
//! | `x`, `y`, `z` | double | μ |
//! | `scale_x`, `scale_y`, `scale_z` | double | s |
//! | `rotation_w`, `rotation_x`, `rotation_y`, `rotation_z` | double | q, of any length |
//! | `density` | double | ρ |
//! | `nu` | double | ν; missing if the kernel is Gaussian |
//! | `confidence` | double | c `[Eq. 8]`, if it was computed |
//! | `red`, `green`, `blue` | uchar | the colour map viridis of c, otherwise of ln ν, otherwise of ρ |
//!
//! Values are physical, in scene units. A PLY of 3D Gaussian splatting stores logarithms of scales in `scale_0` to
//! `scale_2` and colours as spherical harmonics. The property names here differ, so that no splat viewer mistakes one
//! for the other. Properties are read in any order, encoding and type; properties outside the table are ignored.

use crate::Frame;
use crate::output::write_atomically;
use colorous::VIRIDIS;
use serde::{Deserialize, Serialize};
use serde_ply::{PlyReader, SerializeOptions};
use std::io;
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::numeric::elementary::log;
use trgs_core::primitives::{KernelKind, Parameters, Primitives};

/// Properties that a model must have.
const NEEDED: [&str; 11] =
    ["x", "y", "z", "scale_x", "scale_y", "scale_z", "rotation_w", "rotation_x", "rotation_y", "rotation_z", "density"];
/// Number of characters shown of a parser's error message.
const LONGEST: usize = 200;

#[derive(Serialize, Deserialize)]
struct Vertex {
    x: f64,
    y: f64,
    z: f64,
    scale_x: f64,
    scale_y: f64,
    scale_z: f64,
    rotation_w: f64,
    rotation_x: f64,
    rotation_y: f64,
    rotation_z: f64,
    density: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    nu: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    confidence: Option<f64>,
    #[serde(skip_deserializing)]
    red: u8,
    #[serde(skip_deserializing)]
    green: u8,
    #[serde(skip_deserializing)]
    blue: u8,
}

/// A row of another element; ignored.
#[derive(Deserialize)]
struct Other {}

/// The content of a file.
#[derive(Serialize)]
struct Ply {
    vertex: Vec<Vertex>,
}

/// Reads primitives, and their confidence if the file has it.
///
/// # Errors
/// [`Error::Read`], or [`Error::Format`] for a damaged file, a missing property or the first value that cannot be used.
pub fn read(path: impl AsRef<Path>) -> Result<(Primitives, Option<Vec<f64>>)> {
    let path = path.as_ref();
    let content = crate::input::read(path).map_err(|source| Error::read(path, source))?;
    parse(&content, path)
}

/// [`read`] from the content of a file; `path` names it in errors.
pub(super) fn parse(content: &[u8], path: &Path) -> Result<(Primitives, Option<Vec<f64>>)> {
    let damaged = |found: serde_ply::DeserializeError| {
        let found: String = found.0.to_string().chars().take(LONGEST).collect();
        Error::format(path, "PLY", found, "a whole file, ASCII or binary", "copy or export the file again")
    };
    let mut reader = PlyReader::from_reader(content).map_err(damaged)?;
    // A header is accepted only if the file has bytes for it: a property takes at least one.
    for element in &reader.header().elem_defs {
        let least = element.count.checked_mul(element.properties.len());
        if element.count > 0 && least.is_none_or(|least| least == 0 || least > content.len()) {
            let got = format!("{} of {} properties", element.count, element.properties.len());
            let expected = format!("what fits into {} bytes", content.len());
            return Err(Error::format(path, "elements", got, expected, "copy or export the file again"));
        }
    }
    while let Some(element) = reader.current_element() {
        if element.name != "vertex" {
            reader.next_element::<Vec<Other>>().map_err(damaged)?;
            continue;
        }
        if let Some(missing) = NEEDED.into_iter().find(|name| !element.has_property(name)) {
            let names: Vec<&str> = element.properties.iter().map(|property| property.name.as_str()).collect();
            let names: String = names.join(", ").chars().take(LONGEST).collect();
            let remedy = "give a PLY written by trgs; splats of 3D Gaussian splatting are not supported";
            return Err(Error::format(path, "vertices", format!("[{names}]"), format!("a property {missing}"), remedy));
        }
        let (has_nu, has_confidence) = (element.has_property("nu"), element.has_property("confidence"));
        let vertices: Vec<Vertex> = reader.next_element().map_err(damaged)?;
        let nu = |vertex: &Vertex| if has_nu { vertex.nu.unwrap_or(f64::NAN) } else { f64::INFINITY };
        let parameters = Parameters {
            mean: vertices.iter().map(|v| [v.x, v.y, v.z]).collect(),
            scale: vertices.iter().map(|v| [v.scale_x, v.scale_y, v.scale_z]).collect(),
            quaternion: vertices.iter().map(|v| [v.rotation_w, v.rotation_x, v.rotation_y, v.rotation_z]).collect(),
            density: vertices.iter().map(|v| v.density).collect(),
            nu: vertices.iter().map(nu).collect(),
        };
        let primitives = Primitives::new(parameters).map_err(|error| error.in_file(path))?;
        let confidence = vertices.iter().map(|v| v.confidence.unwrap_or(f64::NAN)).collect();
        return Ok((primitives, has_confidence.then_some(confidence)));
    }
    Err(Error::format(path, "PLY", "no vertices", "an element vertex", "give primitives as trgs writes them"))
}

/// Writes primitives, with their `confidence` if given; binary, little-endian.
///
/// # Errors
/// [`Error::Write`] with the error of the operating system.
///
/// # Panics
/// When the number of confidences is not the number of primitives.
pub fn write(path: impl AsRef<Path>, primitives: &Primitives, confidence: Option<&[f64]>, frame: &Frame) -> Result<()> {
    write_path(path.as_ref(), primitives, confidence, frame)
}

fn write_path(path: &Path, primitives: &Primitives, confidence: Option<&[f64]>, frame: &Frame) -> Result<()> {
    let Parameters { mean, scale, quaternion, density, nu } = &primitives.parameters;
    assert!(confidence.is_none_or(|c| c.len() == density.len()), "one confidence for each primitive");
    let (of, colours) = colours(primitives, confidence);
    let vertex = |i: usize| {
        let ([x, y, z], [scale_x, scale_y, scale_z]) = (mean[i], scale[i]);
        let [rotation_w, rotation_x, rotation_y, rotation_z] = quaternion[i];
        let (nu, confidence) = ((primitives.kernel == KernelKind::StudentT).then_some(nu[i]), confidence.map(|c| c[i]));
        let [red, green, blue] = colours[i];
        let density = density[i];
        Vertex {
            x,
            y,
            z,
            scale_x,
            scale_y,
            scale_z,
            rotation_w,
            rotation_x,
            rotation_y,
            rotation_z,
            density,
            nu,
            confidence,
            red,
            green,
            blue,
        }
    };
    let file = Ply { vertex: (0..density.len()).map(vertex).collect() };
    let mut comments = vec![
        "primitives of trgs: physical values in scene units, not the pre-activation ones of 3D Gaussian splatting"
            .into(),
        "rotation is a quaternion (w, x, y, z) of any length; without nu the kernel is Gaussian".into(),
        format!("colour: viridis of {of}"),
    ];
    if *frame != Frame::default() {
        let [x, y, z] = frame.origin.to_array();
        comments.push(format!("unit of length of the scan: {}; the scene's origin is at {x}, {y}, {z}", frame.words()));
    }
    let options = SerializeOptions::binary_le().with_comments(comments);
    write_atomically(path, |out| serde_ply::to_writer(&file, options, out).map_err(io::Error::other))
}

/// What the colours of primitives stand for, and the colour of each.
pub(super) fn colours(primitives: &Primitives, confidence: Option<&[f64]>) -> (&'static str, Vec<[u8; 3]>) {
    let Parameters { density, nu, .. } = &primitives.parameters;
    let (of, place) = match (confidence, primitives.kernel) {
        (Some(confidence), _) => ("confidence, 0 to 1", confidence.to_vec()),
        (None, KernelKind::StudentT) => ("ln nu, smallest to largest", spread(nu.iter().map(|&nu| log(nu)).collect())),
        (None, KernelKind::Gaussian) => ("density, smallest to largest", spread(density.clone())),
    };
    (of, place.into_iter().map(|place| VIRIDIS.eval_continuous(place.clamp(0.0, 1.0)).as_tuple().into()).collect())
}

/// Values scaled to [0, 1] from smallest to largest; ½ where all are equal.
fn spread(values: Vec<f64>) -> Vec<f64> {
    let (low, high) =
        values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
    values.into_iter().map(|x| if low < high { (x - low) / (high - low) } else { 0.5 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Unit;

    fn primitives(nu: [f64; 2]) -> Primitives {
        let parameters = Parameters {
            mean: vec![[0.1, -0.2, 0.3], [0.4, 0.5, 1.0 / 3.0]],
            scale: vec![[0.1, 0.2, 0.3], [0.01, 0.02, 0.7]],
            quaternion: vec![[2.0, 0.0, -1.0, 0.5], [0.1, 0.2, 0.3, -0.4]],
            density: vec![0.5, -0.25],
            nu: nu.into(),
        };
        Primitives::new(parameters).unwrap()
    }

    #[test]
    fn what_is_written_is_read_back_to_the_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        for nu in [[3.0, 30.0], [f64::INFINITY; 2]] {
            for confidence in [None, Some(vec![0.25, 1.0])] {
                write(&path, &primitives(nu), confidence.as_deref(), &Frame::default()).unwrap();
                assert_eq!(read(&path).unwrap(), (primitives(nu), confidence));
            }
        }
    }

    #[test]
    fn the_header_says_what_the_values_are_and_no_viewer_of_splats_knows_the_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        let frame = Frame { unit: Some(Unit::Millimetre), ..Frame::scaled(0.01) };
        write(&path, &primitives([3.0, 30.0]), Some(&[0.0, 1.0]), &frame).unwrap();
        let content = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
        let (header, _) = content.split_once("end_header").unwrap();
        assert!(header.contains("comment primitives of trgs: physical values"), "{header}");
        assert!(header.contains("1 mm is 0.01 scene units"), "{header}");
        assert!(header.contains("format binary_little_endian 1.0") && header.contains("element vertex 2"), "{header}");
        for name in ["double nu", "double confidence", "uchar red"] {
            let alias = name.replace("double", "float64").replace("uchar", "uint8");
            assert!(
                header.contains(&format!("property {name}")) || header.contains(&format!("property {alias}")),
                "{header}"
            );
        }
        assert!(!header.contains("scale_0") && !header.contains("rot_0") && !header.contains("opacity"), "{header}");
    }

    #[test]
    fn any_order_type_and_encoding_is_read_and_other_elements_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        let text = "ply\nformat ascii 1.0\ncomment by hand\nelement edge 1\nproperty list uchar int ends\nelement vertex 1\n\
                    property uchar red\nproperty float density\nproperty float x\nproperty float y\nproperty float z\n\
                    property float scale_z\nproperty float scale_y\nproperty float scale_x\nproperty int rotation_w\n\
                    property int rotation_x\nproperty int rotation_y\nproperty int rotation_z\nend_header\n\
                    2 0 1\n7 0.5 1 2 3 0.25 0.125 4 1 0 0 -1\n";
        std::fs::write(&path, text).unwrap();
        let (found, confidence) = read(&path).unwrap();
        assert_eq!((found.kernel, confidence), (KernelKind::Gaussian, None));
        let p = found.parameters;
        assert_eq!((p.mean[0], p.scale[0]), ([1.0, 2.0, 3.0], [4.0, 0.125, 0.25]));
        assert_eq!((p.quaternion[0], p.density[0]), ([1.0, 0.0, 0.0, -1.0], 0.5));
    }

    #[test]
    fn splats_and_meshes_are_refused_with_what_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.ply");
        let refused = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read(&path).unwrap_err().to_string()
        };
        let head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
        let message = refused(&format!("{head}property float scale_0\nend_header\n0 0 0 1\n"));
        assert!(message.contains("scale_x") && message.contains("3D Gaussian splatting"), "{message}");
        assert!(refused("ply\nformat ascii 1.0\nend_header\n").contains("no vertices"));
        let message = refused("ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n");
        assert!(message.contains("99999999999"), "{message}");
    }
}
