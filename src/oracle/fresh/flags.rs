//! The words in `flags` of generated questions, and what they say.

/// Of questions with a truth.
pub(super) const VALUES: [(&str, &str); 22] = [
    ("random", "numbers drawn from their ranges"),
    ("edge", "numbers at the ends of their ranges"),
    ("spaced", "numbers spaced evenly over the questions"),
    ("adversarial", "one property that programs are known to get wrong"),
    ("one-pixel", "a detector or a volume with sides of one"),
    ("zero-density", "a primitive without density"),
    ("tiny-density", "a density of 1e-30 beside others, or densities of 1e-24 alone"),
    ("centre-on-pixel", "a centre that a pixel's ray meets"),
    ("detector-border", "a centre that projects onto the outline of the detector"),
    ("unnormalised-quaternion", "quaternions of other norms than 1"),
    ("equal-primitives", "two primitives in the same place"),
    ("gaussian-limit", "ν = ∞"),
    ("nu-end", "ν at the end of its range"),
    ("nu-outside-training-range", "ν = 1, 10³, 10⁴ or 10⁶"),
    ("behind-source", "a primitive behind the source, or near its plane"),
    ("ill-conditioned", "a needle or a disc, axes 1:1000"),
    ("zero-image", "zeros, or equal values, throughout"),
    ("large-arrays", "a detector of 256² or 250×190 pixels, a volume of 65×48×33 voxels"),
    ("many-primitives", "5,000 primitives, or 1,025 where each has an output"),
    ("covering-primitive", "a primitive over the whole detector, among small ones"),
    ("crowded-tile", "300 primitives in one tile"),
    ("odd-count", "counts that are no multiples of 16, 32 or 256"),
];

/// Of relations.
pub(super) const RELATIONS: [(&str, &str); 7] = [
    ("rotated", "scene and scanner are turned around the axis of rotation: the same image"),
    ("reordered", "primitives and views come in the reversed order: the same sums"),
    ("split", "the last primitive is two of half its density: the same sum"),
    ("linear", "two models, and the first with three times the second: a sum of their answers"),
    ("views", "each view alone, then all: the same images, and the sum of the gradients"),
    ("scaled", "all lengths times 1.5: line integrals times 1.5"),
    ("adjoint", "⟨image, cotangent⟩ is the sum of density times its gradient"),
];

/// Of questions without an answer.
pub(super) const REFUSALS: [(&str, &str); 3] = [
    ("refuse", "the inputs mean nothing: no answer, an error, or NaN, but no finite numbers"),
    ("finite", "a valid question: finite numbers"),
    ("either", "no answer, an error, or finite numbers"),
];
