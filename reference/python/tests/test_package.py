"""The package itself: import, the GIL, threads, processes, builds, types and documentation."""

import doctest
import importlib.metadata
import importlib.util
import inspect
import json
import os
import pathlib
import platform
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import trgs
import trgs._core
import trgs.distributed
from conftest import model_of
from trgs import conformance, density, losses, metrics, networks, optim  # noqa: F401

DIGEST = """
import hashlib, numpy as np, trgs
digest = hashlib.sha256()
scan = trgs.simulate("torso", trgs.Scanner.synthetic(16, 24), views=6, test_views=1, noise="low", seed=2)
result = trgs.reconstruct(scan, iterations=20, model={"points": 200})
m = result.model
for array in (scan.projections, result.volume, m.mean, m.scale, m.quaternion, m.density, m.nu):
    digest.update(array.tobytes())
for dtype in (np.float32, np.float64):
    image = trgs.project(m, scan.scanner, scan.angles, dtype=dtype)
    digest.update(image.tobytes())
    for gradient in trgs.project_vjp(m, scan.scanner, scan.angles, image):
        digest.update(gradient.tobytes())
    digest.update(trgs.voxelize(m, scan.scanner, dtype=dtype).tobytes())
digest.update(trgs.sart(scan.projections, scan.scanner, scan.angles, iterations=2).tobytes())
digest.update(trgs.confidence(m, scan.scanner, scan.angles).tobytes())
print(dict(trgs.build())["features"] or "baseline")
print(digest.hexdigest())
"""


def fresh(code, **environment):
    """Runs code in an interpreter of its own; returns its output."""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ | environment)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_the_import_takes_a_fifth_of_a_second_at_most():
    code = "import numpy, time; began = time.perf_counter(); import trgs; print(time.perf_counter() - began)"
    assert min(float(fresh(code)) for _ in range(5)) <= 0.2


def test_help_works_without_the_frameworks():
    code = """
import sys
sys.modules["torch"] = sys.modules["jax"] = None
import inspect, pydoc, trgs
assert {"torch", "jax"}.isdisjoint(name for name, _ in inspect.getmembers(trgs))
assert not hasattr(trgs, "torch")
try:
    trgs.jax
except AttributeError as error:
    assert "pip install jax" in str(error)
print(pydoc.plain(pydoc.render_doc(trgs)))
"""
    text = fresh(code)
    assert "class Grid" in text and "reconstruct(scan, method='tr-gs'" in text


def test_the_stubs_have_all_methods(scan):
    stub = importlib.util.find_spec("trgs").submodule_search_locations[0] + "/_core.pyi"
    with open(stub, encoding="utf-8") as file:
        listed = re.search(r"_Method: TypeAlias = Literal\[(.*?)\]", file.read(), re.DOTALL)
    with pytest.raises(ValueError) as caught:
        trgs.reconstruct(scan, "none")
    assert re.findall('"(.*?)"', listed[1]) == re.findall('"(.*?)"', str(caught.value).split("expected")[1].split(";")[0])


@pytest.mark.skipif(platform.machine() != "x86_64" or sys.platform != "linux", reason="sets the mode of an x86-64")
def test_a_mode_that_flushes_subnormal_numbers_is_refused():
    code = """
import ctypes, mmap, numpy as np, trgs
# ldmxcsr [rdi]; ret
page = mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
page.write(bytes([0x0F, 0xAE, 0x17, 0xC3]))
address = ctypes.addressof(ctypes.c_char.from_buffer(page))
load = ctypes.CFUNCTYPE(None, ctypes.POINTER(ctypes.c_uint32))(address)
standard, flush = 0x1F80, 1 << 15
for mode in (standard, standard | flush, standard):
    load(ctypes.byref(ctypes.c_uint32(mode)))
    try:
        found = trgs.haar(np.zeros((2, 2, 2), dtype=np.float32)), trgs.threads()
        print("computed")
    except RuntimeError as error:
        print(error)
"""
    first, second, third = fresh(code).splitlines()
    assert first == third == "computed"
    assert second.startswith("floating-point mode: got one that flushes subnormal numbers")


def test_the_version_is_that_of_the_library():
    try:
        stated = importlib.metadata.version("trgs")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("the package is not installed")
    assert stated == trgs.__version__


def test_the_example_of_the_package_runs():
    assert doctest.testmod(trgs) == (0, 4)


def test_a_call_costs_little_and_copies_no_model():
    """Besides the work: less than a thousandth of that for an image of 512² pixels and 50,000 primitives, about 50 ms."""
    tiny = trgs.Scanner.cone(5.0, 7.0, detector=(1, 1), pitch=(4.0, 4.0), grid=trgs.Grid((1, 1, 1)))
    model = model_of(1)

    def once():
        began = time.perf_counter()
        trgs.project(model, tiny, [0.3])
        return time.perf_counter() - began

    assert min(once() for _ in range(300)) < 50e-6


