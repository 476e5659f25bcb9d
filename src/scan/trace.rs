//! Projections from line integrals, one ray through the centre of each pixel.

use ndarray::Array3;
use trgs_core::error::Result;
use trgs_core::geometry::{Projections, Ray, Scanner, Trajectory};
use trgs_core::numeric::threads;

/// Projections in the views of a trajectory; each pixel is the `integral` along its ray.
///
/// # Errors
/// When there is no angle, or an angle or an integral is not finite.
pub fn trace<'a>(
    scanner: &Scanner,
    views: impl Into<Trajectory<'a>>,
    integral: impl Fn(&Ray) -> f64 + Sync,
) -> Result<Projections> {
    let views = views.into();
    let (rows, columns) = (scanner.detector.rows, scanner.detector.columns);
    let mut images = Array3::zeros((views.len(), rows, columns));
    let pixels = images.as_slice_mut().expect("a new array is in C order");
    threads::for_each_chunk(pixels, columns, |line, pixels| {
        let view = views.view(scanner, line / rows);
        for (column, pixel) in pixels.iter_mut().enumerate() {
            *pixel = integral(&view.ray(line % rows, column)) as f32;
        }
    });
    Projections::along(views, images)
}
