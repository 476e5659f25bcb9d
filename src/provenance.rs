//! The origin of a result: program, platform, command, seeds, SHA-256 digests of inputs and outputs.
//!
//! The same inputs, seeds and version give the same digests on every machine and with every number of threads. The
//! record therefore holds no time and no machine name.

use crate::words::quoted;
use bytesize::ByteSize;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

pub use crate::scan::digest::{digest_bytes, digest_file};

/// The content of `provenance.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of trgs.
    pub version: String,
    /// Git commit that the program was built from, with a hash of what was changed since; `None` without git.
    pub commit: Option<String>,
    /// Architecture, operating system and C library that the program was built for.
    pub target: String,
    /// Instruction sets that the program was built for, beyond the baseline. No result depends on them.
    pub target_features: Vec<String>,
    /// Whether debug assertions were compiled in.
    pub debug_assertions: bool,
    /// Worker threads. No result depends on them.
    pub threads: usize,
    /// Upper bound on memory estimated for the run, bytes; `None` without an estimate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<u64>,
    /// Attenuation per scene unit that counted as density 1 in the run; `None` if its method has no unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density_unit: Option<f64>,
    /// Iterations after which the run was continued to another number of iterations than it had before.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub continued: Vec<usize>,
    /// The command line, program name first.
    pub command: Vec<String>,
    /// Every seed by its purpose.
    pub seeds: BTreeMap<String, u64>,
    /// SHA-256 of every file that was read, keyed by path.
    pub inputs: BTreeMap<String, String>,
    /// SHA-256 of every file that was written, keyed by path, and of arrays, keyed by name.
    pub outputs: BTreeMap<String, String>,
}

impl Provenance {
    /// The record at the start of a run; seeds and digests are added later.
    pub fn new(threads: usize, command: impl IntoIterator<Item = String>) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            commit: commit().map(Into::into),
            target: target(),
            target_features: target_features(),
            debug_assertions: cfg!(debug_assertions),
            threads,
            memory: None,
            density_unit: None,
            continued: Vec::new(),
            command: command.into_iter().collect(),
            seeds: BTreeMap::new(),
            inputs: BTreeMap::new(),
            outputs: BTreeMap::new(),
        }
    }

    /// Everything but the digests, as (label, value) pairs for display.
    pub fn facts(&self) -> Vec<(String, String)> {
        let seeds: Vec<String> = self.seeds.iter().map(|(purpose, seed)| format!("{purpose} {seed}")).collect();
        let facts = [
            ("version", format!("trgs {}", self.version)),
            ("commit", self.commit.clone().unwrap_or_else(|| "not recorded".into())),
            ("command", self.command_line()),
            ("built for", format!("{}, {}", self.target, self.target_features.join(" "))),
            ("threads", self.threads.to_string()),
            ("memory, estimated", self.memory.map_or(String::new(), |bytes| ByteSize(bytes).to_string())),
            ("unit of density", self.density_unit.map_or(String::new(), |unit| unit.to_string())),
            ("continued after iteration", join(&self.continued)),
            ("seeds", seeds.join(", ")),
        ];
        facts.into_iter().filter(|(_, value)| !value.is_empty()).map(|(label, value)| (label.into(), value)).collect()
    }
}

impl Provenance {
    /// The command as a line for a shell.
    pub fn command_line(&self) -> String {
        self.command.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ")
    }

    /// Names of the outputs that are not in the folder as they were written.
    ///
    /// The record may name any path, so only regular files below the folder are read.
    pub fn changed(&self, folder: &Path) -> Vec<&str> {
        let is_same = |name: &str, digest: &str| {
            let (folder, file) = (folder.canonicalize().ok()?, folder.join(name).canonicalize().ok()?);
            Some(file.starts_with(folder) && digest_file(&file).ok()? == digest)
        };
        let changed = self.outputs.iter().filter(|(name, digest)| is_same(name, digest) != Some(true));
        changed.map(|(name, _)| name.as_str()).collect()
    }
}

fn join(numbers: &[usize]) -> String {
    numbers.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")
}

/// The commit this program was built from, if the build was given it.
pub fn commit() -> Option<&'static str> {
    option_env!("TRGS_COMMIT")
}

fn target() -> String {
    let library = if cfg!(target_env = "musl") {
        "-musl"
    } else if cfg!(target_env = "gnu") {
        "-gnu"
    } else {
        ""
    };
    format!("{}-{}{library}", std::env::consts::ARCH, std::env::consts::OS)
}

fn target_features() -> Vec<String> {
    macro_rules! compiled_in {
        ($($name:literal),*) => { [$(($name, cfg!(target_feature = $name))),*] };
    }
    let known = compiled_in!(
        "sse4.2", "avx", "avx2", "fma", "avx512f", "avx512bw", "avx512dq", "avx512vl", "neon", "sve", "simd128"
    );
    known.into_iter().filter(|(_, present)| *present).map(|(name, _)| name.into()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_reads_back_as_it_was_written() {
        let mut provenance = Provenance::new(2, ["trgs".into(), "demo".into()]);
        provenance.seeds.insert("training".into(), 7);
        provenance.inputs.insert("scan/meta_data.json".into(), digest_bytes(b"abc"));
        let json = serde_json::to_string_pretty(&provenance).unwrap();
        assert_eq!(serde_json::from_str::<Provenance>(&json).unwrap(), provenance);
    }
}
