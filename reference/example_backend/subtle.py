"""Bugs of rare inputs, of which no fixed question may have one, and how a hunt finds them:  python3 subtle.py TRGS > RESULT.md

Each is a change of backend.py. The fixed questions of all levels are asked first, then 400 generated ones of level `core`, 400 of
`stress` and 60 of `large` until one fails, all in f64. The table has every bug, those that the fixed questions find as well.
"""
import json, subprocess, sys, tempfile
from pathlib import Path

import bugs as shared, hunts
from bugs import AFFINE, EXACT, FIELD

MODEL = 'for p in a["model"]])\n    return [parts'
SCALE = "scale, nu, cone = p[3:6], p[11]"
NORM = "np.sqrt(np.sum(quaternion * quaternion))"
CENTRE = "if cone and centre[2].real <= scanner[\"DSO\"] / 100:"
SLOPE = 'slope = lambda p, step: np.sum(a["cotangent"] * field(p + 1j * step, a).imag) / H'
TAIL = "local = (voxel - p[0:3])"
MOMENTS = "m, v = beta1 * m"
AMPLITUDE = "return p[10] * factor"
HEIGHT = "return p[10] * power"
FACES = "if np.any(np.abs(p[0:3].real - offset) > size / 2): return np.zeros(a['scanner']['nVoxel'], REAL)"
SUM = 'parts = np.array([FIELDS[field](p, a).real for p in a["model"]])'
ROWS = 'for p in a["model"]], REAL)'

# name, stage, pairs (text, its replacement)
BUGS = [
    ("only the first 64 primitives", EXACT, [(MODEL, MODEL.replace('"model"]]', '"model"][:64]]'))]),
    ("only the first 400 primitives", AFFINE, [(MODEL, MODEL.replace('"model"]]', '"model"][:400]]'))]),
    ("near plane at DSO/50", EXACT, [(CENTRE, CENTRE.replace("100", "50"))]),
    ("near plane at 0", EXACT, [(CENTRE, CENTRE.replace('scanner["DSO"] / 100', "0"))]),
    ("near plane in parallel beams", AFFINE, [(CENTRE, CENTRE.replace("cone and ", ""))]),
    ("angles within one turn", EXACT, [("c, s = np.cos(angle)", "angle = np.clip(angle, 0, 2 * np.pi); c, s = np.cos(angle)")]),
    ("ν at least 1", EXACT, [(SCALE, SCALE + " if p[11].real > 1 else p[11] / p[11].real")]),
    ("ν above 3000 is infinite", EXACT, [(SCALE, SCALE + " if p[11].real < 3e3 else np.inf")]),
    ("series of C(ν) from ν = 8 on", "integral-factor", [("nu.real > 30", "nu.real > 8")]),
    ("scales at least 1/30 of the largest", EXACT, [(SCALE, "scale, nu, cone = np.maximum(p[3:6].real, p[3:6].real.max() / 30) + 1j * p[3:6].imag, p[11]")]),
    ("quaternions of a norm below 0.001", "covariance", [(NORM, "np.sqrt(max(np.sum(quaternion * quaternion).real, 1e-6))")]),
    ("quaternions within 1 % of norm 1 as stored", "covariance", [(NORM, f"(lambda n: 1 if abs(n - 1) < 0.01 else n)({NORM})")]),
    ("square pixels if rows equal columns", EXACT, [("height / rows - ", "(height / rows if rows != columns else width / columns) - ")]),
    ("offset v of parallel beams", EXACT, [('- scanner["offDetector"][1]', '- scanner["offDetector"][1] * (1 if cone else -1)')]),
    ("tails end at δ = 10⁶", EXACT, [(AMPLITUDE, "return (delta.real < 1e6) * p[10] * factor")]),
    ("tails end at δ = 300", FIELD, [(HEIGHT, "return p[10] * (np.sum(local * local, -1).real < 300) * power")]),
    ("centres outside of the box", FIELD, [(TAIL, FACES + "\n    " + TAIL)]),
    ("volumes of more than 64 planes", FIELD, [(TAIL, "voxel[64:] = voxel[63:64]\n    " + TAIL)]),
    ("no slope of primitives of density 0", f"gradient-{EXACT}", [(SLOPE, SLOPE.replace("p, step: ", "p, step: 0 if p[10] == 0 else "))]),
    ("no slope of faint primitives", f"gradient-{EXACT}", [(SLOPE, SLOPE.replace("p, step: ", "p, step: 0 if abs(p[10].real) < 1e-3 else "))]),
    ("no slope to ν above 300", f"gradient-{FIELD}", [(SLOPE, SLOPE.replace("p, step: ", "p, step: 0 if step[11] and p[11].real > 300 else "))]),
    ("no slope of cotangents below 0.01", f"gradient-{AFFINE}", [(SLOPE, SLOPE.replace("* field", '* (np.abs(a["cotangent"]) > 0.01) * field'))]),
    ("slopes of the first 64 primitives", f"gradient-{FIELD}", [(ROWS, ROWS.replace('"model"]]', '"model"][:64]] + [[0] * 12] * max(0, len(a["model"]) - 64)'))]),
    ("equal within 1e-7", "loss-l1", [("np.sign(prediction - target)", "np.sign(np.where(np.abs(prediction - target) < 1e-7, 0, prediction - target))")]),
    ("SSIM of images not below 0", "loss-ssim", [("(blur[0] @ image @ blur[1] for", "(blur[0] @ (image * (image.real > 0)) @ blur[1] for")]),
    ("TV of cubes", "loss-tv", [("sum(step.size for step in steps)", "3 * steps[0].size")]),
    ("TV of steps above 1e-6", "loss-tv", [("steps = [np.diff(block, axis=k)", "steps = [(lambda d: d * (np.abs(d) > 1e-6))(np.diff(block, axis=k))")]),
    ("bias correction up to step 20", "adam", [("(1 - beta2**t)", "(1 - beta2**min(t, 20))")]),
    ("gradients of at most 100", "adam", [(MOMENTS, "g = np.clip(g, -100, 100); " + MOMENTS)]),
    ("gradients of at least 1e-12", "adam", [(MOMENTS, "g = g * (np.abs(g) > 1e-12); " + MOMENTS)]),
    ("δ of at most 10⁸", "kernel", [("power(x, n, 3).real", "power(min(x, 1e8), n, 3).real")]),
    ("ν above 10⁶ is infinite", "kernel", [("power(x, n, 3).real", "power(x, n if n < 1e6 else np.inf, 3).real")]),
    ("only the first 256 columns", EXACT, [(AMPLITUDE, "delta = delta + 1e300 * (np.arange(columns) > 255); " + AMPLITUDE)]),
    ("only the first 256 rows", AFFINE, [(AMPLITUDE, "delta = delta + 1e300 * (np.arange(rows) > 255)[:, None]; " + AMPLITUDE)]),
    ("only the first 16 views", EXACT, [('for angle in REAL(a["angles"])]', '* (k < 16) for k, angle in enumerate(REAL(a["angles"]))]')]),
    ("angles without a sign", EXACT, [("c, s = np.cos(angle)", "angle = np.abs(angle); c, s = np.cos(angle)")]),
    ("far plane at the detector", EXACT, [(CENTRE, CENTRE.replace("if cone and", 'if cone and centre[2].real >= scanner["DSD"] or cone and'))]),
    ("far plane in parallel beams", AFFINE, [(CENTRE, CENTRE.replace("if cone and", 'if not cone and centre[2].real >= scanner["DSD"] or cone and'))]),
    ("quaternions of a norm above 100 as stored", EXACT, [(NORM, f"(lambda n: 1 if n.real > 100 else n)({NORM})")]),
    ("densities below 1e-20", EXACT, [(AMPLITUDE, "return (abs(p[10].real) > 1e-20) * p[10] * factor")]),
    ("one primitive per depth", EXACT, [(SUM, SUM.replace('a["model"]]', '{p[0].real: p for p in a["model"]}.values()]'))]),
    ("volumes of more than 32 rows", FIELD, [(TAIL, "voxel[:, 32:] = voxel[:, 31:32]\n    " + TAIL)]),
    ("volumes of more than 32 columns", FIELD, [(TAIL, "voxel[:, :, 32:] = voxel[:, :, 31:32]\n    " + TAIL)]),
    ("cubic voxels if sides have equal counts", FIELD, [("+ 0.5) * size / n", "+ 0.5) * (size / n if len(set(n)) > 1 else size[0] / n)")]),
    ("no slope at the origin", f"gradient-{FIELD}", [(SLOPE, SLOPE.replace("p, step: ", "p, step: 0 if np.any(step[0:3]) and not np.any(p[0:3].real) else "))]),
    ("L1 of values up to 1.4", "loss-l1", [("return np.sign", "prediction, target = np.minimum(prediction, 1.4), np.minimum(target, 1.4); return np.sign")]),
    ("weight of at most 0.5", "loss-image", [("x + weight *", "x + min(weight, 0.5) *")]),
    ("TV of more than 64 planes", "loss-tv", [("steps = [np.diff", "block[64:] = block[63:64]; steps = [np.diff")]),
    ("TV of more than 32 columns", "loss-tv", [("steps = [np.diff", "block[:, :, 32:] = block[:, :, 31:32]; steps = [np.diff")]),
]

