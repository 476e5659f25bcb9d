//! A scan as a folder, in the format of R²-Gaussian:
//!
//! ```text
//! meta_data.json                     scanner, file names, angles in radians
//! vol_gt.npy                         true volume [x, y, z], optional
//! proj_train/proj_train_0000.npy     one projection [v, u] per file, row 0 on top
//! proj_test/proj_test_0000.npy       projections to judge by, optional
//! init_<name>.npy                    initial points [M, 4] = x, y, z, density, optional
//! ```
//!
//! Projections may also be images with one page (such as `.tif`), and the true volume any file of
//! [`volume_file`](super::volume_file) (such as `.nii.gz`).
//!
//! Keys of our own: `notes` holds facts needed to judge results (that the truth is a pseudo truth, for instance), `unit`
//! the unit of the lengths, and `frame` the unit and place of the files that a scan in scene units was converted from:
//! see [`frame`](super::frame).
//!
//! The files may use any one unit of length. Reading multiplies lengths and projections by `scale = 2/max(sVoxel)`,
//! which makes the longest side of the volume 2. The volume is not scaled: densities remain per unit of the file.
//! Initial points are in scene units already. Files are written in scene units, where the scale is 1.
//!
//! Views may have poses: their fields are in `poses.rs`, their meaning is on the geometry page. A scan with poses is written with
//! a `vector` in each view. Fields that are not read are reported, or refused where they would move something.
//!
//! A scan may also be the single file of NAF and SAX-NeRF, a pickle. Its code is never run:
//!
//! ```text
//! DSD, DSO, nDetector, dDetector, …  scanner, in millimetres; pixel and voxel sizes instead of total sizes
//! image                              true volume [x, y, z], density per metre
//! train, val (or test)               angles in radians and projections [view, v, u], row 0 on top
//! ```

mod fields;
mod files;
mod info;
mod meta;
mod naf;
mod numbers;
mod paths;
pub(crate) mod pickle;
mod poses;
mod subsample;

pub use info::DatasetInfo;
pub use poses::{of_vector as pose_of_vector, to_vector as vector_of_pose};

use super::frame::Frame;
use super::noise::Noise;
use super::npy;
use crate::limit;
use crate::output::{Destination, Kind, create_folder, stage_folder};
use meta::{Meta, ScannerMeta, ViewMeta};
use ndarray::{Array2, Array3, ArrayView, Dimension, Ix2};
use poses::Motion;
use std::path::{Path, PathBuf};
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Beam, Grid, Pose, Projections, Scanner, Trajectory, Volume};
use trgs_core::words::counted;

/// A scan: projections, geometry, and the true volume if it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// The folder's name.
    pub name: String,
    /// The scanner, scene units.
    pub scanner: Scanner,
    /// Scene units per unit of length of the description; that of the data is in `frame`.
    pub scale: f64,
    /// Unit and place of the data. Densities are per its unit of length.
    pub frame: Frame,
    /// Noise of the training views, as far as the files tell.
    pub noise: Noise,
    /// Projections to reconstruct from.
    pub train: Projections,
    /// Projections to evaluate with.
    pub test: Option<Projections>,
    /// The volume that was scanned, if known.
    pub truth: Option<Volume>,
    /// Initial points, `[M, 4]` = x, y, z in scene units and density.
    pub initial_points: Option<Array2<f64>>,
    /// Facts needed to judge results on this scan, one sentence each; stored in the files.
    pub notes: Vec<String>,
    /// Unusual properties of the files, one sentence each. None of them makes the scan unusable.
    pub oddities: Vec<String>,
}

/// The content of a `meta_data.json`, before any projection is read.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// The scanner, scene units.
    pub scanner: Scanner,
    /// Scene units per unit of length of the description.
    pub scale: f64,
    /// Unit and place of the scan.
    pub frame: Frame,
    /// Angles of the training views that the file lists, radians.
    pub listed: Vec<f64>,
    /// First view and span of all views, radians.
    pub arc: Option<(f64, f64)>,
    /// Unusual properties of the file, one sentence each.
    pub oddities: Vec<String>,
    /// Poses of the training views that the file lists or states.
    motion: Motion,
}

