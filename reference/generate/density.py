"""Point samples of the density field at voxel centres."""

from scene import apply, combine, dot, kernel


def sample(p, whiten, x):
    """[Eq. 1] [Eq. 2] density * T(x) of one primitive."""
    y = apply(whiten, combine((1, x), (-1, p.mean)))
    return p.density * kernel(dot(y, y), p.nu)