def test_other_frameworks_are_imported_when_asked_for():
    code = "import sys, trgs, trgs.conformance; print([name for name in ('torch', 'jax', 'pytest') if name in sys.modules])"
    assert fresh(code).strip() == "[]"


def advance(work):
    """Steps of a thread that counts while `work` runs, and the seconds it took."""
    counter, over = [0], threading.Event()

    def count():
        while not over.is_set():
            counter[0] += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    time.sleep(0.01)
    before, began = counter[0], time.perf_counter()
    try:
        work()
        steps, took = counter[0] - before, time.perf_counter() - began
    finally:
        over.set()
        thread.join()
    return steps, took


def test_long_calls_release_the_gil():
    scanner = trgs.Scanner.synthetic(48, 96)
    model, angles = model_of(1500), trgs.Scanner.uniform_angles(2)
    images = np.ones((2, 96, 96))
    projections = trgs.project(model, scanner, angles, dtype=np.float32)
    volume = np.ones((48, 48, 48))
    calls = {
        "project": lambda: trgs.project(model, scanner, angles),
        "project_vjp": lambda: trgs.project_vjp(model, scanner, angles, images),
        "voxelize": lambda: trgs.voxelize(model, scanner),
        "voxelize_vjp": lambda: trgs.voxelize_vjp(model, scanner, volume),
        "sart": lambda: trgs.sart(projections, scanner, angles, iterations=20),
        "forward_project": lambda: trgs.forward_project(volume, scanner, angles * 20),
    }
    for name, call in calls.items():
        steps, took = advance(call)
        # A thread without the GIL takes no step; one that has it a thousand a second, fewer on a machine that is busy.
        assert steps >= max(1, 50 * took) or took < 0.02, f"{name}: {steps} steps in {took:.3f} s"


def test_the_number_of_threads_is_set_once_and_changes_no_bit():
    one, two = (fresh(f"import trgs; trgs.set_threads({n}); assert trgs.threads() == {n}\n{DIGEST}") for n in (1, 3))
    assert one == two
    code = "import trgs; trgs.threads(); trgs.phantoms()\nscan = trgs.simulate('torso', trgs.Scanner.synthetic(8, 8), views=2)\n"
    code += "try: trgs.set_threads(2)\nexcept RuntimeError as error: print(error)"
    assert "expected a call before the first computation" in fresh(code)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_gets_an_error_and_does_not_hang():
    code = """
import os, trgs
scanner = trgs.Scanner.synthetic(8, 8)
trgs.simulate("torso", scanner, views=2)
if os.fork() == 0:
    try:
        trgs.simulate("torso", scanner, views=2)
    except RuntimeError as error:
        os.write(1, str(error).encode())
    os._exit(0)
os.wait()
"""
    assert 'give multiprocessing.get_context("spawn")' in fresh(code)


def test_ctrl_c_ends_a_run():
    code = """
import signal, threading, trgs
# A process that a shell starts in the background ignores the signal.
signal.signal(signal.SIGINT, signal.default_int_handler)
scan = trgs.simulate("torso", trgs.Scanner.synthetic(16, 24), views=6)
threading.Timer(1.0, lambda: signal.raise_signal(signal.SIGINT)).start()
try:
    trgs.reconstruct(scan, iterations=1_000_000)
except KeyboardInterrupt:
    print("ended")
"""
    assert fresh(code).strip() == "ended"


LEVELS = ["baseline", "v3", "v4"]
FEATURE = {"v3": "avx2", "v4": "avx512f"}


def modules():
    """The modules that this installation has and this CPU can run."""
    can = LEVELS[: LEVELS.index(trgs._core.cpu_level()) + 1]
    return [level for level in can if level == "baseline" or importlib.util.find_spec(f"trgs._{level}")]


def test_all_modules_give_the_same_bits():
    if "TRGS_ALL_MODULES" in os.environ:
        there = [level for level in LEVELS[1:] if importlib.util.find_spec(f"trgs._{level}")]
        assert there == LEVELS[1:], "the wheel should have a module for each level"
    elif len(modules()) == 1:
        pytest.skip("this installation has one module that this CPU can run; that of .ci/wheel has three")
    outputs = {name: fresh(DIGEST, TRGS_MODULE=name).split() for name in modules()}
    for name, output in outputs.items():
        for level, feature in FEATURE.items():
            assert (feature in output) == (LEVELS.index(name) >= LEVELS.index(level)), (name, output)
        assert output[-1] == outputs["baseline"][-1], outputs


def test_the_fastest_module_is_chosen():
    chosen = fresh("import warnings; warnings.simplefilter('ignore'); import trgs._core; print(trgs._core.__name__)")
    level = modules()[-1]
    assert chosen.strip() == ("trgs._core" if level == "baseline" else f"trgs._{level}._core")
    fast = fresh("import warnings; warnings.simplefilter('ignore'); import trgs._core; print(trgs._core.is_fast())")
    assert fast.strip() == "True" or trgs._core.cpu_level() == "baseline"


