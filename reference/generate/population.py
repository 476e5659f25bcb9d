"""Position sampler and density control in 50-digit arithmetic; settings are float64 values, taken exactly."""

from dataclasses import replace
from math import comb

from mpmath import mp, mpf

from gradients import STEP
from projection import CameraFrame, left_out
from scene import dot, rotation


# ---------------------------------------------------------------------------- positions

def gate(density, reference):
    """sigmoid(100 ((1 - min(density/reference, 1)) - 995/1000)), and 0 where that is below 1e-12."""
    filled = min(mpf(density) / mpf(reference), mpf(1))
    value = 1 / (1 + mp.exp(-100 * ((1 - filled) - mpf(995) / 1000)))
    return value if value >= mpf(10)**-12 else mpf(0)


def sghmc(start, directions, noise, gates, covariance, rates, burn_in, burn_in_friction, friction):
    """Positions after each step; the first `burn_in` steps have no momentum."""
    x = [[mpf(float(c)) for c in row] for row in start]
    p = [[mpf(0)] * 3 for _ in x]
    trajectory = []
    for step, (direction, draws, rate) in enumerate(zip(directions, noise, rates)):
        rate = mpf(float(rate))
        burning = step < burn_in
        if step == burn_in:
            p = [[mpf(0)] * 3 for _ in x]
        spread = mp.sqrt(2 * rate * mpf(burn_in_friction if burning else friction))
        for i in range(len(x)):
            g, z, s = [mpf(float(c)) for c in direction[i]], [mpf(float(c)) for c in draws[i]], mpf(float(gates[i]))
            if burning:
                shape = [[mpf(float(c)) for c in row] for row in covariance[i]]
                p[i] = [-rate * g[k] + s * spread * dot(shape[k], z) for k in range(3)]
            else:
                p[i] = [s * (1 - rate * mpf(friction)) * p[i][k] - rate * g[k] + s * spread * z[k] for k in range(3)]
            x[i] = [x[i][k] + rate * p[i][k] for k in range(3)]
        trajectory.append([list(row) for row in x])
    return trajectory


# ---------------------------------------------------------------------------- density control

def share(rule, p, n):
    """(density, factor on the scales) of each of n copies of p."""
    if n == 1:
        return p.density, mpf(1)
    if rule == "exact":
        return p.density / n, mpf(1)
    n = min(n, 51)
    opacity = min(p.density, 1 - mpf(10)**-6)
    each = 1 - (1 - opacity)**(mpf(1) / n)

    def line(j):
        """B(1/2, (j (nu+3) - 1)/2), or its limit for large nu, up to a factor common to all j"""
        return 1 / mp.sqrt(j) if p.gaussian else mp.beta(mpf(1) / 2, (j * (p.nu + 3) - 1) / 2)

    total = sum(comb(n, j) * (-1)**(j - 1) * each**j * line(j) for j in range(1, n + 1))
    factor = opacity * line(1) / total
    return each, factor if rule == "sss" else factor**2


def ar(primitives, uniform, dead, recycled, growth, cap, relocation):
    """Adding and recycling: [(primitive, row of its parent, new?)]; one uniform number for each copy."""
    draws = iter(mpf(float(u)) for u in uniform)
    m = len(primitives)
    rows = [(p, i, False) for i, p in enumerate(primitives)]

    def drawn(weights, n):
        total, chosen = sum(weights), []
        for _ in range(n if total > 0 else 0):
            target, running = next(draws) * total, mpf(0)
            for i, weight in enumerate(weights):
                running += weight
                assert abs(running - target) > mpf(10)**-9 or weight == 0, "a draw on the border of two rows"
                if running > target:
                    chosen.append(i)
                    break
        return chosen

    def copies(chosen):
        for i in set(chosen):
            p, parent, new = rows[i]
            density, factor = share(relocation, p, chosen.count(i) + 1)
            rows[i] = (replace(p, density=density, scale=tuple(s * factor for s in p.scale)), parent, new)
        return [(rows[i][0], rows[i][1], True) for i in chosen]

    gone = sorted((i for i in range(m) if primitives[i].density < dead), key=lambda i: (primitives[i].density, i))
    gone = gone[:int(mpf(recycled) * m)]
    chosen = drawn([p.density if p.density >= dead else mpf(0) for p in primitives], len(gone))
    for i, copy in zip(gone, copies(chosen)):
        rows[i] = copy
    added = min(int(mpf(growth) * m), max(cap - m, 0))
    chosen = drawn([p.density for p, _, _ in rows], added)
    return rows + copies(chosen)


def adc(primitives, pull, normals, gradient, split_scale, faint, cap, low, high):
    """Adaptive density control: [(primitive, row of its parent, new?)]; six normal numbers for each primitive."""
    stay, clones, parts = [], [], []
    for i, p in enumerate(primitives):
        half = replace(p, density=p.density / 2)
        if len(primitives) >= cap or mpf(float(pull[i])) < gradient:
            stay.append((p, i, False))
        elif max(p.scale) <= split_scale:
            stay.append((half, i, False))
            clones.append((half, i, True))
        else:
            r = rotation(p.quaternion)
            for z in (normals[i][:3], normals[i][3:]):
                body = [s * mpf(float(c)) for s, c in zip(p.scale, z)]
                mean = tuple(p.mean[k] + dot(r[k], body) for k in range(3))
                parts.append((replace(half, mean=mean, scale=tuple(s / mpf("1.6") for s in p.scale)), i, True))

    def inside(p):
        return all(mpf(a) <= c <= mpf(b) for a, c, b in zip(low, p.mean, high))

    return [row for row in stay + clones + parts if row[0].density >= faint and inside(row[0])]


# ---------------------------------------------------------------------------- criterion of density control

class Moved(CameraFrame):
    """A primitive whose footprint is shifted on the detector, with everything else constant."""

    def __init__(self, p, scanner, view, push):
        super().__init__(p, scanner, view)
        self.push = push

    def value(self, row, column, exact):
        alpha, beta = self.offsets(row, column)
        kappa = mpf(0) if self.parallel or not exact else 1 / self.m[2]
        d = [self.d0[0] + kappa * alpha, self.d0[1] + kappa * beta, mpf(1)]
        depth = mpf(1) if self.parallel else self.m[2] / mpf(self.scanner.dsd)
        half_v, half_u = (mpf(side) / 2 for side in self.scanner.s_detector)
        alpha, beta = alpha - self.push[0] * half_u * depth, beta - self.push[1] * half_v * depth
        q, l = self.quadratic_and_linear(alpha, beta)
        a = self.a0 + 2 * kappa * l + kappa**2 * q
        return self.amplitude_and_fall(mp.sqrt(dot(d, d)), a, (self.a0 / a) * (q - l * l / self.a0))


def shadow_gradient(p, scanner, view, cotangent, axis, exact):
    """Slope of sum(cotangent * image of p) for a shift along u (axis 0) or v (axis 1), in halves of the detector."""
    if left_out(p, scanner, view):
        return mpf(0)

    def total(h):
        moved = Moved(p, scanner, view, (h, mpf(0)) if axis == 0 else (mpf(0), h))
        rows, columns = scanner.n_detector
        return sum(mpf(float(cotangent[r, c])) * moved.value(r, c, exact) for r in range(rows) for c in range(columns))

    return (total(STEP) - total(-STEP)) / (2 * STEP)
