//! A hunt: fresh questions to a backend until it fails, and the failure shrunk to a question that can be replayed.
//!
//! A hunt is a function of its seed and of the backend. After each batch `hunt.json` has what was asked and found, so a hunt
//! that was killed goes on where it stopped.

mod shrink;

use crate::check::{self, CaseResult, Options, PartResult, Status};
use crate::format::Format;
use crate::fresh::draft::{self, Draft};
use crate::fresh::{Ask, refusals, relations, truth};
use crate::limits::Tolerances;
use crate::manifest::{Arrays, Level, Vectors};
use crate::outputs::Outputs;
use crate::plain::answered;
use crate::waivers;
use serde::{Deserialize, Serialize};
use serde_json::json;
use shrink::{Judge, shrink};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use trgs_core::error::{Error, Result};
use trgs_scan::output::{Destination, Kind, write_atomically};

/// File of the state and the results of a hunt.
pub const STATE: &str = "hunt.json";
/// Questions of one stage in the first batch; later ones are larger.
const FIRST: usize = 24;
const LATER: usize = 96;
/// Questions of one stage in a batch of level `large`: two of each kind of scene.
const LARGE: usize = 10;
/// Numbers of threads with which a deterministic backend is asked again.
const THREADS: [&str; 2] = ["1", "3"];
/// File among the questions with the environment variables that a backend is to be started with.
const ENVIRONMENT: &str = "environment.json";

/// An implementation that answers questions: the folder of the questions, and the folder for its answers.
///
/// The result is the reason why it ended before its time, if it did.
pub type Backend<'a> = dyn FnMut(&Vectors, &Path, &Path) -> Result<Option<String>> + 'a;

/// The range of a hunt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Stages to ask.
    pub stages: Vec<String>,
    /// Seed of the questions.
    pub seed: u64,
    /// Questions of each stage.
    pub cases: usize,
    /// The backend's arithmetic.
    pub precision: Format,
    /// How demanding the questions are.
    pub level: Level,
    /// What they ask for.
    pub ask: Ask,
}

/// A failure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The stage that fails.
    pub stage: String,
    /// The first question that failed.
    pub first: String,
    /// The number of questions of the stage that were asked, and of those that failed.
    pub asked: usize,
    /// Failures among them.
    pub failed: usize,
    /// The mistake that the most of them look like.
    pub looks_like: Option<String>,
    /// The place of the error in the most of them: rows, views, primitives or tiles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
    /// What is wrong with the shrunk question.
    pub error: String,
    /// Primitives of the shrunk question.
    pub primitives: usize,
    /// Its pixels, voxels or elements.
    pub elements: usize,
    /// The folder of the shrunk question, below that of the hunt.
    pub case: String,
}

/// State and result of a hunt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hunt {
    /// The range.
    pub settings: Settings,
    /// Number of questions asked by stage, and the number of the next one.
    pub asked: BTreeMap<String, (usize, u64)>,
    /// Stages without any answer.
    pub unanswered: Vec<String>,
    /// One for each stage that failed.
    pub findings: Vec<Finding>,
}

impl Hunt {
    /// Begins a hunt in a folder, or goes on with the one that is there.
    ///
    /// # Errors
    /// For an unknown stage, a folder with other content, or a hunt with other settings.
    pub fn open(folder: &Path, settings: Settings) -> Result<Self> {
        let ask = settings.ask;
        if let Some(unknown) = settings.stages.iter().find(|stage| !ask.stages().contains(&stage.as_str())) {
            return Err(draft::unknown_stage(unknown, ask));
        }
        let new = Self { settings, asked: BTreeMap::new(), unanswered: Vec::new(), findings: Vec::new() };
        let path = folder.join(STATE);
        let refuse = |got: &str, expected: &str| {
            let remedy = "name another folder, or delete this one";
            Err(Error::invalid(format!("folder {}", folder.display()), got, expected, remedy))
        };
        match trgs_scan::input::read(&path) {
            Ok(bytes) => match serde_json::from_slice::<Self>(&bytes) {
                Ok(old) if old.settings == new.settings => Ok(old),
                _ => refuse("a hunt with other settings", "a new folder, or a hunt with the same settings"),
            },
            Err(_) if folder.read_dir().is_ok_and(|mut entries| entries.next().is_some()) => {
                refuse("other content", "a new or empty folder, or an unfinished hunt")
            }
            Err(_) => Ok(new),
        }
    }