impl Description {
    /// Reads a description; `path` is a dataset's folder, its `meta_data.json`, or a `.pickle` of NAF.
    ///
    /// # Errors
    /// [`Error::Read`] for a file that cannot be read, [`Error::Format`] for content that is wrong.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        if naf::is_pickle(path) {
            let Dataset { scanner, scale, frame, train, oddities, .. } = naf::read(path)?;
            let motion = train.poses.map_or(Motion::Circle, Motion::Poses);
            return Ok(Self { scanner, scale, frame, listed: train.angles, arc: None, oddities, motion });
        }
        let path = meta_path(path);
        Self::of(&Meta::read(&path)?, &path)
    }

    /// Parses the content of a `meta_data.json`; `path` names it in errors.
    ///
    /// # Errors
    /// [`Error::Format`] for content that is wrong.
    pub fn parse(text: &[u8], path: &Path) -> Result<Self> {
        Self::of(&Meta::parse(text, path)?, path)
    }

    fn of(meta: &Meta, path: &Path) -> Result<Self> {
        let meta::Interpreted { scanner, scale, frame, motion, oddities, .. } = meta.interpret(path)?;
        let mut listed = angles(&meta.proj_train, &motion, 0);
        if let (true, Motion::Poses(poses)) = (listed.is_empty(), &motion) {
            listed = poses.iter().map(Pose::angle).collect();
        }
        Ok(Self { scanner, scale, frame, listed, arc: meta.scanner.arc(), oddities, motion })
    }

    /// A description of plain numbers, without a file.
    pub fn new(scanner: Scanner, scale: f64, arc: Option<(f64, f64)>) -> Self {
        let frame = Frame::scaled(scale);
        Self { scanner, scale, frame, listed: Vec::new(), arc, oddities: Vec::new(), motion: Motion::Circle }
    }

    /// The description with these poses for the views, in the unit of its [`Frame`].
    ///
    /// # Errors
    /// [`Error::Invalid`] in a parallel beam, and if the file states other poses.
    pub fn with_poses(self, poses: &[Pose]) -> Result<Self> {
        if matches!(self.scanner.beam, Beam::Parallel { .. }) || self.motion != Motion::Circle {
            let got = if self.motion == Motion::Circle { "a parallel beam" } else { "other poses in the description" };
            return Err(Error::invalid("poses", got, "a cone beam without other poses", "correct the description"));
        }
        let scale = self.frame.scale;
        let scaled = |pose: &Pose| Pose { source: pose.source * scale, centre: pose.centre * scale, ..*pose };
        let poses: Vec<Pose> = poses.iter().map(scaled).collect();
        let listed = poses.iter().map(Pose::angle).collect();
        Ok(Self { listed, arc: None, motion: Motion::Poses(poses), ..self })
    }

    /// Poses of training views at `angles` (radians); `None` for a circle.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the file states poses for another number of views, or impossible ones.
    pub fn poses(&self, angles: &[f64]) -> Result<Option<Vec<Pose>>> {
        if self.listed.is_empty() {
            self.motion.fits(angles.len(), 0)?;
        } else if self.motion != Motion::Circle && self.listed.len() != angles.len() {
            let expected = format!("{}, as many as the views with poses", self.listed.len());
            let remedy = "give one frame for each listed view, or a description without proj_train";
            return Err(Error::invalid("frames", angles.len(), expected, remedy));
        }
        let poses = self.motion.poses(0..angles.len(), angles);
        Trajectory { angles, poses: poses.as_deref() }.validate(&self.scanner)?;
        Ok(poses)
    }

    /// Angles of `views` views in radians: the listed ones, or else evenly spaced over the arc.
    ///
    /// The end of the arc is excluded.
    ///
    /// # Errors
    /// [`Error::Invalid`] if another number of views is listed, or neither views nor an arc is stated.
    pub fn angles(&self, views: usize) -> Result<Vec<f64>> {
        let got = match (self.listed.len(), self.arc) {
            (n, _) if n == views => return Ok(self.listed.clone()),
            (0, Some((start, span))) => return Ok(Scanner::uniform_angles(views, start, span)),
            (0, None) => "neither proj_train nor totalAngle".into(),
            (n, _) => format!("{} in proj_train", counted(n, "view")),
        };
        let expected =
            format!("an angle for each of {}, or totalAngle and startAngle in degrees", counted(views, "view"));
        Err(Error::invalid(
            "angles",
            got,
            expected,
            "add totalAngle and startAngle to the scanner's meta_data.json, or give one angle per view",
        ))
    }
}

