"""[X2] The support of a primitive: the cutoff, the bounding box of the projection, and the truncation error.

The box comes from tangent planes and the covariance, not from the conic's coefficients: a plane with normal n through
a point at m from the ellipsoid's centre touches it when (n.m)^2 = cut n'Sigma n. The conic's value at the tangent
point is compared with the cutoff.
"""

from mpmath import mp, mpf

import projection
import scene

INF = mpf("inf")
NEVER, EVERYWHERE = [INF, -INF], [-INF, INF]
TIE = mpf(10)**-4       # relative distance from the cutoff within which an implementation may decide either way


def cut(nu, cutoff):
    """delta_cut: [1 + delta/nu]^(-(nu+2)/2) = cutoff; exp(-delta/2) = cutoff."""
    cutoff = mpf(cutoff)
    return -2 * mp.log(cutoff) if mp.isinf(nu) else nu * (mp.power(cutoff, -2 / (nu + 2)) - 1)


def camera_covariance(p, view):
    """Sigma in the frame (u, v, w) of a view."""
    sigma = scene.covariance(p)
    axes = [view.u, view.v, view.w]
    return [[scene.dot(a, scene.apply(sigma, b)) for b in axes] for a in axes]


def shadow(frame, sigma, axis, limit, exact):
    """Lowest and highest detector coordinate along `axis` (0: u, 1: v) of the lines that meet the ellipsoid.

    Cone: coordinates over the distance dsd. The plane of all rays with u = a has the normal (1, 0, -a).
    """
    m = frame.m
    if frame.parallel:
        half = mp.sqrt(limit * sigma[axis][axis])
        return [m[axis] - half, m[axis] + half]
    if not exact:       # the rays are all parallel to the one through the centre
        a = frame.d0[axis]
        half = mp.sqrt(limit * (sigma[axis][axis] - 2 * a * sigma[axis][2] + a * a * sigma[2][2])) / m[2]
        return [a - half, a + half]
    q2 = m[2]**2 - limit * sigma[2][2]
    q1 = m[axis] * m[2] - limit * sigma[axis][2]
    q0 = m[axis]**2 - limit * sigma[axis][axis]
    root = mp.sqrt(q1 * q1 - q2 * q0)
    return [(q1 - root) / q2, (q1 + root) / q2]


def touching(frame, sigma, axis, a, exact, limit):
    """Where the tangent plane with coordinate `a` touches the ellipsoid: the detector coordinates of that point."""
    n = [mpf(0), mpf(0), mpf(0) if frame.parallel else -a if exact else -frame.d0[axis]]
    n[axis] = mpf(1)
    sn = scene.apply(sigma, n)
    if exact and not frame.parallel:
        side = -scene.dot(n, frame.m) / scene.dot(n, sn)
        x = [frame.m[k] + side * sn[k] for k in range(3)]
        return x[0] / x[2], x[1] / x[2]
    centre = frame.m if frame.parallel else frame.d0
    side = mp.sign(a - centre[axis]) * mp.sqrt(limit / scene.dot(n, sn))
    depth = 1 if frame.parallel else frame.m[2]
    return [centre[k] + side * (sn[k] - frame.d0[k] * sn[2]) / depth for k in (0, 1)]


def box(p, scanner, view, cutoff, exact):
    """row_min, row_max, column_min, column_max in fractional pixel indices, 0.0 at the centre of row or column 0."""
    if projection.left_out(p, scanner, view):
        return NEVER + NEVER
    frame, sigma, limit = projection.CameraFrame(p, scanner, view), camera_covariance(p, view), cut(p.nu, cutoff)
    if exact and not frame.parallel and frame.m[2]**2 <= limit * sigma[2][2]:
        return EVERYWHERE + EVERYWHERE      # the plane of the source meets the ellipsoid: no ellipse
    ends = []
    for axis in (1, 0):
        low, high = shadow(frame, sigma, axis, limit, exact)
        for a in (low, high):
            ends.append(frame.pixel(a, a)[1 - axis])
            reach = frame.reach(*frame.pixel(*touching(frame, sigma, axis, a, exact, limit)), exact)
            assert abs(reach / limit - 1) < mpf(10)**-25, f"edge at {mp.nstr(reach, 20)} not {mp.nstr(limit, 20)}"
    return ends


class Cut:
    """Images and fields of a scene (a Truth) with a cutoff."""

    def __init__(self, truth, cutoff, exact):
        self.truth, self.cutoff, self.exact = truth, mpf(cutoff), exact
        self.limits = [cut(p.nu, cutoff) for p in truth.primitives]

    def place(self, number, pixel):
        """r delta-hat over the cutoff: above 1 the pixel is skipped; None where the primitive is left out of the view."""
        frame = self.truth.frames[number][pixel[0]]
        return None if frame is None else frame.reach(*pixel[1:], self.exact) / self.limits[number]

    def value(self, number, pixel):
        """The closed form, which `image-exact` compares with quadrature."""
        frame = self.truth.frames[number][pixel[0]]
        return frame.exact(*pixel[1:]) if self.exact else frame.affine(*pixel[1:])

    def pixel_sum(self, pixel, what, where):
        """Sum of what(number) over the primitives whose distance satisfies `where`."""
        places = [(number, self.place(number, pixel)) for number in range(len(self.limits))]
        return mp.fsum(what(number) for number, place in places if place is not None and where(place))

    def image(self, pixel):
        return self.pixel_sum(pixel, lambda number: self.value(number, pixel), lambda x: x <= 1)

    def image_allowance(self, pixel):
        return self.pixel_sum(pixel, lambda number: abs(self.value(number, pixel)), near_one)

    def lost(self, number):
        """A bound on a primitive's contribution to a pixel that skips it."""
        p = self.truth.primitives[number]
        return abs(p.density) * projection.integral_factor(p.nu) * max(p.scale) * self.cutoff

    def bound(self, pixel):
        return self.pixel_sum(pixel, self.lost, lambda x: x > 1)

    def bound_allowance(self, pixel):
        return self.pixel_sum(pixel, self.lost, near_one)

    def voxel_sum(self, voxel, where):
        total = mpf(0)
        for (p, whiten, _), limit in zip(self.truth.parts, self.limits):
            y = scene.apply(whiten, scene.combine((1, self.truth.centres[voxel]), (-1, p.mean)))
            delta = scene.dot(y, y)
            if where(delta / limit):
                total += p.density * scene.kernel(delta, p.nu)
        return total

    def volume(self, voxel):
        return self.voxel_sum(voxel, lambda x: x <= 1)

    def volume_allowance(self, voxel):
        return self.voxel_sum(voxel, near_one)


def near_one(x):
    return abs(x - 1) <= TIE
