//! The program from outside: commands, files, results, messages and exit codes.

use crate::program::{Sandbox, stderr};
use crate::tolerances::{largest, relative};
use ndarray::{Array2, Array3};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use trgs::numeric::elementary::exp;
use trgs::scan::npz::Npz;
use trgs::scan::volume_file::VolumeFile;
use trgs::scan::{npy, volume_file};

const COMMANDS: [&str; 12] = [
    "demo",
    "simulate",
    "reconstruct",
    "evaluate",
    "mix",
    "render",
    "voxelize",
    "confidence",
    "oracle",
    "compare",
    "inspect",
    "convert",
];
const METRICS: [&str; 4] = ["psnr_3d", "ssim_3d", "psnr_2d", "ssim_2d"];
/// Arguments of a run that takes almost no time.
const SHORT: &str = "--iterations 6 --points 40 --set report_every=2 --set loss.tv_block=4 --set density_control.every=100 \
                     --set tv.weight=1e-3";

fn keys(value: &Value) -> BTreeSet<&str> {
    value.as_object().unwrap().keys().map(String::as_str).collect()
}

#[test]
fn every_command_has_help_with_an_example() {
    let sandbox = Sandbox::new();
    let listed = String::from_utf8(sandbox.run("--help").stdout).unwrap();
    for command in COMMANDS {
        assert!(listed.contains(&format!("\n  {command} ")), "{command} is not listed");
        let output = sandbox.run(&format!("{command} --help"));
        let help = String::from_utf8(output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(0));
        assert!(help.contains("Example") && help.contains(&format!("\n  trgs {command}")), "{command}: {help}");
        for flag in ["--threads", "--quiet", "--log-format", "--json"] {
            assert!(help.contains(flag), "{command} has no {flag}");
        }
        // Paragraphs are wrapped once, to 100 columns.
        for paragraph in help.split("\n\n").filter(|paragraph| paragraph.lines().all(|line| !line.starts_with(' '))) {
            let lines: Vec<&str> = paragraph.lines().collect();
            let ragged = lines.windows(2).find(|pair| {
                let next = pair[1].split(' ').next().unwrap_or_default();
                pair[0].chars().count() + 1 + next.chars().count() <= 95
            });
            assert_eq!(ragged, None, "{command}: a line ends before the next word needs it to");
        }
    }
}

