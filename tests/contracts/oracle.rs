//! The oracle: valid vectors; complete, wrong, late and missing answers.

use crate::common::vectors::{answer, judge, vectors};
use crate::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use trgs::config::Precision;
use trgs::oracle::check::{PartResult, Status};
use trgs::oracle::limits::{Limits, Rule};
use trgs::oracle::{
    Case, Format, Level, Options, Question, TRACED, Tolerances, Vectors, answers, check, plain, report, waivers,
};

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { all.extend(files(&path)) } else { all.push(path) }
    }
    all
}

#[test]
fn every_file_of_the_vectors_is_listed_and_has_its_digest() {
    let vectors = vectors();
    let mut listed = BTreeSet::from(["manifest.json".to_owned()]);
    let mut ids = BTreeSet::new();
    for case in &vectors.manifest.cases {
        assert!(ids.insert(&case.id), "{} twice", case.id);
        assert!(case.id.starts_with(&format!("{}/", case.stage)), "{}", case.id);
        for flag in &case.flags {
            assert!(vectors.manifest.flags.contains_key(flag), "{}: nobody explains {flag}", case.id);
        }
        for file in case.inputs.values().chain(case.outputs.values()).chain(case.allowances.values()) {
            assert!(file.sha256.is_some(), "{}", file.file);
            vectors.bytes(file).unwrap();
            listed.insert(file.file.clone());
        }
    }
    let folder = root().join("reference/vectors");
    let found: BTreeSet<String> = files(&folder)
        .iter()
        .map(|path| path.strip_prefix(&folder).unwrap().to_str().unwrap().replace('\\', "/"))
        .collect();
    assert_eq!(listed, found);
    let size: u64 = files(&folder).iter().map(|path| path.metadata().unwrap().len()).sum();
    assert!(size < 8_000_000, "{size} bytes");
}

#[test]
fn the_vectors_in_the_program_are_those_in_the_source() {
    let (built_in, source) = (Vectors::embedded().unwrap(), vectors());
    assert_eq!(built_in.digest, source.digest);
    for case in &source.manifest.cases {
        for file in case.inputs.values().chain(case.outputs.values()) {
            assert_eq!(built_in.bytes(file).unwrap(), source.bytes(file).unwrap(), "{}", file.file);
        }
    }
}

#[test]
fn there_is_a_case_for_every_stage_and_every_stage_is_answered() {
    let stages: BTreeSet<String> = vectors().manifest.cases.iter().map(|case| case.stage.clone()).collect();
    assert_eq!(stages, answers::STAGES.map(String::from).into());
}

/// Every kind of adversarial input has a case.
#[test]
fn every_kind_of_trouble_has_a_case() {
    let vectors = vectors();
    let used: BTreeSet<&str> = vectors.manifest.cases.iter().flat_map(|c| c.flags.iter().map(String::as_str)).collect();
    let explained: BTreeSet<&str> = vectors.manifest.flags.keys().map(String::as_str).collect();
    assert_eq!(used, explained, "flags in use and flags explained");
    for needed in [
        "ill-conditioned",
        "gaussian-limit",
        "zero-density",
        "tiny-density",
        "subnormal",
        "centre-on-pixel",
        "behind-source",
        "at-source-plane",
        "support-beyond-detector",
        "support-not-ellipse",
        "one-pixel",
        "unnormalised-quaternion",
        "tiny-quaternion",
        "zero-image",
        "parallel",
        "offset-detector",
        "non-square-pixels",
        "far-skirt",
    ] {
        assert!(used.contains(needed), "no case is {needed}");
    }
    for scene in ["nu-1", "nu-2", "nu-3", "nu-30", "nu-1e3", "nu-1e6"] {
        assert!(vectors.manifest.cases.iter().any(|case| case.id == format!("image-exact/{scene}")), "{scene}");
    }
}

