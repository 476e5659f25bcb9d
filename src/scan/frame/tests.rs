//! Units, the key of descriptions, and volumes of other axes.

use super::*;
use ndarray::{Array3, Axis};

/// A grid whose axes differ in everything, and an oblique, left-handed frame in micrometres.
fn scan() -> (Volume, Frame) {
    let grid = Grid { shape: [4, 5, 7], min: DVec3::new(-0.8, -0.9, -1.0), spacing: DVec3::new(0.4, 0.3, 0.28) };
    let turn = DMat3::from_quat(glam::DQuat::from_xyzw(0.5, -0.1, 0.7, 0.5).normalize());
    let directions = turn * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
    let values = Array3::from_shape_fn((4, 5, 7), |(x, y, z)| (100 * x + 10 * y + z) as f32);
    let origin = DVec3::new(300.0, -2000.0, 77.0);
    (Volume { grid, values }, Frame { unit: Some(Unit::Micrometre), scale: 0.004, origin, directions })
}

/// The same volume with its axes in another order, some of them reversed.
fn turned(file: &VolumeFile, order: [usize; 3], reversed: [bool; 3]) -> VolumeFile {
    let mut values = file.values.view().permuted_axes(order);
    let (mut spacing, mut columns) = ([0.0; 3], [DVec3::ZERO; 3]);
    let mut origin = file.origin.unwrap();
    for (axis, &from) in order.iter().enumerate() {
        (spacing[axis], columns[axis]) = (file.spacing.unwrap()[from], file.directions.col(from));
        if reversed[axis] {
            values.invert_axis(Axis(axis));
            origin += columns[axis] * spacing[axis] * (values.len_of(Axis(axis)) - 1) as f64;
            columns[axis] = -columns[axis];
        }
    }
    let directions = DMat3::from_cols(columns[0], columns[1], columns[2]);
    let values = values.as_standard_layout().into_owned();
    VolumeFile { values, spacing: Some(spacing.into()), origin: Some(origin), directions, ..file.clone() }
}

#[test]
fn a_volume_of_any_axes_comes_back_to_those_of_the_scan() {
    let (volume, frame) = scan();
    let file = frame.file(&volume);
    for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
        for signs in 0..8 {
            let reversed = [0, 1, 2].map(|axis| signs >> axis & 1 == 1);
            let other = turned(&file, order, reversed);
            let (found, remarks) = frame.arrange(other.clone(), &volume.grid).unwrap();
            assert_eq!(found, volume, "{order:?} {reversed:?}");
            let mut stored = frame.arrange_stored(other.clone().into(), &volume.grid).unwrap();
            assert_eq!(*stored.metadata(), VolumeFile { oddities: remarks.clone(), ..frame.metadata(&volume.grid) });
            for axis in 0..3 {
                let slab = stored.slab(axis, 1..3).unwrap();
                assert_eq!(slab, volume.values.slice_axis(Axis(axis), (1..3).into()), "{order:?} {reversed:?}");
            }
            assert_eq!(stored.whole().unwrap().values, volume.values);
            assert_eq!(remarks.is_empty(), order == [0, 1, 2] && signs == 0, "{order:?} {reversed:?}: {remarks:?}");
            // A file without a unit may have its lengths in another one.
            let unstated = VolumeFile {
                unit: None,
                spacing: other.spacing.map(|spacing| spacing * 25.4),
                origin: other.origin.map(|origin| origin * 25.4),
                ..other
            };
            assert_eq!(frame.arrange(unstated, &volume.grid).unwrap().0, volume, "{order:?} {reversed:?}");
        }
    }
}

#[test]
fn values_per_unit_of_the_file_become_those_per_unit_of_the_scan() {
    let (volume, frame) = scan();
    let mut file = turned(&frame.file(&volume), [2, 0, 1], [true, false, false]);
    file.unit = Some(Unit::Millimetre);
    (file.spacing, file.origin) = (file.spacing.map(|s| s / 1000.0), file.origin.map(|o| o / 1000.0));
    file.values *= 1000.0;
    let (found, remarks) = frame.arrange(file.clone(), &volume.grid).unwrap();
    assert_eq!(found, volume);
    assert_eq!(frame.arrange_stored(file.clone().into(), &volume.grid).unwrap().whole().unwrap().values, volume.values);
    for damaged in [
        VolumeFile { values: Array3::from_elem(file.values.dim(), f32::NAN), ..file.clone() },
        VolumeFile { values: Array3::zeros((4, 4, 4)), ..file },
    ] {
        let message = frame.arrange(damaged.clone(), &volume.grid).unwrap_err().to_string();
        assert_eq!(frame.arrange_stored(damaged.into(), &volume.grid).err().unwrap().to_string(), message);
    }
    assert!(remarks[1].contains("values per mm are multiplied by 0.001"), "{remarks:?}");
}

