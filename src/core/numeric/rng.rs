//! Counter-based random numbers. Not in the paper.
//!
//! A draw is a function of (seed, purpose, step, id, component). It does not depend on the order of the work or on other
//! draws.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Purposes of random numbers. Each has its own key, so that no two share a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Photon and electronic noise; step = view, id = pixel.
    Noise = 1,
    /// Choice of initial points.
    Initialisation = 2,
    /// Order of the views; step = epoch.
    ViewOrder = 3,
    /// Position of the total-variation block; step = iteration.
    TotalVariation = 4,
    /// Test angles of a simulation.
    TestAngles = 5,
    /// Solids of a procedural phantom; id = solid.
    Phantom = 6,
    /// Noise of the positions in SGHMC; step = iteration, id = primitive.
    PositionNoise = 7,
    /// Positions of the parts of a split primitive; step = iteration, id = primitive.
    Splitting = 8,
    /// Choice of the primitives to copy; step = iteration.
    Recycling = 9,
    /// Position of the wavelet block; step = iteration.
    Wavelet = 10,
    /// Choice of test views among those of a scan.
    TestViews = 11,
    /// Start of a network; step = layer, id = part.
    Network = 12,
    /// Choice of rays of a network's step.
    Rays = 13,
    /// Places of points along rays; step = step, id = ray.
    Jitter = 14,
    /// Wrong pixels of an experiment; step = view.
    Damage = 15,
    /// Error of a simulated flat field; id = pixel.
    FlatField = 16,
    /// Generated conformance questions; step = stage, id = question.
    Questions = 17,
    /// Small changes of a question's inputs; step = sample.
    Perturbation = 18,
}

/// The generator for one (seed, purpose, step, id); its successive draws are the components.
pub fn stream(seed: u64, purpose: Purpose, step: u64, id: u64) -> ChaCha8Rng {
    let mut key = [0_u8; 32];
    for (slot, word) in key.chunks_exact_mut(8).zip([seed, purpose as u64, step, 0x7472_6773]) {
        slot.copy_from_slice(&word.to_le_bytes());
    }
    let mut generator = ChaCha8Rng::from_seed(key);
    generator.set_stream(id);
    generator
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;

    #[test]
    fn every_part_of_the_address_changes_the_draw() {
        let draw = |seed, purpose, step, id| stream(seed, purpose, step, id).next_u64();
        let base = draw(0, Purpose::Noise, 0, 0);
        assert_eq!(base, draw(0, Purpose::Noise, 0, 0));
        for other in [
            draw(1, Purpose::Noise, 0, 0),
            draw(0, Purpose::ViewOrder, 0, 0),
            draw(0, Purpose::Noise, 1, 0),
            draw(0, Purpose::Noise, 0, 1),
        ] {
            assert_ne!(base, other);
        }
    }
}
