//! Training of a network, a view at a time, and the volume that it is read off to. Not in the paper.

use super::activation::{leaky, leaky_slope, sigmoid};
use super::encoding::{Encoding, FEATURES, Level};
use super::linear::stride;
use super::network::{Network, Trace, Weights, split};
use super::rays::{self, MeasuredRay};
use super::settings::{Kind, NeuralSettings};
use crate::classical::algebraic::{Pass, VoxelRun, VoxelState};
use crate::memory::{Allocation, F32, F64, Sizes, allocation};
use glam::DVec3;
use ndarray::{Array1, Array2, Array3, ArrayD};
use rand::RngExt;
use trgs_core::error::{Error, Result, start_again};
use trgs_core::geometry::{Grid, Projections, Scanner, View, Volume};
use trgs_core::numeric::elementary::pow;
use trgs_core::numeric::rng::{Purpose, stream};
use trgs_core::numeric::threads::{self, Pool};
use trgs_core::numeric::{Lanes, Real, WIDEST, real, reduce};
use trgs_core::optim::Adam;

/// Rays of a task; gradients of tasks are added in order.
const BUNDLE: usize = 32;
/// Samples that go through the network together, about: what it computes for them stays in the cache.
const TOGETHER: usize = 512;
/// Entries of the table start uniformly within this.
const TABLE: f64 = 1e-4;
/// Voxels of a task of the volume, about.
const VOXELS: usize = 1024;
const BETA: [f64; 2] = [0.9, 0.999];
/// Of Adam. With 1e-8, the originals', densities that have become almost 0 everywhere stay there: their slopes are smaller.
const EPSILON: f64 = 1e-15;

/// A run of steps.
pub struct NeuralRun<'a, R: Real> {
    grid: Grid,
    views: Vec<View>,
    projections: &'a Projections,
    settings: NeuralSettings,
    unit: f64,
    pub(super) model: Model,
    /// The table, then the network.
    pub(super) parameters: Vec<f64>,
    /// Of the table and of the network.
    adam: [Adam; 2],
    iteration: usize,
    buffers: Pool<Buffers<R>>,
}

/// A field of density without its parameters.
pub(super) struct Model {
    encoding: Encoding,
    network: Network,
    /// Numbers of the table.
    pub(super) table: usize,
    /// Half of the sides of the box, scene units.
    frame: [f64; 3],
    is_bounded: bool,
    ceiling: f64,
}

/// Parameters of a step in the precision of the kernels.
struct Field<R> {
    table: Vec<R>,
    weights: Weights<R>,
}

/// Buffers of a task.
#[derive(Default)]
struct Buffers<R: Real> {
    trace: Trace<R::Lanes>,
    codes: Vec<R::Lanes>,
    out: Vec<R::Lanes>,
    slopes: Vec<R::Lanes>,
    to_codes: Vec<R::Lanes>,
}

/// What a bundle of rays adds to a step.
struct Share<R: Real> {
    /// Sum of the squared errors of its rays.
    error: f64,
    /// Gradient to the network.
    gradient: Vec<f64>,
    /// Points, in registers, and the gradients to their codes.
    points: Vec<[R::Lanes; 3]>,
    to_codes: Vec<R::Lanes>,
}

/// What a step sees.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Points `[ray, sample, axis]`, from 0 to 1 along each side of the volume.
    pub points: Array3<f64>,
    /// The length that each point stands for `[ray, sample]`, scene units.
    pub lengths: Array2<f64>,
    /// Measured line integral of each ray, divided by the run's unit of density.
    pub values: Array1<f64>,
}

impl NeuralSettings {
    /// Numbers of the network, without those of its table.
    pub fn parameters(&self) -> usize {
        parts(self).1.parameters()
    }

