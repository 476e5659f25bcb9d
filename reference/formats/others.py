"""Reads and writes files with other programs, for tests/cli/formats.rs, which judges the result.

    others.py see FILE...    prints as JSON what SimpleITK, nibabel, plyfile and NumPy read from each file
    others.py make FOLDER    writes files in many formats, and expected.json with their contents

tests/data/point_cloud.pickle is the point_cloud_5.pickle of `make`. Positions are in ITK's coordinates (left, posterior,
superior).
"""

import json
import pathlib
import pickle
import sys

import nibabel
import numpy as np
import plyfile
import SimpleITK as sitk

# Signs that convert from and to nibabel's coordinates (right, anterior, superior).
TO_ITK = np.diag([-1.0, -1.0, 1.0, 1.0])
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


if __name__ == "__main__":
    if sys.argv[1] == "see":
        print(json.dumps({path: see(pathlib.Path(path)) for path in sys.argv[2:]}))
    else:
        make(pathlib.Path(sys.argv[2]))