/// Reads the scanner of a dataset in scene units, without any projection.
///
/// `path` is the folder, its `meta_data.json`, or a `.pickle` of NAF.
///
/// # Errors
/// [`Error::Read`] for a file that cannot be read, [`Error::Format`] for content that is wrong.
pub fn read_scanner(path: impl AsRef<Path>) -> Result<Scanner> {
    Ok(Description::read(path)?.scanner)
}

/// Reads the scanner of a dataset, and poses of views at `angles` (radians) if the scan is no circle.
///
/// `path` is as for [`read_scanner`]. A deviation from the circle that all views share holds at any angle.
///
/// # Errors
/// Those of [`read_scanner`], and for a scan whose views have poses of their own.
pub fn read_at_angles(path: impl AsRef<Path>, angles: &[f64]) -> Result<(Scanner, Option<Vec<Pose>>)> {
    let path = path.as_ref();
    let description = Description::read(path)?;
    if description.motion.is_of_single_views() {
        let expected = "the views of the scan: each has a pose of its own";
        let error =
            Error::invalid("angles", counted(angles.len(), "angle"), expected, "choose a split instead of angles");
        return Err(error.in_file(path));
    }
    let poses = description.motion.poses(0..angles.len(), angles);
    Trajectory { angles, poses: poses.as_deref() }
        .validate(&description.scanner)
        .map_err(|error| error.in_file(path))?;
    Ok((description.scanner, poses))
}

impl Dataset {
    /// A scan of training views in scene units, without noise, test views and truth.
    pub fn new(name: impl Into<String>, scanner: Scanner, train: Projections) -> Self {
        Self {
            name: name.into(),
            scanner,
            scale: 1.0,
            frame: Frame::default(),
            noise: Noise::None,
            train,
            test: None,
            truth: None,
            initial_points: None,
            notes: Vec::new(),
            oddities: Vec::new(),
        }
    }

    /// A scan with these training views alone, without test views and truth.
    pub fn of_views(&self, views: &[usize]) -> Self {
        self.of(self.scanner, self.train.select(views))
    }

    /// The training views with another grid; without test views and truth.
    #[must_use]
    pub fn on(&self, grid: Grid) -> Self {
        self.of(Scanner { grid, ..self.scanner }, self.train.clone())
    }

    /// The training views with pixels and voxels `factor` times as long, averaged; without test views and truth.
    #[must_use]
    pub fn coarser(&self, factor: usize) -> Self {
        let scanner = self.scanner.coarser(factor);
        self.of(scanner, self.train.averaged(scanner.detector.rows, scanner.detector.columns))
    }

    /// Other training views of the same object.
    fn of(&self, scanner: Scanner, train: Projections) -> Self {
        Self {
            scale: self.scale,
            frame: self.frame,
            noise: self.noise,
            initial_points: self.initial_points.clone(),
            ..Self::new(self.name.as_str(), scanner, train)
        }
    }

