//! The images of a page: for each axis, slices of the truth, of each result and of their differences.

use super::slice::{AXES, Cut, Palette, Picture, Window, reach, short};
use super::{escape, section};
use crate::error::{Error, Result};
use crate::geometry::Volume;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ndarray::Array2;
use std::fmt::Write;

/// Volumes on one grid, displayed with one grey window and one range of differences.
pub(super) struct Gallery<'a> {
    truth: Option<&'a Volume>,
    pub(super) results: Vec<(&'a str, &'a Volume)>,
    /// The truth, or else the first result; it determines cuts and window.
    pub(super) reference: &'a Volume,
    pub(super) cuts: [Cut; 3],
    pub(super) window: Window,
    /// Result minus truth, `[result][axis]`; empty without a truth.
    pub(super) differences: Vec<[Array2<f32>; 3]>,
    pub(super) reach: f64,
}

impl<'a> Gallery<'a> {
    /// Chooses cuts and ranges; `None` without any volume.
    ///
    /// # Errors
    /// When the volumes differ in shape.
    pub(super) fn new(truth: Option<&'a Volume>, results: Vec<(&'a str, &'a Volume)>) -> Result<Option<Self>> {
        let Some(reference) = truth.or(results.first().map(|&(_, volume)| volume)) else { return Ok(None) };
        let expected = reference.grid.shape;
        if let Some((name, volume)) = results.iter().find(|(_, volume)| volume.grid.shape != expected) {
            let (got, remedy) = (format!("{:?} voxels", volume.grid.shape), "show volumes on one grid");
            return Err(Error::invalid(format!("volume of {name}"), got, format!("{expected:?}"), remedy));
        }
        let cuts = Cut::through_detail(reference);
        let difference = |truth, volume| cuts.map(|cut| cut.values(volume) - cut.values(truth));
        let differences: Vec<_> =
            truth.iter().flat_map(|truth| results.iter().map(|(_, volume)| difference(truth, volume))).collect();
        let (window, reach) = (Window::of(reference), reach(differences.iter().flatten()));
        Ok(Some(Self { truth, results, reference, cuts, window, differences, reach }))
    }

    /// The section of the page as HTML.
    pub(super) fn html(&self) -> String {
        let mut html = self.explanation();
        // One method: truth, result and difference in a row. Several: each difference stands below its method, and the
        // legends stand below the truth.
        let stacked = self.differences.len() > 1;
        let legends = format!("<div class=\"legends\">{}</div>\n", self.legends());
        if !stacked {
            html += &legends;
        }
        let is_line =
            |cut: &Cut| <[usize; 2]>::from(cut.plane()).map(|axis| self.reference.grid.shape[axis]).contains(&1);
        // Of a volume of one slice, that slice alone is shown.
        let shown = self.cuts.iter().filter(|cut| !is_line(cut) || self.cuts.iter().all(is_line));
        for &cut in shown {
            let (axis, position) = (AXES[cut.axis], short(cut.position(self.reference)));
            let (number, count) = (cut.index + 1, self.reference.grid.shape[cut.axis]);
            let place = format!("at {axis} = {position}, voxel {number} of {count}");
            let (pictures, differences) = (self.pictures(cut), self.difference_pictures(cut));
            let columns = if stacked { pictures.len() } else { pictures.len() + differences.len() };
            let between = if stacked { legends.as_str() } else { "" };
            let (above, below) = (pictures.concat(), differences.concat());
            let _ = writeln!(html, "<h3>Across {axis} <span>{place}</span></h3>");
            let _ =
                writeln!(html, "<div class=\"panels\" style=\"--columns:{columns}\">\n{above}{between}{below}</div>");
        }
        section("Slices", &html)
    }

    fn explanation(&self) -> String {
        let (low, high, reach) = (short(self.window.low), short(self.window.high), short(self.reach));
        let whose = escape(self.truth.map_or_else(|| self.results[0].0, |_| "truth"));
        let mut text = format!(
            "<p>Each row cuts the volume across one axis, where the {whose} has most detail. All are drawn in one grey \
             window: black is {low}, white is {high}, the 99.9th percentile of the {whose}."
        );
        if !self.differences.is_empty() {
            let _ = write!(
                text,
                " A difference is the reconstruction minus the truth: <span class=\"more\">red</span> where it is too \
                 dense, <span class=\"less\">blue</span> where it is not dense enough, pale where it is right. Colours \
                 are full from ±{reach} on, the 99.5th percentile."
            );
        }
        text + "</p>\n"
    }

    fn legends(&self) -> String {
        let grey = legend("density", Palette::Grey, self.window.low, self.window.high);
        if self.differences.is_empty() {
            return grey;
        }
        grey + &legend("difference", Palette::Diverging, -self.reach, self.reach)
    }

    /// Images of truth and results in grey.
    fn pictures(&self, cut: Cut) -> Vec<String> {
        let volumes = self.truth.map(|truth| ("Truth", truth)).into_iter().chain(self.results.iter().copied());
        let picture = |volume| Picture::grey(&cut.values(volume), self.window);
        volumes.map(|(name, volume)| self.figure(&picture(volume), cut, name, "")).collect()
    }

    fn difference_pictures(&self, cut: Cut) -> Vec<String> {
        let named = self.results.iter().zip(&self.differences);
        let figure = |((name, _), differences): (&(&str, &Volume), &[Array2<f32>; 3])| {
            let values = &differences[cut.axis];
            let mean_square = values.mapv(|d| f64::from(d) * f64::from(d)).mean().unwrap_or(0.0);
            let note = format!("RMS {}", short(mean_square.sqrt()));
            self.figure(&Picture::diverging(values, self.reach), cut, &format!("{name} − truth"), &note)
        };
        named.map(figure).collect()
    }

    /// An image between its axes, with a caption.
    fn figure(&self, picture: &Picture, cut: Cut, caption: &str, note: &str) -> String {
        let (right, up) = cut.plane();
        let (name_right, name_up, name_across) = (AXES[right], AXES[up], AXES[cut.axis]);
        let grid = &self.reference.grid;
        let (min, max) = (grid.min, grid.max());
        let [left, right_end, bottom, top] = [min[right], max[right], min[up], max[up]].map(short);
        let (caption, source) = (escape(caption), data_uri(picture));
        let aspect = grid.size()[right] / grid.size()[up];
        format!(
            "<figure><div class=\"frame\">\
             <div class=\"up\"><span>{top}</span><i>{name_up}</i><span>{bottom}</span></div>\
             <img src=\"{source}\" alt=\"{caption}, slice across {name_across}\" style=\"aspect-ratio:{aspect:.4}\">\
             <div class=\"right\"><span>{left}</span><i>{name_right}</i><span>{right_end}</span></div></div>\
             <figcaption>{caption} <span class=\"note\">{note}</span></figcaption></figure>\n"
        )
    }
}

/// A colour bar with the values of both ends below it.
fn legend(what: &str, palette: Palette, low: f64, high: f64) -> String {
    let indices = Array2::from_shape_fn((1, palette.colours()), |(_, index)| index as u8);
    let (bar, low, high) = (data_uri(&Picture { indices, palette }), short(low), short(high));
    format!(
        "<div class=\"legend\">{what}<img src=\"{bar}\" alt=\"from {low} to {high}\">\
         <div class=\"right\"><span>{low}</span><span>{high}</span></div></div>"
    )
}

fn data_uri(picture: &Picture) -> String {
    format!("data:image/png;base64,{}", STANDARD.encode(picture.png()))
}
