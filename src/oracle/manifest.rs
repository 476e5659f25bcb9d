//! The conformance vectors: the manifest and its arrays.

use ndarray::ArrayD;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use trgs_core::described;
use trgs_core::error::{Error, Result};
use trgs_scan::digest::digest_bytes;
use trgs_scan::npy;
use trgs_scan::npz::{self, Entry, Npz};
use trgs_scan::output::{Destination, Kind, create_folder, stage_folder, write_atomically};

/// The version of the manifest format that this program supports.
pub const SCHEMA_VERSION: u32 = 2;
/// The key of the manifest's `generator` with the digest of the vectors that were exported.
const ORIGIN: &str = "vectors";
/// The manifest's file name.
const MANIFEST: &str = "manifest.json";
/// The definition of every question and answer, for authors of backends.
pub const PROTOCOL: &str = include_str!(concat!(env!("TRGS_REFERENCE"), "/PROTOCOL.md"));
/// Its file name beside the manifest.
pub const PROTOCOL_FILE: &str = "PROTOCOL.md";

described! {
    /// How demanding a case is.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Level {
        /// Required of every implementation of the method.
        Core,
        /// Parametrisations and related methods that an implementation may lack.
        Optional,
        /// Ill-conditioned scenes, distant kernel tails, subnormal numbers.
        Stress,
        /// Sizes that break tiles, in generated questions alone.
        Large,
    }
}

/// A file of the conformance vectors.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRef {
    /// Path relative to the folder of the vectors, with `/`.
    pub file: String,
    /// SHA-256 of its bytes; absent if the file is withheld.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// A question and its answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// `stage/name`; also the folder of its outputs.
    pub id: String,
    /// The part of the method in question.
    pub stage: String,
    /// A description in one sentence.
    pub title: String,
    /// Tags of `reference/equations.md`.
    pub equations: Vec<String>,
    /// Level of the case.
    pub level: Level,
    /// Special properties; the manifest explains each word.
    pub flags: Vec<String>,
    /// SHA-256 of the section of PROTOCOL.md that defines the stage; in exports.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub protocol: Option<String>,
    /// Settings that are not arrays: numbers and words.
    pub settings: Map<String, Value>,
    /// Inputs, by role.
    pub inputs: BTreeMap<String, FileRef>,
    /// Expected outputs, by role.
    pub outputs: BTreeMap<String, FileRef>,
    /// Allowed error of each element of an output with a cutoff, by output role.
    ///
    /// A pixel on the border of a support may be inside or outside.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub allowances: BTreeMap<String, FileRef>,
}

/// `manifest.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Always [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Program and settings that generated the vectors.
    pub generator: Map<String, Value>,
    /// Meaning of the words in [`Case::flags`].
    pub flags: BTreeMap<String, String>,
    /// All cases, stage by stage.
    pub cases: Vec<Case>,
}

/// The arrays of one file: a single array without a name, or the arrays of an archive by name.
pub type Arrays = BTreeMap<String, ArrayD<f64>>;

/// The vectors built into the program.
#[cfg(feature = "vectors")]
static EMBEDDED: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/vectors.rs"));
#[cfg(not(feature = "vectors"))]
static EMBEDDED: &[(&str, &[u8])] = &[];

/// Conformance vectors from a folder or built in.
#[derive(Clone, Debug)]
pub struct Vectors {
    /// The manifest.
    pub manifest: Manifest,
    /// SHA-256 of the manifest, which holds all other digests.
    pub digest: String,
    root: Option<PathBuf>,
    /// Files in memory, which come before those in the folder.
    pub(super) files: BTreeMap<String, Vec<u8>>,
}

impl Vectors {
    /// The vectors built into this program.
    ///
    /// # Errors
    /// [`Error::Read`] without the feature `vectors`.
    pub fn embedded() -> Result<Self> {
        Self::new(None)
    }

