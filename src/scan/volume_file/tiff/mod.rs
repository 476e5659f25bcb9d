//! TIFF: grey pages, several in one file or one in each file of a folder.
//!
//! Besides the pages with directories of their own, stacks of ImageJ and of Python's tifffile are read, whose single
//! directory is followed by the numbers of all pages. Spacing is read from ImageJ's tags and from OME-XML, in
//! millimetres. Numbers are read as stored where white is zero.

mod description;
mod directory;
mod rewrite;

use super::elements::{Defect, Element, Encoding, Layout, Number, Start};
use super::header::lossy;
use super::pages::Pages;
use super::{EachSlice, Place, VolumeFile, damaged, unsupported};
use crate::output::write_atomically;
use description::Description;
use directory::{Directory, Entry, Form};
use glam::DVec3;
use std::io::{self, Cursor, Seek, Write};
use std::path::Path;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::encoder::colortype::Gray32Float;
use tiff::encoder::{Rational, TiffEncoder, TiffKind};
use tiff::tags::{ResolutionUnit, Tag};
use tiff::{ColorType, TiffError, TiffResult};
use trgs_core::error::{Error, Result};

/// Largest expansion of a compressed byte: twelve bits of LZW for all of its four thousand codes.
const MOST_INFLATION: usize = 2731;
/// Array size in bytes from which BigTIFF is written; classic TIFF ends at 4 GiB, directories included.
const LARGE: usize = 4_000_000_000;

const KIND_OF_PAGE: u64 = 254;
const WIDTH: u64 = 256;
const HEIGHT: u64 = 257;
const BITS: u64 = 258;
const COMPRESSION: u64 = 259;
const PHOTOMETRIC: u64 = 262;
const DESCRIPTION: u64 = 270;
const OFFSETS: u64 = 273;
const ORIENTATION: u64 = 274;
const SAMPLES: u64 = 277;
const ROWS_PER_STRIP: u64 = 278;
const BYTE_COUNTS: u64 = 279;
const X_RESOLUTION: u64 = 282;
const Y_RESOLUTION: u64 = 283;
/// 2 where the numbers of a pixel are in planes of their own.
const PLANES: u64 = 284;
const TILE_WIDTH: u64 = 322;
const TILE_HEIGHT: u64 = 323;
const TILE_OFFSETS: u64 = 324;
const TILE_BYTE_COUNTS: u64 = 325;
const FORMAT_OF_SAMPLES: u64 = 339;
/// Compression by LZW.
const LZW: u64 = 5;
/// Compression by Zstandard.
const ZSTD: u64 = 50_000;
/// Names of compressions that are not read.
const OTHER_COMPRESSIONS: [(u64, &str); 10] = [
    (2, "CCITT"),
    (3, "CCITT fax 3"),
    (4, "CCITT fax 4"),
    (6, "old JPEG"),
    (7, "JPEG"),
    (33_003, "JPEG 2000"),
    (34_712, "JPEG 2000"),
    (34_887, "LERC"),
    (34_925, "LZMA"),
    (50_001, "WebP"),
];
/// The bit of a page that is a smaller copy of another one, and that of a mask.
const NO_PAGE: u64 = 1 | 4;

pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    let mut pages = Pages::default();
    add_all(content, path, &mut pages)?;
    Ok(pages.volume())
}

/// The first entry with a tag.
fn first(directory: &Directory, tag: u64) -> Option<&Entry> {
    directory.iter().find(|entry| entry.tag == tag)
}

/// The first whole number of a tag.
fn single(form: Form, content: &[u8], directory: &Directory, tag: u64) -> Option<u64> {
    let entry = first(directory, tag).filter(|entry| entry.count > 0)?;
    form.numbers(content, &Entry { count: 1, ..*entry }).ok()?.first().copied()
}

