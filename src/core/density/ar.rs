//! Adding and recycling.
//!
//! Primitives of vanishing density are replaced by copies of others, and a few copies are added. The originals are drawn
//! with a probability proportional to density.

use super::{NextPrimitive, Relocation};
use crate::primitives::{KernelKind, Parameters, Primitives};

/// Thresholds and fractions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Density below which a primitive is dead.
    pub dead: f64,
    /// Largest fraction of all that is recycled in one step.
    pub recycled: f64,
    /// Fraction by which the population grows in one step.
    pub growth: f64,
    /// Growth stops at this number of primitives.
    pub cap: usize,
    /// How copies share the density of their parent.
    pub relocation: Relocation,
}

/// One step of `[AR]`: the next population.
///
/// `uniform` returns independent numbers in [0, 1): one per recycled primitive, then one per added one.
///
/// Dead primitives, the faintest first and at most the fraction `recycled` of all, become copies of living ones. Then
/// `⌊growth·M⌋` copies of any primitive are added, up to the cap. A primitive that was drawn k times shares its density
/// with its copies by `relocation`, N = k+1. Recycled primitives keep their rows, added ones follow; both are fresh. If
/// no primitive is alive, none is recycled; if all densities are 0, none is added.
///
/// With [`Relocation::Exact`] the field changes only by the contributions of the recycled primitives.
/// Not in the paper: it names 3D Student Splatting, whose rule this is. Tests: below, and `tests/contracts/invariance.rs`.
pub fn ar(primitives: &Primitives, settings: &Settings, mut uniform: impl FnMut() -> f64) -> Vec<NextPrimitive> {
    let (p, m) = (&primitives.parameters, primitives.len());
    let mut next: Vec<_> = (0..m).map(|i| NextPrimitive::same(p, i)).collect();

    let dead = faintest(&p.density, settings.dead, (settings.recycled * m as f64) as usize);
    let alive = |i: usize| if p.density[i] >= settings.dead { p.density[i] } else { 0.0 };
    let parents = draw((0..m).map(alive), dead.len(), &mut uniform);
    let copies = share(&mut next, &parents, settings.relocation, primitives.kernel, p);
    for (row, copy) in dead.into_iter().zip(copies) {
        next[row] = copy;
    }

    let added = ((settings.growth * m as f64) as usize).min(settings.cap.saturating_sub(m));
    let parents = draw(next.iter().map(|s| s.density), added, &mut uniform);
    let copies = share(&mut next, &parents, settings.relocation, primitives.kernel, p);
    next.extend(copies);
    next
}

/// Up to `most` rows with a density below `dead`, the faintest first, equal ones by row.
fn faintest(density: &[f64], dead: f64, most: usize) -> Vec<usize> {
    let mut rows: Vec<usize> = (0..density.len()).filter(|&i| density[i] < dead).collect();
    rows.sort_by(|&i, &j| density[i].total_cmp(&density[j]).then(i.cmp(&j)));
    rows.truncate(most);
    rows
}

/// `n` rows, drawn with replacement with a probability proportional to weight; none if all weights are 0.
fn draw(weights: impl Iterator<Item = f64>, n: usize, uniform: &mut impl FnMut() -> f64) -> Vec<usize> {
    let mut total = 0.0;
    let upto: Vec<f64> = weights
        .map(|weight| {
            total += weight.max(0.0);
            total
        })
        .collect();
    let n = if total > 0.0 { n } else { 0 };
    (0..n)
        .map(|_| {
            let target = uniform() * total;
            // Rounding can lead beyond the last row that has a weight.
            upto.partition_point(|&sum| sum <= target).min(upto.partition_point(|&sum| sum < total))
        })
        .collect()
}

