//! The C interface of trgs: projections and volumes of primitives, and their gradients.
//!
//! Functions check their arguments, call the library and write the result. No arithmetic is done here. `trgs.h` is made
//! from this file.

mod memory;

use memory::{Gradient, Number, attempt, object, read, text, write};
use ndarray::{ArrayView3, Dimension};
use std::ffi::{CString, c_char};
use std::path::Path;
use std::ptr::null_mut;
use trgs::error::{Error, Result};
use trgs::geometry::{Beam, Detector, Grid, Scanner};
use trgs::primitives::{Group, Parameters, Primitives};
use trgs::projector::{self, Projection};
use trgs::scan::dataset::read_scanner;
use trgs::scan::model;

/// Value of `projection`: the line integral along the ray of each pixel.
pub const TRGS_EXACT: u32 = 0;
/// Value of `projection`: the paper's approximation, in which all rays of a primitive are parallel to the one through its
/// centre.
pub const TRGS_AFFINE: u32 = 1;

/// Primitives: kernels whose sum is the density.
#[allow(non_camel_case_types)]
pub struct trgs_model(Primitives);

/// Beam, detector and grid of a scan.
#[allow(non_camel_case_types)]
pub struct trgs_scanner(Scanner);

/// What was wrong, what was found and expected, and the remedy.
#[allow(non_camel_case_types)]
pub struct trgs_error(CString);

/// A flat detector.
#[repr(C)]
#[allow(non_camel_case_types)]
pub struct trgs_detector {
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub columns: usize,
    /// Distance between rows.
    pub pitch_v: f64,
    /// Distance between columns.
    pub pitch_u: f64,
    /// Shift of the detector towards higher rows, which are lower in space.
    pub offset_v: f64,
    /// Shift of the detector towards higher columns.
    pub offset_u: f64,
}

/// An axis-aligned box of voxels.
#[repr(C)]
#[allow(non_camel_case_types)]
pub struct trgs_grid {
    /// Voxels along x, y and z.
    pub shape: [usize; 3],
    /// The corner with the smallest coordinates.
    pub low: [f64; 3],
    /// The corner with the largest coordinates.
    pub high: [f64; 3],
}

/// Arrays of one row per primitive, in which a gradient is written. A group whose pointer is NULL is left out.
#[repr(C)]
#[allow(non_camel_case_types)]
pub struct trgs_gradient {
    /// `[count][3]`, to the centres.
    pub mean: *mut f64,
    /// `[count][3]`, to the standard deviations along the principal axes.
    pub scale: *mut f64,
    /// `[count][4]`, to the quaternions as they were given, of any length.
    pub quaternion: *mut f64,
    /// `[count]`, to the densities.
    pub density: *mut f64,
    /// `[count]`, to the degrees of freedom; 0 of Gaussians.
    pub nu: *mut f64,
}

/// The version of the library. The caller does not free it.
#[unsafe(no_mangle)]
pub extern "C" fn trgs_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

/// The message of an error, valid until the error is freed; NULL of NULL.
///
/// # Safety
/// `error` is NULL or an error that was not freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_error_message(error: *const trgs_error) -> *const c_char {
    // SAFETY: the caller's promise.
    unsafe { error.as_ref() }.map_or(null_mut(), |error| error.0.as_ptr())
}

/// Frees an error; NULL is allowed.
///
/// # Safety
/// `error` is NULL or an error that was not freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_error_free(error: *mut trgs_error) {
    if !error.is_null() {
        // SAFETY: the caller's promise; errors are boxes.
        drop(unsafe { Box::from_raw(error) });
    }
}