/// Adds the pages of a file and returns their number.
///
/// Memory is bounded by what the content can expand to.
pub(super) fn add_all(content: &[u8], path: &Path, pages: &mut Pages) -> Result<usize> {
    let (form, directories) = directory::read(content).map_err(|found| damaged(path, &found))?;
    let number = |directory: &Directory, tag| single(form, content, directory, tag);
    let main: Vec<bool> = directories.iter().map(|d| number(d, KIND_OF_PAGE).unwrap_or(0) & NO_PAGE == 0).collect();
    let stored = main.iter().filter(|is_main| **is_main).count();
    let Some(leader) = directories.iter().zip(&main).find(|(_, is_main)| **is_main).map(|(directory, _)| directory)
    else {
        return Err(damaged(path, "no page"));
    };
    let (rows, columns) = (number(leader, HEIGHT).unwrap_or(0), number(leader, WIDTH).unwrap_or(0));
    let text = first(leader, DESCRIPTION).and_then(|entry| entry.content(content)).map(lossy).unwrap_or_default();
    let description = Description::parse(&text, rows, columns);
    remark(form, content, &directories, &main, pages);
    if description.channels > 1 {
        let got = format!("{} channels", description.channels);
        let remedy = "write one channel to a file of its own, for example with ImageJ's Split Channels";
        return Err(unsupported(path, "TIFF", got, "one number per pixel", remedy));
    }
    for oddity in &description.oddities {
        pages.remark(oddity.clone());
    }
    pages.spacing = spacing(form, content, leader, &description, pages);
    pages.in_millimetres = description.in_millimetres;
    let before = pages.count();
    match description.pages.filter(|stated| *stated > stored as u64) {
        None => {
            let plain = rewrite::plain(content, form, &directories).map_err(|found| found.of(path))?;
            decode(&plain, path, &main, &description, pages)?;
            if let Some(stated) = description.pages.filter(|stated| *stated < stored as u64) {
                pages.remark(format!("its description states {stated} pages, but it has {stored}; all are read"));
            }
        }
        Some(stated) if stored == 1 && description.may_be_contiguous => {
            add_contiguous(form, content, leader, [columns, rows, stated], &description, path, pages)?;
        }
        Some(stated) => {
            let expected = format!("{stated} pages, which its description states");
            let remedy = "the file is truncated: copy or export it again";
            return Err(Error::format(path, "TIFF", format!("{stored} pages"), expected, remedy));
        }
    }
    Ok(pages.count() - before)
}

/// Remarks on tags that other programs heed.
fn remark(form: Form, content: &[u8], directories: &[Directory], main: &[bool], pages: &mut Pages) {
    let left_out = main.iter().filter(|is_main| !**is_main).count();
    if left_out > 0 {
        pages.remark(format!("pages that are reduced copies or masks of others ({left_out}) are not read"));
    }
    let has = |tag, value: fn(u64) -> bool| {
        directories.iter().any(|directory| single(form, content, directory, tag).is_some_and(value))
    };
    if has(PHOTOMETRIC, |value| value == 0) {
        pages.remark("it states that 0 is white; its numbers are read as stored".into());
    }
    if has(ORIENTATION, |value| value != 1) {
        pages.remark(
            "it states another orientation than rows from the top; they are read in the order of the file".into(),
        );
    }
}

/// The spacing that the writer's description states, together with the resolution.
fn spacing(form: Form, content: &[u8], leader: &Directory, said: &Description, pages: &mut Pages) -> Option<DVec3> {
    if said.spacing.is_some() {
        return said.spacing;
    }
    let unit = said.unit?;
    let side = |tag| Some(1.0 / form.fraction(content, first(leader, tag)?)?);
    let sides = side(X_RESOLUTION).zip(side(Y_RESOLUTION));
    let Some((x, y)) = sides else {
        pages.remark("it states a unit of length but no resolution: its spacing is unknown".into());
        return None;
    };
    Some(DVec3::new(x, y, said.depth) * unit)
}

/// Decodes the pages with directories of their own, without those that are not `main`.
fn decode(content: &[u8], path: &Path, main: &[bool], description: &Description, pages: &mut Pages) -> Result<()> {
    let broken = |error: TiffError| refused(error, path);
    let mut left = content.len().saturating_mul(MOST_INFLATION);
    let mut decoder = Decoder::new(Cursor::new(content)).map_err(broken)?;
    for index in 0.. {
        let is_main = main.get(index).copied().unwrap_or(true);
        if is_main {
            let kind = decoder.colortype().map_err(broken)?;
            if !matches!(kind, ColorType::Gray(8 | 16 | 32 | 64)) {
                let remedy = "convert it to grey numbers of 8, 16 or 32 bits, for example with ImageJ";
                let expected = "one number of 8 to 64 bits per pixel";
                return Err(unsupported(path, "page", format!("{kind:?}"), expected, remedy));
            }
            let (columns, rows) = decoder.dimensions().map_err(broken)?;
            pages.check(rows as usize, columns as usize, path)?;
            // A tile may be wider than the page, and the decoder holds a row of it.
            if (decoder.chunk_dimensions().0 as usize).saturating_mul(8) > left {
                return Err(damaged(path, &format!("tiles of {:?} pixels", decoder.chunk_dimensions())));
            }
            let mut limits = Limits::default();
            (limits.decoding_buffer_size, limits.intermediate_buffer_size) = (left, left);
            decoder = decoder.with_limits(limits);
            let page = decoder.read_image().map_err(broken)?;
            left -= add(&page, description, pages).min(left);
        }
        if !decoder.more_images() {
            return Ok(());
        }
        decoder.next_image().map_err(broken)?;
    }
    unreachable!("a file has an end")
}

