"""What the oracle's diagnosis says of deliberate bugs:  python3 bugs.py TRGS [f64|f32] > RESULT.md

Each bug is one change of backend.py. It runs on all cases up to level `optional`, `TRGS oracle check` judges the answers to the stages
of the bug, and every array that fails is counted: named rightly, described (a factor, a sign, zeros: true, but no cause), silent, or
named wrongly. A name that holds the right one and another counts as right among candidates. With f32 the backend computes in single
precision. ../example_backend_torch/bugs.py has bugs of its own and uses this program.
"""
import json, subprocess, sys, tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).parent
LEVEL = "optional"
DESCRIBED = ("a factor of", "the opposite sign", "zeros", "1 - x instead of x")
EXACT, AFFINE, FIELD = "image-exact", "image-affine", "density"
PIXEL_U, PIXEL_V = "(np.arange(columns, dtype=REAL) + 0.5 - columns / 2) * width / columns", "(np.arange(rows, dtype=REAL) + 0.5 - rows / 2) * height / rows"
OFF_U, OFF_V = '+ scanner["offDetector"][0]', '- scanner["offDetector"][1]'
GAMMA = "return np.sqrt(2 * np.pi / (1 + (2 * up + 1.5) / nu)) * ratio * series"
FACTOR = "factor = (2 * np.pi)**0.5 if np.isinf(nu.real) else line_integral(nu)"
START = 'scale, nu, cone = p[3:6], p[11], scanner["mode"] == "cone"'
LOCAL = "local = (voxel - p[0:3]) @ rotation(p[6:10]) / p[3:6]"
VOXEL = 'voxel = offset - size / 2 + (np.moveaxis(np.indices(a["scanner"]["nVoxel"], REAL), 0, -1) + 0.5) * size / n'
ROWS = "return {name: rows[:, columns] for name, columns in PARTS.items()}"
SUM = "parts.sum(axis=0)]"
ADAM = "trajectory.append(trajectory[-1] - rate * m_hat / (np.sqrt(v_hat) + epsilon))"
BLUR = "blur = [sum(w * np.eye(n, k=k - 5, dtype=REAL) for k, w in enumerate(window / sum(window))) for n in target.shape]"
QUOTIENT = "quotient = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)"
MEAN = "return np.mean(quotient * (2 * (ab - a * b) + 9e-4) / (aa - a * a + bb - b * b + 9e-4))"
L1 = "return np.sign(prediction - target) / prediction.size, np.mean(np.abs(prediction - target))"
IMAGE = "x + weight * (c - y) for c, x, y in"
TV = "return slope / count, sum(np.sum(np.abs(step)) for step in steps) / count"
COVARIANCE = "[[(r := rotation(p[6:10])) * p[3:6]**2 @ r.T for p in model.real]]"

