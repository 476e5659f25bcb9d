//! The only user of threads. Work is cut by sizes alone, never by the size of the pool, and
//! results come back in index order: the number of threads cannot change a bit.

use crate::error::{Error, Result};
use rayon::prelude::*;
use std::sync::Mutex;

/// A number of workers, kept for several pieces of work.
pub struct Pool(rayon::ThreadPool);

impl Pool {
    /// `threads` workers (0: one for each core).
    ///
    /// # Errors
    /// When the operating system refuses to start them.
    pub fn new(threads: usize) -> Result<Self> {
        let built = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        built.map(Self).map_err(|source| {
            let got = format!("{threads} ({source})");
            Error::invalid("--threads", got, "as many as the system can start", "ask for fewer threads")
        })
    }

    /// Runs `work` and all that it maps over on these workers.
    pub fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.0.install(work)
    }
}

/// Runs `work` on a pool of its own.
///
/// # Errors
/// When the operating system refuses to start the threads.
pub fn install<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T> {
    Ok(Pool::new(threads)?.run(work))
}

/// Runs `work(0)` … `work(n-1)` at the same time, each on a single worker of its own: `n` pieces of work that are not
/// divided further.
///
/// # Errors
/// When the operating system refuses to start the threads.
pub fn side_by_side(n: usize, work: impl Fn(usize) + Sync) -> Result<()> {
    let pools = (0..n).map(|_| Pool::new(1)).collect::<Result<Vec<_>>>()?;
    std::thread::scope(|scope| {
        for (number, pool) in pools.iter().enumerate() {
            let work = &work;
            scope.spawn(move || pool.run(|| work(number)));
        }
    });
    Ok(())
}

/// The number of workers that share the current work.
pub fn count() -> usize {
    rayon::current_num_threads()
}

/// `(a(), b())`, at the same time if a worker is free.
pub fn both<A: Send, B: Send>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    rayon::join(a, b)
}

/// `[f(0), f(1), … f(n-1)]`, computed in parallel, in index order.
pub fn map<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    (0..n).into_par_iter().with_max_len(1).map(f).collect()
}

/// As [`map`] for work so small that many neighbours belong in one task.
pub fn map_many<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    (0..n).into_par_iter().with_min_len(64).map(f).collect()
}

/// Calls `f(index, chunk)` for consecutive chunks of `length` elements (the last may be shorter).
pub fn for_each_chunk<T: Send>(values: &mut [T], length: usize, f: impl Fn(usize, &mut [T]) + Sync + Send) {
    values.par_chunks_mut(length).with_max_len(1).enumerate().for_each(|(index, chunk)| f(index, chunk));
}

/// As [`for_each_chunk`], with something for a task to work in, which it finds as another left it: no more are made than
/// work at the same time.
pub fn for_each_chunk_in<T: Send, S: Send>(
    values: &mut [T],
    length: usize,
    make: impl Fn() -> S + Sync + Send,
    f: impl Fn(usize, &mut [T], &mut S) + Sync + Send,
) {
    let free = Mutex::new(Vec::new());
    let spare = || free.lock().expect("nobody panics with it");
    for_each_chunk(values, length, |index, chunk| {
        let found = spare().pop();
        let mut space = found.unwrap_or_else(|| Box::new(make()));
        f(index, chunk, &mut space);
        spare().push(space);
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn every_chunk_is_worked_on_once_and_no_more_spaces_are_made_than_workers() {
        let (made, mut values) = (AtomicUsize::new(0), vec![0; 1003]);
        let make = || {
            made.fetch_add(1, Ordering::Relaxed);
            0
        };
        let work = |index: usize, chunk: &mut [usize], used: &mut usize| {
            *used += 1;
            chunk.iter_mut().for_each(|value| *value += index + 1);
        };
        install(3, || for_each_chunk_in(&mut values, 10, make, work)).unwrap();
        assert!(values.iter().enumerate().all(|(i, &value)| value == i / 10 + 1));
        assert!((1..=3).contains(&made.into_inner()));
    }
}
