//! Scanned objects: the fifteen stand-ins, or the volumes and scans of a folder.

use super::conditions::{Conditions, Rays};
use super::scale::Scale;
use crate::classical::RayModel;
use crate::error::{Error, Result};
use crate::geometry::{Grid, Scanner, Volume};
use crate::input;
use crate::provenance::{digest_bytes, digest_file};
use crate::scan::chain::Chain;
use crate::scan::phantom::PHANTOMS;
use crate::scan::simulate::{Object, Orbit, Plan, simulate, simulate_measured};
use crate::scan::{Dataset, Noise, Phantom, volume_file};
use crate::setting::Setting;
use ndarray::{Array3, Slice};
use std::path::{Path, PathBuf};

/// Points along each axis of a voxel, for the mean density of a phantom.
const SAMPLES: usize = 4;

/// An object to scan, or an existing scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Name for display.
    pub name: String,
    /// SHA-256 of its data; for a phantom, which is part of the program, its name.
    pub digest: String,
    source: Source,
}

#[derive(Clone, Debug, PartialEq)]
enum Source {
    Phantom,
    Volume(PathBuf),
    /// The middle of a larger volume.
    Middle(PathBuf),
    Scan(PathBuf),
}

/// Scans and volumes of a folder, ordered by name.
struct Contents {
    scans: Vec<(String, PathBuf)>,
    volumes: Vec<Stored>,
}

/// A volume in a file.
struct Stored {
    name: String,
    path: PathBuf,
    /// Voxels along the longest side.
    side: usize,
}

impl Contents {
    fn of(folder: &Path) -> Result<Self> {
        let entries = folder.read_dir().map_err(|source| Error::read(folder, source))?;
        let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        paths.sort();
        let (mut scans, mut volumes) = (Vec::new(), Vec::new());
        for path in paths {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            if path.join("meta_data.json").exists() {
                scans.push((name, path));
            } else if path.is_file() && volume_file::is_volume(&path) {
                let Ok(volume) = volume_file::read(&path) else { continue };
                volumes.push(Stored { name, side: longest(&volume.values), path });
            }
        }
        Ok(Self { scans, volumes })
    }
}

/// The acquisition of a case in a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Acquisition {
    pub(super) views: usize,
    pub(super) noise: Noise,
    pub(super) seed: u64,
    pub(super) conditions: Conditions,
}

impl Case {
    /// The fifteen stand-ins for the paper's cases.
    pub fn stand_ins() -> Vec<Self> {
        let named = PHANTOMS.into_iter().filter(|phantom| phantom.group.is_some());
        named.map(|p| Self { name: p.name.into(), digest: p.name.into(), source: Source::Phantom }).collect()
    }

    /// The stand-in with a name.
    ///
    /// # Errors
    /// For an unknown name.
    pub fn phantom(name: &str) -> Result<Self> {
        Phantom::by_name(name, 0)?;
        Ok(Self { name: name.into(), digest: name.into(), source: Source::Phantom })
    }

    /// The volumes in a folder whose longest side has more than `size` voxels, ordered by name; of each the middle cube.
    ///
    /// Scans, smaller volumes and files that are no volumes are skipped.
    ///
    /// # Errors
    /// When the folder cannot be read, or holds nothing usable.
    pub fn middles_in_folder(folder: impl AsRef<Path>, size: usize) -> Result<Vec<Self>> {
        let folder = folder.as_ref();
        let Contents { volumes, .. } = Contents::of(folder)?;
        let larger = volumes.iter().filter(|volume| volume.side > size);
        let cases: Vec<Self> = larger
            .map(|Stored { name, path, .. }| {
                let digest = format!("middle of {}", digest_file(path)?);
                Ok(Self { name: format!("{name}-middle"), digest, source: Source::Middle(path.clone()) })
            })
            .collect::<Result<_>>()?;
        if cases.is_empty() {
            let got = format!("{}, which holds none", folder.display());
            let expected = format!("a folder with volumes whose longest side has more than {size} voxels");
            let remedy = match volumes.iter().map(|volume| volume.side).max() {
                Some(side) if side > 8 => {
                    "give " + Setting::Crop + format!(" a number below {side}, or another folder")
                }
                _ => "choose another folder".into(),
            };
            return Err(Error::invalid(Setting::Data, got, expected, remedy));
        }
        Ok(cases)
    }

