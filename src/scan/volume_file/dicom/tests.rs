use super::*;
use crate::damage::{MANY, MOST_MEMORY, assert_clear, assert_reader_survives};
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use std::io::Write;

const IMPLICIT: &str = "1.2.840.10008.1.2";
const EXPLICIT: &str = "1.2.840.10008.1.2.1";

fn text(object: &mut InMemDicomObject, tag: Tag, kind: VR, value: &str) {
    object.put(DataElement::new(tag, kind, PrimitiveValue::from(value)));
}

/// A slice of 2 rows and 3 columns at a height.
///
/// Stored numbers are -100, …, -95 plus ten times the height.
fn slice(height: f64) -> InMemDicomObject {
    let mut object = InMemDicomObject::new_empty();
    let short = |object: &mut InMemDicomObject, tag: Tag, value: u16| {
        object.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
    };
    text(&mut object, Tag(0x0008, 0x0016), VR::UI, "1.2.840.10008.5.1.4.1.1.2");
    text(&mut object, Tag(0x0008, 0x0018), VR::UI, "1.2.3.4");
    text(&mut object, MODALITY, VR::CS, "CT");
    text(&mut object, SERIES, VR::UI, "1.2.3");
    text(&mut object, POSITION, VR::DS, &format!("-10\\20.5\\{height}"));
    text(&mut object, ORIENTATION, VR::DS, "1\\0\\0\\0\\1\\0");
    text(&mut object, PIXEL_SPACING, VR::DS, "0.5\\0.25");
    text(&mut object, SLOPE, VR::DS, "2");
    text(&mut object, INTERCEPT, VR::DS, "-1000");
    for (tag, value) in
        [(SAMPLES, 1), (ROWS, 2), (COLUMNS, 3), (BITS_ALLOCATED, 16), (BITS_STORED, 12), (HIGH_BIT, 11), (IS_SIGNED, 1)]
    {
        short(&mut object, tag, value);
    }
    // Bits above the twelve stored bits are not part of the number.
    let stored = (0..6).map(|i| ((10.0 * height) as i16 + i - 100).cast_unsigned() & 0x0fff | 0x5000);
    object.put(DataElement::new(PIXELS, VR::OW, PrimitiveValue::U16(stored.collect())));
    object
}

fn bytes(object: InMemDicomObject, syntax: &str) -> Vec<u8> {
    let meta = FileMetaTableBuilder::new().transfer_syntax(syntax);
    let mut content = Vec::new();
    object.with_meta(meta).unwrap().write_all(&mut content).unwrap();
    content
}

/// A folder of slices whose names do not indicate their order.
fn series(objects: impl IntoIterator<Item = InMemDicomObject>) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (i, object) in objects.into_iter().enumerate() {
        let syntax = if i % 2 == 0 { EXPLICIT } else { IMPLICIT };
        std::fs::write(folder.path().join(format!("IM{i}")), bytes(object, syntax)).unwrap();
    }
    folder
}

fn refused(objects: impl IntoIterator<Item = InMemDicomObject>) -> String {
    super::super::read(series(objects).path()).unwrap_err().to_string()
}

fn changed(height: f64, change: impl FnOnce(&mut InMemDicomObject)) -> InMemDicomObject {
    let mut object = slice(height);
    change(&mut object);
    object
}

#[test]
fn slices_are_put_in_order_by_their_places_and_rescaled() {
    let folder = series([6.0, 1.0, 3.5].map(slice));
    std::fs::write(folder.path().join("notes.txt"), "no slice").unwrap();
    let found = super::super::read(folder.path()).unwrap();
    let value = |(x, y, z): (usize, usize, usize)| 2.0 * ((3 * y + x) as f32 - 100.0 + [10.0, 35.0, 60.0][z]) - 1000.0;
    assert_eq!(found.values, Array3::from_shape_fn((3, 2, 3), value));
    assert!(found.values.is_standard_layout());
    assert_eq!(found.spacing, Some(DVec3::new(0.25, 0.5, 2.5)));
    assert_eq!(found.origin, Some(DVec3::new(-10.0, 20.5, 1.0)));
    assert_eq!(found.oddities, ["values are Hounsfield units, not attenuation: air is -1000"]);
    let one = series([changed(4.0, |object| text(object, SLICE_THICKNESS, VR::DS, "1.5"))]);
    assert_eq!(super::super::read(one.path()).unwrap().spacing, Some(DVec3::new(0.25, 0.5, 1.5)));
}

