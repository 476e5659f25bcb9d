//! Projections of a voxel volume and their exact adjoint: `A x`, and `Aᵀ y` with the same weights.
//!
//! ```text
//! (A x)_i = Σ_j a_ij x_j        a_ij: weight of voxel j in ray i, through a pixel centre, scene units
//! (Aᵀ y)_j = Σ_i a_ij y_i
//! ```
//!
//! | model | a_ij |
//! |---|---|
//! | [`RayModel::Siddon`] `[Siddon85]` | length of the ray in the voxel: exact for a density that is constant in each voxel |
//! | [`RayModel::Joseph`] `[Joseph82]` | planes of voxel centres perpendicular to the axis that the ray is closest to (in voxels), bilinear in them, zero around the volume |
//!
//! Rays are the scanner's, cone or parallel, with all offsets, for voxels and pixels of any shape and views at any
//! angles or with any poses. The rays of a column of an upright view share a plane and are computed together; those of
//! a turned or tilted detector one by one, which takes about ten times as long. Each voxel sums its contributions in the order of views, columns and rows: there are no atomics, and the
//! number of threads changes no bit. Not in the paper, which compares with methods that use such a projector.
//!
//! `[Siddon85]`: R. L. Siddon, *Fast calculation of the exact radiological path*, Med. Phys. 12 (1985) 252.
//! `[Joseph82]`: P. M. Joseph, *An improved algorithm for reprojecting rays through pixel images*, IEEE TMI 1 (1982) 192.

mod fan;
mod joseph;
pub mod naive;
mod siddon;
mod slanted;
#[cfg(test)]
mod tests;

use super::columns::Columns;
use super::resample::margin;
use fan::Fan;
use joseph::Slab;
use ndarray::{Array3, ArrayView3};
use serde::{Deserialize, Serialize};
use slanted::SlantedRay;
use std::ops::Range;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Scanner, Trajectory, View, Volume};
use trgs_core::numeric::{Real, real, threads};
use trgs_scan::simulate::VoxelRays;

/// Columns per task in projection: neighbouring columns meet the same voxels.
const COLUMNS: usize = 8;
/// Slices in x per task in the adjoint; small slices are grouped up to this many voxels.
const SLICES: usize = 4;
const VOXELS: usize = 1 << 13;

/// The weights of the voxels on a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RayModel {
    /// Bilinear interpolation in planes of voxel centres: smooth, and the faster of the two.
    #[default]
    Joseph,
    /// The length of the ray in each voxel.
    Siddon,
}

impl RayModel {
    /// The rays of a simulated scan, in f64.
    pub fn rays(self) -> VoxelRays {
        // The voxels; the pixels in the order of rays and of images.
        let bytes = [8, 16];
        match self {
            Self::Siddon => VoxelRays {
                project: |volume, scanner, views| Self::Siddon.scan(volume, scanner, views),
                note: "simulated from voxels of constant density: exact lengths of the rays in them (Siddon), as TIGRE's",
                bytes,
            },
            Self::Joseph => VoxelRays {
                project: |volume, scanner, views| Self::Joseph.scan(volume, scanner, views),
                note: "simulated from voxels by bilinear interpolation in planes of their centres (Joseph)",
                bytes,
            },
        }
    }

    fn scan(self, volume: &Volume, scanner: &Scanner, views: Trajectory<'_>) -> Result<Projections> {
        let values = volume.values.mapv(f64::from);
        let images = VoxelProjector::new(scanner, self)?.forward(views, values.view())?;
        Projections::along(views, images.mapv(|value| value as f32))
    }
}

/// The linear map from the voxels of a scanner's grid to the pixels of its detector.
#[derive(Clone, Copy, Debug)]
pub struct VoxelProjector {
    scanner: Scanner,
    model: RayModel,
}

impl VoxelProjector {
    /// The projector of a scanner.
    ///
    /// # Errors
    /// When the scanner is invalid.
    pub fn new(scanner: &Scanner, model: RayModel) -> Result<Self> {
        scanner.validate()?;
        Ok(Self { scanner: *scanner, model })
    }

