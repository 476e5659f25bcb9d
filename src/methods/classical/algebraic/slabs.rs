//! Volumes that are larger than memory: slabs of slices along x, in files without a name.

use super::space::{self, Change, Measure, Name, Part, Space, some, started};
use crate::classical::VoxelProjector;
use std::any::Any;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::View;
use trgs_core::numeric::Real;

/// A volume's worth of numbers in a file that ends with the process. It begins with zeros.
struct Scratch {
    file: File,
    /// Numbers of a slice.
    slice: usize,
}

impl Scratch {
    fn new(folder: &Path, shape: [usize; 3], bytes: usize) -> io::Result<Self> {
        let file = tempfile::tempfile_in(folder)?;
        file.set_len(shape.iter().map(|&n| n as u64).product::<u64>() * bytes as u64)?;
        Ok(Self { file, slice: shape[1] * shape[2] })
    }

    fn at<R: Real>(&mut self, slice: usize) -> io::Result<&mut File> {
        let bytes = slice as u64 * self.slice as u64 * size_of::<R>() as u64;
        self.file.seek(SeekFrom::Start(bytes)).map(|_| &mut self.file)
    }

    fn read<R: Real>(&mut self, slices: Range<usize>, mut values: Vec<R>) -> io::Result<Vec<R>> {
        values.resize(slices.len() * self.slice, R::ZERO);
        let any: &mut dyn Any = &mut values;
        let bytes = if any.is::<Vec<f32>>() {
            bytemuck::cast_slice_mut(any.downcast_mut::<Vec<f32>>().expect(TYPES))
        } else {
            bytemuck::cast_slice_mut(any.downcast_mut::<Vec<f64>>().expect(TYPES))
        };
        self.at::<R>(slices.start)?.read_exact(bytes)?;
        Ok(values)
    }

    /// Writes some of the values.
    #[expect(clippy::ptr_arg, reason = "slices have no type that is known when the program runs")]
    fn write<R: Real>(&mut self, slice: usize, values: &Vec<R>, some: Range<usize>) -> io::Result<()> {
        let values: &dyn Any = values;
        let bytes = match values.downcast_ref::<Vec<f32>>() {
            Some(values) => bytemuck::cast_slice(&values[some]),
            None => bytemuck::cast_slice(&values.downcast_ref::<Vec<f64>>().expect(TYPES)[some]),
        };
        self.at::<R>(slice)?.write_all(bytes)
    }
}

/// What a volume's numbers are.
const TYPES: &str = "single or double";

/// Volumes in slabs, one in memory at a time.
pub(super) struct Slabs<'a, R> {
    projector: &'a VoxelProjector,
    views: Vec<View>,
    parts: Vec<Part<'a>>,
    /// Volumes by name, then the dual, then what becomes of [`STEP`].
    files: Vec<Scratch>,
    /// Memory of slabs that were read before: the system takes longer to give new memory than to read.
    pub(super) spare: Vec<Vec<R>>,
}

/// Places among the files of y and the dual, and of what a step writes beside them, since it reads slices of other slabs.
const STEP: [usize; 4] = [2, 3, 4, 5];
const AFTER: [usize; 4] = [6, 7, 8, 9];

impl<'a, R: Real> Slabs<'a, R> {
    /// Zeros in `count` slabs; the files are in `folder`.
    pub(super) fn new(projector: &'a VoxelProjector, views: Vec<View>, count: usize, folder: &Path) -> Result<Self> {
        let shape = projector.scanner().grid.shape;
        let file = |_| Scratch::new(folder, shape, size_of::<R>());
        let files = (0..=AFTER[3]).map(file).collect::<io::Result<_>>().map_err(failed)?;
        let count = count.clamp(1, shape[0]);
        let part = |k: usize| Part::new(projector, k * shape[0] / count..(k + 1) * shape[0] / count);
        Ok(Self { projector, views, parts: (0..count).map(part).collect::<Result<_>>()?, files, spare: Vec::new() })
    }

    fn read(&mut self, place: usize, slices: Range<usize>) -> Result<Vec<R>> {
        let memory = self.spare.pop().unwrap_or_default();
        self.files[place].read(slices, memory).map_err(failed)
    }

    /// Memory of so many equal values.
    fn equal(&mut self, value: R, count: usize) -> Vec<R> {
        let mut values = self.spare.pop().unwrap_or_default();
        values.clear();
        values.resize(count, value);
        values
    }

    fn keep(&mut self, values: impl IntoIterator<Item = Vec<R>>) {
        self.spare.extend(values.into_iter().filter(|values| values.capacity() > 0));
    }

    fn write(&mut self, place: usize, slice: usize, values: &Vec<R>) -> Result<()> {
        self.files[place].write(slice, values, 0..values.len()).map_err(failed)
    }

    /// Reads, changes and writes every slab of a volume.
    fn each(&mut self, name: Name, mut work: impl FnMut(&Part<'_>, &mut [R])) -> Result<()> {
        for part in self.parts.clone() {
            let mut slab = self.read(name as usize, part.x())?;
            work(&part, &mut slab);
            self.write(name as usize, part.x().start, &slab)?;
            self.keep([slab]);
        }
        Ok(())
    }
}

fn failed(error: io::Error) -> Error {
    let remedy = "free space there, or leave the limit on memory out";
    Error::invalid(
        "files of the slabs",
        error.to_string(),
        "files beside the result that can be written and read",
        remedy,
    )
}

impl<R: Real> Space<R> for Slabs<'_, R> {
    fn views(&self) -> usize {
        self.views.len()
    }

