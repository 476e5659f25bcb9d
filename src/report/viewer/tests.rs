use super::*;
use crate::primitives::Parameters;

/// Voxel (x, y, z) holds 100 x + 10 y + z.
fn digits(shape: [usize; 3]) -> Array3<f32> {
    Array3::from_shape_fn(shape, |(x, y, z)| (100 * x + 10 * y + z) as f32)
}

fn file(values: Array3<f32>) -> VolumeFile {
    let (spacing, origin) = (Some(DVec3::new(1.0, 2.0, 3.0)), Some(DVec3::new(10.0, 20.0, 30.0)));
    VolumeFile { values, spacing, origin, unit: Some(Unit::Millimetre), ..VolumeFile::default() }
}

fn scene(file: VolumeFile) -> Scene<'static> {
    Scene::of_files("a scene", vec![("a".into(), file)]).unwrap()
}

/// The values of a volume as the script decodes them.
fn decoded(volume: &Value) -> Vec<f64> {
    let mut bytes = Vec::new();
    let packed = STANDARD.decode(volume["data"].as_str().unwrap()).unwrap();
    std::io::copy(&mut flate2::read::DeflateDecoder::new(&packed[..]), &mut bytes).unwrap();
    let half = bytes.len() / 2;
    let levels: Vec<u16> = match volume["bits"].as_u64() {
        Some(8) => bytes
            .iter()
            .scan(0_u8, |last, step| {
                Some(u16::from(std::mem::replace(last, last.wrapping_add(*step)).wrapping_add(*step)))
            })
            .collect(),
        _ => {
            let folded = (0..half).map(|i| u16::from(bytes[i]) << 8 | u16::from(bytes[half + i]));
            let steps = folded.map(|folded| (folded >> 1) ^ (folded & 1).wrapping_neg());
            steps
                .scan(0_u16, |last, step| {
                    *last = last.wrapping_add(step);
                    Some(*last)
                })
                .collect()
        }
    };
    let [offset, scale] = ["offset", "scale"].map(|key| volume[key].as_f64().unwrap());
    levels.into_iter().map(|level| offset + scale * f64::from(level)).collect()
}

#[test]
fn stored_values_are_right_to_the_nearest_step() {
    let values =
        Array3::from_shape_fn([5, 7, 11], |(x, y, z)| ((x * 7919 + y * 104_729 + z * 31) % 1000) as f32 / 7.0 - 50.0);
    for depth in [Depth::Eight, Depth::Sixteen] {
        let json = scene(file(values.clone())).json(depth);
        let [low, high] = ends(&values);
        let step = (high - low) / depth.top();
        let found = decoded(&json["volumes"][0]);
        assert_eq!(found.len(), values.len());
        // The numbers next to it are no nearer.
        let is_nearest = |(found, &value): (&f64, &f32)| {
            let error = |level: f64| (found + level * step - f64::from(value)).abs();
            error(0.0) <= error(1.0) && error(0.0) <= error(-1.0)
        };
        assert!(found.iter().zip(&values).all(is_nearest), "{depth:?}");
    }
    let constant = scene(file(Array3::from_elem([2, 2, 2], 0.1)));
    assert_eq!(decoded(&constant.json(Depth::Eight)["volumes"][0]), [f64::from(0.1_f32); 8]);
}

#[test]
fn planes_of_a_patient_have_left_on_the_right_and_front_or_head_on_top() {
    let straight = scene(file(digits([2, 3, 4]))).json(Depth::Eight);
    let of = |json: &Value, title: &str| {
        let planes = json["planes"].as_array().unwrap();
        planes.iter().find(|plane| plane["title"] == title).unwrap().clone()
    };
    let expect = |json: &Value, title: &str, across: usize, axes: [usize; 2], signs: [i8; 2], ends: [[&str; 2]; 2]| {
        let plane = of(json, title);
        let found = json!([plane["across"], plane["axes"], plane["signs"], plane["ends"]]);
        assert_eq!(found, json!([across, axes, signs, ends]), "{title}");
    };
    expect(&straight, "Axial", 2, [0, 1], [1, 1], [["R", "L"], ["A", "P"]]);
    expect(&straight, "Coronal", 1, [0, 2], [1, -1], [["R", "L"], ["S", "I"]]);
    expect(&straight, "Sagittal", 0, [1, 2], [1, -1], [["A", "P"], ["S", "I"]]);
    // The array's axes run to the front, to the feet and to the right: other signs, the same letters.
    let turned = DMat3::from_cols(DVec3::new(0.0, -1.0, 0.0), DVec3::new(0.0, 0.0, -1.0), DVec3::new(-1.0, 0.0, 0.0));
    let turned = scene(VolumeFile { directions: turned, ..file(digits([2, 3, 4])) }).json(Depth::Eight);
    expect(&turned, "Axial", 1, [2, 0], [-1, -1], [["R", "L"], ["A", "P"]]);
    expect(&turned, "Coronal", 0, [2, 1], [-1, 1], [["R", "L"], ["S", "I"]]);
    expect(&turned, "Sagittal", 2, [0, 1], [-1, 1], [["A", "P"], ["S", "I"]]);
    // Turned by 30 degrees about the long axis of the body.
    let (sin, cos) = (0.5, 0.75_f64.sqrt());
    let oblique = DMat3::from_cols(DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0), DVec3::Z);
    let oblique = scene(VolumeFile { directions: oblique, ..file(digits([2, 3, 4])) }).json(Depth::Eight);
    expect(&oblique, "Axial", 2, [0, 1], [1, 1], [["RA", "LP"], ["AL", "PR"]]);
}

