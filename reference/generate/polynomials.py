"""Constants of the project's own elementary functions, with their error bounds.

Prints Rust-ready tables for log2, exp2 and the inverse root near 1 in f32 and f64, and the exact coefficients of the
asymptotic series of the ratio Gamma(z)/Gamma(z + 1/2) that the line integral of the Student-t
kernel needs [Eq. 5].

A polynomial is fitted in the weighted minimax sense by Lawson's iteration (reweighted least
squares on Chebyshev nodes), then its coefficients are rounded to the target format one by one,
lowest order first, the remaining ones being refitted each time. The printed error is that of the
polynomial with *rounded* coefficients in *exact* arithmetic, without rounding errors of the
evaluation.

Run: python polynomials.py        (about a minute)
"""

from fractions import Fraction
from math import comb, factorial

import numpy as np
from mpmath import mp, mpf

mp.dps = 40


# ---------------------------------------------------------------------------- minimax fitting

def chebyshev_nodes(a, b, n):
    """n Chebyshev points of [a, b], with points close to both ends."""
    return [(a + b) / 2 + (b - a) / 2 * mp.cos(mp.pi * (2 * i + 1) / (2 * n)) for i in range(n)]


def lawson(points, values, weights, powers, iterations=40):
    """Coefficients c_j minimising max |weight (value - sum_j c_j t^powers_j)| over the points."""
    rows = [[w * t**p for p in powers] for t, w in zip(points, weights)]
    right = [w * v for v, w in zip(values, weights)]
    mass = [mpf(1) / len(points)] * len(points)
    best, best_error = None, mp.inf
    n = len(powers)
    for _ in range(iterations):
        normal, rhs = mp.matrix(n, n), mp.matrix(n, 1)
        for row, y, m in zip(rows, right, mass):
            scaled = [m * r for r in row]
            for i in range(n):
                rhs[i] += scaled[i] * y
                for j in range(i, n):
                    normal[i, j] += scaled[i] * row[j]
        for i in range(n):
            for j in range(i):
                normal[i, j] = normal[j, i]
        c = list(mp.lu_solve(normal, rhs))
        errors = [abs(y - mp.fdot(row, c)) for row, y in zip(rows, right)]
        worst = max(errors)
        if worst < best_error:
            best, best_error = c, worst
        mass = [m * e for m, e in zip(mass, errors)]
        total = sum(mass)
        if total == 0:
            break
        mass = [m / total for m in mass]
    return best


def fit_rounded(function, weight, a, b, powers, round_to):
    """Minimax polynomial with coefficients representable in `round_to`; returns (c, error)."""
    points = chebyshev_nodes(a, b, 8 * len(powers) + 9)
    values = [function(t) for t in points]
    weights = [weight(t) for t in points]
    fixed = []
    while len(fixed) < len(powers):
        free = powers[len(fixed):]
        rest = [v - sum(c * t**p for c, p in zip(fixed, powers)) for v, t in zip(values, points)]
        fixed.append(mpf(float(round_to(float(lawson(points, rest, weights, free)[0])))))
    return fixed, maximum_error(function, weight, a, b, powers, fixed)


def maximum_error(function, weight, a, b, powers, c, n=2001):
    """max |weight (function - polynomial)| on a grid that includes both ends."""
    worst = mpf(0)
    for i in range(n):
        t = a + (b - a) * mpf(i) / (n - 1)
        if t == 0:
            continue
        worst = max(worst, abs(weight(t) * (function(t) - sum(x * t**p for x, p in zip(c, powers)))))
    return worst


def show(title, c, error, rust_type):
    print(f"// {title}: max error {mp.nstr(error, 4)}")
    print(f"const C: [{rust_type}; {len(c)}] = [")
    for x in c:
        value = np.float32(float(x)) if rust_type == "f32" else np.float64(float(x))
        bits = int(value.view(np.uint32 if rust_type == "f32" else np.uint64))
        width = 8 if rust_type == "f32" else 16
        text = np.format_float_scientific(value, unique=True, trim="0")
        print(f"    {text},{' ' * (26 - len(text))}// 0x{bits:0{width}x}")
    print("];\n")