    /// Opens the vectors in a folder.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for a manifest of another version or with paths outside the folder.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self> {
        Self::new(Some(folder.as_ref().into()))
    }

    /// The digest of the vectors that these were exported from, or their own.
    pub fn origin(&self) -> &str {
        self.manifest.generator.get(ORIGIN).and_then(Value::as_str).unwrap_or(&self.digest)
    }

    /// Vectors in memory.
    pub(super) fn of(manifest: Manifest, files: BTreeMap<String, Vec<u8>>) -> Self {
        let text = serde_json::to_vec(&manifest).expect("a manifest is JSON");
        Self { manifest, digest: digest_bytes(&text), root: None, files }
    }

    fn new(root: Option<PathBuf>) -> Result<Self> {
        let path = root.as_deref().unwrap_or(Path::new("")).join(MANIFEST);
        let bytes = bytes(root.as_deref(), MANIFEST)?;
        let wrong = |error: String| {
            let expected = format!("a manifest of schema version {SCHEMA_VERSION}");
            Error::format(&path, "manifest", error, expected, "use vectors and program of the same version")
        };
        // The version is checked first: another version may have other fields.
        let version: Value = serde_json::from_slice(&bytes).map_err(|error| wrong(error.to_string()))?;
        if version["schema_version"] != SCHEMA_VERSION {
            return Err(wrong(format!("schema_version {}", version["schema_version"])));
        }
        let manifest: Manifest = serde_json::from_slice(&bytes).map_err(|error| wrong(error.to_string()))?;
        for case in &manifest.cases {
            let files = case.inputs.values().chain(case.outputs.values()).chain(case.allowances.values());
            if let Some(file) = files.map(|f| &f.file).find(|file| !is_below(file)) {
                return Err(wrong(format!("the file {file:?} of {}, which is not below the folder", case.id)));
            }
        }
        Ok(Self { manifest, digest: digest_bytes(&bytes), root, files: BTreeMap::new() })
    }

    /// The bytes of a file, verified against its digest if there is one.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] if the digest differs.
    pub fn bytes(&self, file: &FileRef) -> Result<Cow<'static, [u8]>> {
        let bytes = match self.files.get(&file.file) {
            Some(bytes) => bytes.clone().into(),
            None => bytes(self.root.as_deref(), &file.file)?,
        };
        match &file.sha256 {
            Some(expected) if *expected != digest_bytes(&bytes) => Err(Error::format(
                &self.path(file),
                "SHA-256",
                digest_bytes(&bytes),
                format!("{expected}, as the manifest says"),
                "the file was changed: export the vectors again with `trgs oracle export`",
            )),
            _ => Ok(bytes),
        }
    }

    /// The arrays of a file.
    ///
    /// # Errors
    /// Those of [`Self::bytes`], and [`Error::Format`] for anything but a NumPy array or archive.
    pub fn arrays(&self, file: &FileRef) -> Result<Arrays> {
        decode(&self.bytes(file)?, &self.path(file))
    }

    /// The path of a file for messages.
    pub(super) fn path(&self, file: &FileRef) -> PathBuf {
        self.root.as_deref().unwrap_or(Path::new("(built-in vectors)")).join(&file.file)
    }

    /// Writes manifest, protocol and inputs to `folder` atomically, and the truth to `folder/expected`.
    ///
    /// `blind` leaves out the truth and its digests. Returns the number of input and truth files.
    ///
    /// # Errors
    /// Those of [`Self::bytes`] and of [`trgs_scan::output::StagedFolder::commit`].
    pub fn export(&self, folder: impl Into<Destination>, blind: bool, cases: &[&Case]) -> Result<usize> {
        let mut manifest =
            Manifest { cases: cases.iter().map(|&case| case.clone()).collect(), ..self.manifest.clone() };
        manifest.generator.entry(ORIGIN).or_insert_with(|| self.digest.clone().into());
        let sections = protocol_sections();
        for case in &mut manifest.cases {
            case.protocol = sections.get(&*case.stage).map(|text| digest_bytes(text.as_bytes()));
        }
        let staged = stage_folder(folder.into().of(Kind::Vectors))?;
        let mut files: BTreeMap<PathBuf, &FileRef> = BTreeMap::new();
        for case in cases {
            files.extend(case.inputs.values().map(|file| (PathBuf::from(&file.file), file)));
            if !blind {
                let expected = case.outputs.values().chain(case.allowances.values());
                files.extend(expected.map(|file| (Path::new("expected").join(&file.file), file)));
            }
        }
        if blind {
            for case in &mut manifest.cases {
                case.outputs.values_mut().for_each(|file| file.sha256 = None);
                case.allowances.clear();
            }
        }
        for (path, file) in &files {
            write_file(&staged.path().join(path), &self.bytes(file)?)?;
        }
        write_atomically(&staged.path().join(PROTOCOL_FILE), |out| out.write_all(PROTOCOL.as_bytes()))?;
        write_atomically(&staged.path().join(MANIFEST), |out| Ok(serde_json::to_writer_pretty(out, &manifest)?))?;
        staged.commit()?;
        Ok(files.len())
    }
}

