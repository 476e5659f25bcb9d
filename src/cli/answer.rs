//! What a command found, for a reader or for a program.

use comfy_table::{ContentArrangement, Table, presets};
use serde::Serialize;
use serde_json::Value;
use std::io::{self, Write};
use std::path::Path;
use trgs::{Error, Result};

/// Numbers that a line of a table can hold.
const LONGEST_LIST: usize = 6;

/// A result in both forms.
pub(super) struct Answer {
    json: Value,
    text: String,
    /// Whether a check, if the command is one, said yes.
    approves: bool,
}

impl Answer {
    /// A result whose table has a line for each of its values.
    pub(super) fn list(result: &impl Serialize) -> Self {
        let json = to_json(result);
        let mut lines = Vec::new();
        flatten("", &json, &mut lines);
        Self { text: table(&[], lines).trim_fmt(), json, approves: true }
    }

    /// A result with a table of its own.
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
        let text = format!("{}\n\n{}", table(&header, rows).trim_fmt(), sentences.join("\n"));
        Self { json: to_json(result), text, approves }
    }

    /// The outcome of a check, with a text of its own.
    #[cfg(feature = "oracle")]
    pub(super) fn verdict(result: &impl Serialize, text: String, approves: bool) -> Self {
        Self { json: to_json(result), text: text.trim_end().to_owned(), approves }
    }

    /// Whether the program may end with exit code 0.
    pub(super) fn approves(&self) -> bool {
        self.approves
    }

    /// Writes the result to standard output. It is no error when a reader like `head` does not want all of it.
    pub(super) fn print(&self, json: bool) -> Result<()> {
        let text = if json { &self.json.to_string() } else { &self.text };
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
    table.add_rows(rows);
    table
}

/// Dotted names and values of all that is there and no object itself. Long lists are for programs.
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
        Value::Array(values) if values.len() > LONGEST_LIST => line(format!("{} values", values.len())),
        value => line(plain(value)),
    }
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), Into::into)
}