/// A model of `count` primitives, from copies of the arrays.
///
/// `mean`, `scale` (positive) and `quaternion` (w, x, y, z; any length but 0) have 3, 3 and 4 numbers per primitive,
/// `density` and `nu` (positive) one. With `nu` NULL, or infinite throughout, the kernels are Gaussian. Fails for the first
/// value that cannot be used.
///
/// # Safety
/// The arrays have `count` rows. `error` is NULL or a place for an error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_model_new(
    count: usize,
    mean: *const f64,
    scale: *const f64,
    quaternion: *const f64,
    density: *const f64,
    nu: *const f64,
    error: *mut *mut trgs_error,
) -> *mut trgs_model {
    let make = || {
        let mut parameters = Parameters::zeros(count);
        let arrays = [mean, scale, quaternion, density, nu];
        for (group, array) in Group::ALL.into_iter().zip(arrays) {
            let out = parameters.group_mut(group);
            if group == Group::Nu && array.is_null() {
                out.fill(f64::INFINITY);
                continue;
            }
            // SAFETY: the caller's promise of `count` rows.
            out.copy_from_slice(unsafe { read(array, out.len(), group.key()) }?);
        }
        Ok(trgs_model(Primitives::new(parameters)?))
    };
    // SAFETY: the caller's promise about `error`.
    unsafe { attempt(error, make) }.map_or(null_mut(), |model| Box::into_raw(Box::new(model)))
}

/// Reads a model: `.npz`, `.ply`, or a model of R²-Gaussian. `path` is UTF-8. Fails for a damaged file.
///
/// # Safety
/// `path` is NULL or ends with a zero. `error` is NULL or a place for an error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_model_read(path: *const c_char, error: *mut *mut trgs_error) -> *mut trgs_model {
    // SAFETY: the caller's promises.
    let read = || Ok(trgs_model(model::read(Path::new(unsafe { text(path, "path") }?))?));
    // SAFETY: as above.
    unsafe { attempt(error, read) }.map_or(null_mut(), |model| Box::into_raw(Box::new(model)))
}

/// The number of primitives; 0 of NULL.
///
/// # Safety
/// `model` is NULL or a model that was not freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_model_count(model: *const trgs_model) -> usize {
    // SAFETY: the caller's promise.
    unsafe { model.as_ref() }.map_or(0, |model| model.0.len())
}

/// Frees a model; NULL is allowed.
///
/// # Safety
/// `model` is NULL or a model that was not freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_model_free(model: *mut trgs_model) {
    if !model.is_null() {
        // SAFETY: the caller's promise; models are boxes.
        drop(unsafe { Box::from_raw(model) });
    }
}

/// A scanner with a point source, `dso` from the axis of rotation and `dsd` from the detector.
///
/// Fails for sizes that are not positive, a source in the volume, or a detector that does not see the volume.
///
/// # Safety
/// `detector` and `grid` are NULL or valid. `error` is NULL or a place for an error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_scanner_cone(
    dso: f64,
    dsd: f64,
    detector: *const trgs_detector,
    grid: *const trgs_grid,
    error: *mut *mut trgs_error,
) -> *mut trgs_scanner {
    // SAFETY: the caller's promises.
    unsafe { scanner(Beam::Cone { dso, dsd }, detector, grid, error) }
}

/// A scanner whose rays are perpendicular to the detector. Fails as `trgs_scanner_cone` does.
///
/// # Safety
/// As of `trgs_scanner_cone`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_scanner_parallel(
    detector: *const trgs_detector,
    grid: *const trgs_grid,
    error: *mut *mut trgs_error,
) -> *mut trgs_scanner {
    // SAFETY: the caller's promises. Nothing depends on the source's distance in a parallel beam.
    unsafe { scanner(Beam::Parallel { dso: 5.0 }, detector, grid, error) }
}

unsafe fn scanner(
    beam: Beam,
    detector: *const trgs_detector,
    grid: *const trgs_grid,
    error: *mut *mut trgs_error,
) -> *mut trgs_scanner {
    let make = || {
        // SAFETY: the promises of the callers.
        let (detector, grid) = unsafe { (object(detector, "detector")?, object(grid, "grid")?) };
        let &trgs_detector { rows, columns, pitch_v, pitch_u, offset_v, offset_u } = detector;
        let detector = Detector { rows, columns, pitch_v, pitch_u, offset_u, offset_v };
        let scanner = Scanner { beam, detector, grid: Grid::new(grid.shape, grid.low.into(), grid.high.into())? };
        scanner.validate()?;
        Ok(trgs_scanner(scanner))
    };
    // SAFETY: as above.
    unsafe { attempt(error, make) }.map_or(null_mut(), |scanner| Box::into_raw(Box::new(scanner)))
}

