//! Poses in the program: simulated, described, rendered, converted; fields that are not read.

use crate::program::{Sandbox, stderr};
use crate::tolerances::largest;
use serde_json::json;
use trgs::numeric::elementary::{cos, sin};
use trgs::scan::{Dataset, npy};

const SCAN: &str = "simulate --phantom torso --size 16 --detector 24 --views 6 --test-views 2 --out scan";

#[test]
fn a_helix_is_simulated_described_and_reconstructed_but_not_by_fdk() {
    let sandbox = Sandbox::new();
    sandbox.done(&format!("{SCAN} --helix 0.3,2 --roll 2 --axis-shift 0.1"));
    let found = sandbox.done("inspect scan");
    let words = found["poses"].as_str().unwrap();
    assert!(
        words.contains("roll 2°") && words.contains("axis shift 0.1") && words.contains("height -0.3 to 0.2"),
        "{words}"
    );
    assert_eq!(found["oddities"], json!([]));
    let message = sandbox.refused("reconstruct scan --method fdk --out run");
    assert!(message.contains("poses for filtered backprojection") && message.contains("sart"), "{message}");
    sandbox.done("reconstruct scan --method sart --iterations 2 --out sart");
    sandbox.done("reconstruct scan --iterations 5 --points 50 --set finish=none --out run");
    // Projections of a model are those of the scan's views, whatever the split.
    for (split, views) in [("train", 6), ("test", 2)] {
        let rendered = sandbox.done(&format!("render run/model.npz --scanner scan --split {split} --out {split}.npy"));
        assert_eq!(rendered["shape"][0], views);
    }
    let message = sandbox.refused("render run/model.npz --scanner scan --angles 0.3 --out other.npy");
    assert!(message.contains("each has a pose of its own"), "{message}");
    sandbox.done("confidence run/model.npz --scanner scan --out c.npz");
    let message = sandbox.refused("inspect scan --check-geometry");
    assert!(message.contains("circle"), "{message}");
}

/// TIGRE's COR in a description is the axis shift of the simulation.
#[test]
fn a_description_with_cor_is_the_scan_with_a_shifted_axis() {
    let sandbox = Sandbox::new();
    sandbox.done(&format!("{SCAN} --axis-shift 0.14"));
    let shifted = Dataset::read(sandbox.path("scan")).unwrap();
    sandbox.edit("scan/meta_data.json", |meta| {
        meta["scanner"]["COR"] = json!(0.14);
        for list in ["proj_train", "proj_test"] {
            for view in meta[list].as_array_mut().unwrap() {
                view.as_object_mut().unwrap().remove("vector");
            }
        }
    });
    let stated = Dataset::read(sandbox.path("scan")).unwrap();
    for (a, b) in [(&shifted.train, &stated.train), (shifted.test.as_ref().unwrap(), stated.test.as_ref().unwrap())] {
        for (a, b) in a.poses.as_ref().unwrap().iter().zip(b.poses.as_ref().unwrap()) {
            within!(a.source.distance(b.source).max(a.centre.distance(b.centre)));
        }
    }
    // One deviation for all views holds at any angle.
    sandbox.done("reconstruct scan --iterations 5 --points 50 --set finish=none --out run");
    sandbox.done("render run/model.npz --scanner scan --angles 0.3,0.4 --out other.npy");
    // A typo is an error with the name meant, in every command.
    sandbox.edit("scan/meta_data.json", |meta| {
        let fields = meta["scanner"].as_object_mut().unwrap();
        fields.remove("COR");
        fields.insert("offDetecor".into(), json!([12.0, 0.0]));
    });
    for command in ["inspect scan", "reconstruct scan --out other", "render run/model.npz --scanner scan --out o.npy"] {
        let message = sandbox.refused(command);
        assert!(message.contains("offDetecor") && message.contains("did you mean offDetector?"), "{message}");
    }
}

#[test]
fn a_field_that_is_not_read_is_an_oddity_on_reading_and_in_inspect() {
    let sandbox = Sandbox::new();
    sandbox.done(SCAN);
    sandbox.edit("scan/meta_data.json", |meta| meta["scanner"]["tube"] = json!("W"));
    let remark = "the field tube of scanner is not read";
    assert_eq!(sandbox.done("inspect scan")["oddities"], json!([remark]));
    let output = sandbox.run("reconstruct scan --method sart --iterations 1 --out run");
    assert!(output.status.success() && stderr(&output).contains(remark), "{}", stderr(&output));
}

#[test]
fn the_geometry_of_rtk_gives_the_poses_of_a_stack() {
    let sandbox = Sandbox::new();
    sandbox.done(SCAN);
    let scan = Dataset::read(sandbox.path("scan")).unwrap();
    npy::write(&sandbox.path("stack.npy"), scan.train.images.view()).unwrap();
    let view = |i: usize| {
        format!("<Projection><GantryAngle>{}</GantryAngle><InPlaneAngle>3</InPlaneAngle></Projection>", 60 * i)
    };
    let text = format!(
        "<?xml version=\"1.0\"?><!DOCTYPE RTKGEOMETRY><RTKThreeDCircularGeometry version=\"3\">\
         <SourceToIsocenterDistance>5</SourceToIsocenterDistance><SourceToDetectorDistance>7</SourceToDetectorDistance>{}\
         </RTKThreeDCircularGeometry>",
        (0..6).map(view).collect::<String>()
    );
    sandbox.write("geometry.xml", text);
    assert_eq!(sandbox.done("inspect geometry.xml")["views"], 6);
    sandbox.edit("scan/meta_data.json", |meta| {
        meta.as_object_mut().unwrap().remove("proj_train");
        meta.as_object_mut().unwrap().remove("proj_test");
    });
    sandbox.done("convert stack.npy out --scanner scan/meta_data.json --line-integrals --geometry geometry.xml");
    let words = sandbox.done("inspect out")["poses"].as_str().unwrap().to_owned();
    assert!(words.contains("roll -3°"), "{words}");
    let read = Dataset::read(sandbox.path("out")).unwrap();
    let apart = |i: usize| read.train.angles[i] - scan.train.angles[i];
    within!("angles", largest((0..6).map(|i| sin(apart(i)))), "{:?}", read.train.angles);
    assert!((0..6).all(|i| cos(apart(i)) > 0.0), "{:?}", read.train.angles);
}

#[test]
fn a_pickle_is_inspected() {
    let sandbox = Sandbox::new();
    sandbox.write("odd.pickle", include_bytes!("../data/naf_odd.pickle"));
    let found = sandbox.done("inspect odd.pickle");
    let oddities = found["oddities"].to_string();
    assert!(
        found["kind"] == "dataset" && oddities.contains("look like degrees") && oddities.contains("field date"),
        "{found}"
    );
}
