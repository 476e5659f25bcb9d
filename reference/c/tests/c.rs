//! The header is that of the code, and a program in C gets the bits of the library and its errors.

use ndarray::{Array1, Array3};
use std::collections::HashMap;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::primitives::{Group, Parameters, Primitives};
use trgs::projector::{self, Projection};
use trgs::scan::model;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
const ANGLES: [f64; 2] = [0.0, 0.7];
const SCANNER: &str = r#"{ "scanner": { "mode": "cone", "DSD": 7.0, "DSO": 5.0, "nDetector": [5, 6],
    "sDetector": [3.5, 3.6], "nVoxel": [4, 4, 4], "sVoxel": [2.0, 2.0, 2.0] } }"#;

#[test]
fn the_header_is_that_of_the_code() {
    let config = cbindgen::Config::from_root_or_default(ROOT);
    let mut header = Vec::new();
    cbindgen::generate_with_config(ROOT, config).expect("a header").write(&mut header);
    let path = Path::new(ROOT).join("trgs.h");
    if env::var_os("TRGS_WRITE").is_some() {
        fs::write(&path, &header).unwrap();
    }
    let written = fs::read(&path).unwrap_or_default();
    let remedy = "run: TRGS_WRITE=1 cargo test --profile checked --package trgs-c";
    assert!(written == header, "trgs.h is not that of src/lib.rs; {remedy}");
}

fn primitives(nu: [f64; 3]) -> Primitives {
    let parameters = Parameters {
        mean: vec![[0.1, -0.2, 0.3], [-0.4, 0.25, 0.0], [0.0, 0.0, -0.35]],
        scale: vec![[0.2, 0.3, 0.25], [0.15, 0.1, 0.4], [0.3, 0.3, 0.3]],
        quaternion: vec![[1.0, 0.0, 0.0, 0.0], [0.5, -0.5, 0.25, 1.0], [2.0, 0.1, 0.0, 0.0]],
        density: vec![1.0, 0.5, 2.0],
        nu: nu.to_vec(),
    };
    Primitives::new(parameters).unwrap()
}