# ---------------------------------------------------------------------------- log2 and exp2

def log2_f32():
    print("==== a) f32: log2(1+f) = log2(1/c) + log2(1+r), 1+r = (1+f) c, for a c near 8/(8+i), of which log2(1/c) is nearly an f32")
    inverses, logarithms, worst = [mpf(1)], [mpf(0)], 0.0
    for i in range(1, 16):
        near = int(np.float32(8 / (8 + i)).view(np.uint32))
        candidates = np.arange(near - 2000, near + 2001).astype(np.uint32).view(np.float32)
        # c - 1 must be an f32.
        candidates = candidates[(candidates - np.float32(1)).astype(np.float64) == candidates.astype(np.float64) - 1]
        exact = -np.log2(candidates.astype(np.float64))
        error = np.abs(exact - exact.astype(np.float32))
        best = error.argmin()
        worst = max(worst, error[best])
        inverses.append(mpf(float(candidates[best])))
        logarithms.append(mpf(float(np.float32(exact[best]))))
    show("c", inverses, 0, "f32")
    show("log2(1/c)", logarithms, worst, "f32")
    print("==== log2(1+r) = r P(r), |r| <= 1/16, relative error")
    function = lambda r: mp.log1p(r) / mp.ln2 / r
    for degree in (3, 4, 5):
        c, error = fit_rounded(function, lambda r: 1 / function(r), -mpf(1) / 16, mpf(1) / 16, list(range(degree + 1)), np.float32)
        show(f"degree of P {degree}, low order first", c, error, "f32")


def log2_f64():
    print("==== b) f64: log2(1+f) = s Q(s^2), s = f/(2+f), |s| <= (sqrt2-1)/(sqrt2+1), relative error")
    top = ((mp.sqrt(2) - 1) / (mp.sqrt(2) + 1))**2

    def function(z):
        s = mp.sqrt(z)
        return 2 * mp.atanh(s) / s / mp.ln2

    for terms in (7, 8):
        c, error = fit_rounded(function, lambda z: 1 / function(z), mpf(0), top, list(range(terms)), np.float64)
        show(f"{terms} terms c0 + z c1 + ..., low order first", c, error, "f64")


def exp2(rust_type, top, degrees):
    print(f"==== {'c' if rust_type == 'f32' else 'd'}) {rust_type}: 2^t = 1 + t P(t), |t| <= {top}, relative error of 2^t")
    round_to = np.float32 if rust_type == "f32" else np.float64
    function = lambda t: mp.expm1(t * mp.ln2) / t
    for degree in degrees:
        c, error = fit_rounded(function, lambda t: abs(t) / mp.power(2, t), -top, top, list(range(degree)), round_to)
        show(f"total degree {degree}, P low order first", c, error, rust_type)


# ---------------------------------------------------------------------------- 1/sqrt(1+e)

def inverse_root(rust_type, cases):
    print(f"==== {rust_type}: 1/sqrt(1+e) = 1 + e P(e), |e| <= top, relative error of the root")
    round_to = np.float32 if rust_type == "f32" else np.float64
    function = lambda e: (1 / mp.sqrt(1 + e) - 1) / e
    for top, degree in cases:
        c, error = fit_rounded(function, lambda e: abs(e) * mp.sqrt(1 + e), -top, top, list(range(degree)), round_to)
        show(f"top {top}, total degree {degree}, P low order first", c, error, rust_type)


# ---------------------------------------------------------------------------- Gamma(z)/Gamma(z+1/2)

def bernoulli_numbers(n):
    """B_0 .. B_n as fractions, B_1 = -1/2."""
    numbers = []
    for m in range(n + 1):
        total = sum(comb(m + 1, k) * numbers[k] for k in range(m))
        numbers.append(Fraction(1) if m == 0 else -total / (m + 1))
    return numbers