    /// Reads a dataset; `path` is the folder, its `meta_data.json`, or a `.pickle` of NAF.
    ///
    /// # Errors
    /// [`Error::Read`] or [`Error::Format`] for the first file that is missing, damaged or does not fit the scanner, and
    /// for values that are not finite.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        Self::read_path(path.as_ref())
    }

    fn read_path(path: &Path) -> Result<Self> {
        if naf::is_pickle(path) {
            return naf::read(path);
        }
        let meta_path = meta_path(path);
        let meta = Meta::read(&meta_path)?;
        let meta::Interpreted { scanner, scale, frame, noise, motion, mut oddities } = meta.interpret(&meta_path)?;
        let folder = meta_path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let name = folder.canonicalize().ok().and_then(|f| Some(f.file_name()?.to_string_lossy().into_owned()));
        let name = name.unwrap_or_else(|| "scan".into());

        if meta.proj_train.is_empty() {
            return Err(Error::format(&meta_path, "proj_train", "no view", "at least one", "list the projections"));
        }
        if meta.vol.is_none() && meta.ct.is_some() {
            oddities.push("the volume is listed as `ct`; R²-Gaussian's own reader only knows `vol`".into());
        }
        oddities.extend(paths::remarks(&meta));

        let mut read = |views: &[ViewMeta], first: usize| -> Result<Projections> {
            let angles = angles(views, &motion, first);
            let poses = motion.poses(first..first + views.len(), &angles);
            if let (Motion::Poses(_), Some(poses)) = (&motion, &poses) {
                oddities.extend(poses::angles_differ(&angles, poses));
            }
            let trajectory = Trajectory { angles: &angles, poses: poses.as_deref() };
            trajectory.validate(&scanner).map_err(|error| error.in_file(&meta_path))?;
            read_views(folder, &meta_path, views, &scanner, scale, trajectory, &mut oddities)
        };
        let train = read(&meta.proj_train, 0)?;
        let test = match meta.proj_test.as_slice() {
            [] => None,
            views => Some(read(views, meta.proj_train.len())?),
        };
        let truth = meta.vol.as_ref().or(meta.ct.as_ref());
        let truth = truth.map(|file| read_volume(&folder.join(file), &scanner, &frame, &mut oddities));
        let initial_points = find_points(folder, &name, &mut oddities)?.map(|path| read_points(&path));
        Ok(Self {
            name,
            scanner,
            scale,
            frame,
            noise,
            train,
            test,
            truth: truth.transpose()?,
            initial_points: initial_points.transpose()?,
            notes: meta.notes,
            oddities,
        })
    }

    /// Reads a scan from the content of a pickle of NAF; `path` names it in errors.
    ///
    /// # Errors
    /// [`Error::Format`] for anything but the data of a scan.
    pub fn parse_pickle(content: &[u8], path: &Path) -> Result<Self> {
        naf::parse(content, path)
    }

    /// Writes the dataset in scene units as the folder `folder`, which appears completely or not at all.
    ///
    /// [`Destination::check`] describes which older folder is replaced; a path stands for a destination of the library.
    ///
    /// # Errors
    /// [`Error::Write`], or [`Error::Invalid`] when the folder holds other files.
    pub fn write(&self, destination: impl Into<Destination>) -> Result<()> {
        self.write_to(destination.into().of(Kind::Scan))
    }

    fn write_to(&self, destination: Destination) -> Result<()> {
        let folder = destination.folder().to_owned();
        let staged = stage_folder(destination)?;
        let at = |file: &str| staged.path().join(file);
        let views = |name: &str, projections: Option<&Projections>| -> Result<Vec<ViewMeta>> {
            let Some(projections) = projections else { return Ok(Vec::new()) };
            create_folder(&at(name))?;
            let mut list = Vec::new();
            for (i, &angle) in projections.angles.iter().enumerate() {
                let file_path = format!("{name}/{name}_{i:04}.npy");
                npy::write(&at(&file_path), projections.image(i))?;
                let pose = projections.poses.as_ref().map(|poses| poses::to_vector(&self.scanner, &poses[i]));
                list.push(ViewMeta::new(file_path, angle, pose));
            }
            Ok(list)
        };
        let vol = match &self.truth {
            Some(volume) => {
                npy::write(&at("vol_gt.npy"), volume.values.view())?;
                Some("vol_gt.npy".into())
            }
            None => None,
        };
        if let Some(points) = &self.initial_points {
            let name = folder.file_name().map_or_else(|| self.name.clone(), |name| name.to_string_lossy().into_owned());
            npy::write(&at(&format!("init_{name}.npy")), points.view())?;
        }
        let meta = Meta::new(
            ScannerMeta::describe(&self.scanner, &self.train.angles, self.noise),
            vol,
            [self.scanner.grid.min.to_array(), self.scanner.grid.max().to_array()],
            [views("proj_train", Some(&self.train))?, views("proj_test", self.test.as_ref())?],
            self.notes.clone(),
            &self.frame,
        );
        meta.write(&at("meta_data.json"))?;
        staged.commit()
    }
}

/// Angles of views, radians; those of the poses where none are stated.
fn angles(views: &[ViewMeta], motion: &Motion, first: usize) -> Vec<f64> {
    let of_pose = |number: usize| match motion {
        Motion::Poses(poses) => poses[first + number].angle(),
        Motion::Circle | Motion::Deviations(_) => 0.0,
    };
    views.iter().enumerate().map(|(number, view)| view.angle.unwrap_or_else(|| of_pose(number))).collect()
}

