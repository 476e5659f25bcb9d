//! The Lineformer block of SAX-NeRF, not in the paper: attention between the two points of a pair, and a feed-forward
//! network, each added to its input after a normalisation of the layer.
//!
//! ```text
//! y = x + Wo·A(N₁(x)) + bo          A: softmax((½q)·k + P)·v in 8 heads of 4;  q = Wq·n, [k, v] = Wkv·n
//! z = y + W3·G(W2·G(W1·N₂(y)))      G(x) = x·Φ(x)
//! ```
//!
//! Rows 2g and 2g+1 of an array hold the first and the second points of pairs.

use super::activation::{gelu, sigmoid};
use super::linear::{HIDDEN, add_bias_gradient, add_gradient, apply, stride, transposed};
use std::ops::Range;
use trgs_core::numeric::{Lanes, Real};

/// Points of a line.
const PAIR: usize = 2;
const HEADS: usize = 8;
/// Numbers of a head.
const DEPTH: usize = HIDDEN / HEADS;
/// Width within the feed-forward network.
const WIDE: usize = 4 * HIDDEN;
/// Factor of the queries, `DEPTH^-½`.
const QUERY: f64 = 0.5;
/// Added to the variance of a layer.
const VARIANCE: f64 = 1e-5;

/// Linear layers: inputs and outputs.
const SHAPES: [[usize; 2]; 6] =
    [[HIDDEN, HIDDEN], [HIDDEN, 2 * HIDDEN], [HIDDEN, HIDDEN], [HIDDEN, WIDE], [WIDE, WIDE], [WIDE, HIDDEN]];
const QUERIES: usize = 0;
const KEYS: usize = 1;
const OUT: usize = 2;
const FIRST: usize = 3;
const SECOND: usize = 4;
const THIRD: usize = 5;

/// A part of the block's parameters.
pub(super) struct Part {
    pub(super) name: &'static str,
    /// Weights are `[outputs, inputs]`.
    pub(super) shape: &'static [usize],
    pub(super) begin: Begin,
}

impl Part {
    /// Number of parameters.
    pub(super) const fn len(&self) -> usize {
        let (mut product, mut axis) = (1, 0);
        while axis < self.shape.len() {
            product *= self.shape[axis];
            axis += 1;
        }
        product
    }
}

const fn of(name: &'static str, shape: &'static [usize], begin: Begin) -> Part {
    Part { name, shape, begin }
}

/// The parts in order.
pub(super) const PARTS: [Part; 12] = [
    of("gain_1", &[HIDDEN], Begin::Number(1.0)),
    of("shift_1", &[HIDDEN], Begin::Number(0.0)),
    of("query", &[HIDDEN, HIDDEN], Begin::Uniform(HIDDEN)),
    of("key_value", &[2 * HIDDEN, HIDDEN], Begin::Uniform(HIDDEN)),
    of("position", &[HEADS, PAIR, PAIR], Begin::Normal),
    of("out", &[HIDDEN, HIDDEN], Begin::Uniform(HIDDEN)),
    of("out_bias", &[HIDDEN], Begin::Uniform(HIDDEN)),
    of("gain_2", &[HIDDEN], Begin::Number(1.0)),
    of("shift_2", &[HIDDEN], Begin::Number(0.0)),
    of("first", &[WIDE, HIDDEN], Begin::Uniform(HIDDEN)),
    of("second", &[WIDE, WIDE], Begin::Uniform(WIDE)),
    of("third", &[HIDDEN, WIDE], Begin::Uniform(WIDE)),
];
const GAIN_1: usize = 0;
const SHIFT_1: usize = 1;
const POSITIONS: usize = 4;
const OUT_BIAS: usize = 6;
const GAIN_2: usize = 7;
const SHIFT_2: usize = 8;
/// The part of each linear layer.
const LINEAR: [usize; 6] = [2, 3, 5, 9, 10, 11];

/// How parameters start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Begin {
    /// At a number.
    Number(f64),
    /// Uniformly within `±1/√inputs`.
    Uniform(usize),
    /// Normally with standard deviation 1, within ±2.
    Normal,
}

/// Number of the block's parameters.
pub(super) fn parameters() -> usize {
    PARTS.iter().map(Part::len).sum()
}

fn part(number: usize) -> Range<usize> {
    let start: usize = PARTS[..number].iter().map(Part::len).sum();
    start..start + PARTS[number].len()
}

