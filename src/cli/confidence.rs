//! `trgs confidence`: coverage of each primitive of a model by the rays of given views.

use super::arguments::finite;
use super::cost::announce;
use super::views::{ViewArgs, Views};
use super::{Output, interrupt};
use clap::{Args, value_parser};
use ndarray::{ArrayView, aview0, aview1};
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;
use trgs::confidence::{Alpha, Coverage, Histogram, MOST_POINTS, Settings, Spread, nu_target, spearman};
use trgs::duration::sample;
use trgs::primitives::Primitives;
use trgs::primitives::activation::Interval;
use trgs::scan::model;
use trgs::scan::npz::{self, Entry};
use trgs::words::{self, counted};
use trgs::{Error, Result};

/// Points on the sphere of a primitive from which the duration is estimated.
const SAMPLED_POINTS: usize = 256;
/// Points of all primitives in all views that take a few seconds at most.
const LITTLE: f64 = 1e9;

/// Compute the ray confidence of each primitive, and the degrees of freedom that follow from it
#[derive(Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:
  trgs confidence out/torso/model.npz --scanner data/torso --out confidence.npz
  trgs confidence model.npz --scanner meta_data.json --angles 0,1.5708 --r-max 0.7 --out confidence.npz"
)]
pub(super) struct Confidence {
    /// Model file
    #[arg(value_name = "MODEL.npz")]
    model: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    /// File to write: arrays c and nu_target (one number per primitive), the settings (alpha where it is one length for all) and
    /// the angles
    #[arg(long, value_name = "FILE.npz")]
    out: PathBuf,
    /// Number of points on each primitive's unit sphere
    #[arg(long, value_name = "N", default_value_t = Settings::default().sphere_points as u32, value_parser = value_parser!(u32).range(1..=MOST_POINTS as i64))]
    sphere_points: u32,
    /// Length that a primitive's scale along a ray is compared with: own (its mean scale), median (of the mean scales of all
    /// primitives), or a number of scene units
    #[arg(long, value_name = "own|median|LENGTH", default_value = "own", value_parser = alpha)]
    alpha: Alpha,
    /// Largest distance between a point and a ray that covers it
    #[arg(long, value_name = "RADIUS", default_value_t = Settings::default().r_max, value_parser = finite)]
    r_max: f64,
    /// Ratio of alpha to the scale along a ray from which on the ray covers up to the largest distance
    #[arg(long, value_name = "RATIO", default_value_t = Settings::default().kappa, value_parser = finite)]
    kappa: f64,
    /// Temperature: the smaller it is, the more sharply nu changes from minimum to maximum
    #[arg(long, value_name = "T", default_value_t = Settings::default().temperature, value_parser = finite)]
    temperature: f64,
    /// Degrees of freedom at confidence 0
    #[arg(long, value_name = "NU", default_value_t = 2.0, value_parser = finite)]
    nu_min: f64,
    /// Degrees of freedom at confidence 1
    #[arg(long, value_name = "NU", default_value_t = 100.0, value_parser = finite)]
    nu_max: f64,
}

impl Confidence {
    pub(super) fn run(&self) -> Result<Output> {
        let (settings, nu) = (self.settings()?, self.nu()?);
        let primitives = model::read(&self.model)?;
        let views = self.views.read()?;
        let seconds = seconds(&primitives, &views, settings);
        announce(&format!("the confidence of {}", counted(primitives.len(), "primitive")), seconds, || None);
        let c = Coverage::new(settings).confidence(&primitives, &views.scanner, views.trajectory());
        let targets: Vec<f64> = c.iter().map(|&c| nu_target(c, &settings, nu)).collect();
        let alpha = settings.alpha.constant(&primitives);
        interrupt::shielded(|| self.write(&c, &targets, &views.angles, alpha))?;
        Ok(Output::list(&json!({
            "out": words::name(&self.out),
            "primitives": primitives.len(),
            "views": views.angles.len(),
            // Null without primitives.
            "c": Spread::of(&c),
            // Primitives with c from 0 to 0.05, from 0.05 to 0.1, and so on.
            "c_histogram": Histogram::of(&c),
            "nu_target": Spread::of(&targets),
            // Rank correlation of c and the model's ν; null if either is constant, as ν of Gaussians is.
            "spearman": spearman(&c, &primitives.parameters.nu),
        })))
    }

    fn settings(&self) -> Result<Settings> {
        let Self { sphere_points, alpha, r_max, kappa, temperature, .. } = *self;
        let settings = Settings { sphere_points: sphere_points as usize, alpha, r_max, kappa, temperature };
        settings.validate().map(|()| settings)
    }

    fn nu(&self) -> Result<Interval> {
        let Self { nu_min: min, nu_max: max, .. } = *self;
        if min > 0.0 && min < max {
            return Ok(Interval { min, max });
        }
        let expected = "positive numbers, the first below the second";
        Err(Error::invalid(
            "--nu-min and --nu-max",
            format!("{min} and {max}"),
            expected,
            "give --nu-min 2 --nu-max 100, the defaults",
        ))
    }

    fn write(&self, c: &[f64], targets: &[f64], angles: &[f64], alpha: Option<f64>) -> Result<()> {
        fn entry<'a, D: ndarray::Dimension>(array: ArrayView<'a, f64, D>) -> Entry<'a> {
            Entry::F64(array.into_dyn())
        }
        let (points, range) = (f64::from(self.sphere_points), [self.nu_min, self.nu_max]);
        let mut arrays = vec![
            ("c", entry(aview1(c))),
            ("nu_target", entry(aview1(targets))),
            ("sphere_points", entry(aview0(&points))),
            ("r_max", entry(aview0(&self.r_max))),
            ("kappa", entry(aview0(&self.kappa))),
            ("temperature", entry(aview0(&self.temperature))),
            ("nu_range", entry(aview1(&range))),
            ("angles", entry(aview1(angles))),
        ];
        if let Some(alpha) = &alpha {
            arrays.push(("alpha", entry(aview0(alpha))));
        }
        npz::write(&self.out, &arrays)
    }
}

/// How long the confidence will take, about, from a few primitives and points; 0 for little work.
fn seconds(primitives: &Primitives, views: &Views, settings: Settings) -> f64 {
    let work = primitives.len() as f64 * views.angles.len() as f64 * settings.sphere_points as f64;
    if work <= LITTLE {
        return 0.0;
    }
    let (sample, factor) = sample(primitives);
    let points = settings.sphere_points.min(SAMPLED_POINTS);
    let began = Instant::now();
    let few = Settings { sphere_points: points, ..settings };
    let _ = Coverage::new(few).confidence(&sample, &views.scanner, views.trajectory());
    began.elapsed().as_secs_f64() * factor * settings.sphere_points as f64 / points as f64
}

fn alpha(text: &str) -> std::result::Result<Alpha, String> {
    match text {
        "own" => Ok(Alpha::Own),
        "median" => Ok(Alpha::Median),
        length => {
            finite(length).map(Alpha::Length).map_err(|_| "expected own, median or a number of scene units".into())
        }
    }
}