#[test]
fn a_scan_is_simulated_reconstructed_evaluated_rendered_voxelized_and_inspected() {
    let sandbox = Sandbox::new();
    let scan =
        sandbox.done("simulate --phantom shepp-logan --out scan --size 32 --detector 40 --views 6 --test-views 4");
    assert_eq!(scan["volume"], serde_json::json!([32, 32, 32]));
    assert_eq!((&scan["train_views"], &scan["test_views"]), (&6.into(), &4.into()));

    let run = sandbox.done("reconstruct scan --out run --iterations 12 --points 200 --set report_every=5 --set finish=none --set sampling=point");
    assert_eq!(keys(&run), BTreeSet::from_iter(["run", "method", "seconds", "report"].into_iter().chain(METRICS)));
    let mut files = vec![".trgs.json", "checkpoints", "config.toml", "log.jsonl", "metrics.json"];
    files.extend(["model.npz", "provenance.json", "report.html", "volume.npy", "volume.npy.json"]);
    assert_eq!(sandbox.names_in("run"), files);
    let log: Vec<Value> =
        sandbox.text("run/log.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(log.iter().map(|record| record["iteration"].as_u64().unwrap()).collect::<Vec<_>>(), [5, 10, 12]);
    for key in [
        "iteration",
        "iterations",
        "loss",
        "l1",
        "d_ssim",
        "tv",
        "nu",
        "wavelet",
        "primitives",
        "confidence",
        "mean_nu",
        "seconds",
    ] {
        assert!(log.iter().all(|record| record[key].is_number()), "{key}");
    }

    let evaluation = sandbox.done("evaluate run --against scan");
    let of_run: Value = serde_json::from_str(&sandbox.text("run/metrics.json")).unwrap();
    for metric in METRICS {
        assert!(evaluation[metric]["value"].is_number() && evaluation[metric]["definition"].is_string(), "{metric}");
        assert_eq!(evaluation[metric], of_run[metric], "{metric}");
        assert_eq!(run[metric], of_run[metric], "{metric}");
    }
    let of_volume = sandbox.done("evaluate run/volume.npy --against scan");
    assert_eq!(of_volume["psnr_3d"], of_run["psnr_3d"]);
    assert_ne!(of_volume["psnr_2d"]["value"], of_run["psnr_2d"]["value"]);

    sandbox.done("reconstruct scan --method fdk --out fdk");
    let mixed = sandbox.done("mix run fdk --scanner scan --out mixed.npy");
    let [share, first, second, both] =
        ["share", "residual_first", "residual_second", "residual"].map(|key| mixed[key].as_f64().unwrap());
    assert!((0.0..=1.0).contains(&share) && both <= first.min(second), "{mixed}");
    let [of_run, of_fdk, mixed] = ["run/volume.npy", "fdk/volume.npy", "mixed.npy"]
        .map(|name| volume_file::read(sandbox.path(name)).unwrap().values);
    let share = share as f32;
    assert_eq!(mixed, of_run * share + of_fdk * (1.0 - share));
    sandbox.done("simulate --phantom shepp-logan --out bare --size 32 --detector 40 --views 6 --test-views 0");
    assert!(sandbox.refused("mix run fdk --scanner bare --out no.npy").contains("test views: got none"));

    let images = sandbox.done("render run/model.npz --scanner scan --split test --out images.npy");
    assert_eq!(images["shape"], serde_json::json!([4, 40, 40]));
    let gradient = sandbox.done(
        "render run/model.npz --scanner scan --split test --out again.npy --vjp images.npy --grad-out gradient.npz",
    );
    assert_eq!(gradient["grad_out"], "gradient.npz");
    assert_eq!(sandbox.read("images.npy"), sandbox.read("again.npy"));
    let (model, gradient) = ["run/model.npz", "gradient.npz"].map(|name| Npz::read(sandbox.path(name)).unwrap()).into();
    for key in model.keys() {
        let [ours, theirs] = [&gradient, &model].map(|npz| npz.entry(key).unwrap().numbers.shape().to_vec());
        assert_eq!(ours, theirs, "{key}");
    }

    sandbox.done("voxelize run/model.npz --scanner scan --precision f32 --cutoff 1e-3 --out volume.npy");
    assert_eq!(sandbox.read("volume.npy"), sandbox.read("run/volume.npy"));
    let part = sandbox.done("voxelize run/model.npz --grid 5,6,7 --box -1,-1,-1,0,1,0.5 --out part.npy");
    assert_eq!(part["shape"], serde_json::json!([5, 6, 7]));
    sandbox.done(
        "voxelize run/model.npz --grid 5,6,7 --box -1,-1,-1,0,1,0.5 --out part.npy --vjp part.npy --grad-out of_part.npz",
    );

    for (path, kind) in [
        ("scan", "dataset"),
        ("scan/meta_data.json", "dataset"),
        ("run", "run"),
        ("run/model.npz", "model"),
        ("images.npy", "array"),
    ] {
        let found = sandbox.done(&format!("inspect {path}"));
        assert!(found["kind"].as_str().unwrap().starts_with(kind), "{path}: {found}");
    }
    assert_eq!(sandbox.done("inspect run")["oddities"], serde_json::json!([]));
    let text = String::from_utf8(sandbox.run("inspect run").stdout).unwrap();
    assert!(!text.contains("[{"), "JSON in a table: {text}");
    sandbox.write("run/volume.npy", sandbox.read("part.npy"));
    assert!(sandbox.done("inspect run")["oddities"][0].as_str().unwrap().contains("volume.npy"));
}

#[test]
fn precision_and_cutoff_of_a_projection_are_those_asked_for() {
    let sandbox = Sandbox::with_scan();
    sandbox.done(&format!("reconstruct scan --out run {SHORT}"));
    let render = "render run/model.npz --scanner scan/meta_data.json --angles -0.5,1e0 --out a.npy";
    let exact = sandbox.done(render);
    assert_eq!((&exact["precision"], &exact["cutoff"]), (&"f64".into(), &0.0.into()));
    assert!(exact.get("truncation_bound").is_none());
    let [double, single] = ["f64", "f32"].map(|precision| {
        sandbox.done(&format!("{render} --precision {precision}"));
        npy::read(sandbox.path("a.npy")).unwrap().numbers
    });
    assert!(double.is_double() && !single.is_double());
    let cut = sandbox.done(&format!("{render} --cutoff 0.01"));
    let bound = cut["truncation_bound"].as_f64().unwrap();
    let cut = npy::read(sandbox.path("a.npy")).unwrap().numbers.into_f64();
    let dropped = (double.into_f64() - cut).iter().fold(0.0, |largest: f64, d| largest.max(d.abs()));
    assert!(dropped > 0.0 && dropped <= bound, "dropped {dropped}, bound {bound}");
}

/// The contributions of an explanation, after checking their order, shares and running sums.
fn contributions(found: &Value) -> Vec<f64> {
    let lines = found["contributions"].as_array().unwrap();
    let number = |line: &Value, key: &str| line[key].as_f64().unwrap();
    let values: Vec<f64> = lines.iter().map(|line| number(line, "contribution")).collect();
    assert!(values.windows(2).all(|pair| pair[0].abs() >= pair[1].abs()) && values.iter().all(|v| *v != 0.0));
    let total = found["value"].as_f64().unwrap();
    let mut sum = 0.0;
    for (line, value) in lines.iter().zip(&values) {
        sum += value;
        assert_eq!(number(line, "sum"), sum);
        within!((number(line, "share") * total - value).abs() / total, "{line}");
        assert!(line["centre"].as_array().unwrap().len() == 3 && number(line, "nu") > 0.0);
    }
    within!((sum - total).abs() / total);
    values
}

#[test]
fn a_pixel_and_a_voxel_are_explained_by_the_primitives_that_make_them() {
    let sandbox = Sandbox::with_scan();
    sandbox.done(&format!("reconstruct scan --out run {SHORT}"));
    let element = |file: &str, index: [usize; 3]| npy::read(sandbox.path(file)).unwrap().numbers.into_f64()[&index[..]];
    for flags in ["", "--projection affine", "--precision f32", "--cutoff 0.3 --precision f32"] {
        // What the parts add up to against the element of the file.
        let assert_equal = |sum: f64, value: f64| match flags.contains("f32") {
            true => within!("f32", relative(sum, value), "{flags}"),
            false => within!("f64", relative(sum, value), "{flags}"),
        };
        let render = format!("render run/model.npz --scanner scan --split test {flags}");
        let both = sandbox.done(&format!("{render} --out a.npy --explain 2,5,9"));
        assert_eq!(
            (&both["out"], &both["view"], &both["row"], &both["column"]),
            (&"a.npy".into(), &2.into(), &5.into(), &9.into())
        );
        let parts = contributions(&both);
        let (pixel, sum) = (element("a.npy", [2, 5, 9]), parts.iter().sum::<f64>());
        assert!(pixel > 0.0);
        assert_equal(sum, pixel);
        assert!(flags.contains("cutoff") == (parts.len() < 40), "{flags}: {} parts", parts.len());

        let flags = flags.replace("--projection affine", "");
        let voxelize = format!("voxelize run/model.npz --scanner scan {flags}");
        let both = sandbox.done(&format!("{voxelize} --out v.npy --explain 4,5,7"));
        assert_eq!((&both["out"], &both["voxel"]), (&"v.npy".into(), &serde_json::json!([4, 5, 7])));
        let (voxel, sum) = (element("v.npy", [4, 5, 7]), contributions(&both).iter().sum::<f64>());
        assert!(voxel > 0.0);
        assert_equal(sum, voxel);
    }
    // Without --out nothing is written; the table has the first 20 rows and the number of the others.
    let before = sandbox.names();
    for command in [
        "render run/model.npz --scanner scan --angles 0.3 --explain 0,5,9",
        "voxelize run/model.npz --grid 3,3,3 --explain 1,1,1",
    ] {
        let found = sandbox.done(command);
        assert!(found.get("out").is_none() && found["primitives"] == 40, "{found}");
        let table = String::from_utf8(sandbox.run(command).stdout).unwrap();
        assert_eq!(table.lines().count(), 1 + 20 + 1, "{table}");
        let more = format!("{} more ", contributions(&found).len() - 20);
        assert!(table.lines().last().unwrap().trim_start().starts_with(&more), "{table}");
    }
    assert_eq!(sandbox.names(), before);
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let sandbox = Sandbox::with_scan();
    for (out, flags) in [("a", ""), ("b", ""), ("c", "--threads 1"), ("d", "--threads 3"), ("e", "--seed 1")] {
        sandbox.done(&format!("reconstruct scan --out {out} {SHORT} {flags}"));
    }
    for file in ["model.npz", "volume.npy", "metrics.json", "config.toml"] {
        let [a, b, c, d, e] = ["a", "b", "c", "d", "e"].map(|run| sandbox.read(&format!("{run}/{file}")));
        assert!(a == b && a == c && a == d, "{file} differs");
        assert!(a != e, "{file} does not depend on the seed");
    }
    let digests = |run: &str| {
        let provenance: Value = serde_json::from_str(&sandbox.text(&format!("{run}/provenance.json"))).unwrap();
        (provenance["inputs"].clone(), provenance["outputs"].clone())
    };
    assert_eq!(digests("a"), digests("d"));
    let written = ["config.toml", "metrics.json", "model.npz", "volume.npy", "volume.npy.json"];
    assert_eq!(keys(&digests("a").1), BTreeSet::from(written));
}

#[test]
fn flags_go_before_the_file_and_settings_before_flags() {
    let sandbox = Sandbox::with_scan();
    sandbox.write("a.toml", "iterations = 9\nseed = 4\ncutoff = 0.01\n[model]\npoints = 50\n");
    sandbox.done("reconstruct scan --out run --config a.toml --seed 5 --points 60 --iterations 4 --set iterations=3");
    let config = sandbox.text("run/config.toml");
    for line in ["iterations = 3", "seed = 5", "cutoff = 0.01", "points = 60"] {
        assert!(config.lines().any(|l| l == line), "{line} is not in\n{config}");
    }
    sandbox.done("reconstruct scan --out again --config run/config.toml");
    assert_eq!(sandbox.read("run/model.npz"), sandbox.read("again/model.npz"));
}

#[test]
fn an_older_run_of_the_same_method_is_replaced_and_nothing_else() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("reconstruct scan --out run --method fdk");
    assert_eq!(
        sandbox.names_in("run"),
        [
            ".trgs.json",
            "config.toml",
            "metrics.json",
            "provenance.json",
            "report.html",
            "volume.npy",
            "volume.npy.json"
        ]
    );
    let first = sandbox.read("run/volume.npy");
    sandbox.done("reconstruct scan --out run --method fdk --views 2");
    assert_ne!(sandbox.read("run/volume.npy"), first);
    assert_eq!(sandbox.names(), ["run", "scan"]);
    assert!(sandbox.refused(&format!("reconstruct scan --out run {SHORT}")).contains("another method"));
    sandbox.write("run/thesis.txt", "years");
    assert!(sandbox.refused("reconstruct scan --out run --method fdk").contains("thesis.txt"));
    assert!(sandbox.refused("reconstruct scan --out scan --method fdk").contains("the folder that is read"));
    assert!(sandbox.refused("reconstruct run/volume.npy --out scan").contains("new or empty folder"));
}

