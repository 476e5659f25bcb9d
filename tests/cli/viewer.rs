//! `trgs view`: the page, and what it does in a browser.

use crate::program::{Sandbox, stderr};
use glam::{DMat3, DVec3};
use ndarray::Array3;
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;
use std::process::Command;
use trgs::geometry::Grid;
use trgs::scan::volume_file::{self, VolumeFile};
use trgs::scan::{Frame, Phantom, Unit, npy};

/// The scenes of a page, as its script reads them.
fn scenes(sandbox: &Sandbox, page: &str) -> Vec<Value> {
    let html = sandbox.text(page);
    let parts = html.split("<script type=\"application/json\">").skip(1);
    parts.map(|part| serde_json::from_str(part.split("</script>").next().unwrap()).unwrap()).collect()
}

fn names(scene: &Value) -> Vec<&str> {
    scene["volumes"].as_array().unwrap().iter().map(|volume| volume["name"].as_str().unwrap()).collect()
}

/// The volumes that `tests/viewer/drive.js` knows.
fn write_digits(sandbox: &Sandbox) {
    let values = Array3::from_shape_fn((16, 16, 16), |(x, y, z)| (x + 16 * y + 256 * z) as f32 / 4096.0);
    npy::write(&sandbox.path("a.npy"), values.view()).unwrap();
    npy::write(&sandbox.path("b.npy"), (values + 0.25).view()).unwrap();
}

#[test]
fn the_viewer_works_in_chromium() {
    let is_there =
        |program: &str| Command::new(program).arg("--version").output().is_ok_and(|run| run.status.success());
    if let Some(missing) = ["node", "chromium"].into_iter().find(|program| !is_there(program)) {
        // Bypasses the capture of the test harness: a skipped test must not look like a passed one.
        let remark = format!("SKIPPED: {missing} is not installed; the viewer is not tried in a browser\n");
        return std::io::stderr().write_all(remark.as_bytes()).unwrap();
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let unit = Command::new("node").args(["--test", "src/report/viewer/"]).current_dir(root).output().unwrap();
    assert!(unit.status.success(), "{}", String::from_utf8_lossy(&unit.stdout));
    let sandbox = Sandbox::new();
    write_digits(&sandbox);
    sandbox.done("view a.npy b.npy --out page.html");
    let drive = |page: &str, flags: &[&str], checks: usize| {
        let mut node = Command::new("node");
        let drive =
            node.arg("tests/viewer/drive.js").arg(sandbox.path(page)).args(flags).current_dir(root).output().unwrap();
        let said = String::from_utf8_lossy(&drive.stdout);
        assert!(drive.status.success() && said.matches("ok: ").count() == checks, "{said}{}", stderr(&drive));
    };
    drive("page.html", &[], 9);
    // As reference/pictures makes them.
    sandbox.done("simulate --phantom torso --out scan --size 64 --detector 64 --views 25");
    sandbox.done("reconstruct scan --out fdk --method fdk");
    sandbox.done("view fdk scan --out fdk.html");
    drive("fdk.html", &["--against", "reference/screens"], 4);
    sandbox.done("simulate --phantom torso --out small --size 16 --detector 16 --views 4 --test-views 0");
    sandbox.done("reconstruct small --out run --iterations 20");
    sandbox.done("view run small --out model.html");
    drive("model.html", &["--model"], 1);
    drive("run/report.html", &["--model"], 1);
    // In millimetres, once as it is and once with the axes in another order.
    let volume = Phantom::by_name("letters", 0).unwrap().voxelize(&Grid::cube(50), 1);
    let straight = VolumeFile { unit: Some(Unit::Millimetre), ..Frame::default().file(&volume) };
    let turned = VolumeFile {
        values: straight.values.clone().permuted_axes([1, 2, 0]).as_standard_layout().into_owned(),
        directions: DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X),
        ..straight.clone()
    };
    for (name, file) in [("straight", straight), ("turned", turned)] {
        volume_file::write(sandbox.path(&format!("{name}.nii.gz")), &file).unwrap();
        sandbox.done(&format!("view {name}.nii.gz --out {name}.html"));
        drive(&format!("{name}.html"), &["--letters"], 1);
    }
}

