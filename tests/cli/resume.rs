//! An interrupted and resumed run ends with the same bits as an uninterrupted run.

use crate::program::{Sandbox, stderr};
use crate::tolerances::largest;
use std::fs;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};
use trgs::primitives::{Group, Parameters};

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

/// The lines of a log without their seconds. The last line of a log that grows may be half-written.
fn log(sandbox: &Sandbox, run: &str, is_whole: bool) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(sandbox.path(&format!("{run}/log.jsonl"))).unwrap_or_default();
    let whole = if is_whole { &text } else { text.rsplit_once('\n').map_or("", |(lines, _)| lines) };
    let timeless = |line: &str| {
        let mut record: serde_json::Value = serde_json::from_str(line).unwrap_or_else(|_| panic!("{line}"));
        record.as_object_mut().unwrap().remove("seconds");
        record
    };
    whole.lines().map(timeless).collect()
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
        let (sandbox, _, expected) = undisturbed(method);
        let whole = log(&sandbox, "calm", true);
        let storm = format!("{RUN} storm --method {method} --resume");
        let (mut killed, mut most) = (0, 0);
        for k in 0..10_u32 {
            let mut child = spawn(&sandbox, &storm);
            // Each process goes on until the log has a line more, and for an irregular time. Times alone do not tell how
            // far a process has come: other tests take the cores.
            let lines = 1 + k as usize * (whole.len() - 2) / 10;
            while log(&sandbox, "storm", false).len() < lines && child.try_wait().unwrap().is_none() {
                sleep(Duration::from_millis(2));
            }
            sleep(Duration::from_millis(u64::from(7 * k % 10)));
            // SIGKILL: no signal handler runs.
            child.kill().unwrap();
            killed += u32::from(!child.wait().unwrap().success());
            // The log grows while the run goes on, with the records of the undisturbed one.
            let grown = log(&sandbox, "storm", false);
            assert!(grown == whole[..grown.len()], "{method}: {grown:?}");
            most = most.max(grown.len());
        }
        assert!(most > 8, "{method}: a log of {most} lines");
        assert!(killed >= 8, "{method}: only {killed} of 10 processes were still running when they were killed");
        sandbox.done(&storm);
        assert!(results(&sandbox, "storm") == expected, "{method}: other results after {killed} kills");
        assert!(log(&sandbox, "storm", true) == whole, "{method}");
    }
}

/// Total variation on voxels, including the choice of its weight.
#[test]
fn total_variation_that_is_killed_ends_with_the_bits_of_an_undisturbed_run() {
    const RUN: &str =
        "reconstruct scan --method tv --iterations 240 --set tv.tolerance=0 --set checkpoint_every=3 --out";
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
    let [storm, calm] = ["storm", "calm"].map(|run| log(&sandbox, run, true));
    assert!(storm == calm && calm.len() == 240);
    assert!(sandbox.text("calm/metrics.json").contains("tv.weight"));
    assert!(sandbox.text("calm/report.html").contains("Choice of tv.weight"));
}

#[cfg(unix)]
#[test]
fn an_interrupt_saves_the_state_and_says_how_to_go_on() {
    let (sandbox, duration, expected) = undisturbed("tr-gs");
    let child = spawn(&sandbox, &format!("{RUN} calm2"));
    sleep(duration / 2);
    assert!(
        Command::new("kill").args([crate::program::interrupt(), &child.id().to_string()]).status().unwrap().success()
    );
    let output = child.wait_with_output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(130), "{message}");
    let command = message.trim_end().rsplit_once("its state is saved; go on with: trgs ").expect(&message).1;
    assert_eq!(command, "reconstruct scan --out calm2 --resume");
    assert!(sandbox.path("calm2/checkpoints/last.msgpack").exists() && !sandbox.path("calm2/model.npz").exists());

    let again = sandbox.run(command);
    assert!(stderr(&again).contains("resuming after iteration"), "{}", stderr(&again));
    assert!(results(&sandbox, "calm2") == expected);
    // A finished run is complete: nothing is done, and the metrics are said again.
    let before = sandbox.content();
    let again = sandbox.run(&format!("{RUN} calm2 --resume --json"));
    assert!(again.status.success() && stderr(&again).contains("calm2 is complete"), "{}", stderr(&again));
    let said: serde_json::Value = serde_json::from_slice(&again.stdout).unwrap();
    let metrics: serde_json::Value = serde_json::from_str(&sandbox.text("calm2/metrics.json")).unwrap();
    assert!(said["psnr_3d"] == metrics["psnr_3d"] && said["psnr_3d"]["value"].is_number(), "{said}");
    assert!(sandbox.content() == before);
    // Results that are missing are made again, without another pilot run.
    fs::remove_file(sandbox.path("calm2/volume.npy")).unwrap();
    let again = sandbox.run(&format!("{RUN} calm2 --resume"));
    assert!(!stderr(&again).contains("complete") && !stderr(&again).contains("pilot"), "{}", stderr(&again));
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