    /// All scans in a folder, and its volumes whose longest side has `size` voxels, ordered by name.
    ///
    /// If no volume has that size, those whose longest side is a multiple of it are used. Other volumes and files that
    /// are no volumes are skipped.
    ///
    /// # Errors
    /// When the folder cannot be read, or holds nothing usable.
    pub fn in_folder(folder: impl AsRef<Path>, size: usize) -> Result<Vec<Self>> {
        let folder = folder.as_ref();
        let Contents { scans, volumes } = Contents::of(folder)?;
        let mut cases = Vec::new();
        for (name, path) in scans {
            let (_, files) = input::digests_of(|| Dataset::read(&path))?;
            let files: Vec<String> = files.into_values().collect();
            cases.push(Self { name, digest: digest_bytes(files.concat().as_bytes()), source: Source::Scan(path) });
        }
        let side = volumes.iter().map(|volume| volume.side).find(|side| *side > 0);
        let fits = |multiple: bool| move |side: usize| if multiple { side.is_multiple_of(size) } else { side == size };
        let fits = fits(volumes.iter().all(|volume| volume.side != size));
        for Stored { name, path, .. } in volumes.into_iter().filter(|volume| volume.side > 0 && fits(volume.side)) {
            cases.push(Self { name, digest: digest_file(&path)?, source: Source::Volume(path) });
        }
        if cases.is_empty() {
            let got = format!("{}, which holds none", folder.display());
            let expected = format!("a folder with scans, or with volumes whose longest side is a multiple of {size}");
            let remedy = match side {
                Some(side) => {
                    "give " + Setting::Size + format!(" {side}, the side of a volume there, or another folder")
                }
                None => "choose another folder or another " + Setting::Size,
            };
            return Err(Error::invalid(Setting::Data, got, expected, remedy));
        }
        Ok(cases)
    }

    /// Whether noise can be chosen; false for an existing scan.
    pub fn takes_noise(&self) -> bool {
        !matches!(self.source, Source::Scan(_))
    }

    /// The scan of a cell.
    ///
    /// Phantoms and volumes are scanned by a cone beam over a full turn, with the distances of R²-Gaussian's synthetic
    /// data. Of an existing scan, evenly spaced training views are selected.
    pub(super) fn scan(&self, scale: Scale, acquisition: &Acquisition) -> Result<Dataset> {
        let plan = Plan {
            views: acquisition.views,
            test_views: scale.test_views(),
            noise: acquisition.noise,
            seed: acquisition.seed,
        };
        let scanned = |object: Object<'_>, grid: Grid| {
            let voxels = match object {
                Object::Phantom(phantom) => phantom.voxelize(&grid, SAMPLES),
                Object::Volume(volume) | Object::Voxels(volume, _) => volume.clone(),
            };
            let object = match acquisition.conditions.rays {
                Rays::Object => object,
                Rays::Siddon => Object::Voxels(&voxels, RayModel::Siddon.rays()),
            };
            let scanner = Scanner { grid, ..Scanner::synthetic(scale.size, scale.detector()) };
            if acquisition.conditions.realistic {
                return simulate_measured(&self.name, object, &scanner, &plan, &Orbit::CIRCLE, &Chain::default());
            }
            simulate(&self.name, object, &scanner, &plan)
        };
        match &self.source {
            Source::Phantom => {
                let phantom = Phantom::by_name(&self.name, 0)?;
                scanned(Object::Phantom(&phantom), Grid::cube(scale.size))
            }
            Source::Volume(path) => {
                let volume = normalised(path, scale.size)?;
                scanned(Object::Volume(&volume), volume.grid)
            }
            Source::Middle(path) => {
                let volume = middle(path, scale.size)?;
                scanned(Object::Volume(&volume), volume.grid)
            }
            Source::Scan(path) => {
                let mut dataset = Dataset::read(path)?;
                dataset.train = dataset.train.evenly_spaced(acquisition.views)?;
                Ok(dataset)
            }
        }
    }
}

/// The middle cube of a volume, `size` voxels along each side or all that there are, and densities scaled to at most 1.
fn middle(path: &Path, size: usize) -> Result<Volume> {
    let fine = volume_file::read(path)?.values;
    let shape: [usize; 3] = <[usize; 3]>::from(fine.dim()).map(|n| n.min(size));
    let part = |axis: usize| {
        let first = (fine.shape()[axis] - shape[axis]) / 2;
        first..first + shape[axis]
    };
    let values = fine.slice_each_axis(|axis| Slice::from(part(axis.axis.index()))).to_owned();
    let top = largest(&values);
    scaled(path, values, 1, top)
}

