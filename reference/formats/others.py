"""Reads and writes files with other programs, for tests/cli/formats.rs, which judges the result.

SimpleITK, nibabel, pydicom, pynrrd, tifffile, imagecodecs and trimesh say what is right.

    others.py see FILE...    prints as JSON what SimpleITK, nibabel, plyfile and NumPy read from each file
    others.py make FOLDER    writes files in many formats, and expected.json with their contents
    others.py letters PATH...   prints as JSON the letters that SimpleITK, nibabel and pydicom see on the phantom `letters`
    others.py mesh FILE...   prints as JSON whether trimesh finds surfaces closed, and their volumes
    others.py odd FOLDER     the same for odd files: stacks of tifffile and ImageJ, headers with skips, lists and units

tests/data/point_cloud.pickle is the point_cloud_5.pickle of `make`. Positions are in ITK's coordinates (left, posterior,
superior).
"""

import json
import pathlib
import pickle
import sys

import imagecodecs
import nibabel
import nrrd
import numpy as np
import plyfile
import pydicom
import SimpleITK as sitk
import tifffile
import trimesh

# Signs that convert from and to nibabel's coordinates (right, anterior, superior).
TO_ITK = np.diag([-1.0, -1.0, 1.0, 1.0])
# Attributes of a CT image that have a value, and those that may be empty: PS3.3, A.3 (types 1 and 2).
DICOM = [
    "SOPClassUID SOPInstanceUID StudyInstanceUID SeriesInstanceUID FrameOfReferenceUID Modality ImageType SamplesPerPixel "
    "PhotometricInterpretation Rows Columns BitsAllocated BitsStored HighBit PixelRepresentation PixelData PixelSpacing "
    "ImageOrientationPatient ImagePositionPatient RescaleIntercept RescaleSlope",
    "StudyDate StudyTime AccessionNumber ReferringPhysicianName PatientName PatientID PatientBirthDate PatientSex StudyID "
    "SeriesNumber Manufacturer InstanceNumber PositionReferenceIndicator KVP AcquisitionNumber SliceThickness PatientPosition",
]
# World points sampled by every reader: inside the test's volume, off its symmetries.
POINTS = [[-0.5, -0.8, -0.2], [0.1, -0.4, 0.9], [0.35, -1.1, 0.3]]


def place(values, spacing, origin, directions):
    """A volume [x, y, z]; the columns of `directions` are unit vectors along its axes."""
    return {
        "shape": list(values.shape),
        "values": np.asarray(values, dtype=float).ravel().tolist(),
        "spacing": list(map(float, spacing)),
        "origin": list(map(float, origin)),
        "directions": np.asarray(directions, dtype=float).T.ravel().tolist(),
    }


def value_at(values, index):
    """The value of a voxel; None outside the volume."""
    inside = all(0 <= i < n for i, n in zip(index, values.shape))
    return float(values[tuple(index)]) if inside else None


def seen_by_itk(path, points=()):
    image = sitk.ReadImage(str(path))
    values = sitk.GetArrayFromImage(image).transpose(2, 1, 0)
    directions = np.array(image.GetDirection()).reshape(3, 3)
    found = place(values, image.GetSpacing(), image.GetOrigin(), directions)
    found["at_points"] = [value_at(values, image.TransformPhysicalPointToIndex(point)) for point in points]
    return found


def seen_by_nibabel(path):
    image = nibabel.load(path)
    values = image.get_fdata()
    affine = TO_ITK @ image.affine
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    found = place(values, spacing, affine[:3, 3], affine[:3, :3] / spacing)
    indices = [np.rint(np.linalg.solve(affine, [*point, 1.0])[:3]).astype(int) for point in POINTS]
    found["at_points"] = [value_at(values, index) for index in indices]
    found["unit"] = image.header.get_xyzt_units()[0]
    found["qform_is_sform"] = bool(np.allclose(image.get_qform(), image.get_sform(), atol=1e-6))
    return found


def see(path):
    if path.suffix == ".ply":
        vertices = plyfile.PlyData.read(path)["vertex"].data
        return {name: vertices[name].astype(float).tolist() for name in vertices.dtype.names}
    if path.suffix == ".npz":
        return {name: array.ravel().tolist() for name, array in np.load(path).items()}
    found = {"itk": seen_by_itk(path, POINTS)}
    if ".nii" in path.suffixes:
        found["nibabel"] = seen_by_nibabel(path)
    return found


