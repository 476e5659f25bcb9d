//! Summary of a table's cells: means, intervals, differences, and agreement with the paper.

use super::METRICS;
use super::case::Case;
use super::cell::Finding;
use super::scale::Scale;
use super::store::Store;
use super::table::Table;
use crate::error::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Resamples of the bootstrap.
const RESAMPLES: usize = 2000;
/// Fraction of the resamples outside the interval at each end.
const TAIL: f64 = 0.025;

/// A table with our figures.
#[derive(Clone, Debug)]
pub struct Summary {
    /// The table summarised.
    pub table: Table,
    /// Names of the cases that means are over.
    pub cases: Vec<String>,
    /// Number of seeds per case.
    pub seeds: u64,
    /// The size of all cells.
    pub scale: Scale,
    /// Whether all scans are simulated, at that size.
    pub is_simulated: bool,
    /// One block for each number of views and level of noise.
    pub blocks: Vec<Block>,
    /// Number of unfinished cells.
    pub missing: usize,
    /// Results of the finished cells.
    pub findings: Vec<Finding>,
}

/// The rows of a table for one number of views and one level of noise.
#[derive(Clone, Debug)]
pub struct Block {
    /// Number of training views.
    pub views: usize,
    /// Level of noise.
    pub noise: String,
    /// Indexed by row of the table, then by metric.
    pub figures: Vec<Vec<Figure>>,
    /// Indexed by metric.
    pub agreement: Vec<Agreement>,
    /// Of each row and each of [`METRICS`] that is no column: the means over seeds, one per case.
    pub others: Vec<(usize, &'static str, Vec<Option<f64>>)>,
}

/// A row's value for a metric.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figure {
    /// Our mean over the finished cells.
    pub ours: Option<Estimate>,
    /// Number of finished cells, and of all cells of the row.
    pub cells: [usize; 2],
    /// Our difference from the full model, over pairs of cells; only with all cells of both.
    pub difference: Option<Estimate>,
    /// The figure printed in the paper.
    pub paper: Option<f64>,
    /// Rank among our figures in the block that have all cells; 1 is the best.
    pub rank: Option<usize>,
    /// Means over seeds, one per case.
    pub by_case: Vec<Option<f64>>,
}

impl Figure {
    /// Whether some cells of the row are finished and others are not.
    pub fn is_partial(&self) -> bool {
        (1..self.cells[1]).contains(&self.cells[0])
    }

    /// Our mean, if all cells of the row are finished: means over other cells cannot be compared.
    pub fn complete(&self) -> Option<Estimate> {
        self.ours.filter(|_| !self.is_partial())
    }
}

/// A mean over cases and seeds, with its 95 % interval.
///
/// The interval contains 95 % of 2,000 resamples of the seeds within each case (stratified bootstrap); there is none
/// for a single seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Mean over cases of means over seeds.
    pub mean: f64,
    /// Both ends of the interval.
    pub interval: Option<(f64, f64)>,
}

/// Agreement of the order and signs of our figures with those of the paper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Number of pairs of rows that differ in the paper, and here by more than their error.
    pub pairs: usize,
    /// Number of those pairs that have the same order here.
    pub pairs_kept: usize,
    /// Number of pairs with the full model among them.
    pub signs: usize,
    /// Number of those that differ with the same sign here.
    pub signs_kept: usize,
    /// Number of pairs that differ in the paper, and here by less than two standard errors over the cases.
    pub unsure: usize,
}

impl Summary {
    /// Summarises the finished cells.
    ///
    /// # Errors
    /// When a file of a cell is damaged.
    pub fn new(table: &Table, cases: &[Case], scale: Scale, seeds: u64, store: &Store) -> Result<Self> {
        let mut summary = Self {
            table: table.clone(),
            cases: cases.iter().map(|case| case.name.clone()).collect(),
            seeds,
            scale,
            is_simulated: cases.iter().all(Case::takes_noise),
            blocks: Vec::new(),
            missing: 0,
            findings: Vec::new(),
        };
        for &views in &table.views {
            for level in &table.noise {
                // [row][case][seed], and the numbers of finished cells and of all cells of each row.
                let mut found: Vec<Vec<Vec<Option<Finding>>>> = Vec::new();
                let mut cells = Vec::new();
                for row in &table.rows {
                    let (mut of_row, mut count) = (Vec::new(), [0, 0]);
                    for case in cases {
                        let mut of_case = Vec::new();
                        for seed in 0..seeds {
                            let finding = match table.cell(row, case, scale, views, level, seed) {
                                Some(cell) => {
                                    let finding = store.find(&cell.id)?;
                                    count[0] += usize::from(finding.is_some());
                                    count[1] += 1;
                                    finding
                                }
                                None => None,
                            };
                            summary.findings.extend(finding.clone());
                            of_case.push(finding);
                        }
                        of_row.push(of_case);
                    }
                    found.push(of_row);
                    summary.missing += count[1] - count[0];
                    cells.push(count);
                }
                summary.blocks.push(Block::new(table, views, level, &found, &cells));
            }
        }
        Ok(summary)
    }
}

