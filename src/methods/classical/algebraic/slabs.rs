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

    fn read<R: Real>(&mut self, slices: Range<usize>) -> io::Result<Vec<R>> {
        let (from, count) = (slices.start, slices.len() * self.slice);
        let mut values: Box<dyn Any> = match size_of::<R>() {
            4 => Box::new(vec![0_f32; count]),
            _ => Box::new(vec![0_f64; count]),
        };
        let bytes = match values.downcast_mut::<Vec<f32>>() {
            Some(values) => bytemuck::cast_slice_mut(values),
            None => bytemuck::cast_slice_mut(values.downcast_mut::<Vec<f64>>().expect(TYPES)),
        };
        self.at::<R>(from)?.read_exact(bytes)?;
        Ok(*values.downcast().expect(TYPES))
    }

    #[expect(clippy::ptr_arg, reason = "slices have no type that is known when the program runs")]
    fn write<R: Real>(&mut self, slice: usize, values: &Vec<R>) -> io::Result<()> {
        let values: &dyn Any = values;
        let bytes = match values.downcast_ref::<Vec<f32>>() {
            Some(values) => bytemuck::cast_slice(values),
            None => bytemuck::cast_slice(values.downcast_ref::<Vec<f64>>().expect(TYPES)),
        };
        self.at::<R>(slice)?.write_all(bytes)
    }
}

/// What a volume's numbers are.
const TYPES: &str = "single or double";

/// Volumes in slabs, one in memory at a time.
pub(super) struct Slabs<'a> {
    projector: &'a VoxelProjector,
    views: Vec<View>,
    parts: Vec<Part<'a>>,
    /// Volumes by name, then the dual and its next values.
    files: Vec<Scratch>,
}

/// Places of the dual and of its next values among the files.
const DUAL: [usize; 3] = [4, 5, 6];
const NEXT_DUAL: [usize; 3] = [7, 8, 9];

impl<'a> Slabs<'a> {
    /// Zeros in `count` slabs; the files are in `folder`.
    pub(super) fn new<R: Real>(
        projector: &'a VoxelProjector,
        views: Vec<View>,
        count: usize,
        folder: &Path,
    ) -> Result<Self> {
        let shape = projector.scanner().grid.shape;
        let file = |_| Scratch::new(folder, shape, size_of::<R>());
        let files = (0..=NEXT_DUAL[2]).map(file).collect::<io::Result<_>>().map_err(failed)?;
        let count = count.clamp(1, shape[0]);
        let part = |k: usize| Part::new(projector, k * shape[0] / count..(k + 1) * shape[0] / count);
        Ok(Self { projector, views, parts: (0..count).map(part).collect::<Result<_>>()?, files })
    }

    fn read<R: Real>(&mut self, place: usize, slices: Range<usize>) -> Result<Vec<R>> {
        self.files[place].read(slices).map_err(failed)
    }

    fn write<R: Real>(&mut self, place: usize, slice: usize, values: &Vec<R>) -> Result<()> {
        self.files[place].write(slice, values).map_err(failed)
    }

    /// Reads, changes and writes every slab of a volume.
    fn each<R: Real>(&mut self, name: Name, mut work: impl FnMut(&Part<'_>, &mut [R])) -> Result<()> {
        for part in self.parts.clone() {
            let mut slab = self.read(name as usize, part.x())?;
            work(&part, &mut slab);
            self.write(name as usize, part.x().start, &slab)?;
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

impl<R: Real> Space<R> for Slabs<'_> {
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
                slab = match name {
                    Some(name) => self.read(name as usize, slices.clone())?,
                    None => vec![R::ONE; slices.len() * slice],
                };
            }
            part.project(&views, &slab, rising, &mut sums);
        }
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
            Change::Forget => (&[], &DUAL),
        };
        let slice = self.files[0].slice;
        for x in self.parts.iter().map(Part::x).collect::<Vec<_>>() {
            let zeros = vec![R::ZERO; x.len() * slice];
            if change == Change::Forget {
                writes.iter().try_for_each(|&place| self.write(place, x.start, &zeros))?;
                continue;
            }
            let mut volumes: [Vec<R>; 4] = Default::default();
            for &place in reads {
                volumes[place] = self.read(place, x.clone())?;
            }
            for &place in writes.iter().filter(|place| !reads.contains(place)) {
                volumes[place].clone_from(&zeros);
            }
            space::change(change, volumes.each_mut().map(Vec::as_mut_slice));
            writes.iter().try_for_each(|&place| self.write(place, x.start, &volumes[place]))?;
        }
        Ok(())
    }

    fn measure(&mut self, measure: Measure<R>) -> Result<Vec<[f64; 3]>> {
        let mut terms = Vec::new();
        for part in self.parts.clone() {
            let mut volumes: [Vec<R>; 4] = Default::default();
            for &name in measure.reads() {
                volumes[name as usize] = self.read(name as usize, part.reads(0))?;
            }
            terms.extend(part.measure(measure, volumes.each_ref().map(Vec::as_slice)));
        }
        Ok(terms)
    }

    fn solve(&mut self, tau: f64, steps: usize) -> Result<()> {
        for part in self.parts.clone() {
            let (read, first) = (part.reads(steps), part.x().start);
            let y: Vec<R> = self.read(Name::Middle as usize, read.clone())?;
            let mut dual: [Vec<R>; 3] = Default::default();
            for (dual, place) in dual.iter_mut().zip(DUAL) {
                *dual = self.read(place, read.clone())?;
            }
            let (next, dual) = part.solve(&y, dual, tau, steps);
            self.write(Name::Next as usize, first, &next)?;
            dual.iter().zip(NEXT_DUAL).try_for_each(|(dual, place)| self.write(place, first, dual))?;
        }
        DUAL.into_iter().zip(NEXT_DUAL).for_each(|(a, b)| self.files.swap(a, b));
        Ok(())
    }

    fn start(&mut self, values: &[f32]) -> Result<()> {
        let slice = self.files[0].slice;
        for x in self.parts.iter().map(Part::x).collect::<Vec<_>>() {
            self.write(0, x.start, &started::<R>(&values[x.start * slice..x.end * slice]))?;
        }
        Ok(())
    }

    fn swap(&mut self, a: Name, b: Name) {
        self.files.swap(a as usize, b as usize);
    }

    fn volume(&mut self) -> Result<Vec<R>> {
        let mut values = Vec::with_capacity(self.projector.scanner().grid.voxels());
        for part in self.parts.clone() {
            values.extend(self.read::<R>(0, part.x())?);
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
