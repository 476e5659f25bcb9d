//! The confident primitives among the nearest ones of each voxel `[Eq. 12]`, `[Eq. 13]`.

use super::Settings;
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::numeric::Lanes;
use crate::numeric::elementary::length;
use crate::numeric::threads::{self, Pool};
use crate::numeric::vectors::{LANES, f64x8};
use crate::setting::Text;
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use ndarray::Array3;

/// Voxels along each side of a cell. The neighbours of a cell's voxels are searched together.
const CELL: usize = 4;
/// Voxels along each side of a bundle, one voxel per lane. Sides of a block are even.
const BUNDLE: usize = 2;
/// Bound on a cell's half diagonal, relative to the distance of the K-th primitive from its centre.
///
/// Above it, too many primitives are candidates for the cell's voxels.
const CROWDED: f64 = 1.5;
/// Bound on the number of neighbours for which cells pay: candidates are kept in order by insertion.
const FEW: usize = 64;
/// Relative difference below which squared distances may be equal: the tree rounds in another order.
const TIE: f64 = 1e-12;
/// Factor from the last distance of the K-th primitive to the first search radius of the next place.
const FARTHER: f64 = 1.25;
/// Voxel diagonals that primitives may move before the tree is rebuilt. Searches are widened by as much.
const STALE: f64 = 0.5;

/// Numbers of confident neighbours and of all neighbours of each voxel of a block.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Routing {
    /// `|N_high|` `[x, y, z]`; the others of the neighbours are `|N_low|`.
    pub high: Array3<u16>,
    /// Neighbours of every voxel.
    pub neighbours: usize,
}

/// The number of confident primitives, `c ≥ τ`, among the K whose centres are nearest to each voxel centre
/// `[Eq. 12]`; the rest of the K are the others `[Eq. 13]`.
///
/// Distances are Euclidean, in f64, `(x² + y²) + z²`; of primitives at the same distance the one with the lower index is nearer.
/// With fewer than K primitives all are neighbours, and [`Routing::neighbours`] says how many.
///
/// Tests: against [`super::naive::route`] on lattices, repeated points, clouds and clouds that move.
///
/// # Errors
/// Without primitives, for a mean or a confidence that is not finite, for settings out of their range, and for sides of the
/// grid that cannot be halved once for each level.
///
/// # Panics
/// When there are not as many confidences as means.
pub fn route(grid: &Grid, means: &[[f64; 3]], confidence: &[f64], settings: &Settings) -> Result<Routing> {
    let mut routing = Routing::default();
    Router::default().route_into(grid, means, confidence, settings, &mut routing)?;
    Ok(routing)
}

/// Routes one block after another.
///
/// Primitives move little between blocks, so that the kd-tree of an earlier block is reused until one has moved far. Its
/// searches are widened, and distances are computed from the current means.
#[derive(Default)]
pub struct Router {
    tree: Option<ImmutableKdTree<f64, 3>>,
    /// The means in the tree.
    places: Vec<[f64; 3]>,
    confident: Vec<bool>,
    scratch: Pool<Scratch>,
}

impl Router {
    /// [`route`] into an existing routing.
    ///
    /// # Errors
    /// As [`route`].
    ///
    /// # Panics
    /// As [`route`].
    pub fn route_into(
        &mut self,
        grid: &Grid,
        means: &[[f64; 3]],
        confidence: &[f64],
        settings: &Settings,
        routing: &mut Routing,
    ) -> Result<()> {
        assert_eq!(means.len(), confidence.len(), "means and their confidences");
        settings.check(grid.shape)?;
        if means.is_empty() {
            return Err(Error::invalid("primitives", 0, "at least one to be a neighbour", "start from more points"));
        }
        check_finite("means of the primitives", means.as_flattened(), 3)?;
        check_finite("confidence", confidence, 1)?;
        self.confident.clear();
        self.confident.extend(confidence.iter().map(|&c| c >= settings.threshold));
        let neighbours = settings.neighbours.min(means.len());
        let Routing { high, neighbours: of_routing } = routing;
        *of_routing = neighbours;
        if high.shape() != grid.shape {
            *high = Array3::default(grid.shape);
        }
        // Where all primitives are neighbours or all are alike, all voxels have the same counts.
        let alike = self.confident.iter().all(|&first| first == self.confident[0]);
        if neighbours == means.len() || alike {
            high.fill(self.confident[..neighbours].iter().filter(|&&confident| confident).count() as u16);
            return Ok(());
        }
        let step = length(grid.spacing);
        let moved = self.follow(means, STALE * step)?;
        let Self { tree, confident, scratch, .. } = self;
        let tree = tree.as_ref().expect("made for these means or some near them");
        let nearest = Nearest { means, confident, tree, moved, step, neighbours };
        let [_, ny, nz] = grid.shape;
        let voxels = high.as_slice_mut().expect("standard layout");
        threads::for_each_chunk_in(voxels, CELL * ny * nz, scratch, |slab, high, scratch| {
            nearest.route_slab(grid, slab * CELL, high, scratch);
        });
        Ok(())
    }

