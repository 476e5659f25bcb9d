//! Renders a primitive and takes its gradient with trgs-core alone: `cargo run --release -p trgs-core --example core`.

use trgs_core::{Parameters, Primitives, Projection, Scanner, forward, vjp};

fn main() -> trgs_core::Result<()> {
    let (mean, scale, quaternion) = (vec![[0.1, -0.2, 0.3]], vec![[0.2, 0.1, 0.15]], vec![[0.9, 0.1, 0.3, 0.2]]);
    let primitives = Primitives::new(Parameters { mean, scale, quaternion, density: vec![1.0], nu: vec![5.0] })?;
    let (scanner, angles) = (Scanner::synthetic(32, 48), Scanner::uniform_angles(4, 0.0, std::f64::consts::TAU));
    let images = forward::<f64>(&primitives, &scanner, &angles, Projection::Exact, 0.0);
    // The gradient of half the sum of squares: its cotangent are the images.
    let gradient = vjp(&primitives, &scanner, &angles, Projection::Exact, 0.0, images.view());
    println!("sum {:.6}, d mean {:?}, d nu {:.6}", images.sum(), gradient.mean[0], gradient.nu[0]);
    Ok(())
}