#[test]
fn slices_along_another_axis_are_ordered_along_it() {
    let sagittal = |x: f64| {
        changed(0.0, |object| {
            text(object, POSITION, VR::DS, &format!("{x}\\0\\0"));
            text(object, ORIENTATION, VR::DS, "0\\1\\0\\0\\0\\-1");
        })
    };
    let found = super::super::read(series([1.0, 3.0, 2.0].map(sagittal)).path()).unwrap();
    // The normal is -x, so the first slice is the one with the largest x.
    assert_eq!((found.spacing.unwrap().z, found.origin.unwrap().x), (1.0, 3.0));
    assert!(found.oddities[0].contains("they are read as x, y and z"), "{:?}", found.oddities);
    let tilted = |z: f64| changed(z, |object| text(object, POSITION, VR::DS, &format!("0\\{}\\{z}", 0.3 * z)));
    let found = super::super::read(series([1.0, 2.0, 3.0].map(tilted)).path()).unwrap();
    assert!(found.oddities[0].contains("sheared"), "{:?}", found.oddities);
}

#[test]
fn series_that_are_mixed_or_have_gaps_are_refused() {
    let other = changed(3.0, |object| text(object, SERIES, VR::UI, "1.2.9"));
    let message = refused([slice(1.0), slice(2.0), other]);
    assert!(message.contains("IM2: series: got 1.2.9, expected 1.2.3"), "{message}");
    let message = refused([1.0, 2.0, 3.0, 5.0, 6.0].map(slice));
    assert!(
        message.contains("IM3: distance of slices: got 2 behind") && message.contains("expected 1 as"),
        "{message}"
    );
    assert!(refused([1.0, 2.0, 2.0, 3.0].map(slice)).contains("missing or duplicated"));
    assert!(refused([1.0, 1.0].map(slice)).contains("missing or duplicated"));
    let wider = changed(2.0, |object| text(object, PIXEL_SPACING, VR::DS, "0.5\\0.5"));
    assert!(refused([slice(1.0), wider]).contains("IM1: slice: got (2, 3) pixels of [0.5, 0.5]"));
}

#[test]
fn slices_that_say_too_little_or_something_else_are_refused() {
    for (tag, part) in
        [(POSITION, "image position"), (PIXEL_SPACING, "pixel spacing"), (ROWS, "rows"), (PIXELS, "pixel data")]
    {
        let message = refused([changed(1.0, |object| {
            object.remove_element(tag);
        })]);
        assert!(message.contains(part), "{message}");
    }
    let message = refused([changed(1.0, |object| text(object, FRAMES, VR::IS, "3"))]);
    assert!(message.contains("got 12 bytes, expected 18 numbers of 16 bits"), "{message}");
    let message = refused([changed(1.0, |object| text(object, FRAMES, VR::IS, "0"))]);
    assert!(message.contains("number of frames: got 0, expected a whole number"), "{message}");
    let message = refused([changed(1.0, |object| {
        object.put(DataElement::new(ROWS, VR::US, PrimitiveValue::from(3_u16)));
    })]);
    assert!(message.contains("got 12 bytes, expected 9 numbers of 16 bits"), "{message}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.dcm");
    // JPEG, indicated by the transfer syntax.
    let mut content = bytes(slice(1.0), EXPLICIT);
    let at = content.windows(19).position(|part| part == EXPLICIT.as_bytes()).unwrap();
    content[at + 17..at + 19].copy_from_slice(b".4");
    std::fs::File::create(&path).unwrap().write_all(&content).unwrap();
    let message = super::super::read(&path).unwrap_err().to_string();
    assert!(message.contains("1.2.840.10008.1.2.4") && message.contains("gdcmconv"), "{message}");
    assert!(message.contains("not supported") && !message.contains("again"), "{message}");
}

/// Elements as the first item of a sequence.
fn sequence(object: &mut InMemDicomObject, tag: Tag, items: Vec<InMemDicomObject>) {
    object.put(DataElement::new(tag, VR::SQ, dicom_core::value::DataSetSequence::from(items)));
}

/// A group of functions: a sequence of one item with texts.
fn group(object: &mut InMemDicomObject, at: usize, texts: &[(Tag, &str)]) {
    let mut item = InMemDicomObject::new_empty();
    texts.iter().for_each(|(tag, value)| text(&mut item, *tag, VR::DS, value));
    sequence(object, GROUPS[at], vec![item]);
}

