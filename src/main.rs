//! The program `trgs`: parse, run, answer with an exit code.

#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    trgs::cli::main(std::env::args_os()).into()
}
