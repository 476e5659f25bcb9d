//! Volumes of which slabs are read, so that a volume may be larger than memory.

use super::folder::{Slices, files};
use super::header::{LARGEST, surplus};
use super::plain::Plain;
use super::{Format, NpySide, VolumeFile, meta_image, nifti, nrrd, raw, read_in_any_order};
use crate::npy::{self, Stream};
use crate::{input, limit};
use ndarray::{Array3, Axis, Slice};
use std::io::Read;
use std::ops::Range;
use std::path::Path;
use trgs_core::error::{Error, Result};

/// Values of a slab, bytes.
const SLAB: u64 = 64 << 20;
/// Values of a slab that is copied from memory, bytes.
const COPY: u64 = 4 << 20;
/// Values of a slab across the fastest axis of a file, bytes: all of the file is read for each.
const CROSSING: u64 = 1 << 30;
/// Part of the limit on memory for the values of a slab: they are copied, and two volumes may be compared.
const PART: u64 = 4;
/// Axes in the order of the file.
const IN_ORDER: [(usize, bool); 3] = [(0, false), (1, false), (2, false)];

enum Numbers {
    Memory(Array3<f32>),
    File(Plain),
    /// One slice across z in each file, and the shape `[x, y, z]`.
    Folder(Slices, [usize; 3]),
}

/// A volume of which slabs are read: from a file of plain numbers, from the files of its slices where they are many, else
/// from memory.
pub struct Stored {
    metadata: VolumeFile,
    numbers: Numbers,
    /// For each axis of the volume: the axis of the numbers, and whether it is reversed.
    axes: [(usize, bool); 3],
    /// What the numbers are multiplied by.
    factor: f64,
    /// Most slices of a slab.
    pub(super) most: usize,
}

impl From<VolumeFile> for Stored {
    fn from(volume: VolumeFile) -> Self {
        Self::new(VolumeFile { values: Array3::default((0, 0, 0)), ..volume }, Numbers::Memory(volume.values))
    }
}

/// Opens a volume; the format follows from the name.
///
/// Sizes are checked against the length of the file. Values are read here only where they are compressed, text, or in
/// several files; those of a folder of slices are read again slab by slab where they are more than 1 GiB or a quarter of the
/// limit on memory.
///
/// # Errors
/// Those of [`read`](super::read()).
pub fn open(path: impl AsRef<Path>) -> Result<Stored> {
    let path = path.as_ref();
    let found = if path.is_dir() { of_folder(path, in_memory())? } else { of_file(path)? };
    match found {
        Some(stored) => Ok(stored),
        None => read_in_any_order(path).map(Stored::from),
    }
}

/// The largest volume of several passes that is kept in memory, bytes.
fn in_memory() -> u64 {
    CROSSING.min(limit::bytes() / PART)
}

/// Bytes of the values of a volume.
fn bytes(shape: [usize; 3]) -> u64 {
    shape.iter().fold(size_of::<f32>() as u64, |size, &n| size.saturating_mul(n as u64))
}

/// A volume of more than `least` bytes in the slices of a folder.
fn of_folder(path: &Path, least: u64) -> Result<Option<Stored>> {
    let Some(slices) = Slices::among(&files(path)?) else { return Ok(None) };
    let shape = slices.shape()?;
    if bytes(shape) <= least {
        return Ok(None);
    }
    Ok(Some(Stored::new(slices.metadata()?, Numbers::Folder(slices, shape))))
}