#[test]
fn a_volume_of_another_grid_is_refused_or_remarked_on() {
    let (volume, frame) = scan();
    let file = frame.file(&volume);
    let arranged = |file: VolumeFile| frame.arrange(file, &volume.grid).map_err(|error| error.to_string());
    let voxel = frame.directions * (DVec3::X * file.spacing.unwrap().x);
    let shifted = |file: &VolumeFile, voxels: f64| VolumeFile {
        origin: file.origin.map(|origin| origin + voxel * voxels),
        ..file.clone()
    };
    assert_eq!(arranged(shifted(&file, 0.4)).unwrap(), (volume.clone(), Vec::new()));
    let (found, remarks) = arranged(shifted(&file, 0.6)).unwrap();
    assert!(found == volume && remarks[0].contains("its middle is at"), "{remarks:?}");
    let longer = VolumeFile { spacing: file.spacing.map(|s| s * DVec3::new(1.0, 1.0, 1.5)), ..file.clone() };
    assert!(arranged(longer).unwrap().1[0].contains("its spacing"));
    let mirrored = turned(&file, [0, 1, 2], [true, false, false]);
    for (wrong, part) in [
        (shifted(&mirrored, 0.6), "the array is turned to them, but its middle"),
        (VolumeFile { directions: frame.directions * DMat3::from_rotation_z(0.5), ..file.clone() }, "oblique"),
        (VolumeFile { values: file.values.clone().permuted_axes([1, 0, 2]), ..file.clone() }, "shape [5, 4, 7]"),
    ] {
        let message = arranged(wrong).unwrap_err();
        assert!(message.contains(part), "{message}");
    }
    // An array that states nothing is in the order of the scan.
    let bare = VolumeFile { values: volume.values.clone(), ..VolumeFile::default() };
    assert_eq!(arranged(bare).unwrap(), (volume.clone(), Vec::new()));
}

#[test]
fn the_frame_of_a_description_is_read_again_and_checked() {
    let (_, frame) = scan();
    let read = |text: &str, stated: &[&str], scale: f64| {
        serde_json::from_str::<FrameMeta>(text).unwrap().frame(stated, scale).map_err(|error| error.to_string())
    };
    let text = serde_json::to_string(&FrameMeta::of(&frame).unwrap()).unwrap();
    assert_eq!(read(&text, &[], 1.0), Ok(frame));
    assert_eq!(FrameMeta::of(&Frame::default()), None);
    let metres = Frame { unit: Some(Unit::Metre), ..Frame::scaled(20.0) };
    assert_eq!(read("{}", &["m", "Metre"], 20.0), Ok(metres));
    for (text, stated, part) in [
        ("{}", &["furlong"][..], "nm, um, mm, cm, m or in"),
        (r#"{"unit": "mm"}"#, &["um"], "got mm and um"),
        (r#"{"scene_units_per_unit": 0.5}"#, &[], "20 = 2/max(sVoxel)"),
        (r#"{"scene_units_per_unit": -1}"#, &[], "a positive number"),
        (r#"{"directions": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}"#, &[], "three perpendicular unit vectors"),
    ] {
        let message = read(text, stated, 20.0).unwrap_err();
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn units_are_known_by_symbols_and_names() {
    for (name, unit) in
        [("mm", Unit::Millimetre), ("µm", Unit::Micrometre), ("\"Micron\"", Unit::Micrometre), ("M", Unit::Metre)]
    {
        assert_eq!(Unit::named(name), Some(unit), "{name}");
    }
    assert_eq!(Unit::named("pixel"), None);
    for (unit, symbol, ..) in Unit::ALL {
        assert_eq!(symbol.parse::<Unit>().unwrap(), unit);
    }
}
