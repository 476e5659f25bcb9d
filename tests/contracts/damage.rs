//! Damaged files for readers: mutations of valid files with critical tokens, and plain noise.
//!
//! Proptest generates them with a fixed seed.

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::{Config as Settings, RngAlgorithm, TestRng, TestRunner};
use std::cell::Cell;
use std::fmt::{Debug, Display};
use std::path::Path;

/// Damaged files per format. All formats together take 35 seconds of one core at low optimisation.
pub(crate) const MANY: u32 = 100_000;
/// Largest memory that a reader may hold at any time for a file of a kilobyte or two.
pub(crate) const MOST_MEMORY: u64 = 64 << 20;
/// Longest message that is still readable as one line.
const LONGEST_MESSAGE: usize = 1500;

/// Runs `check` on values drawn with a fixed seed; a failure message holds the smallest failing value.
pub(crate) fn for_all<S: Strategy>(cases: u32, strategy: &S, check: impl Fn(S::Value)) {
    let settings = Settings { cases, failure_persistence: None, max_shrink_iters: 200, ..Settings::default() };
    let mut runner = TestRunner::new_with_rng(settings, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let outcome = runner.run(strategy, |value| {
        check(value);
        Ok(())
    });
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
}

/// Asserts that an error is one line that names `names`; returns whether the result is a value.
pub(crate) fn assert_clear<T>(result: Result<T, impl Display>, names: &str) -> bool {
    let Err(error) = result else { return true };
    let message = error.to_string();
    assert!(!message.contains(['\n', '\r', '\0']), "more than a line: {message:?}");
    assert!(message.len() <= LONGEST_MESSAGE, "{} bytes: {message}", message.len());
    assert!(message.contains(names), "{names} is not in: {message}");
    false
}

/// One change of a file.
#[derive(Clone, Debug)]
enum Mutation {
    Set(prop::sample::Index, u8),
    Flip(prop::sample::Index, u8),
    Cut(prop::sample::Index),
    Remove(prop::sample::Index, usize),
    Insert(prop::sample::Index, Vec<u8>),
    /// Replaces the bytes that look like a number, at or after a position.
    Number(prop::sample::Index, &'static str),
    /// Replaces a number of bytes by a binary number, little- or big-endian.
    Binary(prop::sample::Index, usize, u64, bool),
    /// Copies a number of bytes from one position to another.
    Copy(prop::sample::Index, prop::sample::Index, usize),
}

impl Mutation {
    fn apply(&self, bytes: &mut Vec<u8>) {
        let at = |index: &prop::sample::Index| if bytes.is_empty() { 0 } else { index.index(bytes.len()) };
        match self {
            Self::Set(index, value) => {
                let at = at(index);
                bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = *value);
            }
            Self::Flip(index, bit) => {
                let at = at(index);
                bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << bit);
            }
            Self::Cut(index) => bytes.truncate(at(index)),
            Self::Remove(index, count) => {
                let start = at(index);
                bytes.drain(start..(start + count).min(bytes.len()));
            }
            Self::Insert(index, new) => {
                let at = at(index);
                bytes.splice(at..at, new.iter().copied());
            }
            Self::Binary(index, size, value, big) => {
                let at = at(index);
                let mut number = value.to_le_bytes()[..*size].to_vec();
                if *big {
                    number.reverse();
                }
                bytes.iter_mut().skip(at).zip(number).for_each(|(byte, new)| *byte = new);
            }
            Self::Copy(from, to, count) => {
                let (from, to) = (at(from), at(to));
                let moved: Vec<u8> = bytes.iter().skip(from).take(*count).copied().collect();
                bytes.iter_mut().skip(to).zip(moved).for_each(|(byte, new)| *byte = new);
            }
            Self::Number(index, text) => {
                let at = at(index);
                let numeric = |byte: &u8| byte.is_ascii_digit() || *byte == b'.';
                if let Some(start) = bytes[at..].iter().position(numeric).map(|i| at + i) {
                    let end = bytes[start..].iter().position(|b| !numeric(b)).map_or(bytes.len(), |i| start + i);
                    bytes.splice(start..end, text.bytes());
                }
            }
        }
    }
}

