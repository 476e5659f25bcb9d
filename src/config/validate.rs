//! Which values make sense.

use super::{AlphaConfig, Config, Method, PositionOptimiser, Start};
use crate::error::{Error, Result};
use crate::primitives::KernelKind;
use std::fmt::Debug;

/// More primitives than any computer here can hold, so that a slip of the finger is a message and not a crash.
const MOST_POINTS: usize = 10_000_000;
/// What a number of primitives may be.
const FROM_THE_SCAN: &str = "4 to 10 million, or 0: as the scan says";

impl Config {
    /// Checks that every number lies in its range.
    ///
    /// # Errors
    /// [`Error::Invalid`] for the first that does not.
    pub fn validate(&self) -> Result<()> {
        self.check_ranges().map_err(|error| match error {
            Error::Invalid { what, got, expected, remedy } if remedy.is_empty() => {
                let remedy = self.remedy(&what);
                Error::Invalid { what, got, expected, remedy }
            }
            other => other,
        })
    }

    /// The remedy for a key out of its range: the default of the method, if that is within the range.
    fn remedy(&self, key: &str) -> String {
        let default = Self::of(self.method).entries().into_iter().find(|(name, _)| name == key);
        let mut changed = self.clone();
        let setting = default.map(|(_, value)| format!("{key}={value}")).filter(|text| changed.set(text).is_ok());
        let is_wrong = matches!(changed.check_ranges(), Err(Error::Invalid { what, .. }) if what == key);
        match setting.filter(|_| !is_wrong) {
            Some(setting) => format!("give `{setting}`, the default"),
            None => "give a value in this range".into(),
        }
    }

