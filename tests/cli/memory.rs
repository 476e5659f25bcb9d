//! The estimated memory of a run against its largest resident set, and the limit on it.
//!
//! The resident set is Linux's `VmHWM`, polled while the program runs. On other systems the test is skipped with a
//! message.

use crate::program::{Sandbox, stderr};
use ndarray::Array3;
use serde_json::Value;
use std::io::Write;
use std::process::{Command, Stdio};
use std::time::Duration;
use trgs::geometry::{Beam, Detector, Grid, Projections, Scanner, Volume};
use trgs::scan::Dataset;

const MIB: f64 = (1 << 20) as f64;
/// Allowed underestimate: memory that the system gives to any program.
const BASE: f64 = 8.0 * MIB;

/// Where data dominate, the estimate is at most so many times the measurement. Without test views, the views of the fit are
/// compared, and it counts arrays that do not all live together. Primitives count as if all of them were in each block and the
/// population doubled.
const CLOSE: Option<f64> = Some(1.15);
const UNTESTED: Option<f64> = Some(1.25);
const CROWD: Option<f64> = Some(1.9);

/// A ball of radius 0.8 in parallel rays: all views are equal, so a large scan is made quickly.
fn ball(voxels: usize, rows: usize, columns: usize, views: usize, test_views: usize) -> Dataset {
    let pitch = |n: usize| 2.4 / n as f64;
    let (pitch_v, pitch_u) = (pitch(rows), pitch(columns));
    let detector = Detector { rows, columns, pitch_v, pitch_u, offset_u: 0.0, offset_v: 0.0 };
    let scanner = Scanner { beam: Beam::Parallel { dso: 5.0 }, detector, grid: Grid::cube(voxels) };
    let projections = |n: usize, start: f64| {
        let images = Array3::from_shape_fn((n, rows, columns), |(_, row, column)| {
            let (u, v) = detector.position(row as f64, column as f64);
            2.0 * (0.64 - u * u - v * v).max(0.0).sqrt() as f32
        });
        Projections::new(Scanner::uniform_angles(n, start, std::f64::consts::TAU), images).unwrap()
    };
    let inside = |(x, y, z)| if scanner.grid.centre([x, y, z]).length() < 0.8 { 1.0 } else { 0.0 };
    let truth = Volume::new(scanner.grid, Array3::from_shape_fn((voxels, voxels, voxels), inside)).unwrap();
    let test = (test_views > 0).then(|| projections(test_views, 0.1));
    Dataset { test, truth: Some(truth), ..Dataset::new("ball", scanner, projections(views, 0.0)) }
}

/// Runs a reconstruction; returns its estimate and its largest resident set, in bytes.
fn measured(sandbox: &Sandbox, arguments: &str, out: &str) -> (f64, f64) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_trgs"))
        .args(["reconstruct", "scan", "--threads", "2", "--quiet", "--out", out])
        .args(arguments.split_whitespace())
        .current_dir(sandbox.path(""))
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut largest = 0.0_f64;
    let outcome = loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        if let Some(line) = text.lines().find_map(|line| line.strip_prefix("VmHWM:")) {
            largest = largest.max(1024.0 * line.trim().trim_end_matches(" kB").parse::<f64>().unwrap());
        }
        if let Some(outcome) = child.try_wait().unwrap() {
            break outcome;
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    assert!(outcome.success(), "{arguments}");
    let provenance: Value = serde_json::from_str(&sandbox.text(&format!("{out}/provenance.json"))).unwrap();
    (provenance["memory"].as_f64().unwrap(), largest)
}

/// Compares the estimate with the measurement. Where data dominates, it is at most `largest` times as large.
fn assert_honest(sandbox: &Sandbox, name: &str, arguments: &str, largest: Option<f64>) {
    let (estimate, measured) = measured(sandbox, arguments, name);
    eprintln!("{name}: estimate {:.0} MiB, measured {:.0} MiB", estimate / MIB, measured / MIB);
    assert!(estimate >= measured - BASE, "{name}: {:.1} MiB for {:.1}", estimate / MIB, measured / MIB);
    if let Some(largest) = largest {
        assert!(measured > 50.0 * MIB, "{name}: {:.1} MiB are too few", measured / MIB);
        assert!(estimate <= largest * measured, "{name}: {:.1} MiB for {:.1}", estimate / MIB, measured / MIB);
    }
}