    /// Asks until each stage has failed or has answered all its questions, or the time is over.
    ///
    /// # Errors
    /// Those of files, and of a backend that cannot be started.
    pub fn run(&mut self, folder: &Path, limit: Option<Duration>, backend: &mut Backend<'_>) -> Result<()> {
        let begin = Instant::now();
        while limit.is_none_or(|limit| begin.elapsed() < limit) {
            let mut batch = Vec::new();
            for stage in self.open_stages() {
                let (asked, next) = self.asked.get(&stage).copied().unwrap_or_default();
                let size = match (self.settings.level, asked) {
                    (Level::Large, _) => LARGE,
                    (_, 0) => FIRST,
                    _ => LATER,
                };
                let size = size.min(self.settings.cases - asked);
                let Settings { ask, seed, level, .. } = self.settings;
                let (drafts, next) = ask.drafts(&stage, seed, next, size, level);
                self.asked.insert(stage, (asked + drafts.len(), next));
                batch.extend(drafts);
            }
            if batch.is_empty() {
                break;
            }
            let mut asker = Asker { settings: &self.settings, backend: &mut *backend, explain: true };
            let results: Vec<CaseResult> = asker.ask(&batch)?.into_iter().flatten().collect();
            for stage in self.open_stages_of(&batch) {
                let of = |result: &&CaseResult| result.stage == stage;
                let answered = results.iter().filter(of).any(|result| result.status != Status::Missing);
                let failed: Vec<&CaseResult> = results.iter().filter(of).filter(|r| is_failure(r, answered)).collect();
                if !answered && failed.is_empty() {
                    self.unanswered.push(stage);
                } else if let Some(first) = failed.first() {
                    let start = batch.iter().find(|draft| draft.id == first.id).expect("the question that was asked");
                    let finding = self.finding(folder, start, &failed, backend)?;
                    self.findings.push(finding);
                }
            }
            self.write(folder)?;
        }
        self.write(folder)
    }

    fn is_open(&self, stage: &str) -> bool {
        let asked = self.asked.get(stage).map_or(0, |(asked, _)| *asked);
        let closed = self.findings.iter().map(|finding| &finding.stage).chain(&self.unanswered);
        let all = self.settings.cases.min(self.settings.ask.most(stage));
        asked < all && !closed.into_iter().any(|closed| closed == stage)
    }

    fn open_stages(&self) -> Vec<String> {
        self.settings.stages.iter().filter(|stage| self.is_open(stage)).cloned().collect()
    }

    fn open_stages_of(&self, batch: &[Draft]) -> Vec<String> {
        let mut stages: Vec<String> = batch.iter().map(|draft| draft.stage.clone()).collect();
        stages.dedup();
        stages
    }

    /// Shrinks a failure and writes it.
    fn finding(
        &self,
        folder: &Path,
        start: &Draft,
        failed: &[&CaseResult],
        backend: &mut Backend<'_>,
    ) -> Result<Finding> {
        let mut asker = Asker { settings: &self.settings, backend, explain: false };
        let small = match self.settings.ask {
            Ask::Refusals => start.clone(),
            _ => shrink(start.clone(), &mut asker)?,
        };
        let result = asker.ask(std::slice::from_ref(&small))?.remove(0);
        let error = result.as_ref().map_or_else(String::new, describe);
        let case = format!("{}-{}", small.stage, small.id.rsplit('-').next().unwrap_or_default());
        let vectors = question(&small, &self.settings);
        let cases: Vec<_> = vectors.manifest.cases.iter().collect();
        let destination = Destination::new(folder.join(&case), Kind::Vectors, "oracle hunt").overwrite(true);
        vectors.export(destination, true, &cases)?;
        let [primitives, elements] = small.size();
        Ok(Finding {
            stage: small.stage.clone(),
            first: start.id.clone(),
            asked: self.asked[&small.stage].0,
            failed: failed.len(),
            looks_like: most_frequent(failed, |part| part.looks_like.as_deref()),
            place: most_frequent(failed, |part| part.place.as_deref()),
            error,
            primitives,
            elements,
            case,
        })
    }