    /// The largest distance of a primitive from its mean in the tree, which is rebuilt if it exceeds `limit`.
    fn follow(&mut self, means: &[[f64; 3]], limit: f64) -> Result<f64> {
        if self.tree.is_some() && self.places.len() == means.len() {
            let squares = self.places.iter().zip(means).map(|(&place, &mean)| {
                let step = DVec3::from(mean) - DVec3::from(place);
                step.length_squared()
            });
            let most = squares.fold(0.0, |most: f64, square| if square > most { square } else { most }).sqrt();
            if most <= limit {
                return Ok(most);
            }
        }
        // The old tree is dropped first, so that memory holds one at a time.
        self.tree = None;
        let tree = ImmutableKdTree::new_from_slice(means).map_err(|error| {
            let remedy = "give " + Text::set("wavelet.enabled", false) + ", which needs no neighbours";
            Error::invalid("primitives", format!("{error:?}"), "centres that a kd-tree can hold", remedy)
        })?;
        self.tree = Some(tree);
        self.places.clear();
        self.places.extend_from_slice(means);
        Ok(0.0)
    }
}

/// The first voxels of a cell's bundles; `sides` are the distances from the cell's first voxel to the block's end.
fn bundles(sides: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    let side = move |axis: usize| (0..sides[axis].min(CELL)).step_by(BUNDLE);
    side(0).flat_map(move |i| side(1).flat_map(move |j| side(2).map(move |k| [i, j, k])))
}

fn check_finite(stage: &'static str, values: &[f64], width: usize) -> Result<()> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(i) => {
            let index = if width == 1 { vec![i] } else { vec![i / width, i % width] };
            Err(Error::NonFinite { stage, value: values[i], index, step: 0 })
        }
    }
}

/// Finds the nearest of more than `neighbours` primitives.
struct Nearest<'a> {
    means: &'a [[f64; 3]],
    confident: &'a [bool],
    tree: &'a ImmutableKdTree<f64, 3>,
    /// Bound on the distance of a mean from its position in the tree.
    moved: f64,
    /// The diagonal of a voxel.
    step: f64,
    neighbours: usize,
}

