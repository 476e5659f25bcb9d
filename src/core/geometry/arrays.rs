//! Projections and volumes, each with its geometry.

use super::{Grid, Pose, Trajectory};
use crate::error::{Error, Result};
use crate::setting::Setting;
use crate::words::counted;
use ndarray::{Array3, ArrayView2, Axis, Slice};

/// Density per voxel: attenuation per scene unit of length.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Where the voxels lie.
    pub grid: Grid,
    /// `[x, y, z]`, z fastest.
    pub values: Array3<f32>,
}

/// Line integrals: one image per view.
#[derive(Clone, Debug, PartialEq)]
pub struct Projections {
    /// Rotation of each view, radians.
    pub angles: Vec<f64>,
    /// Pose of each view; `None` for the circle of the scanner.
    pub poses: Option<Vec<Pose>>,
    /// `[view, v, u]`, row 0 on top.
    pub images: Array3<f32>,
}

impl Volume {
    /// Checks a volume against its grid.
    ///
    /// # Errors
    /// When the shape differs from the grid's, or a value is not finite.
    pub fn new(grid: Grid, values: Array3<f32>) -> Result<Self> {
        check_shape(&grid, values.shape())?;
        check_finite("volume", &values)?;
        Ok(Self { grid, values: in_standard_layout(values) })
    }

    /// The voxels of a grid that this one was made of by [`Grid::with_margin`].
    ///
    /// # Panics
    /// If the grid is not within this one.
    #[must_use]
    pub fn without_margin(self, grid: &Grid) -> Self {
        if self.grid == *grid {
            return self;
        }
        let first = ((grid.min - self.grid.min) / grid.spacing).round();
        let along = |axis: usize| {
            let first = first[axis] as usize;
            Slice::from(first..first + grid.shape[axis])
        };
        let values = self.values.slice_each_axis(|axis| along(axis.axis.index())).to_owned();
        Self { grid: *grid, values }
    }
}

impl Projections {
    /// Checks projections: at least one view, one angle per view, finite values.
    ///
    /// `angles` are in radians, `images` are `[view, v, u]`.
    ///
    /// # Errors
    /// For the first of these checks that fails.
    pub fn new(angles: Vec<f64>, images: Array3<f32>) -> Result<Self> {
        if angles.is_empty() || images.shape()[0] != angles.len() {
            return Err(Error::invalid(
                "projections",
                format!("{} for {}", counted(images.shape()[0], "image"), counted(angles.len(), "angle")),
                "one image per angle, at least one",
                "give one angle per image",
            ));
        }
        if let Some(bad) = angles.iter().find(|a| !a.is_finite()) {
            return Err(Error::invalid(
                "angle",
                bad,
                "a finite number of radians",
                "correct the angles in meta_data.json",
            ));
        }
        check_finite("projections", &images)?;
        Ok(Self { angles, poses: None, images: in_standard_layout(images) })
    }

    /// [`Self::new`] for the views of a trajectory.
    ///
    /// # Errors
    /// Those of [`Self::new`], and when poses and angles differ in number.
    pub fn along(trajectory: Trajectory<'_>, images: Array3<f32>) -> Result<Self> {
        let projections = Self::new(trajectory.angles.to_vec(), images)?;
        let poses = trajectory.poses.map(<[Pose]>::to_vec);
        if let Some(poses) = poses.as_ref().filter(|poses| poses.len() != projections.len()) {
            let expected = format!("{}, one for each view", projections.len());
            return Err(Error::invalid("poses", poses.len(), expected, "give one pose per view, or none"));
        }
        Ok(Self { poses, ..projections })
    }

    /// The angles and poses.
    pub fn trajectory(&self) -> Trajectory<'_> {
        self.into()
    }

    /// Number of views.
    pub fn len(&self) -> usize {
        self.angles.len()
    }

    /// Whether there are no views; never true for checked projections.
    pub fn is_empty(&self) -> bool {
        self.angles.is_empty()
    }

    /// The image `[v, u]` of one view.
    pub fn image(&self, view: usize) -> ArrayView2<'_, f32> {
        self.images.index_axis(Axis(0), view)
    }

    /// `n` of the views, evenly spaced, starting with the first.
    ///
    /// # Errors
    /// When there are fewer than `n` views, or `n` is 0.
    pub fn evenly_spaced(&self, n: usize) -> Result<Self> {
        let len = self.len();
        if n == 0 || n > len {
            let expected = format!("1 to {len}, the dataset's training views");
            let remedy = "give " + Setting::Views + format!(" {len} for all of them");
            return Err(Error::invalid(Setting::Views, n, expected, remedy));
        }
        Ok(self.select(&(0..n).map(|i| i * len / n).collect::<Vec<_>>()))
    }

    /// The views with the given indices, in that order.
    pub fn select(&self, views: &[usize]) -> Self {
        Self {
            angles: views.iter().map(|&i| self.angles[i]).collect(),
            poses: self.poses.as_ref().map(|poses| views.iter().map(|&i| poses[i]).collect()),
            images: self.images.select(Axis(0), views),
        }
    }
}

impl<'a> From<&'a Projections> for Trajectory<'a> {
    fn from(projections: &'a Projections) -> Self {
        Self { angles: &projections.angles, poses: projections.poses.as_deref() }
    }
}

/// The array in C order. An array in C order is returned as it is: a scan must not be in memory twice.
fn in_standard_layout(array: Array3<f32>) -> Array3<f32> {
    if array.is_standard_layout() { array } else { array.as_standard_layout().into_owned() }
}

/// Returns an error for a shape that is not the grid's.
#[doc(hidden)]
pub fn check_shape(grid: &Grid, shape: &[usize]) -> Result<()> {
    if shape == grid.shape {
        return Ok(());
    }
    Err(Error::invalid(
        "volume",
        format!("shape {shape:?}"),
        format!("{:?} = [x, y, z]", grid.shape),
        "correct nVoxel, or transpose the volume to [x, y, z]",
    ))
}

/// Returns an error that names the first value that is not finite.
#[doc(hidden)]
pub fn check_finite(what: &str, values: &Array3<f32>) -> Result<()> {
    check_finite_from(what, 0, values)
}

/// [`check_finite`] for a part of an array, whose first index along the first axis is `first`.
#[doc(hidden)]
pub fn check_finite_from(what: &str, first: usize, values: &Array3<f32>) -> Result<()> {
    match values.indexed_iter().find(|(_, value)| !value.is_finite()) {
        None => Ok(()),
        Some(((i, j, k), value)) => Err(Error::invalid(
            what,
            format!("{value} at {:?}", (first + i, j, k)),
            "finite numbers only",
            "remove the damaged views, or measure them again: values are never guessed",
        )),
    }
}
