"""Gradients in JAX."""

import numpy as np
import pytest

jax = pytest.importorskip("jax")

import trgs  # noqa: E402
import trgs.jax as tj  # noqa: E402
from conftest import model_of  # noqa: E402

ANGLES = [0.2, 1.9]


@pytest.fixture(autouse=True)
def double():
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


def arrays(model):
    return [jax.numpy.asarray(getattr(model, name)) for name in trgs.Parameters._fields]


@pytest.mark.parametrize("compiled", [False, True])
def test_gradients_are_those_of_the_package(scanner, compiled):
    model = model_of(4)
    weight = np.random.default_rng(1).random((2, 9, 12))
    value = lambda *p: (tj.project(*p, scanner, ANGLES) * weight).sum()
    gradient = jax.grad(value, argnums=tuple(range(5)))
    found = (jax.jit(gradient) if compiled else gradient)(*arrays(model))
    for got, expected in zip(found, trgs.project_vjp(model, scanner, ANGLES, weight)):
        assert np.array_equal(got, expected)
    assert np.array_equal(tj.project(*arrays(model), scanner, ANGLES), trgs.project(model, scanner, ANGLES))


def test_volumes_have_gradients_too(scanner):
    model = model_of(4)
    found = jax.grad(lambda *p: tj.voxelize(*p, scanner.grid).sum(), argnums=tuple(range(5)))(*arrays(model))
    for got, expected in zip(found, trgs.voxelize_vjp(model, scanner, np.ones(scanner.grid.shape))):
        assert np.array_equal(got, expected)


def test_numerical_differences_agree(scanner):
    from jax.test_util import check_grads

    check_grads(lambda *p: tj.project(*p, scanner, ANGLES), arrays(model_of(2)), order=1, modes=["rev"], eps=1e-6, rtol=1e-6)


def test_a_batch_is_mapped(scanner):
    model = model_of(3)
    batch = [jax.numpy.stack([array, array]) for array in arrays(model)]
    images = jax.vmap(lambda *p: tj.project(*p, scanner, ANGLES))(*batch)
    assert np.array_equal(images[1], trgs.project(model, scanner, ANGLES))


def test_single_precision_stays_single_and_shapes_are_checked(scanner):
    single = [array.astype(np.float32) for array in arrays(model_of(3))]
    assert tj.project(*single, scanner, ANGLES).dtype == np.float32
    with pytest.raises(ValueError, match=r"scale: got shape \(2, 3\), expected \(3, 3\)"):
        tj.project(single[0], single[1][:2], *single[2:], scanner, ANGLES)
    with pytest.raises(TypeError, match="nu: got float64, expected float32"):
        tj.project(*single[:4], arrays(model_of(3))[4], scanner, ANGLES)
