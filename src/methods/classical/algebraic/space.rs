//! The volumes of an iterative method, and what it does with them.
//!
//! A method names its volumes and never sees their values, so that they can be arrays in memory ([`Whole`]), slabs of files
//! (`super::slabs`) or slabs of several processes. All do the same operations on some slices along x and those beside
//! them, and all sums are over the values of each slice first: the bits do not depend on the division.

use super::proximal::Proximal;
use crate::classical::VoxelProjector;
use std::ops::Range;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::View;
use trgs_core::numeric::{Real, real, reduce, threads};

/// Elements of a volume per parallel task where nothing else determines the split.
const CHUNK: usize = 1 << 16;

/// A volume of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Name {
    /// The result so far, x.
    Volume,
    /// x of the iteration before.
    Before,
    /// y, from which a step is taken, and in its place the next x.
    Next,
}

/// What becomes of a volume without projections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change<R> {
    /// All values become this.
    Fill(Name, R),
    /// All values are multiplied by this.
    Scale(Name, R),
    /// The volume before becomes the present one.
    Keep,
    /// `y = x + β·(x - x before)`.
    Extrapolate(R),
    /// The dual of the total variation becomes 0.
    Forget,
}

/// A sum over voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Measure<R> {
    /// `‖·‖²`
    Squares(Name),
    /// The largest absolute value, of all slices: a maximum.
    Largest(Name),
    /// The total variation.
    Variation(Name),
    /// `‖next - y‖²`, `‖next‖²` and `⟨y - next, next - x⟩`, where y is that of [`Change::Extrapolate`] with this β.
    Step(R),
}

impl<R> Measure<R> {
    /// The volumes that it is a sum over.
    pub fn reads(&self) -> &[Name] {
        match self {
            Self::Squares(name) | Self::Largest(name) | Self::Variation(name) => std::slice::from_ref(name),
            Self::Step(_) => &[Name::Volume, Name::Before, Name::Next],
        }
    }
}

/// The volumes of a method. Images are in the order of the projector: `[view][column][row from below]`, views by number.
pub trait Space<R: Real> {
    /// The number of views.
    fn views(&self) -> usize;

    /// `A x`; of a volume of ones without a name.
    ///
    /// # Errors
    /// When slabs cannot be read; so below.
    fn project(&mut self, views: &[usize], name: Option<Name>) -> Result<Vec<R>>;

    /// `x ← Aᵀ y`, or `x ← x - step·Aᵀ y`.
    fn adjoin(&mut self, views: &[usize], images: &[R], name: Name, step: Option<R>) -> Result<()>;

    /// SART's correction `x ← x + λ·Aᵀ[corrections]/Aᵀ[weights]`, then `x ≥ 0` if `non_negative`.
    fn correct(&mut self, views: &[usize], images: [&[R]; 2], relaxation: R, non_negative: bool) -> Result<()>;

    /// Changes a volume.
    fn change(&mut self, change: Change<R>) -> Result<()>;

    /// The terms of a sum, of every slice.
    fn measure(&mut self, measure: Measure<R>) -> Result<Vec<[f64; 3]>>;

    /// The proximal step of total variation from y to the next x, by `steps` steps of its dual.
    fn solve(&mut self, tau: f64, steps: usize) -> Result<()>;

    /// Sets x; values below 0 become 0.
    fn start(&mut self, values: &[f32]) -> Result<()>;

    /// Exchanges the names of two volumes.
    fn swap(&mut self, a: Name, b: Name);

    /// The volume x in array order.
    fn volume(&mut self) -> Result<Vec<R>>;

    /// The arrays from which a run resumes: volumes and dual; none if they are not in memory.
    fn arrays(&self) -> Vec<&Vec<R>>;

    /// Resumes from [`Self::arrays`].
    fn resume(&mut self, arrays: Vec<Vec<R>>) -> Result<()>;
}

/// A sum of [`Measure`].
pub(super) fn total<R: Real>(space: &mut (impl Space<R> + ?Sized), measure: Measure<R>) -> Result<[f64; 3]> {
    let parts = space.measure(measure)?;
    Ok(match measure {
        Measure::Largest(_) => [parts.iter().fold(0.0, |largest, part| part[0].max(largest)), 0.0, 0.0],
        _ => [0, 1, 2].map(|k| reduce::sum_by(parts.len(), &|i| parts[i][k])),
    })
}

/// [`Space::change`] of some slices, but [`Change::Forget`].
pub(super) fn change<R: Real>(change: Change<R>, volumes: [&mut [R]; 3]) {
    match change {
        Change::Fill(name, value) => volumes[name as usize].fill(value),
        Change::Scale(name, factor) => {
            threads::for_each_chunk(volumes[name as usize], CHUNK, |_, x| x.iter_mut().for_each(|x| *x *= factor));
        }
        Change::Keep => {
            let [x, before, ..] = volumes;
            before.copy_from_slice(x);
        }
        Change::Extrapolate(beta) => {
            let [x, before, y] = volumes;
            threads::for_each_chunk(y, CHUNK, |chunk, y| {
                let (x, before) = (&x[chunk * CHUNK..], &before[chunk * CHUNK..]);
                y.iter_mut().enumerate().for_each(|(i, y)| *y = extrapolated(x[i], before[i], beta));
            });
        }
        Change::Forget => {}
    }
}

