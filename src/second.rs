//! The program for AVX2 and FMA that a program for every x86-64 carries. Vectors have the width that the compiler was told, so
//! it is the same source compiled again, with the same bits.

use rustix::fs::{MemfdFlags, memfd_create};
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::os::unix::process::CommandExt;
use std::process::Command;

static PROGRAM: &[u8] = include_bytes!(env!("TRGS_SECOND"));

/// Becomes the second program where the CPU can run it. `TRGS_MODULE` chooses, as in Python: `baseline` or `v3`.
///
/// # Errors
/// When it chooses another program, or one that the CPU or the system cannot run.
pub(crate) fn start() -> Result<(), String> {
    let refused =
        |got: &str, expected: &str| Err(format!("TRGS_MODULE: got {got}, expected {expected}; unset TRGS_MODULE"));
    let wish = std::env::var_os("TRGS_MODULE").unwrap_or_else(|| "auto".into());
    let wish = wish.to_string_lossy();
    let can = std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma");
    match &*wish {
        "baseline" => Ok(()),
        "auto" | "v3" if can => {
            let error = become_second();
            if wish == "auto" { Ok(()) } else { refused("v3", &format!("a program that the system starts ({error})")) }
        }
        "auto" => Ok(()),
        "v3" => refused("v3", "a program that this CPU can run"),
        other => refused(other, "auto, baseline or v3"),
    }
}

/// Starts the second program in this process, from memory. Returns when the system refuses.
fn become_second() -> io::Error {
    let in_memory = || -> io::Result<File> {
        let mut file = File::from(memfd_create("trgs", MemfdFlags::CLOEXEC)?);
        file.write_all(PROGRAM)?;
        Ok(file)
    };
    let file = match in_memory() {
        Ok(file) => file,
        Err(error) => return error,
    };
    let mut arguments = std::env::args_os();
    let mut second = Command::new(format!("/proc/self/fd/{}", file.as_raw_fd()));
    if let Some(name) = arguments.next() {
        second.arg0(name);
    }
    second.args(arguments).exec()
}
