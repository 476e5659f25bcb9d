"""Ray confidence and what follows from it, from the definitions [Eq. 6] to [Eq. 10].

A count is well defined in floating point only if no point lies on a border. Distances from the walls of tubes, and
distances of projected centres from the detector's edge, are therefore asserted to exceed MARGIN, which suffices for
single precision.
"""

from mpmath import mp, mpf

import scene

MARGIN = mpf(10)**-6


def clear(value, limit):
    """value <= limit, which must not be close."""
    assert abs(value - limit) > MARGIN, f"{mp.nstr(value, 20)} is too close to {mp.nstr(limit, 20)}"
    return value <= limit


def sphere_point(k, n):
    """Point k of n: a lattice from pole to pole, rotated by the golden section from point to point."""
    z = 1 - mpf(2 * k + 1) / n
    azimuth = 2 * mp.pi * mp.frac(k * (mp.sqrt(5) - 1) / 2)
    radius = mp.sqrt(1 - z * z)
    return [radius * mp.cos(azimuth), radius * mp.sin(azimuth), z]


def seen(scanner, view, centre):
    """Whether the projection of a centre lies within the outline of the detector."""
    x, y, depth = view.camera(scene.combine((mpf(1), centre), (mpf(-1), view.source)))
    if scanner.mode == "cone":
        if depth <= 0:
            return False
        x, y = x * scanner.dsd / depth, y * scanner.dsd / depth
    inside = [abs(at - mpf(offset)) for at, offset in zip((x, y), scanner.off_detector)]
    sides = [mpf(size) / 2 for size in reversed(scanner.s_detector)]
    return all([clear(distance, side) for distance, side in zip(inside, sides)])


def direction(scanner, view, p):
    """From the centre towards the source, in the frame of the principal axes."""
    to_source = [-x for x in view.w]
    if scanner.mode == "cone":
        to_source = scene.combine((mpf(1), view.source), (mpf(-1), p.mean))
    length = mp.sqrt(scene.dot(to_source, to_source))
    r = scene.rotation(p.quaternion)
    return [sum(r[k][axis] * to_source[k] for k in range(3)) / length for axis in range(3)]


def effective_ratio(p, u):
    """[Eq. 6] with alpha the geometric mean of the scales"""
    return mp.cbrt(p.scale[0] * p.scale[1] * p.scale[2]) / mp.sqrt(sum((s * x)**2 for s, x in zip(p.scale, u)))


def radius(ratio, r_max, kappa):
    """[Eq. 7]"""
    return mpf(r_max) * min(ratio / mpf(kappa), 1)


def distance_to_chord(point, u):
    """From a point to the segment between -u and u."""
    along = max(-1, min(1, scene.dot(point, u)))
    off = scene.combine((mpf(1), point), (-along, u))
    return mp.sqrt(scene.dot(off, off))


def confidence(p, scanner, views, sphere_points, r_max, kappa):
    """[Eq. 8] The fraction of the points that at least one ray covers."""
    directions = [direction(scanner, view, p) for view in views if seen(scanner, view, p.mean)]
    tubes = [(u, radius(effective_ratio(p, u), r_max, kappa)) for u in directions]
    points = (sphere_point(k, sphere_points) for k in range(sphere_points))
    # A list, so that every margin is checked.
    reached = sum(any([clear(distance_to_chord(point, u), r) for u, r in tubes]) for point in points)
    return mpf(reached) / sphere_points


def nu_target(c, temperature, nu_range, sphere_points):
    """[Eq. 9] c is first clamped to half a point from 0 and 1."""
    half = mpf(1) / (2 * sphere_points)
    c = max(half, min(1 - half, c))
    low, high = map(mpf, nu_range)
    return low + (high - low) / (1 + mp.exp(-mp.log(c / (1 - c)) / mpf(temperature)))


def nu_loss(target, confidence, weight):
    """[Eq. 10] as a function of nu, with the weight 1 - c."""
    def loss(nu):
        terms = [mpf(weight) * (1 - confidence[i]) * (mp.log(nu[i]) - mp.log(target[i]))**2 for i in nu]
        return mp.fsum(terms) / len(terms)

    return loss
