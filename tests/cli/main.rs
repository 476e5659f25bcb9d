//! The contracts of the program, one module each.

#[macro_use]
#[path = "../common/tolerances.rs"]
mod tolerances;
#[path = "../common/mod.rs"]
mod common;
mod program;

// Errors for bad input.
mod bad_input;
// Commands, files, messages and exit codes.
mod commands;
// `trgs confidence`.
mod confidence_cli;
// Same input, same bits.
mod determinism;
// Tables at toy size.
mod experiments;
// Files exchanged with other programs.
mod formats;
// The check of a geometry.
mod geometry_check;
// Scans and volumes in HDF5.
mod hdf5;
// Unit and place, from the first read to the last write.
mod lengths;
// Estimates of memory.
mod memory;
// `trgs oracle` and `trgs compare`.
mod oracle_cli;
// Names of files that are not UTF-8.
#[cfg(target_os = "linux")]
mod names;
// Existing folders and files: what is replaced and what is refused.
mod outputs;
// Scans with poses.
mod poses;
// Frames, volumes and angles in the formats that people have.
mod readers;
// Stopped and resumed runs.
mod resume;
// Settings of the library are flags of the program.
mod settings;
// Stand-ins are named as such.
mod stand_ins;
// Units of density.
mod units;
// Values that cannot be right.
mod values;
// The viewer, and `trgs view`.
mod viewer;