/// The parameters of a step, and the transposes of the linear layers.
pub(super) struct BlockWeights<R> {
    values: Vec<R>,
    transposed: [Vec<R>; 6],
}

/// What the block computed, for its gradient.
#[derive(Default)]
pub(super) struct BlockTrace<L> {
    normal: [Normal<L>; 2],
    queries: Vec<L>,
    keys: Vec<L>,
    /// Weight of the first and of the second point, for each row and head.
    attention: Vec<[L; PAIR]>,
    mixed: Vec<L>,
    middle: Vec<L>,
    /// Before and after each of the two rectifiers.
    wide: [[Vec<L>; 2]; 2],
    scratch: [Vec<L>; 3],
}

/// A normalised layer.
#[derive(Default)]
struct Normal<L> {
    /// With mean 0 and variance 1.
    hat: Vec<L>,
    /// 1 over the standard deviation of each row.
    inverse: Vec<L>,
    /// After gain and shift.
    value: Vec<L>,
}

/// A buffer of rows, with any content.
pub(super) fn rows<L: Lanes>(buffer: &mut Vec<L>, count: usize, width: usize) {
    buffer.resize(count * stride(width), L::default());
}

impl<R: Real> BlockWeights<R> {
    pub(super) fn new(parameters: &[R]) -> Self {
        let transposed = std::array::from_fn(|k| transposed(&parameters[part(LINEAR[k])], SHAPES[k]));
        Self { values: parameters.to_vec(), transposed }
    }

    fn of(&self, number: usize) -> &[R] {
        &self.values[part(number)]
    }

    fn linear(&self, k: usize, bias: Option<&[R]>, x: &[R::Lanes], y: &mut [R::Lanes]) {
        apply(self.of(LINEAR[k]), bias, x, y, SHAPES[k]);
    }

    /// The gradient to the input of a linear layer.
    fn linear_back(&self, k: usize, dy: &[R::Lanes], dx: &mut [R::Lanes]) {
        let [inputs, outputs] = SHAPES[k];
        apply(&self.transposed[k], None, dy, dx, [outputs, inputs]);
    }

    /// The block's output for rows of `HIDDEN`.
    pub(super) fn forward(&self, x: &[R::Lanes], trace: &mut BlockTrace<R::Lanes>, z: &mut [R::Lanes]) {
        let count = x.len() / stride(HIDDEN);
        let BlockTrace { normal: [first, second], queries, keys, attention, mixed, middle, wide, .. } = trace;
        first.forward(x, self.of(GAIN_1), self.of(SHIFT_1));
        rows(queries, count, HIDDEN);
        rows(keys, count, 2 * HIDDEN);
        rows(mixed, count, HIDDEN);
        rows(middle, count, HIDDEN);
        self.linear(QUERIES, None, &first.value, queries);
        self.linear(KEYS, None, &first.value, keys);
        queries.iter_mut().for_each(|q| *q = *q * R::Lanes::splat_f64(QUERY));
        attend(self.of(POSITIONS), queries, keys, attention, mixed);
        self.linear(OUT, Some(self.of(OUT_BIAS)), mixed, middle);
        middle.iter_mut().zip(x).for_each(|(y, &x)| *y += x);
        second.forward(middle, self.of(GAIN_2), self.of(SHIFT_2));
        let [[before_1, after_1], [before_2, after_2]] = wide;
        for buffer in [&mut *before_1, after_1, before_2, after_2] {
            rows(buffer, count, WIDE);
        }
        self.linear(FIRST, None, &second.value, before_1);
        after_1.iter_mut().zip(&*before_1).for_each(|(after, &before)| *after = gelu(before)[0]);
        self.linear(SECOND, None, after_1, before_2);
        after_2.iter_mut().zip(&*before_2).for_each(|(after, &before)| *after = gelu(before)[0]);
        self.linear(THIRD, None, after_2, z);
        z.iter_mut().zip(&*middle).for_each(|(z, &y)| *z += y);
    }