/// The error for a page that the library does not decode.
fn refused(error: TiffError, path: &Path) -> Error {
    let TiffError::UnsupportedError(kind) = &error else { return damaged(path, &error.to_string()) };
    let mut what = kind.to_string();
    if let tiff::TiffUnsupportedError::UnsupportedCompressionMethod(method) = kind {
        let number = u64::from(method.to_u16());
        let name = OTHER_COMPRESSIONS.iter().find(|(known, _)| *known == number).map_or("unknown", |(_, name)| name);
        what = format!("compression {number} ({name})");
    }
    let expected = "grey pages without compression or with LZW, Deflate, PackBits or Zstandard";
    unsupported(path, "page", what, expected, "convert it, for example with tiffcp -c none IN OUT or with ImageJ")
}

/// Adds a decoded page and returns its size in bytes.
fn add(page: &DecodingResult, description: &Description, pages: &mut Pages) -> usize {
    let means = meaning(description);
    macro_rules! add {
        ($values:expr) => {{
            match description.calibration {
                None => pages.add($values.iter().map(|&value| value as f32)),
                Some(_) => pages.add($values.iter().map(|&value| means(value as f64) as f32)),
            }
            size_of_val(&$values[..])
        }};
    }
    match page {
        DecodingResult::U8(values) => add!(values),
        DecodingResult::I8(values) => add!(values),
        DecodingResult::U16(values) => add!(values),
        DecodingResult::I16(values) => add!(values),
        DecodingResult::U32(values) => add!(values),
        DecodingResult::I32(values) => add!(values),
        DecodingResult::U64(values) => add!(values),
        DecodingResult::I64(values) => add!(values),
        DecodingResult::F32(values) => add!(values),
        DecodingResult::F64(values) => add!(values),
        DecodingResult::F16(values) => {
            pages.add(values.iter().map(|value| value.to_f32()));
            size_of_val(&values[..])
        }
    }
}

/// The value of a stored number.
fn meaning(description: &Description) -> impl Fn(f64) -> f64 {
    let calibration = description.calibration;
    move |stored| calibration.map_or(stored, |[offset, slope]| offset + slope * stored)
}

/// Adds pages that follow the first one without directories; `shape` is `[columns, rows, pages]`.
fn add_contiguous(
    form: Form,
    content: &[u8],
    leader: &Directory,
    shape: [u64; 3],
    description: &Description,
    path: &Path,
    pages: &mut Pages,
) -> Result<()> {
    let number = |tag| single(form, content, leader, tag);
    let compression = number(COMPRESSION).unwrap_or(1);
    // Python's tifffile takes three or four frames for the colours of one page, in planes one after another.
    let is_planes =
        number(PLANES) == Some(2) && number(SAMPLES) == Some(shape[2]) && follow_each_other(form, content, leader);
    let samples = if is_planes { 1 } else { number(SAMPLES).unwrap_or(1) };
    let kind = match (samples, number(FORMAT_OF_SAMPLES).unwrap_or(1), number(BITS)) {
        (1, 1, Some(8)) => Some(Number::U8),
        (1, 1, Some(16)) => Some(Number::U16),
        (1, 1, Some(32)) => Some(Number::U32),
        (1, 2, Some(8)) => Some(Number::I8),
        (1, 2, Some(16)) => Some(Number::I16),
        (1, 2, Some(32)) => Some(Number::I32),
        (1, 3, Some(32)) => Some(Number::F32),
        (1, 3, Some(64)) => Some(Number::F64),
        _ => None,
    };
    let (Some(kind), 1) = (kind, compression) else {
        let got = format!("{} pages with one directory, compressed or with several numbers per pixel", shape[2]);
        let remedy = "export it again with one directory for each page";
        return Err(unsupported(path, "TIFF", got, "a directory for each page", remedy));
    };
    let [columns, rows, count] = shape.map(|n| usize::try_from(n).unwrap_or(usize::MAX));
    pages.check(rows, columns, path)?;
    let start = number(OFFSETS).and_then(|at| usize::try_from(at).ok()).unwrap_or(usize::MAX);
    let element = Element { number: kind, big_endian: form.big_endian };
    let end = element.size([columns, rows, count]).ok().and_then(|size| start.checked_add(size)).unwrap_or(usize::MAX);
    // A file that was cut before its directory was written has fewer numbers than pages.
    if leader.iter().any(|entry| (start as u64..end as u64).contains(&entry.at)) {
        return Err(damaged(path, &format!("less than {count} pages, which its description states")));
    }
    let layout = Layout { element, encoding: Encoding::Raw, shape: [columns, rows, count], start: Start::After(start) };
    let voxels = layout.read(content, meaning(description)).map_err(|found| match found {
        Defect::Damage(found) => damaged(path, &format!("{found}, which its description states")),
        Defect::Memory(error) => error.in_file(path),
    })?;
    pages.add(voxels.values.t().iter().copied());
    Ok(())
}