LEVELS = {"core": 400, "stress": 400, "large": 60}


def fixed(trgs, bug, text, vectors, folder):
    """The number of fixed questions that fail."""
    backend, answers, report = shared.mutated(bug, text, folder), folder / "answers", folder / "report.json"
    subprocess.run([sys.executable, "-W", "ignore", str(backend), str(vectors), str(answers), "float64"], check=True, capture_output=True)
    check = [trgs, "oracle", "check", str(answers), "--precision", "f64", "--level", "stress", "--stage", bug[1], "--report", str(report)]
    done = subprocess.run(check, capture_output=True, text=True)
    assert report.exists(), f"{bug[0]}: {done.stderr}"
    return sum(result["status"] == "failed" for result in json.loads(report.read_text())["results"])


def main(trgs):
    text = (hunts.HERE / "backend.py").read_text()
    print("| bug | stage | fixed questions that fail | a hunt finds it at | processor seconds | primitives × elements |")
    print("|---|---|---|---|---|---|")
    unseen, found = 0, 0
    with tempfile.TemporaryDirectory() as scratch:
        vectors = Path(scratch) / "vectors"
        subprocess.run([trgs, "oracle", "export", str(vectors), "--blind", "--level", "stress"], check=True, capture_output=True)
        for k, (name, stage, changes) in enumerate(BUGS):
            bug = name, stage, [], changes
            failed = fixed(trgs, bug, text, vectors, Path(scratch) / f"fixed-{k}")
            level, findings, seconds = hunts.hunt(trgs, "f64", bug, text, Path(scratch) / f"hunt-{k}", LEVELS)
            unseen += failed == 0
            found += failed == 0 and bool(findings)
            sizes = ", ".join(f"{f['primitives']} × {f['elements']}" for f in findings)
            print(f"| {name} | {stage} | {failed or 'none'} | {level or 'no level'} | {seconds:.1f} | {sizes} |", flush=True)
    print(f"\n{len(BUGS)} bugs, {unseen} of which no fixed question sees: a hunt finds {found} of these.")


if __name__ == "__main__":
    main(*sys.argv[1:])