def seen_by_pydicom(folder):
    """A function from a position to the value there, of a series that is as strict as the standard."""
    pydicom.config.settings.reading_validation_mode = pydicom.config.RAISE
    slices = [pydicom.dcmread(path) for path in folder.iterdir()]
    for image in slices:
        missing = [name for name in DICOM[0].split() if not image.get(name) and image.get(name) != 0]
        assert not missing + [name for name in DICOM[1].split() if name not in image], missing
        assert image.file_meta.MediaStorageSOPInstanceUID == image.SOPInstanceUID
    assert len({image.SOPInstanceUID for image in slices}) == len(slices)
    assert len({(image.SeriesInstanceUID, image.FrameOfReferenceUID) for image in slices}) == 1
    row, column = np.array(slices[0].ImageOrientationPatient, float).reshape(2, 3)
    normal = np.cross(row, column)
    slices.sort(key=lambda image: normal @ np.array(image.ImagePositionPatient, float))
    first = np.array(slices[0].ImagePositionPatient, float)
    pitch = normal @ (np.array(slices[1].ImagePositionPatient, float) - first)
    down, across = map(float, slices[0].PixelSpacing)

    def value(point):
        way = np.array(point) - first
        x, y, z = (round(way @ axis / step) for axis, step in [(row, across), (column, down), (normal, pitch)])
        return slices[z].pixel_array[y, x] * float(slices[z].RescaleSlope) + float(slices[z].RescaleIntercept)

    return value


def mesh(path):
    found = trimesh.load(path, force="mesh")
    return {"closed": bool(found.is_watertight and found.is_winding_consistent), "volume": float(found.volume)}


def letters(path):
    """Rows of the letters on the right, front and upper side of the cube, by reader; `path` may be a DICOM series."""
    reader = sitk.ImageSeriesReader()
    if path.is_dir():
        reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(path)))
    image = reader.Execute() if path.is_dir() else sitk.ReadImage(str(path))
    readers = {"itk": lambda point: image[image.TransformPhysicalPointToIndex(point)]}
    if path.is_dir():
        readers["pydicom"] = seen_by_pydicom(path)
    if ".nii" in path.suffixes:
        file = nibabel.load(path)
        values, inverse = file.get_fdata(), np.linalg.inv(TO_ITK @ file.affine)
        readers["nibabel"] = lambda point: values[tuple(np.rint(inverse @ [*point, 1.0])[:3].astype(int))]
    # The patient's left, back and head are x, y and z: a reader in front of a side has its right at up × side.
    sides = [([-1, 0, 0], [0, 0, 1]), ([0, -1, 0], [0, 0, 1]), ([0, 0, 1], [0, -1, 0])]

    def rows(at, side, up):
        side, up = np.array(side, float), np.array(up, float)
        right = np.cross(up, side)
        # In the middle of the part that stands out, in the lengths of a volume of 2.
        point = lambda row, column: 0.65 * side + 0.12 * (right * (column - 2) + up * (3 - row))
        return ["".join("#" if at(point(row, column).tolist()) > 0.5 else "." for column in range(5)) for row in range(7)]

    return {who: [rows(at, *side) for side in sides] for who, at in readers.items()}


def check(name, found, expected):
    """Asserts that SimpleITK reads the expected content: the test must not depend on this script's interpretation of a format."""
    assert found["shape"] == expected["shape"], name
    for key in ["values", "spacing", "origin", "directions"]:
        assert np.allclose(found[key], expected[key], atol=1e-5), (name, key, found[key], expected[key])


