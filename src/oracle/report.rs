//! The report of a check as Markdown and HTML for readers, JSON for programs and JUnit for CI servers.

use super::check::{CaseResult, PartResult, Report, Status};
use pulldown_cmark::html::push_html;
use pulldown_cmark::{Event, Options as ParserOptions, Parser};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use trgs_core::error::{Error, Result};
use trgs_core::setting::Setting;
use trgs_scan::output::write_atomically;

const STYLE: &str = "
:root { color-scheme: light dark; }
body { max-width: 80rem; margin: 2rem auto; padding: 0 1rem; font: 16px/1.5 system-ui, sans-serif; }
table { display: block; overflow-x: auto; border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 0.3rem 0.8rem 0.3rem 0; border-bottom: 1px solid; text-align: left; vertical-align: top; }
";

/// Writes `file.json`, `file.md`, `file.html` and `file.xml`.
///
/// # Errors
/// For a path that does not end in `.json`; [`Error::Write`] with the error of the operating system.
pub fn write(report: &Report, path: impl AsRef<Path>) -> Result<[PathBuf; 4]> {
    let path = path.as_ref();
    if path.extension().is_none_or(|extension| extension != "json") {
        return Err(Error::invalid(
            Setting::Report,
            path.display(),
            "a file ending in .json",
            "end the name with .json: the .md, .html and .xml are written beside it",
        ));
    }
    let paths = ["json", "md", "xml", "html"].map(|extension| path.with_extension(extension));
    write_atomically(&paths[0], |out| Ok(serde_json::to_writer_pretty(out, report)?))?;
    write_atomically(&paths[1], |out| out.write_all(markdown(report).as_bytes()))?;
    write_atomically(&paths[2], |out| out.write_all(junit(report).as_bytes()))?;
    write_atomically(&paths[3], |out| out.write_all(html(report).as_bytes()))?;
    Ok(paths)
}

/// A page with a table of stages, all failures, then the missing answers, and the waived cases.
pub fn markdown(report: &Report) -> String {
    let mut text = String::new();
    let verdict = if report.passed() { "passed" } else { "FAILED" };
    let backend = report.backend.as_ref().map_or_else(String::new, |backend| format!(" of {}", one_line(backend)));
    let level = serde_json::to_value(report.level).expect("a word");
    let _ = writeln!(text, "# Conformance{backend}: {verdict}\n");
    let _ = writeln!(
        text,
        "{} cases up to level {}, as {}: {} passed, {} failed, {} missing, {} waived, {} skipped. {} ({}), vectors {}.\n",
        report.results.len(),
        level.as_str().expect("a word"),
        report.format,
        report.count(Status::Passed),
        report.count(Status::Failed),
        report.count(Status::Missing),
        report.count(Status::Waived),
        report.count(Status::Skipped),
        report.program,
        report.commit.as_deref().map_or("unknown commit", |commit| commit.get(..12).unwrap_or(commit)),
        &report.vectors[..12],
    );
    text += &table(&["stage", "cases", "passed", "worst error / peak", "worst ulp", "in"], stage_rows(report));
    let failed = || report.results.iter().filter(|r| r.status > Status::Waived);
    let parts = failed().flat_map(|r| r.parts.iter().filter(|p| p.status == Status::Failed).map(move |p| (r, p)));
    let rows: Vec<_> = parts.map(|(result, part)| failure_row(result, part)).collect();
    if !rows.is_empty() {
        text += "\n## Causes\n\n";
        text += &table(&["cause", "explains", "stages"], causes(report));
        text += "\n## Failed\n\n";
        text += &table(&["case", "output", "what", "at", "expected", "got", "ulp", "wrong at", "looks like"], rows);
    }
    let rows: Vec<_> = stages(report).into_iter().filter_map(|stage| missing_row(stage, failed())).collect();
    if !rows.is_empty() {
        text += "\n## Missing\n\n";
        text += &table(&["stage", "arrays", "cases, with outputs where others are there"], rows);
    }
    let excused = report.results.iter().filter_map(|r| Some([r.id.clone(), r.waiver.clone()?]));
    let excused: Vec<_> = excused.collect();
    if !excused.is_empty() {
        text += "\n## Waivers\n\n";
        text += &table(&["case", "waiver"], excused);
    }
    if let Some(file) = &report.tolerances {
        let _ = writeln!(text, "\nLimits of {file} were added to those of this program.");
    }
    if !report.unused_waivers.is_empty() {
        let _ = writeln!(text, "\nNo longer needed: the waivers of {}.", report.unused_waivers.join(", "));
    }
    text
}

/// The stages that were checked, in the manifest's order.
fn stages(report: &Report) -> Vec<&str> {
    let mut stages: Vec<&str> = report.results.iter().map(|result| result.stage.as_str()).collect();
    stages.dedup();
    stages
}

