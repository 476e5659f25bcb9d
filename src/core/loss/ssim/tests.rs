use super::*;
use crate::loss::testing::assert_matches_central_differences;
use crate::numeric::elementary::exp;
use crate::tolerances::largest;

/// SSIM as it is written, with the window as a matrix: a sum of 121 products for each blur and pixel.
fn naive(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    let (rows, columns) = a.dim();
    let gauss: Vec<f64> = (0..11).map(|i| exp(-((i as f64 - 5.0) * (i as f64 - 5.0)) / 4.5)).collect();
    let total: f64 = gauss.iter().sum();
    let blur = |row: usize, column: usize, of: &dyn Fn(f64, f64) -> f64| {
        let mut sum = 0.0;
        for (i, wi) in gauss.iter().enumerate() {
            for (j, wj) in gauss.iter().enumerate() {
                let (r, c) = ((row + i).wrapping_sub(5), (column + j).wrapping_sub(5));
                if r < rows && c < columns {
                    sum += wi / total * (wj / total) * of(a[[r, c]], b[[r, c]]);
                }
            }
        }
        sum
    };
    let mut sum = 0.0;
    for row in 0..rows {
        for column in 0..columns {
            let at = |of: &dyn Fn(f64, f64) -> f64| blur(row, column, of);
            let (mean_a, mean_b) = (at(&|a, _| a), at(&|_, b| b));
            let variance_a = at(&|a, _| a * a) - mean_a * mean_a;
            let variance_b = at(&|_, b| b * b) - mean_b * mean_b;
            let covariance = at(&|a, b| a * b) - mean_a * mean_b;
            sum += (2.0 * mean_a * mean_b + 1e-4) * (2.0 * covariance + 9e-4)
                / ((mean_a * mean_a + mean_b * mean_b + 1e-4) * (variance_a + variance_b + 9e-4));
        }
    }
    sum / (rows * columns) as f64
}

fn images(rows: usize, columns: usize) -> (Array2<f64>, Array2<f64>) {
    let wave = |x: usize, y: usize, k: usize| ((x * x * 3 + y * 7 * k + x * y) % 23) as f64 / 20.0;
    (
        Array2::from_shape_fn((rows, columns), |(r, c)| wave(r, c, 1)),
        Array2::from_shape_fn((rows, columns), |(r, c)| wave(r, c, 1) * 0.8 + 0.2 * wave(c, r, 2)),
    )
}

#[test]
fn value_agrees_with_the_double_loop_for_every_shape() {
    for (rows, columns) in [(1, 1), (1, 40), (3, 2), (16, 16), (17, 33), (50, 7), (33, 64), (70, 9), (6, 150)] {
        let (a, b) = images(rows, columns);
        let ssim = Ssim::<f64>::default();
        let value = ssim.value(a.view(), &SsimTarget::new(&ssim, b.view()));
        let truth = naive(&a, &b);
        within!((value - truth).abs(), "{rows}×{columns}: {value} against {truth}");
        let single = Ssim::<f32>::default();
        let (a, b) = (a.mapv(|x| x as f32), b.mapv(|x| x as f32));
        let value = single.value(a.view(), &SsimTarget::new(&single, b.view()));
        within!("f32", (value - truth).abs(), "{rows}×{columns} in f32: {value} against {truth}");
    }
}

#[test]
fn gradient_matches_central_differences_across_bands_and_borders() {
    for (rows, columns) in [(2, 3), (35, 13), (18, 40), (67, 9), (4, 75)] {
        let (a, b) = images(rows, columns);
        let ssim = Ssim::<f64>::default();
        let target = SsimTarget::new(&ssim, b.view());
        let (value, gradient) = ssim.value_and_grad(a.view(), &target);
        assert_eq!(value, ssim.value(a.view(), &target));
        assert_matches_central_differences(&a, &gradient, 1, |a| ssim.value(a.view(), &target));
    }
}

#[test]
fn gradient_in_f32_agrees_with_f64() {
    let (a, b) = images(40, 50);
    let (double, single) = (Ssim::<f64>::default(), Ssim::<f32>::default());
    let (_, truth) = double.value_and_grad(a.view(), &SsimTarget::new(&double, b.view()));
    let (a, b) = (a.mapv(|x| x as f32), b.mapv(|x| x as f32));
    let (_, gradient) = single.value_and_grad(a.view(), &SsimTarget::new(&single, b.view()));
    let peak = largest(truth.iter().copied());
    for (g, t) in gradient.iter().zip(&truth) {
        within!((f64::from(*g) - t).abs() / peak, "{g:e} against {t:e}");
    }
}

#[test]
fn equal_images_have_similarity_one_and_no_slope() {
    let (a, _) = images(20, 30);
    let ssim = Ssim::<f64>::default();
    let (value, gradient) = ssim.value_and_grad(a.view(), &SsimTarget::new(&ssim, a.view()));
    within!((value - 1.0).abs(), "{value}");
    within!("gradient", largest(gradient));
}

#[test]
fn images_that_are_not_contiguous_and_empty_ones_are_accepted() {
    let (a, b) = images(20, 30);
    let ssim = Ssim::<f64>::default();
    let value = ssim.value(a.view(), &SsimTarget::new(&ssim, b.view()));
    let turned = ssim.value(a.t(), &SsimTarget::new(&ssim, b.t()));
    within!((value - turned).abs());
    for shape in [(0, 0), (0, 4), (4, 0)] {
        let empty = Array2::zeros(shape);
        let (value, gradient) = ssim.value_and_grad(empty.view(), &SsimTarget::new(&ssim, empty.view()));
        assert_eq!((value, gradient.dim()), (1.0, shape));
    }
}

#[test]
fn an_image_after_others_has_the_bits_of_the_first_one() {
    let kept = Ssim::<f32>::default();
    let mut gradient = Array2::default((0, 0));
    for (rows, columns) in [(50, 70), (20, 40), (60, 33), (0, 4), (50, 70)] {
        let (a, b) = images(rows, columns);
        let (a, b) = (a.mapv(|x| x as f32), b.mapv(|x| x as f32));
        let target = SsimTarget::new(&kept, b.view());
        let [value, _] = kept.compare(a.view(), &target, [1.0, 0.0], Some(&mut gradient));
        let new = Ssim::<f32>::default();
        let expected = new.value_and_grad(a.view(), &SsimTarget::new(&new, b.view()));
        assert_eq!((value, &gradient), (expected.0, &expected.1), "{rows}×{columns}");
    }
}

#[test]
fn one_thread_and_three_give_the_same_bits() {
    let (a, b) = images(70, 50);
    let ssim = Ssim::<f32>::default();
    let (a, b) = (a.mapv(|x| x as f32), b.mapv(|x| x as f32));
    let run =
        |count| threads::install(count, || ssim.value_and_grad(a.view(), &SsimTarget::new(&ssim, b.view()))).unwrap();
    assert_eq!(run(1), run(3));
}
