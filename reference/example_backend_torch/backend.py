"""A conformance backend in PyTorch:  python3 backend.py VECTORS ANSWERS [float32 [cuda]]

The formulas are those of PROTOCOL.md as it states them, for all primitives at once; gradients are PyTorch's own (autograd).
The arithmetic is float64, or with a third argument float32 throughout, inputs and set-up included; on the CPU, or on the
device of a fourth argument.
"""
import json, math, sys
from pathlib import Path
import numpy as np
import torch

REAL = getattr(torch, (sys.argv[3:] or ["float64"])[0])
DEVICE = (sys.argv[4:] or ["cpu"])[0]
torch.set_default_dtype(REAL)
if DEVICE != "cpu":
    torch.set_default_device(DEVICE)
torch.set_num_threads(1)
KEYS = "mean", "scale", "quaternion", "density", "nu"


def rotations(quaternion):  # [Eq. 3] [M, 3, 3]; the columns are the axes
    w, x, y, z = (quaternion / quaternion.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, 1) for row in rows], 1)


def power(delta, nu, n):  # (1 + delta/nu)^(-(nu+n)/2); exp(-delta/2) where nu is infinite
    finite = torch.isfinite(nu)
    safe = torch.where(finite, nu, torch.ones_like(nu))  # no inf/inf in the gradient
    student = torch.exp(-(safe + n) / 2 * torch.log1p(delta / safe))
    return torch.where(finite, student, torch.exp(-delta / 2))


def integral_factor(nu):  # [Eq. 5] [A] C(nu)
    finite = torch.isfinite(nu)
    safe = torch.where(finite, nu, torch.ones_like(nu))
    student = torch.sqrt(safe * math.pi) * torch.exp(torch.lgamma((safe + 2) / 2) - torch.lgamma((safe + 3) / 2))
    return torch.where(finite, student, math.sqrt(2 * math.pi))


def by_primitive(numbers, dimensions):  # [M] for broadcasting with [M, ...]
    return numbers.reshape(-1, *[1] * dimensions)


def density(model, scanner, angles):  # [Eq. 1] [Eq. 2] of each primitive [M, x, y, z]
    n, size, offset = (scanner[key] for key in ("nVoxel", "sVoxel", "offOrigin"))
    axes = [offset[k] - size[k] / 2 + (torch.arange(n[k], dtype=REAL) + 0.5) * size[k] / n[k] for k in range(3)]
    voxels = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)
    difference = voxels - model["mean"].reshape(-1, 1, 1, 1, 3)
    local = torch.einsum("mxyzi,mij->mxyzj", difference, rotations(model["quaternion"]))
    delta = ((local / model["scale"].reshape(-1, 1, 1, 1, 3)) ** 2).sum(-1)
    return by_primitive(model["density"], 3) * power(delta, by_primitive(model["nu"], 3), 3)


def project(model, scanner, angle, exact):  # section 4, one view of each primitive [M, v, u]
    (rows, columns), (height, width) = scanner["nDetector"], scanner["sDetector"]
    cone, dso, dsd = scanner["mode"] == "cone", scanner["DSO"], scanner["DSD"]
    off_u, off_v = scanner["offDetector"]
    c, s = torch.cos(angle), torch.sin(angle)
    zero, one = torch.zeros(()), torch.ones(())
    camera = torch.stack([torch.stack(row) for row in ([-s, c, zero], [zero, zero, -one], [-c, -s, zero])])
    centre = model["mean"] @ camera.T + torch.tensor([0, 0, dso], dtype=REAL)  # depth from the source
    seen = centre[:, 2] > dso / 100 if cone else torch.ones(len(centre), dtype=torch.bool)
    m_u, m_v, m_w = (by_primitive(x, 2) for x in torch.where(seen[:, None], centre, torch.ones(3)).unbind(1))
    axes = (camera @ rotations(model["quaternion"])) / model["scale"][:, None, :]
    p = axes @ axes.transpose(1, 2)
    ray = torch.stack([m_u / m_w, m_v / m_w, torch.ones_like(m_w)], -1)[:, 0, 0] if cone else torch.tensor([[0, 0, 1.0]])
    g = (p @ ray[..., None])[..., 0]
    a0 = by_primitive((g * ray).sum(-1), 2)
    p_u = (torch.arange(columns, dtype=REAL) + 0.5 - columns / 2) * width / columns + off_u
    p_v = ((torch.arange(rows, dtype=REAL) + 0.5 - rows / 2) * height / rows - off_v)[:, None]
    alpha, beta = ((p_u / dsd - m_u / m_w) * m_w, (p_v / dsd - m_v / m_w) * m_w) if cone else (p_u - m_u, p_v - m_v)
    q = by_primitive(p[:, 0, 0], 2) * alpha**2 + 2 * by_primitive(p[:, 0, 1], 2) * alpha * beta
    q = q + by_primitive(p[:, 1, 1], 2) * beta**2
    along = by_primitive(g[:, 0], 2) * alpha + by_primitive(g[:, 1], 2) * beta
    delta = q - along**2 / a0
    kappa = 1 / m_w if exact and cone else torch.zeros_like(m_w)
    a = a0 + 2 * kappa * along + kappa**2 * q
    delta = (delta * a0 / a).clamp(min=0)
    u, v = (by_primitive(ray[:, k], 2) + kappa * x for k, x in enumerate((alpha, beta)))
    nu = by_primitive(model["nu"], 2)
    value = by_primitive(model["density"], 2) * integral_factor(nu) * torch.sqrt(u * u + v * v + 1) / torch.sqrt(a)
    return torch.where(by_primitive(seen, 2), value * power(delta, nu, 2), zero)


