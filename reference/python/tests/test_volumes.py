"""Voxels, scans and whole reconstructions: against plain NumPy, exact identities, and the program `trgs`."""

import json
import os
import pathlib
import subprocess
import warnings

import numpy as np
import pytest

import trgs
from conftest import model_of
from trgs import metrics

ROOT = pathlib.Path(__file__).resolve().parents[3]
METHODS = ["fdk", "sart", "os-sart", "asd-pocs", "cgls", "tv"]


@pytest.fixture(scope="session")
def program():
    path = pathlib.Path(os.environ.get("TRGS_PROGRAM", ROOT / "target" / "checked" / "trgs"))
    if not path.exists():
        pytest.skip(f"no program at {path}: TRGS_PROGRAM names one")
    return path


@pytest.mark.parametrize("rays", ["joseph", "siddon"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_back_projection_is_the_adjoint(scanner, rays, dtype):
    draw, angles = np.random.default_rng(0), [0.1, 0.9, 4.0]
    x, y = draw.random((8, 10, 6)).astype(dtype), draw.random((3, 9, 12)).astype(dtype)
    forward = trgs.forward_project(x, scanner, angles, rays=rays)
    backward = trgs.back_project(y, scanner, angles, rays=rays)
    assert forward.dtype == backward.dtype == dtype and forward.shape == y.shape and backward.shape == x.shape
    left, right = (np.sum(forward.astype(float) * y), np.sum(backward.astype(float) * x))
    assert abs(left / right - 1) < (1e-5 if dtype == np.float32 else 1e-13)


def test_siddon_is_exact_along_an_axis():
    """A parallel ray through the middles of voxels: the sum of their densities times their side."""
    grid = trgs.Grid((4, 4, 4))
    scanner = trgs.Scanner.parallel(detector=(4, 4), pitch=(0.5, 0.5), grid=grid)
    volume = np.random.default_rng(1).random((4, 4, 4))
    (image,) = trgs.forward_project(volume, scanner, [0.0], rays="siddon")
    # At angle 0 columns run along y, rows down z.
    assert np.allclose(image, 0.5 * volume.sum(axis=0).T[::-1], rtol=1e-14)


def sart_twin(projections, scanner, angles, iterations, relaxation, reduction, subset):
    """x ← x + λ·Aᵀ[(p - A x)/A1]/Aᵀ1, x ≥ 0, by sets of views."""
    x = np.zeros(scanner.grid.shape)
    ones = trgs.forward_project(np.ones(scanner.grid.shape), scanner, angles)
    hit = ones > 0.5 * min(scanner.grid.spacing)
    for _ in range(iterations):
        for first in range(0, len(angles), subset):
            some = slice(first, first + subset)
            residual = projections[some] - trgs.forward_project(x, scanner, angles[some])
            correction = np.where(hit[some], residual / np.where(hit[some], ones[some], 1.0), 0.0)
            weight = trgs.back_project(hit[some].astype(float), scanner, angles[some])
            total = trgs.back_project(np.ascontiguousarray(correction), scanner, angles[some])
            x = np.maximum(x + relaxation * np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), 0.0), 0.0)
        relaxation *= reduction
    return x


@pytest.mark.parametrize("subset", [1, 3])
def test_sart_is_its_formula(scan, subset):
    settings = {"iterations": 3, "relaxation": 0.7, "reduction": 0.9}
    expected = sart_twin(scan.projections.astype(float), scan.scanner, list(scan.angles), subset=subset, **settings)
    method, more = (trgs.sart, {}) if subset == 1 else (trgs.os_sart, {"subset": subset})
    found = method(scan.projections, scan.scanner, scan.angles, dtype=np.float64, **settings, **more)
    assert found.dtype == np.float32 and np.abs(found - expected).max() < 1e-6 * expected.max()


def test_cgls_is_its_formula(scan):
    scanner, angles = scan.scanner, list(scan.angles)
    x, r = np.zeros(scanner.grid.shape), scan.projections.astype(float)
    s = trgs.back_project(r, scanner, angles)
    p, gamma = s.copy(), np.sum(s * s)
    for _ in range(4):
        q = trgs.forward_project(p, scanner, angles)
        alpha = gamma / np.sum(q * q)
        x, r = x + alpha * p, r - alpha * q
        s = trgs.back_project(r, scanner, angles)
        gamma, before = np.sum(s * s), gamma
        p = s + gamma / before * p
    found = trgs.cgls(scan.projections, scanner, angles, iterations=4, dtype=np.float64)
    assert np.abs(found - x).max() < 1e-5 * np.abs(x).max()


def test_tv_smooths_with_its_weight(scan):
    variation = lambda weight: trgs.losses.tv(
        trgs.tv(scan.projections, scan.scanner, scan.angles, weight=weight, iterations=30)
    )[0]
    assert variation(1e-2) < 0.7 * variation(1e-4)


