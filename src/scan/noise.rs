//! Photon and electronic noise of a detector.
//!
//! Not in the paper: it gives the levels and says that projections were made with TIGRE. This is TIGRE's model
//! (`CTnoise`). With p_max the largest line integral of the whole stack, a pixel's expected count is `I =
//! I0·exp(-p/p_max)`, its reading `Ĩ = Poisson(I) + N(0, σ²)` and the noisy line integral `p̃ = -ln(Ĩ/I0)·p_max`.
//! Because p is divided by p_max, the darkest pixel always expects I0/e photons, whatever the object's real
//! attenuation. The Beer-Lambert law is the same model with p_max = 1: then `I = I0·exp(-p)`.
//!
//! Two rules of this project, where TIGRE yields NaN or is silent: a reading below [`FLOOR`] counts is set to
//! [`FLOOR`], and negative line integrals become 0, as in R²-Gaussian's data.

use rand_distr::{Distribution, Poisson, StandardNormal};
use std::fmt;
use std::str::FromStr;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::Projections;
use trgs_core::numeric::elementary::{exp, log};
use trgs_core::numeric::rng::{Purpose, stream};
use trgs_core::numeric::threads;

/// Smallest reading before the logarithm, in counts.
pub const FLOOR: f64 = 0.5;

/// Noise of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noise {
    /// No noise: line integrals are unchanged.
    None,
    /// Poisson counts and electronic noise.
    Counts {
        /// Photons per pixel without an object, I0.
        photons: f64,
        /// Standard deviation of the electronic noise, counts.
        sigma: f64,
        /// How the object attenuates photons.
        attenuation: Attenuation,
    },
}

/// The multiple of a line integral that attenuates photons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attenuation {
    /// The line integral divided by the largest one of the stack, as in TIGRE.
    Relative,
    /// The line integral itself: the Beer-Lambert law.
    Physical,
}

impl Noise {
    /// 10⁵ photons, σ = 10 counts.
    pub const LOW: Self = Self::relative(1e5, 10.0);
    /// 5·10⁴ photons, σ = 20 counts.
    pub const MEDIUM: Self = Self::relative(5e4, 20.0);
    /// 10⁴ photons, σ = 40 counts.
    pub const HIGH: Self = Self::relative(1e4, 40.0);
    /// The named levels.
    pub const NAMED: [(&str, Self); 4] =
        [("none", Self::None), ("low", Self::LOW), ("medium", Self::MEDIUM), ("high", Self::HIGH)];

    /// TIGRE's noise with `photons` per pixel and electronic noise `sigma` in counts.
    pub const fn relative(photons: f64, sigma: f64) -> Self {
        Self::Counts { photons, sigma, attenuation: Attenuation::Relative }
    }

    /// The same level with photons attenuated by the Beer-Lambert law.
    #[must_use]
    pub fn physical(self) -> Self {
        match self {
            Self::None => self,
            Self::Counts { photons, sigma, .. } => Self::Counts { photons, sigma, attenuation: Attenuation::Physical },
        }
    }

    /// Adds noise. A pixel's random numbers depend only on `seed`, its view and its position.
    ///
    /// # Errors
    /// When the expected count of a pixel is not in (0, 10¹⁸], as for very negative line integrals.
    ///
    /// Tests: mean and variance against theory; independence of order and threads.
    pub fn apply(&self, projections: &Projections, seed: u64) -> Result<Projections> {
        let Self::Counts { photons, sigma, attenuation } = *self else { return Ok(projections.clone()) };
        let peak = match attenuation {
            Attenuation::Relative => {
                f64::from(projections.images.iter().fold(0.0_f32, |peak, &p| if p > peak { p } else { peak }))
            }
            Attenuation::Physical => 1.0,
        };
        if peak == 0.0 {
            return Ok(projections.clone());
        }
        let mut noisy = projections.clone();
        let pixels = noisy.images.len() / noisy.len();
        let lowest = f64::from(noisy.images.iter().fold(f32::INFINITY, |low, &p| if p < low { p } else { low }));
        let brightest = photons * exp(-lowest / peak);
        if !(photons > 0.0 && sigma >= 0.0 && brightest <= 1e18) {
            return Err(Error::invalid(
                "noise",
                format!("{photons} photons, σ = {sigma}, up to {brightest} expected in a pixel"),
                "between 0 and 1e18 photons in every pixel, σ not negative",
                "lower the number of photons, give σ ≥ 0, or check the projections for strongly negative values",
            ));
        }
        let images = noisy.images.as_slice_mut().expect("projections are stored in C order");
        threads::for_each_chunk(images, pixels, |view, image| {
            for (pixel, p) in image.iter_mut().enumerate() {
                let mut draws = stream(seed, Purpose::Noise, view as u64, pixel as u64);
                let expected = photons * exp(-f64::from(*p) / peak);
                let counts: f64 = Poisson::new(expected).expect("the count was checked").sample(&mut draws);
                let normal: f64 = StandardNormal.sample(&mut draws);
                *p = noisy_line_integral(photons, sigma, peak, counts, normal) as f32;
            }
        });
        Ok(noisy)
    }
}

