//! The only user of threads. Work is cut by sizes alone, never by the size of the pool, and
//! results come back in index order: the number of threads cannot change a bit.

use crate::error::{Error, Result};
use crate::setting::Setting;
use rayon::prelude::*;
use rayon::slice::ChunksMut;
use std::fmt;
use std::ops::{Deref, DerefMut};
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
            Error::invalid(Setting::Threads, got, "as many as the system can start", "ask for fewer threads")
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
    // Here and below: a pointer, so that rayon's part is compiled once for all functions.
    let f: &(dyn Fn(usize) -> T + Sync) = &f;
    (0..n).into_par_iter().with_max_len(1).map(f).collect()
}

/// As [`map`] for work so small that many neighbours belong in one task.
pub fn map_many<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    (0..n).into_par_iter().with_min_len(64).map(f).collect()
}

/// [`map_many`] into memory that is there already; what it held goes.
pub fn map_many_into<T: Send>(values: &mut Vec<T>, n: usize, f: impl Fn(usize) -> T + Sync + Send) {
    (0..n).into_par_iter().with_min_len(64).map(f).collect_into_vec(values);
}

/// Calls `f(index, chunk)` for consecutive chunks of `length` elements (the last may be shorter).
pub fn for_each_chunk<T: Send>(values: &mut [T], length: usize, f: impl Fn(usize, &mut [T]) + Sync + Send) {
    let f: &(dyn Fn(usize, &mut [T]) + Sync) = &f;
    values.par_chunks_mut(length).with_max_len(1).enumerate().for_each(|(index, chunk)| f(index, chunk));
}

/// Consecutive chunks of an array (the last may be shorter), to be gone through beside those of others.
pub fn chunks<T: Send>(values: &mut [T], length: usize) -> ChunksMut<'_, T> {
    values.par_chunks_mut(length)
}

/// Calls `f(index, (chunk, chunk, …))` for a tuple of [`chunks`], as many of each array as there are of the shortest.
pub fn for_each_of<C: IntoParallelIterator<Iter: IndexedParallelIterator>>(
    chunks: C,
    f: impl Fn(usize, C::Item) + Sync + Send,
) {
    let f: &(dyn Fn(usize, C::Item) + Sync) = &f;
    chunks.into_par_iter().with_max_len(1).enumerate().for_each(|(index, chunks)| f(index, chunks));
}

/// As [`for_each_chunk`], with something for a task to work in.
pub fn for_each_chunk_in<T: Send, S: Default + Send>(
    values: &mut [T],
    length: usize,
    spares: &Spares<S>,
    f: impl Fn(usize, &mut [T], &mut S) + Sync + Send,
) {
    for_each_chunk(values, length, |index, chunk| f(index, chunk, &mut spares.lend()));
}

/// Things to work in, kept for the next task, which finds them as another left them: no more are made than are in use at
/// the same time. Nobody knows which one a task gets, so nothing that it held before may matter.
pub struct Spares<T>(Mutex<Vec<Box<T>>>);

/// One of [`Spares`], which it goes back to.
pub struct Lent<'a, T> {
    thing: Option<Box<T>>,
    home: &'a Spares<T>,
}

impl<T> Spares<T> {
    fn with<O>(&self, work: impl FnOnce(&mut Vec<Box<T>>) -> O) -> O {
        work(&mut self.0.lock().expect("nobody panics with it"))
    }
}

impl<T: Default> Spares<T> {
    /// One that nobody uses, a new one if there is none.
    pub fn lend(&self) -> Lent<'_, T> {
        let spare = self.with(Vec::pop);
        Lent { thing: Some(spare.unwrap_or_default()), home: self }
    }
}

impl<T> Default for Spares<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

/// A copy of what uses them finds its own.
impl<T> Clone for Spares<T> {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl<T> fmt::Debug for Spares<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Spares").field(&self.with(|things| things.len())).finish()
    }
}

impl<T> Deref for Lent<'_, T> {
    type Target = T;
    fn deref(&self) -> &T {
        self.thing.as_ref().expect("there until it goes back")
    }
}

impl<T> DerefMut for Lent<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        self.thing.as_mut().expect("there until it goes back")
    }
}

impl<T> Drop for Lent<'_, T> {
    fn drop(&mut self) {
        let thing = self.thing.take();
        self.home.with(|things| things.extend(thing));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    static MADE: AtomicUsize = AtomicUsize::new(0);

    /// How often it was used.
    struct Counted(usize);

    impl Default for Counted {
        fn default() -> Self {
            MADE.fetch_add(1, Ordering::Relaxed);
            Self(0)
        }
    }

    #[test]
    fn every_chunk_is_worked_on_once_and_no_more_spaces_are_made_than_workers() {
        let (spares, mut values) = (Spares::<Counted>::default(), vec![0; 1003]);
        let work = |index: usize, chunk: &mut [usize], used: &mut Counted| {
            used.0 += 1;
            chunk.iter_mut().for_each(|value| *value += index + 1);
        };
        let pool = Pool::new(3).unwrap();
        for _ in 0..2 {
            pool.run(|| for_each_chunk_in(&mut values, 10, &spares, work));
        }
        assert!(values.iter().enumerate().all(|(i, &value)| value == 2 * (i / 10 + 1)));
        let made = MADE.load(Ordering::Relaxed);
        assert!((1..=3).contains(&made));
        let kept: Vec<_> = (0..made).map(|_| spares.lend()).collect();
        assert_eq!((kept.iter().map(|counted| counted.0).sum::<usize>(), MADE.load(Ordering::Relaxed)), (202, made));
    }

    #[test]
    fn chunks_of_several_arrays_go_side_by_side() {
        let (mut a, mut b, mut c) = ([0; 25], [[0; 2]; 25], [0; 25]);
        for_each_of((chunks(&mut a, 10), chunks(&mut b, 10), chunks(&mut c, 10)), |index, (a, b, c)| {
            a.fill(index);
            b.fill([index; 2]);
            c.fill(a.len());
        });
        for i in 0..25 {
            assert_eq!((a[i], b[i], c[i]), (i / 10, [i / 10; 2], if i < 20 { 10 } else { 5 }));
        }
    }
}
