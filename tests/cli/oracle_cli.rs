//! `trgs oracle` and `trgs compare` from outside: files, results and exit codes.

use crate::program::{Sandbox, stderr};
use ndarray::{Array2, Array3};
use trgs::scan::npy;

#[test]
fn help_has_examples() {
    let sandbox = Sandbox::new();
    for command in [
        "oracle",
        "oracle list",
        "oracle export",
        "oracle answer",
        "oracle check",
        "oracle make",
        "oracle hunt",
        "oracle replay",
        "oracle trace",
        "compare",
    ] {
        let help = String::from_utf8(sandbox.run(&format!("{command} --help")).stdout).unwrap();
        assert!(help.contains("Example") && help.contains("trgs "), "{command}: {help}");
    }
}

#[test]
fn the_list_tells_level_equations_and_flags_and_can_be_narrowed() {
    let sandbox = Sandbox::new();
    let all = sandbox.done("oracle list");
    let core = sandbox.done("oracle list --level core");
    let covariance = sandbox.done("oracle list --level core --stage covariance");
    let count = |list: &serde_json::Value| list["cases"].as_array().unwrap().len();
    assert!(count(&all) > count(&core) && count(&core) > count(&covariance) && count(&covariance) > 0);
    assert_eq!(covariance["cases"][0]["equations"][0], "Eq. 3");
    assert!(all["flags"]["ill-conditioned"].is_string());
    let message = sandbox.refused("oracle list --stage covariances");
    assert!(message.contains("covariances") && message.contains("image-exact"), "{message}");
}

#[test]
fn a_stranger_exports_answers_and_checks() {
    let sandbox = Sandbox::new();
    let exported = sandbox.done("oracle export vectors --blind --level core");
    assert!(exported["files"].as_u64().unwrap() > 20);
    assert_eq!(sandbox.names_in("vectors"), [".trgs.json", "PROTOCOL.md", "inputs", "manifest.json"]);
    // A second export replaces the first; a folder that holds other files is left alone.
    sandbox.done("oracle export vectors --level core");
    assert_eq!(sandbox.names_in("vectors"), [".trgs.json", "PROTOCOL.md", "expected", "inputs", "manifest.json"]);
    sandbox.write("vectors/thesis.txt", "years");
    assert!(sandbox.refused("oracle export vectors").contains("thesis.txt"));

    for precision in ["f64", "f32"] {
        sandbox.done(&format!("oracle answer {precision} --precision {precision}"));
        let report = sandbox.done(&format!("oracle check {precision} --precision {precision} --level stress"));
        assert!(report["results"].as_array().unwrap().iter().all(|r| r["status"] != "failed"));
    }
    let count = |level: &str| {
        sandbox.done(&format!("oracle check f64 --precision f64{level}"))["results"].as_array().unwrap().len()
    };
    assert_eq!(count(""), count(" --level core"));
    assert!(count("") < count(" --level optional"));
    // Single-precision answers must fail as double precision.
    assert_eq!(sandbox.run("oracle check f32 --precision f64").status.code(), Some(1));
}

#[test]
fn generated_questions_are_made_answered_and_checked() {
    let sandbox = Sandbox::new();
    let made = sandbox.done("oracle make questions --stage covariance,kernel --seed 3 --count 4");
    assert_eq!(made["cases"], 8);
    assert_eq!(sandbox.names_in("questions"), [".trgs.json", "PROTOCOL.md", "inputs", "manifest.json"]);
    sandbox.done("oracle answer own --vectors questions");
    let report = sandbox.done("oracle check own --vectors questions --precision f64");
    assert_eq!(report["results"].as_array().unwrap().len(), 8);
    let message = sandbox.refused("oracle make more --stage metrics");
    assert!(message.contains("metrics") && message.contains("image-exact"), "{message}");
}

#[test]
fn limits_of_a_file_are_added_and_said() {
    let sandbox = Sandbox::new();
    sandbox.done("oracle answer own --stage covariance --precision f32");
    let file = sandbox.path("own/covariance/cone-five/covariance.npy");
    let covariance = npy::read_f64::<ndarray::Ix3>(&file, "[M,3,3]").unwrap();
    npy::write(&file, (covariance * 1.001).view()).unwrap();
    let check = "oracle check own --stage covariance --precision f32 --report report.json";
    assert_eq!(sandbox.run(check).status.code(), Some(1));
    let limits = "[[rule]]\nstages = [\"covariance\"]\nreason = \"8 bits\"\nlimits.f32 = { peak = 2e-3 }\n\
                  [[element]]\nstages = [\"covariance\"]\nreason = \"8 bits\"\n";
    sandbox.write("limits.toml", limits);
    let report = sandbox.done(&format!("{check} --tolerances limits.toml"));
    assert!(report["tolerances"].as_str().unwrap().starts_with("limits.toml (SHA-256 "), "{report}");
    assert!(sandbox.text("report.md").contains("Limits of limits.toml"));
    sandbox.write("limits.toml", limits.replace("peak", "peek"));
    let message = sandbox.refused(&format!("{check} --tolerances limits.toml"));
    assert!(message.contains("limits.toml") && message.contains("peek"), "{message}");
}