/// Reads the scanner of a dataset: its folder, its `meta_data.json`, or a pickle of NAF. `path` is UTF-8.
///
/// # Safety
/// `path` is NULL or ends with a zero. `error` is NULL or a place for an error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_scanner_read(path: *const c_char, error: *mut *mut trgs_error) -> *mut trgs_scanner {
    // SAFETY: the caller's promises.
    let read = || Ok(trgs_scanner(read_scanner(Path::new(unsafe { text(path, "path") }?))?));
    // SAFETY: as above.
    unsafe { attempt(error, read) }.map_or(null_mut(), |scanner| Box::into_raw(Box::new(scanner)))
}

/// Frees a scanner; NULL is allowed.
///
/// # Safety
/// `scanner` is NULL or a scanner that was not freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_scanner_free(scanner: *mut trgs_scanner) {
    if !scanner.is_null() {
        // SAFETY: the caller's promise; scanners are boxes.
        drop(unsafe { Box::from_raw(scanner) });
    }
}

fn projection_of(value: u32) -> Result<Projection> {
    match value {
        TRGS_EXACT => Ok(Projection::Exact),
        TRGS_AFFINE => Ok(Projection::Affine),
        _ => Err(Error::invalid("projection", value, "0 or 1", "give TRGS_EXACT or TRGS_AFFINE")),
    }
}

fn check_cutoff(cutoff: f64) -> Result<()> {
    if (0.0..1.0).contains(&cutoff) {
        return Ok(());
    }
    Err(Error::invalid("cutoff", cutoff, "a number from 0 to below 1", "give 0.0 for no cutoff"))
}

fn check_length(what: &str, got: usize, expected: &impl Dimension) -> Result<()> {
    if got == expected.size() {
        return Ok(());
    }
    let shape = expected.slice();
    let remedy = format!("give an array of {} numbers and its length", expected.size());
    Err(Error::invalid(what, format!("{got} numbers"), format!("{} of shape {shape:?}", expected.size()), remedy))
}

/// Views and rays of a call.
struct Views<'a> {
    model: &'a Primitives,
    scanner: &'a Scanner,
    angles: &'a [f64],
    projection: Projection,
    cutoff: f64,
}

impl<'a> Views<'a> {
    /// # Safety
    /// Pointers are NULL or valid, and there are `views` angles.
    unsafe fn new(
        model: *const trgs_model,
        scanner: *const trgs_scanner,
        views: usize,
        angles: *const f64,
        projection: u32,
        cutoff: f64,
    ) -> Result<Self> {
        // SAFETY: as above.
        let (model, scanner) = unsafe { (object(model, "model")?, object(scanner, "scanner")?) };
        // SAFETY: as above.
        let angles = unsafe { read(angles, views, "angles") }?;
        if let Some(angle) = angles.iter().find(|angle| !angle.is_finite()) {
            return Err(Error::invalid("angles", angle, "finite numbers, radians", "give the angle of every view"));
        }
        check_cutoff(cutoff)?;
        Ok(Self { model: &model.0, scanner: &scanner.0, angles, projection: projection_of(projection)?, cutoff })
    }

    fn shape(&self) -> ndarray::Ix3 {
        ndarray::Dim([self.angles.len(), self.scanner.detector.rows, self.scanner.detector.columns])
    }

    /// # Safety
    /// `images` has `length` numbers.
    unsafe fn project<R: Number>(&self, images: *mut R, length: usize) -> Result<()> {
        check_length("images", length, &self.shape())?;
        let found = projector::forward::<R>(self.model, self.scanner, self.angles, self.projection, self.cutoff);
        // SAFETY: as above.
        unsafe { write(images, found.as_slice().expect("in standard order"), "images") }
    }

    /// # Safety
    /// `cotangent` has `length` numbers, and `gradient` as many rows as the model.
    unsafe fn vjp<R: Number>(&self, cotangent: *const R, length: usize, gradient: *const trgs_gradient) -> Result<()> {
        check_length("cotangent", length, &self.shape())?;
        // SAFETY: as above.
        let cotangent = unsafe { read(cotangent, length, "cotangent") }?;
        let cotangent = ArrayView3::from_shape(self.shape(), cotangent).expect("the length was checked");
        // SAFETY: as above.
        let gradient = unsafe { Gradient::new(gradient) }?;
        let Self { model, scanner, angles, projection, cutoff } = *self;
        let found = projector::vjp(model, scanner, angles, projection, cutoff, cotangent);
        // SAFETY: as above.
        unsafe { gradient.write(&found) };
        Ok(())
    }
}