#[test]
fn a_model_is_shown_beside_its_scan_with_its_primitives() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("reconstruct scan --out run --iterations 4");
    let of = |page: &str| scenes(&sandbox, page).remove(0);
    let columns =
        |scene: &Value| scene["model"].as_array().unwrap().iter().map(|c| c["name"].clone()).collect::<Vec<_>>();
    sandbox.done("view run scan --out run.html");
    assert_eq!(columns(&of("run.html"))[12..], ["ν", "confidence", "density"]);
    sandbox.done("convert run/model.npz model.ply --scanner scan");
    for model in ["run/model.npz", "model.ply"] {
        sandbox.done(&format!("view {model} scan --out {model}.html"));
        let scene = of(&format!("{model}.html"));
        assert_eq!(names(&scene), ["truth", model.rsplit('/').next().unwrap()]);
        assert_eq!(columns(&scene).len(), 15);
    }
    // The volume is that of the model, before any finish.
    sandbox.done("voxelize run/model.npz --scanner scan --out volume.npy --precision f32 --cutoff 1e-3");
    sandbox.done("view volume.npy scan --out volume.html");
    let data = |page: &str| of(page)["volumes"][1]["data"].clone();
    assert_eq!(data("run/model.npz.html"), data("volume.html"));
    assert_eq!(columns(&of("volume.html")), Vec::<Value>::new());
    assert!(sandbox.refused("view run/model.npz").contains("model to show"));
}

#[test]
fn a_run_beside_its_scan_shows_volumes_and_projections() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("reconstruct scan --out run --method fdk");
    let found = sandbox.done("view run scan");
    assert_eq!(found["out"], "view.html");
    assert_eq!(found["bytes"], sandbox.read("view.html").len());
    let shown = scenes(&sandbox, "view.html");
    assert_eq!(shown.iter().map(names).collect::<Vec<_>>(), [vec!["truth", "run"], vec!["measured", "rendered"]]);
    assert_eq!([&shown[0]["shape"], &shown[1]["shape"]], [&json!([12, 12, 12]), &json!([3, 14, 15])]);
    assert!(shown.iter().flat_map(|scene| scene["volumes"].as_array().unwrap()).all(|volume| volume["bits"] == 8));
    // The projections of a volume are those that it is judged by.
    assert!(sandbox.text("view.html").contains("<h2>Projections of the test views</h2>"));
    assert_eq!(shown[1]["angles"].as_array().unwrap().len(), 3);
    // A whole turn in steps of ten degrees.
    sandbox.done("view run scan --turntable --out turn.html");
    let turn = scenes(&sandbox, "turn.html").pop().unwrap();
    assert_eq!([&turn["title"], &turn["shape"]], [&json!("Turntable"), &json!([36, 14, 15])]);
    assert_eq!(turn["angles"][35].as_f64().unwrap().round(), 350.0);
    // Alone, a scan shows what was measured.
    sandbox.done("view scan --out scan.html");
    let alone = scenes(&sandbox, "scan.html");
    assert_eq!(alone.iter().map(names).collect::<Vec<_>>(), [vec!["truth"], vec!["measured"]]);
    assert_eq!(alone[1]["shape"], json!([4, 14, 15]));
}

#[test]
fn volumes_of_any_format_are_shown_at_their_place() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("convert scan/vol_gt.npy truth.nii.gz --scanner scan");
    sandbox.done("convert scan/vol_gt.npy truth.mha --scanner scan");
    sandbox.done("view truth.nii.gz --out one.html --mu-water 0.5");
    let one = &scenes(&sandbox, "one.html")[0];
    assert_eq!([&one["volumes"][0]["bits"], &one["water"]], [&json!(16), &json!(0.5)]);
    let spacing = one["spacing"].as_array().unwrap()[0].as_f64().unwrap();
    // NIfTI holds f32.
    assert_eq!(spacing as f32, 2.0 / 12.0);
    sandbox.done("view truth.nii.gz truth.mha scan/vol_gt.npy --bits 8");
    let three = &scenes(&sandbox, "view.html")[0];
    assert_eq!(names(three), ["truth.nii.gz", "truth.mha", "vol_gt.npy"]);
    let data = |number: usize| &three["volumes"][number]["data"];
    assert!(data(0) == data(1) && data(1) == data(2));
    assert_eq!(three["reach"], 1.0);
    // A stack of frames is shown as one.
    sandbox.done("view scan/proj_train --out frames.html");
    assert_eq!(scenes(&sandbox, "frames.html")[0]["axes"], json!(["view", "v", "u"]));
}

#[test]
fn large_volumes_are_reduced_unless_all_is_asked_for() {
    let sandbox = Sandbox::new();
    npy::write(&sandbox.path("long.npy"), Array3::<f32>::ones((1100, 50, 50)).view()).unwrap();
    let found = sandbox.done("view long.npy");
    assert_eq!(found["shows"], json!(["long.npy, 550 × 25 × 25"]));
    assert!(scenes(&sandbox, "view.html")[0]["note"].as_str().unwrap().starts_with("Means of 2 × 2 × 2"));
    let found = sandbox.done("view long.npy --full");
    assert_eq!(found["shows"], json!(["long.npy, 1100 × 50 × 50"]));
}

