"""Every function of one step against the 50-digit vectors, in both precisions, and the judge itself."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import trgs
from trgs import conformance, density, losses, metrics, optim

TYPES = {"f64": np.float64, "f32": np.float32}


def model(case: conformance.Case, role: str = "model") -> trgs.Model:
    return trgs.Model(*(case.inputs[role][name] for name in trgs.Parameters._fields))


def raw(case: conformance.Case) -> trgs.Parameters:
    return trgs.Parameters(*(case.inputs["raw"][name] for name in trgs.Parameters._fields))


def activation(case: conformance.Case) -> optim.Activation:
    settings = case.settings
    return optim.Activation(tuple(settings["scale_range"]), tuple(settings["nu_range"]), settings["kernel"].replace("_", "-"))


def single(value: float) -> np.ndarray:
    return np.array([value])


def valued(value_and_gradient):
    value, gradient = value_and_gradient
    return {"value": single(value), "gradient": gradient}


def images(case, dtype, **more):
    return trgs.project(model(case), case.scanner, case.settings["angles"], dtype=dtype, **more)


def gradient(case, dtype, **more):
    cotangent = case.inputs["cotangent"].astype(dtype)
    return trgs.project_vjp(model(case), case.scanner, case.settings["angles"], cotangent, **more)


def each_kernel(case, dtype, projection):
    whole = case.inputs["model"]
    alone = [trgs.Model(*(whole[name][i : i + 1] for name in trgs.Parameters._fields)) for i in range(len(whole["nu"]))]
    angles = case.settings["angles"]
    return np.stack([trgs.project(one, case.scanner, angles, projection=projection, dtype=dtype) for one in alone])


def with_cutoff(case):
    return {key: case.settings[key] for key in ("projection", "cutoff")}


def gradient_raw(case, dtype):
    map_, parameters = activation(case), raw(case)
    physical = map_.forward(parameters)
    cotangent = case.inputs["cotangent"].astype(dtype)
    found = trgs.project_vjp(physical, case.scanner, case.settings["angles"], cotangent)
    return map_.vjp(physical, found)


def haar(case, dtype):
    (coefficients,) = trgs.haar(case.inputs["block"].astype(dtype))
    bands = []
    for band in range(1, 7):
        alone = np.zeros_like(coefficients)
        alone[band] = coefficients[band]
        bands.append(trgs.haar_inverse([alone]))
    return {"coefficients": coefficients, "bands": np.stack(bands)}


def wavelet(case, block):
    settings = {key: case.settings[key] for key in ("neighbours", "enhancement", "suppress", "enhance", "levels")}
    return trgs.wavelet_loss(block, case.inputs["high"].astype(np.uint16), **settings)


def wavelet_loss(case, dtype):
    loss = wavelet(case, case.inputs["block"].astype(dtype))
    return {
        "value": single(loss.value),
        "gradient": loss.gradient,
        "enhancement": single(loss.enhancement),
        "suppression": single(loss.suppression),
    }


def gradient_wavelet(case, dtype):
    primitives, grid = model(case), case.scanner.grid
    loss = wavelet(case, trgs.voxelize(primitives, grid, dtype=dtype))
    return trgs.voxelize_vjp(primitives, grid, loss.gradient)


def adam(case, _):
    settings, values = case.settings, case.inputs["start"].copy()
    state = optim.Adam(len(values), (settings["beta1"], settings["beta2"]), settings["epsilon"])
    trajectory = []
    for slope, rate in zip(case.inputs["gradients"], case.inputs["rates"]):
        state.step(values, slope, rate)
        trajectory.append(values.copy())
    return np.array(trajectory)


def sghmc(case, _):
    inputs, settings, positions = case.inputs, case.settings, case.inputs["start"].copy()
    state, trajectory = optim.Sghmc(len(positions)), []
    for step, rate in enumerate(inputs["rates"]):
        burns_in = step < settings["burn_in"]
        state.step(
            positions,
            inputs["directions"][step],
            rate=rate,
            friction=settings["burn_in_friction" if burns_in else "friction"],
            gate=inputs["gates"],
            noise=inputs["noise"][step],
            covariance=inputs["covariance"] if burns_in else None,
        )
        trajectory.append(positions.copy())
    return np.array(trajectory)


def population(next_):
    of = next_.model
    arrays = dict(zip(trgs.Parameters._fields, (of.mean, of.scale, of.quaternion, of.density, of.nu)))
    return {"model": arrays, "parent": next_.parent, "fresh": next_.fresh}


def ar(case, _):
    keys = ("dead", "recycled", "growth", "cap", "relocation")
    return population(density.ar(model(case), case.inputs["uniform"], **{key: case.settings[key] for key in keys}))


def adc(case, _):
    keys = ("gradient", "split_scale", "faint", "cap", "low", "high")
    settings = {key: case.settings[key] for key in keys}
    return population(density.adc(model(case), case.inputs["pull"], case.inputs["normals"], **settings))


def all_metrics(case, _):
    pairs = {"psnr_3d": "volume", "ssim_3d": "volume", "psnr_2d": "projections", "ssim_2d": "projections"}
    found = {}
    for name, role in pairs.items():
        truth, result = (case.inputs[key].astype(np.float32) for key in (f"{role}_truth", role))
        found[name] = single(getattr(metrics, name)(truth, result).value)
    return {"metrics": found}


def two(case, dtype):
    return case.inputs["prediction"].astype(dtype), case.inputs["target"].astype(dtype)


def covered(case):
    keys = ("sphere_points", "r_max", "kappa")
    settings = {key: case.settings[key] for key in keys}
    return trgs.confidence(model(case), case.scanner, case.settings["angles"], **settings)


def routed(case):
    settings = {key: case.settings[key] for key in ("neighbours", "threshold")}
    return trgs.wavelet_routing(case.scanner, case.inputs["means"], case.inputs["confidence"], **settings)


def filtered(case, dtype):
    projections, settings = case.inputs["projections"].astype(dtype), case.settings
    return trgs.fdk_filter(projections, case.scanner, settings["angles"], window=settings["window"])


def pulled(case, _):
    settings = {key: case.settings[key] for key in ("sphere_points", "temperature")}
    return trgs.nu_target(case.inputs["c"], nu_range=tuple(case.settings["nu_range"]), **settings)


def rates(case, _):
    settings = (case.settings[key] for key in ("first", "last", "length"))
    first, last, length = settings
    return np.array([optim.learning_rate(int(step), first, last, length) for step in case.inputs["steps"]])


def nu_loss(case, _):
    return valued(losses.nu_loss(*(case.inputs[key] for key in ("nu", "target", "confidence")), case.settings["weight"]))


def activated(case, _):
    of = activation(case).forward(raw(case))
    return (of.mean, of.scale, of.quaternion, of.density, of.nu)


# Stage → the answer for a case and a type: outputs by role, or the only output.
STAGES = {
    "covariance": lambda case, _: model(case).covariance(),
    "kernel": lambda case, dtype: trgs.kernel(case.inputs["delta"], case.inputs["nu"], dtype=dtype),
    "integral-factor": lambda case, _: dict(zip(("factor", "slope"), trgs.integral_factor(case.inputs["nu"]))),
    "density": lambda case, dtype: trgs.voxelize(model(case), case.scanner, dtype=dtype),
    "density-cutoff": lambda case, dtype: trgs.voxelize(
        model(case), case.scanner.grid, cutoff=case.settings["cutoff"], dtype=dtype
    ),
    "projected-kernel-affine": lambda case, dtype: each_kernel(case, dtype, "affine"),
    "projected-kernel-exact": lambda case, dtype: each_kernel(case, dtype, "exact"),
    "image-affine": lambda case, dtype: images(case, dtype, projection="affine"),
    "image-exact": lambda case, dtype: images(case, dtype),
    "image-cutoff": lambda case, dtype: images(case, dtype, **with_cutoff(case)),
    "gradient-density": lambda case, dtype: trgs.voxelize_vjp(
        model(case), case.scanner, case.inputs["cotangent"].astype(dtype)
    ),
    "gradient-image-affine": lambda case, dtype: gradient(case, dtype, projection="affine"),
    "gradient-image-exact": lambda case, dtype: gradient(case, dtype),
    "activation": activated,
    "gradient-raw": gradient_raw,
    "support": lambda case, _: trgs.support(model(case), case.scanner, case.settings["angles"], **with_cutoff(case)),
    "truncation-bound": lambda case, _: trgs.truncation_bound(
        model(case), case.scanner, case.settings["angles"], **with_cutoff(case)
    ),
    "loss-l1": lambda case, dtype: valued(losses.l1(*two(case, dtype))),
    "loss-ssim": lambda case, dtype: valued(losses.ssim(*two(case, dtype))),
    "loss-image": lambda case, dtype: valued(losses.image_loss(*two(case, dtype), case.settings["weight"])),
    "loss-tv": lambda case, dtype: valued(losses.tv(case.inputs["block"].astype(dtype))),
    "confidence": lambda case, _: covered(case),
    "nu-target": pulled,
    "loss-nu": nu_loss,
    "haar": haar,
    "wavelet-routing": lambda case, _: routed(case),
    "wavelet-loss": wavelet_loss,
    "gradient-wavelet": gradient_wavelet,
    "schedule": rates,
    "adam": adam,
    "sghmc-gate": lambda case, _: optim.gate(case.inputs["density"], case.settings["reference"]),
    "sghmc": sghmc,
    "ar": ar,
    "adc": adc,
    "gradient-shadow": lambda case, dtype: trgs.footprint_gradient(
        model(case),
        case.scanner,
        case.settings["angles"],
        case.inputs["cotangent"].astype(dtype),
        projection=case.settings["projection"],
    ),
    "fdk-filter": filtered,
    "fdk-backprojection": lambda case, dtype: trgs.fdk_backproject(
        case.inputs["filtered"].astype(dtype), case.scanner, case.settings["angles"]
    ),
    "fdk": lambda case, dtype: trgs.fdk_backproject(filtered(case, dtype), case.scanner, case.settings["angles"]),
    "metrics": all_metrics,
}


def answers(case, found):
    """Outputs by role."""
    is_all = isinstance(found, dict) and set(found) == set(case.output_names)
    return found if is_all else {case.output_names[0]: found}


@pytest.mark.parametrize("precision", TYPES)
@conformance.cases(stage=list(STAGES), level="stress")
def test_answers_are_those_of_fifty_digits(case, precision):
    found = STAGES[case.stage](case, TYPES[precision])
    case.check(precision=precision, **answers(case, found))


def test_all_other_stages_are_not_functions_of_the_package():
    every = {case.stage for case in conformance.find(level="stress")}
    networks = {"hash-corners", "hash-code", "gradient-hash-code", "frequency-code", "lineformer", "gradient-lineformer"}
    assert every - set(STAGES) == {"noise", "random", "ray-quadrature"} | networks


def test_a_wrong_answer_fails_with_the_likely_mistake():
    (case, *_) = conformance.find(stage="image-exact")
    wrong = images(case, np.float64)[:, ::-1]
    with pytest.raises(conformance.Failure, match="image-exact/.* failed in f64, looks like: .*\n.*limit") as caught:
        case.check(precision="f64", image=wrong)
    assert caught.value.result["status"] == "failed"
    assert "looks like" in str(caught.value)
    with pytest.raises(conformance.Failure, match="shape"):
        case.check(image=wrong[:, :-1])
    with pytest.raises(conformance.Failure, match="missing"):
        case.check()
    with pytest.raises(TypeError, match="answer: got picture, expected image"):
        case.check(picture=wrong)


def test_a_gradient_is_a_mapping_or_five_arrays():
    (case, *_) = conformance.find(stage="gradient-image-exact")
    found = gradient(case, np.float64)
    case.check(grad=found, precision="f64")
    case.check(grad=found._asdict(), precision="f64")
    with pytest.raises(conformance.Failure, match="grad.mean"):
        case.check(grad=found._replace(mean=2 * found.mean), precision="f64")


@conformance.cases(stage=["image-exact", "gradient-density", "kernel"], fresh=4, seed=3)
def test_generated_questions_are_judged(case):
    case.check(precision="f64", **answers(case, STAGES[case.stage](case, np.float64)))
    wrong = np.zeros((1, 1, 1, 1))
    if case.output_names[0] == "grad":
        wrong = dict.fromkeys(("mean", "scale", "quaternion", "density", "nu"), wrong)
    with pytest.raises(conformance.Failure, match="shape|missing"):
        case.check(precision="f64", **{case.output_names[0]: wrong})
    with pytest.raises(ValueError, match="generated question"):
        _ = case.truth


def test_a_hunt_shrinks_what_a_function_fails(tmp_path):
    def mirrored(case):
        return images(case, np.float64)[..., ::-1]

    (finding,) = conformance.hunt(mirrored, stage="image-exact", cases=50, precision="f64", out=tmp_path / "found")
    assert finding["primitives"] == 1 and finding["elements"] <= 2
    assert finding["looks_like"] == "mirrored along u"
    assert (tmp_path / "found" / finding["case"] / "manifest.json").exists()
    right = conformance.hunt(lambda case: images(case, np.float64), stage="image-exact", cases=20, precision="f64", out=tmp_path / "none")
    assert right == []

    def raises(case):
        raise RuntimeError("not yet")

    (finding,) = conformance.hunt(raises, stage="kernel", cases=4, out=tmp_path / "raises")
    assert "RuntimeError: not yet" in finding["error"]
    with pytest.raises(ValueError, match="other settings"):
        conformance.hunt(raises, stage="kernel", cases=5, out=tmp_path / "raises")


def test_a_hunt_asks_for_refusals_and_relations(tmp_path):
    def covariances(case, refuses):
        model = case.inputs["model"]
        norm = np.linalg.norm(model["quaternion"], axis=1)
        if refuses and not (np.all(norm > 0) and np.all(model["scale"] > 0)):
            raise ValueError("no rotation")
        w, x, y, z = (model["quaternion"] / np.where(norm > 0, norm, 1)[:, None]).T
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        roots = np.array(rows).transpose(2, 0, 1) * model["scale"][:, None, :]
        return roots @ roots.transpose(0, 2, 1)

    for refuses, failures in [(True, 0), (False, 1)]:
        found = conformance.hunt(
            lambda case: covariances(case, refuses), stage="covariance", ask="refusals", precision="f64", out=tmp_path / f"{refuses}"
        )
        assert len(found) == failures, found

    def without_last(case):
        whole = case.inputs["model"]
        kept = trgs.Model(*(whole[name][:-1] for name in trgs.Parameters._fields))
        return trgs.project(kept, case.scanner, case.settings["angles"], dtype=np.float64)

    found = conformance.hunt(without_last, stage="image-exact", ask="relations", precision="f64", cases=20, out=tmp_path / "sum")
    assert len(found) == 1
    with pytest.raises(ValueError, match='ask: got "values_"'):
        conformance.hunt(covariances, stage="covariance", ask="values_", out=tmp_path / "none")


def test_truth_and_inputs_are_those_of_an_export(tmp_path):
    folder = tmp_path / "vectors"
    assert conformance.export(folder, stage="image-exact") > 10
    manifest = json.loads((folder / "manifest.json").read_text())
    assert (folder / "PROTOCOL.md").exists()
    for entry, case in zip(manifest["cases"], conformance.find(stage="image-exact"), strict=True):
        assert entry["id"] == case.id
        truth = np.load(folder / "expected" / entry["outputs"]["image"]["file"])
        assert np.array_equal(truth, case.truth["image"])
        with np.load(folder / entry["inputs"]["model"]["file"]) as arrays:
            assert all(np.array_equal(arrays[name], case.inputs["model"][name]) for name in arrays)
    with pytest.raises(ValueError, match="`stage`: got image"):
        conformance.find(stage="image")


def test_the_ten_lines_of_a_backend_run(tmp_path):
    test = tmp_path / "test_backend.py"
    test.write_text(
        "import trgs\n"
        "import trgs.conformance\n"
        '@trgs.conformance.cases(stage="gradient-image-exact", level="core")\n'
        "def test_gradient(case):\n"
        '    model = trgs.Model(**case.inputs["model"])\n'
        '    grad = trgs.project_vjp(model, case.scanner, case.settings["angles"], case.inputs["cotangent"])\n'
        '    case.check(grad=grad, precision="f64")\n'
    )
    run = subprocess.run([sys.executable, "-m", "pytest", "-q", str(test)], capture_output=True, text=True)
    assert run.returncode == 0 and "17 passed" in run.stdout, run.stdout


WAIVER = '[[waiver]]\ncase = "covariance/{}"\nreason = "set-up in half precision"\nexpires = {}\n'


def test_waivers_hold_until_their_day_and_are_strict(tmp_path):
    test, waivers = tmp_path / "test_backend.py", tmp_path / "waivers.toml"
    # Wrong for needles alone: one waiver holds, one ran out, and one is not needed.
    test.write_text(
        "import trgs.conformance\n"
        "@trgs.conformance.cases(stage='covariance', level='stress', waivers='waivers.toml')\n"
        "def test_covariance(case):\n"
        "    wrong = 1.1 if case.id.split('/')[1] in ('needle', 'pancake', 'tiny-quaternion') else 1.0\n"
        "    case.check(covariance=case.truth['covariance'] * wrong, precision='f64')\n"
    )
    days = {"needle": "2100-01-01", "pancake": "2020-01-01", "cone-five": "2100-01-01"}
    waivers.write_text("".join(WAIVER.format(*row) for row in days.items()))
    command = [sys.executable, "-m", "pytest", "-q", "-rxf", test.name]
    wide = os.environ | {"COLUMNS": "400"}
    output = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=wide).stdout
    assert "3 failed, 3 passed, 1 xfailed" in output, output
    assert "XFAIL test_backend.py::test_covariance[covariance/needle] - set-up in half precision (until 2100-01-01)" in output
    assert "[XPASS(strict)] set-up in half precision" in output
    assert "its waiver ran out: set-up in half precision (until 2020-01-01)" in output
    # The summary names the mistake, and the traceback ends in the test.
    assert re.search(r"FAILED .*pancake\] .*: covariance/pancake failed in f64, looks like: .*1\.1", output), output
    assert "conformance.py" not in output, output


def test_waivers_that_say_nothing_are_refused(tmp_path):
    waivers = tmp_path / "waivers.toml"
    for text, message in [
        (WAIVER.format("unknown", "2100-01-01"), "covariance/unknown"),
        (WAIVER.format("needle", "2100-01-01").replace("set-up in half precision", " "), "no reason"),
        (WAIVER.format("needle", '"soon"'), "waiver"),
    ]:
        waivers.write_text(text)
        with pytest.raises(ValueError, match=message):
            conformance.cases(stage="covariance", waivers=waivers)
    with pytest.raises(OSError):
        conformance.cases(stage="covariance", waivers=tmp_path / "none.toml")
    with pytest.raises(ValueError, match="generated questions"):
        conformance.cases(stage="covariance", fresh=2, waivers=waivers)


def test_vectors_of_a_folder_are_those_of_the_module(tmp_path):
    with pytest.raises(FileNotFoundError, match="manifest.json"):
        trgs._core.conformance_open(tmp_path)
    conformance.find()
    other = tmp_path / "core"
    conformance.export(other, level="core")
    with pytest.raises(ValueError, match="in use"):
        trgs._core.conformance_open(other)
    folder = Path(__file__).parents[2] / "vectors"
    if not folder.is_dir():
        pytest.skip("needs the vectors of a checkout, reference/vectors")
    digests = "".join(
        "import hashlib, sys\nfrom trgs import _core\n"
        "if len(sys.argv) > 1: _core.conformance_open(sys.argv[1])\n"
        "from trgs import conformance\n"
        "for case in conformance.find(level='stress'):\n"
        "    for role in case.output_names:\n"
        "        truth = _core.conformance_truth(case.id, role)\n"
        "        arrays = truth if isinstance(truth, dict) else {'': truth}\n"
        "        for name, array in sorted(arrays.items()): print(case.id, role, name, hashlib.sha256(array.tobytes()).hexdigest())\n"
    )
    of_folder, of_module = (
        subprocess.run([sys.executable, "-c", digests, *more], capture_output=True, text=True, check=True).stdout
        for more in ([str(folder)], [])
    )
    assert len(of_module.splitlines()) > 400
    assert of_folder == of_module
