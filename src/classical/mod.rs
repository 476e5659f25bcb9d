//! Classical reconstruction on the same scanner.
