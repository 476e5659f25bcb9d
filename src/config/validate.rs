//! Which values make sense.

use super::keys::{Keys, require};
use super::paper::BLOCK;
use super::{AlphaConfig, Config, Method, PositionOptimiser, Start};
use crate::error::{Error, Result};
use crate::primitives::KernelKind;
use crate::setting::Text;
use std::fmt::Debug;

impl Config {
    /// Checks that every number lies in its range.
    ///
    /// # Errors
    /// [`Error::Invalid`] for the first that does not.
    pub fn validate(&self) -> Result<()> {
        self.check_ranges().map_err(|error| match error {
            Error::Invalid { what, got, expected, remedy } if remedy.is_empty() => {
                let remedy = self.remedy(&what.to_string());
                Error::Invalid { what, got, expected, remedy }
            }
            other => other,
        })
    }

    /// The remedy for a key out of its range: the default of the method, if that is within the range.
    fn remedy(&self, key: &str) -> Text {
        let default = Self::of(self.method).entries().into_iter().find(|(name, _)| name == key);
        let mut changed = self.clone();
        let default = default.filter(|(key, value)| changed.set(&format!("{key}={value}")).is_ok());
        let is_wrong = matches!(changed.check_ranges(), Err(Error::Invalid { what, .. }) if what == Text::from(key));
        match default.filter(|_| !is_wrong) {
            Some((key, value)) => "give " + Text::set(&key, value) + ", the default",
            None => "give a value in this range".into(),
        }
    }

    fn check_ranges(&self) -> Result<()> {
        let Self { model, initialisation, loss, confidence, wavelet, optimiser, sghmc, density_control, .. } = self;
        let Self { fdk, algebraic, asd_pocs, tv, neural, .. } = self;
        self.check("")?;
        model.check("model")?;
        initialisation.check("initialisation")?;
        loss.check("loss")?;
        confidence.check("confidence")?;
        wavelet.check("wavelet")?;
        optimiser.check("optimiser")?;
        sghmc.check("sghmc")?;
        density_control.check("density_control")?;
        fdk.check("fdk")?;
        algebraic.check("algebraic")?;
        asd_pocs.check("asd_pocs")?;
        tv.check("tv")?;
        neural.check("neural")?;
        self.check_together()?;
        self.check_method()
    }

    /// What keys demand of each other.
    fn check_together(&self) -> Result<()> {
        let Self { model, initialisation, confidence, wavelet, optimiser, sghmc, neural, .. } = self;
        let own = self.method.fits_primitives() || self.method == Method::Fdk;
        require("iterations", self.iterations, own || self.iterations >= 1, "at least 1")?;
        let (min, start, max) = (model.nu_min, model.nu_initial, model.nu_max);
        require("model.nu_max", max, max > min, &format!("more than model.nu_min = {min}"))?;
        let between = format!("between model.nu_min = {min} and model.nu_max = {max}");
        require("model.nu_initial", start, min < start && start < max, &between)?;
        match (initialisation.from == Start::Model, initialisation.model.as_str()) {
            (true, "") => {
                let remedy = "name the file: " + Text::set("initialisation.model", "MODEL.npz");
                return Err(Error::invalid("initialisation.model", "no file", "the file of a model", remedy));
            }
            (false, file) if !file.is_empty() => {
                let remedy = "start from the model, " + Text::set("initialisation.from", "model") + ", or name none";
                return Err(Error::invalid("initialisation.model", file, "no file for another start", remedy));
            }
            _ => {}
        }
        if let AlphaConfig::Voxels(voxels) = confidence.alpha {
            let positive = voxels > 0.0 && voxels.is_finite();
            require("confidence.alpha", voxels, positive, "own, median or a positive number of voxels")?;
        }
        let levels = wavelet.levels;
        let block = if wavelet.block == 0 { BLOCK } else { wavelet.block };
        let whole = block.trailing_zeros() as usize >= levels;
        require("wavelet.block", wavelet.block, whole, &format!("a multiple of 2^levels = {}", 1 << levels))?;

        // From there on momentum grows without bound; the burn-in has none. A factor on the rates of a short run divides
        // frictions by its root, which leaves the product as it is.
        let rate = optimiser.mean[0].max(optimiser.mean[1]).sqrt();
        let stirred = optimiser.position != PositionOptimiser::Adam;
        let (first, friction) = (sghmc.burn_in_friction, sghmc.friction);
        require("sghmc.burn_in_friction", first, first >= 0.0 && first.is_finite(), "a number that is not negative")?;
        let stable = friction >= 0.0 && (!stirred || rate * friction < 2.0);
        let expected = format!("below 2/√(learning rate of means) = {:.4}, where sampling is stable", 2.0 / rate);
        require("sghmc.friction", friction, stable, &expected)?;
        let any = neural.rays.saturating_add(neural.windows);
        let expected = "at least 1 without windows, at most 10 million";
        require("neural.rays", neural.rays, (1..=10_000_000).contains(&any), expected)
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
    let remedy = || "give " + Text::set(key, value);
    if holds { Ok(()) } else { Err(Error::invalid(key, format!("{got:?}"), expected, remedy())) }
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
        config.set("sghmc.friction=142").unwrap();
        let message = config.validate().unwrap_err().to_string();
        assert!(message.starts_with("sghmc.friction: got 142.0") && message.contains("141.4"), "{message}");
        // It has no meaning for Adam.
        config.set("optimiser.position=adam").unwrap();
        config.validate().unwrap();
    }

    #[test]
    fn the_block_of_the_scan_has_whole_levels() {
        let mut config = Config::default();
        config.set("wavelet.levels=5").unwrap();
        config.validate().unwrap();
        config.set("wavelet.levels=6").unwrap();
        assert!(config.validate().unwrap_err().to_string().starts_with("wavelet.block: got 0, expected a multiple"));
        config.set("wavelet.block=64").unwrap();
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
                "coarse",
                "iterations",
                "model.points",
                "confidence.every",
                "density_control.every",
                "density_control.cap",
                "wavelet.every",
                "wavelet.block",
                "loss.tv_block",
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