#[test]
fn voxels_are_reconstructed_in_iterations_that_are_logged() {
    let sandbox = Sandbox::new();
    sandbox.done("simulate --phantom torso --out scan --size 24 --detector 36 --views 9 --test-views 2");
    let fdk = sandbox.done("reconstruct scan --out fdk --method fdk")["psnr_3d"]["value"].as_f64().unwrap();
    for (method, iterations) in [("sart", 20), ("os-sart", 20), ("asd-pocs", 10), ("cgls", 20)] {
        let run = sandbox.done(&format!("reconstruct scan --out {method} --method {method}"));
        let mut files = vec![
            ".trgs.json",
            "checkpoints",
            "config.toml",
            "log.jsonl",
            "metrics.json",
            "provenance.json",
            "report.html",
        ];
        files.extend(["volume.npy", "volume.npy.json"]);
        assert_eq!(sandbox.names_in(method), files);
        let psnr = run["psnr_3d"]["value"].as_f64().unwrap();
        assert!(psnr > fdk + 1.0, "{method}: {psnr} dB, FDK {fdk} dB");
        let log: Vec<Value> = sandbox
            .text(&format!("{method}/log.jsonl"))
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert_eq!(log.len(), iterations, "{method}");
        let residual = |k: usize| log[k]["residual"].as_f64().unwrap();
        // ASD-POCS logs the residual after a whole pass, so its first line already shows most of the decrease.
        let falls_to = if method == "asd-pocs" { 1.0 } else { 0.5 };
        assert!(residual(iterations - 1) < falls_to * residual(0), "{method}");
        assert!(sandbox.text(&format!("{method}/report.html")).contains("residual"));
    }
    sandbox.done("reconstruct scan --out sax --method sart --preset sax-nerf");
    assert_eq!(sandbox.text("sax/log.jsonl").lines().count(), 6);
    sandbox.done("reconstruct scan --out siddon --method sart --precision f64 --set algebraic.rays=siddon");
    assert_ne!(sandbox.read("siddon/volume.npy"), sandbox.read("sart/volume.npy"));
    let refused = sandbox.refused("reconstruct scan --out bad --method sart --set algebraic.relaxation=2.5");
    assert!(refused.contains("algebraic.relaxation") && !sandbox.names().contains(&"bad".into()), "{refused}");
}

