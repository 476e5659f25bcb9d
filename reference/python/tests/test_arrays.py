"""Arguments: nothing is converted or copied silently, and every refusal says what, got, expected and remedy."""

import pickle

import numpy as np
import pytest

import trgs
from conftest import model_of
from trgs import density, losses, metrics, optim

ANGLES = [0.0, 1.0]


def zeros(*shape, dtype=np.float64):
    return np.zeros(shape, dtype=dtype)


@pytest.mark.parametrize(
    ("bad", "got"),
    [
        (zeros(2, 9, 12, dtype=np.int64), "ndarray of int64, shape [2, 9, 12]"),
        (zeros(2, 9, 12, dtype=np.float16), "ndarray of float16"),
        (zeros(2, 9, 12, dtype=">f8"), "ndarray of >f8"),
        (zeros(9, 12), "shape [9, 12]"),
        (zeros(12, 9, 2).T, "not contiguous in C order"),
        (zeros(2, 9, 24)[:, :, ::2], "not contiguous in C order"),
        ([[[0.0]]], "an object of type list"),
        (np.frombuffer(bytes(2 * 9 * 12 * 8 + 1), dtype=np.uint8)[1:].view(np.float64).reshape(2, 9, 12), "float64"),
    ],
    ids=["int", "half", "big-endian", "axes", "fortran", "strided", "list", "unaligned"],
)
def test_other_arrays_are_refused(model, scanner, bad, got):
    with pytest.raises(TypeError) as caught:
        trgs.project_vjp(model, scanner, ANGLES, bad)
    message = str(caught.value)
    assert message.startswith("cotangent: got ") and got in message
    expected = "expected a C-contiguous NumPy array of float32 or float64, [view, v, u]"
    has_other_axes = np.ndim(bad) != 3
    remedy = "give an array with 3 axes" if has_other_axes else "give np.ascontiguousarray(cotangent, dtype=np.float64)"
    assert f"{expected}; {remedy}" in message


def test_other_shapes_are_refused(model, scanner):
    with pytest.raises(ValueError, match=r"cotangent: got shape \[2, 12, 9\], expected shape \[2, 9, 12\]; give one image"):
        trgs.project_vjp(model, scanner, ANGLES, zeros(2, 12, 9))
    with pytest.raises(ValueError, match=r"cotangent: got shape \[3, 9, 12\]"):
        trgs.project_vjp(model, scanner, ANGLES, zeros(3, 9, 12))
    with pytest.raises(ValueError, match=r"target: got shape \[3, 5\], expected shape \[5, 3\]"):
        losses.l1(zeros(5, 3), zeros(3, 5))
    with pytest.raises(TypeError, match="target: got ndarray of float32.*array of float64"):
        losses.l1(zeros(5, 3), zeros(5, 3, dtype=np.float32))
    with pytest.raises(TypeError, match="truth: got ndarray of float64.*array of float32"):
        metrics.psnr_3d(zeros(3, 3, 3), zeros(3, 3, 3))


