//! Renders primitives and pulls a gradient of the images back to their parameters: all that a fit of one's own needs.
//!
//!     cargo run --release --example render_and_vjp -- MODEL.npz
//!
//! Without an argument: three primitives. A model is that of any run of `trgs reconstruct`.

use std::f64::consts::TAU;
use std::path::Path;
use trgs::primitives::Parameters;
use trgs::projector::{forward, vjp};
use trgs::scan::model;
use trgs::{Primitives, Projection, Scanner};

fn main() -> trgs::Result<()> {
    let primitives = match std::env::args().nth(1) {
        Some(path) => model::read(Path::new(&path))?,
        None => three()?,
    };
    let scanner = Scanner::synthetic(32, 48);
    let angles = Scanner::uniform_angles(4, 0.0, TAU);
    // A primitive ends where its projection has fallen to this fraction of its peak; 0 keeps all of it.
    let cutoff = 0.0;
    let render = |primitives: &Primitives| forward::<f64>(primitives, &scanner, &angles, Projection::Exact, cutoff);

    // Images [view, v, u], and the loss ½ Σ p²: its gradient with respect to the images are the images.
    let images = render(&primitives);
    let loss = |primitives: &Primitives| 0.5 * render(primitives).iter().map(|pixel| pixel * pixel).sum::<f64>();
    let gradient = vjp(&primitives, &scanner, &angles, Projection::Exact, cutoff, images.view());

    println!("loss {:.6}", loss(&primitives));
    for i in 0..primitives.len().min(3) {
        println!(
            "primitive {i}: d mean {:?}, d density {:.6}, d nu {:.6}",
            gradient.mean[i], gradient.density[i], gradient.nu[i]
        );
    }

    // The same number from a difference of two losses.
    let step = 1e-5;
    let moved = |by: f64| {
        let mut moved = primitives.clone();
        moved.parameters.mean[0][0] += by;
        loss(&moved)
    };
    let difference = (moved(step) - moved(-step)) / (2.0 * step);
    println!("d mean x of primitive 0: {:.8}, by differences {difference:.8}", gradient.mean[0][0]);
    Ok(())
}

fn three() -> trgs::Result<Primitives> {
    Primitives::new(Parameters {
        mean: vec![[0.1, -0.2, 0.3], [-0.4, 0.0, 0.1], [0.2, 0.4, -0.3]],
        scale: vec![[0.2, 0.1, 0.15], [0.1, 0.1, 0.3], [0.25, 0.2, 0.1]],
        quaternion: vec![[1.0, 0.0, 0.0, 0.0], [0.9, 0.1, 0.3, 0.2], [0.5, 0.5, 0.5, 0.5]],
        density: vec![1.0, 0.6, 0.8],
        nu: vec![5.0, 10.0, 40.0],
    })
}
