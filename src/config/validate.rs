//! Which values make sense.

use super::Config;
use crate::error::{Error, Result};
use std::fmt::Debug;

/// More primitives than any computer here can hold, so that a slip of the finger is a message and not a crash.
const MOST_POINTS: usize = 10_000_000;

impl Config {
    /// Checks that every number lies in its range.
    ///
    /// # Errors
    /// [`Error::Invalid`] for the first that does not.
    pub fn validate(&self) -> Result<()> {
        let Self { model, initialisation, loss, optimiser, .. } = self;
        require("iterations", self.iterations, self.iterations >= 1, "at least 1")?;
        require("seed", self.seed, i64::try_from(self.seed).is_ok(), "at most 2^63 - 1, the largest integer of TOML")?;
        require("cutoff", self.cutoff, (0.0..1.0).contains(&self.cutoff), "a number in [0, 1)")?;
        require("report_every", self.report_every, self.report_every >= 1, "at least 1")?;

        let points = 4..=MOST_POINTS;
        require("model.points", model.points, points.contains(&model.points), "4 to 10 million")?;
        let (min, start, max) = (model.nu_min, model.nu_initial, model.nu_max);
        require("model.nu_min", min, min > 0.0 && min.is_finite(), "a positive number")?;
        require("model.nu_max", max, max > min && max.is_finite(), &format!("more than model.nu_min = {min}"))?;
        let between = format!("between model.nu_min = {min} and model.nu_max = {max}");
        require("model.nu_initial", start, min < start && start < max, &between)?;
        let (min, max) = (model.scale_min, model.scale_max);
        require("model.scale_min", min, min > 0.0 && min < 1.0, "a number in (0, 1)")?;
        let above = format!("more than model.scale_min = {min}, at most 1");
        require("model.scale_max", max, max > min && max <= 1.0, &above)?;

        let (threshold, factor) = (initialisation.threshold, initialisation.density_factor);
        require("initialisation.threshold", threshold, threshold.is_finite(), "a finite number")?;
        let positive = factor > 0.0 && factor.is_finite();
        require("initialisation.density_factor", factor, positive, "a positive number")?;

        for (key, weight) in [("loss.d_ssim", loss.d_ssim), ("loss.tv", loss.tv)] {
            require(key, weight, weight >= 0.0 && weight.is_finite(), "a number that is not negative")?;
        }
        require("loss.tv_block", loss.tv_block, loss.tv_block >= 2, "at least 2")?;

        for (key, rates) in [
            ("optimiser.mean", optimiser.mean),
            ("optimiser.scale", optimiser.scale),
            ("optimiser.quaternion", optimiser.quaternion),
            ("optimiser.density", optimiser.density),
            ("optimiser.nu", optimiser.nu),
        ] {
            let usable = rates.iter().all(|rate| *rate >= 0.0 && rate.is_finite());
            require(key, rates, usable, "two rates that are not negative")?;
        }
        let fractions = optimiser.beta.iter().all(|beta| (0.0..1.0).contains(beta));
        require("optimiser.beta", optimiser.beta, fractions, "two numbers in [0, 1)")?;
        let epsilon = optimiser.epsilon;
        require("optimiser.epsilon", epsilon, epsilon > 0.0 && epsilon.is_finite(), "a positive number")
    }
}

fn require(key: &str, got: impl Debug, holds: bool, expected: &str) -> Result<()> {
    if holds {
        return Ok(());
    }
    Err(Error::invalid(key, format!("{got:?}"), expected, "change it in the configuration"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid() {
        Config::default().validate().unwrap();
    }

    #[test]
    fn every_number_has_a_range() {
        for (key, value) in Config::default().entries() {
            let absurd = match &value {
                toml::Value::Integer(_) => &["-1", "0"][..],
                toml::Value::Float(_) => &["nan", "inf"],
                toml::Value::Array(_) => &["[nan, 0.5]", "[0.5, inf]"],
                _ => continue,
            };
            for absurd in absurd.iter().filter(|absurd| (key.as_str(), **absurd) != ("seed", "0")) {
                let mut config = Config::default();
                let outcome = config.set(&format!("{key}={absurd}")).and_then(|()| config.validate());
                let message = outcome.expect_err(&format!("{key} = {absurd} must be refused")).to_string();
                assert!(message.starts_with(&format!("{key}: got ")), "{key} = {absurd}: {message}");
            }
        }
    }

    #[test]
    fn limits_that_depend_on_each_other_name_both() {
        for (setting, names) in [
            ("model.nu_initial=2", ["model.nu_initial", "model.nu_min = 2"]),
            ("model.nu_max=1.5", ["model.nu_max", "model.nu_min = 2"]),
            ("model.scale_min=0.6", ["model.scale_max", "model.scale_min = 0.6"]),
        ] {
            let mut config = Config::default();
            config.set(setting).unwrap();
            let message = config.validate().unwrap_err().to_string();
            assert!(names.iter().all(|name| message.contains(name)), "{setting}: {message}");
        }
    }
}
