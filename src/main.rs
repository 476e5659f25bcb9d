//! The program `trgs`: parse, run, answer with an exit code.

#![forbid(unsafe_code)]

#[cfg(carries_second)]
mod second;

fn main() -> std::process::ExitCode {
    #[cfg(carries_second)]
    if let Err(error) = second::start() {
        eprintln!("error: {error}");
        return 2.into();
    }
    trgs::cli::main(std::env::args_os()).into()
}
