//! Checks a backend's answers against the truth.

mod together;

use super::TRACED;
use super::answers::STAGES;
use super::condition::{self, Conditions};
use super::diagnosis::{self, arrays::transposition};
use super::difference::Difference;
use super::format::Format;
use super::fresh::{Ask, refusals};
use super::limits::{Element, Excess, Tolerances};
use super::manifest::{Arrays, Case, FileRef, Level, Vectors};
use super::place::Errors;
use super::plain::answered;
use super::question::Question;
use super::waivers::Waiver;
use ndarray::ArrayD;
use serde::Serialize;
use serde_json::Value;
use std::path::Path;
use toml::value::Date;
use trgs_core::error::{Error, Result};
use trgs_core::setting::Setting;

/// File in the folder of answers in which a backend may describe itself.
pub const BACKEND: &str = "backend.json";

/// The selection of cases, and the strictness.
#[derive(Clone, Debug)]
pub struct Options<'a> {
    /// The backend's arithmetic.
    pub format: Format,
    /// Highest level to check; cases of higher levels are skipped.
    pub level: Level,
    /// Only these stages; all if empty.
    pub stages: &'a [String],
    /// Accepted failures.
    pub waivers: &'a [Waiver],
    /// The date that waivers are compared with.
    pub today: Date,
    /// The commit that this program was built from, for the report.
    pub commit: Option<&'a str>,
}

/// Outcome of a case or an array, from good to bad.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// Within the tolerances.
    #[default]
    Passed,
    /// The format cannot represent the numbers of the case.
    Skipped,
    /// Failed, but covered by a waiver.
    Waived,
    /// The backend wrote no answer.
    Missing,
    /// Beyond a tolerance, not finite, or not readable.
    Failed,
}

/// One array of an output.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PartResult {
    /// The output's role, and for an archive the array's name: `grad.nu`.
    pub output: String,
    /// The file, relative to the folder of answers.
    pub file: String,
    /// Outcome.
    pub status: Status,
    /// The errors, if the arrays could be compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difference: Option<Difference>,
    /// The element that is nearest to its own limit, or beyond it, where its condition is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub element: Option<Element>,
    /// The norms above their limits.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub exceeded: Vec<Excess>,
    /// Any other defect.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub message: Option<String>,
    /// The mistake that explains the error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub looks_like: Option<String>,
    /// The rows, views, primitives or tiles that are wrong, if the rest is right.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
}

impl PartResult {
    /// An array without a fault.
    fn new(output: String, file: &FileRef) -> Self {
        Self { output, file: file.file.clone(), ..Self::default() }
    }
}

/// One case.
#[derive(Clone, Debug, Serialize)]
pub struct CaseResult {
    /// `stage/name`.
    pub id: String,
    /// Part of the method.
    pub stage: String,
    /// Level of the case.
    pub level: Level,
    /// Tags of `reference/equations.md`.
    pub equations: Vec<String>,
    /// The worst outcome of its arrays.
    pub status: Status,
    /// Its arrays.
    pub parts: Vec<PartResult>,
    /// The reason of the waiver, or that the waiver has expired.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub waiver: Option<String>,
}

/// The results of a check.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// This program's version.
    pub program: String,
    /// The commit it was built from, if known.
    pub commit: Option<String>,
    /// Digest of the manifest that was checked against.
    pub vectors: String,
    /// The backend's description of itself.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backend: Option<Value>,
    /// The backend's arithmetic.
    pub format: Format,
    /// Highest level checked.
    pub level: Level,
    /// The file of limits that were added to those of this program, with its digest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerances: Option<String>,
    /// Waivers of cases that passed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub unused_waivers: Vec<String>,
    /// All cases checked.
    pub results: Vec<CaseResult>,
}

impl Report {
    /// Number of cases with the outcome `status`.
    pub fn count(&self, status: Status) -> usize {
        self.results.iter().filter(|result| result.status == status).count()
    }

    /// Whether no case failed or is missing.
    pub fn passed(&self) -> bool {
        self.results.iter().all(|result| result.status <= Status::Waived)
    }
}

