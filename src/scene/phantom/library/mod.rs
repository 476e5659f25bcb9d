//! The phantoms that have a name.

pub(super) mod artificial;
pub(super) mod basic;
pub(super) mod nature;
pub(super) mod organs;
mod parts;
