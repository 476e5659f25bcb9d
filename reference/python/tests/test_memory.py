"""Sizes that no memory holds: exceptions before anything is allocated, and never the end of the interpreter."""

import numpy as np
import pytest

import trgs
from conftest import model_of
from trgs import density, losses, optim

HUGE = [2**20, 2**40, 2**62]
PROJECTIONS = np.arange(3 * 8 * 8, dtype=np.float32).reshape(3, 8, 8)


@pytest.fixture(autouse=True)
def limit():
    trgs.set_max_memory(2_000_000_000)
    yield
    trgs.set_max_memory(None)


def grid(n):
    return trgs.Grid((n, n, n))


def scanner(voxels=8, pixels=8):
    return trgs.Scanner.synthetic(voxels, pixels)


CALLS = {
    "grid": lambda n: trgs.voxelize(model_of(3), grid(n)),
    "block": lambda n: grid(4).block((n, 0, 0), (n, n, n)),
    "scanner": lambda n: trgs.project(model_of(3), scanner(8, n), [0.0]),
    "support": lambda n: trgs.support(model_of(30), scanner(), np.zeros(10**7)),
    "bound": lambda n: trgs.truncation_bound(model_of(3), scanner(8, n), [0.0]),
    "views": lambda n: trgs.simulate("torso", scanner(), n * 2**10),
    "test views": lambda n: trgs.simulate("torso", scanner(), 2, test_views=n * 2**10),
    "volume": lambda n: trgs.simulate("torso", scanner(n), 2),
    "angles": lambda n: trgs.Scanner.uniform_angles(n * 2**10),
    "fdk": lambda n: trgs.fdk(PROJECTIONS, scanner(n, 8), [0.0, 1.0, 2.0]),
    "sart": lambda n: trgs.sart(PROJECTIONS, scanner(n, 8), [0.0, 1.0, 2.0]),
    "tv": lambda n: trgs.tv(PROJECTIONS, scanner(n, 8), [0.0, 1.0, 2.0]),
    "adjoint": lambda n: trgs.back_project(np.zeros((1, 8, 8), np.float32), scanner(n, 8), [0.0]),
    "forward": lambda n: trgs.forward_project(np.zeros((8, 8, 8), np.float32), scanner(8, n), [0.0]),
    "sphere": lambda n: trgs.confidence(model_of(3), scanner(), [0.0], sphere_points=n * 2**10),
    "adam": lambda n: optim.Adam(n * 2**10),
    "sghmc": lambda n: optim.Sghmc(n * 2**10),
    "neighbours": lambda n: trgs.wavelet_routing(grid(4), np.zeros((3, 3)), np.zeros(3), neighbours=n),
    "routing": lambda n: trgs.wavelet_routing(grid(n), np.zeros((3, 3)), np.zeros(3)),
    "levels": lambda n: trgs.haar(np.zeros((4, 4, 4), np.float32), levels=n),
    "copies": lambda n: density.ar(model_of(3), np.zeros(3), dead=0.0, recycled=0.0, growth=float(n), cap=2**63),
    "threads": lambda n: trgs.set_threads(n),
    "run": lambda n: trgs.reconstruct(trgs.simulate("torso", scanner(), 2), points=n * 2**10),
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("n", HUGE)
def test_a_huge_number_is_an_exception_with_a_remedy(name, n):
    with pytest.raises((MemoryError, ValueError, OverflowError)) as raised:
        CALLS[name](n)
    assert "expected" in str(raised.value) or isinstance(raised.value, OverflowError)


@pytest.mark.parametrize("name", ["grid", "volume", "fdk", "sart", "tv", "adjoint", "routing"])
def test_a_volume_beyond_the_limit_is_a_memory_error(name):
    with pytest.raises(MemoryError, match="max_memory"):
        CALLS[name](2**11)


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("n", [2**64, 10**30, -1])
def test_a_number_that_is_no_size_is_an_exception(name, n):
    if name != "support":
        with pytest.raises((MemoryError, ValueError, OverflowError)):
            CALLS[name](n)


def test_a_file_that_claims_too_much_raises(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.zeros((40, 50, 60), np.float32))
    assert trgs.load_volume(path).shape == (40, 50, 60)
    trgs.set_max_memory(100_000)
    with pytest.raises(MemoryError, match="max_memory"):
        trgs.load_volume(path)
    header = "NDims = 3\nDimSize = 1 1 1000000000000\nElementType = MET_UCHAR\nElementDataFile = s%d.raw 0 999999999999 1"
    (tmp_path / "a.mhd").write_text(header)
    with pytest.raises(ValueError, match="does not exist"):
        trgs.load_volume(tmp_path / "a.mhd")