def test_words_and_numbers_out_of_range_are_refused(model, scanner):
    with pytest.raises(ValueError, match='projection: got "fan", expected one of "exact", "affine"; give projection="exact"'):
        trgs.project(model, scanner, ANGLES, projection="fan")
    with pytest.raises(ValueError, match="cutoff: got 1.5, expected a number from 0 to below 1"):
        trgs.voxelize(model, scanner, cutoff=1.5)
    with pytest.raises(ValueError, match="dtype: got <class 'numpy.float16'>, expected float32 or float64"):
        trgs.project(model, scanner, ANGLES, dtype=np.float16)
    with pytest.raises(ValueError, match="angles: got NaN, expected finite numbers of radians"):
        trgs.project(model, scanner, [0.0, np.nan])
    with pytest.raises(TypeError, match="angles: got ndarray of complex128"):
        trgs.project(model, scanner, np.zeros(2, dtype=np.complex128))
    with pytest.raises(TypeError, match="grid: got an object of type float"):
        trgs.voxelize(model, 3.0)
    with pytest.raises(ValueError, match="algebraic.relaxation"):
        trgs.sart(np.arange(216, dtype=np.float32).reshape(2, 9, 12), scanner, ANGLES, relaxation=-1.0)
    with pytest.raises(ValueError, match="neighbours: got 1, expected at least 3"):
        trgs.wavelet_loss(zeros(2, 2, 2), np.full((2, 2, 2), 3, dtype=np.uint16), neighbours=1)
    with pytest.raises(ValueError, match=r"block: got shape \[3, 4, 4\] with 1 levels"):
        trgs.haar(zeros(3, 4, 4))
    with pytest.raises(ValueError, match=r"levels: got shape \[8, 2, 2, 2\], expected shape \[8, 1, 1, 1\]"):
        trgs.haar_inverse([zeros(8, 2, 2, 2), zeros(8, 2, 2, 2)])
    with pytest.raises(ValueError, match="levels: got shape"):
        trgs.haar_inverse([zeros(7, 2, 2, 2)])
    with pytest.raises(ValueError, match="delta: got -1"):
        trgs.kernel([-1.0], [3.0])


def test_a_model_is_checked():
    good = {"mean": zeros(2, 3), "scale": np.ones((2, 3)), "quaternion": np.ones((2, 4)), "density": zeros(2), "nu": np.ones(2)}
    assert len(trgs.Model(**good)) == 2
    for name, value, message in [
        ("mean", zeros(2, 4), r"mean: got shape \[2, 4\], expected \[M, 3\]"),
        ("mean", zeros(3, 3), "mean: got 3 rows, expected 2, as many as densities"),
        ("scale", zeros(2, 3), "scale of primitive 0"),
        ("quaternion", zeros(2, 4), "quaternion of primitive 0"),
        ("density", np.full(2, np.nan), "density of primitive 0"),
        ("nu", zeros(2), "nu of primitive 0"),
    ]:
        with pytest.raises(ValueError, match=message):
            trgs.Model(**{**good, name: value})
    with pytest.raises(TypeError, match="density: got ndarray of int64"):
        trgs.Model(**{**good, "density": np.zeros(2, dtype=np.int64)})


def test_single_precision_is_widened_exactly_and_kept():
    wide = model_of(5)
    arrays = [getattr(wide, name) for name in trgs.Parameters._fields]
    single = trgs.Model(*(array.astype(np.float32) for array in arrays))
    for name, array in zip(trgs.Parameters._fields, arrays):
        kept = getattr(single, name)
        assert kept.dtype == np.float64 and np.array_equal(kept, array.astype(np.float32).astype(np.float64))


def test_a_model_has_arrays_of_its_own():
    mean = np.zeros((1, 3))
    model = trgs.Model(mean, np.ones((1, 3)), np.ones((1, 4)), np.ones(1), np.ones(1))
    mean[:] = 1.0
    assert np.array_equal(model.mean, np.zeros((1, 3)))


def test_copies_of_an_objects_arrays_refuse_writes(model, scan):
    for array in [model.mean, model.scale, model.quaternion, model.density, model.nu]:
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 2.0
    for array in [scan.angles, scan.projections, scan.test_angles, scan.test_projections, scan.truth]:
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0.0


