//! One PNG file with slices of a truth, of reconstructions and of their differences: a figure for a page or a paper.

use super::font;
use super::gallery::Gallery;
use super::slice::{AXES, Palette, Picture, encode, short};
use crate::error::Result;
use crate::scene::Volume;
use ndarray::Array2;

/// Pixels between panels and around them.
const GAP: usize = 10;
/// Pixels of a dot of the letters.
const DOT: usize = 2;
/// Height of a line of text with the space below it, pixels.
const LINE: usize = (font::HEIGHT + 3) * DOT;
/// Width and height of a colour bar, pixels.
const BAR: (usize, usize) = (128, font::HEIGHT * DOT);
const INK: [u8; 3] = [40, 44, 52];

/// A PNG file with one row per axis: the truth, then each result and its difference to the truth.
///
/// `results` are (name, volume). The slices are those of [`Cut::through_detail`] of the truth; all share one grey window
/// and one range of differences, both written below. `side` is the length of the volume's longest side in pixels;
/// voxels keep their proportions and have hard edges.
///
/// [`Cut::through_detail`]: super::slice::Cut::through_detail
///
/// # Errors
/// When a result has another shape than the truth.
pub fn contact_sheet(truth: &Volume, results: &[(&str, &Volume)], side: usize) -> Result<Vec<u8>> {
    let gallery = Gallery::new(Some(truth), results.to_vec())?.expect("there is a truth");
    let (cuts, window, reach) = (gallery.cuts, gallery.window, gallery.reach);
    let size = truth.grid.size();
    let pixels = |axis: usize| ((size[axis] / size.max_element() * side as f64).round() as usize).max(1);
    let column = cuts.iter().map(|cut| pixels(cut.plane().0)).max().unwrap_or(0) + GAP;
    let heights = cuts.map(|cut| pixels(cut.plane().1) + LINE + GAP);
    let width = GAP + column * (1 + 2 * results.len());
    let mut canvas = Canvas::new(width, 3 * GAP + LINE + heights.iter().sum::<usize>() + LINE);

    canvas.text(GAP, GAP, "truth");
    for (number, (name, _)) in results.iter().enumerate() {
        canvas.text(GAP + column * (1 + 2 * number), GAP, name);
        canvas.text(GAP + column * (2 + 2 * number), GAP, "difference");
    }
    let mut top = 2 * GAP + LINE;
    for (axis, cut) in cuts.iter().enumerate() {
        let (right, up) = cut.plane();
        let panel = (pixels(right), pixels(up));
        let place = short(cut.position(truth));
        canvas.text(GAP, top, &format!("{} = {place}: {} right, {} up", AXES[axis], AXES[right], AXES[up]));
        let mut draw =
            |place: usize, picture: &Picture| canvas.picture((GAP + column * place, top + LINE), panel, picture);
        draw(0, &Picture::grey(&cut.values(truth), window));
        for (number, (_, volume)) in results.iter().enumerate() {
            draw(1 + 2 * number, &Picture::grey(&cut.values(volume), window));
            draw(2 + 2 * number, &Picture::diverging(&gallery.differences[number][axis], reach));
        }
        top += heights[axis];
    }
    let next = canvas.bar((GAP, top), Palette::Grey, &short(window.low), &short(window.high));
    canvas.bar((next, top), Palette::Diverging, &short(-reach), &short(reach));
    Ok(canvas.png())
}

/// A white page of RGB pixels.
struct Canvas {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Canvas {
    fn new(width: usize, height: usize) -> Self {
        Self { width, height, rgb: vec![255; 3 * width * height] }
    }

    /// Colours one pixel; nothing outside of the page.
    fn set(&mut self, x: usize, y: usize, colour: [u8; 3]) {
        if x < self.width && y < self.height {
            self.rgb[3 * (y * self.width + x)..][..3].copy_from_slice(&colour);
        }
    }

    /// A picture stretched over a panel without smoothing.
    fn picture(&mut self, (left, top): (usize, usize), (width, height): (usize, usize), picture: &Picture) {
        let (rows, columns) = picture.indices.dim();
        for y in 0..height {
            for x in 0..width {
                let index = picture.indices[[y * rows / height, x * columns / width]];
                self.set(left + x, top + y, picture.palette.colour(index));
            }
        }
    }

    /// A line of text; returns where it ends.
    fn text(&mut self, left: usize, top: usize, text: &str) -> usize {
        for (column, row) in font::dots(text) {
            for (x, y) in (0..DOT * DOT).map(|i| (i % DOT, i / DOT)) {
                self.set(left + column * DOT + x, top + row * DOT + y, INK);
            }
        }
        left + text.chars().count() * font::ADVANCE * DOT
    }

    /// A colour bar between the values of its ends; returns where the next one may begin.
    fn bar(&mut self, (left, top): (usize, usize), palette: Palette, low: &str, high: &str) -> usize {
        let left = self.text(left, top, low) + GAP / 2;
        let indices = Array2::from_shape_fn((1, palette.colours()), |(_, index)| index as u8);
        self.picture((left, top), BAR, &Picture { indices, palette });
        self.text(left + BAR.0 + GAP / 2 + DOT, top, high) + 2 * GAP
    }

    fn png(&self) -> Vec<u8> {
        encode(self.width, self.height, png::ColorType::Rgb, None, &self.rgb)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::DVec3;
    use ndarray::Array3;

    fn decode(file: &[u8]) -> (usize, usize, Vec<u8>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        (info.width as usize, info.height as usize, pixels)
    }

    #[test]
    fn panels_keep_the_proportions_of_the_voxels_and_a_perfect_result_has_a_white_difference() {
        let grid = Grid { shape: [4, 4, 4], min: DVec3::NEG_ONE, spacing: DVec3::new(0.5, 0.5, 0.25) };
        let truth = Volume::new(grid, Array3::from_shape_fn((4, 4, 4), |(x, y, z)| (x + y * z) as f32)).unwrap();
        let (width, height, pixels) = decode(&contact_sheet(&truth, &[("copy", &truth)], 80).unwrap());
        assert_eq!(width, GAP + 3 * (80 + GAP));
        assert_eq!(height, 3 * GAP + 2 * LINE + 3 * (LINE + GAP) + 40 + 40 + 80);
        let at = |x: usize, y: usize| [0, 1, 2].map(|c| pixels[3 * (y * width + x) + c]);
        let first_panel = 2 * GAP + 2 * LINE;
        for (x, y) in [(0, 0), (79, 0), (0, 39), (79, 39), (40, 20)] {
            let (left, top) = (GAP + x, first_panel + y);
            assert_eq!(at(left, top), at(left + 80 + GAP, top));
            assert_eq!(at(left + 2 * (80 + GAP), top), Palette::Diverging.colour(127));
        }
    }

    #[test]
    fn a_result_on_another_grid_is_refused() {
        let volume = |n| Volume::new(Grid::cube(n), Array3::zeros((n, n, n))).unwrap();
        assert!(contact_sheet(&volume(2), &[("other", &volume(3))], 50).is_err());
    }
}