impl Nearest<'_> {
    /// Counts the confident neighbours of the voxels of a slab of cells, whose first slice is `first`.
    fn route_slab(&self, grid: &Grid, first: usize, high: &mut [u16], scratch: &mut Scratch) {
        let [_, ny, nz] = grid.shape;
        let deep = high.len() / (ny * nz);
        scratch.guess = self.step;
        for (y, z) in (0..ny).step_by(CELL).flat_map(|y| (0..nz).step_by(CELL).map(move |z| (y, z))) {
            let corner = DVec3::from([first, y, z].map(|i| i as f64));
            let middle = grid.min + (corner + 0.5 * CELL as f64) * grid.spacing;
            let found = self.cell(middle, 0.5 * (CELL - 1) as f64 * self.step, scratch);
            for [i, j, k] in bundles([deep, ny - y, nz - z]) {
                let voxels: [[usize; 3]; LANES] =
                    std::array::from_fn(|lane| [i + lane / 4, y + j + lane / 2 % 2, z + k + lane % 2]);
                let centres = voxels.map(|[i, j, k]| grid.centre([first + i, j, k]));
                let counts = if found { scratch.count(self.neighbours, centres) } else { [None; LANES] };
                for (([i, j, k], centre), count) in voxels.into_iter().zip(centres).zip(counts) {
                    high[(i * ny + j) * nz + k] = count.unwrap_or_else(|| self.count(centre, scratch));
                }
            }
        }
    }

    /// Finds all candidates for the neighbours of centres within `radius` of the middle, the nearest to the middle first.
    ///
    /// Returns false if the primitives are too dense, or if there are more than [`FEW`] neighbours.
    ///
    /// K primitives within d of the middle are within d + radius of the centre. All of its neighbours are therefore within
    /// d + radius of the centre, and within d + 2·radius of the middle.
    fn cell(&self, middle: DVec3, radius: f64, scratch: &mut Scratch) -> bool {
        if self.neighbours > FEW {
            return false;
        }
        let distance = self.around(middle, 2.0 * radius, scratch);
        if radius > CROWDED * distance {
            return false;
        }
        let reach = distance + 2.0 * radius;
        let limit = reach * reach * (1.0 + TIE);
        let Scratch { found, near, .. } = scratch;
        found.retain(|(square, _)| *square <= limit);
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let one = |i: u32| Near { point: self.point(i), confident: f64::from(self.confident[i as usize]) };
        near.clear();
        near.extend(found.iter().map(|(_, i)| one(*i)));
        true
    }

    /// The number of confident ones among the neighbours of a centre.
    fn count(&self, centre: DVec3, scratch: &mut Scratch) -> u16 {
        self.around(centre, 0.0, scratch);
        let nearest = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        scratch.found.select_nth_unstable_by(self.neighbours - 1, nearest);
        scratch.found[..self.neighbours].iter().filter(|(_, i)| self.confident[*i as usize]).count() as u16
    }

    /// Returns the distance d of the K-th primitive; finds all within d + `beyond`, and possibly more.
    fn around(&self, place: DVec3, beyond: f64, scratch: &mut Scratch) -> f64 {
        let Scratch { found, guess, .. } = scratch;
        self.gather(place, *guess + beyond, found);
        while found.len() < self.neighbours {
            *guess = 2.0 * *guess + self.step;
            self.gather(place, *guess + beyond, found);
        }
        let (_, (square, _), _) = found.select_nth_unstable_by(self.neighbours - 1, |a, b| a.0.total_cmp(&b.0));
        let distance = square.sqrt();
        if distance > *guess {
            self.gather(place, distance + beyond, found);
        }
        *guess = FARTHER * distance;
        distance
    }

    /// Finds all primitives within `radius`, and possibly more, with their squared distances.
    fn gather(&self, place: DVec3, radius: f64, found: &mut Vec<(f64, u32)>) {
        let reach = radius + self.moved;
        let limit = reach * reach * (1.0 + TIE) + f64::MIN_POSITIVE;
        found.clear();
        let query = place.to_array();
        let within = self.tree.query(&query).within::<SquaredEuclidean<f64>>(limit).unsorted();
        within.visit(|near| found.push(((self.point(near.item) - place).length_squared(), near.item)));
    }

    fn point(&self, i: u32) -> DVec3 {
        self.means[i as usize].into()
    }
}

/// A candidate for a neighbour.
struct Near {
    point: DVec3,
    /// 1 for a confident primitive, else 0.
    confident: f64,
}

/// Scratch buffers of the search.
#[derive(Default)]
struct Scratch {
    /// Expected distance of the K-th primitive.
    guess: f64,
    /// Squared distances and indices around a place.
    found: Vec<(f64, u32)>,
    /// Candidates for the neighbours of a cell's voxels.
    near: Vec<Near>,
    /// Squared distances of all candidates.
    distances: Vec<f64x8>,
    /// The smallest of them, in order.
    order: Vec<f64x8>,
}