/// The cases of the given stages up to a level.
///
/// # Errors
/// When a stage does not exist, or no case is left.
pub fn select<'a>(vectors: &'a Vectors, level: Level, stages: &[String]) -> Result<Vec<&'a Case>> {
    let cases = &vectors.manifest.cases;
    if let Some(unknown) = stages.iter().find(|stage| !cases.iter().any(|case| case.stage == **stage)) {
        let mut known: Vec<&str> = cases.iter().map(|case| case.stage.as_str()).collect();
        known.dedup();
        return Err(Error::invalid(
            Setting::Stage,
            unknown,
            format!("one of {}", known.join(", ")),
            "take a name that `trgs oracle list` prints",
        ));
    }
    let wanted = |case: &&Case| case.level <= level && (stages.is_empty() || stages.contains(&case.stage));
    let selected: Vec<&Case> = cases.iter().filter(wanted).collect();
    if selected.is_empty() {
        let got = format!("no case of {stages:?} up to this level");
        let remedy = "raise " + Setting::Level + " or name another " + Setting::Stage;
        return Err(Error::invalid("selection", got, "at least one case", remedy));
    }
    Ok(selected)
}

/// Compares the answers in `folder` with the truth.
///
/// # Errors
/// When the selection is empty, the folder does not exist, or the vectors are damaged. A wrong answer is a result, not
/// an error.
pub fn check(
    vectors: &Vectors,
    tolerances: &Tolerances,
    folder: impl AsRef<Path>,
    options: &Options<'_>,
) -> Result<Report> {
    report(vectors, tolerances, folder.as_ref(), options, true)
}

/// A check in which errors have places and names only if `explain`, because those take most of its time.
pub(crate) fn report(
    vectors: &Vectors,
    tolerances: &Tolerances,
    folder: &Path,
    options: &Options<'_>,
    explain: bool,
) -> Result<Report> {
    let mut cases = select(vectors, options.level, options.stages)?;
    std::fs::read_dir(folder).map_err(|source| Error::read(folder, source))?;
    let about = backend(folder)?;
    if let Some(about) = &about {
        answered_these(about, vectors, folder)?;
        if let Some(stages) = declared(about, folder)? {
            cases.retain(|case| stages.contains(&case.stage));
        }
    }
    let refusals = Ask::of(vectors) == Ask::Refusals;
    let results = cases.into_iter().map(|case| match refusals {
        true => Ok(check_refusal(folder, case)),
        false => check_case(vectors, tolerances, folder, options, case, explain),
    });
    let mut results = results.collect::<Result<Vec<CaseResult>>>()?;
    if explain {
        together::name(&mut results, vectors, tolerances, options.format)?;
    }
    let unused = options
        .waivers
        .iter()
        .filter(|waiver| results.iter().any(|result| result.id == waiver.case && result.status == Status::Passed));
    Ok(Report {
        program: format!("trgs {}", env!("CARGO_PKG_VERSION")),
        commit: options.commit.map(Into::into),
        vectors: vectors.digest.clone(),
        backend: about,
        format: options.format,
        level: options.level,
        tolerances: tolerances.added.clone(),
        unused_waivers: unused.map(|waiver| waiver.case.clone()).collect(),
        results,
    })
}

/// Whether a backend says that its answers are the same bits whenever it is asked.
///
/// # Errors
/// For an unreadable description.
pub(crate) fn is_deterministic(folder: &Path) -> Result<bool> {
    Ok(backend(folder)?.is_some_and(|about| about["deterministic"] == true))
}

/// The environment variable that a backend names as the switch of its number of threads.
///
/// # Errors
/// For a description that is unreadable, or names no variable.
pub(crate) fn thread_switch(folder: &Path) -> Result<Option<String>> {
    let Some(about) = backend(folder)?.filter(|about| !about["threads"].is_null()) else { return Ok(None) };
    let name = about["threads"].as_str().unwrap_or_default();
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if name.is_empty() || name.starts_with(|c: char| c.is_ascii_digit()) || !name.chars().all(plain) {
        let expected = "the name of an environment variable, such as OMP_NUM_THREADS";
        let path = folder.join(BACKEND);
        return Err(Error::format(&path, "threads", &about["threads"], expected, "correct it, or leave it out"));
    }
    Ok(Some(name.into()))
}

/// Refuses answers to other vectors, if the backend says which it answered.
fn answered_these(about: &Value, vectors: &Vectors, folder: &Path) -> Result<()> {
    match about["vectors"].as_str() {
        Some(digest) if digest != vectors.origin() => {
            let remedy = "answer the vectors of this program, or check against those that were answered";
            Err(Error::format(&folder.join(BACKEND), "vectors", digest, vectors.origin(), remedy))
        }
        _ => Ok(()),
    }
}

/// The stages that a backend says it answers.
fn declared(about: &Value, folder: &Path) -> Result<Option<Vec<String>>> {
    if about["stages"].is_null() {
        return Ok(None);
    }
    let stages: Option<Vec<String>> = serde_json::from_value(about["stages"].clone()).ok();
    let all: Vec<_> = STAGES.into_iter().chain(TRACED).collect();
    let known = |stages: &Vec<String>| stages.iter().all(|stage| all.contains(&stage.as_str()));
    stages.filter(known).map(Some).ok_or_else(|| {
        let (got, expected) = (&about["stages"], format!("a list of {}", all.join(", ")));
        Error::format(&folder.join(BACKEND), "stages", got, expected, "correct the names, or leave the list out")
    })
}

