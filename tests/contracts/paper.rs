//! The paper's tables in `reference/paper`: complete, in range, and with the correct key values.

use std::collections::BTreeSet;
use std::path::Path;

/// Header and rows of a table.
fn table(name: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("reference/paper/{name}.csv"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect());
    (lines.next().unwrap(), lines.collect())
}

/// The value of a column in the only row that starts with `key`.
fn value(name: &str, key: &[&str], column: &str) -> f64 {
    let (header, rows) = table(name);
    let column = header.iter().position(|known| known == column).unwrap();
    let found: Vec<_> = rows.iter().filter(|row| row.iter().zip(key).all(|(cell, key)| cell == key)).collect();
    assert_eq!(found.len(), 1, "rows {key:?} of {name}");
    found[0][column].parse().unwrap()
}

#[test]
fn every_table_is_whole() {
    let tables = [
        ("volume", "data views method", 36),
        ("projection", "data views method", 18),
        ("noise", "views noise method", 18),
        ("ablation", "views variant", 20),
        ("temperature", "temperature", 3),
        ("optimiser", "method density_control optimiser", 8),
        ("threshold", "threshold", 4),
        ("enhancement", "enhancement", 4),
    ];
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("reference/paper");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    assert_eq!(files.filter(|path| path.extension().is_some_and(|e| e == "csv")).count(), tables.len());
    for (name, key, count) in tables {
        let (header, rows) = table(name);
        let keys: Vec<&str> = key.split(' ').collect();
        assert_eq!(header[..keys.len()], keys, "{name}");
        assert_eq!(rows.len(), count, "{name}");
        let distinct: BTreeSet<_> = rows.iter().map(|row| &row[..keys.len()]).collect();
        assert_eq!(distinct.len(), count, "{name} has a row twice");
        for row in &rows {
            assert_eq!(row.len(), header.len(), "{name}: {row:?}");
            for (column, cell) in header.iter().zip(row).skip(keys.len()) {
                let value: f64 = cell.parse().unwrap();
                let (low, high, digits) = if column.starts_with("psnr") { (16.0, 50.0, 2) } else { (0.2, 1.0, 3) };
                assert!(value > low && value < high, "{name} {row:?}: {column}");
                let digits = if column == "spearman" { 2 } else { digits };
                assert_eq!(cell.split_once('.').unwrap().1.len(), digits, "{name} {row:?}: {column}");
            }
        }
    }
}

#[test]
fn values_are_those_of_the_paper() {
    assert_eq!(value("volume", &["synthetic", "12", "tr-gs"], "psnr_3d"), 31.03);
    assert_eq!(value("volume", &["synthetic", "18", "asd-pocs"], "ssim_3d"), 0.856);
    assert_eq!(value("volume", &["real", "25", "tr-gs"], "ssim_3d"), 0.837);
    assert_eq!(value("projection", &["synthetic", "25", "sax-nerf"], "psnr_2d"), 45.36);
    assert_eq!(value("projection", &["real", "25", "r2-gaussian"], "ssim_2d"), 0.948);
    assert_eq!(value("noise", &["12", "high", "r2-gaussian"], "psnr_3d"), 28.97);
    assert_eq!(value("noise", &["25", "medium", "tr-gs"], "ssim_3d"), 0.912);
    assert_eq!(value("ablation", &["6", "confidence"], "psnr_3d"), 26.73);
    assert_eq!(value("ablation", &["50", "wavelet"], "psnr_2d"), 49.71);
    assert_eq!(value("temperature", &["0.10"], "spearman"), 0.87);
    assert_eq!(value("optimiser", &["r2-gaussian", "adc", "sghmc"], "ssim_3d"), 0.891);
    assert_eq!(value("threshold", &["0.80"], "ssim_3d"), 0.866);
    assert_eq!(value("enhancement", &["4.00"], "psnr_2d"), 40.71);
}

#[test]
fn the_default_at_12_views_differs_between_tables_as_printed() {
    let psnr = |name, key: &[&str]| value(name, key, "psnr_3d");
    assert_eq!(psnr("volume", &["synthetic", "12", "tr-gs"]), psnr("ablation", &["12", "full"]));
    assert_eq!(psnr("volume", &["synthetic", "12", "tr-gs"]), psnr("noise", &["12", "low", "tr-gs"]));
    for (name, key) in [("temperature", "0.25"), ("threshold", "0.35"), ("enhancement", "1.50")] {
        assert_eq!(psnr(name, &[key]), 31.05);
    }
}