/// Projections `images[views][rows][columns]` in double precision, scene units of length times density.
///
/// `projection` is `TRGS_EXACT` or `TRGS_AFFINE`. A primitive ends where its projection has fallen to the fraction `cutoff`
/// of its peak; 0: nowhere, which is exact and slow; training uses 1e-3. `length` is the number of elements of `images`.
///
/// # Safety
/// `model` and `scanner` are NULL or were not freed, arrays have the stated lengths, `error` is NULL or a place for an
/// error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_project(
    model: *const trgs_model,
    scanner: *const trgs_scanner,
    views: usize,
    angles: *const f64,
    projection: u32,
    cutoff: f64,
    images: *mut f64,
    length: usize,
    error: *mut *mut trgs_error,
) -> bool {
    // SAFETY: the caller's promises.
    let work = || unsafe { Views::new(model, scanner, views, angles, projection, cutoff)?.project(images, length) };
    // SAFETY: as above.
    unsafe { attempt(error, work) }.is_some()
}

/// `trgs_project` in single precision.
///
/// # Safety
/// As of `trgs_project`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_project_f32(
    model: *const trgs_model,
    scanner: *const trgs_scanner,
    views: usize,
    angles: *const f64,
    projection: u32,
    cutoff: f64,
    images: *mut f32,
    length: usize,
    error: *mut *mut trgs_error,
) -> bool {
    // SAFETY: the caller's promises.
    let work = || unsafe { Views::new(model, scanner, views, angles, projection, cutoff)?.project(images, length) };
    // SAFETY: as above.
    unsafe { attempt(error, work) }.is_some()
}

/// The gradient of the sum of cotangent times projection to the parameters of the model.
///
/// `cotangent` has the shape of `images` of `trgs_project`, and `length` elements.
///
/// # Safety
/// As of `trgs_project`; the arrays of `gradient` have as many rows as the model.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_project_vjp(
    model: *const trgs_model,
    scanner: *const trgs_scanner,
    views: usize,
    angles: *const f64,
    projection: u32,
    cutoff: f64,
    cotangent: *const f64,
    length: usize,
    gradient: *const trgs_gradient,
    error: *mut *mut trgs_error,
) -> bool {
    // SAFETY: the caller's promises.
    let work =
        || unsafe { Views::new(model, scanner, views, angles, projection, cutoff)?.vjp(cotangent, length, gradient) };
    // SAFETY: as above.
    unsafe { attempt(error, work) }.is_some()
}

/// `trgs_project_vjp` in single precision; the gradient is in double precision.
///
/// # Safety
/// As of `trgs_project_vjp`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_project_vjp_f32(
    model: *const trgs_model,
    scanner: *const trgs_scanner,
    views: usize,
    angles: *const f64,
    projection: u32,
    cutoff: f64,
    cotangent: *const f32,
    length: usize,
    gradient: *const trgs_gradient,
    error: *mut *mut trgs_error,
) -> bool {
    // SAFETY: the caller's promises.
    let work =
        || unsafe { Views::new(model, scanner, views, angles, projection, cutoff)?.vjp(cotangent, length, gradient) };
    // SAFETY: as above.
    unsafe { attempt(error, work) }.is_some()
}

/// # Safety
/// Pointers are NULL or valid.
unsafe fn on_grid<'a>(
    model: *const trgs_model,
    grid: *const trgs_grid,
    cutoff: f64,
) -> Result<(&'a Primitives, Grid, ndarray::Ix3)> {
    // SAFETY: as above.
    let (model, grid) = unsafe { (object(model, "model")?, object(grid, "grid")?) };
    check_cutoff(cutoff)?;
    let grid = Grid::new(grid.shape, grid.low.into(), grid.high.into())?;
    Ok((&model.0, grid, ndarray::Dim(grid.shape)))
}