#[test]
fn what_cannot_be_shown_is_refused() {
    let sandbox = Sandbox::with_scan();
    write_digits(&sandbox);
    npy::write(&sandbox.path("flat.npy"), Array3::<f32>::ones((16, 16, 1)).view()).unwrap();
    sandbox.done("simulate --phantom torso --out other --size 12 --detector 14 --views 2 --test-views 0");
    for (arguments, part) in [
        ("view scan other", "scans to show: got scan and other, expected one"),
        ("view a.npy flat.npy", "flat.npy"),
        ("view a.npy a.npy a.npy a.npy a.npy", "volumes to show: got 5, expected 1 to 4"),
        ("view a.npy scan", "a.npy"),
        ("view a.npy --turntable", "--turntable"),
        ("view missing.nii.gz", "missing.nii.gz"),
        ("view a.npy --out a.npy", "a file that is read"),
    ] {
        let error = sandbox.refused(arguments);
        assert!(error.contains(part), "{arguments}: {error}");
    }
}

#[test]
fn the_page_of_a_run_without_a_truth_says_how_good_it_is_and_what_next() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("simulate --phantom torso --out plain --size 12 --detector 16 --views 10 --test-views 0");
    let mut meta: Value = serde_json::from_str(&sandbox.text("plain/meta_data.json")).unwrap();
    meta.as_object_mut().unwrap().remove("vol").unwrap();
    sandbox.write("plain/meta_data.json", meta.to_string());
    sandbox.done("reconstruct plain --out run --method fdk");
    let page = sandbox.text("run/report.html");
    let residual = &serde_json::from_str::<Value>(&sandbox.text("run/metrics.json")).unwrap()["residual"];
    assert_eq!([&residual["views"], &residual["count"]], [&json!("training"), &json!(10)]);
    let percent = 100.0 * residual["relative"].as_f64().unwrap();
    let stated =
        page.split("fitted to, the residual is ").nth(1).unwrap().split(' ').next().unwrap().parse::<f64>().unwrap();
    assert_eq!(stated, format!("{percent:.2e}").parse::<f64>().unwrap());
    assert!(residual["per_noise"].as_f64().unwrap() > 0.0);
    for part in [
        "<h2>Is the volume good?</h2>",
        "In 10 of the views that it was fitted to, the residual is ",
        "<h2>Where is it doubtful?</h2>",
        "<h3>Residual of each view",
        "<code>trgs view run plain --full --out run.html</code>",
        "<code>trgs convert plain run-held-out --views 8 --test-views 2</code>",
        "<code>trgs inspect plain --check-geometry</code>",
    ] {
        assert!(page.contains(part), "{part}");
    }
    // The commands of the page do what they say.
    for command in page.split("<code>trgs ").skip(1).map(|part| part.split("</code>").next().unwrap()) {
        if !command.starts_with("inspect") {
            sandbox.done(command);
        }
    }
    sandbox.done("reconstruct run-held-out --out tested --method fdk");
    let page = sandbox.text("tested/report.html");
    assert!(page.contains("In 2 test views, which were not used to make it"));
}

#[test]
fn runs_are_shown_side_by_side_with_the_settings_that_differ() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("reconstruct scan --out a --method fdk");
    sandbox.done("reconstruct scan --out b --method sart --iterations 3");
    assert_eq!(sandbox.done("report a")["report"], "a/report.html");
    let found = sandbox.done("report a b --out runs.html");
    assert_eq!([&found["report"], &found["runs"]], [&json!("runs.html"), &json!(["a", "b"])]);
    assert_eq!(scenes(&sandbox, "runs.html").iter().map(names).collect::<Vec<_>>(), [vec!["a", "b"]]);
    let page = sandbox.text("runs.html");
    let psnr: Value = serde_json::from_str(&sandbox.text("b/metrics.json")).unwrap();
    for part in [
        "<th>method</th><td>&quot;fdk&quot; | &quot;sart&quot;</td>".into(),
        format!("{:.2}", psnr["psnr_3d"]["value"].as_f64().unwrap()),
    ] {
        assert!(page.contains(&part), "{part}");
    }
    assert!(!page.contains("<th>seed</th>"));
    let error = sandbox.refused("report a scan");
    assert!(error.contains("scan/config.toml"), "{error}");
}
