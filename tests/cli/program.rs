//! Runs `trgs` in a temporary folder.
#![allow(dead_code)]

use assert_cmd::Command;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

/// A working directory that is deleted with its content, and the program to run in it.
pub(crate) struct Sandbox(tempfile::TempDir, PathBuf);

impl Sandbox {
    pub(crate) fn new() -> Self {
        Self::of(env!("CARGO_BIN_EXE_trgs").into())
    }

    /// A sandbox for another build of the program.
    pub(crate) fn of(program: PathBuf) -> Self {
        Self(tempfile::tempdir().unwrap(), program)
    }

    /// A sandbox with the dataset `scan`: 12³ voxels, 4 training and 3 test views of 14 × 15 pixels.
    pub(crate) fn with_scan() -> Self {
        let sandbox = Self::new();
        sandbox.done(
            "simulate --phantom torso --out scan --size 12 --detector 14,15 --views 4 --test-views 3 --noise low",
        );
        sandbox
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The program with arguments separated by spaces.
    pub(crate) fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(&self.1);
        command.args(arguments.split_whitespace()).current_dir(self.0.path());
        command
    }

    /// Runs a command to its end, whatever the exit code.
    pub(crate) fn run(&self, arguments: &str) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Runs a command that must succeed; returns its result.
    pub(crate) fn done(&self, arguments: &str) -> Value {
        let output = self.run(&format!("{arguments} --json"));
        assert_eq!(output.status.code(), Some(0), "{arguments}: {}", stderr(&output));
        let text = String::from_utf8(output.stdout).unwrap();
        assert_eq!(text.lines().count(), 1, "{arguments}: {text}");
        serde_json::from_str(&text).unwrap()
    }

    /// Runs a command that must reject its input; returns the error line.
    ///
    /// The exit code is 2, standard error has one line, standard output is empty, and no file is changed or added.
    pub(crate) fn refused(&self, arguments: &str) -> String {
        self.refuses(arguments, self.command(arguments))
    }

    /// [`Self::refused`] for a prepared command; `name` is used in messages.
    pub(crate) fn refuses(&self, name: &str, mut command: Command) -> String {
        let before = self.content();
        let output = command.output().unwrap();
        let message = stderr(&output);
        // A run that rejects its input late has announced its memory before.
        let message = match message.split_once('\n') {
            Some((first, rest)) if first.starts_with("memory: at most ") => rest.to_owned(),
            _ => message,
        };
        assert_eq!(output.status.code(), Some(2), "{name}: {message}");
        assert!(message.starts_with("error: ") && message.lines().count() == 1, "{name}: {message}");
        assert!(output.stdout.is_empty(), "{name}");
        let (before, after): (Vec<_>, Vec<_>) = (before.into_iter().collect(), self.content().into_iter().collect());
        assert!(before == after, "{name}: files changed; there are {:?}", self.names());
        message
    }

    /// All files below the folder, including hidden files and empty folders.
    pub(crate) fn content(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut content = BTreeMap::new();
        collect(self.0.path(), &mut content);
        content
    }

    /// Names of the files directly in the folder.
    pub(crate) fn names(&self) -> Vec<String> {
        self.names_in("")
    }

    /// Names of the files directly in a folder, sorted.
    pub(crate) fn names_in(&self, folder: &str) -> Vec<String> {
        let entries = fs::read_dir(self.path(folder)).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    pub(crate) fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub(crate) fn text(&self, name: &str) -> String {
        String::from_utf8(self.read(name)).unwrap()
    }

    pub(crate) fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(name), content).unwrap();
    }

    /// Edits a JSON file.
    pub(crate) fn edit(&self, name: &str, change: impl FnOnce(&mut Value)) {
        let mut value = serde_json::from_slice(&self.read(name)).unwrap();
        change(&mut value);
        self.write(name, value.to_string());
    }
}

/// Whether a signal was ignored when the tests began, as in the background of a script: programs started by them ignore it.
pub(crate) fn is_ignored(signal: u32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    mask(&status, "SigIgn:").is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// A set of signals in the status of a process.
pub(crate) fn mask(status: &str, name: &str) -> Option<u64> {
    let mask = status.lines().find_map(|line| line.strip_prefix(name))?;
    u64::from_str_radix(mask.trim(), 16).ok()
}

/// The option of `kill` for Ctrl-C, or where that is ignored for the termination signal.
pub(crate) fn interrupt() -> &'static str {
    if is_ignored(2) { "-TERM" } else { "-INT" }
}

pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn collect(folder: &Path, content: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            content.insert(path.clone(), Vec::new());
            collect(&path, content);
        } else {
            content.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
}