#[test]
fn planes_without_a_patient_have_the_names_of_axes_and_those_that_are_lines_are_left_out() {
    let plain = scene(VolumeFile { values: digits([2, 3, 4]), ..VolumeFile::default() }).json(Depth::Eight);
    assert_eq!(
        plain["planes"][0],
        json!({ "across": 0, "title": "Across x", "axes": [1, 2], "signs": [1, -1], "ends": [["", "y"], ["z", ""]] })
    );
    assert_eq!(plain["planes"][2]["axes"], json!([0, 1]));
    let flat = scene(file(digits([4, 3, 1]))).json(Depth::Eight);
    assert_eq!(flat["planes"].as_array().unwrap().len(), 1);
    assert_eq!(flat["planes"][0]["across"], 2);
    assert_eq!(scene(file(digits([4, 1, 1]))).json(Depth::Eight)["planes"].as_array().unwrap().len(), 3);
}

#[test]
fn a_large_volume_is_shown_as_means_of_blocks_at_the_same_place() {
    assert_eq!(means(&digits([3, 2, 4]), [2, 2, 2]).into_raw_vec_and_offset().0, [55.5, 57.5, 205.5, 207.5]);
    let large = scene(file(Array3::from_elem([300, 100, 100], 1.0))).reduced().json(Depth::Eight);
    assert_eq!(large["shape"], json!([150, 50, 50]));
    assert_eq!(large["spacing"], json!([2.0, 4.0, 6.0]));
    // The middle of the first block of 2 × 2 × 2 voxels.
    assert_eq!(large["origin"], json!([10.5, 21.0, 31.5]));
    assert!(large["note"].as_str().unwrap().starts_with("Means of 2 × 2 × 2 values are shown."));
    assert_eq!(
        scene(file(Array3::zeros([128, 128, 128]))).reduced().json(Depth::Eight)["shape"],
        json!([128, 128, 128])
    );
}

#[test]
fn projections_have_angles_and_places_on_the_detector() {
    let mut scanner = Scanner::synthetic(8, 5);
    scanner.detector.offset_u = 0.5;
    let angles: Vec<f64> = (0..300).map(|view| f64::from(view) * 0.01).collect();
    let images = Array3::from_shape_fn((300, 5, 5), |(view, ..)| view as f32);
    let views = Projections::new(angles, images).unwrap();
    let frame = Frame::scaled(0.1);
    let json = Scene::of_projections("views", vec![("measured", Cow::Borrowed(&views))], &scanner, &frame)
        .unwrap()
        .reduced()
        .json(Depth::Sixteen);
    // One view of three.
    assert_eq!(json["shape"], json!([100, 5, 5]));
    assert_eq!(json["angles"].as_array().unwrap().len(), 100);
    assert_eq!(json["angles"][1], json!(0.03_f64.to_degrees()));
    let pitch = scanner.detector.pitch_u;
    assert_eq!(json["origin"][2], json!((0.5 - 2.0 * pitch) / 0.1));
    assert_eq!(json["planes"][0]["ends"], json!([["", "u"], ["", "v"]]));
    assert_eq!(json["window"][1], json!(297.0));
}

#[test]
fn hounsfield_units_are_recognised_and_values_that_are_no_numbers_reported() {
    let mut values = Array3::from_elem([4, 4, 4], -1000.0);
    values[[1, 1, 1]] = 40.0;
    let json = scene(file(values.clone())).with_water(Some(0.02)).json(Depth::Eight);
    assert_eq!([&json["is_hounsfield"], &json["water"], &json["quantity"]], [&json!(true), &Value::Null, &json!("")]);
    values.fill(0.02);
    values[[0, 0, 0]] = f32::NAN;
    let json = scene(file(values)).with_water(Some(0.02)).json(Depth::Eight);
    assert_eq!(
        [&json["is_hounsfield"], &json["water"], &json["quantity"]],
        [&json!(false), &json!(0.02), &json!("/mm")]
    );
    assert!(json["note"].as_str().unwrap().contains("a: 1 value not finite, shown as the lowest."));
    assert_eq!(decoded(&json["volumes"][0]), [f64::from(0.02_f32); 64]);
}

