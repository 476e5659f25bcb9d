//! PNG and JPEG: grey images, one in each file of a folder, or one file as a single slice.

use super::header::shown;
use super::pages::Pages;
use super::{VolumeFile, damaged, unsupported};
use crate::limit;
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use std::io::Cursor;
use std::path::Path;
use trgs_core::error::Result;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Largest expansion of a compressed byte of PNG.
const MOST_INFLATION: usize = 1032;
/// Largest number of pixels for a byte of a whole JPEG: each block of 64 pixels has a code of its own for its mean, of a
/// bit at least. Runs without codes follow only in later scans.
const MOST_PIXELS: usize = 8 * 64;
/// Remedy for images of colours.
const TO_GREY: &str = "convert it to grey, for example with ImageMagick: magick IN -colorspace Gray OUT.tif";

pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    let mut pages = Pages::default();
    add(content, path, &mut pages)?;
    Ok(pages.volume())
}

/// Adds the image in a file, judged by its first bytes.
pub(super) fn add(content: &[u8], path: &Path, pages: &mut Pages) -> Result<()> {
    if content.starts_with(b"\xff\xd8") { jpeg(content, path, pages) } else { png(content, path, pages) }
}

fn png(content: &[u8], path: &Path, pages: &mut Pages) -> Result<()> {
    let broken = |error: png::DecodingError| damaged(path, &error.to_string());
    let bytes = content.len().saturating_mul(MOST_INFLATION);
    let mut decoder = Decoder::new_with_limits(Cursor::new(content), Limits { bytes });
    decoder.set_transformations(Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(broken)?;
    let info = reader.info();
    let (rows, columns, is_wide) = (info.height as usize, info.width as usize, info.bit_depth == BitDepth::Sixteen);
    if info.is_animated() {
        pages.remark("the images are animations, of which the first frame is read".into());
    }
    let channels = match (info.color_type, info.bit_depth) {
        (ColorType::Grayscale, BitDepth::Eight | BitDepth::Sixteen) => 1,
        (ColorType::GrayscaleAlpha, _) => 2,
        (ColorType::Rgb, _) => 3,
        (ColorType::Rgba, _) => 4,
        (colour, depth) => {
            let got = format!("{colour:?} with {depth:?} bits");
            return Err(unsupported(path, "PNG", got, "grey numbers of 8 or 16 bits", TO_GREY));
        }
    };
    pages.check(rows, columns, path)?;
    let size = reader.output_buffer_size().filter(|size| *size <= bytes);
    let size =
        size.ok_or_else(|| damaged(path, &format!("{rows} rows and {columns} columns in {} bytes", content.len())))?;
    // The image as stored, and its numbers.
    limit::allow("image", 3 * size as u64).map_err(|error| error.in_file(path))?;
    let mut buffer = vec![0; size];
    let frame = reader.next_frame(&mut buffer).map_err(broken)?;
    buffer.truncate(frame.buffer_size());
    let numbers: Vec<u16> = match is_wide {
        true => buffer.as_chunks().0.iter().map(|&pair| u16::from_be_bytes(pair)).collect(),
        false => buffer.iter().map(|&byte| byte.into()).collect(),
    };
    add_grey(&numbers, channels, if is_wide { u16::MAX } else { 255 }, path, pages)
}

fn jpeg(content: &[u8], path: &Path, pages: &mut Pages) -> Result<()> {
    let broken = |found: String| match found.contains("nsupported") {
        true => unsupported(path, "JPEG", shown(&found), "a baseline or progressive JPEG of 8 bits", TO_GREY),
        false => damaged(path, &found),
    };
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(content), DecoderOptions::default());
    decoder.decode_headers().map_err(|error| broken(error.to_string()))?;
    let Some((columns, rows)) = decoder.dimensions() else { return Err(broken("no size".into())) };
    if rows.saturating_mul(columns) / MOST_PIXELS > content.len() {
        let most = content.len().saturating_mul(MOST_PIXELS);
        let found =
            format!("{rows} rows and {columns} columns in {} bytes, which hold {most} pixels at most", content.len());
        return Err(damaged(path, &found));
    }
    pages.check(rows, columns, path)?;
    // Coefficients, three colours, and their numbers.
    limit::allow("image", 16 * (rows * columns) as u64).map_err(|error| error.in_file(path))?;
    let is_grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let (space, channels) = if is_grey { (ColorSpace::Luma, 1) } else { (ColorSpace::RGB, 3) };
    decoder.set_options(DecoderOptions::default().set_strict_mode(true).jpeg_set_out_colorspace(space));
    let pixels = decoder.decode().map_err(|error| broken(error.to_string()))?;
    let numbers: Vec<u16> = pixels.iter().map(|&byte| byte.into()).collect();
    if numbers.len() != rows * columns * channels {
        return Err(damaged(path, &format!("{} numbers for {rows} rows and {columns} columns", numbers.len())));
    }
    pages.remark("JPEG has 8 bits and loses detail: values are inexact".into());
    add_grey(&numbers, channels, 255, path, pages)
}

/// Adds the first channel of an image whose colours, if it has any, are equal, and which is opaque.
fn add_grey(numbers: &[u16], channels: usize, opaque: u16, path: &Path, pages: &mut Pages) -> Result<()> {
    let mut pixels = numbers.chunks_exact(channels);
    let colours = if channels > 2 { 3 } else { 1 };
    let is_grey = |pixel: &[u16]| {
        pixel[1..colours].iter().all(|number| *number == pixel[0]) && pixel[colours..].iter().all(|a| *a == opaque)
    };
    if !pixels.all(is_grey) {
        return Err(unsupported(path, "image", "colours or transparency", "grey numbers", TO_GREY));
    }
    if channels > 1 {
        pages.remark("grey is stored as equal colours or with an opaque layer; one channel is read".into());
    }
    pages.add(numbers.iter().step_by(channels).map(|&number| number.into()));
    Ok(())
}
