//! Errors of the library name settings; the program shows its flags.

use crate::program::Sandbox;
use trgs::Setting;

#[test]
fn every_setting_that_the_library_names_has_a_flag() {
    let sandbox = Sandbox::new();
    let commands = [
        "reconstruct",
        "evaluate",
        "mix",
        "render",
        "voxelize",
        "confidence",
        "table",
        "report",
        "compare",
        "inspect",
        "convert",
        "simulate",
        "demo",
        "oracle list",
        "oracle check",
    ];
    let help = commands.map(|command| String::from_utf8(sandbox.run(&format!("{command} --help")).stdout).unwrap());
    for setting in Setting::ALL {
        let flag = format!(" --{}", setting.name().replace('_', "-"));
        let has_flag =
            |help: &String| help.match_indices(&flag).any(|(at, _)| help[at + flag.len()..].starts_with([' ', '\n']));
        assert!(help.iter().any(has_flag), "no command has the flag{flag}");
    }
}

#[test]
fn errors_show_flags_instead_of_settings() {
    let sandbox = Sandbox::with_scan();
    for (command, flags) in [
        ("reconstruct scan --out run --views 9", vec!["error: --views: got 9, expected 1 to 4"]),
        (
            "reconstruct scan --out run --max-memory 1MB",
            vec!["expected at most 9", "; give --max-memory ", "(--points, density_control.cap), views (--views)"],
        ),
        (
            "reconstruct scan --out run --set density_unit=1e3",
            vec!["from random points: --set initialisation.from=random"],
        ),
        ("oracle list --stage nothing", vec!["error: --stage: got nothing"]),
    ] {
        let message = sandbox.refused(command);
        assert!(flags.iter().all(|flag| message.contains(flag)), "{command}: {message}");
        let is_named = |setting: &Setting| message.contains(&format!("`{}`", setting.name()));
        assert!(!Setting::ALL.iter().any(is_named), "{command}: {message}");
    }
    let message = Sandbox::new().refused("table volume --out out --data .");
    assert!(message.starts_with("error: --data: got") && message.ends_with("another --size\n"), "{message}");
}

#[test]
fn foreign_text_becomes_no_flag() {
    let sandbox = Sandbox::new();
    std::fs::create_dir(sandbox.path("`seed=1`")).unwrap();
    std::fs::write(sandbox.path("`seed=1`/meta_data.json"), "{}").unwrap();
    let message = sandbox.refused("inspect `seed=1`");
    assert!(message.starts_with("error: `seed=1`/meta_data.json: "), "{message}");
    assert!(message.contains("missing field `scanner`"), "{message}");
}
