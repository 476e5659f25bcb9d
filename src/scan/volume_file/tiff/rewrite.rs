//! A copy of a file with its pages stored plainly, where the library that decodes them would not read them as meant.
//!
//! The library has no decoder for Zstandard, inverts numbers where white is zero, and refuses sound LZW: its reader takes
//! a row that ends after the last byte of input for a missing end code.

use super::directory::{Directory, Form, slice};
use super::{BITS, BYTE_COUNTS, COMPRESSION, HEIGHT, LZW, OFFSETS, PHOTOMETRIC, ROWS_PER_STRIP, SAMPLES, WIDTH};
use super::{MOST_INFLATION, TILE_BYTE_COUNTS, TILE_HEIGHT, TILE_OFFSETS, TILE_WIDTH, ZSTD, first, single};
use crate::limit;
use crate::volume_file::elements::Defect;
use ruzstd::decoding::StreamingDecoder;
use std::borrow::Cow;
use std::io::Read;
use weezl::{BitOrder, LzwStatus, decode::Configuration};

/// Type numbers of whole numbers with four and eight bytes.
const LONG: [u64; 2] = [4, 16];
/// Largest expansion of a byte of Zstandard: a block of 128 KiB of one value takes four bytes.
const MOST_ZSTD: usize = 1 << 15;

/// How strips and tiles are packed.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Packing {
    Zstd,
    Lzw,
}

impl Packing {
    /// Largest expansion of a byte.
    fn most(self) -> usize {
        match self {
            Self::Zstd => MOST_ZSTD,
            Self::Lzw => MOST_INFLATION,
        }
    }
}

/// The file with Zstandard and LZW unpacked, and with numbers kept where white is zero.
pub(super) fn plain<'a>(content: &'a [u8], form: Form, directories: &[Directory]) -> Result<Cow<'a, [u8]>, Defect> {
    let mut file = Cow::Borrowed(content);
    for directory in directories {
        // The library would invert the numbers.
        if single(form, content, directory, PHOTOMETRIC) == Some(0) {
            set(file.to_mut(), form, directory, PHOTOMETRIC, &[1])?;
        }
        let packing = match single(form, content, directory, COMPRESSION) {
            Some(ZSTD) => Packing::Zstd,
            Some(LZW) => Packing::Lzw,
            _ => continue,
        };
        unpack(content, file.to_mut(), form, directory, packing)?;
    }
    Ok(file)
}

/// Appends the unpacked strips or tiles of a page, and lets its directory point at them.
fn unpack(
    content: &[u8],
    file: &mut Vec<u8>,
    form: Form,
    directory: &Directory,
    packing: Packing,
) -> Result<(), Defect> {
    let number = |tag| single(form, content, directory, tag);
    let list = |tag| {
        first(directory, tag)
            .ok_or("a page without data")
            .and_then(|entry| form.numbers(content, entry).map_err(|_| "a list outside of the file"))
    };
    let is_tiled = first(directory, TILE_OFFSETS).is_some();
    let (at, counts) = if is_tiled { (TILE_OFFSETS, TILE_BYTE_COUNTS) } else { (OFFSETS, BYTE_COUNTS) };
    let (width, height) = if is_tiled {
        (number(TILE_WIDTH), number(TILE_HEIGHT))
    } else {
        let rows = number(ROWS_PER_STRIP).unwrap_or(u64::MAX);
        (number(WIDTH), number(HEIGHT).map(|height| height.min(rows)))
    };
    let bits = number(BITS).unwrap_or(1).checked_mul(number(SAMPLES).unwrap_or(1));
    let size = width
        .zip(height)
        .zip(bits)
        .and_then(|((width, height), bits)| width.checked_mul(bits)?.div_ceil(8).checked_mul(height));
    let size = usize::try_from(size.ok_or("a page without a size")?).unwrap_or(usize::MAX);
    let (places, packed_sizes) = (list(at)?, list(counts)?);
    // Classic TIFF ends at 4 GiB: the library's own reader of LZW is left for such a page.
    let whole = size.saturating_mul(places.len()).saturating_add(file.len());
    if packing == Packing::Lzw && form.offset == 4 && whole > u32::MAX as usize {
        return Ok(());
    }
    // All that the bytes of the file can expand to. Strips that share their bytes would make more.
    let most = content.len().saturating_mul(packing.most()).saturating_add(content.len());
    let claimed = size.saturating_mul(places.len()).min(most.saturating_sub(file.len()));
    limit::allow("unpacked pages", file.len().saturating_add(claimed) as u64)?;
    // And the lists of places and sizes, of at most eight bytes each.
    file.try_reserve_exact(claimed + 16 * places.len()).map_err(|error| error.to_string())?;
    let (mut starts, mut sizes) = (Vec::new(), Vec::new());
    for (at, count) in places.into_iter().zip(packed_sizes) {
        let packed = slice(content, at, count).ok_or("compressed data outside of the file")?;
        let start = file.len();
        let size = size.min(packed.len().saturating_mul(packing.most()));
        if size > most.saturating_sub(start) {
            let found = format!("more than {most} bytes in {}: strips that share their bytes", content.len());
            return Err(found.into());
        }
        match packing {
            Packing::Zstd => {
                let decoder = StreamingDecoder::new(packed).map_err(|error| error.to_string())?;
                decoder.take(size as u64).read_to_end(file).map_err(|error| error.to_string())?;
            }
            Packing::Lzw => unpack_lzw(packed, size, file)?,
        }
        starts.push(start as u64);
        sizes.push((file.len() - start) as u64);
    }
    set(file, form, directory, COMPRESSION, &[1])?;
    set(file, form, directory, at, &starts)?;
    Ok(set(file, form, directory, counts, &sizes)?)
}

/// Appends at most `size` unpacked bytes. What follows them, and a missing end code, are no concern, as in libtiff.
fn unpack_lzw(mut packed: &[u8], size: usize, file: &mut Vec<u8>) -> Result<(), String> {
    let mut decoder = Configuration::with_tiff_size_switch(BitOrder::Msb, 8).build();
    let mut end = file.len();
    file.resize(end + size, 0);
    while end < file.len() {
        let step = decoder.decode_bytes(packed, &mut file[end..]);
        packed = &packed[step.consumed_in..];
        end += step.consumed_out;
        match step.status {
            Err(error) => return Err(format!("LZW: {error}")),
            Ok(LzwStatus::Done) => break,
            Ok(_) if (step.consumed_in, step.consumed_out) == (0, 0) => break,
            Ok(_) => {}
        }
    }
    file.truncate(end);
    Ok(())
}

/// Replaces the values of a tag.
fn set(file: &mut Vec<u8>, form: Form, directory: &Directory, tag: u64, values: &[u64]) -> Result<(), String> {
    let Some(entry) = first(directory, tag) else { return Ok(()) };
    let is_big = form.offset == 8;
    if !is_big && values.iter().any(|value| *value > u32::MAX.into()) {
        return Err("more than 4 GiB after unpacking".into());
    }
    let values_bytes: Vec<u8> = values.iter().flat_map(|value| form.bytes(*value, form.offset)).collect();
    let value_field = if values.len() == 1 {
        values_bytes
    } else {
        let place = file.len() as u64;
        file.extend(values_bytes);
        form.bytes(place, form.offset)
    };
    let kind = form.bytes(LONG[usize::from(is_big)], 2);
    let fields = [kind, form.bytes(values.len() as u64, form.offset), value_field].concat();
    let at = entry.at as usize + 2;
    file[at..at + fields.len()].copy_from_slice(&fields);
    Ok(())
}