def images(exact):  # [M, view, v, u]
    return lambda model, scanner, angles: torch.stack([project(model, scanner, angle, exact) for angle in angles], 1)


def slopes(value, *inputs):  # zeros where an input has no effect
    found = torch.autograd.grad(value, inputs, allow_unused=True)
    return [torch.zeros_like(x) if slope is None else slope for x, slope in zip(inputs, found)]


def with_gradient(loss):  # outputs in the order of their names: gradient, value
    def answer(**given):
        variable = given.get("prediction", given.get("block")).requires_grad_()
        value = loss(**given)
        return slopes(value, variable)[0], value.reshape(1)
    return answer


def l1(prediction, target):
    return (prediction - target).abs().mean()


def ssim(prediction, target):
    window = torch.exp(-((torch.arange(11, dtype=REAL) - 5) ** 2) / (2 * 1.5**2))
    window = window / window.sum()
    images = torch.stack([prediction, target, prediction**2, target**2, prediction * target])[:, None]
    blurred = torch.nn.functional.conv2d(images, window.reshape(1, 1, 11, 1), padding=(5, 0))
    blurred = torch.nn.functional.conv2d(blurred, window.reshape(1, 1, 1, 11), padding=(0, 5))
    a, b, aa, bb, ab = blurred[:, 0]
    top = (2 * a * b + 0.01**2) * (2 * (ab - a * b) + 0.03**2)
    return (top / ((a * a + b * b + 0.01**2) * (aa - a * a + bb - b * b + 0.03**2))).mean()


def image_loss(prediction, target, weight):
    return l1(prediction, target) + weight * (1 - ssim(prediction, target))


def total_variation(block):
    steps = [block.diff(dim=k) for k in range(3)]
    count = sum(step.numel() for step in steps)
    return sum(step.abs().sum() for step in steps) / max(1, count)


def adam(start, gradients, rates, beta1, beta2, epsilon):
    x, m, v, trajectory = start, torch.zeros_like(start), torch.zeros_like(start), []
    for t, (g, rate) in enumerate(zip(gradients, rates), 1):
        m, v = beta1 * m + (1 - beta1) * g, beta2 * v + (1 - beta2) * g * g
        x = x - rate * (m / (1 - beta1**t)) / (torch.sqrt(v / (1 - beta2**t)) + epsilon)
        trajectory.append(x)
    return [torch.stack(trajectory)]


def covariance(model):
    axes = rotations(model["quaternion"]) * model["scale"][:, None, :]
    return [axes @ axes.transpose(1, 2)]


def factor(nu):
    nu.requires_grad_()
    value = integral_factor(nu)
    return value, slopes(value.sum(), nu)[0]


FIELDS = {"density": density, "image-affine": images(False), "image-exact": images(True)}
KERNELS = {"projected-kernel-affine": images(False), "projected-kernel-exact": images(True)}
SMALL = {  # from inputs and settings to the outputs, ordered by their names
    "covariance": covariance,
    "kernel": lambda delta, nu: [power(delta, nu, 3)],
    "integral-factor": factor,
    "loss-l1": with_gradient(l1),
    "loss-ssim": with_gradient(ssim),
    "loss-image": with_gradient(image_loss),
    "loss-tv": with_gradient(total_variation),
    "adam": adam,
}


def answer(stage, given):
    if stage in SMALL:
        return SMALL[stage](**given)
    model, scanner = given.get("model"), given.get("scanner")
    angles = torch.tensor(given.get("angles", []), dtype=REAL)
    if stage in KERNELS:
        return [KERNELS[stage](model, scanner, angles)]
    if stage in FIELDS:
        return [FIELDS[stage](model, scanner, angles).sum(0)]
    field = FIELDS.get(stage.removeprefix("gradient-"))
    if field is None:
        return []
    inputs = [model[key].requires_grad_() for key in KEYS]
    value = (given["cotangent"] * field(model, scanner, angles)).sum()
    return [dict(zip(KEYS, slopes(value, *inputs)))]


def load(path):
    if path.suffix == ".json":
        return json.loads(path.read_text())["scanner"]
    data = np.load(path)
    if path.suffix == ".npz":
        return {key: torch.tensor(data[key], dtype=REAL) for key in data.files}
    return torch.tensor(data, dtype=REAL)


def main(vectors, answers):
    for case in json.loads((vectors / "manifest.json").read_text())["cases"]:
        given = case["settings"] | {role: load(vectors / file["file"]) for role, file in case["inputs"].items()}
        for role, result in zip(sorted(case["outputs"]), answer(case["stage"], given)):
            path = answers / case["outputs"][role]["file"]
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(result, dict):
                np.savez(path, **{key: array.detach().cpu().numpy() for key, array in result.items()})
            else:
                np.save(path, result.detach().cpu().numpy())
    about = {"name": f"PyTorch example in {REAL}", "version": torch.__version__, "device": DEVICE}
    (answers / "backend.json").write_text(json.dumps(about))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
