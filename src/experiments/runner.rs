//! Runs cells in parallel, each on one thread.

use super::cell::{Cell, picture};
use super::store::Store;
use crate::error::{Error, Result};
use crate::numeric::threads;
use crate::scan::Dataset;
use crate::setting::Text;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Observer: called for each finished cell, and with `None` during runs; `Break` stops all.
pub type Observe<'a> = dyn Fn(Option<&Done<'_>>) -> ControlFlow<()> + Sync + 'a;

/// A finished cell.
#[derive(Clone, Copy, Debug)]
pub struct Done<'a> {
    /// The cell.
    pub cell: &'a Cell,
    /// Number of finished cells, including this one.
    pub done: usize,
    /// Number of all cells.
    pub cells: usize,
}

/// Runs all cells that are not in the store, `workers` at a time.
///
/// Cells that another process is running come last; if that process finishes them, they are not run again.
///
/// # Errors
/// The first error of any cell, or [`Error::Interrupted`] when `observe` breaks. Cells finished before are kept.
pub fn run(cells: &[Cell], store: &Store, workers: usize, observe: &Observe<'_>) -> Result<()> {
    let mut known = BTreeSet::new();
    let cells: Vec<&Cell> = cells.iter().filter(|cell| known.insert(&cell.id)).collect();
    for wait in [false, true] {
        let mut open = Vec::new();
        for cell in &cells {
            match store.find(&cell.id)? {
                None => open.push(*cell),
                Some(_) => store.clear(&cell.id),
            }
        }
        let work = Work { store, observe, cells: cells.len(), done: AtomicUsize::new(cells.len() - open.len()) };
        // Cells of one scan are adjacent: the scan is made once.
        let groups: Vec<&[&Cell]> = open.chunk_by(|a, b| a.scan_id() == b.scan_id()).collect();
        work.all(&groups, workers.clamp(1, groups.len().max(1)), wait)?;
    }
    Ok(())
}

struct Work<'a> {
    store: &'a Store,
    observe: &'a Observe<'a>,
    cells: usize,
    done: AtomicUsize,
}

impl Work<'_> {
    fn all(&self, groups: &[&[&Cell]], workers: usize, wait: bool) -> Result<()> {
        let (next, failure) = (AtomicUsize::new(0), Mutex::new(None));
        threads::side_by_side(workers, |_| {
            while let Some(group) = groups.get(next.fetch_add(1, Ordering::Relaxed)) {
                if let Err(error) = self.group(group, wait) {
                    // The other workers stop after their current cells.
                    next.store(groups.len(), Ordering::Relaxed);
                    failure.lock().expect("nobody panics with it").get_or_insert(error);
                }
            }
        })?;
        failure.into_inner().expect("nobody panics with it").map_or(Ok(()), Err)
    }

    /// Runs the cells of one scan.
    fn group(&self, group: &[&Cell], wait: bool) -> Result<()> {
        let mut dataset: Option<Dataset> = None;
        for cell in group {
            if let Some(_claim) = self.store.claim(&cell.id, wait)? {
                let dataset = match &mut dataset {
                    Some(dataset) => dataset,
                    none => none.insert(self.scan(cell)?),
                };
                let found = cell.run(dataset, self.store.state(&cell.id), &mut || (self.observe)(None));
                let found = found.map_err(say_how_to_go_on)?;
                self.store.keep(cell, &found)?;
            } else if !wait {
                // Another process is running it.
                continue;
            }
            let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
            if (self.observe)(Some(&Done { cell, done, cells: self.cells })).is_break() {
                return Err(say_how_to_go_on(Error::Interrupted { step: 0, remedy: Text::default() }));
            }
        }
        Ok(())
    }

    fn scan(&self, cell: &Cell) -> Result<Dataset> {
        let dataset = cell.scan()?;
        if let Some(truth) = &dataset.truth {
            self.store.keep_truth(cell, &picture(truth))?;
        }
        Ok(dataset)
    }
}

fn say_how_to_go_on(error: Error) -> Error {
    match error {
        Error::Interrupted { step, .. } => Error::Interrupted {
            step,
            remedy: "run the same command again: it continues with the remaining cells".into(),
        },
        other => other,
    }
}