/// Frames of [`slice`] at heights, as Enhanced CT: slope and intercept are those of the frame if `rescales`.
fn enhanced(heights: &[f64], rescales: bool) -> InMemDicomObject {
    let mut object = slice(0.0);
    for tag in [POSITION, ORIENTATION, PIXEL_SPACING, SLOPE, INTERCEPT] {
        object.remove_element(tag);
    }
    text(&mut object, FRAMES, VR::IS, &heights.len().to_string());
    let mut shared = InMemDicomObject::new_empty();
    group(&mut shared, 1, &[(ORIENTATION, "1\\0\\0\\0\\1\\0")]);
    group(&mut shared, 2, &[(PIXEL_SPACING, "0.5\\0.25"), (SLICE_THICKNESS, "1.5")]);
    group(&mut shared, 3, &[(SLOPE, "2"), (INTERCEPT, "-1000")]);
    sequence(&mut object, SHARED_GROUPS, vec![shared]);
    let frame = |(i, height): (usize, &f64)| {
        let mut frame = InMemDicomObject::new_empty();
        group(&mut frame, 0, &[(POSITION, &format!("-10\\20.5\\{height}"))]);
        if rescales {
            group(&mut frame, 3, &[(SLOPE, &format!("{}", i + 1)), (INTERCEPT, "-7")]);
        }
        frame
    };
    let frames = heights.iter().enumerate().map(frame).collect();
    sequence(&mut object, GROUPS_OF_FRAMES, frames);
    let stored = |height: &f64| {
        let first = (10.0 * height) as i16 - 100;
        (0..6).map(move |i| (first + i).cast_unsigned() & 0x0fff | 0x5000)
    };
    let stored = heights.iter().flat_map(stored).collect();
    object.put(DataElement::new(PIXELS, VR::OW, PrimitiveValue::U16(stored)));
    object
}

#[test]
fn frames_with_positions_are_the_slices_of_a_series() {
    let heights = [6.0, 1.0, 3.5];
    let series_of_files = super::super::read(series(heights.map(slice)).path()).unwrap();
    for syntax in [IMPLICIT, EXPLICIT] {
        let content = bytes(enhanced(&heights, false), syntax);
        assert_eq!(super::super::parse(&content, Path::new("a.dcm")).unwrap(), series_of_files);
    }
    // Several files of one series.
    let parts = [enhanced(&heights[..2], false), slice(3.5)];
    assert_eq!(super::super::read(series(parts).path()).unwrap(), series_of_files);
    // A frame's own slope and intercept.
    let content = bytes(enhanced(&heights, true), EXPLICIT);
    let found = super::super::parse(&content, Path::new("a.dcm")).unwrap();
    let value = |(x, y, z): (usize, usize, usize)| {
        let (stored, slope) = ((3 * y + x) as f32 - 100.0 + [10.0, 35.0, 60.0][z], [2.0, 3.0, 1.0][z]);
        slope * stored - 7.0
    };
    assert_eq!(found.values, Array3::from_shape_fn((3, 2, 3), value));
}

#[test]
fn frames_without_positions_stay_in_the_order_of_the_file() {
    let stack = |change: &dyn Fn(&mut InMemDicomObject)| {
        let mut object = enhanced(&[6.0, 1.0, 3.5], false);
        object.remove_element(GROUPS_OF_FRAMES);
        object.remove_element(SHARED_GROUPS);
        text(&mut object, MODALITY, VR::CS, "XA");
        change(&mut object);
        object
    };
    let parse = |object| super::super::parse(&bytes(object, EXPLICIT), Path::new("a.dcm"));
    let found = parse(stack(&|_| {})).unwrap();
    let value = |(x, y, z): (usize, usize, usize)| (3 * y + x) as f32 - 100.0 + [60.0, 10.0, 35.0][z];
    assert_eq!(found.values, Array3::from_shape_fn((3, 2, 3), value));
    assert_eq!((found.spacing, found.origin), (None, None));
    let order = "its 3 frames have no positions of their own: they are read in the order of the file";
    assert_eq!(found.oddities, [order]);
    let detector = stack(&|object| text(object, IMAGER_PIXEL_SPACING, VR::DS, "0.5\\0.25"));
    let found = parse(detector).unwrap();
    assert_eq!(found.spacing, Some(DVec3::new(0.25, 0.5, 1.0)));
    assert_eq!(found.oddities, [format!("{order}, 1 mm apart")]);
    // One position for all frames is that of none.
    let placed = stack(&|object| {
        text(object, POSITION, VR::DS, "1\\2\\3");
        text(object, PIXEL_SPACING, VR::DS, "0.5\\0.25");
        text(object, SLICE_DISTANCE, VR::DS, "-4");
    });
    let found = parse(placed).unwrap();
    assert_eq!((found.spacing, found.origin), (Some(DVec3::new(0.25, 0.5, 4.0)), None));
    assert_eq!(found.oddities, [order]);
    let offsets = stack(&|object| text(object, FRAME_OFFSETS, VR::DS, "0\\1\\2"));
    let message = parse(offsets).unwrap_err().to_string();
    assert!(message.contains("grid frame offset vector, which is not supported"), "{message}");
    // Beside other files they have no place.
    let message = refused([slice(1.0), stack(&|_| {})]);
    assert!(message.contains("IM1: file of a series: got several frames without positions"), "{message}");
}