#[test]
fn volumes_and_scans_change_their_format() {
    let sandbox = Sandbox::with_scan();
    for name in ["v.mha", "v.nrrd", "v.nii.gz", "v.tif"] {
        let found = sandbox.done(&format!("convert scan/vol_gt.npy {name} --scanner scan"));
        assert_eq!(found["kind"], "volume");
        let n = found["shape"][0].as_f64().unwrap();
        let (spacing, origin) = (found["spacing"][0].as_f64().unwrap(), found["origin"][0].as_f64().unwrap());
        within!(largest([spacing - 2.0 / n, origin + 1.0 - 1.0 / n]), "{found}");
        sandbox.done(&format!("convert {name} back.npy"));
        assert_eq!(sandbox.read("back.npy"), sandbox.read("scan/vol_gt.npy"), "{name}");
        let scan =
            sandbox.done(&format!("simulate --volume {name} --out again --views 2 --detector 20 --test-views 0"));
        assert_eq!(scan["volume"], found["shape"]);
    }
    assert!(sandbox.refused("convert scan/vol_gt.npy v.vtk").contains(".nii.gz"));
    let pickle = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/naf_4.pickle");
    assert_eq!(sandbox.done(&format!("convert {pickle} of_naf"))["kind"], "dataset");
    assert_eq!(sandbox.done("inspect of_naf")["kind"], "dataset");
    sandbox.done(&format!("reconstruct {pickle} --out run --method cgls --iterations 3"));
    assert!(sandbox.refused(&format!("convert {pickle} other --scanner scan")).contains("--scanner"));
}