def test_fdk_of_many_views_is_the_density():
    scanner = trgs.Scanner.synthetic(24, 48)
    scan = trgs.simulate("torso", scanner, views=120)
    found = trgs.fdk(scan.projections, scanner, scan.angles)
    assert metrics.psnr_3d(scan.truth, found).value > 21
    smooth = trgs.fdk(scan.projections, scanner, scan.angles, window="hann")
    assert trgs.losses.tv(smooth)[0] < trgs.losses.tv(found)[0]


def test_metrics_are_their_formulas(scan):
    truth = scan.truth
    result = truth + np.random.default_rng(0).normal(0, 0.1, truth.shape).astype(np.float32)
    found = metrics.psnr_3d(truth, result)
    assert found.definition == "psnr3d/peak1"
    assert found.value == pytest.approx(-10 * np.log10(np.mean((truth.astype(float) - result) ** 2)), rel=1e-12)
    assert metrics.psnr_3d(truth, truth).value == np.inf and metrics.ssim_3d(truth, truth).value == pytest.approx(1.0)
    assert len(metrics.ssim_3d(truth, result).detail) == 3
    images = scan.test_projections
    assert metrics.ssim_2d(images, 3 * images).value == pytest.approx(1.0, abs=1e-6)
    assert len(metrics.psnr_2d(images, images[::-1].copy()).detail) == 2


def test_callbacks_hear_of_every_pass_and_can_stop(scan):
    heard = []
    trgs.sart(scan.projections, scan.scanner, scan.angles, iterations=3, callback=heard.append)
    assert [(event.stage, event.iteration, event.iterations) for event in heard] == [("voxels", i, 3) for i in (1, 2, 3)]
    residuals = [event.values["residual"] for event in heard]
    assert residuals == sorted(residuals, reverse=True)

    class Enough(Exception):
        pass

    def stop(event):
        if event.iteration == 2:
            raise Enough

    for run in (trgs.cgls, trgs.tv, trgs.asd_pocs, trgs.os_sart):
        with pytest.raises(Enough):
            run(scan.projections, scan.scanner, scan.angles, callback=stop)


@pytest.mark.parametrize("method", METHODS)
def test_functions_and_reconstruct_agree_to_the_bit(scan, method):
    function = getattr(trgs, method.replace("-", "_"))
    # reconstruct takes the unit of density of asd-pocs, and the weight of tv, from the scan unless they are set.
    passes = {} if method == "fdk" else {"iterations": 3}
    arguments = passes | ({"weight": 2e-3} if method == "tv" else {})
    settings = passes | {"tv": {"weight": 2e-3}, "density_unit": 1.0}
    result = trgs.reconstruct(scan, method, **settings)
    assert result.model is None
    assert np.array_equal(result.volume, function(scan.projections, scan.scanner, scan.angles, **arguments))