/// Sets the density of every parent and returns the copies, one for each entry of `parents`.
fn share(
    next: &mut [NextPrimitive],
    parents: &[usize],
    relocation: Relocation,
    kernel: KernelKind,
    old: &Parameters,
) -> Vec<NextPrimitive> {
    let mut drawn = vec![0; next.len()];
    parents.iter().for_each(|&parent| drawn[parent] += 1);
    for (primitive, k) in next.iter_mut().zip(drawn).filter(|(_, k)| *k > 0) {
        let nu = old.nu[primitive.parent];
        let (density, factor) = relocation.share(kernel, primitive.density, nu, k + 1);
        *primitive = NextPrimitive { density, scale: primitive.scale.map(|s| s * factor), ..*primitive };
    }
    parents.iter().map(|&parent| NextPrimitive { fresh: true, ..next[parent] }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: Settings =
        Settings { dead: 0.005, recycled: 0.5, growth: 0.0, cap: 100, relocation: Relocation::Exact };

    fn primitives(density: &[f64]) -> Primitives {
        let m = density.len();
        Primitives::new(Parameters {
            mean: (0..m).map(|i| [i as f64 / 10.0, 0.0, -0.1]).collect(),
            scale: (0..m).map(|i| [0.1, 0.2, 0.1 + i as f64 / 100.0]).collect(),
            quaternion: vec![[1.0, 0.0, 0.5, 0.0]; m],
            density: density.to_vec(),
            nu: (0..m).map(|i| 3.0 + i as f64).collect(),
        })
        .unwrap()
    }

    fn step(density: &[f64], settings: &Settings, draws: &[f64]) -> Vec<NextPrimitive> {
        let mut draws = draws.iter();
        let next = ar(&primitives(density), settings, || *draws.next().expect("no more draws than copies"));
        assert_eq!(draws.next(), None, "as many draws as copies");
        next
    }

    #[test]
    fn the_dead_become_copies_of_the_living_and_share_their_density() {
        // Weights 0, 0.5, 0, 0.3, 0.2: 0.3 → row 1, 0.4 → row 1.
        let next = step(&[0.004, 0.5, 0.0, 0.3, 0.2], &SETTINGS, &[0.3, 0.4]);
        let third = 0.5 / 3.0;
        let got: Vec<_> = next.iter().map(|s| (s.parent, s.density, s.fresh)).collect();
        let expected = [(1, third, true), (1, third, false), (1, third, true), (3, 0.3, false), (4, 0.2, false)];
        assert_eq!(got, expected);
        assert_eq!((next[0].mean, next[0].scale), (next[1].mean, next[1].scale));
    }

    #[test]
    fn at_most_the_given_fraction_is_recycled_and_the_faintest_first() {
        let settings = Settings { recycled: 0.34, ..SETTINGS };
        let next = step(&[0.003, 0.001, 0.002, 0.9, 0.004, 0.001], &settings, &[0.5, 0.5]);
        let moved: Vec<usize> = (0..6).filter(|&i| next[i].fresh).collect();
        assert_eq!(moved, [1, 5]);
    }

    #[test]
    fn the_population_grows_up_to_its_cap() {
        let settings = Settings { growth: 0.5, cap: 5, ..SETTINGS };
        let next = step(&[0.1, 0.2, 0.3, 0.4], &settings, &[0.05]);
        assert_eq!((next.len(), next[4].parent, next[4].density, next[0].density), (5, 0, 0.05, 0.05));
        assert!(next[4].fresh && !next[0].fresh);
        assert_eq!(step(&[0.1; 8], &settings, &[]).len(), 8);
    }

    #[test]
    fn the_ends_of_the_draw_fall_on_rows_with_a_weight() {
        for (draw, parent) in [(0.0, 1), (0.499, 1), (0.5, 2), (1.0 - 1e-16, 2)] {
            let settings = Settings { growth: 0.25, ..SETTINGS };
            assert_eq!(step(&[0.0, 0.3, 0.3, 0.0], &Settings { recycled: 0.0, ..settings }, &[draw])[4].parent, parent);
        }
    }

    #[test]
    fn where_nothing_lives_nothing_moves() {
        let dead = [0.001, 0.002, 0.0];
        let settings = Settings { growth: 0.4, ..SETTINGS };
        assert_eq!(step(&dead, &Settings { growth: 0.0, ..settings }, &[]).iter().filter(|s| s.fresh).count(), 0);
        assert_eq!(step(&[0.0; 3], &settings, &[]).len(), 3);
    }

    #[test]
    fn the_rule_for_opacities_changes_scales_too() {
        let settings = Settings { growth: 0.25, relocation: Relocation::Sss, ..SETTINGS };
        let next = step(&[0.4; 4], &settings, &[0.6]);
        let (density, factor) = Relocation::Sss.share(KernelKind::StudentT, 0.4, 5.0, 2);
        for copy in [next[2], next[4]] {
            let before = primitives(&[0.4; 4]).parameters.scale[2];
            assert_eq!((copy.density, copy.scale), (density, before.map(|s| s * factor)));
        }
    }
}