#[test]
fn primitives_are_ellipsoids_in_voxels_at_half_of_their_density() {
    let grid = Grid::new([4, 6, 8], DVec3::new(-1.0, -1.0, -2.0), DVec3::new(1.0, 2.0, 2.0)).unwrap();
    let volume = Volume::new(grid, Array3::zeros([4, 6, 8])).unwrap();
    let parameters = Parameters {
        mean: vec![[0.0, 0.5, -1.75], [0.25, 0.25, 0.25]],
        scale: vec![[0.5, 1.0, 2.0], [0.1, 0.2, 0.3]],
        // The first is turned by 90 degrees about z: its x is along y.
        quaternion: vec![[0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()], [1.0, 0.0, 0.0, 0.0]],
        density: vec![0.25, 0.5],
        nu: vec![1.0, 3.0],
    };
    let primitives = Primitives::new(parameters).unwrap();
    let scene = || {
        let scene = Scene::of_volumes("", vec![("v", &volume)], &Frame::default()).unwrap();
        scene.with_primitives(&primitives, &grid, Some(vec![0.1, 0.9]))
    };
    let html = page("", "", &[scene()], Depth::Eight);
    assert!(html.contains(&script(true)) && script(true).len() <= 32 * 1024);
    let table = |scene: &Scene| -> Vec<Vec<f64>> {
        scene.json(Depth::Eight)["model"].as_array().unwrap().iter().map(decoded).collect()
    };
    let columns = table(&scene());
    let row = |columns: &[Vec<f64>]| columns.iter().map(|column| column[0]).collect::<Vec<_>>();
    // At half of its density: (1 + x²)^-2 = 1/2.
    let half = (2.0_f64.sqrt() - 1.0).sqrt();
    let expected =
        [1.5, 2.5, 0.0, 0.0, -half / 0.5, 0.0, half * 0.5 / 0.5, 0.0, 0.0, 0.0, 0.0, half * 2.0 / 0.5, 1.0, 0.1, 0.25];
    let step = 4.0 / f64::from(u16::MAX);
    assert!(
        row(&columns).iter().zip(expected).all(|(found, expected)| (found - expected).abs() <= step),
        "{:?}",
        row(&columns)
    );
    let names: Vec<_> = scene().json(Depth::Eight)["model"].as_array().unwrap()[12..]
        .iter()
        .map(|column| column["name"].clone())
        .collect();
    assert_eq!(names, ["ν", "confidence", "density"]);
    // Blocks of 2 × 2 × 2 voxels.
    let mut reduced = scene();
    reduced.model.reduce(DVec3::splat(2.0));
    let row = row(&table(&reduced));
    assert!((row[0] - 0.5).abs() <= step && (row[11] - half * 2.0).abs() <= step);
}

#[test]
fn scenes_of_no_five_or_different_volumes_are_refused() {
    let of = |shapes: &[[usize; 3]]| {
        Scene::of_files("", shapes.iter().map(|shape| ("v".into(), file(digits(*shape)))).collect())
    };
    assert!(of(&[[2, 2, 2]; 3]).is_ok());
    assert!(of(&[]).is_err() && of(&[[2, 2, 2]; 5]).is_err() && of(&[[0, 2, 2]]).is_err());
    assert!(of(&[[2, 2, 2], [2, 2, 3]]).unwrap_err().to_string().contains("volume of v"));
}

#[test]
fn a_page_has_one_script_of_at_most_30_kb_and_names_its_digest() {
    let grid = Grid::cube(4);
    let volume = Volume::new(grid, digits([4, 4, 4])).unwrap();
    let scene =
        Scene::of_volumes("<b> & </script>", vec![("truth", &volume), ("TR-GS", &volume)], &Frame::default()).unwrap();
    let html = page("Volumes", "two", &[scene.clone(), scene], Depth::Eight);
    assert_eq!(html.matches("<script>").count(), 1);
    assert_eq!(html.matches("<script ").count(), html.matches("<script type=\"application/json\">").count());
    assert_eq!(html.matches("</script>").count(), 3);
    let script = script(false);
    assert!(script.len() <= 30 * 1024, "{} bytes", script.len());
    let digest = STANDARD.encode(Sha256::digest(script.as_bytes()));
    assert!(
        html.contains(&format!("script-src 'sha256-{digest}'")) && html.contains(&format!("<script>{script}</script>"))
    );
    for foreign in ["http:", "https:", "<link", "url(", "@import", "fetch(", "XMLHttp", "import("] {
        assert!(!html.contains(foreign), "{foreign}");
    }
    assert!(html.contains("<h2>&lt;b&gt; &amp; &lt;/script&gt;</h2>"));
}
