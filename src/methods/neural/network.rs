//! The network from the encoding of points to their density, and its gradient. Not in the paper.

use super::activation::{leaky, leaky_slope};
use super::block::{self, Begin, BlockTrace, BlockWeights, PARTS, rows};
use super::linear::{HIDDEN, add_bias_gradient, add_gradient, apply, stride, transposed};
use ndarray::ArrayD;
use rand::RngExt;
use rand_distr::StandardNormal;
use std::ops::Range;
use trgs_core::numeric::rng::{Purpose, stream};
use trgs_core::numeric::{Real, real};

/// Layers from the encoding to one number.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Network {
    code: usize,
    layers: Vec<Layer>,
}

/// A layer, and where its parameters are.
#[derive(Clone, Debug, PartialEq)]
enum Layer {
    Linear {
        shape: [usize; 2],
        /// Whether its input is the encoding followed by the output of the layer before.
        is_joined: bool,
        parameters: Range<usize>,
    },
    Block {
        parameters: Range<usize>,
    },
}

/// The parameters of a step in the precision of the kernels.
pub(super) struct Weights<R> {
    values: Vec<R>,
    /// Transposes of the linear layers; empty for a block.
    transposed: Vec<Vec<R>>,
    block: Option<BlockWeights<R>>,
}

/// What the network computed for some rows, for its gradient.
#[derive(Default)]
pub(super) struct Trace<L> {
    /// Input of each layer.
    inputs: Vec<Vec<L>>,
    /// Output of each layer after its rectifier.
    outputs: Vec<Vec<L>>,
    block: BlockTrace<L>,
    scratch: [Vec<L>; 2],
}

impl Network {
    /// `count` layers; the encoding is joined before layer `joined`, and layer 1 may be a block.
    pub(super) fn new(code: usize, count: usize, joined: usize, has_block: bool) -> Self {
        let mut end = 0;
        let mut of = |size: usize| {
            end += size;
            end - size..end
        };
        let layer = |k: usize| {
            if has_block && k == 1 {
                return Layer::Block { parameters: of(block::parameters()) };
            }
            let before = if k == 0 { code } else { HIDDEN };
            let is_joined = k == joined;
            let shape = [if is_joined { code + before } else { before }, if k + 1 == count { 1 } else { HIDDEN }];
            Layer::Linear { shape, is_joined, parameters: of((shape[0] + 1) * shape[1]) }
        };
        Self { code, layers: (0..count).map(layer).collect() }
    }

    /// Whether samples are seen in pairs.
    pub(super) fn has_block(&self) -> bool {
        self.layers.iter().any(|layer| matches!(layer, Layer::Block { .. }))
    }

    /// Points that a lane has: one, or a pair in two rows.
    pub(super) fn points_of_lane(&self) -> usize {
        if self.has_block() { 2 } else { 1 }
    }