impl Block {
    fn new(
        table: &Table,
        views: usize,
        noise: &str,
        found: &[Vec<Vec<Option<Finding>>>],
        cells: &[[usize; 2]],
    ) -> Self {
        let is_complete = |row: usize| cells[row][0] == cells[row][1];
        let full = table.rows.iter().position(|row| row.name == table.full).expect("a row of the table");
        let mut figures: Vec<Vec<Figure>> = vec![Vec::new(); table.rows.len()];
        let values = |row: usize, metric: &str| -> Vec<Vec<Option<f64>>> {
            let value = |finding: &Option<Finding>| finding.as_ref()?.metrics.get(metric).copied();
            found[row].iter().map(|seeds| seeds.iter().map(value).collect()).collect()
        };
        let by_case = |values: &[Vec<Option<f64>>]| values.iter().map(|s| mean(s.iter().flatten().copied())).collect();
        for metric in &table.metrics {
            let of_full = values(full, metric);
            for (number, row) in table.rows.iter().enumerate() {
                let values = values(number, metric);
                let pairs = values.iter().zip(&of_full).map(|(ours, full)| {
                    ours.iter().zip(full).map(|(ours, full)| Some((*ours)? - (*full)?)).collect::<Vec<_>>()
                });
                let is_comparable = number != full && is_complete(number) && is_complete(full);
                let difference = if is_comparable { estimate(&pairs.collect::<Vec<_>>()) } else { None };
                figures[number].push(Figure {
                    ours: estimate(&values),
                    cells: cells[number],
                    difference,
                    paper: table.printed(row, views, noise, metric),
                    rank: None,
                    by_case: by_case(&values),
                });
            }
        }
        for column in 0..table.metrics.len() {
            let ours = |row: &[Figure]| row[column].complete().map(|estimate| estimate.mean);
            let all: Vec<Option<f64>> = figures.iter().map(|row| ours(row)).collect();
            for (row, value) in figures.iter_mut().zip(&all) {
                row[column].rank = value.map(|value| 1 + all.iter().flatten().filter(|other| **other > value).count());
            }
        }
        let agreement = (0..table.metrics.len()).map(|column| Agreement::new(&figures, column, full)).collect();
        let others = METRICS.into_iter().filter(|metric| table.metrics.iter().all(|column| column != metric));
        let of_rows = |metric| (0..table.rows.len()).map(move |row| (row, metric));
        let others =
            others.flat_map(of_rows).map(|(row, metric)| (row, metric, by_case(&values(row, metric)))).collect();
        Self { views, noise: noise.into(), figures, agreement, others }
    }
}

impl Agreement {
    fn new(figures: &[Vec<Figure>], column: usize, full: usize) -> Self {
        let both = |row: usize| Some((figures[row][column].complete()?.mean, figures[row][column].paper?));
        let mut agreement = Self::default();
        for a in 0..figures.len() {
            for b in a + 1..figures.len() {
                let (Some((ours_a, paper_a)), Some((ours_b, paper_b))) = (both(a), both(b)) else { continue };
                if paper_a == paper_b {
                    continue;
                }
                if is_unsure(&figures[a][column].by_case, &figures[b][column].by_case) {
                    agreement.unsure += 1;
                    continue;
                }
                let kept = usize::from((ours_a > ours_b) == (paper_a > paper_b) && ours_a != ours_b);
                agreement.pairs += 1;
                agreement.pairs_kept += kept;
                if a == full || b == full {
                    agreement.signs += 1;
                    agreement.signs_kept += kept;
                }
            }
        }
        agreement
    }
}

/// Whether two rows differ by less than two standard errors of the differences of their cases; not said of one case.
fn is_unsure(a: &[Option<f64>], b: &[Option<f64>]) -> bool {
    let differences: Vec<f64> = a.iter().zip(b).filter_map(|(a, b)| Some((*a)? - (*b)?)).collect();
    let count = differences.len() as f64;
    let Some(middle) = mean(differences.iter().copied()) else { return false };
    let squares: f64 = differences.iter().map(|difference| (difference - middle) * (difference - middle)).sum();
    differences.len() > 1 && middle.abs() < 2.0 * (squares / (count - 1.0) / count).sqrt()
}

