//! Medians and quantiles. They ignore which half of the values is damaged.

/// Standard deviation of normal noise per median absolute deviation: `1/Φ⁻¹(3/4)`.
pub const SIGMA_OF_MAD: f64 = 1.482_602_218_505_602;
/// Standard error of a median of many normal values, in units of that of their mean: `√(π/2)`.
pub const ERROR_OF_MEDIAN: f64 = 1.253_314_137_315_500_1;
/// Share of normal values below the mean plus one standard deviation.
pub const ONE_SIGMA: f64 = 0.841_344_746_068_543;
/// Share of normal values within one standard deviation of the mean.
pub const WITHIN_ONE_SIGMA: f64 = 0.682_689_492_137_086;

/// The median; the mean of the two middle values for an even number; NaN for none. Sorts the values.
pub fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let half = values.len() / 2;
    match values {
        [] => f64::NAN,
        _ if values.len() % 2 == 1 => values[half],
        _ => 0.5 * (values[half - 1] + values[half]),
    }
}

/// The smallest value that at least the share `of` of all do not exceed; NaN for none. Sorts the values.
pub fn quantile(values: &mut [f64], of: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let rank = (of * values.len() as f64).ceil().max(1.0) as usize - 1;
    values.get(rank).copied().unwrap_or(f64::NAN)
}

/// Standard deviation of normal values of which less than half are damaged; NaN for none.
pub fn spread(values: &[f64]) -> f64 {
    let middle = median(&mut values.to_vec());
    SIGMA_OF_MAD * median(&mut values.iter().map(|value| (value - middle).abs()).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_values_may_be_damaged() {
        assert_eq!(median(&mut [3.0, 1.0, 1e30]), 3.0);
        assert_eq!(median(&mut [4.0, 1.0, 2.0, 1e30]), 3.0);
        assert!(median(&mut []).is_nan() && quantile(&mut [], 0.5).is_nan());
        assert_eq!(quantile(&mut [1.0, 2.0, 3.0, 4.0], 0.5), 2.0);
        assert_eq!(quantile(&mut [1.0, 2.0, 3.0, 4.0], 0.76), 4.0);
        assert_eq!(spread(&[1.0, 2.0, 3.0, 4.0, 1e30]), SIGMA_OF_MAD);
    }
}