/// One row per stage: its worst errors, and the cases that have them.
fn stage_rows(report: &Report) -> Vec<[String; 6]> {
    let row = |stage: &str| {
        let results = || report.results.iter().filter(move |r| r.stage == stage);
        let compared =
            || results().flat_map(|r| r.parts.iter().filter_map(move |p| Some((&r.id, p.difference.as_ref()?))));
        let peak = compared().max_by(|a, b| a.1.peak.total_cmp(&b.1.peak));
        let ulp = compared().map(|(_, d)| d.ulp).max_by(f64::total_cmp);
        [
            stage.to_owned(),
            results().count().to_string(),
            results().filter(|r| r.status == Status::Passed).count().to_string(),
            peak.map_or_else(|| "–".into(), |(_, d)| format!("{:.1e}", d.peak)),
            ulp.map_or_else(|| "–".into(), ulps),
            peak.map_or_else(String::new, |(id, _)| id.rsplit('/').next().unwrap_or_default().to_owned()),
        ]
    };
    stages(report).into_iter().map(row).collect()
}

/// A number of ulp for display.
pub fn ulps(ulp: f64) -> String {
    if ulp < 1e4 { format!("{ulp:.1}") } else { format!("{ulp:.1e}") }
}

/// Each cause, or place, of failures once: the number of failed cases with it, and their stages.
fn causes(report: &Report) -> Vec<[String; 3]> {
    let mut causes: BTreeMap<String, (BTreeSet<&str>, BTreeSet<&str>)> = BTreeMap::new();
    let failed = || report.results.iter().filter(|result| result.status == Status::Failed);
    for result in failed() {
        for part in result.parts.iter().filter(|part| part.status == Status::Failed) {
            let place = part.place.as_ref().map(|place| format!("wrong at {place}"));
            let cause = part.looks_like.as_ref().map(|name| format!("looks like {name}")).or(place);
            let (cases, stages) = causes.entry(cause.unwrap_or_else(|| "unknown".into())).or_default();
            cases.insert(&result.id);
            stages.insert(&result.stage);
        }
    }
    let mut causes: Vec<_> = causes.into_iter().collect();
    causes.sort_by_key(|(_, (cases, _))| std::cmp::Reverse(cases.len()));
    let all = failed().count();
    let row = |(cause, (cases, stages)): (String, (BTreeSet<&str>, BTreeSet<&str>))| {
        [cause, format!("{} of {all}", cases.len()), stages.into_iter().collect::<Vec<_>>().join(", ")]
    };
    causes.into_iter().map(row).collect()
}

fn failure_row(result: &CaseResult, part: &PartResult) -> [String; 9] {
    let worst = part.difference.as_ref().and_then(|d| d.worst.as_ref());
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.9e}"));
    [
        result.id.clone(),
        part.output.clone(),
        what(part),
        worst.map_or_else(String::new, |w| format!("{:?}", w.index)),
        number(worst.map(|w| w.expected)),
        number(worst.map(|w| w.got)),
        worst.map_or_else(String::new, |w| ulps(w.ulp)),
        part.place.clone().unwrap_or_default(),
        part.looks_like.clone().unwrap_or_default(),
    ]
}

/// The missing arrays of a stage, if any: their number, and the cases with the outputs.
fn missing_row<'a>(stage: &str, failed: impl Iterator<Item = &'a CaseResult>) -> Option<[String; 3]> {
    let (mut arrays, mut cases) = (0, Vec::new());
    for result in failed.filter(|result| result.stage == stage) {
        let missing = result.parts.iter().filter(|part| part.status == Status::Missing);
        let outputs: Vec<&str> = missing.map(|part| part.output.as_str()).collect();
        if outputs.is_empty() {
            continue;
        }
        arrays += outputs.len();
        let name = result.id.rsplit('/').next().unwrap_or_default();
        let whole = outputs.len() == result.parts.len();
        cases.push(if whole { name.to_owned() } else { format!("{name}: {}", outputs.join(" ")) });
    }
    (arrays > 0).then(|| [stage.to_owned(), arrays.to_string(), cases.join(", ")])
}

/// The defect of an array in a few words.
fn what(part: &PartResult) -> String {
    let norms = part.exceeded.iter().map(|e| format!("{} {:.1e} > {:.1e}", e.norm, e.value, e.limit));
    let beyond = part.element.as_ref().filter(|_| part.exceeded.iter().any(|e| e.norm == "element"));
    let element = beyond.map(|e| format!("element {:?} is {:e}, expected {:e}", e.index, e.got, e.expected));
    part.message.iter().cloned().chain(norms).chain(element).collect::<Vec<_>>().join("; ")
}

/// A Markdown table, with columns aligned for plain text.
fn table<const N: usize>(header: &[&str; N], rows: Vec<[String; N]>) -> String {
    let mut table = comfy_table::Table::new();
    table.load_style(comfy_table::presets::ASCII_MARKDOWN);
    table.set_content_arrangement(comfy_table::ContentArrangement::Disabled);
    table.set_header(header);
    table.add_rows(rows.into_iter().map(|row| row.map(|cell| cell.replace('|', "\\|"))));
    format!("{table}\n")
}

