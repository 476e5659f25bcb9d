//! One view of the field: the image band by band in primitive order, the gradient primitive by primitive.

use super::footprint::Footprint;
use super::footprint_vjp;
use super::kernels::ImageKernels;
use super::placement::PlacedFootprint;
use crate::geometry::{Beam, View};
use crate::numeric::Real;
use crate::numeric::threads::{self, Pool, PoolGuard};
use crate::numeric::vectors::{LANES, lane_refs};
use crate::projector::kernel::buffers::PaddedImage;
use crate::projector::kernel::columns::STRIP;
use crate::projector::kernel::{Scratch, Sums};
use crate::projector::kernels::Kernels;
use crate::projector::projection::Projection;
use crate::projector::whitened::{FieldGradient, Whitened};
use ndarray::{Array2, ArrayView2};
use std::hint::black_box;

/// Primitives whose gradients one task computes.
const GRADIENT_CHUNK: usize = 64;
/// Primitives that one task projects, or bins into bands; a multiple of [`LANES`].
const BIN_CHUNK: usize = 512;
/// Footprints that a band fetches at a time: they are scattered in memory, so that cache misses overlap.
const FETCHED: usize = 16;

/// The primitives among [`BIN_CHUNK`] whose supports reach each band, in index order.
type Bins = Vec<Vec<u32>>;

/// Buffers of views, reused from view to view so that a steady state allocates nothing.
#[derive(Default)]
pub(crate) struct Workspace<R: Real> {
    footprints: Pool<Vec<Footprint>>,
    bins: Pool<Vec<Bins>>,
    images: Pool<PaddedImage<R>>,
    fetched: Pool<Vec<PlacedFootprint>>,
    scratch: Pool<Scratch<R::Lanes>>,
}

/// The footprints of a [`Field`](crate::projector::Field)'s primitives on the detector of one view.
pub struct ViewField<'a, R: Real> {
    whitened: Whitened<'a>,
    workspace: &'a Workspace<R>,
    pub(crate) view: View,
    projection: Projection,
    pub(crate) footprints: PoolGuard<'a, Vec<Footprint>>,
}

/// The footprints of all primitives on the detector of a view.
fn project_all(whitened: Whitened<'_>, view: &View, projection: Projection, footprints: &mut Vec<Footprint>) {
    footprints.resize(whitened.primitives.len(), Footprint::default());
    threads::for_each_chunk(footprints, BIN_CHUNK, |chunk, footprints| {
        let primitives = whitened.primitives[chunk * BIN_CHUNK..].chunks(LANES);
        for (footprints, primitives) in footprints.chunks_mut(LANES).zip(primitives) {
            Footprint::project(footprints, lane_refs(primitives, |p| p), view, projection);
        }
    });
}

/// The primitives whose supports reach each of `bands` bands.
fn bin_all(footprints: &[Footprint], bands: usize, bins: &mut Vec<Bins>) {
    bins.resize(footprints.len().div_ceil(BIN_CHUNK), Vec::new());
    threads::for_each_chunk(bins, 1, |chunk, bins| {
        let [bins] = bins else { unreachable!("a chunk of one") };
        // Full capacity, so that another view needs no more.
        bins.resize_with(bands, || Vec::with_capacity(BIN_CHUNK));
        bins.iter_mut().for_each(Vec::clear);
        let all = (chunk * BIN_CHUNK..).zip(&footprints[chunk * BIN_CHUNK..]).take(BIN_CHUNK);
        for (i, footprint) in all.filter(|(_, footprint)| !footprint.is_empty()) {
            for band in &mut bins[footprint.rows.start / STRIP..=(footprint.rows.end - 1) / STRIP] {
                band.push(i as u32);
            }
        }
    });
}

/// [`ViewField::truncation_bound`].
fn bound_of_dropped(whitened: Whitened<'_>, footprints: &[Footprint], view: &View) -> Array2<f64> {
    let bound = |i: usize| whitened.primitives[i].truncation_bound(whitened.cutoff);
    let mut bounds = Array2::from_elem((view.detector.rows, view.detector.columns), 0.0);
    for (i, footprint) in footprints.iter().enumerate().filter(|(_, footprint)| footprint.seen) {
        bounds += bound(i);
        for row in footprint.rows.clone() {
            for column in footprint.columns.clone() {
                if footprint.conic.contains(row, column) {
                    bounds[[row, column]] -= bound(i);
                }
            }
        }
    }
    bounds.mapv_into(|bound: f64| bound.max(0.0))
}

impl<'a, R: Kernels> ViewField<'a, R> {
    pub(crate) fn new(
        whitened: Whitened<'a>,
        workspace: &'a Workspace<R>,
        view: &View,
        projection: Projection,
    ) -> Self {
        // A parallel beam is its own affine projection: the cheaper kernel gives the same numbers.
        let projection = if matches!(view.beam, Beam::Parallel { .. }) { Projection::Affine } else { projection };
        let mut footprints = workspace.footprints.take();
        project_all(whitened, view, projection, &mut footprints);
        Self { whitened, workspace, view: *view, projection, footprints }
    }