def ratio_series(n):
    """b_1..b_n with ln G = -1/2 ln w + sum b_k w^(-2k), and a_0..a_n with S = exp(sum b_k x^k).

    G(z) = Gamma(z)/Gamma(z+1/2), w = z - 1/4. From the expansion of ln Gamma(w + a) in Bernoulli
    polynomials at a = 1/4 and a = 3/4: b_k = -2 B_{2k+1}(1/4) / (2k (2k+1)).
    """
    numbers = bernoulli_numbers(2 * n + 1)
    quarter = Fraction(1, 4)
    b = [Fraction(0)]
    for k in range(1, n + 1):
        m = 2 * k + 1
        polynomial = sum(comb(m, j) * numbers[j] * quarter**(m - j) for j in range(m + 1))
        b.append(-2 * polynomial / (2 * k * m))
    a = [Fraction(1)]
    for k in range(1, n + 1):
        a.append(sum(j * b[j] * a[k - j] for j in range(1, k + 1)) / k)
    return a, b


def fraction(q):
    return mpf(q.numerator) / q.denominator


def gamma_ratio():
    print("==== e) G(z) = Gamma(z)/Gamma(z+1/2), w = z - 1/4, x = 1/w^2")
    print("     G = w^(-1/2) sum_k a_k x^k;   ln G = -1/2 ln w + sum_k b_k x^k;")
    print("     psi(z) - psi(z+1/2) = -1/(2w) - 2 sum_k k b_k w^(-2k-1)")
    a, b = ratio_series(12)
    for name, c in (("a", a), ("b", b)):
        for k in range(0 if name == "a" else 1, 13):
            print(f"  {name}_{k:<2} = {float(c[k])!r:<26} = {c[k]}")
    print("\n  relative error of G from the a-series, absolute error of ln G from the b-series, and")
    print("  relative error of psi(z)-psi(z+1/2); the last index kept is n (a_0..a_n, b_1..b_n):")
    for w in (4, 6, 8, 10, 12, 16):
        z = mpf(w) + mpf(1) / 4
        exact = mp.gamma(z) / mp.gamma(z + mpf(1) / 2)
        derivative = mp.digamma(z) - mp.digamma(z + mpf(1) / 2)
        for n in (4, 5, 6, 7, 8, 9):
            x = mpf(1) / w**2
            series = sum(fraction(a[k]) * x**k for k in range(n + 1)) / mp.sqrt(w)
            logarithm = -mp.log(w) / 2 + sum(fraction(b[k]) * x**k for k in range(1, n + 1))
            slope = -mpf(1) / (2 * w) - 2 * sum(k * fraction(b[k]) * mpf(w)**(-2 * k - 1) for k in range(1, n + 1))
            print(f"  w={w:<3} n={n}:  G {mp.nstr(abs(series / exact - 1), 3):>10}   "
                  f"ln G {mp.nstr(abs(logarithm - mp.log(exact)), 3):>10}   "
                  f"psi difference {mp.nstr(abs(slope / derivative - 1), 3):>10}")


if __name__ == "__main__":
    log2_f32()
    log2_f64()
    exact = [mp.power(2, mpf(i) / 8) for i in range(8)]
    rounded = [mpf(float(np.float32(float(x)))) for x in exact]
    show("2^(i/8)", exact, 0, "f32")
    show("what they lack, relative to themselves", [(x - y) / y for x, y in zip(exact, rounded)], 0, "f32")
    exp2("f32", mpf(1) / 16, (2, 3, 4))
    exp2("f64", mpf(1) / 2, (10, 11, 12))
    inverse_root("f32", ((mpf(1) / 16, 4), (mpf(1) / 4, 7)))
    # Initial value of an iteration of third order, whose error becomes 2.5 times its cube.
    inverse_root("f64", ((mpf(1) / 4, 6),))
    gamma_ratio()
