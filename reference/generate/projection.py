"""Projections of one primitive: line integrals by quadrature, and the formulas that they are compared with."""

from mpmath import mp, mpf

from scene import apply, combine, dot, kernel, rotation

# Quadrature must report a relative error below this; images are rounded to float64 afterwards.
QUADRATURE_ERROR = mpf(10)**-34


def line(p, whiten, point, direction):
    """M (x(t) - mean) = y + t z along the line x(t) = point + t direction, and its closest t."""
    y = apply(whiten, combine((1, point), (-1, p.mean)))
    z = apply(whiten, direction)
    return y, z, -dot(y, z) / dot(z, z)


def line_integral(p, whiten, point, direction):
    """[X1] Integral of density * T(x(t)) dt over the whole line, by tanh-sinh quadrature.

    Only a change of variable depends on the kernel: with t0 the closest point and a width h,
    t = t0 + h tan(theta) maps the line to (-pi/2, pi/2) and turns the Student-t kernel into a power
    of cos(theta). For large nu, and for the Gaussian with t = t0 + h x, the interval is cut where the
    integrand is below 1e-60 of its peak. The integrand is divided by its peak, because the tolerance
    of mp.quad is absolute.
    """
    y, z, t0 = line(p, whiten, point, direction)

    def delta(t):
        a, b, c = y[0] + t * z[0], y[1] + t * z[1], y[2] + t * z[2]
        return a * a + b * b + c * c

    nearest = delta(t0)
    peak = kernel(nearest, p.nu)
    if p.gaussian:
        h, end = 1 / mp.sqrt(dot(z, z)), mpf(17)
        integrand = lambda x: kernel(delta(t0 + h * x), p.nu) / peak
    else:
        h = mp.sqrt((p.nu + nearest) / dot(z, z))
        end = mp.pi / 2 if p.nu <= 20 else mp.acos(mp.power(10, -60 / (p.nu + 1)))

        def integrand(theta):
            c = mp.cos(theta)
            return kernel(delta(t0 + h * mp.sin(theta) / c), p.nu) / (peak * c * c)

    value, error = mp.quad(integrand, [-end, 0, end], error=True)
    assert error <= QUADRATURE_ERROR * value, f"quadrature stopped at relative error {mp.nstr(error / value, 3)}"
    return p.density * peak * h * value


def closed_form(p, whiten, point, direction, ratio):
    """The same integral in closed form, in world coordinates; `ratio` is gamma_ratio(nu).

    delta along the line is dmin + |z|^2 (t - t0)^2. Used for gradients, and only after it has been
    compared with `line_integral` on the same scene.
    """
    y, z, _ = line(p, whiten, point, direction)
    zz, yz = dot(z, z), dot(y, z)
    dmin = dot(y, y) - yz * yz / zz
    if p.gaussian:
        return p.density * mp.sqrt(2 * mp.pi / zz) * mp.exp(-dmin / 2)
    return p.density * ratio * mp.sqrt(p.nu * mp.pi / zz) * mp.power(1 + dmin / p.nu, -(p.nu + 2) / 2)


def integral_factor(nu):
    """[Eq. 5] [A] sqrt(nu pi) Gamma((nu+2)/2)/Gamma((nu+3)/2): the integral of T along a line of unit P through the centre."""
    return mp.sqrt(2 * mp.pi) if mp.isinf(nu) else mp.sqrt(nu * mp.pi) * gamma_ratio(nu)


def integral_factor_slope(nu):
    """[A] Its derivative: a central difference, compared with the digamma functions."""
    h = mpf(10)**-17
    slope = (integral_factor(nu + h) - integral_factor(nu - h)) / (2 * h)
    other = integral_factor(nu) / 2 * (1 / nu + mp.digamma((nu + 2) / 2) - mp.digamma((nu + 3) / 2))
    assert abs(slope / other - 1) < mpf(10)**-18, f"d/dnu at {mp.nstr(nu, 5)}: {mp.nstr(slope / other - 1, 3)}"
    return slope


def gamma_ratio(nu):
    """Gamma((nu+2)/2) / Gamma((nu+3)/2) [Eq. 5]"""
    return mpf(1) if mp.isinf(nu) else mp.gamma((nu + 2) / 2) / mp.gamma((nu + 3) / 2)