    fn write(&self, folder: &Path) -> Result<()> {
        trgs_scan::output::create_folder(folder)?;
        write_atomically(&folder.join(STATE), |out| Ok(serde_json::to_writer_pretty(out, self)?))
    }
}

/// A shrunk question as vectors that can be replayed.
fn question(small: &Draft, settings: &Settings) -> Vectors {
    let Settings { ask, precision, seed, .. } = settings;
    let generator = [("ask", json!(ask)), ("precision", json!(precision)), ("seed", json!(seed))];
    draft::vectors(&ask.forms(small), &generator)
}

/// The environment variables with which a backend is to be started for the questions of a folder.
///
/// # Errors
/// For a file that is there and cannot be read.
pub fn environment(questions: &Path) -> Result<BTreeMap<String, String>> {
    let path = questions.join(ENVIRONMENT);
    if !path.exists() {
        return Ok(BTreeMap::new());
    }
    let text = std::fs::read(&path).map_err(|source| Error::read(&path, source))?;
    let expected = "an object of names and texts";
    serde_json::from_slice(&text)
        .map_err(|error| Error::format(&path, "environment", error, expected, "make the questions again"))
}

/// Asks a backend generated questions again, such as a shrunk one, and judges the answers.
///
/// # Errors
/// Those of files, and of a backend that cannot be started.
pub fn replay(vectors: &Vectors, precision: Format, backend: &mut Backend<'_>) -> Result<Vec<CaseResult>> {
    let ask = Ask::of(vectors);
    let settings = Settings { stages: Vec::new(), seed: 0, cases: 0, precision, level: Level::Large, ask };
    let drafts = vectors.manifest.cases.iter().map(|case| Draft::read(vectors, case)).collect::<Result<Vec<_>>>()?;
    let mut asker = Asker { settings: &settings, backend, explain: true };
    if ask == Ask::Relations {
        let groups = relations::groups(&vectors.manifest.cases).into_iter();
        let known = groups.map(|range| Known {
            id: drafts[range.start].id.clone(),
            forms: drafts[range].to_vec(),
            truth: None,
        });
        return asker.judge(&known.collect::<Vec<_>>());
    }
    Ok(asker.ask(&drafts)?.into_iter().flatten().collect())
}

/// The precision that generated questions were asked in, if they say so.
pub fn precision(vectors: &Vectors) -> Option<Format> {
    vectors.manifest.generator.get("precision").and_then(|value| serde_json::from_value(value.clone()).ok())
}

/// Whether a result is a failure. No answer is one where other questions of the stage are answered.
fn is_failure(result: &CaseResult, answered: bool) -> bool {
    result.status == Status::Failed || (result.status == Status::Missing && answered)
}

/// The words that the most failures have.
fn most_frequent(failed: &[&CaseResult], words: fn(&PartResult) -> Option<&str>) -> Option<String> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for name in failed.iter().flat_map(|result| &result.parts).filter_map(words) {
        *counts.entry(name).or_default() += 1;
    }
    let most = counts.values().copied().max()?;
    counts.iter().find(|(_, count)| **count == most).map(|(name, _)| (*name).to_owned())
}