    fn project(&mut self, views: &[usize], name: Option<Name>) -> Result<Vec<R>> {
        let (views, parts, slice) = (some(&self.views, views), self.parts.clone(), self.files[0].slice);
        let mut sums = self.projector.no_sums(&views);
        let (mut slab, mut slices) = (Vec::new(), 0..0);
        for (part, rising) in parts.iter().map(|part| (part, true)).chain(parts.iter().rev().map(|part| (part, false)))
        {
            // The last slab of the first pass is the first one of the second.
            if part.reads(0) != slices {
                slices = part.reads(0);
                self.keep([slab]);
                slab = match name {
                    Some(name) => self.read(name as usize, slices.clone())?,
                    None => self.equal(R::ONE, slices.len() * slice),
                };
            }
            part.project(&views, &slab, rising, &mut sums);
        }
        self.keep([slab]);
        self.projector.scale(&views, &mut sums);
        Ok(sums)
    }

    fn adjoin(&mut self, views: &[usize], images: &[R], name: Name, step: Option<R>) -> Result<()> {
        let views = some(&self.views, views);
        self.each(name, |part, slab| part.adjoin(&views, images, slab, step))
    }

    fn correct(&mut self, views: &[usize], images: [&[R]; 2], relaxation: R, non_negative: bool) -> Result<()> {
        let views = some(&self.views, views);
        self.each(Name::Volume, |part, slab| part.correct(&views, images, slab, relaxation, non_negative))
    }

    fn change(&mut self, change: Change<R>) -> Result<()> {
        let (reads, writes): (&[usize], &[usize]) = match change {
            Change::Fill(name, _) => (&[], &[name as usize]),
            Change::Scale(name, _) => (&[name as usize], &[name as usize]),
            Change::Keep => (&[0], &[1]),
            Change::Extrapolate(_) => (&[0, 1], &[2]),
            Change::Forget => (&[], &STEP[1..]),
        };
        let slice = self.files[0].slice;
        for x in self.parts.iter().map(Part::x).collect::<Vec<_>>() {
            if change == Change::Forget {
                let zeros = self.equal(R::ZERO, x.len() * slice);
                writes.iter().try_for_each(|&place| self.write(place, x.start, &zeros))?;
                self.keep([zeros]);
                continue;
            }
            let mut volumes: [Vec<R>; 3] = Default::default();
            for &place in reads {
                volumes[place] = self.read(place, x.clone())?;
            }
            for &place in writes.iter().filter(|place| !reads.contains(place)) {
                volumes[place] = self.equal(R::ZERO, x.len() * slice);
            }
            space::change(change, volumes.each_mut().map(Vec::as_mut_slice));
            writes.iter().try_for_each(|&place| self.write(place, x.start, &volumes[place]))?;
            self.keep(volumes);
        }
        Ok(())
    }

    fn measure(&mut self, measure: Measure<R>) -> Result<Vec<[f64; 3]>> {
        let mut terms = Vec::new();
        for part in self.parts.clone() {
            let mut volumes: [Vec<R>; 3] = Default::default();
            for &name in measure.reads() {
                volumes[name as usize] = self.read(name as usize, part.reads(0))?;
            }
            terms.extend(part.measure(measure, volumes.each_ref().map(Vec::as_slice)));
            self.keep(volumes);
        }
        Ok(terms)
    }

    fn solve(&mut self, tau: f64, steps: usize) -> Result<()> {
        for part in self.parts.clone() {
            let (read, first) = (part.reads(steps), part.x().start);
            let [y, a, b, c] = STEP.map(|place| self.read(place, read.clone()));
            let (found, own) = part.solve([y?, a?, b?, c?], tau, steps);
            for (values, place) in found.iter().zip(AFTER) {
                self.files[place].write(first, values, own.clone()).map_err(failed)?;
            }
            self.keep(found);
        }
        STEP.into_iter().zip(AFTER).for_each(|(a, b)| self.files.swap(a, b));
        Ok(())
    }

    fn start(&mut self, values: &[f32]) -> Result<()> {
        let slice = self.files[0].slice;
        for x in self.parts.iter().map(Part::x).collect::<Vec<_>>() {
            self.write(0, x.start, &started(&values[x.start * slice..x.end * slice]))?;
        }
        Ok(())
    }

    fn swap(&mut self, a: Name, b: Name) {
        self.files.swap(a as usize, b as usize);
    }

    fn volume(&mut self) -> Result<Vec<R>> {
        let mut values = Vec::with_capacity(self.projector.scanner().grid.voxels());
        for part in self.parts.clone() {
            values.extend(self.read(0, part.x())?);
        }
        Ok(values)
    }

    fn arrays(&self) -> Vec<&Vec<R>> {
        Vec::new()
    }

    fn resume(&mut self, _: Vec<Vec<R>>) -> Result<()> {
        let remedy = "allow more memory, or start again";
        Err(Error::invalid(
            "checkpoint",
            "one of whole volumes",
            "a run from the beginning: volumes are in slabs",
            remedy,
        ))
    }
}