    /// What a run asks of memory: in a step, as a checkpoint is written, and as the volume is read off. The unit of density
    /// comes from SART in f32 before.
    pub fn phases(&self, sizes: &Sizes) -> [Vec<Allocation>; 3] {
        let (encoding, network) = parts(self);
        let rays = self.rays + self.windows * self.window * self.window;
        let parameters = encoding.parameters() + network.parameters();
        // Numbers for a sample, at most, and samples that go through the network together. A task of the volume has
        // whole columns.
        let computed = if network.has_block() { 1300 } else { 600 };
        let column = points_of_column(self, &network, sizes.column);
        let together = self.samples.max(TOGETHER).max(VOXELS).max(column);
        let (points, codes) = (rays * self.samples, 4 * F64 + (3 + 41) * sizes.real);
        // Each task of a step has a gradient of the network.
        let gradients = rays.div_ceil(BUNDLE) * network.parameters();
        let kept = allocation("parameters and moments", parameters, 3 * F64);
        let samples = allocation("samples in the network", sizes.threads * together, computed * sizes.real);
        [
            vec![
                kept,
                allocation("gradient and parameters as the network has them", parameters, F64 + sizes.real),
                allocation("points of a step and gradients to their codes", points, codes),
                allocation("gradients of the network", gradients, F64),
                samples,
            ],
            vec![kept, allocation("parameters and moments as they are written to a checkpoint", parameters, 4 * F64)],
            vec![
                kept,
                allocation("parameters as the network has them", parameters, sizes.real),
                samples,
                allocation("volume", sizes.voxels, F32),
            ],
        ]
    }
}

/// Points at which a column of voxels is read off; the last of an odd number of neighbours is paired with itself.
fn points_of_column(settings: &NeuralSettings, network: &Network, column: usize) -> usize {
    let side = network.points_of_lane();
    if settings.pairs_neighbours { column.next_multiple_of(side) } else { column * side }
}

fn parts(settings: &NeuralSettings) -> (Encoding, Network) {
    let encoding = match settings.kind {
        Kind::IntraTomo => Encoding::Frequencies(6),
        Kind::Naf | Kind::SaxNerf => Encoding::hash(settings.levels, settings.table),
    };
    let network = match settings.kind {
        Kind::IntraTomo => Network::new(encoding.width(), 8, 4, false),
        Kind::Naf => Network::new(encoding.width(), 4, 2, false),
        Kind::SaxNerf => Network::new(encoding.width(), 4, 2, true),
    };
    (encoding, network)
}

/// The scalars of registers.
fn scalars<R: Real>(registers: &[R::Lanes]) -> Vec<R> {
    let mut scalars = vec![R::ZERO; registers.len() * R::Lanes::WIDTH];
    registers.iter().zip(scalars.chunks_exact_mut(R::Lanes::WIDTH)).for_each(|(&register, out)| register.write(out));
    scalars
}

impl Model {
    pub(super) fn new(grid: &Grid, settings: &NeuralSettings) -> Self {
        let (encoding, network) = parts(settings);
        let (table, frame) = (encoding.parameters(), (grid.size() / 2.0).to_array());
        Self { encoding, network, table, frame, is_bounded: settings.is_bounded, ceiling: settings.ceiling }
    }

    pub(super) fn begin(&self, seed: u64) -> Vec<f64> {
        let mut random = stream(seed, Purpose::Network, u64::MAX, 0);
        let table = (0..self.table).map(|_| TABLE * (2.0 * random.random::<f64>() - 1.0));
        let mut parameters: Vec<f64> = table.collect();
        parameters.extend(self.network.begin(seed));
        parameters
    }

    fn field<R: Real>(&self, parameters: &[f64]) -> Field<R> {
        let (table, network) = parameters.split_at(self.table);
        Field { table: table.iter().map(|&value| real(value)).collect(), weights: self.network.weights(network) }
    }

    /// Points in registers, padded by the first: sample n of a pair is in row `2g + n%2`.
    fn registers<R: Real>(&self, grid: &Grid, points: &[DVec3]) -> Vec<[R::Lanes; 3]> {
        let side = self.network.points_of_lane();
        let group = R::Lanes::WIDTH * side;
        let size = grid.size();
        let row = |row: usize| {
            let at = |lane: usize| {
                let n = row / side * group + lane * side + row % side;
                ((points.get(n).unwrap_or(&points[0]) - grid.min) / size).clamp(DVec3::ZERO, DVec3::ONE)
            };
            let places: [DVec3; WIDEST] =
                std::array::from_fn(|lane| if lane < R::Lanes::WIDTH { at(lane) } else { DVec3::ZERO });
            std::array::from_fn(|axis| R::Lanes::from_fn(|lane| real(places[lane][axis])))
        };
        (0..points.len().div_ceil(group) * side).map(row).collect()
    }

    /// Where sample n is among the scalars of the registers.
    fn place<R: Real>(&self, n: usize) -> usize {
        let side = self.network.points_of_lane();
        let group = R::Lanes::WIDTH * side;
        (n / group * side + n % side) * R::Lanes::WIDTH + n % group / side
    }