/// The backend's description of itself; a missing file is allowed, an unreadable one is an error.
fn backend(folder: &Path) -> Result<Option<Value>> {
    let path = folder.join(BACKEND);
    if !path.exists() {
        return Ok(None);
    }
    let text = trgs_scan::input::read(&path).map_err(|source| Error::read(&path, source))?;
    serde_json::from_slice(&text).map(Some).map_err(|error| {
        Error::format(
            &path,
            "backend",
            error,
            "JSON, for example {\"name\": …, \"version\": …, \"device\": …}",
            "correct the file, or delete it",
        )
    })
}

fn check_case(
    vectors: &Vectors,
    tolerances: &Tolerances,
    folder: &Path,
    options: &Options<'_>,
    case: &Case,
    explain: bool,
) -> Result<CaseResult> {
    let mut parts = Vec::new();
    let judges_elements = !tolerances.elements.is_empty();
    let conditions = if judges_elements { condition::of(vectors, case)? } else { Conditions::new() };
    for (role, file) in &case.outputs {
        let expected = vectors.arrays(file)?;
        let allowance = case.allowances.get(role).map(|file| vectors.arrays(file)).transpose()?;
        let got = read_answer(folder, file);
        for (name, expected) in &expected {
            let allowance = allowance.as_ref().and_then(|arrays| arrays.get(name));
            let part = Part {
                vectors,
                tolerances,
                case,
                role,
                file,
                name,
                expected,
                allowance,
                conditions: &conditions,
                format: tolerances.judged_as(&case.stage, options.format),
                explain,
            };
            parts.push(part.judge(&got)?);
        }
    }
    // Outputs of traced steps are in the order of their computation: the first wrong one is the cause.
    if TRACED.contains(&case.stage.as_str())
        && let Some(first) = parts.iter().position(|part| part.status == Status::Failed)
    {
        let message = format!("after {}, which is wrong already", parts[first].output);
        let later = parts[first + 1..].iter_mut().filter(|part| part.status == Status::Failed);
        later.for_each(|part| (part.message, part.looks_like) = (Some(message.clone()), None));
    }
    let mut status = parts.iter().map(|part| part.status).max().unwrap_or(Status::Failed);
    let mut excuse = None;
    if status > Status::Waived
        && let Some(waiver) = options.waivers.iter().find(|waiver| waiver.case == case.id)
    {
        if waiver.expires >= options.today {
            status = Status::Waived;
            excuse = Some(format!("{} (until {})", waiver.reason, waiver.expires));
        } else {
            excuse = Some(format!("its waiver ran out on {}: {}", waiver.expires, waiver.reason));
        }
    }
    let (id, stage, equations) = (case.id.clone(), case.stage.clone(), case.equations.clone());
    Ok(CaseResult { id, stage, level: case.level, equations, status, parts, waiver: excuse })
}

/// Judges the answer to a question that has none, or may have none. One output that is refused refuses the question.
fn check_refusal(folder: &Path, case: &Case) -> CaseResult {
    let got: Vec<_> = case.outputs.values().map(|file| read_answer(folder, file)).collect();
    let is_missing = got.iter().any(|got| matches!(got, Err((Status::Missing, _))));
    let broken = got.iter().filter_map(|got| got.as_ref().err()).find(|(status, _)| *status == Status::Failed);
    let is_finite = got.iter().flatten().all(|arrays| arrays.values().flatten().all(|x| x.is_finite()));
    let message = match broken {
        Some((_, message)) => Some(message.clone()),
        None => refusals::fault(&case.flags, (!is_missing).then_some(is_finite)).map(Into::into),
    };
    let status = match (&message, is_missing) {
        (None, _) => Status::Passed,
        (Some(_), true) => Status::Missing,
        (Some(_), false) => Status::Failed,
    };
    let part = |(role, file): (&String, &FileRef)| {
        let message = message.clone();
        PartResult { status, message, ..PartResult::new(role.clone(), file) }
    };
    let parts = case.outputs.iter().map(part).collect();
    let (id, stage, equations) = (case.id.clone(), case.stage.clone(), case.equations.clone());
    CaseResult { id, stage, level: case.level, equations, status, parts, waiver: None }
}

