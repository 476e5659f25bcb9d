"""Poses, the geometries of other programs, gradients to motions, and copies of scans."""

import copy
import pickle
import types

import numpy as np
import pytest

import trgs
from conftest import model_of

ANGLES = [0.3, 2.1, 4.4]


def circle(scanner, angles):
    """The vectors of plain views, as the geometry page defines them."""
    rows = []
    for angle in angles:
        c, s = np.cos(angle), np.sin(angle)
        forward, u, v = np.array([-c, -s, 0]), np.array([-s, c, 0]), np.array([0, 0, -1.0])
        source = -scanner.dso * forward
        (offset_v, offset_u), (pitch_v, pitch_u) = scanner.offset, scanner.pitch
        centre = source + scanner.dsd * forward + offset_u * u + offset_v * v
        rows.append(np.concatenate([source, centre, pitch_u * u, pitch_v * v]))
    return np.array(rows)


def turned(vectors, axis, step, shift):
    """Source and detector, moved together."""
    k = np.cross(axis, np.eye(3))
    turn = np.eye(3) + np.sin(step) * k.T + (1 - np.cos(step)) * (k @ k)
    moved = (vectors.reshape(-1, 4, 3) @ turn.T).copy()
    moved[:, :2] += shift
    return moved.reshape(-1, 12)


def test_poses_on_the_circle_are_the_plain_views(model, scanner):
    vectors, plain = circle(scanner, ANGLES), trgs.project(model, scanner, ANGLES)
    assert np.allclose(trgs.project(model, scanner, vectors), plain, rtol=1e-10, atol=1e-12)
    volume = trgs.voxelize(model, scanner)
    expected = trgs.forward_project(volume, scanner, ANGLES)
    found = trgs.forward_project(volume, scanner, vectors)
    assert np.allclose(found, expected, rtol=1e-8, atol=1e-9)
    assert np.vdot(found, found) == pytest.approx(np.vdot(volume, trgs.back_project(found, scanner, vectors)), rel=1e-12)
    assert np.allclose(trgs.confidence(model, scanner, vectors), trgs.confidence(model, scanner, ANGLES), rtol=1e-9)
    for row, other in zip(trgs.project_vjp(model, scanner, vectors, plain), trgs.project_vjp(model, scanner, ANGLES, plain)):
        assert np.allclose(row, other, rtol=1e-8, atol=1e-9)
    again = trgs.Scanner.from_vectors(vectors, detector=(9, 12), grid=scanner.grid)
    assert again.detector == scanner.detector
    for name in ("dso", "dsd", "pitch", "offset"):
        assert getattr(again, name) == pytest.approx(getattr(scanner, name), rel=1e-12)


def test_poses_that_do_not_fit_are_refused(model, scanner):
    vectors = circle(scanner, ANGLES)
    with pytest.raises(ValueError, match="length of u of a vector"):
        trgs.project(model, scanner, vectors * 2)
    with pytest.raises(ValueError, match="vector of a view: got 11 numbers, expected 12 numbers"):
        trgs.project(model, scanner, vectors[:, :11])
    with pytest.raises(ValueError, match="angles: got vectors of poses, expected radians"):
        trgs.fdk_filter(np.ones((3, 9, 12)), scanner, vectors)
    with pytest.raises(ValueError, match=r"vectors: got shape \[3, 11\], expected \[view, 12\]"):
        trgs.Scanner.from_vectors(vectors[:, :11], detector=(9, 12), grid=scanner.grid)


class Tensor:
    """An array of another library."""

    def __init__(self, values):
        self.values = values

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.values, dtype=dtype)


def test_angles_are_arrays_and_tensors_of_any_real_numbers(model, scanner):
    exact = trgs.project(model, scanner, [0.5, 2.0])
    for angles in [np.array([0.5, 2.0], np.float32), np.array([0.5, 9.0, 2.0, 9.0])[::2], Tensor([0.5, 2.0]), (0.5, 2.0)]:
        assert np.array_equal(trgs.project(model, scanner, angles), exact)
    assert np.array_equal(trgs.project(model, scanner, np.arange(2)), trgs.project(model, scanner, [0.0, 1.0]))
    for angles in [Tensor(["a"]), np.array([1j]), 0.5]:
        with pytest.raises(TypeError, match="angles: got"):
            trgs.project(model, scanner, angles)