/// A volume of plain numbers in one file.
fn of_file(path: &Path) -> Result<Option<Stored>> {
    if !path.is_file() {
        return Ok(None);
    }
    let format = Format::of(path)?;
    if ![Format::Npy, Format::MetaImage, Format::Nrrd, Format::Nifti, Format::Raw].contains(&format) {
        return Ok(None);
    }
    let failed = |source| Error::read(path, source);
    let mut file = input::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    if format == Format::Npy {
        let stream = Stream::begin(&mut file, length, path, "file")?;
        // The reader of whole arrays says which axes are expected.
        let Ok(shape) = <[usize; 3]>::try_from(stream.shape()) else { return Ok(None) };
        if shape.contains(&0) {
            return Ok(None);
        }
        let metadata = NpySide::beside(path, shape)?;
        let (start, x_is_fastest, item) = (stream.start, stream.is_fortran(), stream.item);
        let values = Box::new(move |bytes: &[u8]| {
            Ok(stream.values(bytes, bytes.len() / item)?.0.into_f32().into_raw_vec_and_offset().0)
        });
        let plain = Plain { file, path: path.into(), start, shape, x_is_fastest, item, values };
        return Ok(Some(Stored::new(metadata, Numbers::File(plain))));
    }
    let mut head = Vec::new();
    // A byte more than a header may have.
    (&file).take(LARGEST as u64 + 1).read_to_end(&mut head).map_err(failed)?;
    let size = usize::try_from(length).unwrap_or(usize::MAX);
    let described = match format {
        Format::MetaImage => meta_image::describe(&head, path),
        Format::Nrrd => nrrd::describe(&head, path),
        Format::Nifti => nifti::describe(&head, size, path),
        _ => raw::describe(size, path),
    };
    let (mut metadata, numbers) = match described {
        // A list of files may go on after the beginning.
        Err(_) if size > head.len() && [Format::MetaImage, Format::Nrrd].contains(&format) => return Ok(None),
        described => described?,
    };
    let Some((plain, has_more)) = numbers.plain(path, file)? else { return Ok(None) };
    metadata.oddities.extend(surplus(has_more));
    Ok(Some(Stored::new(metadata, Numbers::File(plain))))
}

impl Stored {
    fn new(metadata: VolumeFile, numbers: Numbers) -> Self {
        Self { metadata, numbers, axes: IN_ORDER, factor: 1.0, most: usize::MAX }
    }

    /// The volume without its values.
    pub fn metadata(&self) -> &VolumeFile {
        &self.metadata
    }

    /// `[x, y, z]`.
    pub fn shape(&self) -> [usize; 3] {
        let shape = self.numbers_shape();
        self.axes.map(|(axis, _)| shape[axis])
    }

    fn numbers_shape(&self) -> [usize; 3] {
        match &self.numbers {
            Numbers::Memory(values) => values.dim().into(),
            Numbers::File(plain) => plain.shape,
            Numbers::Folder(_, shape) => *shape,
        }
    }

    /// The volume with other metadata, axes and values: for each axis that of the numbers and whether it is reversed.
    pub(crate) fn turned(self, metadata: VolumeFile, axes: [(usize, bool); 3], factor: f64) -> Self {
        Self { metadata, axes, factor, ..self }
    }

    /// The same volume in memory, where memory allows; its file is then read once for several passes over slabs.
    ///
    /// # Errors
    /// Those of [`Self::slab`].
    pub fn kept(mut self) -> Result<Self> {
        let shape = self.shape();
        if matches!(self.numbers, Numbers::Memory(_)) || bytes(shape) > in_memory() {
            return Ok(self);
        }
        let values = self.slab(0, 0..shape[0])?;
        Ok(Self { most: self.most, ..VolumeFile { values, ..self.metadata }.into() })
    }

    /// The axis across which slabs are read with the fewest bytes.
    pub fn slowest(&self) -> usize {
        let of_numbers = match &self.numbers {
            Numbers::Memory(_) | Numbers::File(Plain { x_is_fastest: false, .. }) => 0,
            _ => 2,
        };
        self.axes.iter().position(|(axis, _)| *axis == of_numbers).expect("axes are a permutation")
    }

    /// Whether memory allows so many bytes of a file.
    fn allow(&self, what: String, bytes: u64) -> Result<()> {
        let path = match &self.numbers {
            Numbers::Memory(_) => return Ok(()),
            Numbers::File(plain) => &plain.path,
            Numbers::Folder(slices, _) => &slices.paths[0],
        };
        limit::allow(what, bytes).map_err(|error| error.in_file(path))
    }