/// The training views of `scan` as detector readings.
///
/// They are TIFFs of frames, three flat fields and one dark field.
fn write_readings(sandbox: &Sandbox) {
    let images: Vec<_> =
        (0..4).map(|view| image(sandbox, &format!("scan/proj_train/proj_train_000{view}.npy"))).collect();
    let (rows, columns) = images[0].dim();
    let dark = |v: usize, u: usize| (90 + v + 2 * u) as f32;
    let flat = |v: usize, u: usize| (20_000 + 300 * v + 100 * u) as f32;
    let write = |name: &str, count: usize, reading: &dyn Fn(usize, usize, usize) -> f32| {
        let values = Array3::from_shape_fn((columns, rows, count), |(u, v, frame)| reading(frame, v, u));
        let volume = VolumeFile { values, ..VolumeFile::default() };
        volume_file::write(sandbox.path(name), &volume).unwrap();
    };
    write("darks.tif", 1, &|_, v, u| dark(v, u));
    write("flats.tif", 3, &|frame, v, u| flat(v, u) + 40.0 * (frame as f32 - 1.0));
    write("frames.tif", 4, &|view, v, u| {
        let transmission = exp(-f64::from(images[view][[v, u]])) as f32;
        dark(v, u) + (flat(v, u) - dark(v, u)) * transmission
    });
}

