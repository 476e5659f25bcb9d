//! The pickle of NAF and SAX-NeRF: a whole scan in one file.
//!
//! Lengths are in millimetres, but line integrals are density times metres (a property of the format), so lengths are
//! divided by 1000. Rows are stored from the top, as in this project.

use super::fields::{self, SCANNER_FIELDS};
use super::meta::{Interpreted, ScannerMeta};
use super::pickle::{self, Array, Value};
use super::poses::Motion;
use super::{Dataset, check_finite};
use crate::frame::Frame;
use crate::limit;
use crate::noise::Noise;
use crate::unit::Unit;
use ndarray::Array3;
use serde_json::json;
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Scanner, Trajectory, Volume};

/// Millimetres to metres.
const METRE: f64 = 1e-3;
/// Photons of the generator's noise; the file states only the electronic noise.
const PHOTONS: f64 = 1e5;

/// Whether a path names a pickle, judged by its extension.
pub(super) fn is_pickle(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "pickle" || extension == "pkl")
}

/// Reads a scan from a pickle.
pub(super) fn read(path: &Path) -> Result<Dataset> {
    let content = crate::input::read(path).map_err(|source| Error::read(path, source))?;
    // The bytes, their numbers in double precision, and the scan.
    limit::allow("pickle", 5 * content.len() as u64).map_err(|error| error.in_file(path))?;
    parse(&content, path)
}

/// Reads a scan from the content of a pickle.
pub(super) fn parse(content: &[u8], path: &Path) -> Result<Dataset> {
    interpret(&pickle::parse(content, path)?, path)
}

fn interpret(data: &Value, path: &Path) -> Result<Dataset> {
    if data.get("xyz").is_some() {
        let remedy = "this is a model, not a scan: trgs convert writes it as .npz or .ply";
        return Err(Error::format(path, "pickle", "a point cloud of R²-Gaussian", "a scan", remedy));
    }
    let unread = unread(data).map_err(|error| error.in_file(path))?;
    let Interpreted { scanner, scale, motion, mut oddities, .. } =
        scanner_fields(data).and_then(|meta| meta.interpret()).map_err(|error| error.in_file(path))?;
    oddities.extend(unread);
    let train = data.get("train").ok_or_else(|| missing(path, "train"))?;
    let others = ["val", "test"].into_iter().find_map(|key| Some((key, data.get(key)?)));
    let counts = [Some(train), others.map(|(_, part)| part)]
        .map(|part| part.and_then(|part| part.get("angles")?.numbers()).map_or(0, |angles| angles.len()));
    motion.fits(counts[0], counts[1]).map_err(|error| error.in_file(path))?;
    let of = |part: &Value, key: &str, first: usize| views(part, key, &scanner, scale, (&motion, first), path);
    let train = of(train, "train", 0)?;
    let test = others.map(|(key, part)| of(part, key, train.len())).transpose()?;
    let truth = match data.get("image") {
        None | Some(Value::None) => None,
        Some(image) => {
            let values = volume(image).ok_or_else(|| missing(path, "image [x, y, z]"))?;
            check_finite(path, "image", values.view())?;
            Some(Volume::new(scanner.grid, values).map_err(|error| error.in_file(path))?)
        }
    };
    let sigma = data.get("noise").and_then(Value::number).filter(|sigma| *sigma > 0.0);
    let noise = sigma.map_or(Noise::None, |sigma| Noise::relative(PHOTONS, sigma));
    if sigma.is_some() && test.is_some() {
        oddities.push("the test views have the noise of the training views".into());
    }
    let name = path.file_stem().map_or_else(|| "scan".into(), |stem| stem.to_string_lossy().into_owned());
    let frame = Frame { unit: Some(Unit::Metre), ..Frame::scaled(scale) };
    Ok(Dataset { scale, frame, noise, test, truth, oddities, ..Dataset::new(name, scanner, train) })
}