#[test]
fn frames_that_contradict_each_other_are_refused_by_number() {
    let parse = |object| super::super::parse(&bytes(object, EXPLICIT), Path::new("a.dcm")).unwrap_err().to_string();
    let message = parse(enhanced(&[1.0, 2.0, 3.0, 5.0, 6.0], false));
    let gap = "a.dcm: frame 4: distance of slices: got 2 behind frame 3 of a.dcm, expected 1 as elsewhere";
    assert!(message.contains(gap), "{message}");
    let mut fewer = enhanced(&[1.0, 2.0], false);
    text(&mut fewer, FRAMES, VR::IS, "1");
    let message = parse(fewer);
    assert!(message.contains("functional groups of frames: got 2, expected 1, the number of frames"), "{message}");
    let mut unplaced = enhanced(&[1.0, 2.0], false);
    let mut frame = InMemDicomObject::new_empty();
    group(&mut frame, 0, &[(POSITION, "0\\0\\0")]);
    sequence(&mut unplaced, GROUPS_OF_FRAMES, vec![frame, InMemDicomObject::new_empty()]);
    let message = parse(unplaced);
    assert!(message.contains("a.dcm: frame 2: image position (patient): got nothing"), "{message}");
}

/// A slice with a sequence, in one of the two transfer syntaxes.
fn small(syntax: &str) -> Vec<u8> {
    let mut object = slice(1.0);
    let inner = InMemDicomObject::from_element_iter([DataElement::new(MODALITY, VR::CS, PrimitiveValue::from("CT"))]);
    let sequence = dicom_core::value::DataSetSequence::from(vec![inner]);
    object.put(DataElement::new(Tag(0x0008, 0x1140), VR::SQ, sequence));
    bytes(object, syntax)
}

#[test]
fn damaged_slices_are_clear_errors() {
    for syntax in [IMPLICIT, EXPLICIT] {
        assert_reader_survives("a.dcm", MANY / 2, &small(syntax), super::super::parse);
    }
    assert_reader_survives("a.dcm", MANY / 2, &bytes(enhanced(&[1.0, 2.0], true), EXPLICIT), super::super::parse);
}

#[test]
fn lengths_are_compared_with_what_is_there() {
    let path = Path::new("a.dcm");
    for content in [IMPLICIT, EXPLICIT].map(small) {
        File::parse(&content, path).unwrap();
        for end in 0..content.len() {
            assert!(File::parse(&content[..end], path).is_err(), "cut at {end}");
        }
        let cut: Vec<u8> = content.iter().copied().chain([0, 0, 0, 0, 2, 0, 0, 0, 1, 1]).collect();
        let message = File::parse(&cut, path).map(|_| ()).unwrap_err().to_string();
        assert!(message.contains("a.dcm: volume"), "{message}");
        for at in 0..content.len() - 4 {
            for claim in [u32::MAX - 1, 0x7f7f_7f7f, 1 << 28] {
                let mut lying = content.clone();
                lying[at..at + 4].copy_from_slice(&claim.to_le_bytes());
                let memory = allocation_counter::measure(|| {
                    assert_clear(File::parse(&lying, path).map(|_| ()), "a.dcm");
                });
                assert!(memory.bytes_max <= MOST_MEMORY, "{} bytes at {at}", memory.bytes_max);
            }
        }
    }
}

#[test]
fn files_without_the_length_of_their_own_group_are_read() {
    let whole = [1.0, 3.0, 2.0].map(|height| bytes(slice(height), EXPLICIT));
    let without = |content: &Vec<u8>| {
        assert_eq!(content[132..140], *b"\x02\0\0\0UL\x04\0");
        [&content[..132], &content[144..]].concat()
    };
    let folders = [whole.to_vec(), whole.iter().map(without).collect::<Vec<_>>()].map(|contents| {
        let folder = tempfile::tempdir().unwrap();
        contents
            .iter()
            .enumerate()
            .for_each(|(i, it)| std::fs::write(folder.path().join(format!("IM{i}")), it).unwrap());
        folder
    });
    let [whole, cut] = folders.map(|folder| super::super::read(folder.path()).unwrap());
    assert_eq!(whole, cut);
    assert_reader_survives("a.dcm", MANY / 50, &without(&bytes(slice(1.0), IMPLICIT)), super::super::parse);
}

#[test]
fn numbers_of_which_the_lowest_is_white_are_read_as_stored_and_said() {
    let inverted = |height| changed(height, |object| text(object, PHOTOMETRIC, VR::CS, "MONOCHROME1"));
    let found = super::super::read(series([inverted(1.0), inverted(2.0)]).path()).unwrap();
    let plain = super::super::read(series([slice(1.0), slice(2.0)]).path()).unwrap();
    assert_eq!(found.values, plain.values);
    assert!(found.oddities.iter().any(|oddity| oddity.contains("MONOCHROME1")), "{:?}", found.oddities);
    assert!(!plain.oddities.iter().any(|oddity| oddity.contains("MONOCHROME1")), "{:?}", plain.oddities);
}
