//! What the commands do to folders and files that exist: replace their own, refuse others.

use crate::program::{Sandbox, stderr};
use serde_json::Value;
use std::fs;

const SIMULATE: &str = "simulate --phantom torso --size 12 --detector 14,15 --views 4 --test-views 3 --noise low --out";

#[test]
fn measured_data_are_never_replaced_unless_told_to() {
    let sandbox = Sandbox::with_scan();
    // A scan without a mark is somebody's, whatever its files are called.
    fs::create_dir(sandbox.path("measured")).unwrap();
    for name in ["meta_data.json", "vol_gt.npy"] {
        sandbox.write(&format!("measured/{name}"), sandbox.read(&format!("scan/{name}")));
    }
    for command in [
        format!("{SIMULATE} measured"),
        "convert scan measured --views 2".into(),
        "reconstruct scan --method fdk --out measured".into(),
        "oracle export measured --stage kernel".into(),
        "oracle answer measured --stage kernel".into(),
    ] {
        let message = sandbox.refused(&command);
        assert!(message.contains("did not write") && message.contains("--overwrite"), "{command}: {message}");
    }
    // One command does not replace the scan of another, nor one to which something was added.
    sandbox.done("convert scan converted --views 2");
    let message = sandbox.refused(&format!("{SIMULATE} converted"));
    assert!(message.contains("a scan of another command, convert"), "{message}");
    fs::create_dir(sandbox.path("converted/proj_train/notes")).unwrap();
    sandbox.write("converted/proj_train/notes/thesis.txt", "years");
    let message = sandbox.refused("convert scan converted --views 2");
    assert!(message.contains("proj_train/notes"), "{message}");
    let notes = sandbox.read("converted/proj_train/notes/thesis.txt");
    let output = sandbox.run("convert scan converted --views 2 --overwrite");
    assert!(stderr(&output).contains("converted.replaced-1"), "{}", stderr(&output));
    assert!(!sandbox.path("converted/proj_train/notes").exists());
    assert_eq!(sandbox.read("converted.replaced-1/proj_train/notes/thesis.txt"), notes);
    let measured = sandbox.read("measured/vol_gt.npy");
    sandbox.done(&format!("{SIMULATE} measured --overwrite"));
    sandbox.done(&format!("{SIMULATE} measured"));
    assert_eq!(sandbox.read("measured.replaced-1/vol_gt.npy"), measured);
    // A run moves the folder before it writes its state, and each time to a new name.
    fs::create_dir_all(sandbox.path("run/checkpoints")).unwrap();
    for state in ["one", "two"] {
        sandbox.write("run/checkpoints/last.msgpack", state);
        sandbox.write("run/thesis.txt", "years");
        sandbox.done("reconstruct scan --method sart --iterations 2 --out run --overwrite");
    }
    for (number, state) in [(1, "one"), (2, "two")] {
        assert_eq!(sandbox.read(&format!("run.replaced-{number}/checkpoints/last.msgpack")), state.as_bytes());
    }
    let before = sandbox.names();
    assert!(before.iter().all(|name| !name.starts_with('.')), "{before:?}");
    assert!(sandbox.names_in("run.replaced-1").iter().all(|name| !name.starts_with('.')));
}

#[test]
fn what_is_read_is_never_replaced() {
    let sandbox = Sandbox::with_scan();
    #[cfg(unix)]
    std::os::unix::fs::symlink(sandbox.path("scan"), sandbox.path("link")).unwrap();
    let outs: &[&str] = if cfg!(unix) { &["scan", "scan/", "./scan/.", "link", "link/"] } else { &["scan", "scan/"] };
    for out in outs {
        for command in [
            format!("convert scan {out} --views 2 --overwrite"),
            format!("reconstruct scan/meta_data.json --method fdk --out {out} --overwrite"),
            format!("{SIMULATE} {out} --overwrite").replace("--phantom torso --size 12", "--volume scan/vol_gt.npy"),
        ] {
            let message = sandbox.refused(&command);
            assert!(message.contains("read"), "{command}: {message}");
        }
    }
    sandbox.edit("scan/meta_data.json", |meta| meta["vol"] = "../volumes/true.npy".into());
    fs::create_dir(sandbox.path("volumes")).unwrap();
    fs::rename(sandbox.path("scan/vol_gt.npy"), sandbox.path("volumes/true.npy")).unwrap();
    let message = sandbox.refused("reconstruct scan --method fdk --out volumes --overwrite --quiet");
    assert!(message.contains("true.npy, which is read"), "{message}");
    sandbox.write("volume.npy", sandbox.read("volumes/true.npy"));
    for command in ["convert volume.npy volume.npy", "convert volume.npy ./volume.npy --mu-water 1 --quiet"] {
        assert!(sandbox.refused(command).contains("a file that is read"), "{command}");
    }
    sandbox.done("reconstruct scan --method fdk --out scan/run");
}

#[test]
fn a_separator_at_the_end_and_an_existing_folder_mean_a_folder() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("convert scan 2024.05.12/ --views 2");
    assert!(sandbox.path("2024.05.12/meta_data.json").exists());
    sandbox.done("convert scan 2024.05.12 --views 3");
    assert_eq!(sandbox.names_in("2024.05.12/proj_train").len(), 3);
}