def make(folder):
    expected = {}
    # Axes differ in length, spacing and origin; no value occurs twice.
    values = np.arange(3 * 4 * 5).reshape(3, 4, 5) * 2 + 1
    spacing, origin = [0.5, 0.75, 1.25], [-3.0, 7.0, 0.5]
    turned = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, 0.8], [-0.8, 0.0, 0.6]])

    def by_itk(name, dtype, directions=np.eye(3), **how):
        image = sitk.GetImageFromArray(np.ascontiguousarray(values.astype(dtype).transpose(2, 1, 0)))
        image.SetSpacing(spacing)
        image.SetOrigin(origin)
        image.SetDirection(directions.ravel().tolist())
        sitk.WriteImage(image, str(folder / name), **how)
        expected[name] = place(values.astype(dtype), spacing, origin, directions)

    dtypes = ["uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64"]
    for dtype in dtypes:
        for ending in ["mha", "nrrd", "nii"]:
            by_itk(f"itk_{dtype}.{ending}", dtype)
    by_itk("itk_packed.mha", "int16", useCompression=True)
    by_itk("itk_packed.nrrd", "float32", useCompression=True)
    by_itk("itk_packed.nii.gz", "float64", useCompression=True)
    by_itk("itk_beside.mhd", "uint16")
    by_itk("itk_beside.nhdr", "uint16")
    for ending in ["mha", "nrrd", "nii"]:
        by_itk(f"itk_turned.{ending}", "float32", turned)
        by_itk(f"itk_mirrored.{ending}", "float32", turned @ np.diag([1.0, 1.0, -1.0]))

    def by_nibabel(name, affine, dtype="<f4", scaling=None, forms="both", stored=values):
        header = nibabel.Nifti1Header(endianness=dtype[0] if dtype[0] in "<>" else "<")
        header.set_data_dtype(np.dtype(dtype))
        image = nibabel.Nifti1Image(stored.astype(dtype), affine, header=header)
        image.set_qform(affine if forms in ("both", "qform") else None, code=1 if forms in ("both", "qform") else 0)
        image.set_sform(affine if forms in ("both", "sform") else None, code=2 if forms in ("both", "sform") else 0)
        content = stored.astype(float)
        if scaling:
            image.header.set_slope_inter(*scaling)
            content = content * scaling[0] + scaling[1]
            with open(folder / name, "wb") as file:
                image.header.write_to(file)
                file.seek(352)
                file.write(stored.astype(dtype).tobytes(order="F"))
        else:
            nibabel.save(image, folder / name)
        in_itk = TO_ITK @ affine
        sides = np.linalg.norm(in_itk[:3, :3], axis=0)
        expected[name] = place(content, sides, in_itk[:3, 3], in_itk[:3, :3] / sides)

    straight = TO_ITK @ np.vstack([np.c_[np.diag(spacing), origin], [0, 0, 0, 1]])
    right = np.vstack([np.c_[np.diag(spacing), origin], [0, 0, 0, 1]])
    oblique = TO_ITK @ np.vstack([np.c_[turned * spacing, origin], [0, 0, 0, 1]])
    by_nibabel("nibabel.nii", straight)
    by_nibabel("nibabel_packed.nii.gz", straight, dtype="<i2")
    by_nibabel("nibabel_big_endian.nii", straight, dtype=">f4")
    by_nibabel("nibabel_big_endian_short.nii", straight, dtype=">i2")
    by_nibabel("nibabel_right.nii", right)
    by_nibabel("nibabel_oblique.nii.gz", oblique)
    by_nibabel("nibabel_qform.nii", oblique, forms="qform")
    by_nibabel("nibabel_sform.nii", oblique, forms="sform")
    by_nibabel("nibabel_scaled.nii", straight, dtype="<i2", scaling=(0.25, -3.0))
    by_nibabel("nibabel_scaled_big_endian.nii", straight, dtype=">i2", scaling=(0.25, -3.0))

    # A NRRD with RAS coordinates.
    header = (
        "NRRD0004\ntype: double\ndimension: 3\nspace: right-anterior-superior\nsizes: 3 4 5\n"
        "space directions: (-0.5,0,0) (0,-0.75,0) (0,0,1.25)\nendian: big\nencoding: raw\nspace origin: (3,-7,0.5)\n\n"
    )
    (folder / "ras.nrrd").write_bytes(header.encode() + values.astype(">f8").tobytes(order="F"))
    expected["ras.nrrd"] = place(values, spacing, origin, np.eye(3))
    for name, what in expected.items():
        check(name, seen_by_itk(folder / name), what)
    (folder / "expected.json").write_text(json.dumps(expected))

    # Point clouds as R²-Gaussian writes them: torch's f32, and the bounds as f64.
    generator = np.random.default_rng(5)
    raw = {
        "xyz": generator.uniform(-1, 1, (6, 3)).astype("f4"),
        "density": generator.normal(-2, 1, (6, 1)).astype("f4"),
        "scale": generator.normal(-3, 1, (6, 3)).astype("f4"),
        "rotation": generator.normal(0, 1, (6, 4)).astype("f4"),
        "scale_bound": np.array([0.0005, 0.5]) * 2.0,
    }
    for name, bound in [("point_cloud", raw["scale_bound"]), ("unbounded", None)]:
        for protocol in range(2, 6):
            with open(folder / f"{name}_{protocol}.pickle", "wb") as file:
                pickle.dump({**raw, "scale_bound": bound}, file, protocol)
    wide = {key: array.astype(float) for key, array in raw.items()}
    low, high = raw["scale_bound"]
    physical = {
        "mean": wide["xyz"],
        "density": np.log1p(np.exp(wide["density"])),
        "scale": low + (high - low) / (1 + np.exp(-wide["scale"])),
        "unbounded_scale": np.exp(wide["scale"]),
        "quaternion": wide["rotation"],
    }
    (folder / "physical.json").write_text(json.dumps({key: array.ravel().tolist() for key, array in physical.items()}))


