//! Which voxels are near confident primitives `[Eq. 12]`, `[Eq. 13]`.

use super::Settings;
use crate::error::{Error, Result};
use crate::numeric::elementary::length;
use crate::numeric::{Lanes, Real, threads};
use crate::scene::Grid;
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use ndarray::Array3;
use std::num::NonZero;

/// Voxels along each side of a cell, whose neighbours are looked for together.
const CELL: usize = 4;
/// Voxels along each side of a bundle, which are told from each other in lanes. Sides of a block are even.
const BUNDLE: usize = 2;
/// Voxels of a bundle.
const LANES: usize = <Row as Lanes>::WIDTH;
/// A number for each voxel of a bundle.
type Row = <f64 as Real>::Lanes;
/// The most that a cell's half diagonal may be of the distance in which its middle has K primitives: beyond, too many
/// are near the cell for most of its voxels.
const CROWDED: f64 = 1.5;
/// The most neighbours for which a cell pays: they are kept in order by insertion.
const FEW: usize = 64;
/// Squared distances that the tree reports closer together than this, relatively, may be equal: it rounds in an order of its own.
const TIE: f64 = 1e-12;

/// The shares of confident and other neighbours of each voxel of a block.
#[derive(Clone, Debug, PartialEq)]
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
/// Tests: against [`super::naive::route`] on lattices, repeated points and clouds.
///
/// # Errors
/// Without primitives, for a mean or a confidence that is not finite, for settings out of their range, and for sides of the
/// grid that cannot be halved once for each level.
///
/// # Panics
/// When there are not as many confidences as means.
pub fn route(grid: &Grid, means: &[[f64; 3]], confidence: &[f64], settings: &Settings) -> Result<Routing> {
    assert_eq!(means.len(), confidence.len(), "means and their confidences");
    settings.check(grid.shape)?;
    if means.is_empty() {
        return Err(Error::invalid("primitives", 0, "at least one to be a neighbour", "start from more points"));
    }
    check_finite("means of the primitives", means.as_flattened(), 3)?;
    check_finite("confidence", confidence, 1)?;
    let confident: Vec<bool> = confidence.iter().map(|&c| c >= settings.threshold).collect();
    let count = |is_near: &mut dyn Iterator<Item = usize>| is_near.filter(|&i| confident[i]).count() as u16;
    let neighbours = settings.neighbours.min(means.len());
    // Where all are neighbours or all are alike, no voxel differs from another.
    let alike = confident.iter().all(|&first| first == confident[0]);
    if neighbours == means.len() || alike {
        let high = Array3::from_elem(grid.shape, count(&mut (0..neighbours)));
        return Ok(Routing { high, neighbours });
    }
    let nearest = Nearest::new(means, neighbours)?;
    let mut high = Array3::default(grid.shape);
    let [_, ny, nz] = grid.shape;
    threads::for_each_chunk(high.as_slice_mut().expect("a new array"), CELL * ny * nz, |slab, high| {
        let (mut near, mut room) = (Vec::new(), Room::default());
        let deep = high.len() / (ny * nz);
        for (y, z) in (0..ny).step_by(CELL).flat_map(|y| (0..nz).step_by(CELL).map(move |z| (y, z))) {
            let first = [slab * CELL, y, z];
            let middle = grid.min + (DVec3::from(first.map(|i| i as f64)) + 0.5 * CELL as f64) * grid.spacing;
            let found = nearest.cell(middle, 0.5 * (CELL - 1) as f64 * length(grid.spacing), &confident, &mut near);
            for [i, j, k] in bundles([deep, ny - y, nz - z]) {
                let voxels: [[usize; 3]; LANES] =
                    std::array::from_fn(|lane| [i + lane / 4, y + j + lane / 2 % 2, z + k + lane % 2]);
                let centres = voxels.map(|[i, j, k]| grid.centre([first[0] + i, j, k]));
                let counts = if found { room.count(&near, neighbours, centres) } else { [None; LANES] };
                for (([i, j, k], centre), count) in voxels.into_iter().zip(centres).zip(counts) {
                    high[(i * ny + j) * nz + k] = count.unwrap_or_else(|| nearest.count(centre, &confident));
                }
            }
        }
    });
    Ok(Routing { high, neighbours })
}

/// The first voxels of a cell's bundles, where the block ends so many voxels beyond the cell's first one.
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

/// Finds the nearest of more than `neighbours` points.
struct Nearest<'a> {
    points: &'a [[f64; 3]],
    tree: ImmutableKdTree<f64, 3>,
    neighbours: usize,
}