fn extrapolated<R: Real>(x: R, before: R, beta: R) -> R {
    x + beta * (x - before)
}

/// Some slices of the volumes of a method, and what is done with them.
///
/// Images are as of [`Space`]. A slab has the values of the slices `x`, unless more are asked for.
#[derive(Clone, Debug)]
pub struct Part<'a> {
    projector: &'a VoxelProjector,
    x: Range<usize>,
}

impl<'a> Part<'a> {
    /// The slices `x`.
    ///
    /// # Errors
    /// When they are not slices of the grid.
    pub fn new(projector: &'a VoxelProjector, x: Range<usize>) -> Result<Self> {
        let slices = projector.scanner().grid.shape[0];
        if x.start < x.end && x.end <= slices {
            return Ok(Self { projector, x });
        }
        let expected = format!("at least one of the {slices} slices along x");
        Err(Error::invalid("slices", format!("{x:?}"), expected, "give a range of slices of the grid"))
    }

    /// The slices.
    pub fn x(&self) -> Range<usize> {
        self.x.clone()
    }

    /// The slices that a step of the dual reads, for so many steps; 0: those that projections and sums read.
    pub fn reads(&self, steps: usize) -> Range<usize> {
        let below = if steps == 0 { 0 } else { steps + 1 };
        self.x.start.saturating_sub(below)..(self.x.end + steps + 1).min(self.projector.scanner().grid.shape[0])
    }

    /// Adds the part's share of `A x` to the sums of images; `slab` has the slices of [`Self::reads`] of 0. The sums go
    /// through all parts, from the first to the last for rays that are `rising` along x, and back for all others.
    pub fn project<R: Real>(&self, views: &[View], slab: &[R], rising: bool, sums: &mut [R]) {
        self.projector.add_part(views, slab, self.x.clone(), rising, sums);
    }

    /// `A x` from the sums of all parts of x.
    pub fn complete<R: Real>(&self, views: &[View], sums: &mut [R]) {
        self.projector.scale(views, sums);
    }

    /// The part's share of [`Space::adjoin`].
    pub fn adjoin<R: Real>(&self, views: &[View], images: &[R], slab: &mut [R], step: Option<R>) {
        let (projector, first) = (self.projector, self.x.start);
        match step {
            None => projector.adjoin(views, [images], first, slab, |out, [value]| *out = value),
            Some(step) => projector.adjoin(views, [images], first, slab, |out, [value]| *out += -(step * value)),
        }
    }

    /// The part's share of [`Space::correct`].
    pub fn correct<R: Real>(
        &self,
        views: &[View],
        images: [&[R]; 2],
        slab: &mut [R],
        relaxation: R,
        non_negative: bool,
    ) {
        self.projector.adjoin(views, images, self.x.start, slab, |x, [correction, weight]| {
            if weight > R::ZERO {
                *x += relaxation * (correction / weight);
            }
            if non_negative && *x < R::ZERO {
                *x = R::ZERO;
            }
        });
    }

    /// The part's terms of [`Space::measure`]; volumes have the slices of [`Self::reads`] of 0.
    pub fn measure<R: Real>(&self, measure: Measure<R>, volumes: [&[R]; 3]) -> Vec<[f64; 3]> {
        let grid = &self.projector.scanner().grid;
        let [_, ny, nz] = grid.shape;
        let part = |slice: usize| slice * ny * nz..(slice + 1) * ny * nz;
        threads::map(self.x.len(), |slice| match measure {
            Measure::Squares(name) => {
                let x = &volumes[name as usize][part(slice)];
                [reduce::sum_by(x.len(), &|i| x[i].to_f64() * x[i].to_f64()), 0.0, 0.0]
            }
            Measure::Largest(name) => {
                let larger = |most: R, value: &R| if value.abs() > most { value.abs() } else { most };
                [volumes[name as usize][part(slice)].iter().fold(R::ZERO, larger).to_f64(), 0.0, 0.0]
            }
            Measure::Variation(name) => {
                let x = volumes[name as usize];
                [Proximal::variation(grid, &x[part(slice)], x.get(part(slice + 1))), 0.0, 0.0]
            }
            Measure::Step(beta) => {
                let [x, before, next] = volumes.map(|volume| &volume[part(slice).start.min(volume.len())..]);
                let of = |i: usize| {
                    let moved = (next[i] - extrapolated(x[i], before[i], beta)).to_f64();
                    [moved * moved, next[i].to_f64() * next[i].to_f64(), -moved * (next[i] - x[i]).to_f64()]
                };
                [0, 1, 2].map(|k| reduce::sum_by(ny * nz, &|i| of(i)[k]))
            }
        })
    }