# name, stages, the words of a right name (none: no mistake of the catalogue, so that silence is right), pairs (text, its replacement)
BUGS = [
    # geometry of the views
    ("half a pixel along u", f"{EXACT},{AFFINE}", ["half-pixel shift in u"], [(PIXEL_U, PIXEL_U.replace(" + 0.5", ""))]),
    ("half a pixel along v", f"{EXACT},gradient-{EXACT}", ["half-pixel shift in v"], [(PIXEL_V, PIXEL_V.replace(" + 0.5", ""))]),
    ("half a pixel along both", EXACT, ["half-pixel shift in u and v"], [(PIXEL_U, PIXEL_U.replace(" + 0.5", "")), (PIXEL_V, PIXEL_V.replace(" + 0.5", ""))]),
    ("one pixel along u", EXACT, ["shifted by one along u"], [(PIXEL_U, PIXEL_U.replace("0.5", "1.5"))]),
    ("sense of rotation", f"{EXACT},gradient-{EXACT}", ["opposite sense of rotation"], [("np.cos(angle), np.sin(angle)", "np.cos(angle), -np.sin(angle)")]),
    ("half a turn", EXACT, ["other's side"], [("np.cos(angle), np.sin(angle)", "-np.cos(angle), -np.sin(angle)")]),
    ("quarter turn", f"{EXACT},gradient-{AFFINE}", ["quarter turn"], [("np.cos(angle), np.sin(angle)", "-np.sin(angle), np.cos(angle)")]),
    ("degrees", EXACT, ["degrees"], [("np.cos(angle), np.sin(angle)", "np.cos(np.radians(angle)), np.sin(np.radians(angle))")]),
    ("offset u sign", f"{EXACT},gradient-{EXACT}", ["along u with the opposite sign"], [(OFF_U, OFF_U.replace("+", "-"))]),
    ("offset v sign", f"{EXACT},{AFFINE}", ["along v counted down"], [(OFF_V, OFF_V.replace("-", "+"))]),
    ("offset signs", EXACT, ["offset with the opposite sign"], [(OFF_U, OFF_U.replace("+", "-")), (OFF_V, OFF_V.replace("-", "+"))]),
    ("no offset", EXACT, ["offset ignored"], [(OFF_U, ""), (OFF_V, "")]),
    ("offsets exchanged", EXACT, ["offset read as"], [(OFF_U, OFF_U.replace("0", "1")), (OFF_V, OFF_V.replace("1", "0"))]),
    ("DSD - DSO", f"{EXACT},gradient-{EXACT}", ["DSD - DSO"], [(START, "scanner = scanner | {'DSD': scanner['DSD'] - scanner['DSO']}; " + START)]),
    ("DSO + DSD", EXACT, ["DSO + DSD"], [(START, "scanner = scanner | {'DSD': scanner['DSD'] + scanner['DSO']}; " + START)]),
    ("DSO and DSD", f"{EXACT},{AFFINE}", ["DSO and DSD exchanged"], [(START, "scanner = scanner | {'DSD': scanner['DSO'], 'DSO': scanner['DSD']}; " + START)]),
    ("height and width", EXACT, ["height and width exchanged"], [("(height, width) =", "(width, height) =")]),
    ("pixel sizes", EXACT, ["pixel sizes"], [(PIXEL_U, PIXEL_U.replace("width / columns", "height / rows")), (PIXEL_V, PIXEL_V.replace("height / rows", "width / columns"))]),
    ("affine for exact", f"{EXACT},gradient-{EXACT}", ["affine projection for the exact"], [("images(True)", "images(False)")]),
    ("exact for affine", AFFINE, ["exact projection for the affine"], [("images(False)", "images(True)")]),
    ("detector transposed", EXACT, ["v and u transposed"], [(SUM, "parts.sum(axis=0).swapaxes(-1, -2)]")]),
    ("detector stored as [u, v]", EXACT, ["v and u transposed"], [(SUM, "parts.sum(axis=0).swapaxes(-1, -2).reshape(parts.shape[1:])]")]),
    ("rows from the bottom", EXACT, ["mirrored along v"], [(SUM, "np.flip(parts.sum(axis=0), -2)]")]),
    ("columns from the right", EXACT, ["mirrored along u"], [(SUM, "np.flip(parts.sum(axis=0), -1)]")]),
    ("views backwards", EXACT, ["mirrored along view"], [(SUM, "np.flip(parts.sum(axis=0), 0)]")]),
    ("depth of the axis", AFFINE, ["depth of the axis"], [('(centre[2] / scanner["DSD"] if', '(scanner["DSO"] / scanner["DSD"] if')]),
    # kernels and integral factors
    ("cosine", f"{EXACT},projected-kernel-exact", ["ray's length left out"], [("length = np.sqrt(np.sum(direction * direction, -1))", "length = direction[..., 2]")]),
    ("twice the amplitude", AFFINE, ["a factor of 2"], [("return p[10] * factor", "return 2 * p[10] * factor")]),
    ("exponent of the density", f"{EXACT},gradient-{EXACT}", ["exponent (ν+3)/2"], [("power(delta, nu, 2)", "power(delta, nu, 3)")]),
    ("exponent nu + 1", f"{AFFINE},projected-kernel-affine", ["exponent (ν+1)/2"], [("power(delta, nu, 2)", "power(delta, nu, 1)")]),
    ("exponent of the projection", f"{FIELD},gradient-{FIELD}", ["exponent (ν+2)/2"], [("p[11], 3)", "p[11], 2)")]),
    ("exponent nu/2", FIELD, ["exponent ν/2"], [("p[11], 3)", "p[11], 0)")]),
    ("exponent of the kernel", "kernel", ["exponent (ν+1)/2"], [("power(x, n, 3)", "power(x, n, 1)")]),
    ("log of 1 + x", "kernel", ["log(1 + x)"], [("np.log1p(x.real)", "np.log(1 + x.real)")]),
    ("delta without nu", f"kernel,{FIELD},{EXACT}", ["1 + δ in place"], [("x = delta / nu", "x = delta")]),
    ("distance", f"{FIELD},kernel", ["the distance √δ"], [("x = delta / nu", "x = np.sqrt(delta) / nu"), ("np.exp(-delta / 2)", "np.exp(-np.sqrt(delta) / 2)")]),
    ("cut at three scales", f"{FIELD},{EXACT}", ["three scales"], [("return np.exp(-delta / 2)", "return np.exp(-delta / 2) * (delta.real <= 9)"), ("return np.exp(-(nu + n) / 2 * log)", "return np.exp(-(nu + n) / 2 * log) * (delta.real <= 9)")]),
    ("no root of nu pi", f"integral-factor,{EXACT},gradient-{EXACT}", ["√(νπ) left out"], [(GAMMA, GAMMA + " / np.sqrt(nu * np.pi)")]),
    ("no Gamma quotient", f"integral-factor,{EXACT}", ["Γ quotient left out"], [(GAMMA, "return np.sqrt(nu * np.pi)")]),
    ("inverted Gamma quotient", f"integral-factor,{AFFINE}", ["quotient inverted"], [(GAMMA, GAMMA.replace("return ", "return nu * np.pi / (") + ")")]),
    ("no pi", f"integral-factor,{EXACT}", ["√ν for √(νπ)"], [(GAMMA, GAMMA + " / np.sqrt(np.pi)")]),
    ("no integral factor", f"{EXACT},{AFFINE}", ["integral factor left out"], [(FACTOR, "factor = 1")]),
    ("Gaussian's factor", f"{EXACT},gradient-{EXACT}", ["Gaussian's √(2π)"], [(FACTOR, "factor = (2 * np.pi)**0.5")]),
    ("constant factor in the gradient", f"gradient-{EXACT}", ["∂C/∂ν"], [("else line_integral(nu)", "else line_integral(nu.real)")]),
    # the model
    ("quaternion order", f"{EXACT},covariance,gradient-{EXACT}", ["(x, y, z, w)"], [("w, x, y, z = quaternion", "x, y, z, w = quaternion")]),
    ("inverse rotation", f"{EXACT},covariance,{FIELD},gradient-{FIELD}", ["inverse rotation"], [("w, x, y, z = quaternion", "w, x, y, z = quaternion * [-1, 1, 1, 1]")]),
    ("quaternion as stored", f"{EXACT},gradient-{FIELD}", ["not normalised", "not through the quaternion's normalisation"], [("quaternion / np.sqrt(np.sum(quaternion * quaternion))", "quaternion")]),
    ("scales as variances", f"{FIELD},{EXACT},covariance", ["scales taken for variances"], [(LOCAL, LOCAL.replace("p[3:6]", "np.sqrt(p[3:6])")), ("p[3:6], p[11], scanner", "np.sqrt(p[3:6]), p[11], scanner"), ("p[3:6]**2 @", "p[3:6] @")]),
    ("variances as scales", f"{EXACT},gradient-{EXACT}", ["variances taken for scales"], [("p[3:6], p[11], scanner", "p[3:6]**2, p[11], scanner")]),
    ("Gaussian kernel", f"{FIELD},{EXACT}", ["Gaussian kernel"], [("if np.isinf(nu.real):\n        return", "if True:\n        return"), (FACTOR, "factor = (2 * np.pi)**0.5")]),
    ("inverse covariance", "covariance", ["inverse of the covariance"], [("p[3:6]**2 @", "p[3:6]**-2 @")]),
    # volumes
    ("voxel corners", FIELD, ["voxel corners"], [(VOXEL, VOXEL.replace(" + 0.5", ""))]),
    ("half a voxel along x", FIELD, ["half-voxel shift along x"], [(VOXEL, VOXEL.replace("+ 0.5", "+ np.array([0, 0.5, 0.5])"))]),
    ("no offset of the volume", f"{FIELD},gradient-{FIELD}", ["volume's offset ignored"], [(VOXEL, VOXEL.replace("offset - ", "-"))]),
    ("offset of the volume, sign", FIELD, ["volume's offset with the opposite sign"], [(VOXEL, VOXEL.replace("offset - ", "-offset - "))]),
    ("voxels from end to end", FIELD, ["from one end of the box"], [(VOXEL, VOXEL.replace("+ 0.5) * size / n", ") * size / np.maximum(n - 1, 1)"))]),
    ("sides z, y, x", FIELD, ["order z, y, x"], [(VOXEL, "size = size[::-1]; " + VOXEL)]),
    ("volume [z, y, x]", FIELD, ["x and z transposed"], [(SUM, "parts.sum(axis=0).transpose(2, 1, 0) if field == 'density' else parts.sum(axis=0)]")]),
    ("z downwards", FIELD, ["mirrored along z"], [(SUM, "np.flip(parts.sum(axis=0), -1)]")]),
    # gradients
    ("sign of the gradient", f"gradient-{EXACT},gradient-{FIELD}", ["the opposite sign"], [("* field(p + 1j * step, a).imag)", "* -field(p + 1j * step, a).imag)")]),
    ("half of the gradient", f"gradient-{AFFINE}", ["a factor of ½"], [("* field(p + 1j * step, a).imag) / H", "* field(p + 1j * step, a).imag) / H / 2")]),
    ("scale's logarithm", f"gradient-{EXACT}", ["scale's logarithm"], [(ROWS, "rows[:, 3:6] *= a['model'][:, 3:6].real; " + ROWS)]),
    ("scale's variance", f"gradient-{FIELD}", ["the gradient to the variance"], [(ROWS, "rows[:, 3:6] /= 2 * a['model'][:, 3:6].real; " + ROWS)]),
    ("density's logarithm", f"gradient-{FIELD}", ["density's logarithm"], [(ROWS, "rows[:, 10] *= a['model'][:, 10].real; " + ROWS)]),
    ("nu's logarithm", f"gradient-{EXACT}", ["logarithm of ν"], [(ROWS, "rows[:, 11] *= np.nan_to_num(a['model'][:, 11].real, posinf=0); " + ROWS)]),
    ("normalisation left out of the gradient", f"gradient-{EXACT}", ["not through the quaternion's normalisation"], [("np.sqrt(np.sum(quaternion * quaternion))", "np.sqrt(np.sum(quaternion.real**2))")]),
    ("quaternion gradient as x, y, z, w", f"gradient-{EXACT}", ["order (x, y, z, w)"], [(ROWS, "rows[:, 6:10] = rows[:, [7, 8, 9, 6]]; " + ROWS)]),
    ("sign of w", f"gradient-{FIELD}", ["gradient to w"], [(ROWS, "rows[:, 6] *= -1; " + ROWS)]),
    ("no gradient to the mean", f"gradient-{EXACT}", ["zeros throughout"], [(ROWS, "rows[:, :3] = 0; " + ROWS)]),
    # losses
    ("sum for mean", "loss-l1", ["a sum instead of a mean"], [(L1, "return np.sign(prediction - target), np.sum(np.abs(prediction - target))")]),
    ("mean square", "loss-l1,loss-image", ["mean square"], [(L1, "return 2 * (prediction - target) / prediction.size, np.mean((prediction - target)**2)")]),
    ("slope of equal pixels", "loss-l1", ["a slope where"], [("np.sign(prediction - target)", "np.where(prediction >= target, 1.0, -1.0)")]),
    ("SSIM without padding", "loss-ssim", ["without padding"], [(BLUR, BLUR.replace("for n in target.shape]", "for n in target.shape]; blur = [b[5:-5] for b in blur]")), ("blur[0] @ image @ blur[1]", "blur[0] @ image @ blur[1].T")]),
    ("SSIM renormalised", "loss-ssim", ["renormalised"], [(BLUR, BLUR + "; blur = [b / b.sum(1, keepdims=True) for b in blur]"), ("blur[0] @ image @ blur[1]", "blur[0] @ image @ blur[1].T")]),
    ("uniform window", "loss-ssim", ["uniform window of 11"], [("np.exp(-np.arange(-5, 6, dtype=REAL)**2 / 4.5)", "np.ones(11)")]),
    ("window of 7", "loss-ssim", ["window of 7 pixels"], [("np.exp(-np.arange(-5, 6, dtype=REAL)**2 / 4.5)", "np.exp(-np.arange(-5, 6, dtype=REAL)**2 / 4.5) * (abs(np.arange(-5, 6)) < 4)")]),
    ("variance of 1.5", "loss-ssim", ["σ² = 1.5"], [("**2 / 4.5)", "**2 / 3)")]),
    ("constants not squared", "loss-ssim,loss-image", ["not squared"], [(QUOTIENT, QUOTIENT.replace("1e-4", "1e-2")), (MEAN, MEAN.replace("9e-4", "3e-2"))]),
    ("constants exchanged", "loss-ssim", ["C1 and C2 exchanged"], [(QUOTIENT, QUOTIENT.replace("1e-4", "9e-4")), (MEAN, MEAN.replace("9e-4", "1e-4"))]),
    ("unbiased variances", "loss-ssim", ["unbiased"], [(MEAN, MEAN.replace("(ab - a * b)", "(ab - a * b) * 121 / 120").replace("(aa - a * a + bb - b * b", "((aa - a * a + bb - b * b) * 121 / 120"))]),
    ("1 - SSIM", "loss-ssim", ["1 - SSIM for SSIM", "the opposite sign", "1 - x"], [("return np.reshape(slope, target.shape), value(prediction)", "return -np.reshape(slope, target.shape), 1 - value(prediction)"), (IMAGE, "x + weight * y for c, x, y in")]),
    ("mixed as 3DGS", "loss-image", ["(1 - weight)·L1"], [(IMAGE, "(1 - weight) * x + weight * (c - y) for c, x, y in")]),
    ("half of 1 - SSIM", "loss-image", ["½·(1 - SSIM)"], [(IMAGE, "x + weight / 2 * (c - y) for c, x, y in")]),
    ("weight of 0.2", "loss-image", ["a weight of 0.2"], [(IMAGE, "x + 0.2 * (c - y) for c, x, y in")]),
    ("plus SSIM", "loss-image", ["L1 + weight·SSIM"], [(IMAGE, "x + weight * y for c, x, y in")]),
    ("TV as a sum", "loss-tv", ["a sum instead of a mean"], [(TV, "return slope, sum(np.sum(np.abs(step)) for step in steps)")]),
    ("TV over voxels", "loss-tv", ["mean over voxels"], [(TV, TV.replace("/ count", "/ block.size"))]),
    ("TV of squares", "loss-tv", ["squares"], [("np.diff(np.sign(step), axis", "np.diff(2 * step, axis"), (TV, TV.replace("np.abs(step)", "step**2"))]),
    # Adam
    ("no bias correction", "adam", ["without bias correction"], [("m / (1 - beta1**t), v / (1 - beta2**t)", "m, v")]),
    ("no bias correction of v", "adam", ["without bias correction of v"], [("v / (1 - beta2**t)", "v")]),
    ("correction ahead", "adam", ["one step ahead"], [("m / (1 - beta1**t), v / (1 - beta2**t)", "m / (1 - beta1**(t + 1)), v / (1 - beta2**(t + 1))")]),
    ("epsilon in the root", "adam", ["ε inside of the root"], [("(np.sqrt(v_hat) + epsilon)", "np.sqrt(v_hat + epsilon)")]),
    ("epsilon 1e-8", "adam", ["ε = 1e-8"], [("+ epsilon))", "+ 1e-8))")]),
    ("betas exchanged", "adam", ["exchanged"], [('"adam": adam}', '"adam": lambda beta1, beta2, **a: adam(beta1=beta2, beta2=beta1, **a)}')]),
    ("AMSGrad", "adam", ["AMSGrad"], [("m_hat, v_hat =", "top = np.maximum(v, top if t > 1 else 0); m_hat, v_hat ="), ("v / (1 - beta2**t)", "top / (1 - beta2**t)")]),
    ("AdamW", "adam", ["AdamW"], [(ADAM, "trajectory.append(trajectory[-1] * (1 - rate * 0.01) - rate * m_hat / (np.sqrt(v_hat) + epsilon))")]),
    ("weight decay", "adam", ["decay of 0.01 in the gradient"], [("m, v = beta1", "g = g + 0.01 * trajectory[-1]; m, v = beta1")]),
    ("constant rate", "adam", ["the first rate"], [("- rate * m_hat", "- rates[0] * m_hat")]),
    # number formats
    ("images in float16", EXACT, ["f16"], [(SUM, "parts.sum(axis=0).astype('f2')]")]),
    ("images in float32", f"{EXACT},{FIELD}", ["f32"], [(SUM, "parts.sum(axis=0).astype('f4')]")]),
    ("sums in float16", f"{EXACT},{FIELD}", ["accumulated in f16"], [(SUM, "__import__('functools').reduce(lambda s, x: (s + x.astype('f2')).astype('f2'), parts, np.zeros_like(parts[0], 'f2'))]")]),
    # mistakes that are not in the catalogue: silence is right
    ("random half percent", f"{EXACT},{FIELD},gradient-{EXACT}", [], [('np.save(path, x[""])', "np.save(path, (x := x['']) * (1 + 0.005 * np.sin(1 + np.arange(np.size(x))).reshape(np.shape(np.atleast_1d(x)))))")]),
    ("half percent in every value", "loss-l1,loss-ssim,loss-tv,loss-image", [], [('np.save(path, x[""])', "np.save(path, (x := x['']) * (1.005 if np.size(x) < 3 else 1))")]),
    ("noise of 1e-7", f"{EXACT},{AFFINE},{FIELD},adam,kernel,covariance", [], [('np.save(path, x[""])', "np.save(path, (x := x['']) * (1 + 1e-7 * np.sin(1 + np.arange(np.size(x))).reshape(np.shape(np.atleast_1d(x)))))")]),
    ("nu at most 10", f"{EXACT},{FIELD}", [], [("np.column_stack([data[name] for name in PARTS]).astype(COMPLEX)", "np.column_stack([np.minimum(data[name], 10) if name == 'nu' else data[name] for name in PARTS]).astype(COMPLEX)")]),
    ("scales at least 0.15", f"{EXACT},gradient-{FIELD}", [], [("np.column_stack([data[name] for name in PARTS]).astype(COMPLEX)", "np.column_stack([np.maximum(data[name], 0.15) if name == 'scale' else data[name] for name in PARTS]).astype(COMPLEX)")]),
    ("cotangent mirrored", f"gradient-{EXACT}", [], [('a["cotangent"] * field', 'a["cotangent"][..., ::-1] * field')]),
    ("squared density", f"{EXACT},{FIELD}", [], [("return p[10] * factor", "return p[10]**2 * factor"), ("return p[10] * power", "return p[10]**2 * power")]),
    ("epsilon 1e-5", "adam", [], [("+ epsilon))", "+ 1e-5))")]),
    ("beta1 of 0.85", "adam", [], [("m, v = beta1", "beta1 = 0.85; m, v = beta1")]),
    ("pixel sizes 3 % too large", EXACT, [], [("* width / columns", "* 1.03 * width / columns"), ("* height / rows", "* 1.03 * height / rows")]),
    ("angles 1 degree off", EXACT, [], [("np.cos(angle), np.sin(angle)", "np.cos(angle + 0.01745), np.sin(angle + 0.01745)")]),
]