impl<'a> Nearest<'a> {
    fn new(points: &'a [[f64; 3]], neighbours: usize) -> Result<Self> {
        let tree = ImmutableKdTree::new_from_slice(points).map_err(|error| {
            Error::invalid("primitives", format!("{error:?}"), "centres that a kd-tree can hold", "use fewer")
        })?;
        Ok(Self { points, tree, neighbours })
    }

    /// Finds all that can be a neighbour of a centre within `radius` of the middle, the nearest to the middle first. Not if the
    /// primitives are so dense that these are many, or more neighbours are asked for than [`FEW`].
    ///
    /// K primitives within d of the middle are within d + radius of the centre, so are all of its neighbours, and these within
    /// d + 2·radius of the middle.
    fn cell(&self, middle: DVec3, radius: f64, confident: &[bool], near: &mut Vec<Near>) -> bool {
        let Some(k) = NonZero::new(self.neighbours).filter(|k| k.get() <= FEW) else { return false };
        let query = middle.to_array();
        let found = self.tree.query(&query).nearest_n::<SquaredEuclidean<f64>>(k).execute();
        let distance = found[k.get() - 1].distance.sqrt();
        if radius > CROWDED * distance {
            return false;
        }
        let reach = distance + 2.0 * radius;
        let limit = reach * reach * (1.0 + TIE) + f64::MIN_POSITIVE;
        let within = self.tree.query(&query).within::<SquaredEuclidean<f64>>(limit).execute();
        let one = |i: u32| Near { point: self.point(i), confident: f64::from(confident[i as usize]) };
        near.clear();
        near.extend(within.iter().map(|near| one(near.item)));
        true
    }

    /// The number of confident ones among the neighbours of a centre.
    fn count(&self, centre: DVec3, confident: &[bool]) -> u16 {
        let (k, query) = (self.neighbours, centre.to_array());
        let one_more = NonZero::new(k + 1).expect("a sum with 1");
        let found = self.tree.query(&query).nearest_n::<SquaredEuclidean<f64>>(one_more).execute();
        let (last, next) = (found[k - 1].distance, found[k].distance);
        let limit = last * (1.0 + TIE) + f64::MIN_POSITIVE;
        if next > limit {
            return found[..k].iter().filter(|near| confident[near.item as usize]).count() as u16;
        }
        // The set is not determined: all that are as near as the last, in our own arithmetic and order.
        let within = self.tree.query(&query).within::<SquaredEuclidean<f64>>(limit).execute();
        let mut order: Vec<(f64, u32)> =
            within.iter().map(|near| (self.distance(near.item, centre), near.item)).collect();
        order.select_nth_unstable_by(k - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        order[..k].iter().filter(|(_, i)| confident[*i as usize]).count() as u16
    }

    fn distance(&self, i: u32, centre: DVec3) -> f64 {
        (self.point(i) - centre).length_squared()
    }

    fn point(&self, i: u32) -> DVec3 {
        self.points[i as usize].into()
    }
}

/// A primitive that can be a neighbour.
struct Near {
    point: DVec3,
    /// 1 if it is, else 0.
    confident: f64,
}

/// Room to work, kept from bundle to bundle.
#[derive(Default)]
struct Room {
    /// Squared distances of all that are near.
    distances: Vec<Row>,
    /// The smallest of them, in order.
    order: Vec<Row>,
}

impl Room {
    /// For each centre the number of confident ones among its neighbours, all of which are `near`. `None` where several are as
    /// near as the last of them.
    fn count(&mut self, near: &[Near], neighbours: usize, centres: [DVec3; LANES]) -> [Option<u16>; LANES] {
        let Self { distances, order } = self;
        let [x, y, z] = [0, 1, 2].map(|axis| Row::from_fn(|lane| centres[lane][axis]));
        let (zero, one) = (Row::splat(0.0), Row::splat(1.0));
        distances.clear();
        order.clear();
        order.resize(neighbours, Row::splat(f64::INFINITY));
        for Near { point, .. } in near {
            let [x, y, z] = [Row::splat(point.x) - x, Row::splat(point.y) - y, Row::splat(point.z) - z];
            let mut distance = x * x + y * y + z * z;
            distances.push(distance);
            if distance.any_below(order[neighbours - 1]) {
                for nearer in order.iter_mut() {
                    (*nearer, distance) = (nearer.at_most(distance), nearer.at_least(distance));
                }
            }
        }
        let last = order[neighbours - 1];
        let (mut within, mut confident) = (zero, zero);
        for (distance, near) in distances.iter().zip(near) {
            let inside = distance.select_le(last, one, zero);
            within += inside;
            confident += inside * Row::splat(near.confident);
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
