//! The only user of threads.
//!
//! Work is divided by its size alone, never by the number of workers, and results are in index order. The number of
//! threads therefore cannot change a bit.

use crate::error::{Error, Result};
use crate::setting::Setting;
use rayon::prelude::*;
use rayon::slice::ChunksMut;
use std::fmt;
use std::ops::{Deref, DerefMut};
use std::sync::Mutex;

/// A thread pool; none in WebAssembly, where the calling thread does all work.
pub struct WorkerPool(Option<rayon::ThreadPool>);

impl WorkerPool {
    /// `threads` workers (0: one for each core).
    ///
    /// # Errors
    /// When the operating system refuses to start them.
    pub fn new(threads: usize) -> Result<Self> {
        if cfg!(target_family = "wasm") {
            return Ok(Self(None));
        }
        let built = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        built.map(|pool| Self(Some(pool))).map_err(|source| {
            let got = format!("{threads} ({source})");
            Error::invalid(Setting::Threads, got, "as many as the system can start", "give " + Setting::Threads + " 1")
        })
    }

    /// Runs `work` and all that it maps over on these workers.
    pub fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.0 {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}

/// Runs `work` on a pool of its own.
///
/// # Errors
/// When the operating system refuses to start the threads.
pub fn install<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T> {
    Ok(WorkerPool::new(threads)?.run(work))
}

/// Runs `work(0)` … `work(n-1)` in parallel, each on one thread of its own.
///
/// # Errors
/// When the operating system refuses to start the threads.
pub fn side_by_side(n: usize, work: impl Fn(usize) + Sync) -> Result<()> {
    if n == 1 {
        return install(1, || work(0));
    }
    let pools = (0..n).map(|_| WorkerPool::new(1)).collect::<Result<Vec<_>>>()?;
    std::thread::scope(|scope| {
        for (number, pool) in pools.iter().enumerate() {
            let work = &work;
            scope.spawn(move || pool.run(|| work(number)));
        }
    });
    Ok(())
}

/// The number of cores that the process may use, if the system tells it.
pub fn cores() -> Option<usize> {
    std::thread::available_parallelism().ok().map(Into::into)
}

/// The number of workers that share the current work.
pub fn count() -> usize {
    rayon::current_num_threads()
}

/// `(a(), b())`, in parallel if a worker is free.
pub fn join<A: Send, B: Send>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    rayon::join(a, b)
}

/// `[f(0), f(1), … f(n-1)]`, computed in parallel, in index order.
pub fn map<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    // Here and below: a pointer, so that rayon's part is compiled once for all functions.
    let f: &(dyn Fn(usize) -> T + Sync) = &f;
    (0..n).into_par_iter().with_max_len(1).map(f).collect()
}

/// As [`map`] for small work items: a task processes at least 64 of them.
pub fn map_fine<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    (0..n).into_par_iter().with_min_len(64).map(f).collect()
}

/// Calls `f(index, chunk)` for consecutive chunks of `length` elements (the last may be shorter).
pub fn for_each_chunk<T: Send>(values: &mut [T], length: usize, f: impl Fn(usize, &mut [T]) + Sync + Send) {
    let f: &(dyn Fn(usize, &mut [T]) + Sync) = &f;
    values.par_chunks_mut(length).with_max_len(1).enumerate().for_each(|(index, chunk)| f(index, chunk));
}

/// Consecutive chunks of an array (the last may be shorter), for [`for_each_zip`].
pub fn chunks<T: Send>(values: &mut [T], length: usize) -> ChunksMut<'_, T> {
    values.par_chunks_mut(length)
}

/// Calls `f(index, (chunk, chunk, …))` for a tuple of [`chunks`], up to the end of the shortest.
pub fn for_each_zip<C: IntoParallelIterator<Iter: IndexedParallelIterator>>(
    chunks: C,
    f: impl Fn(usize, C::Item) + Sync + Send,
) {
    let f: &(dyn Fn(usize, C::Item) + Sync) = &f;
    chunks.into_par_iter().with_max_len(1).enumerate().for_each(|(index, chunks)| f(index, chunks));
}