@pytest.mark.parametrize("projection", ["exact", "affine"])
def test_gradients_to_motions_are_differences(scanner, projection):
    model, vectors = model_of(4), circle(scanner, ANGLES)
    cotangent = np.random.default_rng(5).normal(size=(3, 9, 12))
    found = trgs.motion_vjp(model, scanner, vectors, cotangent, projection=projection)
    value = lambda views: (trgs.project(model, scanner, views, projection=projection) * cotangent).sum(axis=(1, 2))
    for k in range(6):
        axis = np.eye(3)[k % 3]
        move = lambda step: turned(vectors, axis, step if k > 2 else 0.0, axis * step if k < 3 else 0.0)
        difference = (value(move(1e-5)) - value(move(-1e-5))) / 2e-5
        assert np.allclose(found[:, k], difference, rtol=0, atol=1e-6 * np.abs(found).max())
    difference = (value(np.add(ANGLES, 1e-5)) - value(np.subtract(ANGLES, 1e-5))) / 2e-5
    turn = trgs.motion_vjp(model, scanner, ANGLES, cotangent, projection=projection)[:, 5]
    assert np.allclose(turn, difference, rtol=0, atol=1e-6 * np.abs(found).max())


def tigre(**more):
    """A geometry with the attributes and orders of TIGRE: [z, y, x] and [v, u]."""
    values = {
        "mode": "cone", "DSO": 1000.0, "DSD": 1500.0, "nDetector": np.array([9, 12]), "dDetector": np.array([60.0, 50.0]),
        "nVoxel": np.array([6, 10, 8]), "sVoxel": np.array([240.0, 400.0, 320.0]), "dVoxel": np.array([40.0, 40.0, 40.0]),
        "offOrigin": np.array([0, 0, 0]), "offDetector": np.array([8.0, -4.0, 0]), "rotDetector": np.array([0, 0, 0]), "COR": 0,
    }
    return types.SimpleNamespace(**(values | more))


def test_geometries_of_tigre_are_read():
    scanner, angles, scale = trgs.from_tigre(tigre(), ANGLES)
    assert scale == 2 / 400 and np.array_equal(angles, ANGLES)
    assert (scanner.dso, scanner.dsd, scanner.detector) == (5.0, 7.5, (9, 12)) and scanner.grid.shape == (8, 10, 6)
    # TIGRE counts the shift of the detector upwards.
    assert np.allclose([scanner.pitch, scanner.offset], [(0.3, 0.25), (-0.04, -0.02)])
    assert np.allclose(scanner.grid.high, (0.8, 1.0, 0.6))
    _, poses, _ = trgs.from_tigre(tigre(COR=20.0, rotDetector=np.array([0, 0, 0.1])), ANGLES)
    plain = circle(scanner, ANGLES)
    assert poses.shape == (3, 12) and np.allclose(poses[:, :3] - plain[:, :3], 0.1 * plain[:, 6:9] / 0.25, atol=1e-12)
    parallel = trgs.from_tigre(tigre(mode="parallel"), ANGLES).scanner
    assert parallel.beam == "parallel" and parallel.pitch == pytest.approx((0.3, 0.25))
    with pytest.raises(ValueError, match="geo: got no nVoxel, expected the attributes of tigre.geometry; set geo.nVoxel"):
        trgs.from_tigre(tigre(nVoxel=None), ANGLES)


def astra(kind="cone", **more):
    volume = {"GridRowCount": 10, "GridColCount": 8, "GridSliceCount": 6, "option": {
        "WindowMinX": -160.0, "WindowMaxX": 160.0, "WindowMinY": -200.0, "WindowMaxY": 200.0,
        "WindowMinZ": -120.0, "WindowMaxZ": 120.0}}
    return {"type": kind, "DetectorRowCount": 9, "DetectorColCount": 12, **more}, volume