/// A method on voxels has no horizon: more passes end with the bits of the longer run.
#[test]
fn more_passes_on_voxels_after_the_end_of_a_run_are_those_of_a_longer_run() {
    let sandbox = Sandbox::with_scan();
    for (method, settings) in [
        ("sart", "--set algebraic.order=random"),
        ("os-sart", "--set algebraic.subset=2"),
        ("asd-pocs", ""),
        ("cgls", ""),
        ("cgls", "--precision f64"),
        ("tv", "--set tv.weight=1e-3 --set tv.tolerance=0"),
        ("naf", "--set neural.rays=64 --set neural.samples=16"),
        ("sax-nerf", "--set neural.rays=32 --set neural.samples=16 --precision f64"),
        ("intratomo", "--set neural.rays=32 --set neural.samples=16"),
    ] {
        let run = |out: &str, more: &str| {
            let output = sandbox.run(&format!("reconstruct scan --out {out} --method {method} {settings} {more}"));
            assert!(output.status.success(), "{method}: {}", stderr(&output));
            stderr(&output)
        };
        // The rates of networks drop where those of the shorter run do.
        let is_network = settings.contains("neural");
        run("long", if is_network { "--iterations 9 --set neural.drop=2" } else { "--iterations 9" });
        run("short", "--iterations 4");
        assert!(sandbox.read("short/volume.npy") != sandbox.read("long/volume.npy"), "{method}");
        let said = run("short", "--resume --iterations 9 --threads 3");
        assert!(said.contains("continuing after iteration 4 to 9 instead of 4: the result is that of"), "{said}");
        assert_eq!(said.contains("from its start with neural.drop=2"), is_network, "{said}");
        for file in ["config.toml", "volume.npy", "metrics.json"] {
            assert!(
                sandbox.read(&format!("short/{file}")) == sandbox.read(&format!("long/{file}")),
                "{method}: {file}"
            );
        }
        assert_eq!(sandbox.text("short/log.jsonl").lines().count(), 9, "{method}");
        let message = sandbox.refused("reconstruct scan --out short --resume --iterations 5 --quiet");
        assert!(
            message.contains("iterations: got 5, expected more than 9") && message.contains("iterations=18"),
            "{message}"
        );
        // The number that the run has is no error, so that one command can be repeated after every crash.
        let before = sandbox.read("short/volume.npy");
        sandbox.done("reconstruct scan --out short --resume --iterations 9 --quiet");
        assert!(sandbox.read("short/volume.npy") == before, "{method}");
        fs::remove_dir_all(sandbox.path("short")).unwrap();
        fs::remove_dir_all(sandbox.path("long")).unwrap();
    }
    sandbox.done("reconstruct scan --out chosen --method sart --iterations 6 --auto");
    let message = sandbox.refused("reconstruct scan --out chosen --resume --iterations 9 --quiet");
    assert!(message.contains("algebraic.auto") && message.contains("without --resume"), "{message}");
}

