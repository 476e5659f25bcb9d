"""Slabs on workers of Dask: the bits of whole volumes, for any number of slabs and workers, also when one of them dies."""

import inspect
import os
import signal

import numpy as np
import pytest
import trgs

distributed = pytest.importorskip("distributed", reason="Dask is not installed")
from trgs import distributed as slabs  # noqa: E402


@pytest.fixture(scope="module")
def scan():
    scanner = trgs.Scanner.cone(5.0, 7.0, detector=(20, 22), pitch=(0.16, 0.15), grid=trgs.Grid((21, 18, 16), (-1, -0.9, -0.8), (1, 0.9, 0.8)))
    return trgs.simulate("torso", scanner, views=7, test_views=0)


def workers(n):
    return distributed.LocalCluster(n_workers=n, threads_per_worker=1, dashboard_address=None)


@pytest.fixture(scope="module")
def client():
    with workers(2) as cluster, distributed.Client(cluster) as client:
        yield client


def same(a, b):
    assert a.dtype == b.dtype and a.tobytes() == b.tobytes()


@pytest.mark.parametrize(("n", "count"), [(1, 2), (2, 7), (5, 3)])
def test_any_number_of_slabs_and_workers_has_the_bits_of_a_whole_volume(scan, n, count):
    with workers(n) as cluster, distributed.Client(cluster) as client:
        every_function(scan, client, count)


def every_function(scan, client, count):
    views = (scan.projections, scan.scanner, scan.angles)
    how = {"slabs": count, "client": client}
    same(slabs.fdk(*views, turn="full", **how), trgs.fdk(*views, turn="full"))
    model = trgs.Model(np.zeros((1, 3)), np.full((1, 3), 0.3), np.array([[1.0, 0, 0, 0]]), np.ones(1), np.full(1, 5.0))
    for dtype in (np.float64, np.float32):
        same(slabs.voxelize(model, scan.scanner, dtype=dtype, **how), trgs.voxelize(model, scan.scanner, dtype=dtype))
    seen, expected = [], []
    found = slabs.os_sart(*views, subset=3, iterations=2, order="angular-distance", callback=seen.append, **how)
    same(found, trgs.os_sart(*views, subset=3, iterations=2, order="angular-distance", callback=expected.append))
    assert seen == expected and len(seen) == 2
    # Sweeps over sets, then iterations over all views.
    same(slabs.tv(*views, weight=0.01, iterations=6, tolerance=0, **how), trgs.tv(*views, weight=0.01, iterations=6, tolerance=0))


def test_poses_and_a_file(scan, client, tmp_path):
    rolled = [[np.cos(a), np.sin(a), -np.sin(a), np.cos(a), 0.1 * a] for a in (0.1, 1.3, 2.2, 4.0)]
    vectors = np.array(
        [
            [4 * c, 4 * s, z, -2 * c, -2 * s, z, 0.15 * u, 0.15 * v, 0.02, 0.02 * u, 0.02 * v, -0.15]
            for c, s, u, v, z in rolled
        ]
    )
    scanner = trgs.Scanner.from_vectors(vectors, detector=(20, 22), grid=scan.scanner.grid)
    projections = np.ascontiguousarray(scan.projections[:4])
    found = slabs.sart(projections, scanner, vectors, iterations=2, client=client, out=tmp_path / "volume.npy")
    same(found, trgs.sart(projections, scanner, vectors, iterations=2))
    assert [path.name for path in tmp_path.iterdir()] == ["volume.npy"]


def test_a_worker_that_dies_is_replaced_and_the_result_is_the_same(scan):
    killed = []

    def kill(progress):
        # After slabs became files once, and between two times.
        if progress.iteration in (3, 6):
            process = list(client.run(os.getpid).values())[progress.iteration % 5]
            os.kill(process, signal.SIGKILL)
            killed.append(process)

    views = (scan.projections, scan.scanner, scan.angles)
    with workers(5) as cluster, distributed.Client(cluster) as client:
        found = slabs.sart(*views, iterations=8, slabs=5, client=client, callback=kill)
    same(found, trgs.sart(*views, iterations=8))
    assert len(set(killed)) == 2


def test_a_weight_is_chosen_as_the_program_does(scan, client):
    views = (scan.projections, scan.scanner, scan.angles)
    seen, expected = [], []
    found = slabs.tv(*views, weight=None, iterations=3, slabs=2, client=client, callback=seen.append)
    same(found, trgs.reconstruct(scan, "tv", iterations=3, callback=expected.append).volume)
    assert seen == expected and {event.stage for event in seen} >= {"choosing"}
    assert found.tobytes() != slabs.tv(*views, iterations=3, slabs=2, client=client).tobytes()


def test_arguments_and_defaults_are_those_of_whole_volumes():
    for name in slabs.__all__:
        one, other = (inspect.signature(getattr(module, name)).parameters for module in (slabs, trgs))
        shared = [argument for argument in other if argument not in ("rays", "dtype")]
        assert [argument for argument in one if argument in shared] == [*shared][: len(shared)], name
        assert all(one[argument].default == other[argument].default for argument in shared if argument != "callback"), name


def test_what_is_wrong_is_said(scan, client):
    views = (scan.projections, scan.scanner, scan.angles)
    with pytest.raises(ValueError, match="slabs: got 0, expected at least 1"):
        slabs.fdk(*views, slabs=0, client=client)
    with pytest.raises(ValueError, match="iterations"):
        slabs.tv(*views, iterations=0, client=client)
    with pytest.raises(ValueError, match="algebraic.order"):
        slabs.sart(*views, order="up", client=client)

    def stop(progress):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        slabs.sart(*views, callback=stop, client=client)
