//! A summary as CSV, Markdown and LaTeX.

use super::summary::{Agreement, Block, Estimate, Figure, Summary, decimals};
use super::table::TableRow;
use crate::words::counted;
use std::collections::BTreeSet;
use std::fmt::Write;

/// Titles of the metrics for display.
pub(super) fn title(metric: &str) -> &str {
    match metric {
        "psnr_3d" => "PSNR 3D",
        "ssim_3d" => "SSIM 3D",
        "psnr_2d" => "PSNR 2D",
        "ssim_2d" => "SSIM 2D",
        "unfinished" => "PSNR 3D before the finish",
        "primitives" => "Primitives at the end",
        _ => "Spearman’s ρ",
    }
}

/// A number with the decimals of its metric.
pub(super) fn number(value: Option<f64>, metric: &str) -> String {
    value.map_or_else(|| "–".into(), |value| format!("{value:.*}", decimals(metric)))
}

/// Our mean with its interval; if cells of the row are not finished, with the number of those that are.
pub(super) fn ours(figure: &Figure, metric: &str) -> String {
    let mean = with_interval(figure.ours, metric, false);
    let [finished, all] = figure.cells;
    if figure.is_partial() { format!("{mean} ({finished} of {all})") } else { mean }
}

/// A mean with half the width of its interval.
pub(super) fn with_interval(estimate: Option<Estimate>, metric: &str, signed: bool) -> String {
    let Some(Estimate { mean, interval }) = estimate else { return "–".into() };
    let digits = decimals(metric);
    let mean = if signed { format!("{mean:+.digits$}") } else { format!("{mean:.digits$}") };
    interval.map_or(mean.clone(), |(low, high)| format!("{mean} [{low:.digits$}, {high:.digits$}]"))
}

impl Block {
    /// A sentence on the mean of each metric that is no column and that some rows have: populations, ρ.
    pub(super) fn remarks(&self, rows: &[TableRow]) -> Vec<String> {
        let of_metric = |metric: &&str| {
            let means = self.others.iter().filter(|(_, name, _)| name == metric).filter_map(|(row, _, by_case)| {
                let values: Vec<f64> = by_case.iter().flatten().copied().collect();
                let mean = (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)?;
                Some(format!("{} {}", rows[*row].name, number(Some(mean), metric)))
            });
            let means: Vec<String> = means.collect();
            (!means.is_empty()).then(|| format!("{}: {}", title(metric), means.join("; ")))
        };
        ["primitives", "spearman"].iter().filter_map(of_metric).collect()
    }

    /// For example "18 views, low noise".
    pub(super) fn title(&self) -> String {
        format!("{} views, {} noise", self.views, self.noise)
    }
}

impl Agreement {
    /// A sentence on whether the paper's order and signs hold.
    pub(super) fn sentence(&self, metric: &str) -> String {
        let Self { pairs, pairs_kept, signs, signs_kept, unsure } = *self;
        if pairs + unsure == 0 {
            return format!("{}: no two rows that differ in the paper are finished", title(metric));
        }
        let beyond = match unsure {
            0 => String::new(),
            n => format!("; {} within two standard errors, not judged", counted(n, "pair")),
        };
        if pairs == 0 {
            return format!("{}: no two rows differ{beyond}", title(metric));
        }
        let all = |kept, of| if kept == of { "holds" } else { "does not hold" };
        let order = format!(
            "{}: the paper’s order {} ({pairs_kept} of {pairs} pairs{beyond})",
            title(metric),
            all(pairs_kept, pairs)
        );
        if signs == 0 {
            return format!("{order}; no row is compared with the full model");
        }
        format!(
            "{order}, the sign of differences to the full model {} ({signs_kept} of {signs})",
            all(signs_kept, signs)
        )
    }
}

impl Summary {
    /// The title, with the number in the paper.
    pub(super) fn heading(&self) -> String {
        let title = &self.table.title;
        self.table.number.map_or_else(|| title.clone(), |number| format!("Table {number}: {title}"))
    }

