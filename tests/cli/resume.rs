//! An interrupted and resumed run ends with the same bits as an uninterrupted run.

use crate::program::{Sandbox, stderr};
use std::fs;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// A run with all features: both blocks, all phases of the sampler, density control, checkpoints.
const RUN: &str = "reconstruct scan --iterations 240 --points 300 --seed 5 --set checkpoint_every=7 \
    --set report_every=20 --set density_control.every=10 --set confidence.every=30 --set wavelet.block=8 --out";
/// Results that contain no time.
const FILES: [&str; 4] = ["config.toml", "model.npz", "volume.npy", "metrics.json"];

fn results(sandbox: &Sandbox, run: &str) -> Vec<Vec<u8>> {
    FILES.map(|file| fs::read(sandbox.path(&format!("{run}/{file}"))).unwrap()).into()
}

fn spawn(sandbox: &Sandbox, arguments: &str) -> Child {
    Command::new(assert_cmd::cargo::cargo_bin!("trgs"))
        .args(arguments.split_whitespace())
        .current_dir(sandbox.path(""))
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// A scan, with the time and the results of an uninterrupted run.
fn undisturbed(method: &str) -> (Sandbox, Duration, Vec<Vec<u8>>) {
    let sandbox = Sandbox::with_scan();
    let began = Instant::now();
    sandbox.done(&format!("{RUN} calm --method {method}"));
    let results = results(&sandbox, "calm");
    (sandbox, began.elapsed(), results)
}

#[test]
fn a_run_killed_at_ten_moments_ends_with_the_bits_of_an_undisturbed_one() {
    for method in ["tr-gs", "r2-gaussian"] {
        let (sandbox, duration, expected) = undisturbed(method);
        let storm = format!("{RUN} storm --method {method} --resume");
        let mut killed = 0;
        // Irregular times; all processes together pass about once through the run.
        for k in 0..10_u32 {
            let mut child = spawn(&sandbox, &storm);
            sleep(duration.mul_f64(0.04 + 0.61803 * f64::from(k) % 0.14));
            // SIGKILL: no signal handler runs.
            child.kill().unwrap();
            killed += u32::from(!child.wait().unwrap().success());
        }
        assert!(killed >= 5, "{method}: only {killed} of 10 processes were still running when they were killed");
        sandbox.done(&storm);
        assert!(results(&sandbox, "storm") == expected, "{method}: other results after {killed} kills");
    }
}

/// Total variation on voxels, including the choice of its weight.
#[test]
fn total_variation_that_is_killed_ends_with_the_bits_of_an_undisturbed_run() {
    const RUN: &str =
        "reconstruct scan --method tv --iterations 600 --set tv.tolerance=0 --set checkpoint_every=3 --out";
    let sandbox = Sandbox::with_scan();
    let began = Instant::now();
    sandbox.done(&format!("{RUN} calm"));
    let duration = began.elapsed();
    let results =
        |run: &str| ["config.toml", "volume.npy", "metrics.json"].map(|file| sandbox.read(&format!("{run}/{file}")));
    let storm = format!("{RUN} storm --resume");
    for k in 0..4_u32 {
        let mut child = spawn(&sandbox, &storm);
        sleep(duration.mul_f64(0.3 + 0.1 * f64::from(k)));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    sandbox.done(&storm);
    assert!(results("storm") == results("calm"));
    let log = |run: &str| sandbox.text(&format!("{run}/log.jsonl")).lines().count();
    assert_eq!((log("storm"), log("calm")), (600, 600));
    assert!(sandbox.text("calm/metrics.json").contains("tv.weight"));
    assert!(sandbox.text("calm/report.html").contains("Choice of tv.weight"));
}

#[cfg(unix)]
#[test]
fn an_interrupt_saves_the_state_and_says_how_to_go_on() {
    let (sandbox, duration, expected) = undisturbed("tr-gs");
    let child = spawn(&sandbox, &format!("{RUN} calm2"));
    sleep(duration / 2);
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(130), "{message}");
    assert!(message.contains("--resume") && message.contains("saved"), "{message}");
    assert!(sandbox.path("calm2/checkpoints/last.msgpack").exists() && !sandbox.path("calm2/model.npz").exists());

    let again = sandbox.run(&format!("{RUN} calm2 --resume"));
    assert!(stderr(&again).contains("resuming after iteration"), "{}", stderr(&again));
    assert!(results(&sandbox, "calm2") == expected);
    // A finished run stays unchanged when resumed again.
    sandbox.done(&format!("{RUN} calm2 --resume"));
    assert!(results(&sandbox, "calm2") == expected);
}

#[test]
fn a_run_is_not_gone_on_with_under_other_settings_or_on_other_data() {
    let sandbox = Sandbox::with_scan();
    let run = "reconstruct scan --out run --iterations 6 --points 50 --set wavelet.block=8";
    sandbox.done(run);
    for (flag, names) in [
        ("--seed 8", ["seed", "got 8", "0, as in the checkpoint"]),
        ("--set loss.tv=0", ["loss.tv", "got 0.0", "as in the checkpoint"]),
        ("--method r2-gaussian", ["method", "r2-gaussian", "--resume"]),
        ("--views 3", ["dataset", "other projections", "--resume"]),
    ] {
        let message = sandbox.refused(&format!("reconstruct scan --out run --quiet --resume {flag}"));
        assert!(names.iter().all(|name| message.contains(name)), "{flag}: {message}");
    }
    let message = {
        let path = sandbox.path("run/checkpoints/last.msgpack");
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        sandbox.refused("reconstruct scan --out run --resume")
    };
    assert!(message.contains("last.msgpack") && message.contains("without --resume"), "{message}");
}

#[test]
fn a_resumed_run_takes_its_settings_from_the_checkpoint() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("reconstruct scan --out run --iterations 9 --points 50 --seed 3 --set wavelet.block=8");
    let before = results(&sandbox, "run");
    sandbox.done("reconstruct scan --out run --resume");
    assert!(results(&sandbox, "run") == before);
}
