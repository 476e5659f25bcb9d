//! Damaged and changed checkpoints of all methods: refused, or gone on from without a panic.

use super::*;
use crate::config::{Finish, Sampling};
use crate::geometry::{Beam, Detector, Grid, Scanner};
use crate::numeric::rng::{Purpose, stream};
use crate::reconstruction::{Progress, Run};
use crate::scan::simulate::{Object, Plan, simulate};
use crate::scan::{Noise, Phantom};
use crate::sealed::reseal::{content, sealed};
use rand::RngExt;
use rmpv::Value;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Flipped bits and changed fields of each method, in every run of the tests and in the one that is ignored.
const FEW: usize = 6;
const MANY: usize = 2000;

fn scan() -> Dataset {
    let detector = Detector { rows: 9, columns: 10, pitch_v: 0.4, pitch_u: 0.4, offset_u: 0.0, offset_v: 0.0 };
    let scanner = Scanner { beam: Beam::Cone { dso: 5.0, dsd: 7.0 }, detector, grid: Grid::cube(8) };
    let plan = Plan { views: 4, test_views: 0, noise: Noise::LOW, seed: 1 };
    simulate("scan", Object::Phantom(&Phantom::by_name("torso", 0).unwrap()), &scanner, &plan).unwrap()
}

/// A run of each method, with both forms of what is chosen.
fn configs() -> Vec<Config> {
    let of = |method: Method, settings: &[&str]| {
        let mut config = Config { iterations: 8, checkpoint_every: 4, ..Config::of(method) };
        settings.iter().for_each(|setting| config.set(setting).unwrap());
        config
    };
    let network = ["neural.rays=16", "neural.samples=6", "neural.levels=2", "neural.table=4"];
    let small =
        ["model.points=12", "density_control.every=3", "confidence.every=2", "report_every=2", "wavelet.block=8"];
    vec![
        of(Method::TrGs, &small),
        of(Method::R2Gaussian, &small),
        of(Method::Sart, &[]),
        of(Method::OsSart, &["algebraic.subset=2", "algebraic.auto=true"]),
        of(Method::AsdPocs, &["precision=f64"]),
        of(Method::Cgls, &[]),
        of(Method::Tv, &["tv.tolerance=0"]),
        of(Method::Naf, &network),
        of(Method::SaxNerf, &network),
        of(Method::Intratomo, &network),
    ]
    .into_iter()
    .map(|config| Config { sampling: Sampling::Point, finish: Finish::None, ..config })
    .collect()
}

/// The file of a run that was stopped after its fifth iteration, and the volume of the whole run.
fn stopped(scan: &Dataset, config: &Config, file: &Path) -> Vec<f32> {
    let stop = |progress: Progress<'_>| match progress {
        Progress::Iteration(5, _) => ControlFlow::Break(()),
        Progress::Pass(pass) if pass.iteration == 5 => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    let run = || Run::new(scan, config);
    let whole = run().reconstruct().unwrap();
    run().checkpoints(Checkpoints::new(file)).observe(stop).reconstruct().map(drop).unwrap_or_default();
    whole.volume.values.into_raw_vec_and_offset().0
}

/// The volume of a run that goes on from the file, or the message of the error.
fn resumed(scan: &Dataset, config: &Config, file: &Path) -> std::result::Result<Vec<f32>, String> {
    let went_on = || {
        let found = Run::new(scan, config).checkpoints(Checkpoints::resume(file)?).reconstruct()?;
        Ok(found.volume.values.into_raw_vec_and_offset().0)
    };
    let outcome = catch_unwind(AssertUnwindSafe(went_on)).unwrap_or_else(|_| panic!("a panic: {config:?}"));
    outcome.map_err(|error: Error| error.to_string())
}