    /// Densities of registers of points.
    fn forward<R: Real>(&self, field: &Field<R>, points: &[[R::Lanes; 3]], buffers: &mut Buffers<R>) {
        let row = stride(self.encoding.width());
        buffers.codes.resize(points.len() * row, R::Lanes::default());
        for (points, code) in points.iter().zip(buffers.codes.chunks_exact_mut(row)) {
            self.encoding.encode(&field.table, points, self.frame, &mut code[..self.encoding.width()]);
        }
        self.network.forward(&field.weights, &buffers.codes, &mut buffers.trace, &mut buffers.out);
        let ceiling = R::Lanes::splat_f64(self.ceiling);
        for out in &mut buffers.out {
            *out = if self.is_bounded { ceiling * sigmoid(*out) } else { leaky(*out) };
        }
    }

    /// Densities of some points, in units of the scan.
    fn densities_of<R: Real>(
        &self,
        field: &Field<R>,
        grid: &Grid,
        points: &[DVec3],
        buffers: &mut Buffers<R>,
    ) -> Vec<f64> {
        self.forward(field, &self.registers::<R>(grid, points), buffers);
        let lanes = scalars::<R>(&buffers.out);
        (0..points.len()).map(|n| lanes[self.place::<R>(n)].to_f64()).collect()
    }

    /// Densities of some points, in units of the scan, by parameters in double precision.
    #[cfg(test)]
    pub(super) fn densities<R: Real>(&self, grid: &Grid, parameters: &[f64], points: &[DVec3]) -> Vec<f64> {
        self.densities_of(&self.field::<R>(parameters), grid, points, &mut Buffers::default())
    }

    /// The slope of the density by what the network gave, from the density.
    fn slope<L: Lanes>(&self, density: L) -> L {
        if self.is_bounded {
            density * (L::splat_f64(1.0) - density / L::splat_f64(self.ceiling))
        } else {
            leaky_slope(density)
        }
    }
}

impl<'a, R: Real> NeuralRun<'a, R> {
    /// Begins, or continues from a state with the bits of an uninterrupted run. `unit` is the density that counts as 1.
    ///
    /// # Errors
    /// When the projections or the state do not fit.
    pub fn new(
        scanner: &Scanner,
        projections: &'a Projections,
        settings: &NeuralSettings,
        unit: f64,
        state: Option<&VoxelState>,
    ) -> Result<Self> {
        let views = projections.trajectory().views(scanner);
        let (got, expected) =
            (projections.images.dim(), (views.len(), scanner.detector.rows, scanner.detector.columns));
        if got != expected {
            let remedy = "give projections [view, v, u] of this scanner";
            return Err(Error::invalid("projections", format!("shape {got:?}"), format!("{expected:?}"), remedy));
        }
        let model = Model::new(&scanner.grid, settings);
        let mut run = Self {
            grid: scanner.grid,
            views,
            projections,
            settings: *settings,
            unit,
            parameters: Vec::new(),
            adam: [model.table, model.network.parameters()].map(|n| Adam::new(n, BETA, EPSILON)),
            model,
            iteration: 0,
            buffers: Pool::default(),
        };
        match state {
            Some(state) => {
                let table = run.model.table;
                let n = table + run.model.network.parameters();
                let ([steps], [parameters, first, second]) = state.get::<f64, 1, 3>([n; 3])?;
                let done = state.iteration();
                if steps != done as f64 {
                    let expected = "one for each iteration done";
                    return Err(Error::invalid("steps of the optimiser", steps, expected, start_again()));
                }
                run.adam = [0..table, table..n]
                    .map(|own| Adam::continued(BETA, EPSILON, steps as u32, &first[own.clone()], &second[own]));
                (run.parameters, run.iteration) = (parameters, done);
            }
            None => run.parameters = run.model.begin(settings.seed),
        }
        Ok(run)
    }

