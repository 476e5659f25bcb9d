use super::*;
use crate::geometry::{Grid, Projections};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use ndarray::Array3;

fn volume(factor: f32) -> Volume {
    let grid = Grid { shape: [4, 5, 6], min: DVec3::new(-1.0, -0.5, 0.0), spacing: DVec3::new(0.5, 0.2, 0.3) };
    Volume::new(grid, Array3::from_shape_fn((4, 5, 6), |(x, y, z)| factor * ((x * 5 + y * 3 + z) % 7) as f32)).unwrap()
}

fn projections(factor: f32) -> Projections {
    let images = Array3::from_shape_fn((2, 5, 6), |(x, y, z)| 1.0 + ((x + y * y + z) % 7) as f32 * factor);
    Projections::new(vec![0.0, 1.0], images).unwrap()
}

/// A page with two methods and all sections, made from the given parts.
fn page() -> String {
    let (truth, good, poor) = (volume(0.1), volume(0.09), volume(0.05));
    let metrics =
        |v: &Volume, f| Metrics::compute(Some((&truth, v)), Some((&projections(1.0), &projections(f)))).unwrap();
    let (of_good, of_poor) = (metrics(&good, 0.9), metrics(&poor, 0.3));
    let provenance = Provenance::new(3, ["trgs".into(), "demo".into()]);
    let html = render(&Report {
        title: "Engine & <block>",
        subtitle: "18 views",
        methods: vec![
            Method { name: "TR-GS", volume: Some(&good), metrics: Some(&of_good) },
            Method { name: "FDK", volume: Some(&poor), metrics: Some(&of_poor) },
        ],
        truth: Some(&truth),
        curves: vec![Curve { name: "total", points: vec![(0.0, 1.0), (100.0, 0.1)] }],
        facts: vec![("views".into(), "18".into())],
        provenance: Some(&provenance),
        ..Report::default()
    })
    .unwrap();
    for (metric, id) in of_good
        .row()
        .iter()
        .chain(&of_poor.row())
        .zip(["psnr3d/peak1", "ssim3d/r2-slices", "psnr2d/selfmax", "ssim2d/selfmax"].iter().cycle())
    {
        assert!(html.contains(metric.as_str()) && html.contains(id), "{metric} of {id} is not on the page");
    }
    html
}

#[test]
fn a_page_loads_nothing_and_shows_every_metric_with_its_definition() {
    let html = page();
    for foreign in ["http:", "https:", "<link", "url(", "@import", "src=\"/", "script src"] {
        assert!(!html.contains(foreign), "{foreign}");
    }
    // The viewer's script, which the policy names by its digest, and its data.
    assert_eq!([html.matches("<script>").count(), html.matches("<script type=\"application/json\">").count()], [1, 1]);
    assert_eq!(html.matches("<script").count(), 2);
    assert!(html.contains("default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-"));
    assert!(html.matches("src=\"").count() == html.matches("src=\"data:image/png;base64,").count());
}

#[test]
fn a_page_escapes_what_it_is_given() {
    let html = page();
    assert!(html.contains("<title>Engine &amp; &lt;block&gt;</title>") && !html.contains("<block>"));
}

#[test]
fn pictures_of_a_page_read_back_with_the_size_of_their_slices() {
    let html = page();
    let sizes: Vec<(u32, u32)> = html
        .split("data:image/png;base64,")
        .skip(1)
        .map(|rest| {
            let file = STANDARD.decode(rest.split('"').next().unwrap()).unwrap();
            let reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
            (reader.info().width, reader.info().height)
        })
        .collect();
    // Across x, y, z: truth and two results, the two colour bars, two differences.
    let block = |size| [size, size, size, (256, 1), (255, 1), size, size];
    let expected = [(5, 6), (4, 6), (4, 5)].map(block).concat();
    assert_eq!(sizes, expected);
    // Across x, y (size 1) is to the right and z (size 1.8) upwards.
    assert!(html.contains("aspect-ratio:0.5556"));
}

#[test]
fn sections_without_content_are_left_out() {
    let html = render(&Report { title: "empty", ..Report::default() }).unwrap();
    assert!(!html.contains("<section") && !html.contains("<script"));
    let alone = volume(1.0);
    let methods = vec![Method { name: "TR-GS", volume: Some(&alone), metrics: None }];
    let html = render(&Report { title: "no truth", methods, ..Report::default() }).unwrap();
    assert!(html.contains("<h2>Slices</h2>") && !html.contains("minus the truth") && !html.contains("Metrics"));
}

#[test]
fn of_a_volume_of_one_slice_that_slice_is_shown() {
    let shown = |shape: [usize; 3]| {
        let grid = Grid::new(shape, DVec3::NEG_ONE, DVec3::ONE).unwrap();
        let volume = Volume::new(grid, Array3::from_elem(shape, 1.0)).unwrap();
        let methods = vec![Method { name: "TV", volume: Some(&volume), metrics: None }];
        let html = render(&Report { title: "slice", methods, ..Report::default() }).unwrap();
        ["x", "y", "z"].map(|axis| html.contains(&format!("<h3>Across {axis} ")))
    };
    assert_eq!(shown([4, 3, 1]), [false, false, true]);
    assert_eq!(shown([1, 3, 2]), [true, false, false]);
    assert_eq!(shown([4, 3, 2]), [true; 3]);
    // A line is better than nothing.
    assert_eq!(shown([4, 1, 1]), [true; 3]);
}

#[test]
fn volumes_of_different_shapes_are_refused() {
    let (truth, other) = (volume(1.0), Volume::new(Grid::cube(2), Array3::zeros((2, 2, 2))).unwrap());
    let methods = vec![Method { name: "other", volume: Some(&other), metrics: None }];
    assert!(render(&Report { truth: Some(&truth), methods, ..Report::default() }).is_err());
}
