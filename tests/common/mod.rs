//! Shared by several contracts: scenes, committed vectors, tolerances.
#![allow(dead_code)]

pub(crate) mod plain;
pub(crate) mod precision;
pub(crate) mod scenes;
pub(crate) mod vectors;