    /// Adds the gradient to the parameters, and turns the gradient to the output into that to the input.
    pub(super) fn backward(&self, trace: &mut BlockTrace<R::Lanes>, d: &mut [R::Lanes], gradient: &mut [f64]) {
        let count = d.len() / stride(HIDDEN);
        let BlockTrace { normal: [first, second], queries, keys, attention, mixed, wide, scratch, .. } = trace;
        let [a, b, c] = scratch;
        let [[before_1, after_1], [before_2, after_2]] = wide;
        let mut linear = |k: usize, x: &[R::Lanes], dy: &[R::Lanes]| {
            add_gradient(x, dy, &mut gradient[part(LINEAR[k])], SHAPES[k]);
        };
        rows(a, count, WIDE);
        rows(b, count, WIDE);
        rows(c, count, HIDDEN);
        linear(THIRD, after_2, d);
        self.linear_back(THIRD, d, a);
        a.iter_mut().zip(&*before_2).for_each(|(d, &before)| *d = *d * gelu(before)[1]);
        linear(SECOND, after_1, a);
        self.linear_back(SECOND, a, b);
        b.iter_mut().zip(&*before_1).for_each(|(d, &before)| *d = *d * gelu(before)[1]);
        linear(FIRST, &second.value, b);
        self.linear_back(FIRST, b, c);
        second.backward(c, self.of(GAIN_2), gradient, [GAIN_2, SHIFT_2]);
        d.iter_mut().zip(&*c).for_each(|(d, &c)| *d += c);

        add_gradient(mixed, d, &mut gradient[part(LINEAR[OUT])], SHAPES[OUT]);
        add_bias_gradient(d, &mut gradient[part(OUT_BIAS)], HIDDEN);
        self.linear_back(OUT, d, c);
        rows(a, count, HIDDEN);
        rows(b, count, 2 * HIDDEN);
        attend_back(queries, keys, attention, c, [a, b], &mut gradient[part(POSITIONS)]);
        a.iter_mut().for_each(|q| *q = *q * R::Lanes::splat_f64(QUERY));
        add_gradient(&first.value, a, &mut gradient[part(LINEAR[QUERIES])], SHAPES[QUERIES]);
        add_gradient(&first.value, b, &mut gradient[part(LINEAR[KEYS])], SHAPES[KEYS]);
        self.linear_back(QUERIES, a, c);
        // Of the queries; that of the keys is added.
        rows(a, count, HIDDEN);
        self.linear_back(KEYS, b, a);
        c.iter_mut().zip(&*a).for_each(|(c, &a)| *c += a);
        first.backward(c, self.of(GAIN_1), gradient, [GAIN_1, SHIFT_1]);
        d.iter_mut().zip(&*c).for_each(|(d, &c)| *d += c);
    }
}

impl<L: Lanes> Normal<L> {
    fn forward(&mut self, x: &[L], gain: &[L::Scalar], shift: &[L::Scalar]) {
        let count = x.len() / stride(HIDDEN);
        rows(&mut self.hat, count, HIDDEN);
        rows(&mut self.value, count, HIDDEN);
        self.inverse.resize(count, L::default());
        let part = L::splat_f64(1.0 / HIDDEN as f64);
        let targets = self.hat.chunks_exact_mut(stride(HIDDEN)).zip(self.value.chunks_exact_mut(stride(HIDDEN)));
        for ((x, (hat, value)), inverse) in x.chunks_exact(stride(HIDDEN)).zip(targets).zip(&mut self.inverse) {
            let mean = x[..HIDDEN].iter().fold(L::default(), |sum, &x| sum + x) * part;
            let variance = x[..HIDDEN].iter().fold(L::default(), |sum, &x| (x - mean).fma(x - mean, sum)) * part;
            *inverse = L::splat_f64(1.0) / (variance + L::splat_f64(VARIANCE)).sqrt();
            for i in 0..HIDDEN {
                hat[i] = (x[i] - mean) * *inverse;
                value[i] = L::splat(gain[i]).fma(hat[i], L::splat(shift[i]));
            }
        }
    }

    /// Turns the gradient to the value into that to the input.
    fn backward(&self, d: &mut [L], gain: &[L::Scalar], gradient: &mut [f64], [gains, shifts]: [usize; 2]) {
        let mut sums = [[L::default(); HIDDEN]; 2];
        let part_of = L::splat_f64(1.0 / HIDDEN as f64);
        for ((d, hat), &inverse) in
            d.chunks_exact_mut(stride(HIDDEN)).zip(self.hat.chunks_exact(stride(HIDDEN))).zip(&self.inverse)
        {
            let (mut mean, mut along) = (L::default(), L::default());
            for i in 0..HIDDEN {
                sums[0][i] = d[i].fma(hat[i], sums[0][i]);
                sums[1][i] += d[i];
                d[i] = d[i] * L::splat(gain[i]);
                mean += d[i];
                along = d[i].fma(hat[i], along);
            }
            let (mean, along) = (mean * part_of, along * part_of);
            for i in 0..HIDDEN {
                d[i] = inverse * (d[i] - mean - hat[i] * along);
            }
        }
        for (to, sums) in [gains, shifts].into_iter().zip(sums) {
            gradient[part(to)].iter_mut().zip(sums).for_each(|(gradient, sum)| *gradient += sum.sum());
        }
    }
}