/// As [`for_each_chunk`], with a scratch buffer from `pool` for each task.
pub fn for_each_chunk_in<T: Send, S: Default + Send>(
    values: &mut [T],
    length: usize,
    pool: &Pool<S>,
    f: impl Fn(usize, &mut [T], &mut S) + Sync + Send,
) {
    for_each_chunk(values, length, |index, chunk| f(index, chunk, &mut pool.take()));
}

/// A pool of scratch buffers. A taken buffer holds arbitrary old data; callers must overwrite it.
///
/// As many buffers are allocated as are in use at the same time.
pub struct Pool<T>(Mutex<Vec<Box<T>>>);

/// A buffer taken from a [`Pool`]. It returns there when dropped.
pub struct PoolGuard<'a, T> {
    buffer: Option<Box<T>>,
    pool: &'a Pool<T>,
}

impl<T> Pool<T> {
    fn with<O>(&self, work: impl FnOnce(&mut Vec<Box<T>>) -> O) -> O {
        work(&mut self.0.lock().expect("nobody panics with it"))
    }
}

impl<T: Default> Pool<T> {
    /// An unused buffer, or a new one.
    pub fn take(&self) -> PoolGuard<'_, T> {
        let unused = self.with(Vec::pop);
        PoolGuard { buffer: Some(unused.unwrap_or_default()), pool: self }
    }
}

impl<T> Default for Pool<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

/// A clone starts with an empty pool.
impl<T> Clone for Pool<T> {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl<T> fmt::Debug for Pool<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Pool").field(&self.with(|buffers| buffers.len())).finish()
    }
}

impl<T> Deref for PoolGuard<'_, T> {
    type Target = T;
    fn deref(&self) -> &T {
        self.buffer.as_ref().expect("present until dropped")
    }
}

impl<T> DerefMut for PoolGuard<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        self.buffer.as_mut().expect("present until dropped")
    }
}

impl<T> Drop for PoolGuard<'_, T> {
    fn drop(&mut self) {
        let buffer = self.buffer.take();
        self.pool.with(|buffers| buffers.extend(buffer));
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
    fn every_chunk_is_worked_on_once_and_no_more_buffers_are_made_than_workers() {
        let (pool, mut values) = (Pool::<Counted>::default(), vec![0; 1003]);
        let work = |index: usize, chunk: &mut [usize], used: &mut Counted| {
            used.0 += 1;
            chunk.iter_mut().for_each(|value| *value += index + 1);
        };
        let workers = WorkerPool::new(3).unwrap();
        for _ in 0..2 {
            workers.run(|| for_each_chunk_in(&mut values, 10, &pool, work));
        }
        assert!(values.iter().enumerate().all(|(i, &value)| value == 2 * (i / 10 + 1)));
        let made = MADE.load(Ordering::Relaxed);
        assert!((1..=3).contains(&made));
        let kept: Vec<_> = (0..made).map(|_| pool.take()).collect();
        assert_eq!((kept.iter().map(|counted| counted.0).sum::<usize>(), MADE.load(Ordering::Relaxed)), (202, made));
    }

    #[test]
    fn chunks_of_several_arrays_go_side_by_side() {
        let (mut a, mut b, mut c) = ([0; 25], [[0; 2]; 25], [0; 25]);
        for_each_zip((chunks(&mut a, 10), chunks(&mut b, 10), chunks(&mut c, 10)), |index, (a, b, c)| {
            a.fill(index);
            b.fill([index; 2]);
            c.fill(a.len());
        });
        for i in 0..25 {
            assert_eq!((a[i], b[i], c[i]), (i / 10, [i / 10; 2], if i < 20 { 10 } else { 5 }));
        }
    }
}
