//! **trgs-oracle** checks values, gradients and optimiser steps of any implementation.
//!
//! Not in the paper. The truth in `reference/vectors` was computed from the equations with 50 digits, independently of
//! this program (`reference/generate`). The oracle exports the vectors and checks answers. Only files are exchanged:
//!
//! ```text
//! manifest ──► question ──► backend ──► answers ──► check ──► report
//!                 │                        ▲          │
//!                 └── answers (this one's) ┘      difference, tolerances, waivers; diagnosis of what failed
//! ```
//!
//! | module | content |
//! |---|---|
//! | [`manifest`] | cases, levels, files with digests; built into the program |
//! | [`question`] | a case with its inputs read |
//! | [`answers`] | this program's answers, in f32 and f64 |
//! | [`format`](mod@format) | f64, f32, f16, bf16, tf32, f16+f32: units in the last place |
//! | [`difference`] | the norms of an error |
//! | `condition` | the error of each element that rounding causes |
//! | `place` | the rows, views, primitives or tiles that are wrong |
//! | [`limits`] | `reference/tolerances.toml` |
//! | [`waivers`] | failures that are accepted until a date |
//! | [`check`](mod@check) | the comparison |
//! | [`diagnosis`] | the mistake that explains an error |
//! | [`compare`](mod@compare) | the comparison of two files outside the vectors |
//! | [`fresh`] | questions that are generated, and their truth |
//! | [`hunt`] | failures of a backend, found and shrunk |
//! | [`iteration`] | one iteration of a run, with every intermediate array |
//! | [`recycling`] | adding and recycling after an iteration |
//! | [`run`] | iterations in a row |
//! | [`report`] | Markdown, JSON, JUnit |

#![forbid(unsafe_code)]

#[cfg(test)]
#[macro_use]
#[path = "../../tests/common/tolerances.rs"]
mod tolerances;

pub mod answers;
pub mod check;
pub mod compare;
mod condition;
pub mod diagnosis;
pub mod difference;
pub mod format;
pub mod fresh;
pub mod hunt;
pub mod iteration;
pub mod limits;
pub mod manifest;
mod networks;
mod outputs;
mod place;
pub mod plain;
mod population;
pub mod question;
pub mod recycling;
pub mod report;
pub mod run;
pub mod waivers;

pub use check::{Options, Report, Status, check};
pub use difference::Difference;
pub use format::Format;
pub use limits::Tolerances;
pub use manifest::{Case, Level, Vectors};
pub use outputs::Outputs;

/// The stages of traced trainings, which have no cases among the vectors.
pub const TRACED: [&str; 3] = [iteration::STAGE, recycling::STAGE, run::STAGE];

/// For the training that is traced.
#[doc(hidden)]
pub mod internals {
    pub use crate::outputs::{one, parameters};
}
pub use question::Question;