#[test]
fn iterations_in_a_row_are_judged_by_a_corridor() {
    let sandbox = Sandbox::with_scan();
    let run = "--set iterations=40 --set model.points=40";
    sandbox.done(&format!("oracle trace scan rows --iteration 6 --steps 20 {run}"));
    for precision in ["f32", "f64"] {
        sandbox.done(&format!("oracle answer {precision} --vectors rows --precision {precision}"));
        sandbox.done(&format!("oracle check {precision} --vectors rows --precision {precision}"));
    }
    let manifest: serde_json::Value = serde_json::from_str(&sandbox.text("rows/manifest.json")).unwrap();
    let settings = |wrong: &serde_json::Value| wrong["cases"][0]["settings"].clone();
    assert_eq!(settings(&manifest)["views"].as_array().unwrap().len(), 20);
    let double = |value: &serde_json::Value| (2.0 * value.as_f64().unwrap()).into();
    // Trainers whose burn-in ends a step later, with other moments, and with a step too many behind them.
    for (name, changed, first) in [
        ("burn_in", (settings(&manifest)["burn_in"].as_u64().unwrap() + 1).into(), "1-losses"),
        ("beta2", serde_json::json!(0.998), "1-losses"),
        ("done", 6.into(), "1-losses"),
        ("friction", double(&settings(&manifest)["friction"]), "1-losses"),
    ] {
        let mut wrong = manifest.clone();
        wrong["cases"][0]["settings"][name] = changed;
        sandbox.write("rows/manifest.json", wrong.to_string());
        sandbox.done("oracle answer foreign --vectors rows --precision f64 --overwrite");
        sandbox.write("rows/manifest.json", manifest.to_string());
        let output = sandbox.run("oracle check foreign --vectors rows --precision f32 --json");
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let parts = report["results"][0]["parts"].as_array().unwrap();
        let failed: Vec<_> = parts.iter().filter(|part| part["status"] == "failed").collect();
        assert!(failed[0]["output"].as_str().unwrap().starts_with(first), "{name}: {}", failed[0]);
        assert!(failed[1]["message"].as_str().unwrap().starts_with(&format!("after {first}")), "{name}: {}", failed[1]);
    }
    let mut wrong = manifest.clone();
    wrong["cases"][0]["settings"]["views"][3] = 99.into();
    sandbox.write("rows/manifest.json", wrong.to_string());
    assert!(sandbox.refused("oracle answer no --vectors rows").contains("views below"));
    let message = sandbox.refused(&format!("oracle trace scan no {run} --iteration 30 --steps 12"));
    assert!(message.contains("steps: got 12, expected 1 to 11"), "{message}");
}