    /// A sentence on what the figures are means of, and at which size.
    pub fn conditions(&self) -> String {
        let (cases, seeds, size) = (self.cases.len(), self.seeds, self.scale.size);
        let spread = if seeds > 1 { "; in brackets the 95 % interval over seeds (stratified bootstrap)" } else { "" };
        let missing = match self.missing {
            0 => String::new(),
            1 => "; 1 cell is not finished".into(),
            n => format!("; {n} cells are not finished"),
        };
        let mut figures = self.blocks.iter().flat_map(|block| block.figures.iter().flatten());
        let partial = if figures.any(Figure::is_partial) {
            "; a mean over a part of a row’s cells says of how many, and is not ranked"
        } else {
            ""
        };
        let missing = missing + partial;
        let seeds = if seeds == 1 { "1 seed".into() } else { format!("{seeds} seeds") };
        let with =
            if self.table.set.is_empty() { String::new() } else { format!(", with {}", self.table.set.join(", ")) };
        let means = format!("Means over {cases} cases and {seeds}{with}");
        if !self.is_simulated {
            return format!("{means}{spread}{missing}.");
        }
        let views: Vec<usize> =
            self.blocks.iter().map(|block| block.views).collect::<BTreeSet<_>>().into_iter().collect();
        let rays = |&views: &usize| format!("{:.2}", self.scale.rays_per_voxel(views));
        format!(
            "{means} at {size}³ voxels, {}² pixels{spread}{missing}. Matched by {}: {} rays per voxel with {} views.",
            self.scale.detector(),
            self.scale.matching,
            views.iter().map(rays).collect::<Vec<_>>().join(", "),
            views.iter().map(usize::to_string).collect::<Vec<_>>().join(", "),
        )
    }

    /// CSV with one line per block, row and metric; rows with unfinished cells have no figures of ours.
    pub fn csv(&self) -> String {
        let header = "views noise row metric ours low high difference difference_low difference_high paper";
        let mut lines = vec![header.split(' ').map(str::to_owned).collect()];
        self.for_each(|block, row, metric, figure| {
            let plain = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.6}"));
            let ends = |estimate: Option<Estimate>| {
                let interval = estimate.and_then(|estimate| estimate.interval);
                [estimate.map(|e| e.mean), interval.map(|i| i.0), interval.map(|i| i.1)].map(plain)
            };
            let paper = number(figure.paper, metric).replace('–', "");
            let names = [block.views.to_string(), block.noise.clone(), row.into(), metric.into()];
            lines.push([&names[..], &ends(figure.complete()), &ends(figure.difference), &[paper]].concat());
        });
        written(&lines)
    }

    /// CSV with one line per block, row, metric and case: means over seeds.
    pub fn cases_csv(&self) -> String {
        let mut lines = vec![["views", "noise", "row", "metric", "case", "ours"].map(str::to_owned).into()];
        let mut add = |block: &Block, row: &str, metric: &str, by_case: &[Option<f64>]| {
            for (case, value) in self.cases.iter().zip(by_case) {
                if let Some(value) = value {
                    let (views, noise) = (block.views.to_string(), block.noise.clone());
                    lines.push(vec![views, noise, row.into(), metric.into(), case.clone(), format!("{value:.6}")]);
                }
            }
        };
        self.for_each(|block, row, metric, figure| add(block, row, metric, &figure.by_case));
        for block in &self.blocks {
            for (row, metric, by_case) in &block.others {
                add(block, &self.table.rows[*row].name, metric, by_case);
            }
        }
        written(&lines)
    }

    pub(super) fn for_each(&self, mut see: impl FnMut(&Block, &str, &str, &Figure)) {
        for block in &self.blocks {
            for (row, figures) in self.table.rows.iter().zip(&block.figures) {
                for (metric, figure) in self.table.metrics.iter().zip(figures) {
                    see(block, &row.name, metric, figure);
                }
            }
        }
    }

    /// Markdown; our three best are marked as far as Markdown can: bold, italic, underlined.
    pub fn markdown(&self) -> String {
        let mut text = format!("# {}\n\n{}\n", self.heading(), self.conditions());
        for block in &self.blocks {
            let _ = write!(text, "\n## {}\n\n|  |", block.title());
            for metric in &self.table.metrics {
                let _ = write!(text, " {0} | – {1} | paper |", title(metric), self.table.full);
            }
            let _ = write!(text, "\n|---|{}\n", "---|".repeat(3 * self.table.metrics.len()));
            for (row, figures) in self.table.rows.iter().zip(&block.figures) {
                let _ = write!(text, "| {} |", row.name);
                for (metric, figure) in self.table.metrics.iter().zip(figures) {
                    let ours = marked(ours(figure, metric), figure.rank, [["**", "**"], ["*", "*"], ["<u>", "</u>"]]);
                    let difference = figure.difference.map_or(String::new(), |d| with_interval(Some(d), metric, true));
                    let _ = write!(text, " {ours} | {difference} | {} |", number(figure.paper, metric));
                }
                text.push('\n');
            }
            text.push('\n');
            for (metric, agreement) in self.table.metrics.iter().zip(&block.agreement) {
                let _ = writeln!(text, "- {}", agreement.sentence(metric));
            }
            block.remarks(&self.table.rows).iter().for_each(|remark| text += &format!("- {remark}\n"));
        }
        let _ = write!(text, "\n{}\n", self.footer());
        text
    }

    /// LaTeX for `\input`; needs `booktabs`. Our three best are bold, underlined and italic.
    pub fn latex(&self) -> String {
        let columns = "rr".repeat(self.table.metrics.len());
        let mut text = format!("% {}\n\\begin{{tabular}}{{l{columns}}}\n\\toprule\n", self.footer());
        for metric in &self.table.metrics {
            let _ = write!(text, " & \\multicolumn{{2}}{{c}}{{{}}}", escaped(title(metric)));
        }
        text += " \\\\\n";
        text += &" & ours & paper".repeat(self.table.metrics.len());
        text += " \\\\\n";
        for block in &self.blocks {
            let span = 1 + 2 * self.table.metrics.len();
            let _ = write!(text, "\\midrule\n\\multicolumn{{{span}}}{{l}}{{{}}} \\\\\n", escaped(&block.title()));
            for (row, figures) in self.table.rows.iter().zip(&block.figures) {
                text += &escaped(&row.name);
                for (metric, figure) in self.table.metrics.iter().zip(figures) {
                    let ours = number(figure.complete().map(|estimate| estimate.mean), metric).replace('–', "--");
                    let ours =
                        marked(ours, figure.rank, ["\\textbf{", "\\underline{", "\\textit{"].map(|open| [open, "}"]));
                    let _ = write!(text, " & {ours} & {}", number(figure.paper, metric).replace('–', "--"));
                }
                text += " \\\\\n";
            }
        }
        text + "\\bottomrule\n\\end{tabular}\n"
    }

    /// The origin of the figures.
    pub fn footer(&self) -> String {
        let mut ids: Vec<String> =
            self.findings.iter().map(|finding| serde_json::to_string(finding).expect("string keys")).collect();
        ids.sort();
        let program = crate::provenance::commit().unwrap_or("not recorded");
        format!(
            "trgs {}, commit {program}; table {}, {} cells, SHA-256 of all of them {}",
            env!("CARGO_PKG_VERSION"),
            self.table.name,
            ids.len(),
            crate::provenance::digest_bytes(ids.concat().as_bytes())
        )
    }
}

