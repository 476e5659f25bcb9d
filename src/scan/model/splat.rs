//! Primitives as splats of 3D Gaussian splatting, for public viewers: an approximation, which is written and not read.
//!
//! Viewers draw Gaussians of an opacity one over the other; primitives are Student's t-kernels whose line integrals add.
//! A splat has the half width of its primitive: `σ = s·√(ν(2^(2/(ν+3)) - 1)/(2 ln 2))`. Its opacity is the part of the light
//! that its own line integral through the middle absorbs, `1 - exp(-ρ·√(2π)·σ̄)` with the geometric mean σ̄ of its widths;
//! primitives without density are left out. Lengths are in scene units.

use super::ply::colours;
use crate::output::write_atomically;
use serde::Serialize;
use serde_ply::SerializeOptions;
use std::f64::consts::{LN_2, TAU};
use std::io;
use std::path::Path;
use trgs_core::error::Result;
use trgs_core::numeric::elementary::{exp, log};
use trgs_core::primitives::{Parameters, Primitives};

/// The constant spherical harmonic.
const HARMONIC: f64 = 0.282_094_791_773_878_14;
/// `√(2 ln 2)`: of a Gaussian.
const HALF_WIDTH: f64 = 1.177_410_022_515_474_7;
/// Least and greatest opacity: their logits are stored.
const OPACITY: [f64; 2] = [1.0 / 255.0, 0.999];

#[derive(Serialize)]
struct Splat {
    x: f32,
    y: f32,
    z: f32,
    nx: f32,
    ny: f32,
    nz: f32,
    f_dc_0: f32,
    f_dc_1: f32,
    f_dc_2: f32,
    opacity: f32,
    scale_0: f32,
    scale_1: f32,
    scale_2: f32,
    rot_0: f32,
    rot_1: f32,
    rot_2: f32,
    rot_3: f32,
}

#[derive(Serialize)]
struct Ply {
    vertex: Vec<Splat>,
}

/// Writes primitives as splats, coloured as in [`super::ply`], and returns how many have density and are written.
///
/// # Errors
/// [`Error::Write`](trgs_core::error::Error::Write) with the error of the operating system.
pub fn write(path: impl AsRef<Path>, primitives: &Primitives, confidence: Option<&[f64]>) -> Result<usize> {
    let (of, colours) = colours(primitives, confidence);
    let vertex: Vec<_> = (0..primitives.len()).filter_map(|i| splat(&primitives.parameters, i, colours[i])).collect();
    let count = vertex.len();
    let comments = vec![
        "splats of trgs, an approximation: Gaussians with the half widths of the kernels; viewers cover instead of adding".into(),
        format!("colour: viridis of {of}"),
    ];
    let options = SerializeOptions::binary_le().with_comments(comments);
    let content = Ply { vertex };
    write_atomically(path.as_ref(), |out| serde_ply::to_writer(&content, options, out).map_err(io::Error::other))?;
    Ok(count)
}

/// Distance from the centre of a kernel of scale 1 at which its density is half of that at the centre.
pub fn half_width(nu: f64) -> f64 {
    if nu.is_infinite() { HALF_WIDTH } else { (nu * (exp(2.0 / (nu + 3.0) * LN_2) - 1.0)).sqrt() }
}

/// A primitive as a splat; `None` without density.
fn splat(Parameters { mean, scale, quaternion, density, nu }: &Parameters, i: usize, colour: [u8; 3]) -> Option<Splat> {
    if density[i] <= 0.0 {
        return None;
    }
    let logs = scale[i].map(|scale| log(scale * half_width(nu[i]) / HALF_WIDTH));
    let mean_width = exp((logs[0] + logs[1] + logs[2]) / 3.0);
    let absorbed = 1.0 - exp(-density[i] * TAU.sqrt() * mean_width);
    let opacity = absorbed.clamp(OPACITY[0], OPACITY[1]);
    // Divided by the largest entry first: squares of small entries would underflow.
    let largest = quaternion[i].iter().fold(0.0_f64, |largest, part| largest.max(part.abs()));
    let parts = quaternion[i].map(|part| part / largest);
    let length = parts.iter().map(|part| part * part).sum::<f64>().sqrt();
    let [rot_0, rot_1, rot_2, rot_3] = parts.map(|part| (part / length) as f32);
    let [x, y, z] = mean[i].map(|at| at as f32);
    let [scale_0, scale_1, scale_2] = logs.map(|log| log as f32);
    let [f_dc_0, f_dc_1, f_dc_2] = colour.map(|part| ((f64::from(part) / 255.0 - 0.5) / HARMONIC) as f32);
    let opacity = log(opacity / (1.0 - opacity)) as f32;
    let [nx, ny, nz] = [0.0; 3];
    Some(Splat {
        x,
        y,
        z,
        nx,
        ny,
        nz,
        f_dc_0,
        f_dc_1,
        f_dc_2,
        opacity,
        scale_0,
        scale_1,
        scale_2,
        rot_0,
        rot_1,
        rot_2,
        rot_3,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_splat_falls_to_half_where_its_kernel_does() {
        for nu in [0.5, 3.0, 30.0, 1e6] {
            let half = half_width(nu);
            let kernel = exp(-(nu + 3.0) / 2.0 * log(1.0 + half * half / nu));
            within!((kernel - 0.5).abs());
        }
        let half = half_width(f64::INFINITY);
        within!((exp(-half * half / 2.0) - 0.5).abs());
    }

    #[test]
    fn files_have_the_properties_of_splats_and_the_primitives_with_density() {
        let parameters = Parameters {
            mean: vec![[0.1, -0.2, 0.3], [0.0; 3]],
            scale: vec![[0.5, 1.0, 2.0], [1.0; 3]],
            quaternion: vec![[0.0, 0.0, -3.0, 4.0], [1.0, 0.0, 0.0, 0.0]],
            density: vec![0.25, -0.1],
            nu: vec![f64::INFINITY; 2],
        };
        let primitives = Primitives::new(parameters).unwrap();
        let path = tempfile::tempdir().unwrap().keep().join("splats.ply");
        assert_eq!(write(&path, &primitives, Some(&[0.0, 1.0])).unwrap(), 1);
        let content = std::fs::read(&path).unwrap();
        std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
        let end = content.windows(11).position(|part| part == b"end_header\n").unwrap() + 11;
        let header = String::from_utf8_lossy(&content[..end]);
        let names: Vec<_> = header
            .lines()
            .filter_map(|line| line.strip_prefix("property "))
            .map(|line| line.split(' ').nth(1).unwrap())
            .collect();
        assert_eq!(
            names.join(" "),
            "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
        );
        let values: Vec<_> =
            content[end..].chunks(4).map(|part| f32::from_le_bytes(part.try_into().unwrap())).collect();
        assert_eq!(values.len(), names.len());
        assert_eq!((&values[..3], &values[13..]), ([0.1, -0.2, 0.3].as_slice(), [0.0, 0.0, -0.6, 0.8].as_slice()));
        let logs = [0.5, 1.0, 2.0].map(log);
        within!("scale", (0..3).map(|axis| (f64::from(values[10 + axis]) - logs[axis]).abs()).fold(0.0, f64::max));
        let absorbed = 1.0 - exp(-0.25 * TAU.sqrt());
        within!("opacity", (f64::from(values[9]) - log(absorbed / (1.0 - absorbed))).abs());
        // The first colour of viridis.
        let red = f64::from(values[6]) * HARMONIC + 0.5;
        within!("colour", (red * 255.0 - 68.0).abs());
    }
}