/// The program, compiled for the library of this build.
fn program(folder: &Path) -> PathBuf {
    let libraries = env::current_exe().unwrap().parent().unwrap().to_path_buf();
    let program = folder.join("program");
    let compiler = env::var("CC").unwrap_or_else(|_| "cc".into());
    let output = Command::new(&compiler)
        .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-I", ROOT])
        .arg(Path::new(ROOT).join("tests/program.c"))
        .arg("-o")
        .arg(&program)
        .arg("-L")
        .arg(&libraries)
        .arg(format!("-Wl,-rpath,{}", libraries.display()))
        .args(["-ltrgs_c", "-lm"])
        .output()
        .unwrap_or_else(|error| panic!("{compiler}: {error}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    program
}

/// What the program printed.
struct Printed {
    /// A line's name → the bits of its numbers; those of a gradient have its name before the group's.
    numbers: HashMap<String, Vec<u64>>,
    lines: Vec<String>,
}

impl Printed {
    fn new(text: &str) -> Self {
        let bits = |number: &str| u64::from_str_radix(&number[2..], 16).unwrap();
        let (mut numbers, mut gradient) = (HashMap::new(), "");
        for line in text.lines().filter(|line| !line.starts_with("error") && !line.starts_with("version")) {
            let (name, values) = line.split_once(' ').unwrap_or((line, ""));
            if name.contains("vjp") {
                gradient = name;
            } else if values.contains("0x") {
                let is_group = Group::ALL.iter().any(|group| group.key() == name);
                let name = if is_group { format!("{gradient} {name}") } else { name.into() };
                numbers.insert(name, values.split(' ').map(bits).collect());
            }
        }
        Self { numbers, lines: text.lines().map(str::to_owned).collect() }
    }

    fn expect(&self, name: &str, values: impl IntoIterator<Item = f64>) {
        let values: Vec<u64> = values.into_iter().map(f64::to_bits).collect();
        assert_eq!(self.numbers[name], values, "{name}");
        assert!(values.iter().any(|&bits| bits != 0), "{name}: zeros");
    }

    fn expect_gradient(&self, name: &str, gradient: &Parameters) {
        for group in Group::ALL {
            self.expect(&format!("{name} {}", group.key()), gradient.group(group).iter().copied());
        }
    }
}

#[test]
fn a_program_in_c_gets_the_bits_of_the_library() {
    let folder = tempfile::tempdir().unwrap();
    let (student, gaussian) = (primitives([3.0, 8.0, 40.0]), primitives([f64::INFINITY; 3]));
    let [saved, described] = ["model.npz", "meta_data.json"].map(|name| folder.path().join(name));
    model::write(&saved, &student.parameters).unwrap();
    fs::write(&described, SCANNER).unwrap();
    let output = Command::new(program(folder.path())).args([&saved, &described]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let printed = Printed::new(&String::from_utf8(output.stdout).unwrap());

    let grid = Grid::new([4, 3, 5], [-1.0; 3].into(), [1.0; 3].into()).unwrap();
    let detector = Detector { rows: 5, columns: 6, pitch_v: 0.7, pitch_u: 0.6, offset_u: -0.1, offset_v: 0.05 };
    let cone = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid };
    let parallel = Scanner { beam: Beam::Parallel { dso: 5.0 }, ..cone };
    let wide = |values: Array3<f32>| values.into_iter().map(f64::from);

    printed.expect("exact", projector::forward::<f64>(&student, &cone, &ANGLES, Projection::Exact, 0.0));
    printed.expect("affine", projector::forward::<f64>(&student, &cone, &ANGLES, Projection::Affine, 1e-3));
    printed.expect("parallel", projector::forward::<f64>(&gaussian, &parallel, &ANGLES, Projection::Exact, 0.0));
    printed.expect("exact_f32", wide(projector::forward(&student, &cone, &ANGLES, Projection::Exact, 0.0)));
    printed.expect("volume", projector::voxelize::<f64>(&student, &grid, 0.0));
    printed.expect("volume_f32", wide(projector::voxelize(&student, &grid, 0.0)));

    let counted = |count: usize| Array1::from_iter((1..=count).map(|i| i as f64));
    let images = counted(2 * 5 * 6).into_shape_with_order((2, 5, 6)).unwrap();
    let volume = counted(4 * 3 * 5).into_shape_with_order((4, 3, 5)).unwrap();
    let narrow = |values: &Array3<f64>| values.mapv(|value| value as f32);
    let of_images = projector::vjp(&student, &cone, &ANGLES, Projection::Exact, 0.0, images.view());
    printed.expect_gradient("project_vjp", &of_images);
    let of_images = projector::vjp(&student, &cone, &ANGLES, Projection::Exact, 0.0, narrow(&images).view());
    printed.expect_gradient("project_vjp_f32", &of_images);
    let of_volume = projector::voxelize_vjp(&student, &grid, 0.0, volume.view());
    printed.expect_gradient("voxelize_vjp", &of_volume);
    printed.expect("part", of_volume.density.iter().copied());
    let of_volume = projector::voxelize_vjp(&student, &grid, 0.0, narrow(&volume).view());
    printed.expect_gradient("voxelize_vjp_f32", &of_volume);

    let version = format!("version {}", env!("CARGO_PKG_VERSION"));
    for line in [version.as_str(), "count 3 0", "read 3"] {
        assert!(printed.lines.iter().any(|printed| printed == line), "{line}");
    }
    let errors: Vec<&str> = printed.lines.iter().filter_map(|line| line.strip_prefix("error ")).collect();
    let expected = [
        "nu",
        "mean: got NULL",
        "missing.npz",
        "path: got NULL",
        "DSO",
        "detector: got NULL",
        "images: got 59 numbers, expected 60 of shape [2, 5, 6]",
        "angles: got NaN",
        "projection: got 2",
        "cutoff: got 1",
        "model: got NULL",
        "images: got NULL",
        "gradient: got NULL",
    ];
    assert_eq!(errors.len(), expected.len(), "{errors:#?}");
    for (error, expected) in errors.iter().zip(expected) {
        assert!(error.contains(expected), "{error:?} without {expected:?}");
    }
}
