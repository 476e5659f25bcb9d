//! Scanned objects: the fifteen stand-ins, or the volumes and scans of a folder.

use super::scale::Scale;
use crate::error::{Error, Result};
use crate::provenance::{digest_bytes, digest_file, digests};
use crate::scene::phantom::PHANTOMS;
use crate::scene::simulate::{Object, Plan, simulate};
use crate::scene::{Dataset, Grid, Noise, Phantom, Scanner, Volume, volume_file};
use crate::setting::Setting;
use ndarray::Array3;
use std::path::{Path, PathBuf};

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
    Scan(PathBuf),
}

/// The acquisition of a case in a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Acquisition {
    pub(super) views: usize,
    pub(super) noise: Noise,
    pub(super) seed: u64,
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

    /// All scans in a folder, and its volumes whose longest side has `size` voxels, ordered by name.
    ///
    /// If no volume has that size, those whose longest side is a multiple of it are used. Other volumes and files that
    /// are no volumes are skipped.
    ///
    /// # Errors
    /// When the folder cannot be read, or holds nothing usable.
    pub fn in_folder(folder: &Path, size: usize) -> Result<Vec<Self>> {
        let entries = folder.read_dir().map_err(|source| Error::read(folder, source))?;
        let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        paths.sort();
        let (mut cases, mut volumes) = (Vec::new(), Vec::new());
        for path in paths {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let description = path.join("meta_data.json");
            if description.exists() {
                let files: Vec<String> = digests(&path)?.into_values().collect();
                cases.push(Self { name, digest: digest_bytes(files.concat().as_bytes()), source: Source::Scan(path) });
            } else if path.is_file() && volume_file::is_volume(&path) {
                let Ok(volume) = volume_file::read(&path) else { continue };
                volumes.push((longest(&volume.values), name, path));
            }
        }
        let side = volumes.iter().map(|(side, ..)| *side).find(|side| *side > 0);
        let fits = |multiple: bool| move |side: usize| if multiple { side.is_multiple_of(size) } else { side == size };
        let fits = fits(volumes.iter().all(|(side, ..)| *side != size));
        for (_, name, path) in volumes.into_iter().filter(|(side, ..)| *side > 0 && fits(*side)) {
            cases.push(Self { name, digest: digest_file(&path)?, source: Source::Volume(path) });
        }
        if cases.is_empty() {
            let got = format!("{}, which holds none", folder.display());
            let expected = format!("a folder with scans, or with volumes whose longest side is a multiple of {size}");
            let remedy = match side {
                Some(side) => format!("give {} {side}, the side of a volume there, or another folder", Setting::Size),
                None => format!("choose another folder or another {}", Setting::Size),
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
        match &self.source {
            Source::Phantom => {
                let phantom = Phantom::by_name(&self.name, 0)?;
                simulate(&self.name, Object::Phantom(&phantom), &scanner(scale, Grid::cube(scale.size)), &plan)
            }
            Source::Volume(path) => {
                let volume = normalised(path, scale.size)?;
                simulate(&self.name, Object::Volume(&volume), &scanner(scale, volume.grid), &plan)
            }
            Source::Scan(path) => {
                let mut dataset = Dataset::read(path)?;
                dataset.train = dataset.train.evenly_spaced(acquisition.views)?;
                Ok(dataset)
            }
        }
    }
}

fn scanner(scale: Scale, grid: Grid) -> Scanner {
    Scanner { grid, ..Scanner::synthetic(scale.size, scale.detector()) }
}

/// A volume with cubic voxels, averaged over blocks, and densities scaled to at most 1.
fn normalised(path: &Path, size: usize) -> Result<Volume> {
    let fine = volume_file::read(path)?.values;
    let factor = longest(&fine) / size;
    let shape: [usize; 3] = <[usize; 3]>::from(fine.dim()).map(|n| n / factor);
    let top = fine.iter().fold(0.0_f32, |top, &value| top.max(value));
    if top <= 0.0 || shape.contains(&0) {
        let expected = "a volume with positive values, at least as thick as one voxel of the result";
        return Err(Error::format(path, "volume", format!("shape {shape:?}, maximum {top}"), expected, "leave it out"));
    }
    let voxels = (factor * factor * factor) as f32 * top;
    let values = Array3::from_shape_fn(shape, |(x, y, z)| {
        let part = |i: usize| {
            let (dx, dy, dz) = (i / (factor * factor), i / factor % factor, i % factor);
            fine[[x * factor + dx, y * factor + dy, z * factor + dz]]
        };
        (0..factor * factor * factor).map(part).sum::<f32>() / voxels
    });
    let sides = glam::DVec3::from_array(shape.map(|n| n as f64));
    let corner = sides / sides.max_element();
    Volume::new(Grid::new(shape, -corner, corner)?, values).map_err(|error| error.in_file(path))
}

fn longest(values: &Array3<f32>) -> usize {
    values.shape().iter().copied().max().unwrap_or(0)
}
