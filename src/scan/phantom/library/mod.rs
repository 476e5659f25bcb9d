//! The named phantoms.

pub(super) mod artificial;
pub(super) mod basic;
pub(super) mod nature;
pub(super) mod organs;
pub(super) mod parts;