/// The noisy line integral of a pixel, given its random numbers.
///
/// ```text
/// p̃ = max(0, -ln(max(counts + sigma·normal, FLOOR)/photons)·peak)
/// ```
///
/// `photons` I0 > 0 and `sigma` ≥ 0 in counts; `peak` is the largest line integral of the stack or 1; `counts` is the
/// Poisson draw and `normal` a standard normal draw. The result has the unit of `peak`: attenuation times scene units.
///
/// Not in the paper: see the head of this page. Tests: `a_reading_is_turned_back_into_a_line_integral`.
pub fn noisy_line_integral(photons: f64, sigma: f64, peak: f64, counts: f64, normal: f64) -> f64 {
    let reading = counts + sigma * normal;
    let line_integral = -log(reading.max(FLOOR) / photons) * peak;
    line_integral.max(0.0)
}

impl fmt::Display for Noise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (Self::NAMED.iter().find(|(_, noise)| noise == self), self) {
            (Some((name, _)), _) => f.write_str(name),
            (None, Self::Counts { photons, sigma, attenuation }) => {
                let law = if *attenuation == Attenuation::Physical { ",physical" } else { "" };
                write!(f, "{photons},{sigma}{law}")
            }
            (None, Self::None) => f.write_str("none"),
        }
    }
}

impl FromStr for Noise {
    type Err = Error;