class CameraFrame:
    """[Eq. 4] One primitive in the frame (u, v, w) of one view: all values independent of the pixel."""

    def __init__(self, p, scanner, view):
        self.p, self.scanner = p, scanner
        self.parallel = scanner.mode == "parallel"
        self.m = view.camera(combine((1, p.mean), (-1, view.source)))
        r = rotation(p.quaternion)
        axes = [view.camera([r[k][i] for k in range(3)]) for i in range(3)]
        self.precision = [[sum(axes[i][j] * axes[i][k] / p.scale[i]**2 for i in range(3)) for k in range(3)]
                          for j in range(3)]
        zero, one = mpf(0), mpf(1)
        self.d0 = [zero, zero, one] if self.parallel else [self.m[0] / self.m[2], self.m[1] / self.m[2], one]
        self.g = apply(self.precision, self.d0)
        self.a0 = dot(self.d0, self.g)
        self.ratio = gamma_ratio(p.nu)

    def offsets(self, row, column):
        """(alpha, beta): the ray's offset from the centre in the plane through the centre."""
        pu, pv = self.scanner.pixel_centre(row, column)
        if self.parallel:
            return pu - self.m[0], pv - self.m[1]
        dsd = mpf(self.scanner.dsd)
        return (pu / dsd - self.d0[0]) * self.m[2], (pv / dsd - self.d0[1]) * self.m[2]

    def quadratic_and_linear(self, alpha, beta):
        """Q and L [Eq. 4]"""
        q = self.precision
        return (q[0][0] * alpha**2 + 2 * q[0][1] * alpha * beta + q[1][1] * beta**2,
                self.g[0] * alpha + self.g[1] * beta)

    def amplitude_and_fall(self, length, a, delta):
        """density * length * sqrt(.../a) * kernel of the detector plane [Eq. 5]"""
        nu = self.p.nu
        if self.p.gaussian:
            return self.p.density * length * mp.sqrt(2 * mp.pi / a) * mp.exp(-delta / 2)
        return self.p.density * length * self.ratio * mp.sqrt(nu * mp.pi / a) * mp.power(1 + delta / nu, -(nu + 2) / 2)

    def affine(self, row, column):
        """[Eq. 4] [Eq. 5] The footprint of the centre's ray: delta-hat = Q - L^2/A0."""
        q, l = self.quadratic_and_linear(*self.offsets(row, column))
        length = mp.sqrt(dot(self.d0, self.d0))
        return self.amplitude_and_fall(length, self.a0, q - l * l / self.a0)

    def exact(self, row, column):
        """[X1] with A = A0 + 2 kappa L + kappa^2 Q and r = A0/A: a third form of the line integral."""
        alpha, beta = self.offsets(row, column)
        q, l = self.quadratic_and_linear(alpha, beta)
        kappa = mpf(0) if self.parallel else 1 / self.m[2]
        d = [self.d0[0] + kappa * alpha, self.d0[1] + kappa * beta, mpf(1)]
        a = self.a0 + 2 * kappa * l + kappa**2 * q
        return self.amplitude_and_fall(mp.sqrt(dot(d, d)), a, (self.a0 / a) * (q - l * l / self.a0))

    def pixel(self, a, b):
        """The fractional pixel (row, column) with detector coordinates a, b; in a cone beam those over the distance dsd."""
        s, scale = self.scanner, mpf(1) if self.parallel else mpf(self.scanner.dsd)
        rows, columns = s.n_detector
        dv, du = mpf(s.s_detector[0]) / rows, mpf(s.s_detector[1]) / columns
        return ((scale * b - mpf(s.off_detector[1])) / dv - mpf(1) / 2 + mpf(rows) / 2,
                (scale * a - mpf(s.off_detector[0])) / du - mpf(1) / 2 + mpf(columns) / 2)

    def reach(self, row, column, exact):
        """[X2] r delta-hat, which is compared with the cutoff; r = 1 in the affine projection."""
        alpha, beta = self.offsets(row, column)
        q, l = self.quadratic_and_linear(alpha, beta)
        kappa = 1 / self.m[2] if exact and not self.parallel else mpf(0)
        return (q - l * l / self.a0) * self.a0 / (self.a0 + 2 * kappa * l + kappa**2 * q)


def left_out(p, scanner, view):
    """The "near" rule: a centre whose depth from the source is at most dso/100 is left out of a cone beam [choice]."""
    if scanner.mode == "parallel":
        return False
    return view.camera(combine((1, p.mean), (-1, view.source)))[2] <= mpf(scanner.dso) / 100
