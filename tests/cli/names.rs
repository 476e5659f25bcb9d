//! Names of files that are not UTF-8: Linux allows every byte but 0 and the slash.

use crate::program::{Sandbox, stderr};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::process::Output;

/// Runs a command; `§` stands for the byte 0xff, which is in no text in UTF-8.
fn run(sandbox: &Sandbox, arguments: &str) -> Output {
    let mut command = sandbox.command("");
    for word in arguments.split_whitespace() {
        let parts: Vec<&[u8]> = word.split('§').map(str::as_bytes).collect();
        command.arg(OsStr::from_bytes(&parts.join(&0xff)));
    }
    command.output().unwrap()
}

#[test]
fn every_command_reads_and_writes_names_that_are_not_utf_8() {
    let sandbox = Sandbox::new();
    let kernels = "oracle answer answers§ --stage kernel";
    for arguments in [
        "simulate --phantom torso --out scan§ --size 12 --detector 14,15 --views 4 --test-views 3 --noise low",
        "inspect scan§",
        "reconstruct scan§ --out run§ --iterations 5 --points 50 --set wavelet.block=8",
        "reconstruct scan§ --out fdk§ --method fdk",
        "inspect run§",
        "report run§",
        "evaluate run§ --against scan§",
        "render run§/model.npz --scanner scan§ --out views§.npy",
        "render run§/model.npz --scanner scan§ --out again§.npy --vjp views§.npy --grad-out gradient§.npz",
        "compare views§.npy again§.npy",
        "voxelize run§/model.npz --scanner scan§ --out volume§.npy",
        "confidence run§/model.npz --scanner scan§ --out confidence§.npz",
        "convert run§/model.npz model§.ply",
        "convert scan§ few§ --views 2",
        "convert views§.npy stack§ --scanner scan§/meta_data.json --line-integrals",
        "simulate --volume volume§.npy --out other§ --detector 14,15 --views 2 --test-views 1",
        "inspect other§",
        kernels,
        "oracle export vectors§ --stage kernel --blind",
        "oracle check answers§ --stage kernel --report report§.json",
    ] {
        let output = run(&sandbox, &format!("{arguments} --json"));
        assert_eq!(output.status.code(), Some(0), "{arguments}: {}", stderr(&output));
        let text = String::from_utf8(output.stdout).unwrap();
        serde_json::from_str::<serde_json::Value>(&text).unwrap_or_else(|error| panic!("{arguments}: {error}: {text}"));
        if arguments == kernels {
            assert!(text.contains(r#""folder":"answers\\xff""#), "{text}");
        }
    }
    // Also those formats whose header names a second file.
    for ending in ["nii.gz", "mha", "mhd", "nrrd", "nhdr", "tif", "npy"] {
        for arguments in [
            format!("convert run§/volume.npy converted§.{ending} --scanner scan§"),
            format!("convert converted§.{ending} back.npy"),
            "compare run§/volume.npy back.npy --tolerance 0".into(),
        ] {
            let output = run(&sandbox, &arguments);
            let message = stderr(&output);
            let unsupported = arguments.contains("hdr") || arguments.contains(".mhd");
            assert!(output.status.success() || unsupported && message.starts_with("error: "), "{arguments}: {message}");
            if !output.status.success() {
                break;
            }
        }
    }
}

#[test]
fn errors_name_files_that_are_not_utf_8_in_one_line() {
    let sandbox = Sandbox::new();
    for arguments in [
        "inspect none§",
        "inspect none§.h5:/data",
        "reconstruct none§ --out run",
        "evaluate none§ --against none",
        "convert none§.npy out§.nii.gz",
        "table ablation --data none§ --out tables§ --size 8",
        "report none§",
        "simulate --phantom none§ --out scan",
    ] {
        let output = run(&sandbox, arguments);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments}: {message}");
        assert!(message.starts_with("error: "), "{arguments}: {message}");
    }
}