fn is_linux() -> bool {
    if cfg!(target_os = "linux") {
        return true;
    }
    std::io::stderr().write_all(b"SKIPPED: the resident set is measured on Linux only\n").unwrap();
    false
}

fn with(scan: &Dataset) -> Sandbox {
    let sandbox = Sandbox::new();
    scan.write(&sandbox.path("scan")).unwrap();
    sandbox
}

#[test]
fn methods_on_voxels_need_what_was_said() {
    if !is_linux() {
        return;
    }
    let (small, views, voxels) =
        (with(&ball(20, 24, 30, 4, 2)), with(&ball(24, 400, 500, 22, 3)), with(&ball(168, 40, 48, 3, 1)));
    // Networks need more of a voxel, and more time.
    let fewer = with(&ball(80, 40, 48, 3, 1));
    // With 80³ voxels the same run of NAF needs 229 or 250 MiB, by the order in which its threads give memory back.
    let dense = with(&ball(144, 40, 48, 3, 1));
    // Few views are one set: tv begins with iterations over all of them, which need most.
    let large = with(&ball(24, 800, 1000, 5, 1));
    // Without test views the page compares those of the fit.
    let untested = with(&ball(24, 400, 500, 22, 0));
    for method in ["fdk", "sart"] {
        assert_honest(&untested, &format!("{method}-untested"), &format!("--method {method} --iterations 1"), UNTESTED);
    }
    for method in ["fdk", "sart", "os-sart", "asd-pocs", "cgls", "tv", "naf", "sax-nerf"] {
        let steps = match method {
            "fdk" => "",
            // Held-out runs take time, and are smaller.
            "tv" => "--iterations 3 --set tv.weight=1e-3",
            "naf" | "sax-nerf" => "--iterations 2 --set neural.rays=512",
            // All views in one set, the most that it can need.
            "os-sart" => "--iterations 1 --set algebraic.subset=22",
            _ => "--iterations 1",
        };
        let voxels = match method {
            "naf" => &dense,
            "sax-nerf" => &fewer,
            _ => &voxels,
        };
        let views = if method == "tv" { &large } else { &views };
        for (what, sandbox, largest) in [("small", &small, None), ("views", views, CLOSE), ("voxels", voxels, CLOSE)] {
            assert_honest(sandbox, &format!("{method}-{what}"), &format!("--method {method} {steps}"), largest);
        }
    }
}

#[test]
fn training_needs_what_was_said() {
    if !is_linux() {
        return;
    }
    let (small, views) = (with(&ball(20, 24, 30, 4, 2)), with(&ball(24, 400, 500, 24, 3)));
    let many = with(&ball(72, 64, 64, 6, 2));
    for method in ["tr-gs", "r2-gaussian"] {
        let cap = "--set density_control.cap=2000 --points 1500 --iterations 4 --set density_control.every=2";
        let finished = format!("{cap} --set finish=tv --set tv.weight=1e-3 --set tv.finish_iterations=1");
        assert_honest(&small, &format!("{method}-small"), &format!("--method {method} {finished}"), None);
        let cap = format!("{cap} --set finish=none --set sampling=point --set initialisation.from=fdk");
        assert_honest(&views, &format!("{method}-views"), &format!("--method {method} {cap}"), CLOSE);
        // ADC may double the primitives in a step but rarely does; the cap prevents it here.
        let most = if method == "tr-gs" { 95_000 } else { 90_000 };
        let crowd = format!(
            "--points 90000 --iterations 3 --set density_control.every=2 --set density_control.cap={most} \
                 --set finish=none --set initialisation.from=fdk"
        );
        assert_honest(&many, &format!("{method}-many"), &format!("--method {method} {crowd}"), CROWD);
    }
    assert_honest(&many, "double", "--precision f64 --points 90000 --iterations 2 --set finish=none", CROWD);
}

