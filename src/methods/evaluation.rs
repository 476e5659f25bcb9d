//! Quality of a reconstruction: PSNR and SSIM of volumes and projections, as R²-Gaussian defines them.
//!
//! Published SSIMs of one volume differ by 6 points between definitions, so each [`Metric`] carries the id of its
//! definition:
//!
//! | id | definition |
//! |---|---|
//! | `psnr3d/peak1` | `10 log10(1/MSE)` over all voxels, peak 1, without clipping or scaling |
//! | `ssim3d/r2-slices` | mean over the axes of the mean [SSIM](trgs_core::loss::ssim) of the slices across it |
//! | `psnr3d/truth-range` | the same with both volumes divided by the range of the truth, maximum less minimum |
//! | `ssim3d/truth-range-slices` | SSIM of the slices of these, otherwise as above |
//! | `psnr2d/selfmax` | `10 log10(1/MSE)` of images divided by their own maximum, mean over the views |
//! | `ssim2d/selfmax` | SSIM of the same images, mean over the same views |
//!
//! Slices and views whose truth has no value above 0 are left out of the means. The metrics with the truth's range are
//! computed only where the maximum of the truth is outside [½, 2]: a peak of 1 says little there. The 2-D metrics do
//! not see an error in global scale; the 3-D metrics do. All arithmetic is f64.
//!
//! PSNR is infinite for equal data. JSON has no such number: infinity is written as the string `"inf"`. A missing value
//! (a view left out, a mean over nothing) is NaN here and `null` in JSON.

use ndarray::{Array2, ArrayView2, ArrayView3, Axis};
use serde::{Deserialize, Serialize};
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Projections, Volume};
use trgs_core::loss::{Ssim, SsimTarget};
use trgs_core::numeric::elementary::log10;
use trgs_core::numeric::{reduce, threads};

/// Definitions of PSNR and SSIM of a volume with peak 1.
const OF_PEAK_1: [&str; 2] = ["psnr3d/peak1", "ssim3d/r2-slices"];
/// The same with the truth's range as their peak.
const OF_RANGE: [&str; 2] = ["psnr3d/truth-range", "ssim3d/truth-range-slices"];

/// A mean, the id of its definition, and the values that it is the mean of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metric {
    /// The mean. PSNR in dB; infinite when the data are equal, NaN when there is nothing to compare.
    #[serde(with = "number")]
    pub value: f64,
    /// Id of the definition, see the [module documentation](self).
    pub definition: String,
    /// The values that `value` is the mean of; NaN for each that is left out.
    ///
    /// They are indexed by axis x, y, z for `ssim_3d` and by view for the 2-D metrics. Empty for `psnr_3d`.
    #[serde(with = "numbers", default, skip_serializing_if = "Vec::is_empty")]
    pub detail: Vec<f64>,
}

/// The metrics of a reconstruction. A metric without its reference data is `None`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Peak signal-to-noise ratio of the volume, dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_3d: Option<Metric>,
    /// Structural similarity of the volume's slices.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ssim_3d: Option<Metric>,
    /// [`Self::psnr_3d`] with the truth's range as its peak, where the truth's maximum is not near 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_3d_range: Option<Metric>,
    /// [`Self::ssim_3d`] of volumes divided by the truth's range, where the truth's maximum is not near 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ssim_3d_range: Option<Metric>,
    /// Peak signal-to-noise ratio of the projections, dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_2d: Option<Metric>,
    /// Structural similarity of the projections.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ssim_2d: Option<Metric>,
}

/// Gives pairs of slabs across an axis to its argument, truth and result, in their order.
pub type Pairs<'a> = dyn FnMut(Axis, &mut dyn FnMut(ArrayView3<f32>, ArrayView3<f32>)) -> Result<()> + 'a;