fn image(sandbox: &Sandbox, name: &str) -> Array2<f32> {
    npy::read_f32(&sandbox.path(name), "[v, u]").unwrap()
}

#[test]
fn readings_of_a_detector_become_a_scan() {
    let sandbox = Sandbox::with_scan();
    write_readings(&sandbox);
    let found = sandbox.done("convert frames.tif own --scanner scan --flat flats.tif --dark darks.tif");
    assert_eq!((&found["kind"], &found["views"], &found["clamped"]), (&json!("dataset"), &json!(4), &json!(0)));
    for view in 0..4 {
        let [own, scan] =
            ["own", "scan"].map(|at| image(&sandbox, &format!("{at}/proj_train/proj_train_000{view}.npy")));
        // Transmissions, readings and line integrals are each rounded to 2⁻²⁴ relative.
        let worst = (own - scan).iter().fold(0.0_f32, |worst, difference| worst.max(difference.abs()));
        within!(worst, "view {view}: {worst}");
    }
    assert_eq!(sandbox.done("inspect own")["train"]["views"], 4);
    // Another unit of the scanner's lengths scales the line integrals; only totalAngle gives the views.
    sandbox.edit("scan/meta_data.json", |meta| {
        for key in ["DSD", "DSO"] {
            meta["scanner"][key] = json!(10.0 * meta["scanner"][key].as_f64().unwrap());
        }
        for key in ["sDetector", "dDetector", "sVoxel", "dVoxel", "offOrigin", "offDetector"] {
            let values: Vec<f64> = serde_json::from_value(meta["scanner"][key].clone()).unwrap();
            meta["scanner"][key] = json!(values.iter().map(|value| 10.0 * value).collect::<Vec<_>>());
        }
        (meta["proj_train"], meta["bbox"]) = (json!([]), Value::Null);
    });
    sandbox.write("meta.json", sandbox.read("scan/meta_data.json"));
    sandbox.done("convert frames.tif scaled --scanner meta.json --flat flats.tif --dark darks.tif");
    let [own, scaled] = ["own", "scaled"].map(|at| image(&sandbox, &format!("{at}/proj_train/proj_train_0001.npy")));
    assert_eq!(own.mapv(|value| (f64::from(value) * 0.1) as f32), scaled);
    let angle = |at: &str| {
        serde_json::from_str::<Value>(&sandbox.text(&format!("{at}/meta_data.json"))).unwrap()["proj_train"][1]["angle"]
            .as_f64()
    };
    within!("angle", (angle("own").unwrap() - angle("scaled").unwrap()).abs());
    sandbox.write("angles.txt", "0 10 20 30");
    let line_integrals =
        "convert frames.tif given --scanner meta.json --line-integrals --angles angles.txt --degrees --clockwise";
    sandbox.done(line_integrals);
    within!("angle", (angle("given").unwrap() + 10_f64.to_radians()).abs());

    let warned = |arguments: &str| {
        let output = sandbox.run(&format!("convert frames.tif other --scanner meta.json {arguments}"));
        assert!(output.status.success(), "{}", stderr(&output));
        stderr(&output)
    };
    assert!(warned("--normalise frame").contains("contradict each other"));
    assert!(warned("").contains("no flat field"));
    let said = warned("--white 24000 --dark darks.tif --air 0,0,2,15");
    assert!(said.starts_with("4 views from 0.00°") && said.lines().count() == 1, "{said}");
    for (arguments, part) in [
        ("frames.tif other", "add --scanner"),
        ("frames.tif other.mha --scanner meta.json --flat flats.tif", "--flat"),
        ("scan other --clockwise", "--clockwise"),
        ("frames.tif other --scanner meta.json --white 5 --flat flats.tif", "cannot be used with"),
        ("frames.tif other --scanner meta.json --air 0,0,99,3", "14 rows and 15 columns"),
        ("darks.tif other --scanner meta.json --angles angles.txt", "one for each of 1 frame;"),
        ("frames.tif other --scanner meta.json --flat scan/vol_gt.npy", "flat field: got shape [12, 12]"),
    ] {
        let output = sandbox.run(&format!("convert {arguments}"));
        let message = stderr(&output);
        assert!(output.status.code() == Some(2) && message.contains(part), "{arguments}: {message}");
    }
}