/// The worst array of a result in words.
pub fn describe(result: &CaseResult) -> String {
    let part = result.parts.iter().max_by_key(|part| part.status);
    let Some(part) = part else { return "no array".into() };
    if let Some(message) = &part.message {
        return format!("{}: {message}", part.output);
    }
    match part.difference.as_ref().and_then(|difference| difference.worst.as_ref()) {
        Some(worst) => format!("{}{:?}: got {}, expected {}", part.output, worst.index, worst.got, worst.expected),
        None => format!("{}: equal", part.output),
    }
}

/// A backend with the judge of its answers.
struct Asker<'a, 'b> {
    settings: &'a Settings,
    backend: &'a mut Backend<'b>,
    explain: bool,
}

/// A question in its forms, with its truth if it has one.
struct Known {
    id: String,
    forms: Vec<Draft>,
    truth: Option<(Outputs, Outputs)>,
}

impl Known {
    /// `None` for a question without a finite answer, unless it is to be refused.
    fn new(base: &Draft, settings: &Settings) -> Option<Self> {
        let forms = settings.ask.forms(base);
        let truth = match settings.ask {
            Ask::Values => Some(truth::truth(base, settings.precision).ok()?),
            Ask::Relations => {
                forms.iter().try_for_each(|form| form.question().map(drop)).ok()?;
                None
            }
            Ask::Refusals => None,
        };
        Some(Self { id: base.id.clone(), forms, truth })
    }
}

impl Asker<'_, '_> {
    /// Results in the order of the questions; none for a question without a finite answer, which is not asked.
    fn ask(&mut self, drafts: &[Draft]) -> Result<Vec<Option<CaseResult>>> {
        let known: Vec<Option<Known>> = drafts.iter().map(|draft| Known::new(draft, self.settings)).collect();
        let valid: Vec<bool> = known.iter().map(Option::is_some).collect();
        let mut results = self.judge(&known.into_iter().flatten().collect::<Vec<_>>())?.into_iter();
        Ok(valid.into_iter().map(|valid| if valid { results.next() } else { None }).collect())
    }

    /// Questions that ended the backend before its time are found by halves.
    fn judge(&mut self, known: &[Known]) -> Result<Vec<CaseResult>> {
        if known.is_empty() {
            return Ok(Vec::new());
        }
        let scratch = tempfile::tempdir().map_err(|source| Error::write(&std::env::temp_dir(), source))?;
        let (questions, answers) = (scratch.path().join("vectors"), scratch.path().join("answers"));
        let forms: Vec<Draft> = known.iter().flat_map(|known| known.forms.clone()).collect();
        let mut vectors = draft::vectors(&forms, &[("ask", json!(self.settings.ask))]);
        write_plainly(&vectors, &questions)?;
        trgs_scan::output::create_folder(&answers)?;
        let ended = (self.backend)(&vectors, &questions, &answers)?;
        if ended.is_some() && known.len() > 1 {
            let (first, second) = known.split_at(known.len() / 2);
            let mut results = self.judge(first)?;
            results.extend(self.judge(second)?);
            return Ok(results);
        }
        let differing = if ended.is_none() { self.differing(&vectors, &answers)? } else { BTreeMap::new() };
        let truths = known.iter().flat_map(|known| &known.truth).enumerate();
        truths.for_each(|(index, truth)| truth::insert(&mut vectors, index, truth));
        if self.settings.ask == Ask::Relations {
            relations::complete(&mut vectors, &answers)?;
        }
        let format = self.settings.precision;
        let today = waivers::today();
        let options = Options { format, level: Level::Large, stages: &[], waivers: &[], today, commit: None };
        let mut all =
            check::report(&vectors, &Tolerances::of(&vectors)?, &answers, &options, self.explain)?.results.into_iter();
        let worst = known.iter().map(|known| {
            let forms = all.by_ref().take(known.forms.len());
            let worst = forms.max_by_key(|result| result.status).expect("a result for each form");
            let stage = known.forms.last().expect("at least one form").stage.clone();
            let mut result = CaseResult { id: known.id.clone(), stage, ..worst };
            if let Some(message) = known.forms.iter().find_map(|form| differing.get(&form.id)) {
                (result.parts[0].status, result.parts[0].message) = (Status::Failed, Some(message.clone()));
                result.status = Status::Failed;
            }
            result
        });
        let mut results: Vec<CaseResult> = worst.collect();
        if let Some(reason) = ended {
            let may = self.settings.ask == Ask::Refusals && refusals::may_refuse(&known[0].forms[0].flags);
            let status = if may { Status::Passed } else { Status::Failed };
            for part in results.iter_mut().flat_map(|result| &mut result.parts) {
                (part.status, part.message) = (status, Some(reason.clone()));
            }
            results.iter_mut().for_each(|result| result.status = status);
        }
        Ok(results)
    }