/// A volume with cubic voxels, averaged over blocks, and densities scaled to at most 1.
fn normalised(path: &Path, size: usize) -> Result<Volume> {
    let fine = volume_file::read(path)?.values;
    let factor = longest(&fine) / size;
    let shape = <[usize; 3]>::from(fine.dim()).map(|n| n / factor);
    let sums = Array3::from_shape_fn(shape, |(x, y, z)| {
        let part = |i: usize| {
            let (dx, dy, dz) = (i / (factor * factor), i / factor % factor, i % factor);
            fine[[x * factor + dx, y * factor + dy, z * factor + dz]]
        };
        (0..factor * factor * factor).map(part).sum::<f32>()
    });
    scaled(path, sums, factor * factor * factor, largest(&fine))
}

fn largest(values: &Array3<f32>) -> f32 {
    values.iter().fold(0.0_f32, |top, &value| top.max(value))
}

/// The volume of cubic voxels whose `sums` are those of so many voxels each, divided by the largest density `top`.
fn scaled(path: &Path, sums: Array3<f32>, voxels: usize, top: f32) -> Result<Volume> {
    let shape = <[usize; 3]>::from(sums.dim());
    if top <= 0.0 || shape.contains(&0) {
        let expected = "a volume with positive values, at least as thick as one voxel of the result";
        return Err(Error::format(path, "volume", format!("shape {shape:?}, maximum {top}"), expected, "leave it out"));
    }
    let values = sums / (voxels as f32 * top);
    let sides = glam::DVec3::from_array(shape.map(|n| n as f64));
    let corner = sides / sides.max_element();
    Volume::new(Grid::new(shape, -corner, corner)?, values).map_err(|error| error.in_file(path))
}

fn longest(values: &Array3<f32>) -> usize {
    values.shape().iter().copied().max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::npy;

    #[test]
    fn rays_see_the_object_or_its_voxels_and_a_chain_changes_what_trains_alone() {
        let scale = Scale::new(16, crate::experiments::Matching::Edge);
        let scan = |rays, realistic| {
            let conditions = Conditions { rays, realistic, ..Conditions::default() };
            let acquisition = Acquisition { views: 3, noise: Noise::None, seed: 5, conditions };
            Case::phantom("pepper").unwrap().scan(scale, &acquisition).unwrap()
        };
        let (object, voxels) = (scan(Rays::Object, false), scan(Rays::Siddon, false));
        assert_eq!(object.truth, voxels.truth);
        let of_truth = |scan: &Dataset| {
            let test = scan.test.as_ref().unwrap();
            (RayModel::Siddon.rays().project)(scan.truth.as_ref().unwrap(), &scan.scanner, test.trajectory()).unwrap()
        };
        assert_eq!(of_truth(&voxels).images, voxels.test.as_ref().unwrap().images);
        assert_ne!(of_truth(&object).images, object.test.as_ref().unwrap().images);
        let measured = scan(Rays::Siddon, true);
        assert_eq!((&measured.test, &measured.truth), (&voxels.test, &voxels.truth));
        assert_ne!(measured.train.images, voxels.train.images);
    }

    #[test]
    fn the_middle_of_a_volume_is_cut_out_and_scaled_by_its_own_maximum() {
        let folder = tempfile::tempdir().unwrap();
        // 100 x + 10 y + z, with the maximum of the whole outside of the middle; the second side is shorter than the cube.
        let values = Array3::from_shape_fn((9, 3, 10), |(x, y, z)| (100 * x + 10 * y + z) as f32);
        npy::write(&folder.path().join("thing.npy"), values.view()).unwrap();
        let [case] = &Case::middles_in_folder(folder.path(), 4).unwrap()[..] else { panic!() };
        let plain = &Case::in_folder(folder.path(), 10).unwrap()[0];
        assert!(case.name == "thing-middle" && plain.name == "thing" && case.digest != plain.digest);
        let cut = middle(&folder.path().join("thing.npy"), 4).unwrap();
        // x from 2 to 5, all y, z from 3 to 6.
        let expected = Array3::from_shape_fn((4, 3, 4), |(x, y, z)| (100 * (x + 2) + 10 * y + z + 3) as f32 / 526.0);
        assert_eq!(cut.values, expected);
        assert_eq!((cut.grid.shape, cut.grid.spacing), ([4, 3, 4], glam::DVec3::splat(0.5)));
        assert!(Case::middles_in_folder(folder.path(), 10).is_err(), "no larger volume");
    }
}