#[test]
fn a_scan_may_be_given_by_its_description_from_within_its_folder() {
    let sandbox = Sandbox::with_scan();
    let mut command = sandbox.command("reconstruct ./meta_data.json --out ../run --method fdk");
    assert!(command.current_dir(sandbox.path("scan")).output().unwrap().status.success());
    let provenance: Value = serde_json::from_str(&sandbox.text("run/provenance.json")).unwrap();
    assert_eq!(keys(&provenance["inputs"]).len(), 1 + 1 + 4 + 3, "description, truth, views");
}

#[test]
fn metrics_without_truth_or_test_views_are_absent_with_the_reason() {
    let sandbox = Sandbox::with_scan();
    sandbox.edit("scan/meta_data.json", |meta| meta["vol"] = Value::Null);
    let run = sandbox.done("reconstruct scan --out run --method fdk");
    assert!(run["absent"]["psnr_3d"].as_str().unwrap().contains("no true volume"));
    assert!(run["psnr_2d"]["value"].is_number() && run.get("psnr_3d").is_none());
    sandbox.edit("scan/meta_data.json", |meta| meta["proj_test"] = serde_json::json!([]));
    let evaluation = sandbox.done("evaluate run --against scan");
    assert_eq!(keys(&evaluation["absent"]), BTreeSet::from(METRICS));
    let table = String::from_utf8(sandbox.run("evaluate run --against scan").stdout).unwrap();
    assert!(table.contains("absent: the dataset has no test views"), "{table}");
}

#[test]
fn what_does_not_exist_is_a_usage_error_that_names_what_does() {
    let sandbox = Sandbox::with_scan();
    for (arguments, names) in [
        ("tables --out t", &["tables", "reconstruct", "inspect"][..]),
        ("reconstruct scan --out run --method sax", &["sax", "tr-gs", "fdk"]),
        (
            "reconstruct scan --out run --method r2-gaussian --set wavelet.enabled=true",
            &["wavelet.enabled", "r2-gaussian"],
        ),
        ("reconstruct scan --out run --views 5", &["--views", "1 to 4"]),
        ("reconstruct scan --out run --set loss.d_sim=1", &["did you mean loss.d_ssim?"]),
        ("reconstruct scan --out run --set model.points=3", &["model.points", "got 3"]),
        ("simulate --phantom tors --out run", &["did you mean torso?"]),
        ("simulate --phantom torso --volume a.npy --out run", &["--volume"]),
        ("render m.npz --scanner scan --out a.npy --vjp b.npy", &["--grad-out"]),
        ("render m.npz --scanner scan --explain 0,1,1 --vjp b.npy --grad-out g.npz", &["--out"]),
        ("render m.npz --scanner scan", &["--out"]),
        ("render m.npz --scanner scan --explain 1,2", &["VIEW,ROW,COLUMN", "3 numbers"]),
        ("voxelize m.npz --out a.npy", &["--scanner", "--grid"]),
    ] {
        let output = sandbox.run(arguments);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments}");
        assert!(message.starts_with("error: ") && names.iter().all(|name| message.contains(name)), "{message}");
    }
    assert_eq!(sandbox.names(), ["scan"]);
}