#[test]
fn every_stage_and_format_has_a_tolerance_with_a_reason() {
    let (vectors, tolerances) = (vectors(), Tolerances::embedded().unwrap());
    let mut used = BTreeSet::new();
    for case in &vectors.manifest.cases {
        for (role, file) in &case.outputs {
            for name in vectors.arrays(file).unwrap().keys() {
                let part = if name.is_empty() { role } else { name };
                for format in Format::ALL {
                    let rule = tolerances.rule(case, part, format);
                    let rule = rule.unwrap_or_else(|| panic!("no tolerance for {} {part} in {format}", case.id));
                    used.insert(std::ptr::from_ref(rule) as usize);
                    assert!(rule.reason.len() > 20, "{:?}: a reason, not {:?}", rule.stages, rule.reason);
                }
            }
        }
    }
    let of_vectors = tolerances.rules.iter().filter(|rule| !is_of_traces(rule));
    assert_eq!(used.len(), of_vectors.count(), "a rule that no array uses");
    for rule in &tolerances.rules {
        for stage in &rule.stages {
            assert!(answers::STAGES.contains(&stage.as_str()) || is_of_traces(rule), "a rule for the stage {stage}");
        }
    }
}

/// Whether a rule is of the stages that traces alone have: tests/cli/oracle_cli.rs judges this program's answers by it.
fn is_of_traces(rule: &Rule) -> bool {
    TRACED.iter().any(|stage| rule.stages == [*stage])
}

/// The largest value of each norm over all arrays of a rule.
fn envelope(vectors: &Vectors, report: &trgs::oracle::Report, rule: usize, tolerances: &Tolerances) -> Limits {
    let mut envelope = Limits::default();
    let raise = |slot: &mut Option<f64>, value: f64| *slot = Some(slot.unwrap_or(0.0).max(value));
    for result in &report.results {
        let case = vectors.manifest.cases.iter().find(|case| case.id == result.id).unwrap();
        for part in &result.parts {
            let name = part.output.rsplit('.').next().unwrap();
            let own = tolerances.rule(case, name, report.format).unwrap();
            if let (true, Some(d)) = (std::ptr::eq(own, &tolerances.rules[rule]), &part.difference) {
                raise(&mut envelope.peak, d.peak);
                raise(&mut envelope.ulp, d.ulp);
                raise(&mut envelope.relative, d.relative);
                raise(&mut envelope.l2, d.l2);
                raise(&mut envelope.cosine, d.cosine);
                raise(&mut envelope.bias, d.bias.abs());
                raise(&mut envelope.zeros, d.zeros);
            }
        }
    }
    envelope
}

/// Answers in f64 rounded to a format: the best possible answers in that format.
fn answer_rounded(vectors: &Vectors, folder: &Path, format: Format) {
    for case in &vectors.manifest.cases {
        let mut outputs = answers::answer(&Question::new(vectors, case).unwrap(), Precision::F64).unwrap();
        for arrays in outputs.values_mut() {
            arrays.values_mut().for_each(|array| array.mapv_inplace(|x| format.round(x)));
        }
        answers::write(folder, case, &outputs).unwrap();
    }
}

/// Writes right answers in f32, in which those of some cases are changed.
fn answer_changed(vectors: &Vectors, folder: &Path, change: &dyn Fn(&Case, usize, f64) -> f64) {
    for case in &vectors.manifest.cases {
        let mut outputs = answers::answer(&Question::new(vectors, case).unwrap(), Precision::F32).unwrap();
        for array in outputs.values_mut().flat_map(|arrays| arrays.values_mut()) {
            array.iter_mut().enumerate().for_each(|(index, x)| *x = change(case, index, *x));
        }
        answers::write(folder, case, &outputs).unwrap();
    }
}

