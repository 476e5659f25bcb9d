//! The oracle: whether a value, a gradient or a step of some implementation is right.
//!
//! Not in the paper. The truth in `reference/vectors` was computed from the equations with 50 digits, independently of
//! this program (`reference/generate`); here it is handed out, and answers are judged. Only files are exchanged:
//!
//! ```text
//! manifest ──► question ──► backend ──► answers ──► check ──► report
//!                 │                        ▲          │
//!                 └── answers (this one's) ┘      difference, tolerances, waivers; diagnosis of what failed
//! ```
//!
//! | module | what it holds |
//! |---|---|
//! | [`manifest`] | cases, levels, files with digests; built into the program |
//! | [`question`] | a case with its inputs read |
//! | [`answers`] | what this program answers, in f32 and f64 |
//! | [`format`](mod@format) | f64, f32, f16, bf16: units in the last place |
//! | [`difference`] | the norms of an error |
//! | [`tolerances`] | `reference/tolerances.toml` |
//! | [`waivers`] | failures that are excused until a day |
//! | [`check`](mod@check) | the comparison |
//! | [`diagnosis`] | which mistake an error looks like |
//! | [`compare`](mod@compare) | the same for two files that belong to no case |
//! | [`report`] | Markdown, JSON, JUnit |

pub mod answers;
pub mod check;
pub mod compare;
pub mod diagnosis;
pub mod difference;
pub mod format;
pub mod manifest;
mod outputs;
mod population;
pub mod question;
pub mod report;
pub mod tolerances;
pub mod waivers;

pub use check::{Options, Report, Status, check};
pub use difference::Difference;
pub use format::Format;
pub use manifest::{Case, Level, Vectors};
pub use outputs::Outputs;
pub use question::Question;
pub use tolerances::Tolerances;