#[test]
fn messages_go_to_standard_error_in_the_format_asked_for() {
    let sandbox = Sandbox::with_scan();
    let run = |flags: &str| sandbox.run(&format!("reconstruct scan --out run {SHORT} {flags}"));
    let text = stderr(&run(""));
    assert!(text.contains("iteration 2 of 6: loss ") && !text.contains("needs"), "{text}");
    assert_eq!(stderr(&run("--quiet")), "");
    let lines = stderr(&run("--log-format json"));
    let lines: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let first = lines.iter().find_map(|line| Some((line["iteration"].as_u64()?, line["part"].as_str()?)));
    assert_eq!(first, Some((2, "training")));
    assert!(lines.iter().any(|line| line["parts"].as_str().is_some_and(|parts| parts.contains("among them"))));
    // A line every five seconds at most, however short the iterations are.
    for method in ["naf --set neural.rays=16 --set neural.samples=8", "sart", "tv", "tr-gs --points 50"] {
        let began = std::time::Instant::now();
        let said = stderr(&sandbox.run(&format!("reconstruct scan --out other --method {method} --iterations 60")));
        let lines = said.lines().filter(|line| line.contains(" of 60: ") || line.contains("held-out error")).count();
        assert!((1..=1 + began.elapsed().as_secs() as usize / 5).contains(&lines), "{method}: {said}");
        std::fs::remove_dir_all(sandbox.path("other")).unwrap();
    }
    let said = stderr(&sandbox.run("inspect scan --threads 1000"));
    assert!(said.starts_with("warning: --threads 1000: this machine has ") && said.contains("only wait"), "{said}");
    let error = stderr(&sandbox.run("inspect nowhere --log-format json --quiet"));
    let error: Value = serde_json::from_str(&error).unwrap();
    assert!(error["message"].as_str().unwrap().contains("nowhere"));
    let table = String::from_utf8(run("--quiet").stdout).unwrap();
    assert!(METRICS.iter().all(|metric| table.contains(metric)), "{table}");
}

#[test]
fn the_demonstration_beats_filtered_back_projection_by_far() {
    let sandbox = Sandbox::new();
    let found = sandbox.done("demo");
    let psnr = |method: &str| found[method]["psnr_3d"]["value"].as_f64().unwrap();
    assert!(psnr("tr-gs") >= psnr("fdk") + 6.0, "{found}");
    assert_eq!(sandbox.names_in("out/demo"), ["dataset", "fdk", "tr-gs"]);
    let page = sandbox.text(found["report"].as_str().unwrap());
    assert!(page.contains("TR-GS") && page.contains("FDK"));
}

#[cfg(unix)]
#[test]
fn an_interrupt_leaves_nothing_half_written() {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};
    let sandbox = Sandbox::with_scan();
    for signal in [crate::program::interrupt(), "-TERM"] {
        let mut child = Command::new(assert_cmd::cargo::cargo_bin!("trgs"))
            .args("reconstruct scan --out run --iterations 100000000 --set report_every=1".split(' '))
            .current_dir(sandbox.path(""))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut messages = BufReader::new(child.stderr.take().unwrap()).lines();
        for beginning in ["memory: at most ", "iteration 1 of"] {
            let line = messages.next().unwrap().unwrap();
            assert!(line.starts_with(beginning), "{line}");
        }
        Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        let last = messages.map(Result::unwrap).last().unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(130));
        assert!(last.starts_with("error: interrupted at iteration") && last.contains("--resume"), "{last}");
        assert_eq!(sandbox.names(), ["run", "scan"]);
        assert_eq!(sandbox.names_in("run"), [".trgs.json", "checkpoints", "log.jsonl"]);
        assert_eq!(sandbox.names_in("run/checkpoints"), ["last.msgpack"]);
    }
}

#[cfg(unix)]
#[test]
fn a_reader_that_goes_away_is_no_error() {
    use std::process::{Command, Stdio};
    let sandbox = Sandbox::with_scan();
    let mut child = Command::new(assert_cmd::cargo::cargo_bin!("trgs"))
        .args(["inspect", "scan"])
        .current_dir(sandbox.path(""))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
}