/// The scanner's fields in metres, with the total sizes that the format leaves out.
fn scanner_fields(data: &Value) -> Result<ScannerMeta> {
    let numbers = |key: &str, unit: f64| {
        data.get(key).and_then(Value::numbers).map(|values| values.into_iter().map(|x| x * unit).collect::<Vec<_>>())
    };
    // One number for all views or one for each; the same of arrays.
    let any = |key: &str, unit: f64| match data.get(key) {
        None | Some(Value::None) => Ok(serde_json::Value::Null),
        Some(value) => nested(value, unit).ok_or_else(|| {
            let expected = "finite numbers, or such numbers for each view";
            Error::invalid(key, "something else", expected, "write the file again with plain numbers")
        }),
    };
    let size = |count: &str, pitch: &str| {
        let (counts, pitches) = (numbers(count, 1.0)?, numbers(pitch, METRE)?);
        Some(counts.iter().zip(&pitches).map(|(n, d)| n * d).collect::<Vec<_>>())
    };
    let mode = match data.get("mode") {
        Some(Value::Text(mode)) => mode.as_str(),
        _ => "cone",
    };
    let fields = json!({
        "mode": mode,
        "DSD": any("DSD", METRE)?,
        "DSO": any("DSO", METRE)?,
        "nDetector": numbers("nDetector", 1.0).unwrap_or_default(),
        "sDetector": numbers("sDetector", METRE).or_else(|| size("nDetector", "dDetector")).unwrap_or_default(),
        "dDetector": numbers("dDetector", METRE),
        "nVoxel": numbers("nVoxel", 1.0).unwrap_or_default(),
        "sVoxel": numbers("sVoxel", METRE).or_else(|| size("nVoxel", "dVoxel")).unwrap_or_default(),
        "dVoxel": numbers("dVoxel", METRE),
        "offOrigin": any("offOrigin", METRE)?,
        "offDetector": any("offDetector", METRE)?,
        "COR": any("COR", METRE)?,
        "rotDetector": any("rotDetector", 1.0)?,
        "vectors": any("vectors", METRE)?,
    });
    serde_json::from_value(fields).map_err(|error| {
        let expected = "nDetector, dDetector, nVoxel, dVoxel, DSD and DSO as numbers";
        Error::invalid("fields of the scanner", error, expected, "write the file again with NAF's generator")
    })
}

/// A number, or lists of numbers, times a unit; `None` for anything else.
fn nested(value: &Value, unit: f64) -> Option<serde_json::Value> {
    let number = |x: f64| x.is_finite().then(|| json!(x * unit));
    match value {
        Value::List(values) => values.iter().map(|value| nested(value, unit)).collect(),
        Value::Array(Array { shape, values }) => match shape.as_slice() {
            [] => number(*values.first()?),
            [_] => values.iter().map(|&x| number(x)).collect(),
            &[_, n] if n > 0 => {
                let row = |row: &[f64]| row.iter().map(|&x| number(x)).collect::<Option<serde_json::Value>>();
                values.chunks_exact(n).map(row).collect()
            }
            _ => None,
        },
        value => number(value.number()?),
    }
}

/// Remarks on the fields that are not read.
fn unread(data: &Value) -> Result<Vec<String>> {
    const PARTS: [&str; 4] = ["image", "train", "val", "test"];
    // Matrices depend on the unit, which differs between lengths and projections here.
    let scanner: Vec<&str> = SCANNER_FIELDS.into_iter().filter(|name| *name != "matrices").collect();
    let of = |place: &str, value: &Value, read: &[&str]| {
        fields::unread(place, value.fields().map(|(name, value)| (name, is_neutral(value))), read)
    };
    let mut remarks = of("the pickle", data, &[&scanner[..], &PARTS, &fields::OF_GENERATORS].concat())?;
    for part in &PARTS[1..] {
        if let Some(value) = data.get(part) {
            remarks.extend(of(part, value, &["angles", "projections"])?);
        }
    }
    Ok(remarks)
}

/// The same as [`fields::is_neutral`] of a pickle's value.
fn is_neutral(value: &Value) -> bool {
    match value {
        Value::None => true,
        Value::Bool(value) => !value,
        Value::Integer(value) => *value == 0,
        Value::Float(value) => *value == 0.0,
        Value::Text(text) => text.is_empty(),
        Value::Bytes(bytes) => bytes.is_empty(),
        Value::List(values) => values.iter().all(is_neutral),
        Value::Dictionary(pairs) => pairs.iter().all(|(_, value)| is_neutral(value)),
        Value::Array(array) => array.values.iter().all(|value| *value == 0.0),
        Value::Unknown(_) => false,
    }
}

fn views(
    part: &Value,
    key: &str,
    scanner: &Scanner,
    scale: f64,
    (motion, first): (&Motion, usize),
    path: &Path,
) -> Result<Projections> {
    let angles = part.get("angles").and_then(Value::numbers).ok_or_else(|| missing(path, &format!("{key}.angles")))?;
    let Some(Value::Array(Array { shape, values })) = part.get("projections") else {
        return Err(missing(path, &format!("{key}.projections")));
    };
    let expected = [angles.len(), scanner.detector.rows, scanner.detector.columns];
    if shape[..] != expected {
        let expected = format!("{expected:?} = [view, v, u], from angles and nDetector");
        return Err(Error::format(
            path,
            format!("{key}.projections"),
            format!("shape {shape:?}"),
            expected,
            "correct nDetector, or transpose the projections to [view, v, u]",
        ));
    }
    let values = values.iter().map(|value| (value * scale) as f32).collect();
    let images =
        Array3::from_shape_vec((expected[0], expected[1], expected[2]), values).expect("the shape was checked");
    check_finite(path, &format!("{key}.projections"), images.view())?;
    let poses = motion.poses(first..first + angles.len(), &angles);
    let trajectory = Trajectory { angles: &angles, poses: poses.as_deref() };
    let checked = trajectory.validate(scanner).and_then(|()| Projections::along(trajectory, images));
    checked.map_err(|error| error.in_file(path))
}