/// Whether each strip of a page begins where the one before ends.
fn follow_each_other(form: Form, content: &[u8], page: &Directory) -> bool {
    let numbers = |tag| first(page, tag).and_then(|entry| form.numbers(content, entry).ok());
    let (Some(starts), Some(sizes)) = (numbers(OFFSETS), numbers(BYTE_COUNTS)) else { return false };
    let ends = starts.iter().zip(&sizes).map(|(start, size)| start.checked_add(*size));
    starts.len() == sizes.len() && ends.zip(starts.iter().skip(1)).all(|(end, next)| end == Some(*next))
}

/// Writes one single-precision page per z, with the spacing as ImageJ states it where it is in millimetres.
pub(super) fn write(path: &Path, shape: [usize; 3], place: Place, slices: &mut EachSlice<'_>) -> Result<()> {
    let spacing = place.in_millimetres.then_some(place.spacing);
    let [x, y, _] = shape;
    let sides = [x, y].map(u32::try_from);
    let [Ok(columns), Ok(rows)] = sides else {
        let sides = (x, y, shape[2]);
        return Err(Error::invalid("volume", format!("{sides:?}"), "sides below 2^32", "take another format"));
    };
    let sides = [columns, rows];
    write_atomically(path, |file| {
        if 4 * shape.iter().product::<usize>() > LARGE {
            let mut encoder = TiffEncoder::new_big(file).map_err(not_written)?;
            slices(&mut |page| write_page(&mut encoder, page, sides, spacing).map_err(not_written))
        } else {
            let mut encoder = TiffEncoder::new(file).map_err(not_written)?;
            slices(&mut |page| write_page(&mut encoder, page, sides, spacing).map_err(not_written))
        }
    })
}

fn not_written(error: TiffError) -> io::Error {
    match error {
        TiffError::IoError(error) => error,
        other => io::Error::other(other.to_string()),
    }
}

fn write_page<W: Write + Seek, K: TiffKind>(
    encoder: &mut TiffEncoder<W, K>,
    page: &[f32],
    [columns, rows]: [u32; 2],
    spacing: Option<DVec3>,
) -> TiffResult<()> {
    let mut image = encoder.new_image::<Gray32Float>(columns, rows)?;
    if let Some(DVec3 { x, y, z }) = spacing {
        // Without the number of images: where it is stated, ImageJ takes the pages for contiguous.
        let description = format!("ImageJ=1.54f\nunit=mm\nspacing={z}\nloop=false\n");
        image.encoder().write_tag(Tag::ImageDescription, description.as_str())?;
        image.resolution_unit(ResolutionUnit::None);
        image.x_resolution(per_unit(x));
        image.y_resolution(per_unit(y));
    }
    image.write_data(page)
}

/// Pixels per unit of length, with as many bits as a fraction has.
fn per_unit(pitch: f64) -> Rational {
    let (resolution, mut d) = (1.0 / pitch, 1_u32);
    while d < 1 << 30 && resolution * f64::from(2 * d) < f64::from(u32::MAX) {
        d *= 2;
    }
    Rational { n: (resolution * f64::from(d)).round() as u32, d }
}