    /// Number of parameters.
    pub(super) fn parameters(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.parameters().end)
    }

    /// Name and shape of each part of the parameters, in order.
    pub(super) fn layout(&self) -> Vec<(String, Vec<usize>)> {
        let of = |(number, layer): (usize, &Layer)| -> Vec<(String, Vec<usize>)> {
            let name = |part: &str| format!("layer_{number}.{part}");
            match layer {
                Layer::Linear { shape: [inputs, outputs], .. } => {
                    vec![(name("weight"), vec![*outputs, *inputs]), (name("bias"), vec![*outputs])]
                }
                Layer::Block { .. } => PARTS.iter().map(|part| (name(part.name), part.shape.to_vec())).collect(),
            }
        };
        self.layers.iter().enumerate().flat_map(of).collect()
    }

    /// Parameters at the start: weights and biases uniformly within `±1/√inputs`.
    pub(super) fn begin(&self, seed: u64) -> Vec<f64> {
        let mut values = Vec::with_capacity(self.parameters());
        for (number, layer) in self.layers.iter().enumerate() {
            let mut add = |part: u64, count: usize, begin: Begin| {
                let mut random = stream(seed, Purpose::Network, number as u64, part);
                values.extend((0..count).map(|_| match begin {
                    Begin::Number(number) => number,
                    Begin::Uniform(inputs) => (2.0 * random.random::<f64>() - 1.0) / (inputs as f64).sqrt(),
                    Begin::Normal => loop {
                        let draw: f64 = random.sample(StandardNormal);
                        if draw.abs() <= 2.0 {
                            break draw;
                        }
                    },
                }));
            };
            match layer {
                Layer::Linear { shape: [inputs, outputs], .. } => {
                    add(0, inputs * outputs, Begin::Uniform(*inputs));
                    add(1, *outputs, Begin::Uniform(*inputs));
                }
                Layer::Block { .. } => {
                    PARTS.iter().enumerate().for_each(|(number, part)| add(number as u64, part.len(), part.begin));
                }
            }
        }
        values
    }

    /// The parameters of a step.
    pub(super) fn weights<R: Real>(&self, parameters: &[f64]) -> Weights<R> {
        let values: Vec<R> = parameters.iter().map(|&value| real(value)).collect();
        let transposes = self.layers.iter().map(|layer| match layer {
            Layer::Linear { shape, parameters, .. } => {
                transposed(&values[parameters.clone()][..shape[0] * shape[1]], *shape)
            }
            Layer::Block { .. } => Vec::new(),
        });
        let transposed = transposes.collect();
        let block = self.layers.iter().find_map(|layer| match layer {
            Layer::Block { parameters } => Some(BlockWeights::new(&values[parameters.clone()])),
            Layer::Linear { .. } => None,
        });
        Weights { values, transposed, block }
    }

    /// The output of the last layer, a register for each row, from rows of codes.
    pub(super) fn forward<R: Real>(
        &self,
        weights: &Weights<R>,
        code: &[R::Lanes],
        trace: &mut Trace<R::Lanes>,
        out: &mut Vec<R::Lanes>,
    ) {
        let count = code.len() / stride(self.code);
        trace.inputs.resize_with(self.layers.len(), Vec::new);
        trace.outputs.resize_with(self.layers.len(), Vec::new);
        for (k, layer) in self.layers.iter().enumerate() {
            let (before, after) = trace.outputs.split_at_mut(k);
            let (input, output) = (&mut trace.inputs[k], &mut after[0]);
            match layer {
                Layer::Linear { shape, is_joined, parameters } => {
                    let width = shape[0];
                    rows(input, count, width);
                    rows(output, count, shape[1]);
                    for (row, input) in input.chunks_exact_mut(stride(width)).enumerate() {
                        let code = &code[row * stride(self.code)..][..self.code];
                        let taken = if k == 0 || *is_joined { self.code } else { 0 };
                        input[..taken].copy_from_slice(&code[..taken]);
                        if let Some(before) = before.last() {
                            let before = &before[row * stride(HIDDEN)..][..HIDDEN];
                            input[taken..width].copy_from_slice(before);
                        }
                    }
                    let (w, bias) = weights.values[parameters.clone()].split_at(shape[0] * shape[1]);
                    apply(w, Some(bias), input, output, *shape);
                }
                Layer::Block { .. } => {
                    input.clone_from(&before[k - 1]);
                    rows(output, count, HIDDEN);
                    let block = weights.block.as_ref().expect("made from the same layers");
                    block.forward(input, &mut trace.block, output);
                }
            }
            if k + 1 < self.layers.len() {
                output.iter_mut().for_each(|value| *value = leaky(*value));
            }
        }
        out.clear();
        // A row of one number is one register.
        out.extend_from_slice(trace.outputs.last().expect("there are layers"));
    }

    /// Adds the gradient to the parameters, and writes the gradient to the rows of codes, from the one to the output.
    pub(super) fn backward<R: Real>(
        &self,
        weights: &Weights<R>,
        trace: &mut Trace<R::Lanes>,
        slopes: &[R::Lanes],
        gradient: &mut [f64],
        to_code: &mut Vec<R::Lanes>,
    ) {
        let count = slopes.len();
        to_code.clear();
        rows(to_code, count, self.code);
        let Trace { inputs, outputs, block: block_trace, scratch: [d, dx] } = trace;
        d.clear();
        d.extend_from_slice(slopes);
        for (k, layer) in self.layers.iter().enumerate().rev() {
            if k + 1 < self.layers.len() {
                d.iter_mut().zip(&outputs[k]).for_each(|(d, &output)| *d = *d * leaky_slope(output));
            }
            match layer {
                Layer::Linear { shape, is_joined, parameters } => {
                    let [width, height] = *shape;
                    let (to_weights, to_bias) = gradient[parameters.clone()].split_at_mut(width * height);
                    add_gradient(&inputs[k], d, to_weights, *shape);
                    add_bias_gradient(d, to_bias, height);
                    rows(dx, count, width);
                    apply(&weights.transposed[k], None, d, dx, [height, width]);
                    let of_code = if k == 0 || *is_joined { self.code } else { 0 };
                    rows(d, count, HIDDEN);
                    for (row, dx) in dx.chunks_exact(stride(width)).enumerate() {
                        let code = &mut to_code[row * stride(self.code)..][..self.code];
                        code.iter_mut().zip(&dx[..of_code]).for_each(|(code, &dx)| *code += dx);
                        if k > 0 {
                            d[row * stride(HIDDEN)..][..HIDDEN].copy_from_slice(&dx[of_code..width]);
                        }
                    }
                }
                Layer::Block { parameters } => {
                    let block = weights.block.as_ref().expect("made from the same layers");
                    block.backward(block_trace, d, &mut gradient[parameters.clone()]);
                }
            }
        }
    }
}

impl Layer {
    fn parameters(&self) -> &Range<usize> {
        match self {
            Self::Linear { parameters, .. } | Self::Block { parameters } => parameters,
        }
    }
}

/// Parameters as arrays of the named shapes, in order.
///
/// # Panics
/// When there are fewer parameters than the shapes have elements.
pub(super) fn split(
    parameters: &[f64],
    parts: impl Iterator<Item = (String, Vec<usize>)>,
) -> Vec<(String, ArrayD<f64>)> {
    let mut rest = parameters;
    let own = |(name, shape): (String, Vec<usize>)| {
        let (own, others) = rest.split_at(shape.iter().product());
        rest = others;
        (name, ArrayD::from_shape_vec(shape, own.to_vec()).expect("as many numbers as the shape has"))
    };
    parts.map(own).collect()
}
