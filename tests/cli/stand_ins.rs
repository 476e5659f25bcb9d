//! Stand-ins and pseudo truths are named as such.

use crate::program::Sandbox;
use serde_json::Value;
use std::collections::BTreeSet;
use trgs::scan::npy;

fn notes(found: &Value) -> String {
    found["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap().to_owned() + "\n").collect()
}

#[test]
fn a_scan_of_a_stand_in_says_what_it_is_wherever_it_is_used() {
    let sandbox = Sandbox::new();
    let small = "--size 12 --detector 14 --views 4 --test-views 2";
    let scan = sandbox.done(&format!("simulate --phantom chest --out scan {small}"));
    assert!(notes(&scan).contains("chest is a procedural stand-in"), "{scan}");
    assert!(sandbox.text("scan/meta_data.json").contains("stand-in"));
    assert!(notes(&sandbox.done("inspect scan")).contains("stand-in"));
    sandbox.done("convert scan copy");
    assert!(notes(&sandbox.done("inspect copy")).contains("stand-in"));
    let said = crate::program::stderr(&sandbox.run("reconstruct scan --out run --method fdk"));
    assert!(said.contains("stand-in") && sandbox.text("run/report.html").contains("stand-in"), "{said}");
    assert!(crate::program::stderr(&sandbox.run("evaluate run --against scan")).contains("stand-in"));
    let help = String::from_utf8(sandbox.run("simulate --help").stdout).unwrap();
    let words = help.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains("stand-ins, which share only their names with the scans of the paper"), "{words}");
    assert!(words.contains("animals and plants: beetle, bonsai, broccoli, kingsnake, pepper"), "{words}");
    assert!(sandbox.done(&format!("simulate --phantom torso --out torso {small}")).get("notes").is_none());
}

#[test]
fn a_scan_with_many_views_becomes_one_with_few_and_a_pseudo_truth() {
    let sandbox = Sandbox::new();
    sandbox
        .done("simulate --phantom torso --out scan --size 12 --detector 14,15 --views 30 --test-views 3 --noise high");
    let few = sandbox.done("convert scan few --views 7 --test-views 5 --pseudo-truth --seed 3");
    assert!(notes(&few).contains("pseudo truth") && notes(&few).contains("7 of 30 measured views"), "{few}");
    let found = sandbox.done("inspect few");
    assert_eq!((&found["train"]["views"], &found["test"]["views"]), (&7.into(), &5.into()));
    assert!(notes(&found).contains("pseudo truth: FDK of all 30 views"), "{found}");

    // The truth equals the result of `reconstruct` from all views, without its negative values.
    sandbox.done("reconstruct scan --out run --method fdk");
    let volume = |name: &str| npy::read_f32::<ndarray::Ix3>(&sandbox.path(name), "[x, y, z]").unwrap();
    let (truth, fdk) = (volume("few/vol_gt.npy"), volume("run/volume.npy"));
    assert!(fdk.iter().any(|density| *density < 0.0));
    assert_eq!(truth, fdk.mapv(|density| density.max(0.0)));
    assert_ne!(truth, volume("scan/vol_gt.npy"));

    // Views are those of the scan, each at most once.
    let meta = |name: &str| serde_json::from_str::<Value>(&sandbox.text(&format!("{name}/meta_data.json"))).unwrap();
    let angles = |list: &Value| -> Vec<String> {
        list.as_array().unwrap().iter().map(|view| view["angle"].to_string()).collect()
    };
    let (all, kept) = (angles(&meta("scan")["proj_train"]), meta("few"));
    let (train, test) = (angles(&kept["proj_train"]), angles(&kept["proj_test"]));
    assert_eq!(train, [0, 4, 9, 14, 19, 24, 29].map(|view: usize| all[view].clone()));
    let unique: BTreeSet<&String> = train.iter().chain(&test).collect();
    assert!(unique.len() == 12 && unique.iter().all(|angle| all.contains(angle)), "{train:?} {test:?}");

    sandbox.done("convert scan again --views 7 --test-views 5 --pseudo-truth --seed 3");
    assert_eq!(sandbox.text("again/meta_data.json"), sandbox.text("few/meta_data.json"));
    sandbox.done("convert scan other --views 7 --test-views 5 --seed 4");
    assert_ne!(meta("other")["proj_test"], kept["proj_test"]);
    assert_eq!(volume("other/vol_gt.npy"), volume("scan/vol_gt.npy"));
    assert_eq!(sandbox.done("inspect other")["train"]["views"], 7);
    sandbox.done("convert scan whole --pseudo-truth");
    assert_eq!(angles(&meta("whole")["proj_train"]), all);
}

#[test]
fn views_that_cannot_be_chosen_are_refused() {
    let sandbox = Sandbox::with_scan();
    for (arguments, part) in [
        ("convert scan few --views 5", "views to keep: got 5, expected 1 to 4"),
        ("convert scan few --views 0", "views to keep"),
        ("convert scan few --views 3 --test-views 2", "test views: got 2, expected at most 1"),
        ("convert scan/vol_gt.npy v.mha --pseudo-truth", "--pseudo-truth"),
        ("convert scan/vol_gt.npy v.mha --views 3", "--views"),
    ] {
        let message = sandbox.refused(arguments);
        assert!(message.contains(part), "{arguments}: {message}");
    }
    for arguments in ["convert scan few --test-views 2", "convert scan few --seed 2"] {
        let output = sandbox.run(arguments);
        assert!(output.status.code() == Some(2) && crate::program::stderr(&output).contains("--views"), "{arguments}");
    }
}