impl Metrics {
    /// Column names in a table of metrics.
    pub const NAMES: [&'static str; 4] = ["psnr_3d", "ssim_3d", "psnr_2d", "ssim_2d"];
    /// Names of the metrics with the truth's range.
    pub const RANGE_NAMES: [&'static str; 2] = ["psnr_3d_range", "ssim_3d_range"];

    /// All metrics of a volume and of projections. The truth comes first in each pair.
    ///
    /// Volumes are `[x, y, z]`, projections `[view, v, u]`. A missing pair leaves its metrics out.
    ///
    /// # Errors
    /// When the shapes in a pair differ.
    pub fn compute(
        volumes: Option<(&Volume, &Volume)>,
        projections: Option<(&Projections, &Projections)>,
    ) -> Result<Self> {
        let mut metrics = Self::default();
        if let Some((truth, result)) = volumes {
            check_shapes("volume", truth.values.shape(), result.values.shape())?;
            metrics = Self::of_slabs(&mut |_, compare| {
                compare(truth.values.view(), result.values.view());
                Ok(())
            })?;
        }
        if let Some((truth, result)) = projections {
            check_shapes("projections", truth.images.shape(), result.images.shape())?;
            metrics.psnr_2d = Some(psnr_2d(truth.images.view(), result.images.view()));
            metrics.ssim_2d = Some(ssim_2d(truth.images.view(), result.images.view()));
        }
        Ok(metrics)
    }

    /// The metrics of a volume that is given by slabs of any thickness. They are the same bits for all.
    ///
    /// `pairs` is called for the range, and then for each axis.
    ///
    /// # Errors
    /// Those of `pairs`.
    ///
    /// # Panics
    /// When the shapes in a pair differ.
    pub fn of_slabs(pairs: &mut Pairs<'_>) -> Result<Self> {
        let mut ends = NO_ENDS;
        pairs(Axis(0), &mut |truth, _| ends = extended(ends, truth))?;
        let range = range_that_matters(ends);
        let peaks: Vec<f64> = [1.0].into_iter().chain(range).collect();
        let mut sums = vec![(Vec::new(), [const { Vec::new() }; 3]); peaks.len()];
        let mut voxels = 0;
        for axis in 0..3 {
            pairs(Axis(axis), &mut |truth, result| {
                for (peak, (errors, similarities)) in peaks.iter().zip(&mut sums) {
                    similarities[axis].extend(similarities_across(Axis(axis), truth, result, *peak));
                    if axis == 0 {
                        errors.extend(squared_errors(truth, result, *peak));
                    }
                }
                voxels += if axis == 0 { truth.len() } else { 0 };
            })?;
        }
        let mut metrics = sums.into_iter().zip([OF_PEAK_1, OF_RANGE]).map(|((errors, similarities), [psnr, ssim])| {
            [psnr_of(psnr, &errors, voxels), ssim_of(ssim, &similarities)]
        });
        let [psnr_3d, ssim_3d] = metrics.next().map_or([None, None], |both| both.map(Some));
        let [psnr_3d_range, ssim_3d_range] = metrics.next().map_or([None, None], |both| both.map(Some));
        Ok(Self { psnr_3d, ssim_3d, psnr_3d_range, ssim_3d_range, ..Self::default() })
    }

    /// The metrics in the order of [`Self::NAMES`].
    pub fn columns(&self) -> [Option<&Metric>; 4] {
        [&self.psnr_3d, &self.ssim_3d, &self.psnr_2d, &self.ssim_2d].map(Option::as_ref)
    }

    /// The metrics in the order of [`Self::RANGE_NAMES`].
    pub fn of_range(&self) -> [Option<&Metric>; 2] {
        [&self.psnr_3d_range, &self.ssim_3d_range].map(Option::as_ref)
    }

    /// The cells of a table row, in the order of [`Self::NAMES`]: dB with two decimals, SSIM with four.
    pub fn row(&self) -> [String; 4] {
        let mut decimals = [2, 4].into_iter().cycle();
        self.columns().map(|metric| {
            let decimals = decimals.next().expect("an endless cycle");
            match metric {
                Some(m) if !m.value.is_nan() => format!("{:.decimals$}", m.value),
                _ => "–".into(),
            }
        })
    }
}

/// PSNR of a volume with peak 1, in dB; `psnr3d/peak1`.
///
/// Not in the paper: it names the metric, R²-Gaussian defines it.
///
/// # Panics
/// When the shapes differ.
pub fn psnr_3d(truth: ArrayView3<f32>, result: ArrayView3<f32>) -> Metric {
    psnr_of_peak(OF_PEAK_1[0], truth, result, 1.0)
}

/// PSNR of a volume with peak `range`, in dB; `psnr3d/truth-range`.
///
/// Not in the paper, whose densities lie in [0, 1].
///
/// # Panics
/// When the shapes differ.
pub fn psnr_3d_range(truth: ArrayView3<f32>, result: ArrayView3<f32>, range: f64) -> Metric {
    psnr_of_peak(OF_RANGE[0], truth, result, range)
}

fn psnr_of_peak(definition: &str, truth: ArrayView3<f32>, result: ArrayView3<f32>, peak: f64) -> Metric {
    psnr_of(definition, &squared_errors(truth, result, peak), truth.len())
}

fn psnr_of(definition: &str, errors: &[f64], voxels: usize) -> Metric {
    Metric::new(definition, psnr(reduce::sum(errors) / voxels as f64), Vec::new())
}

/// The squared errors of the slices across x.
fn squared_errors(truth: ArrayView3<f32>, result: ArrayView3<f32>, peak: f64) -> Vec<f64> {
    assert_eq!(truth.shape(), result.shape(), "PSNR of volumes of different shapes");
    threads::map(truth.len_of(Axis(0)), |x| {
        squared_error(truth.index_axis(Axis(0), x), result.index_axis(Axis(0), x), peak, peak)
    })
}

/// Maximum less minimum of a volume; 0 for a constant volume. Not in the paper.
pub fn range(truth: ArrayView3<f32>) -> f64 {
    range_of(extended(NO_ENDS, truth))
}

/// Minimum and maximum of no values.
const NO_ENDS: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

/// Minimum and maximum of more values.
fn extended(ends: [f32; 2], values: ArrayView3<f32>) -> [f32; 2] {
    values.iter().fold(ends, |[low, high], &value| [low.min(value), high.max(value)])
}

fn range_of([low, high]: [f32; 2]) -> f64 {
    f64::from(high) - f64::from(low)
}

/// The range of a truth whose maximum is outside [½, 2], otherwise `None`.
fn range_that_matters([low, top]: [f32; 2]) -> Option<f64> {
    let range = range_of([low, top]);
    (!(0.5..=2.0).contains(&top) && range > 0.0 && range.is_finite()).then_some(range)
}

/// SSIM of a volume, slice by slice across each axis; `ssim3d/r2-slices`.
///
/// Not in the paper: it names the metric, R²-Gaussian defines it.
///
/// # Panics
/// When the shapes differ.
pub fn ssim_3d(truth: ArrayView3<f32>, result: ArrayView3<f32>) -> Metric {
    ssim_of_peak(OF_PEAK_1[1], truth, result, 1.0)
}

/// SSIM of a volume divided by `range`, slice by slice; `ssim3d/truth-range-slices`.
///
/// Not in the paper, whose densities lie in [0, 1].
///
/// # Panics
/// When the shapes differ.
pub fn ssim_3d_range(truth: ArrayView3<f32>, result: ArrayView3<f32>, range: f64) -> Metric {
    ssim_of_peak(OF_RANGE[1], truth, result, range)
}

fn ssim_of_peak(definition: &str, truth: ArrayView3<f32>, result: ArrayView3<f32>, peak: f64) -> Metric {
    ssim_of(definition, &[0, 1, 2].map(|axis| similarities_across(Axis(axis), truth, result, peak)))
}

fn ssim_of(definition: &str, similarities: &[Vec<f64>; 3]) -> Metric {
    let axes = [0, 1, 2].map(|axis| mean(&similarities[axis]));
    Metric::new(definition, mean(&axes), axes.to_vec())
}

/// SSIM of the slices across an axis; NaN for those that are left out.
fn similarities_across(axis: Axis, truth: ArrayView3<f32>, result: ArrayView3<f32>, peak: f64) -> Vec<f64> {
    assert_eq!(truth.shape(), result.shape(), "SSIM of volumes of different shapes");
    threads::map(truth.len_of(axis), |i| {
        let (truth, result) = (truth.index_axis(axis, i), result.index_axis(axis, i));
        if largest(truth) > 0.0 { ssim(truth, result, peak, peak) } else { f64::NAN }
    })
}

/// PSNR of projections, each divided by its own maximum, in dB; `psnr2d/selfmax`.
///
/// Not in the paper: it names the metric, R²-Gaussian defines it. An image of the result without a value above 0 is not
/// divided.
///
/// # Panics
/// When the shapes differ.
pub fn psnr_2d(truth: ArrayView3<f32>, result: ArrayView3<f32>) -> Metric {
    per_view("psnr2d/selfmax", truth, result, |truth, result, of_truth, of_result| {
        psnr(squared_error(truth, result, of_truth, of_result) / truth.len() as f64)
    })
}

/// SSIM of projections, each divided by its own maximum; `ssim2d/selfmax`.
///
/// Not in the paper: it names the metric, R²-Gaussian defines it. An image of the result without a value above 0 is not
/// divided.
///
/// # Panics
/// When the shapes differ.
pub fn ssim_2d(truth: ArrayView3<f32>, result: ArrayView3<f32>) -> Metric {
    per_view("ssim2d/selfmax", truth, result, ssim)
}

impl Metric {
    fn new(definition: &str, value: f64, detail: Vec<f64>) -> Self {
        Self { value, definition: definition.into(), detail }
    }
}

/// The mean over the views of `measure(truth, result, maximum of truth, maximum of result)`.
fn per_view(
    definition: &str,
    truth: ArrayView3<f32>,
    result: ArrayView3<f32>,
    measure: impl Fn(ArrayView2<f32>, ArrayView2<f32>, f64, f64) -> f64 + Sync + Send,
) -> Metric {
    assert_eq!(truth.shape(), result.shape(), "{definition} of projections of different shapes");
    let views = threads::map(truth.len_of(Axis(0)), |view| {
        let (truth, result) = (truth.index_axis(Axis(0), view), result.index_axis(Axis(0), view));
        let (of_truth, of_result) = (largest(truth), largest(result));
        if of_truth > 0.0 {
            measure(truth, result, of_truth, if of_result > 0.0 { of_result } else { 1.0 })
        } else {
            f64::NAN
        }
    });
    Metric::new(definition, mean(&views), views)
}

fn psnr(mean_squared_error: f64) -> f64 {
    -10.0 * log10(mean_squared_error)
}

/// `Σ (t/of_truth - r/of_result)²`
fn squared_error(truth: ArrayView2<f32>, result: ArrayView2<f32>, of_truth: f64, of_result: f64) -> f64 {
    let rows: Vec<f64> = (truth.rows().into_iter().zip(result.rows()))
        .map(|(truth, result)| {
            reduce::sum_by(truth.len(), &|i| {
                let difference = f64::from(truth[i]) / of_truth - f64::from(result[i]) / of_result;
                difference * difference
            })
        })
        .collect();
    reduce::sum(&rows)
}

fn ssim(truth: ArrayView2<f32>, result: ArrayView2<f32>, of_truth: f64, of_result: f64) -> f64 {
    let scaled = |image: ArrayView2<f32>, by: f64| -> Array2<f64> { image.mapv(|value| f64::from(value) / by) };
    let ssim = Ssim::default();
    ssim.value(scaled(result, of_result).view(), &SsimTarget::new(&ssim, scaled(truth, of_truth).view()))
}

fn largest(image: ArrayView2<f32>) -> f64 {
    image.iter().fold(f64::NEG_INFINITY, |largest, &value| largest.max(f64::from(value)))
}

/// Mean of the values that are not NaN; NaN when there is none.
fn mean(values: &[f64]) -> f64 {
    let present: Vec<f64> = values.iter().copied().filter(|v| !v.is_nan()).collect();
    reduce::sum(&present) / present.len() as f64
}

fn check_shapes(what: &str, truth: &[usize], result: &[usize]) -> Result<()> {
    if truth == result {
        return Ok(());
    }
    let remedy = "compare two results on the same grid and with the same views";
    Err(Error::invalid(what, format!("shape {result:?}"), format!("the truth's shape {truth:?}"), remedy))
}

/// JSON form of a number: infinity is `"inf"`, NaN is `null`.
mod number {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize, Deserialize)]
    #[serde(untagged)]
    pub(super) enum Json {
        Number(f64),
        Word(Infinity),
        Missing,
    }