    /// Mean squared error of the rays of the next step, and its gradient to all parameters.
    pub(super) fn gradient(&self) -> (f64, usize, Vec<f64>) {
        let rays = self.rays();
        let field: Field<R> = self.model.field(&self.parameters);
        let bundles: Vec<&[MeasuredRay]> = rays.chunks(BUNDLE).collect();
        let factor = 2.0 / rays.len().max(1) as f64;
        let shares = threads::map(bundles.len(), |number| self.share(&field, bundles[number], number * BUNDLE, factor));
        let mut gradient = vec![0.0; self.parameters.len()];
        let (to_table, to_network) = gradient.split_at_mut(self.model.table);
        for share in &shares {
            to_network.iter_mut().zip(&share.gradient).for_each(|(sum, &part)| *sum += part);
        }
        if let Encoding::Hash(levels) = &self.model.encoding {
            self.add_to_table(levels, &shares, to_table);
        }
        let errors: Vec<f64> = shares.iter().map(|share| share.error).collect();
        (reduce::sum(&errors), rays.len(), gradient)
    }

    /// The rays of the next step.
    fn rays(&self) -> Vec<MeasuredRay> {
        rays::chosen(&self.grid, &self.views, self.projections, &self.settings, self.iteration, self.unit)
    }

    /// Points and their lengths along the ray with this number in the next step.
    fn samples(&self, ray: &MeasuredRay, number: usize) -> Vec<(DVec3, f64)> {
        let Self { settings, iteration, .. } = self;
        let mut random = stream(settings.seed, Purpose::Jitter, *iteration as u64, number as u64);
        let draws: Vec<f64> = (0..settings.samples).map(|_| random.random()).collect();
        rays::points(ray, &draws)
    }

    /// What the next step sees.
    pub fn batch(&self) -> Batch {
        let rays = self.rays();
        let (count, samples) = (rays.len(), self.settings.samples);
        let mut batch = Batch {
            points: Array3::zeros([count, samples, 3]),
            lengths: Array2::zeros([count, samples]),
            values: rays.iter().map(|ray| ray.value).collect(),
        };
        for (number, ray) in rays.iter().enumerate() {
            for (sample, (point, length)) in self.samples(ray, number).into_iter().enumerate() {
                let place = (point - self.grid.min) / self.grid.size();
                (0..3).for_each(|axis| batch.points[[number, sample, axis]] = place[axis].clamp(0.0, 1.0));
                batch.lengths[[number, sample]] = length;
            }
        }
        batch
    }

    /// All parameters by name; weights are `[outputs, inputs]`, and a level of the table is `[entries, features]`.
    pub fn named_parameters(&self) -> Vec<(String, ArrayD<f64>)> {
        let parts = self.model.encoding.layout().into_iter().chain(self.model.network.layout());
        split(&self.parameters, parts)
    }

    /// A step; returns the mean squared error of its rays before it.
    pub fn train(&mut self) -> f64 {
        let (error, rays) = self.advance();
        error / rays.max(1) as f64
    }

    /// A step; returns the sum of the squared errors of its rays before it, and their number.
    fn advance(&mut self) -> (f64, usize) {
        let (error, rays, gradient) = self.gradient();
        let rates = self.rates();
        let (table, network) = self.parameters.split_at_mut(self.model.table);
        let (to_table, to_network) = gradient.split_at(self.model.table);
        self.adam[0].step(table, to_table, rates[0]);
        self.adam[1].step(network, to_network, rates[1]);
        self.iteration += 1;
        (error, rays)
    }

    /// The gradient of a bundle of rays, the first of which has this number in the step.
    fn share(&self, field: &Field<R>, bundle: &[MeasuredRay], first: usize, factor: f64) -> Share<R> {
        let Self { model, settings, .. } = self;
        let mut buffers = self.buffers.take();
        let mut share = Share {
            error: 0.0,
            gradient: vec![0.0; model.network.parameters()],
            points: Vec::new(),
            to_codes: Vec::new(),
        };
        let together = (TOGETHER / settings.samples).max(1);
        for (number, group) in bundle.chunks(together).enumerate() {
            let mut samples = Vec::with_capacity(group.len() * settings.samples);
            for (k, ray) in group.iter().enumerate() {
                samples.extend(self.samples(ray, first + number * together + k));
            }
            let places: Vec<DVec3> = samples.iter().map(|sample| sample.0).collect();
            let points = model.registers::<R>(&self.grid, &places);
            model.forward(field, &points, &mut buffers);
            let Buffers { trace, out, slopes, to_codes, .. } = &mut *buffers;
            let densities = scalars::<R>(out);
            let mut to_densities = vec![R::ZERO; densities.len()];
            let at = |n: usize| model.place::<R>(n);
            for (k, ray) in group.iter().enumerate() {
                let own = k * settings.samples..(k + 1) * settings.samples;
                let integral: f64 = own.clone().map(|n| densities[at(n)].to_f64() * samples[n].1).sum();
                let error = integral - ray.value;
                share.error += error * error;
                own.for_each(|n| to_densities[at(n)] = real(factor * error * samples[n].1));
            }
            slopes.clear();
            slopes.extend(
                out.iter()
                    .zip(to_densities.chunks_exact(R::Lanes::WIDTH))
                    .map(|(&density, to_density)| R::Lanes::from_slice(to_density) * model.slope(density)),
            );
            model.network.backward(&field.weights, trace, slopes, &mut share.gradient, to_codes);
            share.points.extend(points);
            share.to_codes.extend_from_slice(to_codes);
        }
        share
    }