/// # Safety
/// Pointers are NULL or valid, and `volume` has `length` numbers.
unsafe fn voxelize<R: Number>(
    model: *const trgs_model,
    grid: *const trgs_grid,
    cutoff: f64,
    volume: *mut R,
    length: usize,
) -> Result<()> {
    // SAFETY: as above.
    let (model, grid, shape) = unsafe { on_grid(model, grid, cutoff) }?;
    check_length("volume", length, &shape)?;
    let found = projector::voxelize::<R>(model, &grid, cutoff);
    // SAFETY: as above.
    unsafe { write(volume, found.as_slice().expect("in standard order"), "volume") }
}

/// # Safety
/// Pointers are NULL or valid, `cotangent` has `length` numbers, and `gradient` as many rows as the model.
unsafe fn voxelize_vjp<R: Number>(
    model: *const trgs_model,
    grid: *const trgs_grid,
    cutoff: f64,
    cotangent: *const R,
    length: usize,
    gradient: *const trgs_gradient,
) -> Result<()> {
    // SAFETY: as above.
    let (model, grid, shape) = unsafe { on_grid(model, grid, cutoff) }?;
    check_length("cotangent", length, &shape)?;
    // SAFETY: as above.
    let (cotangent, gradient) = unsafe { (read(cotangent, length, "cotangent")?, Gradient::new(gradient)?) };
    let cotangent = ArrayView3::from_shape(shape, cotangent).expect("the length was checked");
    let found = projector::voxelize_vjp(model, &grid, cutoff, cotangent);
    // SAFETY: as above.
    unsafe { gradient.write(&found) };
    Ok(())
}

/// The density `volume[x][y][z]` at the voxel centres of a grid in double precision, attenuation per scene unit.
///
/// `cutoff` is that of `trgs_project`, and `length` the number of elements of `volume`.
///
/// # Safety
/// `model` is NULL or was not freed, `grid` is NULL or valid, arrays have the stated lengths, `error` is NULL or a place for
/// an error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_voxelize(
    model: *const trgs_model,
    grid: *const trgs_grid,
    cutoff: f64,
    volume: *mut f64,
    length: usize,
    error: *mut *mut trgs_error,
) -> bool {
    // SAFETY: the caller's promises.
    unsafe { attempt(error, || voxelize(model, grid, cutoff, volume, length)) }.is_some()
}

/// `trgs_voxelize` in single precision.
///
/// # Safety
/// As of `trgs_voxelize`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_voxelize_f32(
    model: *const trgs_model,
    grid: *const trgs_grid,
    cutoff: f64,
    volume: *mut f32,
    length: usize,
    error: *mut *mut trgs_error,
) -> bool {
    // SAFETY: the caller's promises.
    unsafe { attempt(error, || voxelize(model, grid, cutoff, volume, length)) }.is_some()
}

/// The gradient of the sum of cotangent times volume to the parameters of the model.
///
/// `cotangent` has the shape of `volume` of `trgs_voxelize`, and `length` elements.
///
/// # Safety
/// As of `trgs_voxelize`; the arrays of `gradient` have as many rows as the model.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_voxelize_vjp(
    model: *const trgs_model,
    grid: *const trgs_grid,
    cutoff: f64,
    cotangent: *const f64,
    length: usize,
    gradient: *const trgs_gradient,
    error: *mut *mut trgs_error,
) -> bool {
    // SAFETY: the caller's promises.
    unsafe { attempt(error, || voxelize_vjp(model, grid, cutoff, cotangent, length, gradient)) }.is_some()
}

/// `trgs_voxelize_vjp` in single precision; the gradient is in double precision.
///
/// # Safety
/// As of `trgs_voxelize_vjp`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trgs_voxelize_vjp_f32(
    model: *const trgs_model,
    grid: *const trgs_grid,
    cutoff: f64,
    cotangent: *const f32,
    length: usize,
    gradient: *const trgs_gradient,
    error: *mut *mut trgs_error,
) -> bool {
    // SAFETY: the caller's promises.
    unsafe { attempt(error, || voxelize_vjp(model, grid, cutoff, cotangent, length, gradient)) }.is_some()
}
