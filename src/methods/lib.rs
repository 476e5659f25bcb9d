//! **trgs-methods**: reconstruction from projections without primitives, and how good a volume is. None of it is in the paper,
//! which compares with these methods and judges with these metrics.
//!
//! | module | content |
//! |---|---|
//! | [`classical`] | the projector of voxels and its adjoint; FDK, SART, OS-SART, ASD-POCS, CGLS, total variation |
//! | [`classical::geometry_check`] | whether the stated geometry of a scan is that of its views |
//! | [`neural`] | NAF, SAX-NeRF, IntraTomo |
//! | [`evaluation`] | metrics, each with the id of its definition |

#![forbid(unsafe_code)]

#[cfg(test)]
#[macro_use]
#[path = "../../tests/common/tolerances.rs"]
mod tolerances;

pub mod classical;
pub mod evaluation;
mod in_precision;
pub mod memory;
pub mod neural;

/// For the package `trgs`, no part of the interface.
#[doc(hidden)]
pub mod internals {
    pub use crate::classical::algebraic::held_out::{FinishSearch, pilot_folds};
    pub use crate::classical::density_unit::in_unit;
    pub use crate::in_precision::{Iterative, begin, choose_finish, choose_passes, choose_weight, first_steps};
}