/// A text between the marks of its rank, which counts from 1.
fn marked(text: String, rank: Option<usize>, marks: [[&str; 2]; 3]) -> String {
    match rank.and_then(|rank| marks.get(rank - 1)) {
        Some([open, close]) => format!("{open}{text}{close}"),
        None => text,
    }
}

/// A cell that no spreadsheet takes for a formula: the name of a file may begin like one. Numbers stay.
fn harmless(cell: &str) -> String {
    let begins = cell.starts_with(['=', '+', '-', '@', '\t', '\r']);
    if begins && cell.parse::<f64>().is_err() { format!("'{cell}") } else { cell.into() }
}

fn written(lines: &[Vec<String>]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    lines
        .iter()
        .for_each(|line| writer.write_record(line.iter().map(|cell| harmless(cell))).expect("memory takes all"));
    String::from_utf8(writer.into_inner().expect("memory takes all")).expect("text")
}

/// Text escaped for LaTeX.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' | '%' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            'τ' => out += "$\\tau$",
            'η' => out += "$\\eta$",
            'ρ' => out += "$\\rho$",
            '²' => out += "$^2$",
            '’' => out.push('\''),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::written;

    #[test]
    fn no_name_is_a_formula_and_numbers_stay() {
        let line = ["=1+1", "+x", "-x", "@x", "-1.5", "+2e3", "a=b", ""].map(String::from);
        assert_eq!(written(&[line.into()]), "'=1+1,'+x,'-x,'@x,-1.5,+2e3,a=b,\n");
    }
}
