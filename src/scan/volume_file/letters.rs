//! The phantom `letters` in every format that states a place: the letters are on the same sides for every reader.

use super::{Slices, VolumeFile, read, write, write_slices};
use crate::{Frame, Phantom};
use glam::{DMat3, DVec3};
use serde_json::{Value, json};
use std::io::Write;
use std::path::PathBuf;
use std::process::Command;
use trgs_core::geometry::Grid;

/// The rows of the letters on the right, front and upper side of the phantom `letters`, where a reader sees them.
fn rows(file: &VolumeFile) -> Value {
    let (spacing, origin) = (file.spacing.unwrap(), file.origin.unwrap());
    let is_letter = |point: DVec3| {
        let index = (file.directions.transpose() * (point - origin) / spacing).round();
        // Letters have a density of 0.9, the cube of 0.3.
        file.values[[index.x as usize, index.y as usize, index.z as usize]].round() == 1.0
    };
    let sides = [(DVec3::NEG_X, DVec3::Z), (DVec3::NEG_Y, DVec3::Z), (DVec3::Z, DVec3::NEG_Y)];
    let of_side = |(side, up): (DVec3, DVec3)| {
        let at = |row: i32, column: i32| {
            let place = up.cross(side) * f64::from(column - 2) + up * f64::from(3 - row);
            if is_letter(0.65 * side + 0.12 * place) { '#' } else { '.' }
        };
        (0..7).map(|row| (0..5).map(|column| at(row, column)).collect()).collect::<Vec<String>>()
    };
    json!(sides.map(of_side))
}

/// The letters as SimpleITK, nibabel and pydicom see them, or `None` with a message without these. A CI server must have them.
fn seen_by_others(paths: &[PathBuf]) -> Option<Value> {
    let program = std::env::var("TRGS_PYTHON").unwrap_or_else(|_| "python3".into());
    let imports = "import imagecodecs, nibabel, nrrd, plyfile, pydicom, SimpleITK, tifffile, trimesh";
    if !Command::new(&program).args(["-c", imports]).output().is_ok_and(|out| out.status.success()) {
        assert!(std::env::var_os("CI").is_none(), "{program} lacks packages; set TRGS_PYTHON");
        let remark =
            format!("SKIPPED: {program} lacks packages of reference/formats/requirements.txt; set TRGS_PYTHON\n");
        std::io::stderr().write_all(remark.as_bytes()).unwrap();
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../reference/formats/others.py");
    let output = Command::new(program).arg(script).arg("letters").args(paths).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn letters_are_on_their_sides_in_every_format_and_for_every_reader() {
    let expected = json!([
        ["####.", "#...#", "#...#", "####.", "#.#..", "#..#.", "#...#"],
        [".###.", "#...#", "#...#", "#####", "#...#", "#...#", "#...#"],
        [".####", "#....", "#....", ".###.", "....#", "....#", "####."],
    ]);
    let volume = Phantom::by_name("letters", 0).unwrap().voxelize(&Grid::cube(50), 1);
    let straight = Frame::default().file(&volume);
    // The first axis runs to the front, the second to the head, the third to the left.
    let mut values = straight.values.clone().permuted_axes([1, 2, 0]);
    values.invert_axis(ndarray::Axis(0));
    let turned = VolumeFile {
        values: values.as_standard_layout().into_owned(),
        directions: DMat3::from_cols(DVec3::NEG_Y, DVec3::Z, DVec3::X),
        origin: straight.origin.map(|origin| origin * DVec3::new(1.0, -1.0, 1.0)),
        ..straight.clone()
    };
    let folder = tempfile::tempdir().unwrap();
    let mut paths = Vec::new();
    for (name, file) in [("straight", &straight), ("turned", &turned)] {
        for ending in ["nii", "nii.gz", "mha", "nrrd"] {
            paths.push(folder.path().join(format!("{name}.{ending}")));
            write(paths.last().unwrap(), file).unwrap();
        }
        paths.push(folder.path().join(format!("{name}_dicom")));
        std::fs::create_dir(paths.last().unwrap()).unwrap();
        write_slices(paths.last().unwrap(), file, Slices::Dicom).unwrap();
    }
    for path in &paths {
        assert_eq!(rows(&read(path).unwrap()), expected, "{}", path.display());
    }
    let Some(seen) = seen_by_others(&paths) else { return };
    for path in paths {
        let seen = seen[path.to_str().unwrap()].as_object().unwrap();
        for (who, part) in [("nibabel", ".nii"), ("pydicom", "_dicom")] {
            assert_eq!(seen.contains_key(who), path.to_string_lossy().contains(part));
        }
        seen.iter().for_each(|(who, found)| assert_eq!(*found, expected, "{who}, {}", path.display()));
    }
}
