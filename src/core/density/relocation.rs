//! Densities and scales of N copies of a primitive at its position, such that their sum equals the original.

use crate::primitives::{KernelKind, student_t};
use serde::{Deserialize, Serialize};

/// Largest number of copies in the formulas of 3D Student Splatting, whose alternating sums lose digits.
const MOST: usize = 51;
/// Largest density that counts as an opacity.
const OPAQUE: f64 = 1.0 - 1e-6;

/// The rule by which copies share density.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Relocation {
    /// Each has ρ/N and the same shape: X-ray densities add up, so field and projections stay as they are.
    Exact,
    /// 3D Student Splatting's rule for opacities that occlude each other: `1-(1-ρ)^(1/N)`, scales times c.
    Sss,
    /// The same as in its published program: scales times c².
    SssProgram,
}

impl Relocation {
    /// Density of each of `n` copies of a primitive of density ρ, and the factor on its scales.
    ///
    /// | | density | factor |
    /// |---|---|---|
    /// | exact | ρ/n | 1 |
    /// | SSS | `o = 1-(1-ρ)^(1/n)` | `c = ρ·a/D`, `D = Σⱼ C(n,j)(-1)^(j-1) oʲ·B(½, (j(ν+3)-1)/2)`, a the B of j = 1 |
    ///
    /// For opacities, ρ is clamped to `1-10⁻⁶` and n to 51. Not in the paper: it follows 3D Student
    /// Splatting's adding and recycling. Tests: `copies_add_up_to_the_original`,
    /// `the_opacity_rule_keeps_the_integral_of_what_shows_along_a_line`.
    pub fn share(self, kernel: KernelKind, density: f64, nu: f64, n: usize) -> (f64, f64) {
        match self {
            _ if n == 1 => (density, 1.0),
            Self::Exact => (density / n as f64, 1.0),
            Self::Sss => opacity_rule(kernel, density, nu, n),
            Self::SssProgram => {
                let (density, factor) = opacity_rule(kernel, density, nu, n);
                (density, factor * factor)
            }
        }
    }
}

fn opacity_rule(kernel: KernelKind, density: f64, nu: f64, n: usize) -> (f64, f64) {
    let (o, n) = (density.min(OPAQUE), n.min(MOST));
    let each = -libm::expm1(libm::log1p(-o) / n as f64);
    // B(½, (j(ν+3)-1)/2) up to a factor common to all j; for the Gaussian its limit.
    let line = |j: usize| match kernel {
        KernelKind::Gaussian => 1.0 / (j as f64).sqrt(),
        KernelKind::StudentT => {
            let nu = j as f64 * (nu + 3.0) - 3.0;
            student_t::line_integral(nu).0 / nu.sqrt()
        }
    };
    // C(n,j)·(-1)^(j-1)·oʲ by recurrence.
    let (mut term, mut total) = (-1.0, 0.0);
    for j in 1..=n {
        term *= -each * (n - j + 1) as f64 / j as f64;
        total += term * line(j);
    }
    (each, o * line(1) / total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;

    #[test]
    fn copies_add_up_to_the_original() {
        for n in 1..200 {
            let (density, factor) = Relocation::Exact.share(KernelKind::StudentT, 0.7, 5.0, n);
            within!(relative(density * n as f64, 0.7));
            assert_eq!(factor, 1.0);
        }
    }

    #[test]
    fn one_copy_is_the_original_under_every_rule() {
        for rule in [Relocation::Exact, Relocation::Sss, Relocation::SssProgram] {
            assert_eq!(rule.share(KernelKind::StudentT, 0.7, 5.0, 1), (0.7, 1.0));
        }
    }

    /// ∫ 1-(1-o·T(x/s))ⁿ dx by the trapezoidal rule after x = sinh t, which converges geometrically.
    fn shown(kernel: KernelKind, o: f64, s: f64, nu: f64, n: usize) -> f64 {
        let h = 1.0 / 512.0;
        let value = |k: i32| {
            let t = f64::from(k) * h;
            let x = libm::sinh(t) / s;
            let kernel = match kernel {
                KernelKind::Gaussian => libm::exp(-x * x / 2.0),
                KernelKind::StudentT => libm::exp(-(nu + 3.0) / 2.0 * libm::log1p(x * x / nu)),
            };
            -libm::expm1(n as f64 * libm::log1p(-o * kernel)) * libm::cosh(t)
        };
        (-8192..=8192).map(value).sum::<f64>() * h
    }

    #[test]
    fn the_opacity_rule_keeps_the_integral_of_what_shows_along_a_line() {
        for kernel in [KernelKind::StudentT, KernelKind::Gaussian] {
            for (o, nu, n) in [(0.8, 10.0, 2), (0.9, 3.0, 5), (0.3, 2.0, 17), (0.05, 40.0, 51)] {
                let (each, factor) = Relocation::Sss.share(kernel, o, nu, n);
                let (before, after) = (shown(kernel, o, 1.0, nu, 1), shown(kernel, each, factor, nu, n));
                within!(relative(after, before));
                let (same, squared) = Relocation::SssProgram.share(kernel, o, nu, n);
                assert_eq!((same, squared), (each, factor * factor));
            }
        }
    }

    #[test]
    fn the_published_program_loses_a_tenth() {
        let (o, nu, n) = (0.8, 10.0, 2);
        let (each, factor) = Relocation::SssProgram.share(KernelKind::StudentT, o, nu, n);
        let lost = 1.0 - shown(KernelKind::StudentT, each, factor, nu, n) / shown(KernelKind::StudentT, o, 1.0, nu, 1);
        within!((lost - 0.11).abs(), "{lost}");
    }

    #[test]
    fn absurd_densities_and_numbers_of_copies_have_finite_shares() {
        for (density, nu, n) in [(5.0, 2.0, 51), (1.0, 100.0, 1000), (1e-12, 2.0, 3), (0.999_999, 3.0, 51)] {
            let (each, factor) = Relocation::Sss.share(KernelKind::StudentT, density, nu, n);
            assert!(each > 0.0 && each < 1.0 && factor > 0.0 && factor.is_finite(), "{density} {n}: {each} {factor}");
        }
    }
}