/// The arrays of the backend's file, or an outcome with a message.
fn read_answer(folder: &Path, file: &FileRef) -> std::result::Result<Arrays, (Status, String)> {
    match answered(&folder.join(&file.file)) {
        Ok(found) => found.ok_or_else(|| (Status::Missing, "no such file".into())),
        Err(error) => Err((Status::Failed, error.to_string())),
    }
}

/// One array with everything needed to judge it.
struct Part<'a> {
    vectors: &'a Vectors,
    tolerances: &'a Tolerances,
    case: &'a Case,
    role: &'a str,
    file: &'a FileRef,
    name: &'a str,
    expected: &'a ArrayD<f64>,
    allowance: Option<&'a ArrayD<f64>>,
    conditions: &'a Conditions,
    format: Format,
    explain: bool,
}

impl Part<'_> {
    fn judge(&self, got: &std::result::Result<Arrays, (Status, String)>) -> Result<PartResult> {
        let output = if self.name.is_empty() { self.role.into() } else { format!("{}.{}", self.role, self.name) };
        let mut result = PartResult::new(output, self.file);
        let finite = self.expected.iter().filter(|x| x.is_finite());
        if finite.fold(0.0_f64, |peak, x| peak.max(x.abs())) > self.format.largest() {
            result.status = Status::Skipped;
            result.message = Some(format!("{} cannot hold its numbers", self.format));
            return Ok(result);
        }
        let got = match got.as_ref().map(|arrays| arrays.get(self.name)) {
            Ok(Some(got)) => got,
            Ok(None) => {
                (result.status, result.message) = (Status::Missing, Some(format!("no array {:?}", self.name)));
                return Ok(result);
            }
            Err((status, message)) => {
                (result.status, result.message) = (*status, Some(message.clone()));
                return Ok(result);
            }
        };
        if got.shape() != self.expected.shape() {
            result.status = Status::Failed;
            result.message = Some(format!("shape {:?}, expected {:?}", got.shape(), self.expected.shape()));
            result.looks_like = transposition(self.expected, got, diagnosis::axes(self.role));
            return Ok(result);
        }
        let part = if self.name.is_empty() { self.role } else { self.name };
        let rule = self.tolerances.rule(self.case, part, self.format).ok_or_else(|| {
            let got = format!("no rule for {} {part} in {}", self.case.id, self.format);
            Error::invalid(
                "tolerances",
                got,
                "a rule for every stage and format",
                "add a rule to reference/tolerances.toml",
            )
        })?;
        let difference = Difference::new(self.expected, got, self.allowance, self.format);
        result.exceeded = rule.limits[&self.format].exceeded(&difference);
        if let (Some(k), Some(condition)) = (self.tolerances.factor(self.case, part), self.conditions.get(self.name)) {
            result.element = Element::worst(self.expected, got, self.allowance, condition, self.format);
            let beyond = result.element.as_ref().filter(|element| element.ratio > k);
            result.exceeded.extend(beyond.map(|element| Excess { norm: "element", value: element.ratio, limit: k }));
        }
        if !result.exceeded.is_empty() {
            result.status = Status::Failed;
            if got.iter().any(|x| x.is_nan()) {
                result.message = Some("NaN".into());
            }
        }
        if !result.exceeded.is_empty() && self.explain {
            result.place = self.place(got, part, rule.limits[&self.format].peak.unwrap_or(0.0));
            let question = Question::new(self.vectors, self.case)?;
            let limit = rule.limits[&self.format].peak.unwrap_or(0.0);
            let names = (self.role, self.name);
            result.looks_like = diagnosis::of_part(&question, names, self.expected, got, self.format, limit);
        }
        result.difference = Some(difference);
        Ok(result)
    }

    /// The place of the error, by the limit of each element, or by the limit of the peak.
    fn place(&self, got: &ArrayD<f64>, part: &str, limit: f64) -> Option<String> {
        let finite = self.expected.iter().filter(|e| e.is_finite());
        let norm = limit * finite.fold(0.0_f64, |peak, e| peak.max(e.abs()));
        let factor = self.tolerances.factor(self.case, part).unwrap_or(0.0) * self.format.ulp(1.0) / 2.0;
        let condition = self.conditions.get(self.name).filter(|_| factor > 0.0);
        let allowed = |index: &[usize]| self.allowance.map_or(0.0, |allowance| allowance[index]);
        let limit = |index: &[usize], _: f64| {
            let own = condition.map_or(norm, |condition| factor * condition[index]);
            own + allowed(index) + self.format.smallest_normal()
        };
        let axes = match (diagnosis::axes(self.role), self.role) {
            ([], "grad" | "model" | "physical" | "covariance" | "shadow" | "confidence") => &["primitive", "component"],
            (axes, _) => axes,
        };
        Errors::new(self.expected, got, limit).place(axes)
    }
}