    /// Whether the view sees each primitive: its support holds a pixel.
    pub fn seen(&self) -> impl Iterator<Item = bool> {
        self.footprints.iter().map(|footprint| !footprint.is_empty())
    }

    /// Number of (pixel, primitive) pairs in the boxes of all supports: what an image costs.
    pub fn support_pixels(&self) -> usize {
        self.footprints.iter().map(|f| f.rows.len() * f.columns.len()).sum()
    }

    /// The support of every primitive on the detector `[X2]`: `[row_min, row_max, column_min, column_max]` in fractional
    /// pixel indices (0 is the centre of the first row or column), not clipped to the detector.
    ///
    /// It bounds the pixels that the field's cutoff ε lets the primitive reach, where its projection has not fallen to
    /// ε of its peak. `(-∞, ∞, -∞, ∞)` where that set is not an ellipse: it holds the source or passes next to it, or ε
    /// is 0 and it is the whole plane. `(∞, -∞, ∞, -∞)` for a primitive that is left out near or behind the source.
    /// That a kernel in `R` adds nothing below `2^-R::HORIZON` is a limit of its number range and no cutoff: it shrinks the
    /// pixels that are evaluated, not these boxes.
    ///
    /// Tests: `support_boxes_bound_the_pixels_of_each_primitive`, `boxes_know_the_cutoff_alone`.
    pub fn support_boxes(&self) -> Vec<[f64; 4]> {
        let boxes = self.whitened.primitives.chunks(LANES).flat_map(|group| {
            let primitives = lane_refs(group, |p| p);
            let boxes = Footprint::support_boxes(primitives, &self.view, self.projection);
            boxes.into_iter().take(group.len())
        });
        boxes.collect()
    }

    /// The image `[v, u]`: bands of 32 rows in parallel, primitives in index order.
    pub fn image(&self) -> Array2<R> {
        let mut image = Array2::default((0, 0));
        self.image_into(&mut image);
        image
    }

    /// [`Self::image`] into an existing array.
    pub fn image_into(&self, image: &mut Array2<R>) {
        let (rows, columns) = (self.view.detector.rows, self.view.detector.columns);
        if image.dim() != (rows, columns) {
            *image = Array2::default((rows, columns));
        }
        let image = image.as_slice_mut().expect("images are in standard layout");
        let mut bins = self.workspace.bins.take();
        bin_all(&self.footprints, rows.div_ceil(STRIP), &mut bins);
        let kernel = self.kernels().forward;
        threads::for_each_chunk_in(image, STRIP * columns, &self.workspace.scratch, |band, pixels, scratch| {
            let origin = band * STRIP;
            let height = pixels.len() / columns;
            let (mut buffer, mut fetched) = (self.workspace.images.take(), self.workspace.fetched.take());
            buffer.reset(height, columns);
            fetched.reserve(FETCHED);
            for group in bins.iter().flat_map(|bins| bins[band].chunks(FETCHED)) {
                // A prefetch: the cache misses of all footprints overlap.
                black_box(group.iter().fold(0, |bits, &i| bits ^ self.footprints[i as usize].touch()));
                fetched.clear();
                fetched.extend(group.iter().map(|&i| {
                    let footprint = &self.footprints[i as usize];
                    let rows = footprint.rows_in(origin..origin + height);
                    let top = rows.start - origin;
                    footprint.placed(rows, top, buffer.stride)
                }));
                for footprint in fetched.iter() {
                    kernel(footprint, &mut buffer, scratch);
                }
            }
            for (row, pixels) in pixels.chunks_exact_mut(columns).enumerate() {
                pixels.copy_from_slice(buffer.row(row, columns));
                self.times_ray_length(origin + row, pixels);
            }
        });
    }

    /// A bound, per pixel, on what the cutoff dropped `[X2]`: the sum over the primitives that a pixel skipped
    /// of |ρ| · line integral · largest scale · ε. One that is left out near or behind the source has nothing to drop.
    pub fn truncation_bound(&self) -> Array2<f64> {
        bound_of_dropped(self.whitened, &self.footprints, &self.view)
    }