#[test]
fn the_current_folder_is_filled_and_stays_the_same_folder() {
    let sandbox = Sandbox::with_scan();
    fs::create_dir(sandbox.path("here")).unwrap();
    let here = |arguments: &str| {
        let mut command = sandbox.command(arguments);
        command.current_dir(sandbox.path("here"));
        command
    };
    #[cfg(unix)]
    let number = || std::os::unix::fs::MetadataExt::ino(&fs::metadata(sandbox.path("here")).unwrap());
    #[cfg(unix)]
    let before = number();
    let expected = sandbox.names_in("scan");
    for _ in 0..2 {
        let output = here(&format!("{SIMULATE} .")).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(sandbox.names_in("here"), expected);
    }
    #[cfg(unix)]
    assert_eq!(number(), before);
    sandbox.write("here/thesis.txt", "years");
    let message = sandbox.refuses("simulate .", here(&format!("{SIMULATE} . --overwrite")));
    assert!(message.contains("thesis.txt"), "{message}");
    let message = sandbox.refuses("simulate ..", here(&format!("{SIMULATE} .. --overwrite")));
    assert!(message.contains("the current one"), "{message}");
}

#[test]
fn two_runs_do_not_write_one_folder() {
    let sandbox = Sandbox::with_scan();
    let run = "reconstruct scan --method sart --iterations 2 --out run";
    sandbox.done(run);
    let lock = fs::File::create(sandbox.path("run/.trgs.lock")).unwrap();
    lock.lock().unwrap();
    for command in [run.into(), format!("{run} --resume"), format!("{run} --overwrite")] {
        let message = sandbox.refused(&command);
        assert!(message.contains("another process") && message.contains("output folder run"), "{message}");
    }
    // The lock of a dead process remains as a file, which is taken over.
    drop(lock);
    sandbox.done(&format!("{run} --resume"));
    assert!(!sandbox.path("run/.trgs.lock").exists());
}

#[test]
fn a_page_of_a_table_is_replaced_only_as_it_was_written() {
    let sandbox = Sandbox::new();
    fs::create_dir(sandbox.path("out")).unwrap();
    sandbox.write("out/threshold.md", "my notes");
    let table = "table threshold --out out --size 8 --cases chest";
    let message = sandbox.refused(table);
    assert!(message.contains("threshold.md") && message.contains("--overwrite"), "{message}");
    fs::remove_file(sandbox.path("out/threshold.md")).unwrap();
    sandbox.write("out/notes.txt", "my notes");
    sandbox.done(table);
    sandbox.done("report out");
    sandbox.write("out/threshold.csv", "corrected by hand");
    for command in [table, "report out"] {
        assert!(sandbox.refused(command).contains("threshold.csv"), "{command}");
    }
    sandbox.done("report out --overwrite");
    assert_eq!(sandbox.text("out/notes.txt"), "my notes");
}

#[cfg(unix)]
#[test]
fn files_that_a_scan_does_not_list_decide_nothing() {
    use std::os::unix::fs::symlink;
    let sandbox = Sandbox::with_scan();
    let run = |out: &str| {
        sandbox.done(&format!("reconstruct scan --method fdk --out {out}"));
        serde_json::from_str::<Value>(&sandbox.text(&format!("{out}/provenance.json"))).unwrap()["inputs"].clone()
    };
    let before = run("before");
    pipe(&sandbox, "scan/pipe");
    pipe(&sandbox, "scan/proj_train/init_pipe.npy");
    symlink("/dev/zero", sandbox.path("scan/init_zero.npy")).unwrap();
    symlink("nowhere", sandbox.path("scan/init_nothing.npy")).unwrap();
    symlink("nowhere", sandbox.path("scan/nothing")).unwrap();
    sandbox.write("scan/notes.txt", "years");
    assert_eq!(run("after"), before);
    assert_eq!(before.as_object().unwrap().len(), 1 + 1 + 4 + 3, "description, truth, views");
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_are_refused_as_files_of_numbers() {
    let sandbox = Sandbox::with_scan();
    pipe(&sandbox, "pipe.npy");
    fs::remove_file(sandbox.path("scan/proj_train/proj_train_0001.npy")).unwrap();
    pipe(&sandbox, "scan/proj_train/proj_train_0001.npy");
    for command in
        ["inspect pipe.npy", "convert pipe.npy a.nii.gz", "inspect scan", "reconstruct scan --method fdk --out run"]
    {
        let output = sandbox.command(command).timeout(std::time::Duration::from_secs(60)).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{command}");
        assert!(stderr(&output).contains("it is a pipe"), "{}", stderr(&output));
    }
    assert!(!sandbox.path("run").exists());
}

#[cfg(unix)]
#[test]
fn a_record_that_names_devices_is_not_followed() {
    let sandbox = Sandbox::with_scan();
    sandbox.done("reconstruct scan --method fdk --out run");
    sandbox.edit("run/provenance.json", |record| {
        for name in ["/dev/zero", "../scan/vol_gt.npy", "pipe"] {
            record["outputs"][name] = "00".into();
        }
    });
    pipe(&sandbox, "run/pipe");
    let mut command = sandbox.command("inspect run --json");
    let output = command.timeout(std::time::Duration::from_secs(60)).output().unwrap();
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["oddities"].as_array().unwrap().len(), 3, "{found}");
}

#[cfg(unix)]
fn pipe(sandbox: &Sandbox, name: &str) {
    assert!(std::process::Command::new("mkfifo").arg(sandbox.path(name)).status().unwrap().success());
}