/// Primitives follow the schedule of the longer run from where the shorter one ended.
#[test]
fn more_iterations_after_the_end_of_a_run_continue_it_with_the_same_bits_on_any_threads() {
    let sandbox = Sandbox::with_scan();
    // As many views as a pilot run needs to hold some out.
    sandbox
        .done("simulate --phantom torso --out scan --size 12 --detector 14,15 --views 12 --test-views 3 --noise low");
    let run = "reconstruct scan --points 200 --seed 5 --set report_every=20 --set wavelet.block=8";
    sandbox.done(&format!("{run} --out short --iterations 80"));
    sandbox.done(&format!("{run} --out straight --iterations 200"));
    for out in ["one", "three", "killed"] {
        fs::create_dir_all(sandbox.path(&format!("{out}/checkpoints"))).unwrap();
        for file in [".trgs.json", "checkpoints/last.msgpack"] {
            fs::copy(sandbox.path(&format!("short/{file}")), sandbox.path(&format!("{out}/{file}"))).unwrap();
        }
    }
    let output = sandbox.run("reconstruct scan --out one --resume --iterations 200 --threads 1");
    let said = stderr(&output);
    assert!(said.contains("continuing after iteration 80 to 200 instead of 80: learning rates"), "{said}");
    assert!(said.contains("differs from a run of 200 from its start"), "{said}");
    assert!(
        said.contains("kept from the run of 80 iterations: sampling ") && said.contains("--choose-again"),
        "{said}"
    );
    let decision = |run: &str| {
        let metrics: serde_json::Value = serde_json::from_str(&sandbox.text(&format!("{run}/metrics.json"))).unwrap();
        [metrics["choice"].clone(), metrics["sampled"].clone()]
    };
    assert_eq!(decision("one"), decision("short"));
    assert!(decision("short").iter().all(|value| value.is_object()));
    sandbox.done("reconstruct scan --out three --resume --iterations 200 --threads 3");
    let three = results(&sandbox, "three");
    // Continued in two parts with the length of the second.
    let mut child = spawn(&sandbox, "reconstruct scan --out killed --resume --iterations 200");
    sleep(Duration::from_millis(300));
    drop(child.kill());
    child.wait().unwrap();
    sandbox.done("reconstruct scan --out killed --resume --iterations 200");
    let one = results(&sandbox, "one");
    // Forgotten, the decision is that of a pilot run of 100 iterations.
    sandbox.done("reconstruct scan --out three --resume --choose-again");
    assert_ne!(decision("three")[0], decision("one")[0]);
    assert!(three == one && results(&sandbox, "killed") == one);
    assert!(sandbox.read("straight/model.npz") != sandbox.read("one/model.npz"));
    let log: Vec<serde_json::Value> =
        sandbox.text("one/log.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let of = |at: u64, key: &str| log.iter().find(|line| line["iteration"] == at).unwrap()[key].as_f64().unwrap();
    assert_eq!(
        (of(80, "iterations"), of(100, "iterations"), log.last().unwrap()["iteration"].as_u64()),
        (80.0, 200.0, Some(200))
    );
    assert!(of(200, "loss") <= of(80, "loss"), "{} after {}", of(200, "loss"), of(80, "loss"));
    let provenance: serde_json::Value = serde_json::from_str(&sandbox.text("one/provenance.json")).unwrap();
    assert_eq!(provenance["continued"], serde_json::json!([80]));
    assert!(sandbox.text("one/report.html").contains("continued after iteration"));
    assert!(!sandbox.text("straight/provenance.json").contains("continued"));
    let message = sandbox.refused("reconstruct scan --out one --resume --iterations 100 --quiet");
    assert!(
        message.contains("iterations: got 100, expected more than 200") && message.contains("--resume"),
        "{message}"
    );
}

/// Without a schedule there is no seam: the values are those of the longer run from its start, up to the rounding of rates.
#[test]
fn more_iterations_of_a_run_whose_settings_do_not_depend_on_its_length_are_those_of_a_longer_run() {
    let sandbox = Sandbox::with_scan();
    // Rates are constant, the horizon leaves them as they are, and the phases of sampler and density control have no end.
    let constant =
        ["mean=[2e-4,2e-4]", "scale=[5e-3,5e-3]", "quaternion=[1e-3,1e-3]", "density=[1e-2,1e-2]", "nu=[1e-2,1e-2]"]
            .map(|rate| format!(" --set optimiser.{rate}"))
            .concat();
    let run = format!(
        "reconstruct scan --points 200 --seed 5 --set wavelet.block=8 --set optimiser.horizon=1 --set sghmc.burn_in=0 \
         --set density_control.start=0 --set density_control.stop=1 --set density_control.every=10 \
         --set confidence.every=15{constant}"
    );
    sandbox.done(&format!("{run} --out short --iterations 55"));
    let model = |run: &str| trgs::scan::model::read(sandbox.path(&format!("{run}/model.npz"))).unwrap().parameters;
    let before = model("short");
    sandbox.done("reconstruct scan --out short --resume --iterations 120 --threads 3");
    sandbox.done(&format!("{run} --out long --iterations 120"));
    assert_eq!(sandbox.text("short/config.toml"), sandbox.text("long/config.toml"));
    let (found, expected) = (model("short"), model("long"));
    let differences = |other: &Parameters| {
        let of = |group| largest(found.group(group).iter().zip(other.group(group)).map(|(a, b)| a - b));
        Group::ALL.map(of)
    };
    differences(&expected).into_iter().for_each(|difference| within!(difference));
    differences(&before).into_iter().for_each(|difference| beyond!("steps", difference));
}

#[test]
fn a_run_starts_from_the_model_of_another_one() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("reconstruct scan --out first --iterations 60 --points 120 --set finish=none --set wavelet.block=8");
    // The same object on another grid and detector.
    sandbox.done("simulate --phantom torso --out other --size 16 --detector 18 --views 5 --test-views 0 --noise none");
    let from = "--iterations 40 --set finish=none --set wavelet.block=8 --set initialisation.from=model";
    let run = format!("reconstruct other --out second {from} --set initialisation.model=first/model.npz");
    let output = sandbox.run(&run);
    assert!(output.status.success(), "{}", stderr(&output));
    let model = |run: &str| trgs::scan::model::read(sandbox.path(&format!("{run}/model.npz"))).unwrap();
    let config = sandbox.text("second/config.toml");
    assert!(config.contains(&format!("points = {}\n", model("first").len())), "{config}");
    let provenance: serde_json::Value = serde_json::from_str(&sandbox.text("second/provenance.json")).unwrap();
    assert!(provenance["inputs"]["first/model.npz"].is_string(), "{provenance}");
    for (setting, names) in [
        ("--set initialisation.model=none.npz", "none.npz"),
        ("--set initialisation.model=other/vol_gt.npy", "vol_gt.npy"),
        ("", "--set initialisation.model=MODEL.npz"),
        ("--set initialisation.model=first/model.npz --points 7", "--set model.points="),
        ("--set initialisation.model=first/model.npz --set density_control.cap=5", "--set density_control.cap="),
        ("--set initialisation.model=first/model.npz --method r2-gaussian", "--set method=tr-gs"),
    ] {
        let message = sandbox.refused(&format!("reconstruct other --out third --quiet {from} {setting}"));
        assert!(message.contains(names), "{setting}: {message}");
    }
    // It resumes from its checkpoint without the file.
    let before = sandbox.read("second/model.npz");
    fs::remove_file(sandbox.path("first/model.npz")).unwrap();
    sandbox.done("reconstruct other --out second --resume");
    assert!(sandbox.read("second/model.npz") == before);
}

