//! A summary as one self-contained HTML file.

use super::case::Case;
#[cfg(feature = "plots")]
use super::plot::{plot, targets};
use super::store::Store;
use super::summary::Summary;
use super::text::{number, ours, title, with_interval};
use crate::report::{document, escape};
use base64::prelude::{BASE64_STANDARD, Engine as _};
use std::fmt::Write;

impl Summary {
    /// The page as HTML. `cases` are those of the summary.
    ///
    /// Pictures show each case with its first seed, in the middle block.
    pub fn html(&self, cases: &[Case], store: &Store) -> String {
        let heading = self.heading();
        let mut content = String::new();
        for block in &self.blocks {
            content += &self.block(block);
        }
        #[cfg(feature = "plots")]
        for metric in &self.table.metrics {
            if let Some(svg) = plot(self, metric) {
                let _ = write!(content, "<section>\n<h2>{}</h2>\n{svg}\n", title(metric));
                content +=
                    "<p class=\"note\">Solid: ours, with the interval over seeds; dashed: the paper.</p>\n</section>\n";
            }
        }
        #[cfg(feature = "plots")]
        if let Some(svg) = targets(self) {
            let _ = write!(content, "<section>\n<h2>Confidence to target of ν</h2>\n{svg}\n</section>\n");
        }
        content += &self.pictures(cases, store);
        content += &self.appendix();
        let _ = write!(content, "<section>\n<h2>Provenance</h2>\n<p>{}</p>\n</section>\n", escape(&self.footer()));
        document(&heading, &self.conditions(), &content)
    }

    fn block(&self, block: &super::summary::Block) -> String {
        let mut head = String::from("<th></th>");
        for metric in &self.table.metrics {
            let _ = write!(head, "<th>{}</th><th>less {}</th><th>paper</th>", title(metric), escape(&self.table.full));
        }
        let mut body = String::new();
        for (row, figures) in self.table.rows.iter().zip(&block.figures) {
            let _ = write!(body, "<tr><th>{}</th>", escape(&row.name));
            for (metric, figure) in self.table.metrics.iter().zip(figures) {
                let class =
                    figure.rank.filter(|rank| *rank <= 3).map_or(String::new(), |r| format!(" class=\"best{r}\""));
                let difference = figure.difference.map_or(String::new(), |d| with_interval(Some(d), metric, true));
                let _ = write!(
                    body,
                    "<td{class}>{}</td><td>{difference}</td><td>{}</td>",
                    ours(figure, metric),
                    number(figure.paper, metric)
                );
            }
            body += "</tr>\n";
        }
        let mut notes = String::new();
        for (metric, agreement) in self.table.metrics.iter().zip(&block.agreement) {
            let _ = writeln!(notes, "<li>{}</li>", agreement.sentence(metric));
        }
        for remark in block.remarks(&self.table.rows) {
            let _ = writeln!(notes, "<li>{}</li>", escape(&remark));
        }
        format!(
            "<section>\n<h2>{}</h2>\n<div class=\"scroll\"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody></table></div>\n\
             <ul class=\"note\">\n{notes}</ul>\n</section>\n",
            escape(&block.title())
        )
    }

    /// For each case slices of the truth and of every row side by side, with the PSNR of each volume.
    fn pictures(&self, cases: &[Case], store: &Store) -> String {
        let Some(block) = self.blocks.get(self.blocks.len() / 2) else { return String::new() };
        let mut galleries = String::new();
        for case in cases {
            let figures = self.slices(case, block, store);
            if !figures.is_empty() {
                let (open, name) = (if galleries.is_empty() { " open" } else { "" }, escape(&case.name));
                let _ = writeln!(
                    galleries,
                    "<details{open}><summary>{name}</summary>\n<div class=\"slices\">\n{figures}</div></details>"
                );
            }
        }
        if galleries.is_empty() {
            return galleries;
        }
        format!(
            "<section>\n<h2>Slices, {}</h2>\n{galleries}<p class=\"note\">Across z in the middle; densities from 0 to 1 from \
             black to white; a picture leads to a page with all slices. Decibels are PSNR_3D of the whole volume.</p>\n</section>\n",
            escape(&block.title())
        )
    }

    fn slices(&self, case: &Case, block: &super::summary::Block, store: &Store) -> String {
        let mut figures = String::new();
        let mut add = |name: &str, psnr: Option<f64>, png: Vec<u8>, page: Option<String>| {
            let (data, name) = (BASE64_STANDARD.encode(png), escape(name));
            let psnr = psnr.map_or(String::new(), |value| format!(", {value:.2} dB"));
            let [link, end] =
                page.map_or_else(Default::default, |page| [format!("<a href=\"{page}\">"), "</a>".into()]);
            let _ = writeln!(
                figures,
                "<figure>{link}<img alt=\"{name}\" src=\"data:image/png;base64,{data}\">{end}\
                 <figcaption>{name}{psnr}</figcaption></figure>"
            );
        };
        let of_row = |row| Some((row, self.table.cell(row, case, self.scale, block.views, &block.noise, 0)?));
        let cells: Vec<_> = self.table.rows.iter().filter_map(of_row).collect();
        if let Some(png) = cells.first().and_then(|(_, cell)| store.picture_of_truth(cell)) {
            add("truth", None, png, None);
        }
        for (row, cell) in &cells {
            if let Some(png) = store.picture(cell) {
                let found = self.findings.iter().find(|finding| finding.id == cell.id);
                add(
                    &row.name,
                    found.and_then(|finding| finding.metrics.get("psnr_3d").copied()),
                    png,
                    store.page(cell),
                );
            }
        }
        figures
    }

    /// The figures of each case.
    fn appendix(&self) -> String {
        let mut html = String::from("<section>\n<h2>Each case</h2>\n");
        for (column, metric) in self.table.metrics.iter().enumerate() {
            for block in &self.blocks {
                let _ = write!(
                    html,
                    "<details><summary>{}, {}</summary>\n<div class=\"scroll\"><table>\n<thead><tr><th></th>",
                    title(metric),
                    escape(&block.title())
                );
                for case in &self.cases {
                    let _ = write!(html, "<th>{}</th>", escape(case));
                }
                html += "</tr></thead>\n<tbody>\n";
                for (row, figures) in self.table.rows.iter().zip(&block.figures).filter(|(row, _)| row.method.is_some())
                {
                    let _ = write!(html, "<tr><th>{}</th>", escape(&row.name));
                    for value in &figures[column].by_case {
                        let _ = write!(html, "<td>{}</td>", number(*value, metric));
                    }
                    html += "</tr>\n";
                }
                html += "</tbody></table></div></details>\n";
            }
        }
        html + "</section>\n"
    }
}
