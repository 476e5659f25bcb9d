//! `trgs confidence` from outside: file, result and rejected input.

use crate::program::{Sandbox, stderr};
use ndarray::{ArrayD, Ix0, Ix1, array};
use trgs::confidence::{Alpha, Coverage, Histogram, Settings, nu_target};
use trgs::primitives::activation::Interval;
use trgs::scan::Dataset;
use trgs::scan::model;
use trgs::scan::npz::{self, Entry, Npz};

/// Three primitives, the last outside every view; `nu` is their degrees of freedom.
fn write_model(sandbox: &Sandbox, nu: [f64; 3]) {
    let arrays: [(&str, ArrayD<f64>); 5] = [
        ("mean", array![[0.1, -0.2, 0.3], [-0.4, 0.3, -0.1], [0.0, 0.0, 40.0]].into_dyn()),
        ("scale", array![[0.4, 0.02, 0.03], [0.1, 0.1, 0.1], [0.1, 0.2, 0.1]].into_dyn()),
        ("quaternion", array![[0.8, 0.1, -0.4, 0.3], [1.0, 0.0, 0.0, 0.0], [0.3, 0.2, 0.1, 0.9]].into_dyn()),
        ("density", array![0.5, 0.6, 0.7].into_dyn()),
        ("nu", array![nu[0], nu[1], nu[2]].into_dyn()),
    ];
    let entries: Vec<_> = arrays.iter().map(|(key, values)| (*key, Entry::F64(values.view()))).collect();
    npz::write(sandbox.path("m.npz"), &entries).unwrap();
}

fn numbers(sandbox: &Sandbox, key: &str) -> Vec<f64> {
    Npz::read(sandbox.path("c.npz")).unwrap().get::<Ix1>(key, "[N]").unwrap().to_vec()
}

#[test]
fn the_file_has_what_the_library_computes_and_the_settings_it_was_computed_with() {
    let sandbox = Sandbox::with_scan();
    write_model(&sandbox, [7.0, 5.0, 3.0]);
    let flags = "--sphere-points 200 --r-max 0.6 --kappa 0.8 --temperature 0.5 --nu-min 3 --nu-max 50";
    let found = sandbox.done(&format!("confidence m.npz --scanner scan --out c.npz {flags}"));

    let settings = Settings { sphere_points: 200, alpha: Alpha::Own, r_max: 0.6, kappa: 0.8, temperature: 0.5 };
    let dataset = Dataset::read(sandbox.path("scan")).unwrap();
    let primitives = model::read(sandbox.path("m.npz")).unwrap();
    let c = Coverage::new(settings).confidence(&primitives, &dataset.scanner, &dataset.train.angles);
    assert!(c[0] > 0.0 && c[0] < c[1] && c[2] == 0.0, "{c:?}");
    assert_eq!(numbers(&sandbox, "c"), c);
    let target = |c: &f64| nu_target(*c, &settings, Interval { min: 3.0, max: 50.0 });
    assert_eq!(numbers(&sandbox, "nu_target"), c.iter().map(target).collect::<Vec<_>>());
    assert_eq!(numbers(&sandbox, "angles"), dataset.train.angles);
    assert_eq!(numbers(&sandbox, "nu_range"), [3.0, 50.0]);
    let npz = Npz::read(sandbox.path("c.npz")).unwrap();
    for (key, value) in [("sphere_points", 200.0), ("r_max", 0.6), ("kappa", 0.8), ("temperature", 0.5)] {
        assert_eq!(npz.get::<Ix0>(key, "[]").unwrap().into_scalar(), value, "{key}");
    }
    assert_eq!(npz.keys().count(), 8);

    assert_eq!((&found["primitives"], &found["views"]), (&3.into(), &4.into()));
    assert_eq!(found["c"]["min"], 0.0);
    assert_eq!(found["c"]["median"], c[0]);
    assert_eq!(found["c"]["max"], c[1]);
    assert_eq!(found["c_histogram"], serde_json::json!(Histogram::of(&c).counts));
    // Ranks 2, 3, 1 against 3, 2, 1.
    assert_eq!(found["spearman"], 0.5);
}

#[test]
fn alpha_is_own_the_median_or_a_length() {
    let sandbox = Sandbox::with_scan();
    write_model(&sandbox, [7.0, 5.0, 3.0]);
    let dataset = Dataset::read(sandbox.path("scan")).unwrap();
    let primitives = model::read(sandbox.path("m.npz")).unwrap();
    for (word, alpha) in [("own", Alpha::Own), ("median", Alpha::Median), ("0.05", Alpha::Length(0.05))] {
        sandbox.done(&format!("confidence m.npz --scanner scan --out c.npz --alpha {word}"));
        let settings = Settings { alpha, ..Settings::default() };
        let c = Coverage::new(settings).confidence(&primitives, &dataset.scanner, &dataset.train.angles);
        assert_eq!(numbers(&sandbox, "c"), c, "{word}");
        // A length that all primitives share is in the file.
        let npz = Npz::read(sandbox.path("c.npz")).unwrap();
        let written =
            npz.keys().any(|key| key == "alpha").then(|| npz.get::<Ix0>("alpha", "[]").unwrap().into_scalar());
        assert_eq!(written, alpha.constant(&primitives), "{word}");
    }
}

#[test]
fn views_are_those_of_the_scan_its_test_or_any() {
    let sandbox = Sandbox::with_scan();
    write_model(&sandbox, [f64::INFINITY; 3]);
    let views = |flags: &str| {
        let found = sandbox.done(&format!("confidence m.npz --scanner {flags} --out c.npz"));
        // Gaussians have no ν to compare.
        assert!(found["spearman"].is_null());
        (found["views"].as_u64().unwrap(), numbers(&sandbox, "c")[1])
    };
    let train = views("scan");
    assert_eq!((train.0, views("scan --split test").0), (4, 3));
    let one = views("scan/meta_data.json --angles -0.5");
    assert!(one.0 == 1 && one.1 < train.1, "{one:?} against {train:?}");
    let text = sandbox.run("confidence m.npz --scanner scan --out c.npz");
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(text.contains("c.median") && !text.contains("spearman"), "{text}");
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let sandbox = Sandbox::with_scan();
    write_model(&sandbox, [7.0, 5.0, 3.0]);
    let bytes = [1, 3].map(|n| {
        sandbox.done(&format!("confidence m.npz --scanner scan --out c.npz --threads {n}"));
        sandbox.read("c.npz")
    });
    assert!(bytes[0] == bytes[1]);
}

#[test]
fn impossible_settings_are_refused_by_name() {
    let sandbox = Sandbox::with_scan();
    write_model(&sandbox, [7.0, 5.0, 3.0]);
    let command = "confidence m.npz --scanner scan --out c.npz";
    for (flags, expected) in [
        ("--r-max 0", "r_max"),
        ("--kappa -1", "kappa"),
        ("--temperature 0", "temperature"),
        ("--nu-min 0", "--nu-min"),
        ("--nu-min 5 --nu-max 5", "5 and 5"),
    ] {
        let message = sandbox.refused(&format!("{command} {flags}"));
        assert!(message.contains(expected), "{flags}: {message}");
    }
    assert!(sandbox.refused("confidence n.npz --scanner scan --out c.npz").contains("n.npz"));
    assert!(sandbox.refused("confidence m.npz --scanner m.npz --out c.npz").contains("m.npz"));
    for flags in ["--sphere-points 0", "--r-max nan", "--angles 1 --split test"] {
        let output = sandbox.run(&format!("{command} {flags}"));
        assert_eq!(output.status.code(), Some(2), "{flags}: {}", stderr(&output));
    }
}