#[test]
fn a_resumed_run_takes_its_settings_from_the_checkpoint() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("reconstruct scan --out run --iterations 9 --points 50 --seed 3 --set wavelet.block=8");
    let before = results(&sandbox, "run");
    sandbox.done("reconstruct scan --out run --resume");
    assert!(results(&sandbox, "run") == before);
}

/// As with `nohup`, and in a script's background.
#[cfg(target_os = "linux")]
#[test]
fn a_signal_that_was_ignored_before_stays_ignored() {
    use crate::program::{is_ignored, mask};
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};
    let sandbox = Sandbox::with_scan();
    let signals = [("HUP", 1), ("INT", 2), ("TERM", 15)];
    for (ignored, number) in signals {
        let mut child = Command::new("sh")
            .args(["-c", &format!("trap '' {ignored}; exec \"$0\" \"$@\"")])
            .arg(assert_cmd::cargo::cargo_bin!("trgs"))
            .args("reconstruct scan --out run --iterations 100000000 --set report_every=1".split(' '))
            .current_dir(sandbox.path(""))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut messages = BufReader::new(child.stderr.take().unwrap()).lines();
        messages.find(|line| line.as_ref().unwrap().starts_with("iteration 1 of")).unwrap().unwrap();
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap();
        let is_in = |name: &str, signal: u32| mask(&status, name).unwrap() >> (signal - 1) & 1 == 1;
        assert!(is_in("SigIgn:", number) && !is_in("SigCgt:", number), "{ignored}: {status}");
        let mut handled = signals.iter().filter(|(_, other)| *other != number && !is_ignored(*other));
        assert!(handled.clone().all(|(_, other)| is_in("SigCgt:", *other)), "{ignored}: {status}");
        let kill = |signal: &str| Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        kill(&format!("-{ignored}"));
        kill(&handled.next().map_or("-KILL".into(), |(name, _)| format!("-{name}")));
        child.wait().unwrap();
    }
}