#[test]
fn an_iteration_is_traced_and_its_first_wrong_array_is_named() {
    let sandbox = Sandbox::with_scan();
    let run = "--set iterations=40 --set model.points=40 --set density_control.every=9";
    let made = sandbox.done(&format!("oracle trace scan step --iteration 20 {run}"));
    assert_eq!(made["cases"], 1);
    // The same iteration again, and another one.
    sandbox.done(&format!("oracle trace scan again --iteration 20 {run}"));
    sandbox.done(&format!("oracle trace scan other --iteration 21 {run}"));
    let inputs = |folder: &str| sandbox.read(&format!("{folder}/manifest.json"));
    assert_eq!(inputs("step"), inputs("again"));
    assert_ne!(inputs("step"), inputs("other"));
    for precision in ["f32", "f64"] {
        sandbox.done(&format!("oracle answer {precision} --vectors step --precision {precision}"));
        sandbox.done(&format!("oracle check {precision} --vectors step --precision {precision}"));
    }
    // Twice the momentum, and what follows from it.
    let file = "f64/iteration/step-20/10-momentum.npy";
    let momentum = npy::read_f64::<ndarray::Ix2>(&sandbox.path(file), "[M,3]").unwrap();
    npy::write(&sandbox.path(file), (momentum * 2.0).view()).unwrap();
    sandbox.done("oracle answer next --vectors other");
    sandbox.write("f64/iteration/step-20/11-raw.npz", sandbox.read("next/iteration/step-21/11-raw.npz"));
    let output = sandbox.run("oracle check f64 --vectors step --precision f64 --json");
    assert_eq!(output.status.code(), Some(1));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let parts = report["results"][0]["parts"].as_array().unwrap();
    let failed: Vec<_> = parts.iter().filter(|part| part["status"] == "failed").collect();
    assert_eq!(failed[0]["output"], "10-momentum");
    assert!(
        failed.len() > 1 && failed[1..].iter().all(|part| part["message"].as_str().unwrap().starts_with("after 10-"))
    );
    // Trainers with another friction, another decay of the rates, and another gate of the noise.
    let manifest = sandbox.text("step/manifest.json");
    let setting = |text: &str, name: &str, change: fn(&mut serde_json::Value)| {
        let mut manifest: serde_json::Value = serde_json::from_str(text).unwrap();
        change(&mut manifest["cases"][0]["settings"][name]);
        manifest.to_string()
    };
    let double = |value: &mut serde_json::Value| *value = (2.0 * value.as_f64().unwrap()).into();
    for (wrong, first) in [
        (setting(&manifest, "friction", double), "10-momentum"),
        (setting(&manifest, "length", |value| *value = 30.into()), "07-rates"),
        (setting(&manifest, "reference", double), "10-momentum"),
    ] {
        assert_ne!(wrong, manifest);
        sandbox.write("step/manifest.json", wrong);
        sandbox.done("oracle answer foreign --vectors step --precision f64 --overwrite");
        sandbox.write("step/manifest.json", &manifest);
        let output = sandbox.run("oracle check foreign --vectors step --precision f64 --json");
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let mut parts = report["results"][0]["parts"].as_array().unwrap().iter();
        assert_eq!(parts.find(|part| part["status"] == "failed").unwrap()["output"], first);
    }
    // Recycling where it is due: trainers that recycle nothing, that keep moments, and whose copies stay in place.
    let more = "--set density_control.every=4 --set density_control.dead=0.05 --set density_control.reset_parents=true";
    assert_eq!(sandbox.done(&format!("oracle trace scan due --iteration 20 {run} {more}"))["cases"], 2);
    let manifest = sandbox.text("due/manifest.json");
    for precision in ["f32", "f64"] {
        sandbox.done(&format!("oracle answer due-{precision} --vectors due --precision {precision}"));
        sandbox.done(&format!("oracle check due-{precision} --vectors due --precision {precision}"));
    }
    for (name, value, first) in
        [("dead", 0.0, "1-parent"), ("reset_parents", 0.0, "4-first"), ("spread", 0.0, "3-physical")]
    {
        let mut wrong: serde_json::Value = serde_json::from_str(&manifest).unwrap();
        wrong["cases"][1]["settings"][name] = value.into();
        sandbox.write("due/manifest.json", wrong.to_string());
        sandbox.done("oracle answer foreign --vectors due --precision f64 --overwrite");
        sandbox.write("due/manifest.json", &manifest);
        let output = sandbox.run("oracle check foreign --vectors due --precision f32 --json");
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!([&report["results"][0]["status"], &report["results"][1]["status"]], ["passed", "failed"], "{name}");
        let parts = report["results"][1]["parts"].as_array().unwrap();
        let failed: Vec<_> = parts.iter().filter(|part| part["status"] == "failed").collect();
        let output = failed[0]["output"].as_str().unwrap();
        assert!(output.starts_with(first), "{name}: {output}");
        assert!(failed[1..].iter().all(|part| part["message"].as_str().unwrap().starts_with("after ")), "{name}");
    }
    for (change, part) in [
        ("--iteration 41", "iteration: got 41, expected 1 to 40"),
        ("--iteration 3 --set optimiser.position=sghmc-textbook", "sghmc-textbook"),
        ("--iteration 3 --set method=fdk", "method: got FDK, expected one that fits primitives"),
    ] {
        let message = sandbox.refused(&format!("oracle trace scan no {run} {change}"));
        assert!(message.contains(part), "{message}");
    }
    sandbox.done("simulate --phantom torso --out helix --size 12 --detector 14,15 --views 4 --test-views 0 --roll 3");
    assert!(sandbox.refused(&format!("oracle trace helix no {run} --iteration 3")).contains("poses"));
}

