//! A volume as a continuous function, and its exact projections.
//!
//! Between voxel centres the density is trilinear, and the volume is surrounded by zeros: across half a voxel on both
//! sides of the box's border it falls to 0. A line along an axis through voxel centres therefore integrates to the sum
//! of their values times the spacing, and the function has no jump. Not in the paper.

use super::trace::trace;
use glam::DVec3;
use ndarray::Array3;
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, Ray, Scanner, Trajectory, Volume};

/// Exact projections of a volume in the views of a trajectory, one ray through the centre of each pixel.
///
/// # Errors
/// When there is no angle, or one is not finite.
pub fn project<'a>(volume: &Volume, scanner: &Scanner, views: impl Into<Trajectory<'a>>) -> Result<Projections> {
    let density = Trilinear::new(volume);
    trace(scanner, views, |ray| density.line_integral(ray))
}

/// A volume interpreted as a continuous function.
#[derive(Clone, Debug)]
pub struct Trilinear {
    /// The values `[x, y, z]`, surrounded by a layer of zeros.
    values: Vec<f32>,
    shape: [usize; 3],
    /// Index of the last centre (a zero) along each axis.
    last: DVec3,
    /// World → fractional index: `point·per_voxel + shift` is an integer at voxel centres.
    per_voxel: DVec3,
    shift: DVec3,
}

/// The traversal of cells between voxel centres by a ray, along one axis.
#[derive(Clone, Copy)]
struct Axis {
    /// Ray parameter at which the ray enters the next cell; infinite in the last one.
    crossing: f64,
    /// Index of the plane crossed there.
    plane: f64,
    /// The cell lies between the planes `low` and `low + 1`.
    low: f64,
    /// +1 or -1.
    step: f64,
    last: f64,
    origin: f64,
    direction: f64,
}

impl Trilinear {
    /// The continuous function of a volume.
    pub fn new(volume: &Volume) -> Self {
        let shape = volume.grid.shape.map(|n| n + 2);
        let mut values = Array3::zeros(shape);
        volume.values.indexed_iter().for_each(|((x, y, z), &value)| values[[x + 1, y + 1, z + 1]] = value);
        let per_voxel = 1.0 / volume.grid.spacing;
        Self {
            values: values.into_raw_vec_and_offset().0,
            shape,
            last: DVec3::from_array(shape.map(|n| (n - 1) as f64)),
            per_voxel,
            shift: DVec3::splat(0.5) - volume.grid.min * per_voxel,
        }
    }

    /// Density at a point.
    pub fn at(&self, point: DVec3) -> f64 {
        let index = point * self.per_voxel + self.shift;
        let inside = index.cmpge(DVec3::ZERO).all() && index.cmple(self.last).all();
        // The last cell includes its upper border.
        let low = index.floor().min(self.last - 1.0);
        if inside { interpolate(&self.cell(low), index - low) } else { 0.0 }
    }

    /// Integral of the density along the whole line of a ray, scene units of length × density.
    ///
    /// Between two crossings of planes of voxel centres, the density along the ray is a cubic polynomial, which the
    /// two-point Gauss rule integrates exactly: the result is right to rounding, about 10⁻¹³ relative.
    ///
    /// Tests: against quadrature, chords of a box, a product of linear functions, sums along the axes.
    pub fn line_integral(&self, ray: &Ray) -> f64 {
        let (origin, direction) = (ray.origin * self.per_voxel + self.shift, ray.direction * self.per_voxel);
        let Some((mut from, end)) = inside_box(origin, direction, self.last) else { return 0.0 };
        let start = origin + direction * from;
        let mut axes = [0, 1, 2].map(|i| Axis::new(origin[i], direction[i], start[i], self.last[i]));
        let gauss = 0.5 / 3.0_f64.sqrt();
        let mut total = 0.0;
        while from < end {
            let to = axes.iter().fold(end, |to, axis| if axis.crossing < to { axis.crossing } else { to });
            if to > from {
                let low = DVec3::new(axes[0].low, axes[1].low, axes[2].low);
                let cell = self.cell(low);
                let (offset, length, middle) = (origin - low, to - from, 0.5 * (from + to));
                let left = interpolate(&cell, offset + direction * (middle - gauss * length));
                let right = interpolate(&cell, offset + direction * (middle + gauss * length));
                total += 0.5 * length * (left + right);
                from = to;
            }
            axes.iter_mut().filter(|axis| axis.crossing <= to).for_each(Axis::advance);
        }
        total
    }

