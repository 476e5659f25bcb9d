//! From the settings that the library names to the flags of the program.

use trgs::{Config, Setting};

/// The text of an error with flags for settings: `` `max_memory` `` becomes `--max-memory`, and an assignment to a key of the
/// configuration, `` `seed=1` ``, becomes `--set seed=1`.
pub(super) fn with_flags(text: &str) -> String {
    let (mut shown, mut rest) = (String::new(), text);
    while let Some((before, after)) = rest.split_once('`') {
        shown += before;
        let quoted = after.split_once('`').and_then(|(name, after)| Some((flag(name)?, after)));
        // A backtick of anything else stays.
        let (word, after) = quoted.unwrap_or_else(|| ("`".into(), after));
        shown += &word;
        rest = after;
    }
    shown + rest
}

/// The flag of a setting has its name; `tests/cli/settings.rs` checks that there is one.
fn flag(name: &str) -> Option<String> {
    if Setting::ALL.iter().any(|setting| setting.name() == name) {
        return Some(format!("--{}", name.replace('_', "-")));
    }
    (name.contains('=') && Config::default().set(name).is_ok()).then(|| format!("--set {name}"))
}