#[cfg(unix)]
#[test]
fn a_hunt_starts_the_backend_and_its_finding_is_replayed() {
    let sandbox = Sandbox::new();
    // Single precision is wrong as double precision.
    let program = env!("CARGO_BIN_EXE_trgs");
    for precision in ["f32", "f64"] {
        let text = format!("{program} oracle answer \"$2\" --vectors \"$1\" --precision {precision} > log\n");
        sandbox.write(&format!("{precision}.sh"), text);
    }
    let hunt = "oracle hunt --stage haar --cases 8 --precision f64 --out";
    let found = sandbox.run(&format!("{hunt} found --json -- sh f32.sh"));
    assert_eq!(found.status.code(), Some(1), "{}", stderr(&found));
    let found: serde_json::Value = serde_json::from_slice(&found.stdout).unwrap();
    let case = format!("found/{}", found["findings"][0]["case"].as_str().unwrap());
    assert_eq!(sandbox.run(&format!("oracle replay {case} -- sh f32.sh")).status.code(), Some(1));
    assert_eq!(sandbox.run(&format!("oracle replay {case} -- sh f64.sh")).status.code(), Some(0));
    assert_eq!(sandbox.run(&format!("{hunt} none -- sh f64.sh")).status.code(), Some(0));
    assert!(sandbox.refused(&format!("{hunt} found --seed 2 -- sh f32.sh")).contains("other settings"));
    assert!(sandbox.refused(&format!("{hunt} nobody -- no-such-backend")).contains("no-such-backend"));
}

#[test]
fn a_failed_check_ends_with_1_and_writes_its_four_reports() {
    let sandbox = Sandbox::new();
    sandbox.done("oracle answer own --stage covariance,kernel");
    let case = sandbox.done("oracle list --stage kernel")["cases"][0].clone();
    let file = format!("own/{}", case["outputs"]["kernel"]["file"].as_str().unwrap());
    let array = npy::read_f64::<ndarray::Ix1>(&sandbox.path(&file), "[N]").unwrap();
    npy::write(&sandbox.path(&file), (array * 2.0).view()).unwrap();
    let check = "oracle check own --stage covariance,kernel --precision f64 --level stress";
    let output = sandbox.run(&format!("{check} --report report.json"));
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("FAILED") && text.contains("a factor of 2"), "{text}");
    assert_eq!(text.trim_end(), sandbox.text("report.md").trim_end());
    assert!(sandbox.text("report.html").contains("a factor of 2"));
    assert!(sandbox.text("report.xml").contains("a factor of 2") && sandbox.text("report.json").contains("looks_like"));

    let id = case["id"].as_str().unwrap();
    let waiver = |day: &str| format!("[[waiver]]\ncase = \"{id}\"\nreason = \"twice is nice\"\nexpires = {day}\n");
    sandbox.write("waivers.toml", waiver("9999-12-31"));
    assert_eq!(sandbox.run(&format!("{check} --waivers waivers.toml")).status.code(), Some(0));
    sandbox.write("waivers.toml", waiver("2020-01-01"));
    assert_eq!(sandbox.run(&format!("{check} --waivers waivers.toml")).status.code(), Some(1));
    sandbox.write("waivers.toml", waiver("tomorrow"));
    assert!(sandbox.refused(&format!("{check} --waivers waivers.toml")).contains("waivers.toml"));
    assert!(sandbox.refused(&format!("{check} --report report.txt")).contains(".json"));
    assert!(sandbox.refused("oracle check nowhere").contains("nowhere"));
}

#[test]
fn compare_names_what_it_sees() {
    let sandbox = Sandbox::new();
    let image = |shift: f64| {
        Array3::from_shape_fn((2, 20, 24), |(n, r, c)| {
            let (y, x) = (r as f64 - 9.2 - n as f64, c as f64 - 11.4 - shift);
            1.0 / (1.0 + (x * x + 0.6 * y * y + 0.3 * x * y) / 20.0)
        })
    };
    npy::write(&sandbox.path("a.npy"), image(0.0).view()).unwrap();
    npy::write(&sandbox.path("b.npy"), image(0.5).view()).unwrap();
    npy::write(&sandbox.path("c.npy"), image(0.0).mapv(|x| x as f32).view()).unwrap();
    npy::write(&sandbox.path("d.npy"), Array2::<f64>::zeros((3, 4)).view()).unwrap();
    let output = sandbox.run("compare a.npy b.npy --axes view,v,u");
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert!(text.contains("looks like a half-pixel shift in u towards higher indices"), "{text}");
    let worst = text.lines().find(|line| line.contains("worst at [")).unwrap();
    assert!(worst.contains(": expected ") && worst.contains(", got "), "{worst}");
    let ulp = text.lines().find_map(|line| line.strip_suffix(" ulp")?.rsplit(' ').next()).unwrap();
    assert!(ulp.contains("e1") && ulp.len() < 8, "{ulp}");
    assert_eq!(sandbox.run("compare a.npy b.npy --tolerance 1e-3").status.code(), Some(1));
    assert_eq!(sandbox.run("compare a.npy c.npy --tolerance 1e-7 --precision f32").status.code(), Some(0));
    assert_eq!(sandbox.done("compare a.npy a.npy --tolerance 0")[0]["difference"]["peak"], 0.0);
    assert_eq!(sandbox.run("compare a.npy d.npy --tolerance 1").status.code(), Some(1));
    assert!(sandbox.refused("compare a.npy nowhere.npy").contains("nowhere.npy"));
}
