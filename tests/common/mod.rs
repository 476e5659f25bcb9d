//! Shared by several contracts: scenes, committed vectors.
#![allow(dead_code)]

pub(crate) mod plain;
pub(crate) mod scenes;
pub(crate) mod vectors;
