"""A conformance backend in NumPy:  python3 backend.py VECTORS ANSWERS [float32]

Each formula appears once, for ONE primitive p (12 numbers), in a function of complex numbers.
Gradients are complex steps, f'(x) = Im f(x + ih)/h: there is no subtraction, so they are exact to rounding.
The arithmetic is float64, or with a third argument float32 throughout, inputs and set-up included.
To test your own backend, keep `load` and the loop at the end, and let `answer` call your code.
"""
import json, sys
from pathlib import Path
import numpy as np

PARTS = {"mean": slice(0, 3), "scale": slice(3, 6), "quaternion": slice(6, 10), "density": 10, "nu": 11}
REAL, COMPLEX, H = {"float64": (np.float64, np.complex128, 1e-130), "float32": (np.float32, np.complex64, 1e-20)}[
    (sys.argv[3:] or ["float64"])[0]]  # H is the complex step: small against the smallest quaternion
EULER = (2, -1), (4, 5), (6, -61), (8, 1385), (10, -50521), (12, 2702765)  # n and Euler's number E_n

def rotation(quaternion):  # [Eq. 3] R of a quaternion of any norm
    w, x, y, z = quaternion / np.sqrt(np.sum(quaternion * quaternion))
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], quaternion.dtype)
    return np.eye(3, dtype=REAL) + 2 * w * k + 2 * k @ k
def power(delta, nu, n):  # (1 + delta/nu)^(-(nu+n)/2), exp(-delta/2) for nu = inf
    if np.isinf(nu.real):
        return np.exp(-delta / 2)
    x = delta / nu  # [X3] by the real log1p: NumPy's complex log1p is inaccurate near 0
    log = np.log1p(x.real) + 1j * x.imag / (1 + x.real)
    return np.exp(-(nu + n) / 2 * log)
def line_integral(nu):  # [A] sqrt(nu pi) Gamma(nu/2 + 1) / Gamma(nu/2 + 3/2)
    up = 0 if nu.real > 30 else 10  # number of recurrences before the asymptotic series
    ratio = np.prod(1 + 1 / (nu + 2 + 2 * np.arange(up, dtype=REAL)))
    series = np.exp(sum(e / (2 * n * (2 * nu + 3 + 4 * up)**n) for n, e in EULER))
    return np.sqrt(2 * np.pi / (1 + (2 * up + 1.5) / nu)) * ratio * series

def density(p, a):  # [Eq. 1] [Eq. 2] one primitive at the voxel centres [x, y, z]
    n, size, offset = (np.array(a["scanner"][key], REAL) for key in ("nVoxel", "sVoxel", "offOrigin"))
    voxel = offset - size / 2 + (np.moveaxis(np.indices(a["scanner"]["nVoxel"], REAL), 0, -1) + 0.5) * size / n
    local = (voxel - p[0:3]) @ rotation(p[6:10]) / p[3:6]
    return p[10] * power(np.sum(local * local, -1), p[11], 3)

def project(p, scanner, angle, exact):  # [Eq. 4] [Eq. 5] [X1] one primitive in one view [v, u]
    scale, nu, cone = p[3:6], p[11], scanner["mode"] == "cone"
    (rows, columns), (height, width) = scanner["nDetector"], scanner["sDetector"]
    c, s = np.cos(angle), np.sin(angle)
    camera = np.array([[-s, c, 0], [0, 0, -1], [-c, -s, 0]], REAL)  # the axes u, v, w (depth from the source)
    centre = camera @ p[0:3] + REAL([0, 0, scanner["DSO"]])
    if cone and centre[2].real <= scanner["DSO"] / 100:  # "near": left out
        return np.zeros((rows, columns), REAL)
    u = (np.arange(columns, dtype=REAL) + 0.5 - columns / 2) * width / columns + scanner["offDetector"][0]
    v = (np.arange(rows, dtype=REAL) + 0.5 - rows / 2) * height / rows - scanner["offDetector"][1]
    pixel = np.stack(np.broadcast_arrays(u, v[:, None], REAL(0)), -1)
    offset = pixel * (centre[2] / scanner["DSD"] if cone else 1) - centre * REAL([1, 1, 0])  # from the centre
    direction = pixel + REAL([0, 0, scanner["DSD"]]) if exact else centre  # affine: all rays are parallel to the centre's ray
    direction = direction if cone else REAL([0, 0, 1])
    local = camera @ rotation(p[6:10])  # its columns: the primitive's axes
    square = np.sum((direction @ local / scale)**2, -1)  # A = d' P d
    moment = np.cross(offset, direction) @ local * scale / np.prod(scale)
    delta = np.sum(moment * moment, -1) / square  # the least delta on the line, without cancellation
    length = np.sqrt(np.sum(direction * direction, -1))
    factor = (2 * np.pi)**0.5 if np.isinf(nu.real) else line_integral(nu)
    return p[10] * factor * length / np.sqrt(square) * power(delta, nu, 2)

def images(exact):  # the same in all views [view, v, u]
    return lambda p, a: np.array([project(p, a["scanner"], angle, exact) for angle in REAL(a["angles"])])