    /// [`Space::solve`] from y and the dual with the slices of [`Self::reads`]: what becomes of them, and where the part's
    /// own values are; the others are not those of the step.
    pub fn solve<R: Real>(&self, [mut y, a, b, c]: [Vec<R>; 4], tau: f64, steps: usize) -> ([Vec<R>; 4], Range<usize>) {
        let (grid, read) = (&self.projector.scanner().grid, self.reads(steps));
        let mut proximal = Proximal::of(grid, read.len(), [a, b, c]);
        proximal.solve(&mut y, tau, steps);
        let slice = grid.shape[1] * grid.shape[2];
        let own = (self.x.start - read.start) * slice..(self.x.end - read.start) * slice;
        let [a, b, c] = proximal.into_dual();
        ([y, a, b, c], own)
    }
}

/// [`Space::start`] of some values.
pub(super) fn started<R: Real>(values: &[f32]) -> Vec<R> {
    values.iter().map(|&value| if value > 0.0 { real(f64::from(value)) } else { R::ZERO }).collect()
}

/// Whole volumes in memory.
pub(super) struct Whole<'a, R> {
    projector: &'a VoxelProjector,
    views: Vec<View>,
    volumes: [Vec<R>; 3],
    proximal: Option<Proximal<R>>,
}

impl<'a, R: Real> Whole<'a, R> {
    /// Zeros: the volumes of SART alone, or all three and the dual of the total variation.
    pub(super) fn new(projector: &'a VoxelProjector, views: Vec<View>, varies: bool) -> Self {
        let grid = &projector.scanner().grid;
        let volume = |is_used: bool| if is_used { vec![R::ZERO; grid.voxels()] } else { Vec::new() };
        let proximal = varies.then(|| Proximal::new(grid));
        Self { projector, views, volumes: [true, varies, varies].map(volume), proximal }
    }

    /// A volume.
    pub(super) fn get(&self, name: Name) -> &[R] {
        &self.volumes[name as usize]
    }

    /// A volume, to be changed.
    pub(super) fn get_mut(&mut self, name: Name) -> &mut Vec<R> {
        &mut self.volumes[name as usize]
    }

    fn part(&self) -> Part<'a> {
        Part { projector: self.projector, x: 0..self.projector.scanner().grid.shape[0] }
    }
}

/// The views of these numbers.
pub(super) fn some(all: &[View], views: &[usize]) -> Vec<View> {
    views.iter().map(|&view| all[view]).collect()
}

impl<R: Real> Space<R> for Whole<'_, R> {
    fn views(&self) -> usize {
        self.views.len()
    }

    fn project(&mut self, views: &[usize], name: Option<Name>) -> Result<Vec<R>> {
        let views = some(&self.views, views);
        let Some(name) = name else {
            let voxels = self.projector.scanner().grid.voxels();
            return Ok(self.projector.project(&views, &vec![R::ONE; voxels]).values);
        };
        Ok(self.projector.project(&views, self.get(name)).values)
    }

    fn adjoin(&mut self, views: &[usize], images: &[R], name: Name, step: Option<R>) -> Result<()> {
        let views = some(&self.views, views);
        self.part().adjoin(&views, images, &mut self.volumes[name as usize], step);
        Ok(())
    }

    fn correct(&mut self, views: &[usize], images: [&[R]; 2], relaxation: R, non_negative: bool) -> Result<()> {
        let views = some(&self.views, views);
        self.part().correct(&views, images, &mut self.volumes[0], relaxation, non_negative);
        Ok(())
    }

    fn change(&mut self, what: Change<R>) -> Result<()> {
        if let (Change::Forget, Some(proximal)) = (what, &mut self.proximal) {
            *proximal = Proximal::new(&self.projector.scanner().grid);
        }
        change(what, self.volumes.each_mut().map(Vec::as_mut_slice));
        Ok(())
    }

    fn measure(&mut self, what: Measure<R>) -> Result<Vec<[f64; 3]>> {
        Ok(self.part().measure(what, self.volumes.each_ref().map(Vec::as_slice)))
    }

    fn solve(&mut self, tau: f64, steps: usize) -> Result<()> {
        self.proximal.as_mut().expect("a method with total variation").solve(&mut self.volumes[2], tau, steps);
        Ok(())
    }

    fn start(&mut self, values: &[f32]) -> Result<()> {
        self.volumes[0] = started(values);
        Ok(())
    }

    fn swap(&mut self, a: Name, b: Name) {
        self.volumes.swap(a as usize, b as usize);
    }

    fn volume(&mut self) -> Result<Vec<R>> {
        Ok(std::mem::take(&mut self.volumes[0]))
    }

    fn arrays(&self) -> Vec<&Vec<R>> {
        let volumes = if self.proximal.is_some() { &self.volumes[..2] } else { &self.volumes[..1] };
        volumes.iter().chain(self.proximal.iter().flat_map(Proximal::dual)).collect()
    }

    fn resume(&mut self, arrays: Vec<Vec<R>>) -> Result<()> {
        let mut arrays = arrays.into_iter();
        self.volumes[0] = arrays.next().expect("a volume");
        if let (Some(proximal), Some(before)) = (&mut self.proximal, arrays.next()) {
            self.volumes[1] = before;
            proximal.set_dual(std::array::from_fn(|_| arrays.next().expect("three arrays of the dual")));
        }
        Ok(())
    }
}
