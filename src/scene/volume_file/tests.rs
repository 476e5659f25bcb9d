use super::*;
use std::path::PathBuf;
use tempfile::TempDir;

fn sample() -> VolumeFile {
    let values = Array3::from_shape_fn((3, 4, 5), |(x, y, z)| (100 * x + 10 * y + z) as f32 / 8.0);
    let (spacing, origin) = (Some(DVec3::new(0.5, 0.25, 2.0)), Some(DVec3::new(-1.0, 3.0, 0.125)));
    VolumeFile { values, spacing, origin, oddities: Vec::new() }
}

fn folder() -> (TempDir, impl Fn(&str) -> PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().to_owned();
    (folder, move |name: &str| root.join(name))
}

#[test]
fn what_is_written_is_read_again() {
    let (_folder, at) = folder();
    for name in ["a.mha", "a.nrrd", "a.nii", "a.nii.gz", "a.npy", "a_3x4x5_float32.raw"] {
        write(&at(name), &sample()).unwrap();
        let mut expected = sample();
        if name.ends_with("npy") || name.ends_with("raw") {
            (expected.spacing, expected.origin) = (None, None);
        }
        assert_eq!(read(&at(name)).unwrap(), expected, "{name}");
    }
}

#[test]
fn the_same_volume_gives_the_same_bytes() {
    let (_folder, at) = folder();
    for name in ["a.mha", "a.nrrd", "a.nii", "a.nii.gz"] {
        let bytes = || {
            write(&at(name), &sample()).unwrap();
            std::fs::read(at(name)).unwrap()
        };
        assert!(bytes() == bytes(), "{name}");
    }
}

#[test]
fn types_orders_and_files_beside_are_understood() {
    let (_folder, at) = folder();
    let expected = Array3::from_shape_vec((2, 1, 2), vec![1.0, 3.0, 2.0, 256.0]).unwrap();
    // x is the fastest: (0,0,0), (1,0,0), (0,0,1), (1,0,1).
    let numbers: [u16; 4] = [1, 2, 3, 256];
    std::fs::write(at("v_2x1x2_uint16be.raw"), numbers.map(u16::to_be_bytes).concat()).unwrap();
    assert_eq!(read(&at("v_2x1x2_uint16be.raw")).unwrap().values, expected);
    let header = "ObjectType = Image\nNDims = 3\nDimSize = 2 1 2\nElementType = MET_USHORT\nElementByteOrderMSB = True\n\
                  TransformMatrix = 0 1 0 1 0 0 0 0 1\nElementSpacing = 1 2 3\nElementDataFile = v_2x1x2_uint16be.raw\n";
    std::fs::write(at("v.mhd"), header).unwrap();
    let found = read(&at("v.mhd")).unwrap();
    assert_eq!((found.values, found.spacing), (expected.clone(), Some(DVec3::new(1.0, 2.0, 3.0))));
    assert!(found.oddities[0].contains("directions 0 1 0"));
    let header = "NRRD0001\n# a remark\ntype: unsigned short\ndimension: 3\nsizes: 2 1 2\nspacings: 1 2 3\nendian: big\n\
                  encoding: raw\ndata file: v_2x1x2_uint16be.raw";
    std::fs::write(at("v.nhdr"), header).unwrap();
    let found = read(&at("v.nhdr")).unwrap();
    assert_eq!((found.values, found.spacing), (expected, Some(DVec3::new(1.0, 2.0, 3.0))));
}

#[test]
fn what_does_not_fit_is_an_error_that_names_it() {
    let (_folder, at) = folder();
    let refused = |name: &str, content: &[u8]| {
        std::fs::write(at(name), content).unwrap();
        read(&at(name)).unwrap_err().to_string()
    };
    assert!(
        refused("a.mha", b"DimSize = 9 9 9\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n1234")
            .contains("[9, 9, 9]")
    );
    assert!(refused("a.mha", b"DimSize = 9 9\n").contains("DimSize"));
    assert!(
        refused("a.mha", b"DimSize = 1 1 1\nElementType = MET_UCHAR\nElementDataFile = ../x.raw\n")
            .contains("this folder")
    );
    assert!(refused("a.nrrd", b"NRRD0004\ntype: block\n\n").contains("block"));
    assert!(refused("a.nrrd", b"P5\n").contains("NRRD0001"));
    let huge = b"NRRD0004\ntype: float\ndimension: 3\nsizes: 99999 99999 99999\nencoding: gzip\n\n12345";
    assert!(refused("a.nrrd", huge).contains("99999"));
    assert!(refused("a.raw", b"1").contains("name_256x256x256_uint8.raw"));
    assert!(refused("a_2x2x2_uint8.raw", b"1234567").contains("7 bytes"));
    assert!(refused("a.nii", &[0; 400]).contains("volume"));
    assert!(read(&at("a.stl")).unwrap_err().to_string().contains(".nii.gz"));
    assert!(write(&at("a_3x4x6_float32.raw"), &sample()).unwrap_err().to_string().contains("_3x4x5_float32.raw"));
}
