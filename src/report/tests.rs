use super::*;
use crate::geometry::{Grid, Projections, Scanner};
use glam::DVec3;
use ndarray::Array3;
use std::borrow::Cow;

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
    assert!(!html.contains("src="));
}

#[test]
fn a_page_escapes_what_it_is_given() {
    let html = page();
    assert!(html.contains("<title>Engine &amp; &lt;block&gt;</title>") && !html.contains("<block>"));
}

#[test]
fn a_page_answers_whether_the_volume_is_good_where_not_and_what_next() {
    let (measured, rendered) = (projections(0.1), projections(0.11));
    let mut scanner = Scanner::synthetic(4, 6);
    scanner.detector.rows = 5;
    let agreement = Agreement::new([&measured, &rendered], &measured, &scanner, true).unwrap();
    let stacks = vec![("Measured", Cow::Borrowed(&measured)), ("TR-GS", Cow::Borrowed(&rendered))];
    let scene = Scene::of_projections("Projections", stacks, &scanner, &Frame::default()).unwrap();
    let html = render(&Report {
        title: "no truth",
        warnings: vec!["air is <0.1>".into()],
        views: Some((agreement, scene)),
        next: vec![("More".into(), "trgs view 'a & b'".into())],
        ..Report::default()
    })
    .unwrap();
    let titles: Vec<_> = html.split("<h2>").skip(1).map(|part| part.split("</h2>").next().unwrap()).collect();
    assert_eq!(titles, ["Is the volume good?", "Where is it doubtful?", "Projections", "What next?"]);
    for part in
        ["<li>air is &lt;0.1&gt;</li>", "<code>trgs view 'a &amp; b'</code>", "<title>view at 57.3°: ", "Cividis"]
    {
        assert!(html.contains(part), "{part}");
    }
    assert_eq!(html.matches("<script type=\"application/json\">").count(), 2);
}

#[test]
fn sections_without_content_are_left_out() {
    let html = render(&Report { title: "empty", ..Report::default() }).unwrap();
    assert!(!html.contains("<section") && !html.contains("<script"));
    let alone = volume(1.0);
    let methods = vec![Method { name: "TR-GS", volume: Some(&alone), metrics: None }];
    let html = render(&Report { title: "no truth", methods, ..Report::default() }).unwrap();
    assert!(html.contains("<h2>Volumes</h2>") && !html.contains("Truth") && !html.contains("Metrics"));
}

#[test]
fn volumes_of_different_shapes_are_refused() {
    let (truth, other) = (volume(1.0), Volume::new(Grid::cube(2), Array3::zeros((2, 2, 2))).unwrap());
    let methods = vec![Method { name: "other", volume: Some(&other), metrics: None }];
    assert!(render(&Report { truth: Some(&truth), methods, ..Report::default() }).is_err());
}