@pytest.mark.parametrize(
    ("call", "kind", "argument", "message"),
    [
        (lambda: trgs.Grid(64), TypeError, "shape", "got 64, expected a tuple of 3 counts; give (64, 64, 64)"),
        (lambda: trgs.Grid((4, 4)), TypeError, "shape", "got (4, 4), expected a tuple of 3 counts"),
        (lambda: trgs.Grid((4, -4, 4)), ValueError, "shape", "got (4, -4, 4), expected a tuple of 3 counts"),
        (lambda: trgs.Grid((4, 4, 10**40)), ValueError, "shape", ", expected a tuple of 3 counts"),
        (lambda: trgs.Grid((4, 4, 4), low=0), TypeError, "low", "got 0, expected a tuple of 3 numbers"),
        (
            lambda: trgs.Scanner.cone(5, 7, detector=(8, 8), pitch=(1, 1), grid=(4, 4, 4)),
            TypeError,
            "grid",
            "got an object of type tuple, expected a Grid; give trgs.Grid(",
        ),
        (
            lambda: trgs.Scanner.parallel(detector=8, pitch=(1, 1), grid=trgs.Grid([4, 4, 4])),
            TypeError,
            "detector",
            "got 8, expected a tuple of 2 counts",
        ),
    ],
)
def test_wrong_tuples_are_named_with_a_remedy(call, kind, argument, message):
    with pytest.raises(kind) as raised:
        call()
    # The name of the argument is a note, or before the message where Python has no notes.
    text = "\n".join([str(raised.value), *getattr(raised.value, "__notes__", [])])
    assert message in text and f"'{argument}'" in text


def test_remedies_are_those_of_arguments():
    with pytest.raises(ValueError, match="scale of primitive 0: got .* correct the array"):
        trgs.Model(np.zeros((1, 3)), np.zeros((1, 3)), np.ones((1, 4)), np.ones(1), np.ones(1))
    stack = np.zeros((2, 8, 8), dtype=np.float32)
    with pytest.raises(TypeError, match=r"give an array with 2 axes, \[v, u\]"):
        trgs.losses.image_loss(stack, stack)
    with pytest.raises(ValueError, match="file to write: got volume.vtk, expected a name that ends with .npy") as caught:
        trgs.save_volume("volume.vtk", np.zeros((2, 2, 2), dtype=np.float32), trgs.Grid((2, 2, 2)))
    assert ".png" not in str(caught.value) and ".h5" not in str(caught.value)


def test_the_kernel_follows_from_nu(model):
    assert (model.kernel, model_of(3, gaussian=True).kernel) == ("student-t", "gaussian")
    assert np.isinf(model_of(3, gaussian=True).nu).all()


@pytest.mark.parametrize("ending", ["npz", "ply"])
def test_a_model_is_saved_and_loaded(tmp_path, model, ending):
    path = tmp_path / f"model.{ending}"
    model.save(path)
    again = trgs.Model.load(path)
    for name in trgs.Parameters._fields:
        assert np.array_equal(getattr(again, name), getattr(model, name))


def test_files_that_cannot_be_used_are_errors(tmp_path, model):
    with pytest.raises(FileNotFoundError, match="cannot read"):
        trgs.Model.load(tmp_path / "nowhere.npz")
    with pytest.raises(ValueError, match="ends in .npz or .ply"):
        model.save(tmp_path / "model.txt")
    with pytest.raises(OSError, match="cannot write"):
        model.save(tmp_path / "no" / "folder.npz")
    (tmp_path / "bad.npz").write_bytes(b"no archive")
    with pytest.raises(ValueError, match="bad.npz"):
        trgs.Model.load(tmp_path / "bad.npz")


def test_models_and_grids_are_pickled(model, scanner):
    again = pickle.loads(pickle.dumps(model))
    assert all(np.array_equal(getattr(again, name), getattr(model, name)) for name in trgs.Parameters._fields)
    assert pickle.loads(pickle.dumps(scanner.grid)) == scanner.grid
    assert pickle.loads(pickle.dumps(scanner)) == scanner