def verdict(name, right):
    """The class of the name of one array."""
    if name is None:
        return "silent"
    if any(word in name for word in right):
        return "among candidates" if ", or " in name else "right"
    observed = name.startswith(DESCRIBED) and ", or " not in name and ": " not in name
    return "described" if observed else "wrong"


def mutated(bug, text, folder):
    """Writes the backend with one bug, for the stages of the bug alone."""
    name, stages, _, changes = bug
    for old, new in changes:
        assert old in text, f"{name}: {old!r} is not in the backend"
    for k, (old, _) in enumerate(changes):
        text = text.replace(old, f"\0{k}\0")
    for k, (_, new) in enumerate(changes):
        text = text.replace(f"\0{k}\0", new)
    folder.mkdir()
    backend = folder / "backend.py"
    loop = next(line for line in text.splitlines() if line.endswith('["cases"]:'))
    indent = " " * (len(loop) - len(loop.lstrip()) + 4)
    text = text.replace(loop, f'{loop}\n{indent}if case["stage"] not in {stages.split(",")}: continue', 1)
    # A bug may compute in double precision what the rest computes in single precision.
    text = text.replace("assert all(array.dtype == REAL", "assert all(array.dtype")
    backend.write_text(text)
    return backend


def judge(trgs, precision, bug, text, vectors, folder):
    name, stages, right, _ = bug
    backend, answers, report = mutated(bug, text, folder), folder / "answers", folder / "report.json"
    word = {"f64": "float64", "f32": "float32"}[precision]
    done = subprocess.run([sys.executable, "-W", "ignore", str(backend), str(vectors), str(answers), word], capture_output=True, text=True)
    assert done.returncode == 0, f"{name}: {done.stderr}"
    check = [trgs, "oracle", "check", str(answers), "--precision", precision, "--level", LEVEL, "--stage", stages, "--report", str(report)]
    done = subprocess.run(check, capture_output=True, text=True)
    assert report.exists(), f"{name}: {done.stderr}"
    parts = [part for result in json.loads(report.read_text())["results"] for part in result["parts"] if part["status"] == "failed"]
    names = Counter(part.get("looks_like") for part in parts)
    return names, Counter(verdict(part.get("looks_like"), right) for part in parts)