    #[derive(Serialize, Deserialize)]
    pub(super) enum Infinity {
        #[serde(rename = "inf")]
        Positive,
        #[serde(rename = "-inf")]
        Negative,
    }

    pub(super) fn to_json(value: f64) -> Json {
        match value {
            f64::INFINITY => Json::Word(Infinity::Positive),
            f64::NEG_INFINITY => Json::Word(Infinity::Negative),
            v if v.is_nan() => Json::Missing,
            v => Json::Number(v),
        }
    }

    pub(super) fn from_json(json: Json) -> f64 {
        match json {
            Json::Number(v) => v,
            Json::Word(Infinity::Positive) => f64::INFINITY,
            Json::Word(Infinity::Negative) => f64::NEG_INFINITY,
            Json::Missing => f64::NAN,
        }
    }

    pub(super) fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        to_json(*value).serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        Json::deserialize(deserializer).map(from_json)
    }
}

/// JSON form of a list of such numbers.
mod numbers {
    use super::number::{Json, from_json, to_json};
    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(values: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(values.iter().map(|&v| to_json(v)))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
        Ok(Vec::<Json>::deserialize(deserializer)?.into_iter().map(from_json).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;
    use trgs_core::geometry::Grid;

    fn phantom(shape: (usize, usize, usize)) -> Array3<f32> {
        Array3::from_shape_fn(shape, |(x, y, z)| ((x * 5 + y * 3 + z * 7) % 11) as f32 / 10.0)
    }

    #[test]
    fn psnr_of_a_constant_error_of_a_tenth_is_20_db() {
        let truth = Array3::zeros((3, 4, 5));
        let metric = psnr_3d(truth.view(), (&truth + 0.1_f32).view());
        within!((metric.value - 20.0).abs(), "{}", metric.value);
        assert_eq!(metric.definition, "psnr3d/peak1");
    }

    #[test]
    fn a_truth_whose_peak_is_not_near_1_is_measured_by_its_range_too() {
        let volume = |values| Volume::new(Grid::cube(8), values).unwrap();
        let (truth, result) = (phantom((8, 8, 8)), phantom((8, 8, 8)).mapv(|v| v * v));
        let of = |k: f32| Metrics::compute(Some((&volume(&truth * k), &volume(&result * k))), None).unwrap();
        let near = of(1.0);
        assert_eq!(near.of_range(), [None, None]);
        for k in [1.0 / 1024.0, 4096.0] {
            let far = of(k);
            let [psnr, ssim] = far.of_range().map(Option::unwrap);
            assert_eq!(
                (psnr.definition.as_str(), ssim.definition.as_str()),
                ("psnr3d/truth-range", "ssim3d/truth-range-slices")
            );
            within!((psnr.value - near.psnr_3d.as_ref().unwrap().value).abs());
            within!((ssim.value - near.ssim_3d.as_ref().unwrap().value).abs());
            assert_ne!(far.psnr_3d, near.psnr_3d);
        }
        assert_eq!(of(0.0).of_range(), [None, None]);
    }

    #[test]
    fn slabs_of_any_thickness_give_the_same_bits() {
        let shape = [5, 8, 9];
        let (truth, result) = (phantom(shape.into()), phantom(shape.into()).mapv(|v| v * v));
        for k in [1.0, 1.0 / 1024.0] {
            let [truth, result] = [&truth * k, &result * k];
            let of = |thickness: usize| {
                Metrics::of_slabs(&mut |axis, compare| {
                    let slabs = truth.axis_chunks_iter(axis, thickness).zip(result.axis_chunks_iter(axis, thickness));
                    slabs.for_each(|(truth, result)| compare(truth, result));
                    Ok(())
                })
            };
            let whole = of(usize::MAX).unwrap();
            assert_eq!(whole.of_range().map(|metric| metric.is_some()), [k < 1.0; 2]);
            assert_eq!(whole.psnr_3d, Some(psnr_3d(truth.view(), result.view())));
            assert_eq!(whole.ssim_3d, Some(ssim_3d(truth.view(), result.view())));
            [1, 2, 4].iter().for_each(|thickness| assert_eq!(of(*thickness).unwrap(), whole));
        }
    }

    #[test]
    fn equal_data_have_infinite_psnr_and_similarity_one() {
        let data = phantom((4, 5, 6));
        assert_eq!(psnr_3d(data.view(), data.view()).value, f64::INFINITY);
        assert_eq!(psnr_2d(data.view(), data.view()).value, f64::INFINITY);
        within!((ssim_3d(data.view(), data.view()).value - 1.0).abs());
        within!((ssim_2d(data.view(), data.view()).value - 1.0).abs());
    }

    #[test]
    fn two_dimensional_metrics_are_blind_to_a_global_scale_and_the_others_are_not() {
        let (truth, result) = (phantom((4, 12, 9)), phantom((4, 12, 9)).mapv(|v| v * v));
        let scaled = result.mapv(|v| 4.0 * v);
        for metric in [psnr_2d, ssim_2d] {
            assert_eq!(metric(truth.view(), result.view()), metric(truth.view(), scaled.view()));
        }
        for metric in [psnr_3d, ssim_3d] {
            assert!(metric(truth.view(), result.view()).value > metric(truth.view(), scaled.view()).value);
        }
    }

    #[test]
    fn psnr_2d_of_two_pixels_is_that_computed_by_hand() {
        let truth = Array3::from_shape_vec((1, 1, 2), vec![2.0, 1.0]).unwrap();
        let result = Array3::from_shape_vec((1, 1, 2), vec![4.0, 1.0]).unwrap();
        // (1, ½) against (1, ¼): the mean squared error is 1/32.
        let metric = psnr_2d(truth.view(), result.view());
        within!((metric.value - 10.0 * log10(32.0)).abs());
        assert_eq!(metric.detail, [metric.value]);
    }

    #[test]
    fn views_and_slices_of_nothing_are_left_out_of_the_mean() {
        let mut truth = phantom((3, 8, 8));
        let result = phantom((3, 8, 8)).mapv(|v| 0.5 * v + 0.1);
        let whole = psnr_2d(truth.view(), result.view());
        truth.index_axis_mut(Axis(0), 1).fill(0.0);
        let metric = psnr_2d(truth.view(), result.view());
        assert!(metric.detail[1].is_nan());
        assert_eq!((metric.detail[0], metric.detail[2]), (whole.detail[0], whole.detail[2]));
        assert_eq!(metric.value, (metric.detail[0] + metric.detail[2]) / 2.0);
        // Across x one slice of three is left out, across y and z none.
        let of_slice = |i: usize| ssim(truth.index_axis(Axis(0), i), result.index_axis(Axis(0), i), 1.0, 1.0);
        assert_eq!(ssim_3d(truth.view(), result.view()).detail[0], (of_slice(0) + of_slice(2)) / 2.0);
    }

    #[test]
    fn ssim_3d_is_the_mean_over_the_axes_and_turns_with_the_volume() {
        let (truth, result) = (phantom((5, 14, 9)), phantom((5, 14, 9)).mapv(|v| v * 0.7));
        let metric = ssim_3d(truth.view(), result.view());
        within!((metric.value - metric.detail.iter().sum::<f64>() / 3.0).abs());
        let turned = ssim_3d(truth.view().permuted_axes([1, 2, 0]), result.view().permuted_axes([1, 2, 0]));
        for axis in 0..3 {
            within!("turned", (turned.detail[axis] - metric.detail[(axis + 1) % 3]).abs());
        }
    }

    #[test]
    fn a_result_of_zeros_gives_finite_metrics_and_a_truth_of_zeros_none() {
        let (data, zeros) = (phantom((3, 6, 6)), Array3::zeros((3, 6, 6)));
        assert!(psnr_2d(data.view(), zeros.view()).value.is_finite());
        assert!(ssim_2d(data.view(), zeros.view()).value.is_finite());
        assert!(psnr_2d(zeros.view(), data.view()).value.is_nan());
        assert!(ssim_3d(zeros.view(), data.view()).value.is_nan());
    }

    #[test]
    fn json_keeps_what_is_infinite_and_what_is_missing() {
        let mut truth = phantom((2, 4, 4));
        truth.index_axis_mut(Axis(0), 1).fill(0.0);
        let metrics = Metrics {
            psnr_2d: Some(psnr_2d(truth.view(), truth.view())),
            ssim_2d: Some(ssim_2d(truth.view(), truth.mapv(|v| v * v).view())),
            ..Metrics::default()
        };
        let json = serde_json::to_string(&metrics).unwrap();
        assert!(json.contains(r#""value":"inf","definition":"psnr2d/selfmax","detail":["inf",null]"#), "{json}");
        assert!(!json.contains("psnr_3d"));
        let back: Metrics = serde_json::from_str(&json).unwrap();
        assert_eq!(back.ssim_2d.unwrap().value, metrics.ssim_2d.unwrap().value);
        let psnr = back.psnr_2d.unwrap();
        assert_eq!(psnr.value, f64::INFINITY);
        assert!(psnr.detail[1].is_nan());
    }

    #[test]
    fn a_row_has_two_decimals_for_db_four_for_similarities_and_a_dash_for_what_is_missing() {
        let metrics = Metrics {
            psnr_3d: Some(Metric::new("psnr3d/peak1", 31.0349, Vec::new())),
            ssim_3d: Some(Metric::new("ssim3d/r2-slices", 0.87149, Vec::new())),
            psnr_2d: Some(Metric::new("psnr2d/selfmax", f64::NAN, Vec::new())),
            ..Metrics::default()
        };
        assert_eq!(metrics.row(), ["31.03", "0.8715", "–", "–"]);
    }

    #[test]
    fn volumes_of_different_shapes_are_refused_with_both_shapes() {
        let volume = |n| Volume::new(Grid::cube(n), Array3::zeros((n, n, n))).unwrap();
        let message = Metrics::compute(Some((&volume(3), &volume(4))), None).unwrap_err().to_string();
        assert!(message.contains("[4, 4, 4]") && message.contains("[3, 3, 3]"), "{message}");
    }
}