    /// Asks a backend that says it is deterministic again, in the reversed order: once, or with each of [`THREADS`] where it
    /// names a switch for them; the questions with other bits.
    fn differing(&mut self, vectors: &Vectors, answers: &Path) -> Result<BTreeMap<String, String>> {
        let mut differing = BTreeMap::new();
        if !check::is_deterministic(answers)? {
            return Ok(differing);
        }
        let mut reversed = vectors.clone();
        reversed.manifest.cases.reverse();
        let settings = match check::thread_switch(answers)? {
            Some(variable) => THREADS.map(|threads| Some((variable.clone(), threads))).to_vec(),
            None => vec![None],
        };
        for setting in settings {
            let scratch = tempfile::tempdir().map_err(|source| Error::write(&std::env::temp_dir(), source))?;
            let (questions, again) = (scratch.path().join("vectors"), scratch.path().join("answers"));
            write_plainly(&reversed, &questions)?;
            trgs_scan::output::create_folder(&again)?;
            let mut how = "in the reversed order of questions".to_owned();
            if let Some((variable, threads)) = setting {
                how += &format!(" with {variable}={threads}");
                let path = questions.join(ENVIRONMENT);
                let text = json!({ variable: threads }).to_string();
                std::fs::write(&path, text).map_err(|source| Error::write(&path, source))?;
            }
            (self.backend)(&reversed, &questions, &again)?;
            for case in &vectors.manifest.cases {
                for (role, file) in &case.outputs {
                    let [first, second] =
                        [answers, &again].map(|folder| answered(&folder.join(&file.file)).ok().flatten());
                    if bits(first) != bits(second) {
                        let message = || format!("{role} has other bits when asked again {how}");
                        differing.entry(case.id.clone()).or_insert_with(message);
                    }
                }
            }
        }
        Ok(differing)
    }
}

/// The bits of all numbers, by the arrays' names.
fn bits(arrays: Option<Arrays>) -> Option<Vec<(String, Vec<u64>)>> {
    let of = |(name, array): (String, ndarray::ArrayD<f64>)| (name, array.iter().map(|x| x.to_bits()).collect());
    arrays.map(|arrays| arrays.into_iter().map(of).collect())
}

impl Judge for Asker<'_, '_> {
    fn fail(&mut self, drafts: &[Draft]) -> Result<Vec<bool>> {
        let mut asked = drafts.to_vec();
        asked.iter_mut().enumerate().for_each(|(index, draft)| draft.id = format!("{}/try-{index}", draft.stage));
        let results = self.ask(&asked)?;
        Ok(results.iter().map(|result| result.as_ref().is_some_and(|result| is_failure(result, true))).collect())
    }
}

/// Writes questions to a scratch folder: without marks, and without waiting for the disk.
fn write_plainly(vectors: &Vectors, folder: &Path) -> Result<()> {
    let write = |path: PathBuf, bytes: &[u8]| {
        trgs_scan::output::create_folder(path.parent().expect("a file is in a folder"))?;
        std::fs::write(&path, bytes).map_err(|source| Error::write(&path, source))
    };
    for (name, bytes) in &vectors.files {
        write(folder.join(name), bytes)?;
    }
    let manifest = serde_json::to_vec(&vectors.manifest).expect("a manifest is JSON");
    write(folder.join("manifest.json"), &manifest)
}

#[cfg(test)]
mod tests;