    fn check_ranges(&self) -> Result<()> {
        let Self { model, initialisation, loss, confidence, wavelet, optimiser, sghmc, density_control, .. } = self;
        let own = self.method.fits_primitives() || self.method == Method::Fdk;
        require("iterations", self.iterations, own || self.iterations >= 1, "at least 1")?;
        require("seed", self.seed, i64::try_from(self.seed).is_ok(), "at most 2^63 - 1, the largest integer of TOML")?;
        require("cutoff", self.cutoff, (0.0..1.0).contains(&self.cutoff), "a number in [0, 1)")?;
        if let Some(unit) = self.density_unit.fixed() {
            require("density_unit", unit, unit > 0.0 && unit.is_finite(), "a positive number, or auto")?;
        }
        for (key, period) in [
            ("report_every", self.report_every),
            ("checkpoint_every", self.checkpoint_every),
            ("wavelet.every", wavelet.every),
            ("optimiser.horizon", optimiser.horizon),
            ("optimiser.longest", optimiser.longest),
        ] {
            require(key, period, period >= 1, "at least 1")?;
        }

        let some = |points: usize| points == 0 || (4..=MOST_POINTS).contains(&points);
        require("model.points", model.points, some(model.points), FROM_THE_SCAN)?;
        let (min, start, max) = (model.nu_min, model.nu_initial, model.nu_max);
        require("model.nu_min", min, min > 0.0 && min.is_finite(), "a positive number")?;
        require("model.nu_max", max, max > min && max.is_finite(), &format!("more than model.nu_min = {min}"))?;
        let between = format!("between model.nu_min = {min} and model.nu_max = {max}");
        require("model.nu_initial", start, min < start && start < max, &between)?;
        let (min, max) = (model.smallest_scale, model.scale_max);
        require("model.smallest_scale", min, min > 0.0 && min.is_finite(), "a positive number of voxels")?;
        require("model.scale_max", max, max > 0.0 && max <= 1.0, "a number in (0, 1]")?;

        let (threshold, factor) = (initialisation.threshold, initialisation.density_factor);
        require("initialisation.threshold", threshold, threshold.is_finite(), "a finite number")?;
        let positive = factor > 0.0 && factor.is_finite();
        require("initialisation.density_factor", factor, positive, "a positive number")?;
        let smoothing = initialisation.smoothing;
        require("initialisation.smoothing", smoothing, smoothing > 0.0 && smoothing <= 16.0, "a number in (0, 16]")?;
        match (initialisation.from == Start::Model, initialisation.model.as_str()) {
            (true, "") => {
                let remedy = "name the file: `initialisation.model=MODEL.npz`";
                return Err(Error::invalid("initialisation.model", "no file", "the file of a model", remedy));
            }
            (false, file) if !file.is_empty() => {
                let remedy = "start from the model, `initialisation.from=model`, or name none";
                return Err(Error::invalid("initialisation.model", file, "no file for another start", remedy));
            }
            _ => {}
        }

        for (key, weight) in [
            ("loss.d_ssim", loss.d_ssim),
            ("loss.tv", loss.tv.or(0.0)),
            ("confidence.weight", confidence.weight),
            ("wavelet.enhancement", wavelet.enhancement),
            ("wavelet.suppress", wavelet.suppress),
            ("wavelet.enhance", wavelet.enhance),
            ("density_control.dead", density_control.dead),
            ("density_control.growth", density_control.growth),
            ("density_control.gradient", density_control.gradient),
            ("density_control.spread", density_control.spread),
            ("density_control.split_scale", density_control.split_scale),
            ("density_control.faint", density_control.faint),
        ] {
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
        require("optimiser.epsilon", epsilon, epsilon > 0.0 && epsilon.is_finite(), "a positive number")?;

        for (key, value) in [
            ("confidence.temperature", confidence.temperature),
            ("confidence.r_max", confidence.r_max),
            ("confidence.kappa", confidence.kappa),
            ("sghmc.density_reference", sghmc.density_reference),
            ("sghmc.temperature", sghmc.temperature),
        ] {
            require(key, value, value > 0.0 && value.is_finite(), "a positive number")?;
        }
        if let AlphaConfig::Voxels(voxels) = confidence.alpha {
            let positive = voxels > 0.0 && voxels.is_finite();
            require("confidence.alpha", voxels, positive, "own, median or a positive number of voxels")?;
        }
        let points = confidence.sphere_points;
        require("confidence.sphere_points", points, (8..=1 << 20).contains(&points), "8 to 2^20")?;
        let levels = wavelet.levels;
        require("wavelet.levels", levels, (1..=8).contains(&levels), "1 to 8")?;
        let whole = wavelet.block >> levels >= 1 && wavelet.block.trailing_zeros() as usize >= levels;
        require("wavelet.block", wavelet.block, whole, &format!("a multiple of 2^levels = {}", 1 << levels))?;
        require("wavelet.neighbours", wavelet.neighbours, (1..=255).contains(&wavelet.neighbours), "1 to 255")?;
        let fraction = |key, value: f64| require(key, value, (0.0..=1.0).contains(&value), "a number from 0 to 1");
        fraction("wavelet.threshold", wavelet.threshold)?;
        fraction("sghmc.burn_in", sghmc.burn_in)?;
        fraction("density_control.start", density_control.start)?;
        fraction("density_control.stop", density_control.stop)?;
        fraction("density_control.recycled", density_control.recycled)?;
        let cap = density_control.cap;
        require("density_control.cap", cap, some(cap), FROM_THE_SCAN)?;

        // Beyond this the momentum changes its sign with every step and can grow without bound. A factor on the rates of
        // a short run divides frictions by its root, which leaves the product as it is.
        let rate = optimiser.mean[0].max(optimiser.mean[1]).sqrt();
        let stirred = optimiser.position != PositionOptimiser::Adam;
        for (key, friction) in [("sghmc.burn_in_friction", sghmc.burn_in_friction), ("sghmc.friction", sghmc.friction)]
        {
            let stable = friction >= 0.0 && (!stirred || rate * friction <= 1.0);
            let expected = format!("at most 1/√(learning rate of means) = {:.4}, where sampling is stable", 1.0 / rate);
            require(key, friction, stable, &expected)?;
        }
        let Self { algebraic, asd_pocs, tv, .. } = self;
        let relaxation = algebraic.relaxation;
        require("algebraic.relaxation", relaxation, relaxation > 0.0 && relaxation < 2.0, "a number in (0, 2)")?;
        for (key, factor) in
            [("algebraic.reduction", algebraic.reduction), ("asd_pocs.alpha_reduction", asd_pocs.alpha_reduction)]
        {
            require(key, factor, factor > 0.0 && factor <= 1.0, "a number in (0, 1]")?;
        }
        fraction("algebraic.tolerance", algebraic.tolerance)?;
        fraction("tv.tolerance", tv.tolerance)?;
        for (key, count) in [
            ("algebraic.subset", algebraic.subset),
            ("asd_pocs.tv_steps", asd_pocs.tv_steps),
            ("tv.finish_iterations", tv.finish_iterations.or(1)),
            ("tv.steps", tv.steps),
        ] {
            require(key, count, count >= 1, "at least 1")?;
        }
        for (key, value) in [
            ("asd_pocs.alpha", asd_pocs.alpha),
            ("asd_pocs.r_max", asd_pocs.r_max),
            ("asd_pocs.epsilon", asd_pocs.epsilon),
            ("tv.weight", tv.weight.or(0.0)),
        ] {
            require(key, value, value >= 0.0 && value.is_finite(), "a number that is not negative")?;
        }
        let neural = &self.neural;
        require("neural.levels", neural.levels, neural.levels <= 16, "1 to 16, or 0: as the scan says")?;
        require("neural.table", neural.table, neural.table <= 24, "1 to 24, or 0: as the scan says")?;
        let even = neural.samples.is_multiple_of(2) && neural.samples <= 1 << 16;
        require("neural.samples", neural.samples, even, "an even number up to 65,536, or 0: as the scan says")?;
        for (key, count) in [("neural.window", neural.window), ("neural.drop", neural.drop)] {
            require(key, count, count >= 1, "at least 1")?;
        }
        let any = neural.rays + neural.windows;
        require(
            "neural.rays",
            neural.rays,
            (1..=10_000_000).contains(&any),
            "at least 1 without windows, at most 10 million",
        )?;
        for (key, value) in [
            ("neural.table_rate", neural.table_rate),
            ("neural.network_rate", neural.network_rate),
            ("neural.ceiling", neural.ceiling),
        ] {
            require(key, value, value > 0.0 && value.is_finite(), "a positive number")?;
        }
        self.check_method()
    }

    /// Refuses settings that make a method another one.
    fn check_method(&self) -> Result<()> {
        if self.method == Method::R2Gaussian {
            let gaussian = self.model.kernel == KernelKind::Gaussian;
            fits("model.kernel", self.model.kernel, gaussian, "gaussian with method r2-gaussian", "gaussian")?;
            for (key, enabled) in
                [("confidence.enabled", self.confidence.enabled), ("wavelet.enabled", self.wavelet.enabled)]
            {
                fits(key, enabled, !enabled, "false with method r2-gaussian", "false")?;
            }
        }
        let tails = self.model.kernel == KernelKind::StudentT || !self.confidence.enabled;
        fits("confidence.enabled", true, tails, "false with gaussian kernels, which have no ν to pull", "false")
    }
}

/// An error about a key whose only value that fits is known.
fn fits(key: &str, got: impl Debug, holds: bool, expected: &str, value: &str) -> Result<()> {
    let remedy = || format!("give `{key}={value}`");
    if holds { Ok(()) } else { Err(Error::invalid(key, format!("{got:?}"), expected, remedy())) }
}

fn require(key: &str, got: impl Debug, holds: bool, expected: &str) -> Result<()> {
    if holds {
        return Ok(());
    }
    // `validate` adds the remedy.
    Err(Error::invalid(key, format!("{got:?}"), expected, ""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Preset;

    #[test]
    fn the_defaults_of_all_methods_are_valid() {
        for method in Method::ALL {
            let mut config = Config::of(method);
            config.validate().unwrap();
            for preset in Preset::ALL {
                config.apply(preset);
                config.validate().unwrap();
            }
        }
    }

    #[test]
    fn a_method_is_not_bent_into_another() {
        for setting in ["model.kernel=student-t", "confidence.enabled=true", "wavelet.enabled=true"] {
            let mut config = Config::of(Method::R2Gaussian);
            config.set(setting).unwrap();
            let message = config.validate().unwrap_err().to_string();
            assert!(message.contains("r2-gaussian"), "{message}");
        }
        let mut config = Config::default();
        config.set("model.kernel=gaussian").unwrap();
        assert!(config.validate().unwrap_err().to_string().contains("confidence.enabled"));
    }

    #[test]
    fn friction_that_samples_unstably_is_refused() {
        let mut config = Config::default();
        config.set("sghmc.friction=71").unwrap();
        let message = config.validate().unwrap_err().to_string();
        assert!(message.starts_with("sghmc.friction: got 71.0") && message.contains("70.7"), "{message}");
        // It has no meaning for Adam.
        config.set("optimiser.position=adam").unwrap();
        config.validate().unwrap();
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
            let follows_from_the_scan = [
                "iterations",
                "model.points",
                "confidence.every",
                "density_control.every",
                "density_control.cap",
                "neural.levels",
                "neural.table",
                "neural.samples",
            ];
            let may_be_zero = key == "seed" || key == "neural.windows" || follows_from_the_scan.contains(&key.as_str());
            for absurd in absurd.iter().filter(|absurd| !(may_be_zero && **absurd == "0")) {
                let mut config = Config::default();
                if let (Ok(()), Err(error)) = (config.set(&format!("{key}={absurd}")), config.validate()) {
                    // The remedy is an assignment that works.
                    let message = error.to_string();
                    let setting = message.split('`').nth(1).unwrap_or_else(|| panic!("{key}: {message}"));
                    let mut mended = config.clone();
                    mended.set(setting).and_then(|()| mended.validate()).unwrap_or_else(|error| panic!("{error}"));
                }
                let outcome = config.set(&format!("{key}={absurd}")).and_then(|()| config.validate());
                let message = outcome.expect_err(&format!("{key} = {absurd} must be refused")).to_string();
                assert!(message.starts_with(&format!("{key}: got ")), "{key} = {absurd}: {message}");
            }
        }
    }

    #[test]
    fn a_model_and_a_start_from_it_need_each_other() {
        let outcome = |settings: &[&str]| {
            let mut config = Config::default();
            settings.iter().try_for_each(|setting| config.set(setting)).and_then(|()| config.validate())
        };
        let (from, model) = ("initialisation.from=model", "initialisation.model=out/model.npz");
        outcome(&[from, model]).unwrap();
        for alone in [from, model] {
            let message = outcome(&[alone]).unwrap_err().to_string();
            assert!(message.starts_with("initialisation.model: got "), "{message}");
        }
    }

    #[test]
    fn limits_that_depend_on_each_other_name_both() {
        for (setting, names) in [
            ("model.nu_initial=2", ["model.nu_initial", "model.nu_min = 2"]),
            ("model.nu_max=1.5", ["model.nu_max", "model.nu_min = 2"]),
        ] {
            let mut config = Config::default();
            config.set(setting).unwrap();
            let message = config.validate().unwrap_err().to_string();
            assert!(names.iter().all(|name| message.contains(name)), "{setting}: {message}");
        }
    }
}