#[test]
fn what_all_failures_have_in_common_is_named() {
    let (vectors, tolerances) = (vectors(), Tolerances::embedded().unwrap());
    let names = |change: &dyn Fn(&Case, usize, f64) -> f64| {
        let folder = tempfile::tempdir().unwrap();
        answer_changed(&vectors, folder.path(), change);
        let report = judge(&vectors, folder.path(), Format::F32, &[]);
        let parts = report.results.into_iter().flat_map(|result| result.parts);
        parts.filter(|part| part.status == Status::Failed).map(|part| part.looks_like).collect::<Vec<_>>()
    };
    let named =
        |names: &[Option<String>], what: &str| names.iter().flatten().filter(|name| name.contains(what)).count();
    // Errors of 2⁻¹², with signs as of rounding.
    let rounded =
        |index: usize, x: f64| x * (1.0 + if index.wrapping_mul(0x9e37_79b9) >> 7 & 1 == 0 { 2.4e-4 } else { -2.4e-4 });
    let has_products = |case: &Case| case.level == Level::Core && tolerances.products.contains(&case.stage);
    let products = names(&|case, index, x| if has_products(case) { rounded(index, x) } else { x });
    assert!(products.len() > 50 && 10 * named(&products, "11 bits") > 9 * products.len(), "{products:?}");
    // The same errors everywhere are no matter of products.
    let everywhere = names(&|_, index, x| rounded(index, x));
    assert_eq!(named(&everywhere, "11 bits"), 0);
    // NaN where a primitive has infinite ν, and then elsewhere as well.
    let is_infinite = |case: &Case| {
        let model = case.inputs.get("model").map(|file| vectors.arrays(file).unwrap());
        model.is_some_and(|model| model["nu"].iter().any(|nu| nu.is_infinite()))
    };
    let fast = names(&|case, _, x| if is_infinite(case) { f64::NAN } else { x });
    assert!(fast.len() > 2 && named(&fast, "ν = ∞") == fast.len(), "{fast:?}");
    let broken = names(&|case, _, x| if is_infinite(case) || case.stage == "loss-l1" { f64::NAN } else { x });
    assert_eq!(named(&broken, "ν = ∞"), 0);
}

#[test]
fn formats_of_products_have_wide_limits_in_stages_with_products_alone() {
    let (vectors, tolerances) = (vectors(), Tolerances::embedded().unwrap());
    for format in [Format::Tf32, Format::F16F32] {
        let folder = tempfile::tempdir().unwrap();
        answer_rounded(&vectors, folder.path(), format);
        let report = judge(&vectors, folder.path(), format, &[]);
        let failed = |stage: &str| report.results.iter().any(|r| r.stage == stage && r.status == Status::Failed);
        assert!(!tolerances.products.iter().any(|stage| failed(stage)), "{}", report::markdown(&report));
        assert!(["kernel", "adam", "loss-l1"].into_iter().all(failed), "{format}");
        let folder = tempfile::tempdir().unwrap();
        answer(&vectors, Precision::F32, folder.path(), |_| true);
        assert!(judge(&vectors, folder.path(), format, &[]).passed());
    }
    let known = |stage: &String| answers::STAGES.contains(&stage.as_str()) || TRACED.contains(&stage.as_str());
    assert!(tolerances.products.iter().all(known));
}

