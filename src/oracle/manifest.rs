//! The conformance vectors: their manifest, and the arrays behind it.

use crate::error::{Error, Result};
use crate::output::{create_folder, stage_folder, write_atomically};
use crate::provenance::digest_bytes;
use crate::scene::npy;
use crate::scene::npz::Npz;
use documented::DocumentedVariants;
use ndarray::ArrayD;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// The version of the manifest's format that this program speaks.
pub const SCHEMA_VERSION: u32 = 2;
/// The manifest's file name.
const MANIFEST: &str = "manifest.json";

/// How much is asked of an implementation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, DocumentedVariants)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// What every implementation of the method should meet.
    Core,
    /// Parametrisations and surroundings that another implementation may not have.
    Optional,
    /// Ill-conditioned, far skirts, subnormal numbers.
    Stress,
}

impl Level {
    /// All levels, from the least.
    pub const ALL: [Self; 3] = [Self::Core, Self::Optional, Self::Stress];
}

/// A file of the vectors.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRef {
    /// Path below the folder of the vectors, with `/`.
    pub file: String,
    /// Digest of its bytes; absent where the file itself is withheld.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// One question and its answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// `stage/name`; also the folder of its outputs.
    pub id: String,
    /// Which part of the method is asked for.
    pub stage: String,
    /// One sentence.
    pub title: String,
    /// Tags of `reference/equations.md`.
    pub equations: Vec<String>,
    /// How much is asked.
    pub level: Level,
    /// What is special about it; the manifest explains each word.
    pub flags: Vec<String>,
    /// Numbers and words that are not arrays.
    pub settings: Map<String, Value>,
    /// What is given, by role.
    pub inputs: BTreeMap<String, FileRef>,
    /// What is asked for, by role.
    pub outputs: BTreeMap<String, FileRef>,
    /// For outputs that a cutoff makes jump: how much each element may be off because a pixel on the border of a
    /// support may fall to either side. By the output's role.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub allowances: BTreeMap<String, FileRef>,
}

/// `manifest.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// What made the vectors.
    pub generator: Map<String, Value>,
    /// What the words in [`Case::flags`] mean.
    pub flags: BTreeMap<String, String>,
    /// All cases, stage by stage.
    pub cases: Vec<Case>,
}

/// The arrays of one file: one without a name, or those of an archive by name.
pub type Arrays = BTreeMap<String, ArrayD<f64>>;

/// Those that were built into the program, by `src/build.rs`: path below `reference/vectors` and content, in order.
static EMBEDDED: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/vectors.rs"));

/// Conformance vectors, in a folder or built in.
#[derive(Clone, Debug)]
pub struct Vectors {
    /// The manifest.
    pub manifest: Manifest,
    /// SHA-256 of the manifest, which names all other digests.
    pub digest: String,
    root: Option<PathBuf>,
}

impl Vectors {
    /// The vectors built into this program.
    ///
    /// # Errors
    /// None in a program that passed its tests.
    pub fn embedded() -> Result<Self> {
        Self::new(None)
    }

    /// The vectors in a folder.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for a manifest of another version or with paths that lead out of the folder.
    pub fn open(folder: &Path) -> Result<Self> {
        Self::new(Some(folder.into()))
    }

    fn new(root: Option<PathBuf>) -> Result<Self> {
        let path = root.as_deref().unwrap_or(Path::new("")).join(MANIFEST);
        let bytes = bytes(root.as_deref(), MANIFEST)?;
        let wrong = |error: String| {
            let expected = format!("a manifest of schema version {SCHEMA_VERSION}");
            Error::format(&path, "manifest", error, expected, "use vectors and program of the same version")
        };
        // The version first: another one may have other fields.
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
        Ok(Self { manifest, digest: digest_bytes(&bytes), root })
    }

    /// The bytes of a file, compared with its digest where there is one.
    ///
    /// # Errors
    /// [`Error::Read`] or, when the digest differs, [`Error::Format`].
    pub fn bytes(&self, file: &FileRef) -> Result<Cow<'static, [u8]>> {
        let bytes = bytes(self.root.as_deref(), &file.file)?;
        match &file.sha256 {
            Some(expected) if *expected != digest_bytes(&bytes) => Err(Error::format(
                &self.path(file),
                "SHA-256",
                digest_bytes(&bytes),
                format!("{expected}, as the manifest says"),
                "the vectors were changed: take them anew",
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

    /// What a file is called in messages.
    pub(super) fn path(&self, file: &FileRef) -> PathBuf {
        self.root.as_deref().unwrap_or(Path::new("(built-in vectors)")).join(&file.file)
    }

    /// Writes manifest and inputs to `folder` as a whole, and the truth to `folder/expected`; `blind`: without the truth
    /// and its digests.
    ///
    /// # Errors
    /// Those of [`Self::bytes`] and of [`crate::output::StagedFolder::commit`].
    pub fn export(&self, folder: &Path, blind: bool, cases: &[&Case]) -> Result<usize> {
        let mut manifest =
            Manifest { cases: cases.iter().map(|&case| case.clone()).collect(), ..self.manifest.clone() };
        let staged = stage_folder(folder)?;
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
            let path = staged.path().join(path);
            create_folder(path.parent().expect("a file is in a folder"))?;
            let bytes = self.bytes(file)?;
            write_atomically(&path, |out| std::io::Write::write_all(out, &bytes))?;
        }
        write_atomically(&staged.path().join(MANIFEST), |out| Ok(serde_json::to_writer_pretty(out, &manifest)?))?;
        staged.commit()?;
        Ok(files.len())
    }
}

/// The arrays in the bytes of a `.npy` or `.npz` file; `path` tells which, and names it in errors.
pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Arrays> {
    if path.extension().is_some_and(|extension| extension == "npz") {
        let npz = Npz::decode(Cursor::new(bytes), path)?;
        let array = |key: &str| npz.entry(key).expect("keys are those that are there").numbers.clone().into_f64();
        return Ok(npz.keys().map(|key| (key.to_owned(), array(key))).collect());
    }
    let array = npy::decode(bytes, bytes.len() as u64, path, "file")?.numbers.into_f64();
    Ok([(String::new(), array)].into())
}

fn bytes(root: Option<&Path>, file: &str) -> Result<Cow<'static, [u8]>> {
    match root {
        Some(root) => {
            let path = root.join(file);
            std::fs::read(&path).map(Cow::Owned).map_err(|source| Error::read(&path, source))
        }
        None => match EMBEDDED.binary_search_by_key(&file, |(path, _)| path) {
            Ok(index) => Ok(EMBEDDED[index].1.into()),
            Err(_) => {
                let missing = std::io::Error::new(std::io::ErrorKind::NotFound, "not among the built-in vectors");
                Err(Error::read(Path::new(file), missing))
            }
        },
    }
}

/// Whether a path of the manifest stays in its folder.
fn is_below(file: &str) -> bool {
    !file.is_empty() && file.split('/').all(|part| !matches!(part, "" | "." | "..") && !part.contains(['\\', ':']))
}