fn volume(image: &Value) -> Option<Array3<f32>> {
    let Value::Array(Array { shape, values }) = image else { return None };
    let &[x, y, z] = shape.as_slice() else { return None };
    Array3::from_shape_vec((x, y, z), values.iter().map(|&value| value as f32).collect()).ok()
}

fn missing(path: &Path, what: &str) -> Error {
    let expected = "a scan of NAF or SAX-NeRF: scanner, image, train and val with angles and projections";
    Error::format(path, what, "nothing of that kind", expected, "write the file again with NAF's generator")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::{largest, relative};
    use glam::DVec3;
    use trgs_core::geometry::Beam;

    fn sample(protocol: u8) -> &'static [u8] {
        match protocol {
            2 => include_bytes!("../../../tests/data/naf_2.pickle"),
            3 => include_bytes!("../../../tests/data/naf_3.pickle"),
            4 => include_bytes!("../../../tests/data/naf_4.pickle"),
            _ => include_bytes!("../../../tests/data/naf_5.pickle"),
        }
    }

    fn parsed(content: &[u8]) -> Result<Dataset> {
        parse(content, Path::new("scan.pickle"))
    }

    #[test]
    fn all_protocols_hold_the_same_scan() {
        let expected = parsed(sample(5)).unwrap();
        for protocol in 2..=4 {
            assert_eq!(parsed(sample(protocol)).unwrap(), expected, "protocol {protocol}");
        }
    }

    #[test]
    fn lengths_are_millimetres_and_line_integrals_metres() {
        // 4 × 5 × 6 voxels of 20 mm: the longest side is 0.12 m, so a metre is 2/0.12 scene units.
        let scan = parsed(sample(4)).unwrap();
        let metre = 2.0 / 0.12;
        within!(relative(scan.scale, metre));
        assert_eq!(scan.scanner.grid.shape, [4, 5, 6]);
        within!(relative(scan.scanner.grid.spacing.x, 0.02 * metre));
        let Beam::Cone { dso, dsd } = scan.scanner.beam else { panic!("a cone") };
        within!(relative(dso, 0.5 * metre));
        within!(relative(dsd, 0.7 * metre));
        let detector = scan.scanner.detector;
        assert_eq!((detector.rows, detector.columns), (3, 7));
        within!(relative(detector.pitch_v, 0.05 * metre));
        within!(relative(detector.pitch_u, 0.04 * metre));
        within!(relative(detector.offset_u, 0.002 * metre));
        within!(relative(scan.scanner.grid.min.x, (0.001 - 0.04) * metre));
        // The generator's values are 0.01 times the number of the element.
        assert_eq!(scan.train.angles, [0.0, 1.5]);
        within!("f32", relative(f64::from(scan.train.images[[1, 2, 3]]), 0.01 * 38.0 * metre));
        assert_eq!(scan.test.unwrap().angles, [0.25]);
        assert_eq!(scan.truth.unwrap().values[[1, 2, 3]], 45.0 / 120.0);
        assert_eq!(scan.noise, Noise::relative(1e5, 2.0));
        within!(largest((scan.scanner.grid.size() - DVec3::new(0.08, 0.1, 0.12) * metre).to_array()));
    }

    #[test]
    fn a_pickle_that_calls_something_is_refused_and_not_run() {
        // cos.system('true') as protocols 0 and 4 write it.
        for content in [&b"cos\nsystem\n(S'true'\ntR."[..], b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x04true\x85R."] {
            let message = parsed(content).unwrap_err().to_string();
            assert!(message.contains("os.system"), "{message}");
        }
    }

    #[test]
    fn damaged_pickles_are_errors() {
        let whole = sample(4);
        for length in 0..whole.len() {
            parsed(&whole[..length]).unwrap_err();
        }
        let deep: Vec<u8> = [b"\x80\x04N".as_slice(), &b"\x85".repeat(1_000_000), b"."].concat();
        let message = parsed(&deep).unwrap_err().to_string();
        assert!(message.contains("2000 lists"), "{message}");
        // A list of ten of a list of ten of …: small, and large.
        let mut bomb = b"\x80\x04]q\x00".to_vec();
        for level in 1..12 {
            bomb.extend(b"](");
            (0..10).for_each(|_| bomb.extend([b'h', level - 1]));
            bomb.extend([b'e', b'q', level]);
        }
        bomb.push(b'.');
        assert!(pickle::parse(&bomb, Path::new("bomb")).unwrap_err().to_string().contains("large object"));
    }
}
