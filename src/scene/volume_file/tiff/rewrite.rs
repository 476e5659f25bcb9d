//! A copy of a file with its pages stored plainly, where the library that decodes them would not read them as meant.

use super::directory::{Directory, Form, slice};
use super::{BITS, BYTE_COUNTS, COMPRESSION, HEIGHT, OFFSETS, PHOTOMETRIC, ROWS_PER_STRIP, SAMPLES, WIDTH};
use super::{TILE_BYTE_COUNTS, TILE_HEIGHT, TILE_OFFSETS, TILE_WIDTH, ZSTD, first, single};
use ruzstd::decoding::StreamingDecoder;
use std::borrow::Cow;
use std::io::Read;

/// Type numbers of whole numbers with four and eight bytes.
const LONG: [u64; 2] = [4, 16];

/// The file with Zstandard unpacked, and with numbers kept where white is zero; or an error message.
pub(super) fn plain<'a>(content: &'a [u8], form: Form, directories: &[Directory]) -> Result<Cow<'a, [u8]>, String> {
    let mut file = Cow::Borrowed(content);
    for directory in directories {
        // The library would invert the numbers.
        if single(form, content, directory, PHOTOMETRIC) == Some(0) {
            set(file.to_mut(), form, directory, PHOTOMETRIC, &[1])?;
        }
        if single(form, content, directory, COMPRESSION) == Some(ZSTD) {
            unpack(content, file.to_mut(), form, directory)?;
        }
    }
    Ok(file)
}

/// Appends the unpacked strips or tiles of a page, and lets its directory point at them.
fn unpack(content: &[u8], file: &mut Vec<u8>, form: Form, directory: &Directory) -> Result<(), String> {
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
    let size = size.ok_or("a page without a size")?;
    let (mut places, mut sizes) = (Vec::new(), Vec::new());
    for (at, count) in list(at)?.into_iter().zip(list(counts)?) {
        let packed = slice(content, at, count).ok_or("compressed data outside of the file")?;
        let start = file.len();
        let decoder = StreamingDecoder::new(packed).map_err(|error| error.to_string())?;
        decoder.take(size).read_to_end(file).map_err(|error| error.to_string())?;
        places.push(start as u64);
        sizes.push((file.len() - start) as u64);
    }
    set(file, form, directory, COMPRESSION, &[1])?;
    set(file, form, directory, at, &places)?;
    set(file, form, directory, counts, &sizes)
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