/// The section of [`PROTOCOL`] that defines each stage, by the table of stages.
pub fn protocol_sections() -> BTreeMap<&'static str, &'static str> {
    let sections: BTreeMap<&str, &str> = (PROTOCOL.split("\n## ").skip(1))
        .filter_map(|section| section.split_once(". ").map(|(number, _)| (number, section)))
        .collect();
    let rows = PROTOCOL.lines().filter_map(|line| line.strip_prefix("| `")?.split_once("` | "));
    rows.filter_map(|(stage, rest)| Some((stage, *sections.get(rest.split(" |").next()?)?))).collect()
}

/// The arrays in the bytes of a `.npy` or `.npz` file; `path` gives the format and names it in errors.
pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Arrays> {
    if path.extension().is_some_and(|extension| extension == "npz") {
        let npz = Npz::parse(bytes, path)?;
        let array = |key: &str| npz.entry(key).expect("keys are those that are there").numbers.clone().into_f64();
        return Ok(npz.keys().map(|key| (key.to_owned(), array(key))).collect());
    }
    let array = npy::parse(bytes, path)?.numbers.into_f64();
    Ok([(String::new(), array)].into())
}

/// Writes a file in a folder that need not exist.
pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    create_folder(path.parent().expect("a file is in a folder"))?;
    write_atomically(path, |out| out.write_all(bytes))
}

/// The bytes of a `.npy` file for a single array, otherwise of a `.npz` file.
pub(super) fn encode(arrays: &Arrays) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    match arrays.get("") {
        Some(array) => npy::encode(&mut bytes, array.view()),
        None => {
            let entries: Vec<_> = arrays.iter().map(|(key, array)| (key.as_str(), Entry::F64(array.view()))).collect();
            npz::encode(&mut bytes, &entries)
        }
    }
    .expect("memory can be written to");
    bytes.into_inner()
}

fn bytes(root: Option<&Path>, file: &str) -> Result<Cow<'static, [u8]>> {
    match root {
        Some(root) => {
            let path = root.join(file);
            trgs_scan::input::read(&path).map(Cow::Owned).map_err(|source| Error::read(&path, source))
        }
        None => match EMBEDDED.binary_search_by_key(&file, |(path, _)| path) {
            Ok(index) => Ok(EMBEDDED[index].1.into()),
            Err(_) => {
                let text = match EMBEDDED {
                    [] => "this program was built without the feature `vectors`; read them from a folder",
                    _ => "not among the built-in vectors",
                };
                let missing = std::io::Error::new(std::io::ErrorKind::NotFound, text);
                Err(Error::read(Path::new(file), missing))
            }
        },
    }
}

/// Whether a path of the manifest stays inside its folder.
fn is_below(file: &str) -> bool {
    !file.is_empty() && file.split('/').all(|part| !matches!(part, "" | "." | "..") && !part.contains(['\\', ':']))
}
