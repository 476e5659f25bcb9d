use super::super::volume_file::VolumeFile;
use super::*;
use std::f64::consts::PI;
use trgs_core::geometry::{Beam, Detector, Grid, Scanner};

fn frames() -> Array3<f32> {
    Array3::from_shape_fn((3, 4, 5), |(view, v, u)| (100 * view + 10 * v + u) as f32)
}

fn description() -> Description {
    let detector = Detector { rows: 4, columns: 5, pitch_v: 0.5, pitch_u: 0.5, offset_u: 0.0, offset_v: 0.0 };
    let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(4) };
    Description::new(scanner, 0.02, Some((0.5, PI)))
}

#[test]
fn a_stack_is_the_same_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    npy::write(&at("a.npy"), frames().view()).unwrap();
    // Views are the third axis of a volume file.
    let values = frames().reversed_axes().as_standard_layout().into_owned();
    let volume = VolumeFile { values, ..VolumeFile::default() };
    for name in ["a.tif", "a.mha", "a.nii.gz", "a_5x4x3_float32.raw"] {
        volume_file::write(at(name), &volume).unwrap();
    }
    for sub in ["npy", "tif"] {
        std::fs::create_dir(at(sub)).unwrap();
    }
    for (view, frame) in frames().outer_iter().enumerate() {
        let name = format!("f{}", [2, 10, 100][view]);
        npy::write(&at("npy").join(&name).with_extension("npy"), frame).unwrap();
        let values = frame.to_owned().reversed_axes().insert_axis(Axis(2));
        let page = VolumeFile { values, ..volume.clone() };
        volume_file::write(at("tif").join(&name).with_extension("tif"), &page).unwrap();
    }
    for name in ["a.npy", "a.tif", "a.mha", "a.nii.gz", "a_5x4x3_float32.raw", "npy", "tif"] {
        let found = read(at(name)).unwrap();
        assert_eq!(found, frames(), "{name}");
        assert!(found.is_standard_layout(), "{name}");
    }
    assert_eq!(read(at("npy/f10.npy")).unwrap(), frames().select(Axis(0), &[1]));
    npy::write(&at("npy/f3.npy"), Array3::<f32>::zeros((1, 4, 4)).index_axis(Axis(0), 0)).unwrap();
    assert!(read(at("npy")).unwrap_err().to_string().contains("f3.npy: frame: got shape [4, 4]"));
}

#[test]
fn lengths_scale_line_integrals_and_flips_turn_frames_into_place() {
    let angles = vec![0.0, 0.5, 1.5];
    let plain = scan("a", &description(), frames(), angles.clone(), Orientation::default()).unwrap();
    assert_eq!(plain.train.angles, angles);
    assert_eq!(plain.train.images, frames().mapv(|value| (f64::from(value) * 0.02) as f32));
    let orientation = Orientation { flip_rows: true, flip_columns: false, clockwise: true };
    let turned = scan("a", &description(), frames(), angles.clone(), orientation).unwrap();
    assert_eq!(turned.train.angles, [-0.0, -0.5, -1.5]);
    assert_eq!(turned.train.images[[1, 0, 2]], plain.train.images[[1, 3, 2]]);
    let orientation = Orientation { flip_columns: true, ..Orientation::default() };
    let turned = scan("a", &description(), frames(), angles, orientation).unwrap();
    assert_eq!(turned.train.images[[1, 0, 0]], plain.train.images[[1, 0, 4]]);
}

#[test]
fn what_does_not_fit_the_scanner_is_an_error_that_names_it() {
    let refused = |frames: Array3<f32>, angles: usize| {
        scan("a", &description(), frames, vec![0.0; angles], Orientation::default()).unwrap_err().to_string()
    };
    assert!(refused(frames().reversed_axes(), 5).contains("got 4 rows × 3 columns, expected 4 × 5 = nDetector"));
    assert!(refused(frames(), 4).contains("got 4, expected one for each of 3 frames"));
    let mut damaged = frames();
    damaged[[2, 0, 1]] = f32::INFINITY;
    assert!(refused(damaged, 3).contains("inf at (2, 0, 1)"));
}

#[test]
fn the_span_of_the_views_is_a_sentence() {
    assert_eq!(span(&Scanner::uniform_angles(12, 0.0, 2.0 * PI)), "12 views from 0.00° to 330.00°, in steps of 30.00°");
    assert_eq!(span(&[0.0, -PI / 2.0, -PI / 4.0]), "3 views from 0.00° to -45.00°, in steps of -90.00° to 45.00°");
    assert_eq!(span(&[PI]), "1 view at 180.00°");
}

#[test]
fn angles_come_from_a_list_a_file_or_the_arc() {
    let mut description = description();
    assert_eq!(description.angles(2).unwrap(), [0.5, 0.5 + PI / 2.0]);
    description.listed = vec![0.1, 0.7];
    assert_eq!(description.angles(2).unwrap(), [0.1, 0.7]);
    assert!(description.angles(3).unwrap_err().to_string().contains("2 views in proj_train"));
    (description.listed, description.arc) = (Vec::new(), None);
    assert!(description.angles(3).unwrap_err().to_string().contains("totalAngle"));

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("angles.txt");
    std::fs::write(&path, "# of the table\r\n0, 90;-45.5\n\n1e1 # the last\n").unwrap();
    assert_eq!(read_angles(&path, false).unwrap(), [0.0, 90.0, -45.5, 10.0]);
    assert_eq!(read_angles(&path, true).unwrap()[1], PI / 2.0);
    let array = folder.path().join("angles.npy");
    npy::write(&array, ndarray::arr1(&[0.25, 0.5]).view()).unwrap();
    assert_eq!(read_angles(&array, false).unwrap(), [0.25, 0.5]);
    std::fs::write(&path, "0\nninety\n").unwrap();
    let message = read_angles(&path, false).unwrap_err().to_string();
    assert!(message.contains("line 2: got ninety"), "{message}");
}