#[test]
fn a_run_that_may_need_more_than_allowed_is_refused_with_the_figure() {
    let sandbox = Sandbox::with_scan();
    let message = sandbox.refused("reconstruct scan --out run --max-memory 1MB");
    assert!(message.contains("--max-memory") && message.contains("MiB") && message.contains("--points"), "{message}");
    // The check precedes all reading: the projections need not even exist.
    std::fs::remove_dir_all(sandbox.path("scan/proj_train")).unwrap();
    let huge = "reconstruct scan --out run --iterations 30000 --set density_control.cap=10000000 --max-memory 2GiB";
    let message = sandbox.refused(huge);
    assert!(message.contains("at most 2.0 GiB") && message.contains("run: got 2"), "{message}");
    assert!(!stderr(&sandbox.run("reconstruct scan --out run --max-memory much")).is_empty());
    let pickle = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/naf_4.pickle");
    assert!(sandbox.refused(&format!("reconstruct {pickle} --out run --max-memory 3kB")).contains("--max-memory"));
}

#[test]
fn a_limit_chooses_slabs_and_no_bit_depends_on_it() {
    let sandbox = with(&ball(80, 20, 24, 6, 1));
    let finish =
        "--points 200 --iterations 12 --set density_control.cap=300 --set tv.finish_iterations=2 --set tv.weight=0.01";
    for (name, arguments, tenths) in [("tv", "--method tv --iterations 2", 8), ("tr-gs", finish, 9)] {
        let run = |out: &str, more: &str| {
            let output = sandbox.run(&format!("reconstruct scan --out {out} --threads 2 {arguments} {more}"));
            assert!(output.status.success(), "{}", stderr(&output));
            let provenance: Value = serde_json::from_str(&sandbox.text(&format!("{out}/provenance.json"))).unwrap();
            (provenance["memory"].as_u64().unwrap(), stderr(&output))
        };
        let (whole, said) = run(&format!("{name}-whole"), "");
        assert!(!said.contains("slabs"), "{said}");
        let limit = whole * tenths / 10;
        let (slabs, said) = run(&format!("{name}-slabs"), &format!("--max-memory {limit}B"));
        assert!(slabs <= limit && said.contains("slabs of files"), "{name}: {slabs} of {limit}: {said}");
        assert_eq!(said.contains("no checkpoints"), name == "tv", "{said}");
        let volume = |out: &str| sandbox.read(&format!("{name}-{out}/volume.npy"));
        assert!(volume("whole") == volume("slabs"), "{name}");
        let files = sandbox.names_in(&format!("{name}-slabs"));
        assert_eq!(files.iter().any(|file| file == "checkpoints"), name == "tr-gs", "{files:?}");
        if is_linux() {
            assert_honest(&sandbox, &format!("{name}-said"), &format!("{arguments} --max-memory {limit}B"), None);
        }
    }
    // A state of whole volumes is not continued in slabs.
    let output = sandbox.run("reconstruct scan --out tv-whole --method tv --iterations 4 --resume --max-memory 35MB");
    let message = stderr(&output);
    assert!(
        output.status.code() == Some(2) && message.contains("volumes are in slabs; allow more memory"),
        "{message}"
    );
}

#[test]
fn a_run_that_fits_runs_and_says_what_it_needs() {
    let sandbox = Sandbox::with_scan();
    let output = sandbox.run("reconstruct scan --out run --method fdk --max-memory 500MB");
    assert!(output.status.success() && stderr(&output).contains("memory: at most "), "{}", stderr(&output));
    let provenance: Value = serde_json::from_str(&sandbox.text("run/provenance.json")).unwrap();
    assert!(provenance["memory"].as_u64().unwrap() > 1 << 20);
}