    /// Adds the gradient of `Σ cotangent·image`; `cotangent` is `[v, u]`.
    ///
    /// # Panics
    /// If the cotangent does not have the detector's shape, if the gradient belongs to another field, or for images of 2^32
    /// pixels.
    pub fn vjp(&self, cotangent: ArrayView2<'_, R>, gradient: &mut FieldGradient) {
        let (rows, columns) = (self.view.detector.rows, self.view.detector.columns);
        assert_eq!(cotangent.shape(), [rows, columns], "shape of the cotangent");
        assert_eq!(gradient.by_primitive.len(), self.footprints.len(), "primitives of the gradient");
        let mut buffer = self.workspace.images.take();
        buffer.reset(rows, columns);
        let stride = buffer.stride;
        threads::for_each_chunk(&mut buffer.pixels, STRIP * stride, |band, pixels| {
            for (row, pixels) in (band * STRIP..rows).zip(pixels.chunks_exact_mut(stride)) {
                let pixels = &mut pixels[..columns];
                pixels.iter_mut().zip(cotangent.row(row)).for_each(|(pixel, &value)| *pixel = value);
                self.times_ray_length(row, pixels);
            }
        });
        let kernel = self.kernels().vjp;
        let (gradients, scratch) = (&mut gradient.by_primitive, &self.workspace.scratch);
        threads::for_each_chunk_in(gradients, GRADIENT_CHUNK, scratch, |chunk, gradients, scratch| {
            let here = chunk * GRADIENT_CHUNK..chunk * GRADIENT_CHUNK + gradients.len();
            let (footprints, primitives) = (&self.footprints[here.clone()], &self.whitened.primitives[here]);
            let groups = footprints.chunks(LANES).zip(primitives.chunks(LANES));
            for ((footprints, primitives), gradients) in groups.zip(gradients.chunks_mut(LANES)) {
                let mut sums = [Sums::default(); LANES];
                for (sums, footprint) in sums.iter_mut().zip(footprints).filter(|(_, f)| !f.is_empty()) {
                    let rows = footprint.rows.clone();
                    let top = rows.start;
                    *sums = kernel(&footprint.placed(rows, top, buffer.stride), &buffer, scratch);
                }
                let (all, primitives) = (lane_refs(footprints, |f| f), lane_refs(primitives, |p| p));
                let parts = footprint_vjp::vjp(all, primitives, &self.view, self.projection, &sums);
                for ((gradient, part), footprint) in gradients.iter_mut().zip(&parts).zip(footprints) {
                    if !footprint.is_empty() {
                        gradient.add(part);
                    }
                }
            }
        });
    }

    /// The kernels of this view.
    pub(crate) fn kernels(&self) -> ImageKernels<R> {
        R::image_kernels(self.whitened.kernel, self.projection)
    }

    /// Multiplies a row of pixels by the lengths of their rays.
    fn times_ray_length(&self, row: usize, pixels: &mut [R]) {
        let Some(length) = self.ray_lengths(row) else { return };
        for (column, pixel) in pixels.iter_mut().enumerate() {
            *pixel *= length(column);
        }
    }

    /// The length |d| of the ray of each column of a row, between planes of unit distance `[X1]`.
    ///
    /// `None` if it is 1, or if the footprints' weights contain it, as in the affine projection.
    pub(crate) fn ray_lengths(&self, row: usize) -> Option<impl Fn(usize) -> R + use<R>> {
        let Beam::Cone { dsd, .. } = self.view.beam else { return None };
        if self.projection == Projection::Affine {
            return None;
        }
        let (u, v) = self.view.detector.position(row as f64, 0.0);
        let (first, pitch, rest) = (u / dsd, self.view.detector.pitch_u / dsd, 1.0 + v / dsd * (v / dsd));
        Some(move |column: usize| {
            let slope = first + column as f64 * pitch;
            R::from_f64((rest + slope * slope).sqrt())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Detector, Grid, Scanner};
    use crate::primitives::{Parameters, Primitives};
    use crate::projector::Field;
    use crate::tolerances::largest;
    use std::ops::Range;

    #[test]
    fn every_primitive_of_many_is_in_the_image_once() {
        let pitch = 4.0 / 40.0;
        let detector = Detector { rows: 70, columns: 40, pitch_v: pitch, pitch_u: pitch, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(8) };
        let at = |i: usize, factor: f64| ((i as f64 * factor).fract() - 0.5) * 1.6;
        // Densities that differ from one to the next and from chunk to chunk.
        let some = |range: Range<usize>| {
            let primitives = Primitives::new(Parameters {
                mean: range.clone().map(|i| [at(i, 0.819), at(i, 0.671), 0.7 * at(i, 0.549)]).collect(),
                scale: vec![[0.04, 0.05, 0.06]; range.len()],
                quaternion: vec![[1.0, 0.2, -0.1, 0.3]; range.len()],
                density: range.clone().map(|i| 0.1 + (i % 7) as f64 + (i / BIN_CHUNK) as f64).collect(),
                nu: vec![8.0; range.len()],
            });
            Field::<f64>::new(&primitives.unwrap(), 1e-3).view(&scanner, 0.4, Projection::Exact).image()
        };
        let (whole, sum) =
            (some(0..2 * BIN_CHUNK + 100), some(0..200) + some(200..BIN_CHUNK) + some(BIN_CHUNK..2 * BIN_CHUNK + 100));
        within!(largest(&whole - &sum) / largest(whole.iter().copied()));
        assert!(whole.row(30).sum() > 0.0 && whole.row(40).sum() > 0.0);
    }
}