def odd(folder):
    """Files that other programs write or read in forms of their own; spacing and origin are None where no judge states them."""
    expected = {}
    values = np.arange(3 * 4 * 5).reshape(3, 4, 5) * 2 + 1
    spacing, origin = [0.5, 0.75, 1.25], [-3.0, 7.0, 0.5]
    in_file = values.astype("<f4").tobytes(order="F")

    def judged(name, seen, with_place=True):
        found = {key: seen[key] for key in ["shape", "values", "spacing", "origin"]}
        if not with_place:
            found["spacing"] = found["origin"] = None
        expected[name] = found

    # Headers by hand, judged by SimpleITK.
    mhd = (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nElementSpacing = 0.5 0.75 1.25\n"
        "Offset = -3 7 0.5\nDimSize = 3 4 5\nElementType = MET_FLOAT\n"
    )
    (folder / "skipped.raw").write_bytes(b"\t" * 100 + in_file)
    (folder / "plain.raw").write_bytes(in_file)
    slices = [f"slice{z:02}.raw" for z in range(5)]
    for z, name in enumerate(slices):
        (folder / name).write_bytes(in_file[48 * z : 48 * (z + 1)])
    heads = {
        "skip.mhd": "HeaderSize = 100\nElementDataFile = skipped.raw\n",
        "end.mhd": "HeaderSize = -1\nElementDataFile = skipped.raw\n",
        "dot.mhd": "ElementDataFile = ./plain.raw\n",
        "list.mhd": "ElementDataFile = LIST\n" + "\n".join(slices) + "\n",
        "pattern.mhd": "ElementDataFile = slice%02d.raw 0 4 1\n",
    }
    for name, end in heads.items():
        (folder / name).write_text(mhd + end)
    (folder / "negative.mha").write_bytes((mhd.replace("0.5 0.75", "-0.5 0.75") + "ElementDataFile = LOCAL\n").encode() + in_file)
    nhdr = "NRRD0004\ntype: float\ndimension: 3\nsizes: 3 4 5\nendian: little\nencoding: raw\n"
    placed = "space: left-posterior-superior\nspace directions: (0.5,0,0) (0,0.75,0) (0,0,1.25)\nspace origin: (-3,7,0.5)\n"
    heads = {
        "skip.nhdr": placed + "byte skip: 100\ndata file: skipped.raw\n",
        "end.nhdr": placed + "byte skip: -1\ndata file: skipped.raw\n",
        "list.nhdr": placed + "data file: LIST\n" + "\n".join(slices) + "\n",
        "pattern.nhdr": placed + "data file: slice%02d.raw 0 4 1\n",
        "cells.nhdr": "spacings: 0.5 0.75 1.25\naxis mins: 1 2 3\ndata file: plain.raw\n",
        "nodes.nhdr": "spacings: 0.5 0.75 1.25\naxis mins: 1 2 3\ncenters: node node node\ndata file: plain.raw\n",
    }
    for name, end in heads.items():
        (folder / name).write_text(nhdr + end)
    for name in [path.name for path in sorted(folder.iterdir()) if path.suffix in [".mhd", ".mha", ".nhdr"]]:
        judged(name, seen_by_itk(folder / name))

    # pynrrd packs with bzip2 and writes text.
    header = {"space": "left-posterior-superior", "space directions": np.diag(spacing), "space origin": origin}
    for encoding in ["bzip2", "gzip", "ascii"]:
        name = f"pynrrd_{encoding}.nrrd"
        nrrd.write(str(folder / name), values.astype("<i2"), {**header, "encoding": encoding}, index_order="F")
        content, seen = nrrd.read(str(folder / name), index_order="F")
        judged(name, place(content, np.diag(seen["space directions"]), seen["space origin"], np.eye(3)))

    # NIfTI: units as SimpleITK reads them, and the second version as nibabel does.
    affine = TO_ITK @ np.vstack([np.c_[np.diag(spacing), origin], [0, 0, 0, 1]])
    for unit in ["micron", "mm", "meter"]:
        image = nibabel.Nifti1Image(values.astype("<f4"), affine)
        image.header.set_xyzt_units(unit, "sec")
        nibabel.save(image, folder / f"{unit}.nii")
        judged(f"{unit}.nii", seen_by_itk(folder / f"{unit}.nii"))
    for name, order in [("second.nii", "<"), ("second_packed.nii.gz", "<"), ("second_big.nii", ">")]:
        header = nibabel.Nifti2Header(endianness=order)
        header.set_data_dtype(np.dtype(order + "i2"))
        nibabel.save(nibabel.Nifti2Image(values.astype(order + "i2"), affine, header=header), folder / name)
        judged(name, seen_by_nibabel(folder / name))
    image = nibabel.Nifti1Image(values.astype("<f4"), affine)
    image.set_qform(affine, code=1)
    image.set_sform(np.zeros((4, 4)), code=1)
    image.header["pixdim"][1:4] = spacing
    nibabel.save(image, folder / "zero_sform.nii")
    judged("zero_sform.nii", seen_by_itk(folder / "zero_sform.nii"))

    # TIFF: pages are [z, y, x].
    pages = np.ascontiguousarray(values.transpose(2, 1, 0))

    def by_tifffile(name, dtype, sides=None, **how):
        tifffile.imwrite(folder / name, pages.astype(dtype), **how)
        content = tifffile.imread(folder / name).reshape(5, 4, 3).transpose(2, 1, 0)
        judged(name, {**place(content, sides or [1, 1, 1], [0, 0, 0], np.eye(3)), **({} if sides else {"spacing": None}), "origin": None})

    resolution = (1 / spacing[0], 1 / spacing[1])
    for dtype in ["uint8", "uint16", "float32"]:
        by_tifffile(f"imagej_{dtype}.tif", dtype, spacing, imagej=True, resolution=resolution, metadata={"spacing": 1.25, "unit": "mm", "axes": "ZYX"})
    micron = [side / 1000 for side in spacing]
    by_tifffile("imagej_um.tif", "uint16", micron, imagej=True, resolution=resolution, metadata={"spacing": 1.25, "unit": "um", "axes": "ZYX"})
    by_tifffile("imagej_one_directory.tif", "uint16", spacing, imagej=True, truncate=True, resolution=resolution, metadata={"spacing": 1.25, "unit": "mm", "axes": "ZYX"})
    by_tifffile("shaped.tif", "float32", photometric="minisblack")
    by_tifffile("shaped_one_directory.tif", "float32", photometric="minisblack", truncate=True)
    by_tifffile("white.tif", "uint8", photometric="miniswhite")
    for compression in ["zstd", "lzw", "deflate", "packbits"]:
        by_tifffile(f"{compression}.tif", "uint16", photometric="minisblack", compression=compression)
    by_tifffile("zstd_horizontal.tif", "uint16", photometric="minisblack", compression="zstd", predictor=2)
    by_tifffile("zstd_float.tif", "float32", photometric="minisblack", compression="zstd", predictor=3)
    by_tifffile("zstd_big.tif", "float64", photometric="minisblack", compression="zstd", bigtiff=True, byteorder=">")
    by_tifffile("zstd_tiles.tif", "float32", photometric="minisblack", compression="zstd", tile=(16, 16))
    by_tifffile("zstd_strips.tif", "uint16", photometric="minisblack", compression="zstd", rowsperstrip=1)
    physical = {"axes": "ZYX", "PhysicalSizeX": 500.0, "PhysicalSizeY": 750.0, "PhysicalSizeZ": 1250.0}
    by_tifffile("pages.ome.tif", "uint16", spacing, photometric="minisblack", metadata=physical)

    # Folders of images.
    for name, encode in [("png", imagecodecs.png_encode), ("jpg", lambda page: imagecodecs.jpeg8_encode(page, level=100))]:
        (folder / name).mkdir()
        for z, page in enumerate(pages.astype("u1")):
            (folder / name / f"{z}.{name}").write_bytes(encode(page))
        decode = imagecodecs.png_decode if name == "png" else imagecodecs.jpeg8_decode
        content = np.stack([decode((folder / name / f"{z}.{name}").read_bytes()) for z in range(5)]).transpose(2, 1, 0)
        judged(name, place(content, spacing, origin, np.eye(3)), with_place=False)
    (folder / "expected.json").write_text(json.dumps(expected))


if __name__ == "__main__":
    if sys.argv[1] in ["see", "letters", "mesh"]:
        look = {"see": see, "letters": letters, "mesh": mesh}[sys.argv[1]]
        print(json.dumps({path: look(pathlib.Path(path)) for path in sys.argv[2:]}))
    else:
        {"make": make, "odd": odd}[sys.argv[1]](pathlib.Path(sys.argv[2]))
