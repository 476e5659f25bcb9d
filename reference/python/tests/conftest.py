"""What several tests need: a small scan, a model in it, and random numbers."""

import numpy as np
import pytest

import trgs


def model_of(m: int, seed: int = 0, gaussian: bool = False) -> trgs.Model:
    draw = np.random.default_rng(seed)
    return trgs.Model(
        draw.uniform(-0.6, 0.6, (m, 3)),
        draw.uniform(0.05, 0.3, (m, 3)),
        draw.normal(size=(m, 4)),
        draw.uniform(0.1, 1.0, m),
        np.full(m, np.inf) if gaussian else draw.uniform(2.0, 20.0, m),
    )


@pytest.fixture
def model() -> trgs.Model:
    return model_of(7)


@pytest.fixture
def scanner() -> trgs.Scanner:
    grid = trgs.Grid((8, 10, 6), (-1.0, -1.0, -0.6), (1.0, 1.0, 0.6))
    return trgs.Scanner.cone(5.0, 7.0, detector=(9, 12), pitch=(0.3, 0.28), grid=grid, offset=(0.1, -0.05))


@pytest.fixture(scope="session")
def scan() -> trgs.Scan:
    return trgs.simulate("torso", trgs.Scanner.synthetic(16, 24), views=8, test_views=2, noise="low", seed=3)