def of_program(program, folder, *arguments):
    run = subprocess.run([program, *arguments, "--quiet"], cwd=folder, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_a_reconstruction_has_the_bits_of_the_program(tmp_path, scan, program):
    scan.save(tmp_path / "scan")
    of_program(program, tmp_path, "reconstruct", "scan", "--out", "run", "--iterations", "30", "--points", "300", "--seed", "5")
    heard = []
    again = trgs.load_scan(tmp_path / "scan")
    result = trgs.reconstruct(again, iterations=30, seed=5, model={"points": 300}, callback=heard.append)
    assert np.array_equal(result.volume, np.load(tmp_path / "run" / "volume.npy"))
    model = trgs.Model.load(tmp_path / "run" / "model.npz")
    for name in trgs.Parameters._fields:
        assert np.array_equal(getattr(result.model, name), getattr(model, name))
    assert {event.stage for event in heard} >= {"primitives", "voxels"}
    assert result.log[-1]["iteration"] == 30 and result.unit > 0 and "points = 300" in result.settings
    assert result.unfinished.shape == result.volume.shape and not np.array_equal(result.unfinished, result.volume)
    stated = json.loads((tmp_path / "run" / "metrics.json").read_text())
    found = again.evaluate(result.volume, result.model)
    assert {name: metric.value for name, metric in found.items()} == {name: stated[name]["value"] for name in found}
    result.save(tmp_path / "volume.npy")
    assert np.array_equal(trgs.load_volume(tmp_path / "volume.npy"), result.volume)


def test_images_and_volumes_have_the_bits_of_the_program(tmp_path, scan, program):
    scan.save(tmp_path / "scan")
    model = model_of(20)
    model.save(tmp_path / "model.npz")
    for dtype, precision in [(np.float32, "f32"), (np.float64, "f64")]:
        of_program(program, tmp_path, "render", "model.npz", "--scanner", "scan", "--split", "test", "--out", "i.npy",
                   "--precision", precision, "--cutoff", "1e-3")
        found = trgs.project(model, scan.scanner, scan.test_angles, cutoff=1e-3, dtype=dtype)
        stored = np.load(tmp_path / "i.npy")
        assert stored.dtype == dtype and np.array_equal(found, stored)
        of_program(program, tmp_path, "voxelize", "model.npz", "--scanner", "scan", "--out", "v.npy", "--precision", precision)
        assert np.array_equal(trgs.voxelize(model, scan.scanner, dtype=dtype), np.load(tmp_path / "v.npy"))
    of_program(program, tmp_path, "confidence", "model.npz", "--scanner", "scan", "--out", "c.npz")
    with np.load(tmp_path / "c.npz") as stored:
        assert np.array_equal(trgs.confidence(model, scan.scanner, scan.angles), stored["c"])


def test_a_simulated_scan_has_the_bits_of_the_program(tmp_path, program):
    of_program(program, tmp_path, "simulate", "--phantom", "torso", "--out", "scan", "--size", "16", "--detector", "24",
               "--views", "8", "--test-views", "2", "--noise", "low", "--seed", "3")
    scan = trgs.simulate("torso", trgs.Scanner.synthetic(16, 24), views=8, test_views=2, noise="low", seed=3)
    stored = trgs.load_scan(tmp_path / "scan")
    for name in ("angles", "projections", "test_angles", "test_projections", "truth"):
        assert np.array_equal(getattr(scan, name), getattr(stored, name)), name
    assert stored.scanner == scan.scanner and len(stored) == 8


def test_a_run_goes_on_from_its_checkpoint(tmp_path, scan):
    settings = {"iterations": 20, "model": {"points": 200}, "report_every": 5, "checkpoint_every": 10, "finish": "none"}
    whole = trgs.reconstruct(scan, **settings)

    def stop(event):
        if event.iteration == 15:
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        trgs.reconstruct(scan, checkpoint=tmp_path / "state", callback=stop, **settings)
    assert (tmp_path / "state").exists()
    rest = trgs.reconstruct(scan, checkpoint=tmp_path / "state", **settings)
    assert np.array_equal(rest.volume, whole.volume)


def test_settings_are_checked(scan):
    with pytest.raises(ValueError, match="iteratons.*did you mean iterations"):
        trgs.reconstruct(scan, iteratons=3)
    with pytest.raises(ValueError, match="model.points"):
        trgs.reconstruct(scan, model={"points": "many"})
    with pytest.raises(TypeError, match="model.points: got an object of type object"):
        trgs.reconstruct(scan, model={"points": object()})
    with pytest.raises(ValueError, match='method: got "nerf"'):
        trgs.reconstruct(scan, "nerf")
    settings = trgs.reconstruct(scan, "fdk", seed=np.int64(3), optimiser={"beta": (0.8, 0.9)}, precision="f64").settings
    for line in ('method = "fdk"', "seed = 3", "beta = [0.8, 0.9]", 'precision = "f64"'):
        assert line in settings


def test_a_scan_of_arrays_is_checked_and_saved(tmp_path, scanner):
    model, angles = model_of(5), [0.0, 0.7, 2.0]
    images = trgs.project(model, scanner, angles, dtype=np.float32)
    truth = trgs.voxelize(model, scanner, dtype=np.float32)
    scan = trgs.Scan(scanner, angles, images, truth=truth, name="five")
    assert (scan.name, len(scan), scan.test_angles) == ("five", 3, None)
    scan.save(tmp_path / "five")
    again = trgs.load_scan(tmp_path / "five")
    assert np.array_equal(again.projections, images) and np.array_equal(again.truth, truth)
    assert again.scanner.detector == scanner.detector
    with pytest.raises(ValueError, match=r"projections: got shape \[3, 12, 9\]"):
        trgs.Scan(scanner, angles, images.transpose(0, 2, 1).copy())
    with pytest.raises(ValueError, match="test views"):
        trgs.Scan(scanner, angles, images, test_angles=angles)
    with pytest.raises(ValueError, match="projections: got NaN"):
        trgs.Scan(scanner, angles, np.full_like(images, np.nan))
    with pytest.raises(ValueError, match="volume"):
        trgs.Scan(scanner, angles, images, truth=truth[1:].copy())


def test_oddities_of_files_are_warnings(tmp_path, scan):
    scan.save(tmp_path / "scan")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trgs.load_scan(tmp_path / "scan")
    meta = tmp_path / "scan" / "meta_data.json"
    content = json.loads(meta.read_text())
    for view in content["proj_train"]:
        view["angle"] = view["angle"] * 180 / np.pi
    meta.write_text(json.dumps(content))
    with pytest.warns(UserWarning, match="look like degrees"):
        odd = trgs.load_scan(tmp_path / "scan")
    assert "look like degrees" in odd.remarks[0]


def test_degrees_and_empty_views_are_refused(scan):
    degrees = np.degrees(scan.angles)
    for method in [trgs.fdk, trgs.sart, trgs.cgls]:
        with pytest.raises(ValueError, match=r"angles: got .*look like degrees.*numpy.deg2rad\(angles\)"):
            method(scan.projections, scan.scanner, degrees)
        with pytest.raises(ValueError, match="training views: got the value 0 in every pixel"):
            method(np.zeros_like(scan.projections), scan.scanner, scan.angles)
        with pytest.raises(ValueError, match="change their sign"):
            method(-scan.projections, scan.scanner, scan.angles)
    with pytest.raises(ValueError, match="look like degrees"):
        trgs.Scan(scan.scanner, degrees, scan.projections)


def test_phantoms_and_volumes_are_simulated(scan):
    assert {"torso", "shepp-logan", "pepper"} <= set(trgs.phantoms())
    of_voxels = trgs.simulate(scan.truth, scan.scanner, views=4)
    assert np.array_equal(of_voxels.truth, scan.truth) and of_voxels.projections.shape == (4, 24, 24)
    lengths = trgs.simulate(scan.truth, scan.scanner, views=4, rays="siddon")
    projector = trgs.forward_project(scan.truth.astype(float), scan.scanner, lengths.angles, rays="siddon")
    assert np.array_equal(lengths.projections, projector.astype(np.float32))
    assert np.abs(lengths.projections - of_voxels.projections).max() > 0.01
    with pytest.raises(ValueError, match="rays: got"):
        trgs.simulate("torso", scan.scanner, views=4, rays="siddon")
    with pytest.raises(ValueError, match="trso"):
        trgs.simulate("trso", scan.scanner, views=4)
    with pytest.raises(ValueError, match="noise: got loud"):
        trgs.simulate("torso", scan.scanner, views=4, noise="loud")


def test_unit_and_place_go_from_a_scan_to_its_volume(tmp_path, scan):
    scan.save(tmp_path / "scan")
    assert scan.unit is None and scan.scale == 1.0
    description = tmp_path / "scan" / "meta_data.json"
    meta = json.loads(description.read_text())
    meta["frame"] = {"unit": "um", "scene_units_per_unit": 0.001, "origin": [100.0, 0.0, 0.0]}
    description.write_text(json.dumps(meta))
    again = trgs.load_scan(tmp_path / "scan")
    assert again.unit == "um" and again.scale == 0.001
    spacing, origin, directions = again.place
    assert np.allclose(spacing, 1000 * np.array(again.scanner.grid.spacing)) and np.array_equal(directions, np.eye(3))
    again.save(tmp_path / "copy")
    assert trgs.load_scan(tmp_path / "copy").place == again.place
    # A file has millimetres, and attenuation per millimetre.
    trgs.save_volume(tmp_path / "v.mha", again.truth, again)
    values, place = trgs.load_volume(tmp_path / "v.mha", place=True)
    assert place["unit"] == "mm" and np.allclose(1000 * np.array(place["spacing"]), spacing)
    assert np.allclose(1000 * np.array(place["origin"]), origin) and np.allclose(values, 1000 * again.truth)
    with pytest.warns(UserWarning, match="multiplied by 0.001"):
        assert np.allclose(trgs.load_volume(tmp_path / "v.mha", scan=again), again.truth)
    # In scene units without a scan.
    trgs.save_volume(tmp_path / "v.mha", again.truth, again.scanner)
    assert np.allclose(trgs.load_volume(tmp_path / "v.mha", place=True)[1]["spacing"], again.scanner.grid.spacing)


def test_a_page_shows_volumes_at_their_place(tmp_path):
    values = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
    page = trgs.show(values, trgs.Grid((3, 4, 5)), title="a <b>")
    scene = json.loads(page.html.split('<script type="application/json">')[1].split("</script>")[0])
    assert scene["shape"] == [3, 4, 5] and scene["title"] == "a <b>" and [v["bits"] for v in scene["volumes"]] == [16]
    assert "<title>a &lt;b&gt;</title>" in page.html
    frame = page._repr_html_()
    assert frame.startswith('<iframe srcdoc="<!doctype html>') and frame.count('"') == 6
    two = {"truth": values, "other": values + 1}
    trgs.save_page(tmp_path / "page.html", two)
    written = (tmp_path / "page.html").read_text()
    assert written == trgs.show(two).html and '"name":"other"' in written
    with pytest.raises(ValueError, match="volumes to show: got 5, expected 1 to 4"):
        trgs.show({name: values for name in "abcde"})
    with pytest.raises(ValueError, match="volume of c"):
        trgs.show({"b": values, "c": values[:2].copy()})
    with pytest.raises(TypeError, match="volume of volume"):
        trgs.show(values.astype(float))
