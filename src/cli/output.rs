//! The result of a command, for readers and for programs.

use super::messages::plain_json;
use comfy_table::{ContentArrangement, Table, presets};
use serde::Serialize;
use serde_json::Value;
use std::io::{self, Write};
use std::path::Path;
use trgs::words::visible;
use trgs::{Error, Result};

/// Largest number of list elements in a line of a table.
const LONGEST_LIST: usize = 6;

/// A result in both forms.
pub(super) struct Output {
    json: Value,
    text: String,
    /// Whether the check passed; true for commands that check nothing.
    approves: bool,
}

impl Output {
    /// A result whose table has one line per value.
    pub(super) fn list(result: &impl Serialize) -> Self {
        let json = to_json(result);
        let mut lines = Vec::new();
        flatten("", &json, &mut lines);
        Self { text: table(&[], lines).trim_fmt(), json, approves: true }
    }

    /// A result with its own table.
    pub(super) fn table<const N: usize>(
        result: &impl Serialize,
        header: [&str; N],
        rows: impl IntoIterator<Item = [String; N]>,
    ) -> Self {
        Self { json: to_json(result), text: table(&header, rows).trim_fmt(), approves: true }
    }

    /// The outcome of a check: a table, and sentences below it.
    pub(super) fn judged_table<const N: usize>(
        result: &impl Serialize,
        header: [&str; N],
        rows: impl IntoIterator<Item = [String; N]>,
        sentences: &[String],
        approves: bool,
    ) -> Self {
        let sentences: Vec<_> = sentences.iter().map(visible).collect();
        let text = format!("{}\n\n{}", table(&header, rows).trim_fmt(), sentences.join("\n"));
        Self { json: to_json(result), text, approves }
    }

    /// The outcome of a check: sentences, and the table that they rest on below them.
    pub(super) fn judgement<const N: usize>(
        result: &impl Serialize,
        sentences: &[String],
        header: [&str; N],
        rows: impl IntoIterator<Item = [String; N]>,
        approves: bool,
    ) -> Self {
        let text = format!("{}\n\n{}", sentences.join("\n"), table(&header, rows).trim_fmt());
        Self { json: to_json(result), text, approves }
    }

    /// The outcome of a check, with its own text.
    #[cfg(feature = "oracle")]
    pub(super) fn verdict(result: &impl Serialize, text: String, approves: bool) -> Self {
        let lines: Vec<_> = text.trim_end().lines().map(visible).collect();
        Self { json: to_json(result), text: lines.join("\n"), approves }
    }

    /// Whether the exit code is 0.
    pub(super) fn approves(&self) -> bool {
        self.approves
    }

    /// Writes the result to standard output. A reader that closes it early, such as `head`, is no error.
    pub(super) fn print(&self, json: bool) -> Result<()> {
        let text = if json { &plain_json(&self.json.to_string()) } else { &self.text };
        let mut output = io::stdout().lock();
        match writeln!(output, "{text}").and_then(|()| output.flush()) {
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                Err(Error::write(Path::new("standard output"), error))
            }
            _ => Ok(()),
        }
    }
}

fn to_json(result: &impl Serialize) -> Value {
    serde_json::to_value(result).expect("results have string keys and no foreign serialisers")
}

fn table<const N: usize>(header: &[&str], rows: impl IntoIterator<Item = [String; N]>) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    if !header.is_empty() {
        table.set_header(header);
    }
    // A foreign name must not give the terminal commands, nor begin a line of its own.
    table.add_rows(rows.into_iter().map(|row| row.map(visible)));
    table
}

/// Dotted names and values of everything that is no object. Long lists and lists of objects appear only with `--json`.
fn flatten(name: &str, value: &Value, lines: &mut Vec<[String; 2]>) {
    let mut line = |text: String| lines.push([name.to_owned(), text]);
    match value {
        Value::Null => {}
        Value::Object(entries) => {
            for (key, value) in entries {
                flatten(&if name.is_empty() { key.clone() } else { format!("{name}.{key}") }, value, lines);
            }
        }
        Value::Array(values) if values.is_empty() => line("none".into()),
        Value::Array(values) if values.iter().any(Value::is_string) => values.iter().for_each(|v| line(plain(v))),
        Value::Array(values) if values.len() > LONGEST_LIST || values.iter().any(Value::is_object) => {
            line(format!("{} values", values.len()))
        }
        value => line(plain(value)),
    }
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), Into::into)
}
