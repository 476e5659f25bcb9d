//! From the settings that the library names to the flags of the program.

use trgs::Text;

/// A sentence of the library with flags for settings: `--max-memory`, and `--set seed=1` for an assignment to a key.
///
/// The flag of a setting has its name; `tests/cli/settings.rs` checks that there is one.
pub(super) fn with_flags(text: &Text) -> String {
    text.shown(|setting| format!("--{}", setting.name().replace('_', "-")), |assignment| format!("--set {assignment}"))
}