/// Path of the description, given the folder or the description itself.
fn meta_path(path: &Path) -> PathBuf {
    if path.is_dir() { path.join("meta_data.json") } else { path.into() }
}

fn read_views(
    folder: &Path,
    meta: &Path,
    views: &[ViewMeta],
    scanner: &Scanner,
    scale: f64,
    trajectory: Trajectory<'_>,
    oddities: &mut Vec<String>,
) -> Result<Projections> {
    let (rows, columns) = (scanner.detector.rows, scanner.detector.columns);
    let mut values = Vec::new();
    for view in views {
        let path = folder.join(&view.file_path);
        let image = files::read_image(&path, oddities)?;
        if image.dim() != (rows, columns) {
            return Err(Error::format(
                &path,
                "projection",
                format!("shape {:?}", image.shape()),
                format!("[{rows}, {columns}] = nDetector = [v, u]"),
                "correct nDetector = [v, u], or transpose the projections to [v, u]",
            ));
        }
        // Rounding once, from f64, keeps a scale of 1 exact.
        let image = image.mapv(|value| (f64::from(value) * scale) as f32);
        check_finite(&path, "projection", image.view())?;
        if values.is_empty() {
            // The first file has what the detector promised.
            let what = format!("{} of shape [{rows}, {columns}]", counted(views.len(), "view"));
            let size = views.len().saturating_mul(rows * columns);
            values = limit::room(what, size).map_err(|error| error.in_file(meta))?;
        }
        values.extend(image);
    }
    let images =
        Array3::from_shape_vec((views.len(), rows, columns), values).expect("every image has the detector's shape");
    Projections::along(trajectory, images).map_err(|error| error.in_file(meta))
}

fn read_volume(path: &Path, scanner: &Scanner, frame: &Frame, oddities: &mut Vec<String>) -> Result<Volume> {
    let values = files::read_values(path, &scanner.grid, frame, oddities)?;
    check_finite(path, "volume", values.view())?;
    Volume::new(scanner.grid, values).map_err(|error| error.in_file(path))
}

fn read_points(path: &Path) -> Result<Array2<f64>> {
    let points = npy::read_f64::<Ix2>(path, "[M, 4] = x, y, z, density")?;
    if points.ncols() != 4 {
        let got = format!("shape {:?}", points.shape());
        return Err(Error::format(
            path,
            "initial points",
            got,
            "[M, 4] = x, y, z, density",
            "write them again in this shape, or delete the file",
        ));
    }
    check_finite(path, "initial points", points.view())?;
    Ok(points)
}

/// `init_<name>.npy`, or the only other `init_*.npy`.
fn find_points(folder: &Path, name: &str, oddities: &mut Vec<String>) -> Result<Option<PathBuf>> {
    let failed = |source| Error::read(folder, source);
    let mut found = Vec::new();
    for entry in folder.read_dir().map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let file = entry.file_name().to_string_lossy().into_owned();
        if file.starts_with("init_") && file.ends_with(".npy") && entry.path().is_file() {
            found.push(file);
        }
    }
    found.sort();
    let own = format!("init_{name}.npy");
    let chosen = found.iter().find(|file| **file == own).or(found.first());
    if let (Some(chosen), true) = (chosen, found.len() > 1) {
        oddities.push(format!("{} files with initial points: {chosen} is used", found.len()));
    }
    Ok(chosen.map(|file| folder.join(file)))
}

/// Returns an error that names the file and its first value that is not finite.
fn check_finite<T: Copy + Into<f64>, D: Dimension>(path: &Path, what: &str, values: ArrayView<'_, T, D>) -> Result<()> {
    let finite = |value: &T| -> bool { (*value).into().is_finite() };
    match values.indexed_iter().find(|(_, value)| !finite(value)) {
        None => Ok(()),
        Some((index, value)) => {
            let got = format!("{} at index {index:?}", (*value).into());
            let remedy = "remove the damaged views, or copy the file again: values are never guessed";
            Err(Error::format(path, what, got, "finite numbers only", remedy))
        }
    }
}

#[cfg(test)]
mod pose_tests;
#[cfg(test)]
mod tests;
