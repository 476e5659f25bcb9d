"""Filtered backprojection (Feldkamp, Davis, Kress 1984) as sums in the space of the detector, without a transform of the data.

f(x) = 1/2 sum_views dphi (dso/d)^2 (h * [p dsd/sqrt(dsd^2 + u^2 + v^2)])(u, v); parallel: both weights 1, half a turn, no 1/2.
"""

from functools import cached_property

from mpmath import mp, mpf

import scene

WINDOWS = {
    "ram-lak": lambda omega: mpf(1),
    "shepp-logan": lambda omega: mp.sinc(omega / 2),
    "cosine": lambda omega: mp.cos(omega / 2),
    "hamming": lambda omega: mpf(54) / 100 + mpf(46) / 100 * mp.cos(omega),
    "hann": lambda omega: (1 + mp.cos(omega)) / 2,
}


def ramp(n):
    """The ramp filter's samples in space, for pixels of size 1."""
    return mpf(1) / 4 if n == 0 else mpf(0) if n % 2 == 0 else -1 / (mp.pi * n)**2


def padding(columns):
    """Length of the zero-padded rows: the next power of two from twice the columns, at least 64."""
    length = 64
    while length < 2 * columns:
        length *= 2
    return length


def filter_in_space(window, length, reach):
    """g(0) .. g(reach-1): the ramp's samples |n| < length/2, their transform times the window, and back."""
    cosine = [mp.cos(2 * mp.pi * k / length) for k in range(length)]
    samples = [ramp(n) for n in range(length // 2)]
    response = []
    for k in range(length):
        transform = samples[0] + 2 * mp.fsum(samples[n] * cosine[k * n % length] for n in range(1, length // 2))
        response.append(transform * WINDOWS[window](2 * mp.pi * min(k, length - k) / length))
    g = [mp.fsum(response[k] * cosine[k * n % length] for k in range(length)) / length for n in range(reach)]
    if window == "ram-lak":
        assert all(abs(g[n] - ramp(n)) < mpf(10)**-45 for n in range(reach)), "without a window nothing may change"
        return [ramp(n) for n in range(reach)]
    return g


def angular_weights(angles, turn):
    """Half the distance between a view's two neighbours on a circle of circumference `turn`."""
    places = [mpf(angle) - turn * mp.floor(mpf(angle) / turn) for angle in angles]
    order = sorted(range(len(angles)), key=lambda n: places[n])
    weights = [mpf(0)] * len(angles)
    for k, n in enumerate(order):
        following = places[order[k + 1]] if k + 1 < len(order) else places[order[0]] + turn
        before = places[order[k - 1]] if k > 0 else places[order[-1]] - turn
        weights[n] = (following - before) / 2
    return weights


class Fdk:
    def __init__(self, scanner, angles, window, projections):
        self.scanner, self.angles, self.window = scanner, angles, window
        self.projections = projections
        self.parallel = scanner.mode == "parallel"

    @cached_property
    def kernel(self):
        columns = self.scanner.n_detector[1]
        return filter_in_space(self.window, padding(columns), columns)

    @cached_property
    def scales(self):
        """Factor on a view's filtered rows: weight of the view over the pixel's size at the axis."""
        s = self.scanner
        pitch = mpf(s.s_detector[1]) / s.n_detector[1]
        if self.parallel:
            return [weight / pitch for weight in angular_weights(self.angles, mp.pi)]
        pitch_at_axis = pitch * mpf(s.dso) / mpf(s.dsd)
        return [weight / 2 / pitch_at_axis for weight in angular_weights(self.angles, 2 * mp.pi)]

    def weighted(self, view, row, column):
        p = mpf(float(self.projections[view, row, column]))
        if self.parallel:
            return p
        u, v = self.scanner.pixel_centre(row, column)
        dsd = mpf(self.scanner.dsd)
        return p * dsd / mp.sqrt(dsd**2 + u * u + v * v)

    def filtered(self, index):
        view, row, column = index
        return self.scales[view] * mp.fsum(self.kernel[abs(column - c)] * self.weighted(view, row, c)
                                           for c in range(self.scanner.n_detector[1]))


def backprojection(scanner, angles, filtered, voxel):
    """sum_views (dso/d)^2 filtered(u, v): bilinear between pixel centres, with zeros beyond the detector.

    `filtered` is a function of (view, row, column)."""
    x = scanner.voxel_centre(voxel)
    rows, columns = scanner.n_detector
    dv, du = mpf(scanner.s_detector[0]) / rows, mpf(scanner.s_detector[1]) / columns
    total = mpf(0)
    for n, angle in enumerate(angles):
        view = scene.view_at(scanner, angle)
        u, v = scene.dot(view.u, x), scene.dot(view.v, x)
        weight = mpf(1)
        if scanner.mode != "parallel":
            depth = mpf(scanner.dso) + scene.dot(view.w, x)
            u, v, weight = mpf(scanner.dsd) * u / depth, mpf(scanner.dsd) * v / depth, (mpf(scanner.dso) / depth)**2
        row = (v - mpf(scanner.off_detector[1])) / dv - mpf(1) / 2 + mpf(rows) / 2
        column = (u - mpf(scanner.off_detector[0])) / du - mpf(1) / 2 + mpf(columns) / 2
        top, left = int(mp.floor(row)), int(mp.floor(column))
        for r, wr in ((top, 1 - (row - top)), (top + 1, row - top)):
            for c, wc in ((left, 1 - (column - left)), (left + 1, column - left)):
                if 0 <= r < rows and 0 <= c < columns:
                    total += weight * wr * wc * filtered(n, r, c)
    return total