#[test]
fn the_measured_envelopes_in_the_table_are_those_of_this_program() {
    let (vectors, tolerances) = (vectors(), Tolerances::embedded().unwrap());
    let mut wrong = Vec::new();
    for format in [Format::F64, Format::F32, Format::F16, Format::Bf16] {
        let folder = tempfile::tempdir().unwrap();
        match format {
            Format::F64 => answer(&vectors, Precision::F64, folder.path(), |_| true),
            Format::F32 => answer(&vectors, Precision::F32, folder.path(), |_| true),
            _ => answer_rounded(&vectors, folder.path(), format),
        }
        let report = judge(&vectors, folder.path(), format, &[]);
        assert!(report.passed(), "{}", report::markdown(&report));
        for (i, rule) in tolerances.rules.iter().enumerate().filter(|(_, rule)| !is_of_traces(rule)) {
            let (Some(limits), actual) = (rule.limits.get(&format), envelope(&vectors, &report, i, &tolerances)) else {
                continue;
            };
            let pairs = |l: &Limits| [l.peak, l.ulp, l.relative, l.l2, l.cosine, l.bias, l.zeros];
            let stated = rule.measured.get(&format).copied().unwrap_or_default();
            for (norm, ((stated, actual), limit)) in
                pairs(&stated).into_iter().zip(pairs(&actual)).zip(pairs(limits)).enumerate()
            {
                let Some(limit) = limit else { continue };
                let actual = actual.unwrap_or(0.0);
                let Some(stated) = stated else {
                    wrong.push(format!(
                        "{format} rule {i} {:?} norm {norm}: measured {actual:.2e}, not stated",
                        rule.stages
                    ));
                    continue;
                };
                // Two digits are stated.
                if (stated - actual).abs() > 0.06 * actual {
                    wrong.push(format!(
                        "{format} rule {i} {:?} norm {norm}: measured {actual:.2e}, stated {stated:.2e}",
                        rule.stages
                    ));
                }
                assert!(limit >= actual, "{format} rule {i}: {limit:e} below {actual:e}");
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_blind_export_has_the_inputs_and_nothing_of_the_truth() {
    let (vectors, folder) = (vectors(), tempfile::tempdir().unwrap());
    let cases: Vec<_> = vectors.manifest.cases.iter().collect();
    let (blind, open) = (folder.path().join("blind"), folder.path().join("open"));
    vectors.export(&blind, true, &cases).unwrap();
    vectors.export(&open, false, &cases).unwrap();
    let exported = Vectors::open(&blind).unwrap();
    for case in &exported.manifest.cases {
        assert!(case.inputs.values().all(|file| exported.bytes(file).is_ok()), "{}", case.id);
        assert!(case.outputs.values().all(|file| file.sha256.is_none()), "{}", case.id);
        assert!(case.allowances.is_empty());
        for file in case.outputs.values() {
            assert!(!blind.join(&file.file).exists() && !blind.join("expected").join(&file.file).exists());
            assert!(open.join("expected").join(&file.file).exists());
        }
    }
    // The truth passes as its own answer; an empty folder does not.
    assert!(judge(&vectors, &open.join("expected"), Format::F64, &[]).passed());
    let report = judge(&vectors, &blind, Format::F64, &[]);
    assert_eq!(report.count(Status::Missing), report.results.len());
    assert!(!report.passed());
}

#[test]
fn a_plain_export_has_the_same_numbers_without_json_and_archives() {
    let (vectors, folder) = (vectors(), tempfile::tempdir().unwrap());
    let cases: Vec<_> = vectors.manifest.cases.iter().collect();
    let [blind, open] = ["blind", "open"].map(|name| folder.path().join(name));
    plain::export(&vectors, &blind, true, &cases).unwrap();
    plain::export(&vectors, &open, false, &cases).unwrap();
    let table = std::fs::read_to_string(blind.join(plain::TABLE)).unwrap();
    let lines: Vec<Vec<&str>> = table.lines().map(|line| line.split('\t').collect()).collect();
    assert!(lines.iter().all(|line| line.len() == 4) && lines[0] == ["*", "vectors", "", vectors.origin()]);
    let numbers = |text: &str| text.split(' ').map(|number| number.parse::<f64>().unwrap()).collect::<Vec<_>>();
    let value = |case: &str, kind: &str, name: &str| {
        let found = lines.iter().find(|line| line[..3] == [case, kind, name]);
        found.unwrap_or_else(|| panic!("{case} {kind} {name}"))[3]
    };
    for case in &cases {
        assert_eq!(serde_json::json!(case.level), value(&case.id, "level", ""));
        for (name, expected) in &case.settings {
            let text = value(&case.id, "setting", name);
            match expected.as_array() {
                Some(list) => assert_eq!(numbers(text), list.iter().map(|n| n.as_f64().unwrap()).collect::<Vec<_>>()),
                None => assert_eq!(text, expected.to_string().trim_matches('"')),
            }
        }
        for (role, file) in case.inputs.iter().filter(|(_, file)| !file.file.ends_with(".json")) {
            for (name, array) in vectors.arrays(file).unwrap() {
                let name = if name.is_empty() { role.clone() } else { format!("{role}.{name}") };
                let path = blind.join(value(&case.id, "input", &name));
                assert_eq!(trgs::scan::npy::read(&path).unwrap().numbers.into_f64(), array, "{} {name}", case.id);
            }
        }
    }
    let scanned = cases.iter().find(|case| case.inputs.contains_key("scanner")).unwrap();
    assert!(value(&scanned.id, "scanner", "DSO").parse::<f64>().unwrap() > 0.0);
    assert_eq!(numbers(value(&scanned.id, "scanner", "nVoxel")).len(), 3);
    // The truth passes as an answer in this form, and nothing of it is in the blind export.
    assert!(judge(&vectors, &open.join("expected"), Format::F64, &[]).passed());
    let report = judge(&vectors, &blind, Format::F64, &[]);
    assert_eq!(report.count(Status::Missing), report.results.len());
    // An array that is missing is named.
    let lost = lines.iter().find(|line| line[1] == "output" && line[2].contains('.')).unwrap();
    std::fs::remove_file(open.join("expected").join(lost[3])).unwrap();
    let report = judge(&vectors, &open.join("expected"), Format::F64, &[]);
    assert_eq!((report.passed(), report.count(Status::Failed) + report.count(Status::Missing)), (false, 1));
}

/// This program's answers to one stage in a folder, to be modified.
fn answered(stage: &str) -> (Vectors, tempfile::TempDir, Vec<String>) {
    let (vectors, folder) = (vectors(), tempfile::tempdir().unwrap());
    answer(&vectors, Precision::F64, folder.path(), |case| case.stage == stage);
    (vectors, folder, vec![stage.to_owned()])
}

#[test]
fn nan_a_missing_file_a_missing_array_a_wrong_shape_and_rubbish_fail() {
    let (vectors, folder, stages) = answered("gradient-density");
    let path = |scene: &str| folder.path().join("gradient-density").join(scene).join("grad.npz");
    let case =
        |scene: &str| vectors.manifest.cases.iter().find(|c| c.id == format!("gradient-density/{scene}")).unwrap();
    let spoil = |scene: &str, change: &dyn Fn(&mut trgs::oracle::manifest::Arrays)| {
        let mut outputs = answers::answer(&Question::new(&vectors, case(scene)).unwrap(), Precision::F64).unwrap();
        change(outputs.get_mut("grad").unwrap());
        answers::write(folder.path(), case(scene), &outputs).unwrap();
    };
    fs::remove_file(path("cone-centred")).unwrap();
    spoil("cone-offset", &|arrays| drop(arrays.remove("nu")));
    spoil("cone-five", &|arrays| arrays.get_mut("mean").unwrap()[[0, 1]] = f64::NAN);
    spoil("nu-2", &|arrays| {
        let transposed = arrays["mean"].t().to_owned();
        arrays.insert("mean".into(), transposed);
    });
    fs::write(path("nu-3"), b"rubbish").unwrap();
    let report = judge(&vectors, folder.path(), Format::F64, &stages);
    let of = |scene: &str| report.results.iter().find(|r| r.id == format!("gradient-density/{scene}")).unwrap();
    let part = |scene: &str, output: &str| of(scene).parts.iter().find(|p| p.output == output).unwrap();
    assert_eq!(of("cone-centred").status, Status::Missing);
    assert_eq!(of("cone-offset").status, Status::Missing);
    assert_eq!(part("cone-offset", "grad.nu").status, Status::Missing);
    assert_eq!(part("cone-offset", "grad.mean").status, Status::Passed);
    assert_eq!(part("cone-five", "grad.mean").message.as_deref(), Some("NaN"));
    assert_eq!(part("cone-five", "grad.mean").difference.as_ref().unwrap().worst.as_ref().unwrap().index, [0, 1]);
    assert!(part("nu-2", "grad.mean").message.as_ref().unwrap().contains("shape [3, 1], expected [1, 3]"));
    assert_eq!(of("nu-3").status, Status::Failed);
    assert!(!report.passed());
    assert_eq!(report.count(Status::Passed), report.results.len() - 5);
}

/// A diagnosis of a wrong answer never ends the check: all stages and outputs, wrong in five ways.
#[test]
fn every_wrong_output_of_every_stage_is_in_the_report() {
    type Change = fn(f64) -> f64;
    let vectors = vectors();
    let size = |case: &Case| -> u64 {
        let bytes = case.outputs.values().map(|file| vectors.bytes(file).unwrap().len() as u64);
        bytes.sum()
    };
    // The smallest case of each stage, and all kernels and beams of the parametrisation.
    let chosen = |case: &&Case| {
        let others = vectors.manifest.cases.iter().filter(|other| other.stage == case.stage);
        case.stage == "gradient-raw" || others.min_by_key(|other| size(other)).is_some_and(|least| least.id == case.id)
    };
    let chosen: Vec<&Case> = vectors.manifest.cases.iter().filter(chosen).collect();
    assert!(chosen.len() >= answers::STAGES.len());
    let changes: [(&str, Change); 5] = [
        ("zeros", |_| 0.0),
        ("NaN", |_| f64::NAN),
        ("infinity", |_| f64::INFINITY),
        ("a factor of 1.01", |x| 1.01 * x),
        ("the opposite sign", |x| -x),
    ];
    for (name, change) in changes {
        let folder = tempfile::tempdir().unwrap();
        for case in &chosen {
            let outputs = case.outputs.iter().map(|(role, file)| {
                let arrays = vectors.arrays(file).unwrap().into_iter();
                (role.clone(), arrays.map(|(key, array)| (key, array.mapv(change))).collect())
            });
            answers::write(folder.path(), case, &outputs.collect()).unwrap();
        }
        let report = judge(&vectors, folder.path(), Format::F64, &[]);
        assert_eq!(report.results.len(), vectors.manifest.cases.len(), "{name}");
        assert_eq!(report.count(Status::Missing), report.results.len() - chosen.len(), "{name}");
        // A change leaves zeros, and infinities stay what they are; NaN is never right.
        let failed = report.count(Status::Failed);
        assert!(failed == chosen.len() || (name != "NaN" && failed > chosen.len() / 2), "{name}: {failed} failed");
        assert!(report::markdown(&report).contains("gradient-raw/extreme"), "{name}");
        if name == "the opposite sign" {
            let of = |part: &&PartResult| part.looks_like.as_ref().is_some_and(|text| text.contains(name));
            let raw = report.results.iter().filter(|result| result.stage == "gradient-raw");
            assert!(raw.flat_map(|result| &result.parts).filter(of).count() >= 10);
        }
    }
}

#[test]
fn a_waiver_excuses_until_its_day_and_is_reported_when_it_is_not_needed() {
    let (vectors, folder, stages) = answered("covariance");
    let cases: Vec<_> = vectors.manifest.cases.iter().filter(|case| case.stage == "covariance").collect();
    fs::remove_file(folder.path().join(&cases[0].outputs["covariance"].file)).unwrap();
    let file = folder.path().join("waivers.toml");
    let text = |case: &str, day: &str| format!("[[waiver]]\ncase = \"{case}\"\nreason = \"known\"\nexpires = {day}\n");
    fs::write(&file, text(&cases[0].id, "2031-05-07") + &text(&cases[1].id, "2031-05-07")).unwrap();
    let waivers = waivers::read(&file, &vectors.manifest.cases).unwrap();
    let on = |year, month, day| {
        let today = toml::value::Date { year, month, day };
        let options = Options {
            format: Format::F64,
            level: Level::Stress,
            stages: &stages,
            waivers: &waivers,
            today,
            commit: None,
        };
        check(&vectors, &Tolerances::embedded().unwrap(), folder.path(), &options).unwrap()
    };
    let report = on(2031, 5, 7);
    assert!(report.passed());
    assert_eq!((report.count(Status::Waived), report.unused_waivers.clone()), (1, vec![cases[1].id.clone()]));
    assert!(report::markdown(&report).contains("known (until 2031-05-07)"));
    let report = on(2031, 5, 8);
    assert!(!report.passed());
    assert!(report::markdown(&report).contains("ran out on 2031-05-07"));
    for (bad, needle) in [
        (text("covariance/none", "2031-05-07"), "covariance/none"),
        (text(&cases[0].id, "\"soon\""), "expires"),
        (text(&cases[0].id, "2031-02-29"), "expires"),
        (text(&cases[0].id, "2031-05-07").replace("known", " "), "no reason"),
        ("[[waiver]]\ncase = \"x\"\n".into(), "reason"),
    ] {
        fs::write(&file, &bad).unwrap();
        let error = waivers::read(&file, &vectors.manifest.cases).unwrap_err().to_string();
        assert!(error.contains(needle), "{error}");
    }
}

#[test]
fn the_report_is_written_for_readers_programs_and_build_servers() {
    let (vectors, folder, stages) = answered("kernel");
    let case = vectors.manifest.cases.iter().find(|case| case.stage == "kernel").unwrap();
    let mut outputs = answers::answer(&Question::new(&vectors, case).unwrap(), Precision::F64).unwrap();
    outputs.get_mut("kernel").unwrap().get_mut("").unwrap().mapv_inplace(|x| -x);
    answers::write(folder.path(), case, &outputs).unwrap();
    fs::write(folder.path().join("backend.json"), r#"{"name": "mine", "version": "3", "device": "<b>"}"#).unwrap();
    let result = judge(&vectors, folder.path(), Format::F64, &stages);
    let paths = report::write(&result, folder.path().join("report.json")).unwrap();
    let [json, markdown, junit, html] = paths.map(|path| fs::read_to_string(path).unwrap());
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["backend"]["name"], "mine");
    assert_eq!(json["results"][0]["parts"][0]["looks_like"], "the opposite sign");
    assert!(json["results"][0]["parts"][0]["difference"]["worst"]["ulp"].as_f64().unwrap() > 1e15);
    assert!(markdown.contains("mine 3 <b>: FAILED") && markdown.contains("the opposite sign"), "{markdown}");
    // Tables and names, and no markup of the backend.
    assert!(html.contains("<table>") && html.contains("the opposite sign"), "{html}");
    assert!(html.contains("mine 3 &lt;b&gt;: FAILED") && !html.contains("<b>"), "{html}");
    let junit = roxmltree::Document::parse(&junit).unwrap();
    assert_eq!(junit.root_element().attribute("failures"), Some("1"));
    let failed = junit.descendants().find(|node| node.has_tag_name("failure")).unwrap();
    assert_eq!(failed.parent().unwrap().attribute("name"), Some(&*case.id));
    assert!(failed.attribute("message").unwrap().contains("the opposite sign"), "{failed:?}");
    assert!(report::write(&result, folder.path().join("report.txt")).is_err());
}

/// All failures are listed, and before them no missing answer.
#[test]
fn the_report_lists_every_failure_before_the_missing_answers() {
    let (vectors, folder) = (vectors(), tempfile::tempdir().unwrap());
    let all = ["image-affine", "image-exact", "image-cutoff", "density", "density-cutoff", "kernel"].map(String::from);
    let open = folder.path().join("open");
    let cases: Vec<_> = vectors.manifest.cases.iter().filter(|case| all.contains(&case.stage)).collect();
    vectors.export(&open, false, &cases).unwrap();
    let answers = open.join("expected");
    let mut wrong = 0;
    for case in cases.iter().filter(|case| case.stage != "kernel") {
        for (role, file) in &case.outputs {
            let mut arrays = vectors.arrays(file).unwrap();
            arrays.get_mut("").unwrap().mapv_inplace(|x| 1.5 - x);
            answers::write(&answers, case, &[(role.clone(), arrays)].into()).unwrap();
            wrong += 1;
        }
    }
    assert!(wrong > 60);
    fs::remove_dir_all(answers.join("kernel")).unwrap();
    let report = judge(&vectors, &answers, Format::F64, &all);
    let text = report::markdown(&report);
    let (failed, missing) = text.split_once("## Missing").unwrap();
    let rows = failed.split_once("## Failed").unwrap().1.lines().filter(|line| line.contains('/'));
    assert!(rows.count() >= wrong - 2, "{text}");
    assert!(missing.contains("kernel") && missing.contains("trained, gaussian"), "{missing}");
}

#[test]
fn damaged_vectors_and_those_of_another_version_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let vectors = vectors();
    let cases: Vec<_> = vectors.manifest.cases.iter().filter(|case| case.stage == "covariance").collect();
    let root = folder.path().join("vectors");
    vectors.export(&root, false, &cases).unwrap();
    let exported = Vectors::open(&root).unwrap();
    let file = exported.manifest.cases[0].inputs["model"].clone();
    let path = root.join(&file.file);
    let mut bytes = fs::read(&path).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&path, bytes).unwrap();
    assert!(exported.bytes(&file).unwrap_err().to_string().contains("SHA-256"));
    let manifest = fs::read_to_string(root.join("manifest.json")).unwrap();
    for (from, to, needle) in [
        ("\"schema_version\": 2", "\"schema_version\": 3", "schema_version 3"),
        (file.file.as_str(), "../../etc/passwd", "not below the folder"),
    ] {
        fs::write(root.join("manifest.json"), manifest.replace(from, to)).unwrap();
        let error = Vectors::open(&root).unwrap_err().to_string();
        assert!(error.contains(needle), "{error}");
    }
}

/// The table in `reference/README.md`: worst ulp and worst error of each stage, in f64 and f32.
#[test]
fn the_worst_ulp_of_every_stage_stands_in_the_readme() {
    let (vectors, readme) = (vectors(), fs::read_to_string(root().join("reference/README.md")).unwrap());
    let worst = [(Precision::F64, Format::F64), (Precision::F32, Format::F32)].map(|(precision, format)| {
        let folder = tempfile::tempdir().unwrap();
        answer(&vectors, precision, folder.path(), |_| true);
        let report = judge(&vectors, folder.path(), format, &[]);
        let mut worst: BTreeMap<String, (f64, f64)> = BTreeMap::new();
        for result in &report.results {
            let slot = worst.entry(result.stage.clone()).or_default();
            for d in result.parts.iter().filter_map(|part| part.difference.as_ref()) {
                *slot = (slot.0.max(d.ulp), slot.1.max(d.peak));
            }
        }
        worst
    });
    let ulp = |x: f64| {
        if x < 0.05 {
            "0".into()
        } else if x < 1e4 {
            format!("{x:.1}")
        } else {
            format!("{x:.1e}")
        }
    };
    let peak = |x: f64| if x == 0.0 { "0".into() } else { format!("{x:.1e}") };
    let mut missing = Vec::new();
    for stage in answers::STAGES {
        let [f64s, f32s] = worst.each_ref().map(|worst| worst[stage]);
        let row = format!("| {stage} | {} | {} | {} | {} |", ulp(f64s.0), peak(f64s.1), ulp(f32s.0), peak(f32s.1));
        if !readme.contains(&row) {
            missing.push(row);
        }
    }
    assert!(missing.is_empty(), "reference/README.md lacks\n{}", missing.join("\n"));
}