def gradient(field, a):  # of sum(cotangent * field), to the numbers as stored
    slope = lambda p, step: np.sum(a["cotangent"] * field(p + 1j * step, a).imag) / H
    rows = np.array([[slope(p, step) for step in H * np.eye(12, dtype=REAL)] for p in a["model"]], REAL).reshape(-1, 12)
    return {name: rows[:, columns] for name, columns in PARTS.items()}

def l1(prediction, target):  # losses return gradient, value
    return np.sign(prediction - target) / prediction.size, np.mean(np.abs(prediction - target))
def ssim(prediction, target):
    window = np.exp(-np.arange(-5, 6, dtype=REAL)**2 / 4.5)  # sigma = 1.5
    blur = [sum(w * np.eye(n, k=k - 5, dtype=REAL) for k, w in enumerate(window / sum(window))) for n in target.shape]
    def value(p, t=target):
        a, b, aa, bb, ab = (blur[0] @ image @ blur[1] for image in (p, t, p * p, t * t, p * t))
        quotient = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)
        return np.mean(quotient * (2 * (ab - a * b) + 9e-4) / (aa - a * a + bb - b * b + 9e-4))
    pixels = np.eye(target.size, dtype=REAL).reshape(-1, *target.shape)
    slope = [value(prediction + 1j * H * pixel).imag / H for pixel in pixels]
    return np.reshape(slope, target.shape), value(prediction)
def tv(block):
    steps = [np.diff(block, axis=k) for k in range(3)]
    count = max(1, sum(step.size for step in steps))
    slope = -sum(np.diff(np.sign(step), axis=k, prepend=REAL(0), append=REAL(0)) for k, step in enumerate(steps))
    return slope / count, sum(np.sum(np.abs(step)) for step in steps) / count
def adam(start, gradients, rates, beta1, beta2, epsilon):
    m, v, trajectory = 0, 0, [start]
    for t, (g, rate) in enumerate(zip(gradients, rates), 1):
        m, v = beta1 * m + (1 - beta1) * g, beta2 * v + (1 - beta2) * g * g
        m_hat, v_hat = m / (1 - beta1**t), v / (1 - beta2**t)
        trajectory.append(trajectory[-1] - rate * m_hat / (np.sqrt(v_hat) + epsilon))
    return [trajectory[1:]]

FIELDS = {"density": density, "affine": images(False), "exact": images(True)}
SMALL = {  # the other stages: from settings and inputs to outputs, ordered by the outputs' names
    "covariance": lambda model: [[(r := rotation(p[6:10])) * p[3:6]**2 @ r.T for p in model.real]],
    "kernel": lambda delta, nu: [[power(x, n, 3).real for x, n in zip(delta, np.where(nu > 0, nu, np.nan))]],
    "integral-factor": lambda nu: zip(*((f.real, f.imag / H) for f in map(line_integral, np.where(nu > 0, nu, np.nan) + 1j * H))),
    "loss-image": lambda prediction, target, weight: [
        x + weight * (c - y) for c, x, y in zip((0, 1), l1(prediction, target), ssim(prediction, target))],
    "loss-l1": l1, "loss-ssim": ssim, "loss-tv": tv, "adam": adam}

def answer(stage, a):
    kind, _, field = stage.rpartition("-")
    if field not in FIELDS:
        return SMALL[stage](**a) if stage in SMALL else []
    if kind.startswith("gradient"):
        return [gradient(FIELDS[field], a)]
    parts = np.array([FIELDS[field](p, a).real for p in a["model"]])
    return [parts if kind == "projected-kernel" else parts.sum(axis=0)]
def load(path):  # a model as an array [primitive, 12]; parameters of a network as None
    data = json.loads(path.read_text())["scanner"] if path.suffix == ".json" else np.load(path)
    if path.suffix == ".npz":
        model = np.column_stack([data[name] for name in PARTS]).astype(COMPLEX) if "mean" in data else None
        is_defined = model is None or np.all(model[:, [3, 4, 5, 11]].real > 0)  # scales and nu; NaN refuses the rest
        return model if is_defined else np.nan * model
    return data if path.suffix == ".json" else data.astype(REAL)

vectors, answers = map(Path, sys.argv[1:3])
for case in json.loads((vectors / "manifest.json").read_text())["cases"]:
    a = case["settings"] | {role: load(vectors / given["file"]) for role, given in case["inputs"].items()}
    for role, x in zip(sorted(case["outputs"]), answer(case["stage"], a)):
        path = answers / case["outputs"][role]["file"]
        path.parent.mkdir(parents=True, exist_ok=True)
        x = {name: np.array(array, order="C", ndmin=1) for name, array in (x if type(x) is dict else {"": x}).items()}
        assert all(array.dtype == REAL for array in x.values()), case["id"]
        np.savez(path, **x) if "" not in x else np.save(path, x[""])
(answers / "backend.json").write_text(json.dumps({"name": "NumPy example", "version": "1", "device": "CPU"}))