    /// Parses a name or the two numbers `I0,SIGMA`; `,physical` after them selects the Beer-Lambert law.
    fn from_str(text: &str) -> Result<Self> {
        if let Some(level) = text.strip_suffix(",physical") {
            return level.parse().map(Self::physical);
        }
        if let Some((_, noise)) = Self::NAMED.iter().find(|(name, _)| *name == text) {
            return Ok(*noise);
        }
        let numbers = text.split_once(',').and_then(|(photons, sigma)| {
            Some((photons.trim().parse::<f64>().ok()?, sigma.trim().parse::<f64>().ok()?))
        });
        match numbers {
            Some((photons, sigma)) if photons > 0.0 && photons <= 1e18 && (0.0..1e18).contains(&sigma) => {
                Ok(Self::relative(photons, sigma))
            }
            _ => Err(Error::invalid(
                "noise",
                text,
                "none, low, medium, high or I0,SIGMA with I0 > 0 photons and SIGMA ≥ 0 counts",
                "for example low or 1e5,10",
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerances::relative;
    use ndarray::Array3;

    /// Three views of many equal pixels, the last view the brightest of the stack.
    fn flat(values: [f32; 3]) -> Projections {
        let images = Array3::from_shape_fn((3, 100, 150), |(view, _, _)| values[view]);
        Projections::new(vec![0.0, 1.0, 2.0], images).unwrap()
    }

    #[test]
    fn a_reading_is_turned_back_into_a_line_integral() {
        let near = |got: f64, expected: f64| within!(relative(got, expected));
        // 960 counts and two σ of 20 make 1000 of 8000: -ln(1/8).
        near(noisy_line_integral(8000.0, 20.0, 0.5, 960.0, 2.0), 1.5 * std::f64::consts::LN_2);
        // The floor, and a reading brighter than without an object.
        near(noisy_line_integral(8000.0, 20.0, 2.0, 3.0, -1.0), 2.0 * log(16_000.0));
        assert_eq!(noisy_line_integral(8000.0, 20.0, 2.0, 8100.0, -1.0), 0.0);
    }

    #[test]
    fn mean_and_variance_are_those_of_the_model() {
        // First order: the variance of the count, I + σ², becomes (I + σ²)/I²·p_max²; the mean moves by half of that
        // over p_max.
        let values = [0.4_f32, 1.3, 2.6];
        for noise in [Noise::HIGH, Noise::relative(2e3, 15.0), Noise::relative(2e4, 15.0).physical()] {
            let Noise::Counts { photons, sigma, attenuation } = noise else { unreachable!() };
            let peak = if attenuation == Attenuation::Relative { f64::from(2.6_f32) } else { 1.0 };
            let noisy = noise.apply(&flat(values), 7).unwrap();
            for (view, value) in values.into_iter().enumerate() {
                let image = noisy.image(view).mapv(f64::from);
                let n = image.len() as f64;
                let (mean, variance) = (image.mean().unwrap(), image.var(1.0));
                let counts = photons * exp(-f64::from(value) / peak);
                let expected_variance = (counts + sigma * sigma) / (counts * counts) * peak * peak;
                let expected_mean = f64::from(value) + expected_variance / (2.0 * peak);
                let standard_error = (expected_variance / n).sqrt();
                within!("mean", (mean - expected_mean).abs() / standard_error, "mean {mean}, expected {expected_mean}");
                within!("variance", (variance / expected_variance - 1.0).abs(), "view {view}");
            }
        }
    }

    #[test]
    fn photons_are_poisson_distributed() {
        use statrs::distribution::{ChiSquared, ContinuousCDF, Discrete, Poisson};
        // Without electronic noise the count follows from the line integral; the floor turns 0 counts into half a
        // count.
        let (photons, values) = (20.0, [0.4_f32, 1.3, 2.6]);
        let noisy = Noise::relative(photons, 0.0).physical().apply(&flat(values), 11).unwrap();
        for (view, value) in values.into_iter().enumerate() {
            let expected = photons * exp(-f64::from(value));
            let model = Poisson::new(expected).unwrap();
            // Counts of 20 and more give the same value, as line integrals are not negative.
            let mut found = [0.0; 20];
            let mut total = 0.0;
            for &p in noisy.image(view) {
                let count = photons * exp(-f64::from(p));
                if count < 19.5 {
                    found[if count < 0.75 { 0 } else { count.round() as usize }] += 1.0;
                }
                total += 1.0;
            }
            let cells: Vec<(f64, f64)> = (0..20).map(|k| (found[k], total * model.pmf(k as u64))).collect();
            let usable: Vec<_> = cells.into_iter().filter(|(_, expected)| *expected > 10.0).collect();
            let statistic: f64 =
                usable.iter().map(|(found, expected)| (found - expected) * (found - expected) / expected).sum();
            let limit = ChiSquared::new(usable.len() as f64).unwrap().inverse_cdf(0.999);
            assert!(usable.len() > 7 && statistic < limit, "view {view}: {statistic}, limit {limit}");
        }
    }

    #[test]
    fn a_pixel_has_the_same_draws_in_any_company_and_with_any_number_of_threads() {
        let all = Noise::LOW.apply(&flat([1.0, 2.0, 3.0]), 5).unwrap();
        let one_thread = threads::install(1, || Noise::LOW.apply(&flat([1.0, 2.0, 3.0]), 5).unwrap()).unwrap();
        assert_eq!(all, one_thread);
        let mut other = flat([1.0, 2.5, 3.0]);
        other
            .images
            .indexed_iter_mut()
            .filter(|((view, row, _), _)| *view == 0 && *row >= 50)
            .for_each(|(_, p)| *p = 0.1);
        let other = Noise::LOW.apply(&other, 5).unwrap();
        for ((view, row, column), p) in all.images.indexed_iter() {
            assert!(view == 1 || (view == 0 && row >= 50) || *p == other.images[[view, row, column]]);
        }
        assert_ne!(all.image(2), Noise::LOW.apply(&flat([1.0, 2.0, 3.0]), 6).unwrap().image(2));
    }

    #[test]
    fn readings_without_photons_stay_finite_and_results_stay_positive() {
        let noisy = Noise::relative(3.0, 5.0).apply(&flat([0.0, 0.5, 4.0]), 1).unwrap();
        let largest = (-log(FLOOR / 3.0) * 4.0) as f32;
        assert!(noisy.images.iter().all(|&p| (0.0..=largest).contains(&p)));
        assert!(noisy.images.iter().any(|&p| p == largest) && noisy.images.iter().any(|&p| p == 0.0));
    }

    #[test]
    fn nothing_is_added_to_empty_projections_or_without_noise() {
        let empty = flat([0.0; 3]);
        assert_eq!(Noise::HIGH.apply(&empty, 0).unwrap(), empty);
        let some = flat([0.1, -0.2, 0.3]);
        assert_eq!(Noise::None.apply(&some, 0).unwrap(), some);
    }

    #[test]
    fn names_and_pairs_of_numbers_are_understood() {
        for (name, noise) in Noise::NAMED {
            assert_eq!(name.parse::<Noise>().unwrap(), noise);
            assert_eq!(noise.to_string(), name);
        }
        let custom: Noise = "1e5, 2.5".parse().unwrap();
        assert_eq!(custom, Noise::relative(1e5, 2.5));
        assert_eq!(custom.to_string().parse::<Noise>().unwrap(), custom);
        let physical: Noise = "low,physical".parse().unwrap();
        assert_eq!(physical, Noise::LOW.physical());
        assert_eq!(physical.to_string().parse::<Noise>().unwrap(), physical);
        assert_eq!("100000,10".parse::<Noise>().unwrap().to_string(), "low");
        for bad in ["", "loud", "1e5", "-1,10", "0,1", "1e5,-1", "nan,1", "1,inf"] {
            assert!(bad.parse::<Noise>().unwrap_err().to_string().contains("I0,SIGMA"), "{bad}");
        }
        assert!(Noise::LOW.apply(&flat([1e-3, -1.0, 0.0]), 0).is_err());
    }
}
