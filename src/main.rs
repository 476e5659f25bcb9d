//! The program `trgs`.

fn main() {}