    /// Slices of a slab across an axis, as memory allows.
    ///
    /// # Errors
    /// [`Error::Memory`] where it does not allow one.
    pub fn thickness(&self, axis: usize) -> Result<usize> {
        let shape = self.shape();
        let slice = (0..3).filter(|&other| other != axis).fold(4_u64, |size, i| size.saturating_mul(shape[i] as u64));
        let of_numbers = self.axes[axis].0;
        let most = match &self.numbers {
            Numbers::Memory(_) => COPY,
            Numbers::File(plain) if of_numbers == if plain.x_is_fastest { 0 } else { 2 } => CROSSING,
            Numbers::Folder(..) if of_numbers != 2 => CROSSING,
            _ => SLAB,
        };
        self.allow(format!("slices of shape {shape:?}"), slice.saturating_mul(PART))?;
        let count = most.min(limit::bytes() / PART) / slice.max(1);
        Ok(usize::try_from(count).unwrap_or(usize::MAX).clamp(1, self.most))
    }

    /// The values `[x, y, z]` of some slices across an axis.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for a file that was cut since it was opened.
    pub fn slab(&mut self, axis: usize, slices: Range<usize>) -> Result<Array3<f32>> {
        let (of_numbers, is_reversed) = self.axes[axis];
        let mut ranges = self.numbers_shape().map(|n| 0..n);
        let n = ranges[of_numbers].end;
        ranges[of_numbers] = if is_reversed { n - slices.end..n - slices.start } else { slices };
        let values = match &mut self.numbers {
            Numbers::Memory(values) => {
                values.slice_axis(Axis(of_numbers), Slice::from(ranges[of_numbers].clone())).to_owned()
            }
            Numbers::File(plain) => {
                plain.read(ranges).map_err(|source| npy::unreadable(source, &plain.path, "file"))?
            }
            Numbers::Folder(slices, _) => slices.part(ranges)?,
        };
        Ok(turned(values, self.axes, self.factor))
    }

    /// Gives the slabs across an axis to `put`, with the number of their first slices.
    ///
    /// # Errors
    /// Those of [`Self::thickness`], [`Self::slab`] and `put`.
    pub fn each(&mut self, axis: usize, mut put: impl FnMut(usize, Array3<f32>) -> Result<()>) -> Result<()> {
        let (count, thickness) = (self.shape()[axis], self.thickness(axis)?);
        (0..count).step_by(thickness).try_for_each(|first| {
            let slab = self.slab(axis, first..count.min(first.saturating_add(thickness)))?;
            put(first, slab)
        })
    }

    /// The volume in memory.
    ///
    /// # Errors
    /// [`Error::Memory`], and those of [`Self::slab`].
    pub fn whole(mut self) -> Result<VolumeFile> {
        let shape = self.shape();
        // The values, and their copy in another order.
        self.allow(format!("volume of shape {shape:?}"), bytes(shape).saturating_mul(2))?;
        let values = match self.numbers {
            Numbers::Memory(values) => turned(values, self.axes, self.factor),
            _ => self.slab(0, 0..shape[0])?,
        };
        Ok(VolumeFile { values, ..self.metadata }.in_order())
    }
}

/// An array with its axes exchanged or reversed, and its values multiplied.
pub(crate) fn turned(mut values: Array3<f32>, axes: [(usize, bool); 3], factor: f64) -> Array3<f32> {
    if axes != IN_ORDER {
        values = values.permuted_axes(axes.map(|(axis, _)| axis));
        for (axis, _) in axes.iter().enumerate().filter(|(_, (_, is_reversed))| *is_reversed) {
            values.invert_axis(Axis(axis));
        }
        values = values.as_standard_layout().into_owned();
    }
    if factor == 1.0 { values } else { values.mapv_into(|value| (f64::from(value) * factor) as f32) }
}

#[cfg(test)]
mod tests;