impl Scratch {
    /// The number of confident neighbours of each centre, all of which are among `near`.
    ///
    /// `None` where several primitives are as near as the last neighbour.
    fn count(&mut self, neighbours: usize, centres: [DVec3; LANES]) -> [Option<u16>; LANES] {
        let Self { near, distances, order, .. } = self;
        let [x, y, z] = [0, 1, 2].map(|axis| f64x8::from_fn(|lane| centres[lane][axis]));
        let (zero, one) = (f64x8::splat(0.0), f64x8::splat(1.0));
        distances.clear();
        order.clear();
        order.resize(neighbours, f64x8::splat(f64::INFINITY));
        for Near { point, .. } in &*near {
            let [x, y, z] = [f64x8::splat(point.x) - x, f64x8::splat(point.y) - y, f64x8::splat(point.z) - z];
            let mut distance = x * x + y * y + z * z;
            distances.push(distance);
            if distance.below(order[neighbours - 1]) != 0 {
                for nearer in order.iter_mut() {
                    (*nearer, distance) = (nearer.at_most(distance), nearer.at_least(distance));
                }
            }
        }
        let last = order[neighbours - 1];
        let (mut within, mut confident) = (zero, zero);
        for (distance, near) in distances.iter().zip(&*near) {
            let inside = distance.select_le(last, one, zero);
            within += inside;
            confident += inside * f64x8::splat(near.confident);
        }
        let [mut all, mut high] = [[0.0; LANES]; 2];
        within.write(&mut all);
        confident.write(&mut high);
        std::array::from_fn(|lane| (all[lane] == neighbours as f64).then_some(high[lane] as u16))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::rng::{Purpose, stream};
    use crate::wavelet::naive;
    use rand::RngExt;

    const SETTINGS: Settings =
        Settings { neighbours: 8, threshold: 0.35, enhancement: 1.5, suppress: 1e-3, enhance: 1e-3, levels: 1 };

    fn uniform(seed: u64, n: usize) -> Vec<f64> {
        let mut random = stream(seed, Purpose::Phantom, 3, 0);
        (0..n).map(|_| random.random::<f64>()).collect()
    }

    fn cloud(seed: u64, n: usize) -> Vec<[f64; 3]> {
        uniform(seed, 3 * n).chunks_exact(3).map(|c| [2.0 * c[0] - 1.0, 1.4 * c[1] - 0.9, 1.8 * c[2] - 0.7]).collect()
    }

    fn grid(shape: [usize; 3]) -> Grid {
        Grid::new(shape, DVec3::new(-0.8, -0.5, -0.9), DVec3::new(0.4, 0.9, 0.8)).unwrap()
    }

    fn assert_matches_brute_force(what: &str, grid: &Grid, means: &[[f64; 3]], settings: &Settings) {
        let confidence = uniform(77, means.len());
        let found = route(grid, means, &confidence, settings).unwrap();
        let expected = naive::route(grid, means, &confidence, settings);
        assert_eq!(found.neighbours, expected.neighbours, "{what}");
        let wrong = found.high.iter().zip(&expected.high).filter(|(a, b)| a != b).count();
        assert_eq!(wrong, 0, "{what}: wrong voxels of {}", grid.voxels());
        let k = found.neighbours as u16;
        assert!(found.high.iter().any(|h| *h > 0) && found.high.iter().any(|h| *h < k), "{what}: both kinds");
    }

    #[test]
    fn primitives_that_are_all_alike_need_no_search() {
        let (grid, means) = (grid([4, 4, 4]), cloud(3, 50));
        for (confidence, expected) in [(0.35, 8), (0.34, 0)] {
            let found = route(&grid, &means, &[confidence; 50], &SETTINGS).unwrap();
            assert_eq!(found, naive::route(&grid, &means, &[confidence; 50], &SETTINGS));
            assert!(found.high.iter().all(|&high| high == expected));
        }
    }

    #[test]
    fn counts_are_those_of_brute_force_in_clouds() {
        for (seed, m, k) in [(1, 9, 8), (2, 300, 8), (3, 2000, 1), (4, 900, 33), (5, 900, 100)] {
            let settings = Settings { neighbours: k, ..SETTINGS };
            assert_matches_brute_force(&format!("{m} points, K = {k}"), &grid([6, 8, 10]), &cloud(seed, m), &settings);
        }
    }

    /// Nothing, a little, more than the tree may be off by, fewer, and the first ones again.
    #[test]
    fn primitives_that_move_are_found_where_they_are() {
        let (grid, confidence, mut router) = (grid([6, 8, 10]), uniform(77, 900), Router::default());
        let (mut routing, still, noise) = (Routing::default(), cloud(4, 900), cloud(12, 900));
        let mut made = Vec::new();
        for (by, m) in [(0.0, 900), (0.03, 900), (0.06, 900), (1.5, 900), (0.0, 700), (0.0, 900)] {
            let means: Vec<[f64; 3]> = still[..m]
                .iter()
                .zip(&noise)
                .map(|(p, step)| std::array::from_fn(|axis| p[axis] + by * step[axis]))
                .collect();
            router.route_into(&grid, &means, &confidence[..m], &SETTINGS, &mut routing).unwrap();
            assert_eq!(routing, naive::route(&grid, &means, &confidence[..m], &SETTINGS), "{by}, {m}");
            made.push(router.places == means);
        }
        assert_eq!(made, [true, false, false, true, true, true], "whether the tree was made again");
    }

    /// Voxel centres at multiples of 1/8 and a lattice of 1/4 between them: up to eight primitives at the same distance.
    #[test]
    fn ties_on_lattices_go_to_the_lower_index() {
        let grid = Grid::new([8, 6, 10], DVec3::splat(-0.5), DVec3::new(0.5, 0.25, 0.75)).unwrap();
        let mut lattice: Vec<[f64; 3]> =
            (0..6 * 6 * 6).map(|i| [i / 36, i / 6 % 6, i % 6].map(|n: usize| n as f64 * 0.25 - 0.5625)).collect();
        // An order that has nothing to do with the place.
        lattice.sort_by_key(|p| (p[0] * 1000.0 + p[1] * 7700.0 + p[2] * 3300.0).abs() as u64 % 101);
        for k in [1, 2, 3, 5, 8, 9] {
            let settings = Settings { neighbours: k, ..SETTINGS };
            assert_matches_brute_force(&format!("lattice, K = {k}"), &grid, &lattice, &settings);
        }
    }

    #[test]
    fn repeated_points_are_neighbours_one_by_one() {
        let grid = grid([4, 6, 4]);
        let few = cloud(5, 12);
        let repeated: Vec<_> = (0..400).map(|i| few[i * 7 % 12]).collect();
        assert_matches_brute_force("12 points, 400 times", &grid, &repeated, &SETTINGS);
        let pile = vec![grid.centre([1, 2, 3]).to_array(); 300];
        let mut piles = cloud(6, 40);
        piles.splice(20..20, pile);
        assert_matches_brute_force("a pile on a voxel's centre", &grid, &piles, &SETTINGS);
    }

    #[test]
    fn with_fewer_primitives_than_neighbours_all_are() {
        let settings = Settings { neighbours: 8, ..SETTINGS };
        let routing = route(&grid([2, 4, 2]), &cloud(7, 3), &[0.9, 0.1, 0.35], &settings).unwrap();
        assert_eq!(routing.neighbours, 3);
        assert!(routing.high.iter().all(|h| *h == 2), "the threshold itself is confident");
    }

    #[test]
    fn what_cannot_be_routed_is_refused_in_words() {
        let grid = grid([4, 4, 4]);
        let refused = |grid: &Grid, means: &[[f64; 3]], confidence: &[f64], settings: &Settings| {
            route(grid, means, confidence, settings).unwrap_err().to_string()
        };
        let odd = Grid { shape: [4, 5, 4], ..grid };
        let message = refused(&odd, &[[0.0; 3]], &[0.5], &SETTINGS);
        assert!(message.contains("[4, 5, 4]") && message.contains("even sides"), "{message}");
        let six = Grid { shape: [4, 4, 6], ..grid };
        let message = refused(&six, &[[0.0; 3]], &[0.5], &Settings { levels: 2, ..SETTINGS });
        assert!(message.contains("2 levels"), "{message}");
        assert!(refused(&grid, &[], &[], &SETTINGS).contains("at least one"));
        let message = refused(&grid, &[[0.0; 3], [0.0, f64::NAN, 0.0]], &[0.5, 0.5], &SETTINGS);
        assert!(message.contains("means") && message.contains("[1, 1]"), "{message}");
        let message = refused(&grid, &[[0.0; 3], [1.0; 3]], &[0.5, f64::INFINITY], &SETTINGS);
        assert!(message.contains("confidence") && message.contains("[1]"), "{message}");
        for (neighbours, levels) in [(0, 1), (65536, 1), (8, 0)] {
            let settings = Settings { neighbours, levels, ..SETTINGS };
            assert!(refused(&grid, &[[0.0; 3]], &[0.5], &settings).contains("expected"));
        }
    }

    #[test]
    fn bits_do_not_depend_on_threads() {
        let (grid, means, confidence) = (grid([10, 8, 14]), cloud(9, 3000), uniform(10, 3000));
        let run =
            |threads| threads::install(threads, || route(&grid, &means, &confidence, &SETTINGS).unwrap()).unwrap();
        let alone = run(1);
        assert_eq!(run(2), alone);
        assert_eq!(run(3), alone);
    }
}