fn one_line(backend: &serde_json::Value) -> String {
    let words = backend.as_object().map(|fields| {
        let about = fields.iter().filter(|(key, _)| matches!(key.as_str(), "name" | "version" | "device"));
        about.map(|(_, v)| v.as_str().map_or_else(|| v.to_string(), Into::into)).collect::<Vec<String>>().join(" ")
    });
    words.unwrap_or_else(|| backend.to_string())
}

/// The Markdown as a page that loads nothing. Names and messages come from a backend, so its HTML is text.
fn html(report: &Report) -> String {
    let text = markdown(report);
    let events = Parser::new_ext(&text, ParserOptions::ENABLE_TABLES).map(|event| match event {
        Event::Html(html) | Event::InlineHtml(html) => Event::Text(html),
        other => other,
    });
    let title = attribute(text.lines().next().unwrap_or_default().trim_start_matches("# "));
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n"
    );
    push_html(&mut page, events);
    page
}

/// One test suite of JUnit per stage, one test per case.
fn junit(report: &Report) -> String {
    let counts = |of: &dyn Fn(&CaseResult) -> bool| {
        let count = |is: fn(Status) -> bool| report.results.iter().filter(|r| of(r) && is(r.status)).count();
        let skipped = count(|status| matches!(status, Status::Skipped | Status::Waived));
        let [all, errors, failures] =
            [count(|_| true), count(|status| status == Status::Missing), count(|status| status == Status::Failed)];
        format!("tests=\"{all}\" skipped=\"{skipped}\" errors=\"{errors}\" failures=\"{failures}\"")
    };
    let mut text = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let _ = writeln!(text, "<testsuites name=\"trgs oracle\" {}>", counts(&|_| true));
    for stage in stages(report) {
        let _ = writeln!(text, "    <testsuite name=\"{}\" {}>", attribute(stage), counts(&|r| r.stage == stage));
        for result in report.results.iter().filter(|r| r.stage == stage) {
            let bad = result.parts.iter().filter(|p| p.status != Status::Passed);
            let looks_like =
                |p: &PartResult| p.looks_like.as_ref().map_or(String::new(), |x| format!("; looks like {x}"));
            let lines = bad.map(|p| format!("{}: {}{}", p.output, what(p), looks_like(p)));
            let lines: Vec<String> = lines.chain(result.waiver.clone()).collect();
            let (name, message) = (attribute(&result.id), attribute(&lines.join("\n")));
            let _ = match result.status {
                Status::Passed => writeln!(text, "        <testcase name=\"{name}\"/>"),
                status => {
                    let tag = match status {
                        Status::Missing => "error",
                        Status::Failed => "failure",
                        _ => "skipped",
                    };
                    let inner = format!("            <{tag} message=\"{message}\"/>");
                    writeln!(text, "        <testcase name=\"{name}\">\n{inner}\n        </testcase>")
                }
            };
        }
        text += "    </testsuite>\n";
    }
    text + "</testsuites>\n"
}

/// A text in the quotation marks of XML, which has no control characters.
fn attribute(text: &str) -> String {
    let text: String = text.chars().filter(|c| *c == '\n' || !c.is_control()).collect();
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;");
    text.replace('\n', "&#10;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::{Options, check};
    use crate::{Format, Level, Tolerances, Vectors, answers};

    #[test]
    fn one_cause_is_stated_once_with_the_number_of_cases() {
        let (vectors, folder) = (Vectors::embedded().unwrap(), tempfile::tempdir().unwrap());
        let stages = ["image-affine".to_owned(), "image-exact".to_owned()];
        let cases = vectors.manifest.cases.iter().filter(|c| stages.contains(&c.stage) && c.level == Level::Core);
        let mut wrong = 0;
        for case in cases {
            let mut image = vectors.arrays(&case.outputs["image"]).unwrap();
            let array = image.get_mut("").unwrap();
            let dropped = array.indexed_iter_mut().filter(|(index, x)| index[2] >= 5 && **x != 0.0);
            wrong += usize::from(dropped.map(|(_, x)| *x = 0.0).count() > 0);
            answers::write(folder.path(), case, &[("image".to_owned(), image)].into()).unwrap();
        }
        let today = crate::waivers::today();
        let options =
            Options { format: Format::F32, level: Level::Core, stages: &stages, waivers: &[], today, commit: None };
        let report = check(&vectors, &Tolerances::embedded().unwrap(), folder.path(), &options).unwrap();
        assert_eq!(report.count(Status::Failed), wrong);
        let places = report.results.iter().flat_map(|result| &result.parts).filter_map(|part| part.place.as_ref());
        let named = places.filter(|place| place.starts_with("columns 5-")).count();
        assert!(named > 10 && 10 * named >= 8 * wrong, "{named} of {wrong}");
        let text = markdown(&report);
        let rows: Vec<_> = text.lines().skip_while(|line| *line != "## Causes").collect();
        assert!(
            rows.iter().any(|row| row.contains("wrong at columns 5-") && row.contains(&format!("of {wrong}"))),
            "{text}"
        );
    }
}