    /// The values at the corners of the cell above the integer index `low`, z fastest.
    fn cell(&self, low: DVec3) -> [f64; 8] {
        let (dx, dy) = (self.shape[1] * self.shape[2], self.shape[2]);
        let corner = low.x as usize * dx + low.y as usize * dy + low.z as usize;
        let [b, c, d] = [corner + dy, corner + dx, corner + dx + dy];
        let at = |index: usize| f64::from(self.values[index]);
        [at(corner), at(corner + 1), at(b), at(b + 1), at(c), at(c + 1), at(d), at(d + 1)]
    }
}

/// The trilinear function in a cell, at a point relative to its lowest corner.
fn interpolate(cell: &[f64; 8], at: DVec3) -> f64 {
    let between = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let along_z = |i: usize| between(cell[i], cell[i + 1], at.z);
    let along_y = |i: usize| between(along_z(i), along_z(i + 2), at.y);
    between(along_y(0), along_y(4), at.x)
}

impl Axis {
    fn new(origin: f64, direction: f64, start: f64, last: f64) -> Self {
        // Rounding may put the start just outside; then the cell is the first or the last one.
        let low = start.floor().clamp(0.0, last - 1.0);
        let (step, plane) = if direction > 0.0 { (1.0, low + 1.0) } else { (-1.0, low) };
        let mut axis = Self { crossing: f64::INFINITY, plane, low, step, last, origin, direction };
        axis.find_crossing();
        axis
    }

    fn advance(&mut self) {
        self.plane += self.step;
        self.low += self.step;
        self.find_crossing();
    }

    /// Computed from the plane's index and not the previous crossing: rounding errors do not add up.
    fn find_crossing(&mut self) {
        let inside = self.direction != 0.0 && self.plane > 0.0 && self.plane < self.last;
        self.crossing = if inside { (self.plane - self.origin) / self.direction } else { f64::INFINITY };
    }
}