    /// Adds the gradients of all samples to the table, each level by one task.
    fn add_to_table(&self, levels: &[Level], shares: &[Share<R>], to_table: &mut [f64]) {
        let row = stride(self.model.encoding.width());
        let mut rest = to_table;
        let mut parts: Vec<(usize, &mut [f64])> = Vec::new();
        for (number, level) in levels.iter().enumerate() {
            let (own, others) = rest.split_at_mut(level.entries as usize * FEATURES);
            parts.push((number, own));
            rest = others;
        }
        threads::for_each_chunk(&mut parts, 1, |_, part| {
            let (number, to_table) = &mut part[0];
            let mut sums = vec![R::ZERO; to_table.len()];
            for share in shares {
                for (points, to_code) in share.points.iter().zip(share.to_codes.chunks_exact(row)) {
                    levels[*number].add_gradient(points, &to_code[*number * FEATURES..][..FEATURES], &mut sums);
                }
            }
            to_table.iter_mut().zip(sums).for_each(|(to, sum)| *to = sum.to_f64());
        });
    }

    fn rates(&self) -> [f64; 2] {
        let part = pow(0.1, (self.iteration / self.settings.drop) as f64);
        self.settings.rate.map(|rate| rate * part)
    }
}

impl<R: Real> VoxelRun for NeuralRun<'_, R> {
    fn is_finished(&self) -> bool {
        self.iteration >= self.settings.iterations
    }

    /// The residual is the norm of the errors of the step's rays.
    fn step(&mut self) -> Result<Option<Pass>> {
        let (error, _) = self.advance();
        Pass::new(self.iteration, self.settings.iterations, self.unit * error.sqrt()).map(Some)
    }

    fn state(&self) -> VoxelState<'_> {
        let [(steps, first, second), (_, of_network, squares)] = [0, 1].map(|group| self.adam[group].state());
        let (first, second) = ([first, of_network].concat(), [second, squares].concat());
        VoxelState::new(self.iteration, vec![f64::from(steps)], [self.parameters.clone(), first, second])
    }

    /// The densities at the centres of the voxels.
    fn into_volume(self: Box<Self>) -> Result<Volume> {
        let field: Field<R> = self.model.field(&self.parameters);
        let [nx, ny, nz] = self.grid.shape;
        let side = self.model.network.points_of_lane();
        let pairs_neighbours = self.settings.pairs_neighbours;
        let points = points_of_column(&self.settings, &self.model.network, nz);
        let columns = (VOXELS / points).max(1);
        let mut values = vec![0.0_f32; nx * ny * nz];
        threads::for_each_chunk(&mut values, columns * nz, |chunk, values| {
            let mut buffers = self.buffers.take();
            let centre = |n: usize| {
                let (column, point) = (chunk * columns + n / points, n % points);
                let z = if pairs_neighbours { point.min(nz - 1) } else { point / side };
                let index = [column / ny, column % ny, z].map(|i| i as f64 + 0.5);
                self.grid.min + DVec3::from_array(index) * self.grid.spacing
            };
            let places: Vec<DVec3> = (0..values.len() / nz * points).map(centre).collect();
            let densities = self.model.densities_of(&field, &self.grid, &places, &mut buffers);
            for (n, value) in values.iter_mut().enumerate() {
                let point = if pairs_neighbours { n % nz } else { n % nz * side };
                *value = (densities[n / nz * points + point] * self.unit) as f32;
            }
        });
        Volume::new(self.grid, Array3::from_shape_vec(self.grid.shape, values).expect("a value for each voxel"))
    }
}