def table(bugs, results):
    columns = ["right", "among candidates", "described", "silent", "wrong"]
    known = [(bug, counts) for bug, (_, counts) in zip(bugs, results) if bug[2]]
    unknown = [(bug, counts) for bug, (_, counts) in zip(bugs, results) if not bug[2]]
    lines = []
    for title, rows in (("Bugs of the catalogue", known), ("Other bugs: silence or a description is right", unknown)):
        if not rows:
            continue
        total = sum((counts for _, counts in rows), Counter())
        arrays = max(1, sum(total.values()))
        lines += [f"### {title}", "", "| bug | arrays that fail | " + " | ".join(columns) + " |", "|---|" + "---|" * 6]
        for bug, counts in rows:
            lines.append(f"| {bug[0]} | {sum(counts.values())} | " + " | ".join(str(counts[c]) for c in columns) + " |")
        shares = " | ".join(f"{total[c]} ({100 * total[c] / arrays:.1f} %)" for c in columns)
        lines += [f"| **{len(rows)} bugs** | {arrays} | {shares} |", ""]
        most = Counter()
        for _, counts in rows:
            told = {c: counts[c] for c in columns if c != "silent" and counts[c]}
            most[max(told, key=told.get) if told else "silent"] += 1
        caught = sum(1 for _, counts in rows if sum(counts.values()))
        lines += [f"Caught: {caught}. By their most frequent name: " + ", ".join(f"{c} {most[c]}" for c in columns) + ".", ""]
    return "\n".join(lines)


def main(bugs, backend, trgs, precision="f64"):
    text = backend.read_text()
    with tempfile.TemporaryDirectory() as scratch:
        scratch = Path(scratch)
        vectors = scratch / "vectors"
        subprocess.run([trgs, "oracle", "export", str(vectors), "--blind", "--level", LEVEL], check=True, capture_output=True)
        one = lambda k: judge(trgs, precision, bugs[k], text, vectors, scratch / str(k))
        with ThreadPoolExecutor(2) as pool:
            results = list(pool.map(one, range(len(bugs))))
    for (name, _, right, _), (names, counts) in zip(bugs, results):
        print(name, dict(counts), {k: v for k, v in names.items() if verdict(k, right) == "wrong"}, file=sys.stderr)
    print(table(bugs, results))


if __name__ == "__main__":
    main(BUGS, HERE / "backend.py", *sys.argv[1:])