/// Changes one value of a tree: its length, its sign, its size or its kind.
fn change(value: &mut Value, draw: &mut impl FnMut(usize) -> usize) {
    if let Value::Array(values) = value
        && !values.is_empty()
        && draw(4) > 0
    {
        let at = draw(values.len());
        return change(&mut values[at], draw);
    }
    let other = match value {
        Value::Array(values) => {
            let mut values = values.clone();
            match draw(4) {
                0 => drop(values.pop()),
                1 => values.push(values.last().cloned().unwrap_or(Value::Nil)),
                2 => values.clear(),
                _ => values.truncate(values.len() / 2),
            }
            Value::Array(values)
        }
        Value::F32(_) => Value::F32([f32::NAN, f32::INFINITY, -1.0, 0.0, f32::MAX][draw(5)]),
        Value::F64(_) => Value::F64([f64::NAN, f64::INFINITY, -1.0, 0.0, f64::MAX, 1e-320][draw(6)]),
        Value::Integer(_) => [0, 1, 5, 1 << 20, u64::from(u32::MAX), u64::MAX][draw(6)].into(),
        Value::String(text) => {
            let text = text.as_str().unwrap_or_default();
            Value::from(text.chars().take(draw(text.len() + 1)).collect::<String>())
        }
        Value::Boolean(is) => Value::Boolean(!*is),
        _ => Value::from(7),
    };
    *value = if draw(8) == 0 { Value::Nil } else { other };
}

/// Returns how many changed checkpoints were refused, and how many were gone on from.
fn attack(cases: usize) -> [usize; 2] {
    let (scan, folder) = (scan(), tempfile::tempdir().unwrap());
    let [mut refused, mut accepted] = [0; 2];
    for config in configs() {
        let file = folder.path().join("last.msgpack");
        let expected = stopped(&scan, &config, &file);
        let (intact, what) = (std::fs::read(&file).unwrap(), config.method);
        let kind = if what.fits_primitives() { Kind::Primitives } else { Kind::Voxels };
        assert!(resumed(&scan, &config, &file).unwrap() == expected, "{what:?}");
        assert!(sealed(kind, content(&intact)) == intact);
        let mut random = stream(1, Purpose::TestViews, 0, what as u64);
        let mut draw = |n: usize| random.random_range(0..n);
        for case in 0..cases {
            // A flipped bit.
            let mut bytes = intact.clone();
            bytes[draw(intact.len())] ^= 1 << draw(8);
            std::fs::write(&file, &bytes).unwrap();
            let message = resumed(&scan, &config, &file).expect_err("a flipped bit");
            assert!(message.contains("last.msgpack") && message.contains("start again without"), "{message}");
            // A changed field and a flipped bit below a right digest.
            let mut tree = rmpv::decode::read_value(&mut content(&intact)).unwrap();
            change(&mut tree, &mut draw);
            let mut field = Vec::new();
            rmpv::encode::write_value(&mut field, &tree).unwrap();
            let mut bit = content(&intact).to_vec();
            bit[draw(content(&intact).len())] ^= 1 << draw(8);
            for changed in [field, bit] {
                std::fs::write(&file, sealed(kind, &changed)).unwrap();
                match resumed(&scan, &config, &file) {
                    Ok(volume) => {
                        assert_eq!(volume.len(), expected.len(), "{what:?}, case {case}");
                        accepted += 1;
                    }
                    Err(message) => {
                        assert!(!message.contains('\n') && message.contains(';'), "{what:?}, case {case}: {message}");
                        refused += 1;
                    }
                }
            }
        }
    }
    [refused, accepted]
}

#[test]
fn damaged_and_changed_checkpoints_are_refused_or_gone_on_from_without_a_panic() {
    let [refused, accepted] = attack(FEW);
    assert!(refused > accepted && accepted > 0, "{refused} refused, {accepted} accepted");
}

#[test]
#[ignore = "2,000 flips and changed fields for each of ten methods take minutes; the same attack with six always runs"]
fn thousands_of_damaged_and_changed_checkpoints_cause_no_panic() {
    let [refused, accepted] = attack(MANY);
    eprintln!("{refused} refused, {accepted} accepted");
}