const NUMBERS: [&str; 16] = [
    "0",
    "1",
    "-1",
    "2.5",
    "65536",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "1e999",
    "1e-999",
    "NaN",
    "inf",
    "null",
    "\"text\"",
    "[]",
    "99999999999999999999999999999999",
];

const BINARY: [u64; 10] = [0, 1, 2, 0x7f, 0xffff, 0x8000, 0x7fff_ffff, 0xffff_ffff, 0x1000_0000, 0xffff_ffff_ffff_fff0];

fn mutation() -> impl Strategy<Value = Mutation> {
    let index = any::<prop::sample::Index>;
    prop_oneof![
        (index(), any::<u8>()).prop_map(|(i, value)| Mutation::Set(i, value)),
        (index(), 0..8_u8).prop_map(|(i, bit)| Mutation::Flip(i, bit)),
        index().prop_map(Mutation::Cut),
        (index(), 1..40_usize).prop_map(|(i, count)| Mutation::Remove(i, count)),
        (index(), vec(any::<u8>(), 1..20)).prop_map(|(i, new)| Mutation::Insert(i, new)),
        (index(), prop::sample::select(&["((((((((", "]", "{\"a\":", "\u{feff}", "L", "'descr': '<c16'", ", , ,"][..]))
            .prop_map(|(i, new)| Mutation::Insert(i, new.into())),
        (index(), prop::sample::select(&NUMBERS[..])).prop_map(|(i, text)| Mutation::Number(i, text)),
        (index(), prop::sample::select(&NUMBERS[..])).prop_map(|(i, text)| Mutation::Number(i, text)),
        (index(), prop::sample::select(&[2_usize, 4, 8][..]), prop::sample::select(&BINARY[..]), any::<bool>())
            .prop_map(|(i, size, value, big)| Mutation::Binary(i, size, value, big)),
        (index(), index(), 1..20_usize).prop_map(|(from, to, count)| Mutation::Copy(from, to, count)),
    ]
}

/// Valid bytes with one to four changes, or noise with or without the expected first bytes.
pub(crate) fn damaged(valid: Vec<u8>) -> impl Strategy<Value = Vec<u8>> {
    let head = valid[..valid.len().min(8)].to_vec();
    prop_oneof![
        8 => (Just(valid), vec(mutation(), 1..5)).prop_map(|(mut bytes, mutations)| {
            mutations.iter().for_each(|mutation| mutation.apply(&mut bytes));
            bytes
        }),
        1 => vec(any::<u8>(), 0..200),
        1 => vec(any::<u8>(), 0..200).prop_map(move |tail| [&head[..], &tail].concat()),
    ]
}

/// Passes damaged versions of a file's content to a reader.
///
/// The reader must accept some, reject some, and use little memory.
pub(crate) fn assert_reader_survives<T: Debug, E: Debug + Display>(
    name: &str,
    cases: u32,
    valid: &[u8],
    read: impl Fn(&[u8], &Path) -> Result<T, E>,
) {
    let path = Path::new(name);
    read(valid, path).unwrap();
    let (taken, refused, most) = (Cell::new(0), Cell::new(0), Cell::new(0));
    for_all(cases, &damaged(valid.to_vec()), |bytes| {
        let mut is_taken = false;
        let memory = allocation_counter::measure(|| is_taken = assert_clear(read(&bytes, path), name)).bytes_max;
        assert!(memory <= MOST_MEMORY, "{memory} bytes of memory for a file of {}", bytes.len());
        most.set(most.get().max(memory));
        let count = if is_taken { &taken } else { &refused };
        count.set(count.get() + 1);
    });
    let (taken, refused, most) = (taken.get(), refused.get(), most.get());
    eprintln!("{name}: {taken} taken, {refused} refused, at most {most} bytes of memory");
    assert!(
        refused > cases / 10 && taken > 0,
        "{name}: {refused} refused, {taken} taken: the damage is not what it should be"
    );
}
