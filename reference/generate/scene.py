"""Scanner, rays and primitives from their definitions, in 50-digit arithmetic.

Everything here is mpmath numbers in plain lists; inputs are float64 values and are taken exactly.

World: right-handed, z is the rotation axis. A view at angle phi has its source at
DSO (cos phi, sin phi, 0) and three orthonormal axes:

    u = (-sin phi,  cos phi, 0)    along the columns of the detector
    v = (0, 0, -1)                 down its rows
    w = (-cos phi, -sin phi, 0)    from the source to the rotation axis (depth)
"""

from dataclasses import dataclass, replace

from mpmath import mp, mpf

mp.dps = 50


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def combine(*terms):
    """sum of coefficient * vector"""
    return [sum(c * x[k] for c, x in terms) for k in range(3)]


# ---------------------------------------------------------------------------- scanner

@dataclass(frozen=True)
class Scanner:
    """The `scanner` block of meta_data.json (lengths in scene units, float64 values)."""

    mode: str           # "cone" or "parallel"
    dso: float          # source to rotation axis
    dsd: float          # source to detector
    n_detector: tuple   # rows (v), columns (u)
    s_detector: tuple   # total size along v, u
    n_voxel: tuple      # x, y, z
    s_voxel: tuple      # total size along x, y, z
    off_origin: tuple = (0.0, 0.0, 0.0)    # centre of the volume x, y, z
    off_detector: tuple = (0.0, 0.0)       # u, v

    def pixel_centre(self, row, column):
        """(along u, along v) of a pixel's centre on the detector."""
        rows, columns = self.n_detector
        dv, du = mpf(self.s_detector[0]) / rows, mpf(self.s_detector[1]) / columns
        return ((column + mpf(1) / 2 - mpf(columns) / 2) * du + mpf(self.off_detector[0]),
                (row + mpf(1) / 2 - mpf(rows) / 2) * dv + mpf(self.off_detector[1]))

    def voxel_centre(self, index):
        """World coordinates of the centre of voxel [x, y, z]."""
        centre = []
        for i, n, s, off in zip(index, self.n_voxel, self.s_voxel, self.off_origin):
            centre.append(mpf(off) - mpf(s) / 2 + (i + mpf(1) / 2) * mpf(s) / n)
        return centre


@dataclass(frozen=True)
class View:
    source: list
    u: list
    v: list
    w: list

    def camera(self, x):
        """Components of a world vector along u, v, w."""
        return [dot(self.u, x), dot(self.v, x), dot(self.w, x)]


def view_at(scanner, angle):
    c, s = mp.cos(mpf(angle)), mp.sin(mpf(angle))
    dso = mpf(scanner.dso)
    return View(source=[dso * c, dso * s, mpf(0)], u=[-s, c, mpf(0)], v=[mpf(0), mpf(0), mpf(-1)], w=[-c, -s, mpf(0)])


def ray(scanner, view, row, column):
    """A point and the unit direction of the line that a pixel measures.

    Cone: from the source through the pixel's centre on the detector at distance DSD.
    Parallel: along w, through the pixel's centre taken at the scale of the rotation axis.
    """
    pu, pv = scanner.pixel_centre(row, column)
    if scanner.mode == "parallel":
        return combine((mpf(1), view.source), (pu, view.u), (pv, view.v)), view.w
    direction = combine((mpf(scanner.dsd), view.w), (pu, view.u), (pv, view.v))
    length = mp.sqrt(dot(direction, direction))
    return view.source, [x / length for x in direction]


# ---------------------------------------------------------------------------- primitives

@dataclass(frozen=True)
class Primitive:
    """Physical parameters; nu = inf is the Gaussian. The quaternion (w, x, y, z) has any norm."""

    mean: tuple
    scale: tuple
    quaternion: tuple
    density: object
    nu: object

    def moved(self, name, component, step):
        """The primitive with one number changed by `step`."""
        old = getattr(self, name)
        if component is None:
            return replace(self, **{name: old + step})
        new = tuple(x + step if k == component else x for k, x in enumerate(old))
        return replace(self, **{name: new})

    @property
    def gaussian(self):
        return mp.isinf(self.nu)


def primitive(mean, scale, quaternion, density, nu):
    """A primitive from float64 numbers."""
    exact = lambda values: tuple(mpf(x) for x in values)
    return Primitive(exact(mean), exact(scale), exact(quaternion), mpf(density), mpf(nu))


def rotation(quaternion):
    """[Eq. 3] Rotation matrix R of the normalised quaternion (w, x, y, z)."""
    norm = mp.sqrt(sum(x * x for x in quaternion))
    w, x, y, z = (c / norm for c in quaternion)
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]


def whitening(p):
    """M = diag(1/s) R^T, so that delta = |M (x - mean)|^2 with Sigma = R diag(s^2) R^T [Eq. 3]."""
    r = rotation(p.quaternion)
    return [[r[k][i] / p.scale[i] for k in range(3)] for i in range(3)]


def apply(matrix, x):
    return [dot(row, x) for row in matrix]


def kernel(delta, nu):
    """[Eq. 2] T as a function of delta; exp(-delta/2) for nu = inf."""
    if mp.isinf(nu):
        return mp.exp(-delta / 2)
    return mp.power(1 + delta / nu, -(nu + 3) / 2)


def covariance(p):
    """[Eq. 3] Sigma = R diag(s^2) R^T"""
    r = rotation(p.quaternion)
    return [[sum(r[i][k] * r[j][k] * p.scale[k]**2 for k in range(3)) for j in range(3)] for i in range(3)]