/// Estimate from `[case][seed]` over the values present; `None` without any.
fn estimate(values: &[Vec<Option<f64>>]) -> Option<Estimate> {
    let cases: Vec<Vec<f64>> = values.iter().map(|seeds| seeds.iter().flatten().copied().collect()).collect();
    let cases: Vec<Vec<f64>> = cases.into_iter().filter(|seeds: &Vec<f64>| !seeds.is_empty()).collect();
    let over_cases = |of: &mut dyn FnMut(&[f64]) -> Option<f64>| mean(cases.iter().filter_map(|seeds| of(seeds)));
    let centre = over_cases(&mut |seeds| mean(seeds.iter().copied()))?;
    if cases.iter().any(|seeds| seeds.len() < 2) {
        return Some(Estimate { mean: centre, interval: None });
    }
    // The seed is fixed, so that equal cells give equal tables.
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let mut resamples: Vec<f64> = (0..RESAMPLES)
        .filter_map(|_| {
            over_cases(&mut |seeds| mean((0..seeds.len()).map(|_| seeds[random.random_range(0..seeds.len())])))
        })
        .collect();
    resamples.sort_by(f64::total_cmp);
    let cut = (TAIL * resamples.len() as f64) as usize;
    Some(Estimate { mean: centre, interval: Some((resamples[cut], resamples[resamples.len() - 1 - cut])) })
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Number of decimals that a metric is printed with.
pub(super) fn decimals(metric: &str) -> usize {
    debug_assert!(METRICS.contains(&metric), "{metric}");
    match metric {
        "primitives" => 0,
        "psnr_3d" | "psnr_2d" | "unfinished" => 2,
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_weighs_cases_alike_and_its_interval_is_that_of_the_seeds() {
        let values = [vec![Some(1.0), Some(3.0), None], vec![Some(10.0), Some(10.0), Some(10.0)]];
        let Estimate { mean, interval } = estimate(&values).unwrap();
        assert_eq!(mean, 6.0);
        // Only two seeds of one case vary: their mean is 1, 2 or 3, so the total is 5.5, 6 or 6.5.
        assert_eq!(interval, Some((5.5, 6.5)));
        assert_eq!(estimate(&[vec![Some(1.0)], vec![Some(2.0), Some(3.0)]]).unwrap().interval, None);
        assert_eq!(estimate(&[vec![None], vec![]]), None);
    }

    #[test]
    fn an_interval_is_as_wide_as_the_mean_is_uncertain() {
        // 16 seeds with a standard deviation of 1: the mean has 1/4, and 95 % of a normal distribution lie within 1.96.
        let seeds: Vec<Option<f64>> = (0..16).map(|i| Some(if i % 2 == 0 { 1.0 } else { -1.0 })).collect();
        let (low, high) = estimate(&[seeds]).unwrap().interval.unwrap();
        within!((high - low - 2.0 * 1.96 / 4.0).abs(), "{low} {high}");
    }

    #[test]
    fn agreement_counts_pairs_in_the_papers_order() {
        let figure = |ours, paper| {
            vec![Figure {
                ours: Some(Estimate { mean: ours, interval: None }),
                paper: Some(paper),
                ..Figure::default()
            }]
        };
        // The paper's order is a < b < c = d; ours a < c < b < d.
        let mut figures = [figure(1.0, 1.0), figure(3.0, 2.0), figure(2.0, 3.0), figure(4.0, 3.0)];
        let agreement = Agreement::new(&figures, 0, 3);
        assert_eq!((agreement.pairs, agreement.pairs_kept), (5, 4));
        assert_eq!((agreement.signs, agreement.signs_kept), (2, 2));
        // A mean over a part of the cells is compared with none.
        figures[3][0].cells = [1, 2];
        let agreement = Agreement::new(&figures, 0, 3);
        assert_eq!((agreement.pairs, agreement.pairs_kept, agreement.signs), (3, 2, 0));
        let sentence = agreement.sentence("psnr_3d");
        assert!(sentence.contains("(2 of 3 pairs); no row") && !sentence.contains("0 of 0"), "{sentence}");
        assert!(!Agreement::default().sentence("psnr_3d").contains("holds"));
        figures[3][0].cells = [0, 0];
        // By case, a and b differ by 1 ± 1, a and c by 2 ± 0.
        let by_case = [[0.0, 2.0], [3.0, 3.0], [2.0, 4.0], [4.0, 4.0]];
        for (row, values) in figures.iter_mut().zip(by_case) {
            row[0].by_case = values.map(Some).to_vec();
        }
        let unsure = Agreement::new(&figures, 0, 3);
        assert!(!is_unsure(&figures[0][0].by_case, &figures[2][0].by_case) && unsure.unsure > 0);
        assert_eq!(unsure.pairs + unsure.unsure, 5);
        assert!(unsure.sentence("psnr_3d").contains("within two standard errors, not judged"));
    }
}