    /// `A x`: line integrals `[view, v, u]`, scene units of length × density.
    ///
    /// `volume` is `[x, y, z]`; `views` are angles (radians) or projections with their poses.
    ///
    /// Accuracy: f64 1e-13 of the largest value against [`naive`]; f32 1e-6.
    ///
    /// # Errors
    /// When the volume does not have the grid's shape, there is no view, or a pose is impossible.
    ///
    /// Tests: `fast_rays_are_the_naive_ones`, `the_adjoint_is_the_transpose`.
    pub fn forward<'a, R: Real>(
        &self,
        views: impl Into<Trajectory<'a>>,
        volume: ArrayView3<'_, R>,
    ) -> Result<Array3<R>> {
        check("volume", volume.shape(), &self.scanner.grid.shape, "give a volume [x, y, z] on the scanner's grid")?;
        let views = self.views(views)?;
        let volume = volume.as_standard_layout();
        Ok(self.project(&views, volume.as_slice().expect("standard layout")).images())
    }

    /// `Aᵀ y`: a volume `[x, y, z]` from `projections` `[view, v, u]` in `views`.
    ///
    /// # Errors
    /// When the projections do not have the detector's shape and a view for each, and as for [`Self::forward`].
    ///
    /// Tests: as [`Self::forward`].
    pub fn adjoint<'a, R: Real>(
        &self,
        views: impl Into<Trajectory<'a>>,
        projections: ArrayView3<'_, R>,
    ) -> Result<Array3<R>> {
        let views = self.views(views)?;
        let detector = &self.scanner.detector;
        let expected = [views.len(), detector.rows, detector.columns];
        check("projections", projections.shape(), &expected, "give one image [v, u] per angle")?;
        let columns = Columns::from_images(projections);
        let mut volume = Array3::from_elem(self.scanner.grid.shape, R::ZERO);
        let values = volume.as_slice_mut().expect("a new array is in C order");
        self.adjoin(&views, [&columns.values], 0, values, |out, [value]| *out = value);
        Ok(volume)
    }

    /// Zeros, to which [`Self::add_part`] adds.
    pub(super) fn no_sums<R: Real>(&self, views: &[View]) -> Vec<R> {
        vec![R::ZERO; views.len() * self.scanner.detector.pixels()]
    }

    /// Adds to `sums` the part of `A x` of the rays between the slices `x` and their next ones, before [`Self::scale`].
    ///
    /// `A x` of a volume that is never in memory as a whole, with the bits of [`Self::project`]: the sums go through all
    /// parts, the first slices first, with `rising`, for the rays on which Joseph's method meets growing x; then the last
    /// slices first without, for all others. `slab` has the slices `x` and the one after them, if there is one.
    pub(super) fn add_part<R: Real>(&self, views: &[View], slab: &[R], x: Range<usize>, rising: bool, sums: &mut [R]) {
        self.accumulate(views, &Slab::part(self.scanner.grid.shape, x), slab, Some(rising), sums);
    }

    /// `A x` from the sums of all parts of x.
    pub(super) fn scale<R: Real>(&self, views: &[View], sums: &mut [R]) {
        let (rows, columns) = (self.scanner.detector.rows, self.scanner.detector.columns);
        threads::for_each_chunk(sums, rows, |number, out| {
            let view = &views[number / columns];
            if view.is_upright() {
                let fan = Fan::new(&self.scanner.grid, view, number % columns);
                fan.scale(&fan.shallow(rows), out);
            }
        });
    }

    /// The scanner.
    pub fn scanner(&self) -> &Scanner {
        &self.scanner
    }

    /// The views of a trajectory.
    ///
    /// # Errors
    /// When there is none, an angle is not finite or a pose is impossible.
    pub fn views<'a>(&self, trajectory: impl Into<Trajectory<'a>>) -> Result<Vec<View>> {
        let trajectory = trajectory.into();
        let angles = trajectory.angles;
        if angles.is_empty() || angles.iter().any(|angle| !angle.is_finite()) {
            return Err(Error::invalid(
                "angles",
                format!("{angles:?}"),
                "finite radians, at least one",
                "give one finite angle per view",
            ));
        }
        trajectory.validate(&self.scanner)?;
        Ok(trajectory.views(&self.scanner))
    }

    /// `A x` of a volume in array order.
    pub(super) fn project<R: Real>(&self, views: &[View], volume: &[R]) -> Columns<R> {
        let (rows, columns) = (self.scanner.detector.rows, self.scanner.detector.columns);
        let shape = self.scanner.grid.shape;
        let mut values = self.no_sums(views);
        self.accumulate(views, &Slab::new(shape, 0..shape[0]), volume, None, &mut values);
        Columns { values, rows, columns }
    }

    /// `A x` from zeros, or the slab's part of it for the rays on which x grows or does not, added to `sums`.
    fn accumulate<R: Real>(&self, views: &[View], slab: &Slab, volume: &[R], rising: Option<bool>, sums: &mut [R]) {
        let (rows, columns) = (self.scanner.detector.rows, self.scanner.detector.columns);
        let (grid, nz) = (&self.scanner.grid, slab.shape[2]);
        let counts = |grows: bool| rising.is_none_or(|rising| rising == grows);
        threads::for_each_chunk(sums, COLUMNS * rows, |chunk, values| {
            let mut profile = Vec::new();
            for (i, out) in values.chunks_exact_mut(rows).enumerate() {
                let number = chunk * COLUMNS + i;
                let (view, column) = (&views[number / columns], number % columns);
                if !view.is_upright() {
                    for (k, out) in out.iter_mut().enumerate() {
                        let ray = SlantedRay::new(grid, view, column, k);
                        if counts(ray.rises()) {
                            self.visit(&ray, slab, |voxel, weight| *out += volume[voxel] * real(weight));
                        }
                    }
                    continue;
                }
                let fan = Fan::new(grid, view, column);
                match self.model {
                    RayModel::Joseph => {
                        let shallow = fan.shallow(rows);
                        if counts(fan.rises()) {
                            fan.joseph_forward(volume, slab, &shallow, out, &mut profile);
                        }
                        if rising.is_none() {
                            fan.scale(&shallow, out);
                        }
                        for k in (0..shallow.start).chain(shallow.end..rows).filter(|&k| counts(fan.rises_along_z(k))) {
                            fan.visit_steep(k, slab, |line, z, weight| {
                                out[k] += volume[line * nz + z] * real(weight);
                            });
                        }
                    }
                    RayModel::Siddon => fan.visit_siddon(0..rows, slab, |line, z, k, length| {
                        out[k] += volume[line * nz + z] * real(length);
                    }),
                }
            }
        });
    }

    /// Passes `Aᵀ y` of N images to every voxel of `volume`, the slices from `first` on, in array order.
    ///
    /// The images are `[view][column][row from below]`.
    pub(super) fn adjoin<R: Real, const N: usize>(
        &self,
        views: &[View],
        images: [&[R]; N],
        first: usize,
        volume: &mut [R],
        take: impl Fn(&mut R, [R; N]) + Sync + Send,
    ) {
        let (rows, columns) = (self.scanner.detector.rows, self.scanner.detector.columns);
        let grid = &self.scanner.grid;
        let [nx, ny, nz] = grid.shape;
        let view = |number: usize| &views[number / columns];
        let fan = |number: usize| Fan::new(grid, view(number), number % columns);
        let padded = rows + 2 * margin::<R>();
        let weighted = images.map(|image| match self.model {
            RayModel::Joseph => {
                let mut weighted = vec![R::ZERO; views.len() * columns * padded];
                threads::for_each_chunk(&mut weighted, COLUMNS * padded, |chunk, weighted| {
                    for (i, out) in weighted.chunks_exact_mut(padded).enumerate() {
                        let number = chunk * COLUMNS + i;
                        if view(number).is_upright() {
                            fan(number).weighted(&image[number * rows..][..rows], out);
                        }
                    }
                });
                weighted
            }
            RayModel::Siddon => Vec::new(),
        });
        let slices = SLICES.max(VOXELS / (ny * nz));
        threads::for_each_chunk(volume, slices * ny * nz, |chunk, volume| {
            let from = first + chunk * slices;
            let slab = Slab::new([nx, ny, nz], from..from + volume.len() / (ny * nz));
            let mut sums = images.map(|_| vec![R::ZERO; volume.len()]);
            let add = |sums: &mut [Vec<R>; N], at: usize, pixel: usize, weight: f64| {
                let weight: R = real(weight);
                (0..N).for_each(|n| sums[n][at] += images[n][pixel] * weight);
            };
            for number in 0..views.len() * columns {
                let first = number * rows;
                if !view(number).is_upright() {
                    for k in 0..rows {
                        let ray = SlantedRay::new(grid, view(number), number % columns, k);
                        self.visit(&ray, &slab, |voxel, weight| add(&mut sums, voxel, first + k, weight));
                    }
                    continue;
                }
                let fan = fan(number);
                match self.model {
                    RayModel::Joseph => {
                        let shallow = fan.shallow(rows);
                        let columns = weighted.each_ref().map(|weighted| &weighted[number * padded..][..padded]);
                        fan.joseph_adjoint(columns, &shallow, &slab, &mut sums);
                        for k in (0..shallow.start).chain(shallow.end..rows) {
                            fan.visit_steep(k, &slab, |line, z, weight| {
                                add(&mut sums, line * nz + z, first + k, weight)
                            });
                        }
                    }
                    RayModel::Siddon => fan.visit_siddon(0..rows, &slab, |line, z, k, length| {
                        add(&mut sums, line * nz + z, first + k, length);
                    }),
                }
            }
            for (at, voxel) in volume.iter_mut().enumerate() {
                take(voxel, std::array::from_fn(|n| sums[n][at]));
            }
        });
    }
}

impl VoxelProjector {
    /// Calls `visit(voxel, weight)` for the voxels of a slab on a ray.
    fn visit(&self, ray: &SlantedRay, slab: &Slab, visit: impl FnMut(usize, f64)) {
        match self.model {
            RayModel::Joseph => ray.visit_joseph(slab, visit),
            RayModel::Siddon => ray.visit_siddon(slab, visit),
        }
    }
}

/// Rejects an array of another shape.
fn check(what: &str, got: &[usize], expected: &[usize], remedy: &str) -> Result<()> {
    if got == expected {
        return Ok(());
    }
    Err(Error::invalid(what, format!("shape {got:?}"), format!("{expected:?}"), remedy))
}