@pytest.mark.parametrize("wish", ["v5", "v3", "v4"])
def test_a_module_that_cannot_run_is_an_error(wish):
    if wish in modules():
        pytest.skip(f"this installation has {wish}, and this CPU can run it")
    run = subprocess.run(
        [sys.executable, "-c", "import trgs"], capture_output=True, text=True, env=os.environ | {"TRGS_MODULE": wish}
    )
    expected = {
        "v5": "got 'v5', expected one of auto, baseline, v3, v4; unset TRGS_MODULE",
    }.get(wish, "expected a module that can run; unset TRGS_MODULE")
    assert run.returncode != 0 and expected in run.stderr, run.stderr


def public():
    for module in (trgs, losses, metrics, networks, optim, density, conformance, trgs.distributed):
        for name in module.__all__:
            yield f"{module.__name__}.{name}", getattr(module, name)


def test_all_that_is_public_has_documentation():
    for name, value in public():
        assert inspect.getdoc(value), name
        if inspect.isclass(value):
            for member, of in vars(value).items():
                if not member.startswith("_") and (callable(of) or isinstance(of, (property, staticmethod))):
                    assert inspect.getdoc(getattr(value, member)), f"{name}.{member}"


def test_documentation_names_all_arguments():
    for name, value in public():
        if inspect.isclass(value) or not callable(value):
            continue
        documentation = inspect.getdoc(value)
        for argument in inspect.signature(value).parameters:
            assert re.search(rf"\b{argument}\b", documentation), f"{name}: {argument}"


def test_defaults_are_those_of_the_configuration():
    tomllib = pytest.importorskip("tomllib")
    scan = trgs.simulate("torso", trgs.Scanner.synthetic(8, 12), views=6, test_views=1)
    compared = 0
    for method in ["fdk", "sart", "os-sart", "asd-pocs", "cgls", "tv"]:
        tables = tomllib.loads(trgs.reconstruct(scan, method=method).settings)
        settings = tables | tables["algebraic"] | tables.get(method.replace("-", "_"), {})
        # Without views held out, no weight is chosen.
        settings.pop("weight", None)
        function = getattr(trgs, method.replace("-", "_"))
        for name, parameter in inspect.signature(function).parameters.items():
            if name in settings:
                assert parameter.default == settings[name], f"{method}: {name}"
                compared += 1
    assert compared == 34


def test_types_agree_with_the_module():
    pytest.importorskip("mypy")
    run = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "trgs._core", "--ignore-disjoint-bases"], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr


def program(*arguments, folder, **options):
    """Begins the command that comes with the package."""
    path = pathlib.Path(sys.executable).with_name("trgs.exe" if os.name == "nt" else "trgs")
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([path, *map(str, arguments)], cwd=folder, text=True, **pipes, **options)


def test_the_program_comes_with_the_package(tmp_path):
    def said(*arguments):
        run = program(*arguments, folder=tmp_path)
        out, errors = run.communicate()
        return run.returncode, out, errors

    assert said("--version") == (0, f"trgs {dict(trgs.build())['version']}\n", "")
    scan = ["--phantom", "torso", "--size", 16, "--detector", 24, "--views", 6, "--test-views", 1]
    code, _, errors = said("simulate", *scan, "--out", "scan", "--quiet")
    assert code == 0, errors
    code, _, errors = said("reconstruct", "scan", "--method", "sart", "--out", "run", "--quiet")
    assert code == 0, errors
    expected = trgs.reconstruct(trgs.load_scan(tmp_path / "scan"), method="sart").volume
    assert np.array_equal(np.load(tmp_path / "run/volume.npy"), expected)
    assert "trgs reconstruct scan --method sart" in (tmp_path / "run/report.html").read_text()
    code, out, errors = said("reconstruct", "nothing", "--out", "other")
    assert (code, out) == (2, "") and errors.startswith("error") and "Traceback" not in errors
    assert not (tmp_path / "other").exists()
    # The wheel of .ci/wheel has the vectors as files.
    code, out, errors = said("oracle", "list", "--level", "core", "--json")
    assert code == 0 and any(case["stage"] == "image-exact" for case in json.loads(out)["cases"]), errors


@pytest.mark.skipif(os.name == "nt", reason="no such signal")
def test_the_program_is_interrupted_as_elsewhere(tmp_path):
    # A script's background jobs ignore Ctrl-C, and so would the program.
    heeded = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    run = program("demo", "--out", "demo", folder=tmp_path, **heeded)
    for line in run.stderr:
        if "iteration" in line:
            break
    run.send_signal(signal.SIGINT)
    errors = run.communicate()[1]
    assert run.returncode == 130 and "Traceback" not in errors, errors