/// Attention of each pair; keys are followed by values.
fn attend<R: Real>(
    positions: &[R],
    queries: &[R::Lanes],
    keys: &[R::Lanes],
    attention: &mut Vec<[R::Lanes; PAIR]>,
    mixed: &mut [R::Lanes],
) {
    attention.clear();
    let pairs = queries.chunks_exact(PAIR * stride(HIDDEN)).zip(keys.chunks_exact(PAIR * stride(2 * HIDDEN)));
    for ((queries, keys), mixed) in pairs.zip(mixed.chunks_exact_mut(PAIR * stride(HIDDEN))) {
        for own in 0..PAIR {
            for head in 0..HEADS {
                let query = &queries[own * stride(HIDDEN) + head * DEPTH..][..DEPTH];
                let score = |other: usize| {
                    let start = R::Lanes::splat(positions[(head * PAIR + own) * PAIR + other]);
                    let key = &keys[other * stride(2 * HIDDEN) + head * DEPTH..][..DEPTH];
                    query.iter().zip(key).fold(start, |sum, (&q, &k)| q.fma(k, sum))
                };
                let ahead = score(0) - score(1);
                let weights = [sigmoid(ahead), sigmoid(-ahead)];
                for d in 0..DEPTH {
                    let value = |other: usize| keys[other * stride(2 * HIDDEN) + HIDDEN + head * DEPTH + d];
                    mixed[own * stride(HIDDEN) + head * DEPTH + d] = weights[1].fma(value(1), weights[0] * value(0));
                }
                attention.push(weights);
            }
        }
    }
}

/// Gradients to the queries, to keys and values, and to the positions, from the one to the mixed values.
fn attend_back<L: Lanes>(
    queries: &[L],
    keys: &[L],
    attention: &[[L; PAIR]],
    mixed: &[L],
    [to_queries, to_keys]: [&mut Vec<L>; 2],
    to_positions: &mut [f64],
) {
    to_queries.fill(L::default());
    to_keys.fill(L::default());
    let mut sums = [L::default(); HEADS * PAIR * PAIR];
    let key_row = stride(2 * HIDDEN);
    let pairs = queries.chunks_exact(PAIR * stride(HIDDEN)).zip(keys.chunks_exact(PAIR * key_row));
    let targets = to_queries.chunks_exact_mut(PAIR * stride(HIDDEN)).zip(to_keys.chunks_exact_mut(PAIR * key_row));
    let given = mixed.chunks_exact(PAIR * stride(HIDDEN)).zip(attention.chunks_exact(PAIR * HEADS));
    for (((queries, keys), (mixed, attention)), (to_queries, to_keys)) in pairs.zip(given).zip(targets) {
        for own in 0..PAIR {
            for head in 0..HEADS {
                let weights = attention[own * HEADS + head];
                let at = own * stride(HIDDEN) + head * DEPTH;
                let value = |other: usize| other * key_row + HIDDEN + head * DEPTH;
                let key = |other: usize| other * key_row + head * DEPTH;
                let mut along = [L::default(); PAIR];
                for d in 0..DEPTH {
                    for other in 0..PAIR {
                        to_keys[value(other) + d] = weights[other].fma(mixed[at + d], to_keys[value(other) + d]);
                        along[other] = mixed[at + d].fma(keys[value(other) + d], along[other]);
                    }
                }
                let ahead = weights[0] * weights[1] * (along[0] - along[1]);
                for (other, to_score) in [ahead, -ahead].into_iter().enumerate() {
                    sums[(head * PAIR + own) * PAIR + other] += to_score;
                    for d in 0..DEPTH {
                        to_queries[at + d] = to_score.fma(keys[key(other) + d], to_queries[at + d]);
                        to_keys[key(other) + d] = to_score.fma(queries[at + d], to_keys[key(other) + d]);
                    }
                }
            }
        }
    }
    to_positions.iter_mut().zip(sums).for_each(|(to, sum)| *to += sum.sum());
}