def test_a_scanner_says_what_it_is(scanner):
    assert (scanner.beam, scanner.dso, scanner.dsd, scanner.detector) == ("cone", 5.0, 7.0, (9, 12))
    assert (scanner.pitch, scanner.offset, scanner.grid.shape) == ((0.3, 0.28), (0.1, -0.05), (8, 10, 6))
    parallel = trgs.Scanner.parallel(detector=(4, 4), pitch=(1.0, 1.0), grid=trgs.Grid((4, 4, 4)))
    assert (parallel.beam, parallel.dso, parallel.dsd) == ("parallel", None, None)
    assert parallel != scanner and eval(repr(scanner), {"Scanner": trgs.Scanner, "Grid": trgs.Grid}) == scanner
    block = trgs.Grid((8, 8, 8)).block((2, 0, 4), (2, 2, 2))
    assert (block.low, block.high, block.spacing) == ((-0.5, -1.0, 0.0), (0.0, -0.5, 0.5), (0.25, 0.25, 0.25))
    with pytest.raises(ValueError, match="DSO"):
        trgs.Scanner.cone(1.0, 7.0, detector=(4, 4), pitch=(1.0, 1.0), grid=trgs.Grid((4, 4, 4)))
    with pytest.raises(ValueError, match="grid shape"):
        trgs.Grid((0, 4, 4))
    with pytest.raises(ValueError, match="box of the grid"):
        trgs.Grid((4, 4, 4), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))


def test_the_offset_of_the_detector_counts_downwards():
    """The shadow of a primitive in the middle moves up by a row where the detector moves down by one."""
    grid, one = trgs.Grid((4, 4, 4)), np.ones(1)
    model = trgs.Model(np.zeros((1, 3)), np.full((1, 3), 0.1), np.eye(4)[:1], one, one)
    sees = lambda offset: trgs.Scanner.cone(5.0, 7.0, detector=(9, 9), pitch=(0.4, 0.4), grid=grid, offset=offset)
    peak = lambda offset: np.unravel_index(trgs.project(model, sees(offset), [0.0])[0].argmax(), (9, 9))
    assert (peak((0.0, 0.0)), peak((0.4, 0.0)), peak((0.0, 0.4))) == ((4, 4), (3, 4), (4, 3))


def test_what_is_changed_in_place_must_be_writable_and_fit():
    state, values = optim.Adam(6), np.zeros((2, 3))
    state.step(values, np.ones((2, 3)), 0.1)
    assert np.allclose(values, -0.1)
    values.flags.writeable = False
    with pytest.raises(TypeError, match="parameters: got .*, expected an array that can be written to"):
        state.step(values, np.ones((2, 3)), 0.1)
    with pytest.raises(ValueError, match="parameters: got 4 numbers, expected 6"):
        state.step(np.zeros(4), np.zeros(4), 0.1)
    with pytest.raises(ValueError, match=r"gradient: got shape \[3, 2\]"):
        state.step(np.zeros((2, 3)), np.zeros((3, 2)), 0.1)
    with pytest.raises(ValueError, match="rows: got 2, expected rows below 2"):
        state.remap_rows(3, [0, 2])
    state.remap_rows(3, [1, None, 0])
    assert state.direction(np.ones(9)).shape == (9,)


def test_random_numbers_must_suffice(model):
    settings = {"dead": 0.0, "recycled": 0.0, "growth": 1.0, "cap": 100}
    assert len(density.ar(model, np.full(7, 0.5), **settings).model) == 14
    with pytest.raises(ValueError, match="uniform: got 3 numbers, expected at least 7"):
        density.ar(model, np.full(3, 0.5), **settings)
    with pytest.raises(ValueError, match="uniform: got 1, expected numbers from 0 to below 1"):
        density.ar(model, np.ones(7), **settings)


def test_an_activation_goes_back_and_forth(model):
    activation = optim.Activation((0.01, 1.0), (1.0, 50.0))
    again = activation.forward(activation.inverse(model))
    for name in trgs.Parameters._fields:
        assert np.allclose(getattr(again, name), getattr(model, name), rtol=1e-12)
    with pytest.raises(ValueError, match=r"scale_range: got \(1, 0.5\)"):
        optim.Activation((1.0, 0.5))
    with pytest.raises(ValueError, match="gradient: got 2 rows, expected 7"):
        activation.vjp(model, [array[:2].copy() for array in trgs.project_vjp(
            model, trgs.Scanner.synthetic(4, 4), [0.0], np.ones((1, 4, 4)))])