/// The interval of the line where every index is between 0 and `last`.
fn inside_box(origin: DVec3, direction: DVec3, last: DVec3) -> Option<(f64, f64)> {
    let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let (low, high) = (-origin[axis], last[axis] - origin[axis]);
        if direction[axis] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
        } else {
            let (a, b) = (low / direction[axis], high / direction[axis]);
            from = from.max(a.min(b));
            to = to.min(a.max(b));
        }
    }
    (from < to).then_some((from, to))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;
    use trgs_core::geometry::{Beam, Detector, Grid};
    use trgs_core::numeric::{reduce, threads};

    fn grid() -> Grid {
        Grid::new([5, 7, 4], DVec3::new(-0.9, -0.6, -0.8), DVec3::new(0.7, 0.8, 1.0)).unwrap()
    }

    fn volume(value: impl Fn(usize, usize, usize) -> f64) -> Volume {
        Volume::new(grid(), Array3::from_shape_fn((5, 7, 4), |(x, y, z)| value(x, y, z) as f32)).unwrap()
    }

    fn bumpy() -> Volume {
        volume(|x, y, z| ((x * 5 + y * 3 + z * 7) % 11) as f64 / 8.0)
    }

    fn rays() -> Vec<Ray> {
        let beams = [Beam::Cone { dso: 4.0, dsd: 6.0 }, Beam::Parallel { dso: 4.0 }];
        let detector = Detector { rows: 7, columns: 6, pitch_v: 0.35, pitch_u: 0.4, offset_u: 0.1, offset_v: 0.05 };
        let scanners = beams.map(|beam| Scanner { beam, detector, grid: grid() });
        let pixels =
            |s: Scanner| (0..42).map(move |i| s.ray(&s.view(0.3 + 0.9 * f64::from(i)), i as usize / 6, i as usize % 6));
        scanners.into_iter().flat_map(pixels).collect()
    }

    #[test]
    fn line_integrals_match_quadrature_of_the_function() {
        let volume = bumpy();
        let density = Trilinear::new(&volume);
        for ray in rays() {
            let (n, length) = (100_000, 8.0);
            let at = |i: usize| density.at(ray.origin + ray.direction * ((i as f64 + 0.5) * length / n as f64));
            let expected = reduce::sum_by(n, &at) * length / n as f64;
            let exact = density.line_integral(&ray);
            assert!((exact - expected).abs() < 2.0 * length / n as f64, "{exact} instead of {expected}");
        }
    }

    #[test]
    fn a_constant_volume_integrates_to_chords_of_its_box_and_half_of_the_rim() {
        use crate::phantom::solid::{Shape, Solid};
        // Along an axis, the fall to 0 over one spacing counts half, so the integral equals that of the box; at other
        // angles the difference between the boxes with and without the rim bounds it.
        let volume = volume(|_, _, _| 0.75);
        let (centre, half) = ((grid().min + grid().max()) / 2.0, grid().size() / 2.0);
        let chord = |half: DVec3, ray: &Ray| Solid::new(Shape::Cuboid, 0.75, centre, half).line_integral(ray);
        let density = Trilinear::new(&volume);
        let mut inside = 0;
        for ray in rays() {
            let (least, most) = (chord(half - grid().spacing / 2.0, &ray), chord(half + grid().spacing / 2.0, &ray));
            let value = density.line_integral(&ray);
            within!(f64::max(least - value, value - most), "{value} is not between {least} and {most}");
            inside += usize::from(least > 0.5);
        }
        assert!(inside > 20);
    }

    #[test]
    fn a_product_of_linear_functions_is_integrated_exactly() {
        // xyz is trilinear everywhere; between the outermost centres its integral is a polynomial of the ends.
        let function = |p: DVec3| (p.x + 1.5) * (p.y - 2.0) * (p.z + 3.0);
        let mut volume = volume(|_, _, _| 0.0);
        let (size, start) = (grid(), DVec3::new(-0.4, -0.2, -0.3));
        volume.values.indexed_iter_mut().for_each(|((x, y, z), v)| *v = function(size.centre([x, y, z])) as f32);
        let end = DVec3::new(0.35, 0.5, 0.6);
        let density = Trilinear::new(&volume);
        // Boole's rule is exact for polynomials of degree 5.
        let direction = (end - start).normalize();
        let boole: f64 = [7.0, 32.0, 12.0, 32.0, 7.0]
            .iter()
            .enumerate()
            .map(|(i, w)| w * function(start.lerp(end, i as f64 / 4.0)))
            .sum();
        let expected = boole / 90.0 * (end - start).length();
        // The integral over a part is the whole minus a quadrature over the rest.
        let outside = |from: f64, to: f64| {
            let n = 200_000;
            let step = (to - from) / n as f64;
            reduce::sum_by(n, &|i| density.at(start + direction * (from + (i as f64 + 0.5) * step))) * step
        };
        let whole = density.line_integral(&Ray { origin: start - direction * 3.0, direction });
        let part = whole - outside(-3.0, 0.0) - outside((end - start).length(), 3.0);
        within!((part - expected).abs(), "{part} instead of {expected}");
    }

    #[test]
    fn lines_through_centres_sum_the_values() {
        let volume = bumpy();
        let density = Trilinear::new(&volume);
        for (direction, axis) in [(DVec3::X, 0), (DVec3::NEG_Y, 1), (DVec3::Z, 2)] {
            let index = [3, 2, 1];
            let ray = Ray { origin: grid().centre(index) - direction * 3.0, direction };
            let line = (0..grid().shape[axis]).map(|i| {
                let mut at = index;
                at[axis] = i;
                f64::from(volume.values[at])
            });
            let expected = line.sum::<f64>() * grid().spacing[axis];
            within!((density.line_integral(&ray) - expected).abs());
        }
    }

    #[test]
    fn a_single_voxel_is_a_tent() {
        let grid = Grid::new([1, 1, 1], DVec3::new(0.1, 0.0, -0.3), DVec3::new(0.5, 0.3, 0.1)).unwrap();
        let volume = Volume::new(grid, Array3::from_elem((1, 1, 1), 2.0)).unwrap();
        let ray = Ray { origin: DVec3::new(-2.0, 0.1, 0.0), direction: DVec3::X };
        let density = Trilinear::new(&volume);
        // The ray passes the centre at 0.05 of 0.3 in y and 0.1 of 0.4 in z.
        let expected = 2.0 * 0.4 * (1.0 - 0.05 / 0.3) * (1.0 - 0.1 / 0.4);
        within!((density.line_integral(&ray) - expected).abs());
        within!((density.at(grid.centre([0, 0, 0])) - 2.0).abs());
        within!((density.at(DVec3::new(0.1, 0.15, -0.1)) - 1.0).abs());
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let volume = bumpy();
        let detector = Detector { rows: 9, columns: 8, pitch_v: 0.3, pitch_u: 0.3, offset_u: 0.0, offset_v: 0.0 };
        let scanner = Scanner { beam: Beam::Cone { dso: 4.0, dsd: 6.0 }, detector, grid: grid() };
        let [one, three] =
            [1, 3].map(|n| threads::install(n, || project(&volume, &scanner, &[0.1, 2.0]).unwrap()).unwrap());
        assert_eq!(one, three);
    }
}