#[test]
fn every_command_keeps_to_the_limit_and_names_it() {
    let sandbox = Sandbox::with_scan();
    let model = trgs::primitives::Parameters {
        mean: vec![[0.0; 3]],
        scale: vec![[0.2; 3]],
        quaternion: vec![[1.0, 0.0, 0.0, 0.0]],
        density: vec![1.0],
        nu: vec![5.0],
    };
    trgs::scan::model::write(sandbox.path("model.npz"), &model).unwrap();
    let listed = std::fs::read_to_string(sandbox.path("scan/meta_data.json")).unwrap();
    let mut often: Value = serde_json::from_str(&listed).unwrap();
    let views = often["proj_train"].as_array_mut().unwrap();
    *views = vec![views[0].clone(); 3000];
    std::fs::write(sandbox.path("scan/often.json"), often.to_string()).unwrap();
    for (command, part) in [
        ("voxelize model.npz --grid 1000,1000,1000 --out a.npy --max-memory 8MB", "fewer voxels"),
        ("voxelize model.npz --grid 1000000,1000000,1000000 --out a.npy", "grid shape: got"),
        ("simulate --phantom torso --size 2000 --out big --max-memory 8GB", "fewer voxels, views or pixels"),
        ("simulate --phantom torso --detector 60000 --views 60000 --out big --max-memory 1TB", "no machine has"),
        ("render model.npz --scanner scan --out a.npy --max-memory 2kB", "expected at most 2"),
        (
            "render model.npz --scanner scan --angles 0,1,2,3,4,5,6,7 --out a.npy --max-memory 20kB",
            "fewer views or pixels",
        ),
        ("confidence model.npz --scanner scan --out c.npz --max-memory 2kB", "expected at most 2"),
        ("inspect scan/often.json --max-memory 1MB", "3000 views of shape"),
        ("inspect scan/vol_gt.npy --max-memory 1kB", "vol_gt.npy"),
        ("convert scan/vol_gt.npy a.mha --max-memory 1kB", "vol_gt.npy"),
        ("evaluate scan/vol_gt.npy --against scan --max-memory 1kB", "expected at most 1"),
        ("table volume --size 512 --out tables --max-memory 1GB", "a smaller --size, or fewer --threads"),
    ] {
        let message = sandbox.refused(command);
        assert!(message.contains(part), "{command}: {message}");
        assert!(message.contains("; give ") && !message.contains("out of"), "{command}: {message}");
    }
    // A volume of 8 MB is written by slices.
    sandbox.done("voxelize model.npz --grid 100,100,100 --threads 1 --out a.npy --max-memory 2MB");
    let cotangent = "--vjp a.npy --grad-out grad.npz";
    let message =
        sandbox.refused(&format!("voxelize model.npz --grid 100,100,100 --out b.npy {cotangent} --max-memory 2MB"));
    assert!(message.contains("fewer voxels"), "{message}");
    sandbox.done(&format!("voxelize model.npz --grid 100,100,100 --out b.npy {cotangent}"));
    assert!(sandbox.read("a.npy") == sandbox.read("b.npy"));
    // Volumes of 2 MB are converted and compared by slabs.
    sandbox.done("voxelize model.npz --grid 64,64,64 --out a.npy");
    let limit = "--max-memory 300kB";
    for (from, to, limit) in [("a.npy", "a.nii.gz", limit), ("a.npy", "b.nii.gz", ""), ("a.npy", "a.mha", limit)] {
        sandbox.done(&format!("convert {from} {to} {limit}"));
    }
    sandbox.done(&format!("convert a.mha b.npy {limit}"));
    sandbox.done("convert a.npy c.npy");
    assert!(sandbox.read("a.nii.gz") == sandbox.read("b.nii.gz"));
    assert!(sandbox.read("b.npy") == sandbox.read("c.npy"));
    let metrics = ["", limit].map(|limit| sandbox.done(&format!("evaluate a.mha --against b.npy {limit}")));
    assert_eq!(metrics[0], metrics[1]);
    assert!(sandbox.refused(&format!("convert a.nii.gz b.npy {limit}")).contains("a.nii.gz"));
    for (from, to, limit) in [("a.npy", "a.png", ""), ("a.npy", "b.png", "3MB"), ("a.mha", "c.png", "3MB")] {
        let limit = if limit.is_empty() { String::new() } else { format!("--max-memory {limit}") };
        sandbox.done(&format!("convert {from} {to} {limit}"));
    }
    assert!(sandbox.read("a.png") == sandbox.read("b.png") && sandbox.read("a.png") == sandbox.read("c.png"));
    assert!(sandbox.refused(&format!("convert a.mha d.png {limit}")).contains("contact sheet"));
    std::fs::remove_file(sandbox.path("a.npy")).unwrap();
    assert!(!sandbox.path("a.npy").exists() && !sandbox.path("big").exists() && !sandbox.path("tables").exists());
}
