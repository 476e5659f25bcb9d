//! The named phantoms.

pub(super) mod artificial;
pub(super) mod basic;
pub(super) mod nature;
pub(super) mod organs;
mod parts;
