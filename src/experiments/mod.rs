//! The paper's tables, one command each: cells that run once on any machine, and their summary.
//!
//! A [`Table`] is data: rows, numbers of views, levels of noise (`src/experiments/tables/*.toml`, `reference/experiments/*.toml`,
//! or a file of the user). Each combination
//! with a case and a seed is a [`Cell`], whose id follows from configuration, data and program. [`run`] runs the cells
//! that are not in the [`Store`] yet; a [`Summary`] compares the results with the paper's figures
//! (`reference/paper/*.csv`).
//!
//! ```text
//! Table × Case × Scale × seeds ── cells ──▶ run ──▶ Store ──▶ Summary ──▶ CSV, Markdown, LaTeX, HTML
//! ```

mod case;
mod cell;
mod conditions;
mod page;
#[cfg(feature = "plots")]
mod plot;
mod predictions;
mod runner;
mod scale;
mod store;
mod summary;
mod table;
mod text;

pub use case::Case;
pub use cell::{Cell, Finding};
pub use conditions::{Conditions, Damage, Rays};
pub use predictions::{Judged, Prediction, Predictions};
pub use runner::{Done, Observe, run};
pub use scale::{Matching, Scale};
pub use store::Store;
pub use summary::{Agreement, Block, Estimate, Figure, Summary};
pub use table::{Basis, NAMES, Table, TableRow};

/// All metrics of a cell; `unfinished` is PSNR_3D before the finish on voxels, `primitives` their number at the end.
pub const METRICS: [&str; 7] = ["spearman", "unfinished", "psnr_3d", "ssim_3d", "psnr_2d", "ssim_2d", "primitives"];