def test_geometries_of_astra_are_read(model):
    """The vectors are those of astra.functions.geom_2vec for the same cone: both are the same scanner."""
    thetas = np.array(ANGLES)
    sizes = {"DetectorSpacingX": 50.0, "DetectorSpacingY": 60.0, "ProjectionAngles": thetas}
    cone = trgs.from_astra(*astra(DistanceOriginSource=1000.0, DistanceOriginDetector=500.0, **sizes))
    c, s, zero = np.cos(thetas), np.sin(thetas), np.zeros(3)
    vectors = np.array([1000 * s, -1000 * c, zero, -500 * s, 500 * c, zero, 50 * c, 50 * s, zero, zero, zero, zero + 60]).T
    posed = trgs.from_astra(*astra("cone_vec", Vectors=vectors))
    assert cone.scale == posed.scale == 2 / 400 and posed.angles.shape == (3, 12)
    assert np.allclose(posed.angles, circle(cone.scanner, cone.angles), atol=1e-12)
    images = trgs.project(model, cone.scanner, cone.angles)
    assert np.allclose(trgs.project(model, posed.scanner, posed.angles), images, rtol=1e-9, atol=1e-12)
    # At angle 0, ASTRA's source is at -y and its columns run along +x: a primitive there is in the right half.
    right = trgs.Model(np.array([[0.5, 0.0, 0.3]]), np.full((1, 3), 0.05), np.eye(4)[:1], np.ones(1), np.ones(1))
    sizes["ProjectionAngles"] = np.zeros(1)
    geometry = trgs.from_astra(*astra(DistanceOriginSource=1000.0, DistanceOriginDetector=500.0, **sizes))
    row, column = np.unravel_index(trgs.project(right, *geometry[:2])[0].argmax(), (9, 12))
    assert column > 6 and row < 4
    parallel = trgs.from_astra(*astra("parallel3d", **sizes)).scanner
    assert parallel.beam == "parallel" and parallel.grid.shape == (8, 10, 6)
    with pytest.raises(ValueError, match="proj_geom: got type 'fanflat'"):
        trgs.from_astra(*astra("fanflat"))


def test_scans_are_pickled_and_copied(scan, scanner):
    vectors = circle(scanner, ANGLES) + 0.0
    posed = trgs.Scan(scanner, vectors, np.random.default_rng(0).uniform(0.1, 1, (3, 9, 12)).astype(np.float32), name="posed")
    assert posed.poses.shape == (3, 12) and np.allclose(posed.poses, vectors, atol=1e-15) and scan.poses is None
    for one in (scan, posed):
        for again in (pickle.loads(pickle.dumps(one)), copy.deepcopy(one)):
            assert again.scanner == one.scanner and (again.unit, again.scale) == (one.unit, one.scale)
            assert (again.name, again.place, again.notes, again.oddities) == (one.name, one.place, one.notes, one.oddities)
            for name in ("angles", "poses", "projections", "test_angles", "test_poses", "test_projections", "truth"):
                left, right = getattr(again, name), getattr(one, name)
                assert (left is None and right is None) or np.array_equal(left, right), name


def test_posed_scans_are_reconstructed_along_their_poses(scanner):
    """The same views, once as angles and once as poses, and once at wrong angles."""
    images = trgs.project(model_of(3), scanner, ANGLES, dtype=np.float32)
    run = lambda views: trgs.reconstruct(trgs.Scan(scanner, views, images), "sart", {"iterations": 5}).volume
    plain = run(ANGLES)
    assert np.allclose(run(circle(scanner, ANGLES)), plain, atol=1e-4 * plain.max())
    assert not np.allclose(run(np.add(ANGLES, 0.5)), plain, atol=1e-2 * plain.max())


def test_settings_are_a_dict_or_keywords(scan):
    one = trgs.reconstruct(scan, "sart", {"iterations": 2, "algebraic": {"relaxation": 0.8}})
    two = trgs.reconstruct(scan, "sart", iterations=2, algebraic={"relaxation": 0.8})
    assert np.array_equal(one.volume, two.volume) and one.settings == two.settings
    with pytest.raises(TypeError, match="settings: got an object of type str, expected a dict of keys"):
        trgs.reconstruct(scan, "sart", "iterations = 2")
