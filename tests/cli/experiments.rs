//! The paper's tables at a toy size: each cell runs once, in any process, with the same result.

use crate::program::Sandbox;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Arguments for cells of a few milliseconds.
const TINY: &str = "--size 8 --cases chest,pepper";

/// Starts the program in a sandbox.
fn begun(sandbox: &Sandbox, arguments: &str) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trgs"));
    command.current_dir(sandbox.path("")).args(arguments.split_whitespace()).arg("--quiet");
    command.stdout(Stdio::null()).spawn().unwrap()
}

/// The files below a folder of the sandbox, by their names there.
fn below(sandbox: &Sandbox, folder: &str) -> BTreeMap<PathBuf, Vec<u8>> {
    let root = sandbox.path(folder);
    let inside = |(path, content): (PathBuf, Vec<u8>)| Some((path.strip_prefix(&root).ok()?.to_owned(), content));
    sandbox.content().into_iter().filter_map(inside).collect()
}

fn cells(sandbox: &Sandbox, arguments: &str, key: &str) -> Vec<String> {
    let listed = sandbox.done(&format!("table {arguments} --list-cells"));
    listed.as_array().unwrap().iter().map(|cell| cell[key].as_str().unwrap().to_owned()).collect()
}

/// The lines of a CSV file, by column.
fn lines_of(sandbox: &Sandbox, path: &str) -> Vec<BTreeMap<String, String>> {
    let text = sandbox.text(path);
    csv::Reader::from_reader(text.as_bytes()).into_deserialize().collect::<Result<_, _>>().unwrap()
}

#[test]
fn a_table_is_filled_and_set_beside_the_papers_figures() {
    let sandbox = Sandbox::new();
    let found = sandbox.done(&format!("table volume --out out {TINY} --seeds 2"));
    let table = &found["tables"][0];
    // 2 cases, 3 numbers of views, 2 seeds; SAX-NeRF has no cells, the other six rows have one each.
    assert_eq!((&table["cells"], &table["missing"]), (&72.into(), &0.into()), "{found}");
    let lines = lines_of(&sandbox, "out/volume.csv");
    assert_eq!(lines.len(), 3 * 7 * 2);
    for line in &lines {
        let [ours, low, high, paper] = ["ours", "low", "high", "paper"].map(|column| line[column].parse::<f64>());
        assert_eq!(ours.is_err(), line["row"] == "SAX-NeRF", "{line:?}");
        assert_eq!(paper.is_err(), line["row"] == "TR-GS, exact projection", "{line:?}");
        if let (Ok(ours), Ok(low), Ok(high)) = (ours, low, high) {
            assert!(low <= ours && ours <= high, "{line:?}");
        }
    }
    let text = |name: &str| sandbox.text(&format!("out/{name}"));
    let words = ["| SAX-NeRF |", "31.03", "18 views, low noise", "the paper’s order", "SHA-256"];
    for word in words.into_iter().chain(["- Primitives at the end: R²-Gaussian ", "- Spearman’s ρ: TR-GS "]) {
        assert!(text("volume.md").contains(word), "{word}");
    }
    assert!(text("volume.tex").contains("\\textbf{") && text("volume.tex").contains("\\bottomrule"));
    let page = text("volume.html");
    assert_eq!(page.matches("data:image/png;base64,").count(), 14, "truth and six rows of two cases");
    assert_eq!(page.matches(" dB</figcaption>").count(), 12, "a figure for each result");
    // A picture leads to a page with the truth and the result of its cell, in all slices.
    let links: Vec<_> = page.split("<a href=\"").skip(1).map(|part| part.split('"').next().unwrap()).collect();
    assert_eq!(links.len(), 12);
    for link in links {
        let cell = text(link);
        assert!(cell.contains("class=\"trgs-viewer\"") && cell.contains(" views, low noise, seed 0, "), "{link}");
        assert_eq!(cell.matches("\"bits\":8").count(), 2, "{link}");
    }
    assert_eq!(page.matches("<svg ").count(), 2, "a plot of each metric");
    for outside in ["http://", "https://", "<script"] {
        // The SVG namespace is not a link.
        assert!(!page.replace("http://www.w3.org/2000/svg", "").contains(outside), "{outside}");
    }
    let cases = text("volume-cases.csv");
    let of = |metric: &str| cases.lines().filter(|line| line.contains(&format!(",{metric},pepper,"))).count();
    // Six rows run, three of them with primitives, two of those with a confidence.
    assert_eq!(["psnr_3d", "primitives", "spearman", "unfinished"].map(of), [18, 9, 6, 0]);
}

#[test]
fn finished_cells_are_not_run_again_and_pages_are_made_from_what_there_is() {
    let sandbox = Sandbox::new();
    let all = cells(&sandbox, &format!("threshold {TINY}"), "id");
    assert_eq!(all.len(), 8);
    let one = sandbox.done(&format!("table threshold --out out {TINY} --cell {}", all[3]));
    assert_eq!(one["cells"][0]["id"], all[3].as_str());
    // The edited result shows whether the cell is run again.
    sandbox.edit(&format!("out/cells/{}.json", all[3]), |finding| finding["metrics"]["psnr_3d"] = 99.0.into());
    sandbox.done(&format!("table threshold --out out {TINY}"));
    assert!(sandbox.text("out/threshold-cases.csv").contains(",99.000000"));

    std::fs::remove_file(sandbox.path("out/threshold.html")).unwrap();
    std::fs::remove_file(sandbox.path(&format!("out/cells/{}.json", all[0]))).unwrap();
    let again = sandbox.done("report out");
    assert_eq!((&again["tables"][0]["cells"], &again["tables"][0]["missing"]), (&7.into(), &1.into()));
    assert!(sandbox.text("out/threshold.html").contains("1 cell is not finished"));
    // Its row has the mean of the other case, which is not compared with means of both.
    for page in ["threshold.html", "threshold.md"] {
        let text = sandbox.text(&format!("out/{page}"));
        let rows: String = text.lines().filter(|line| line.contains("<td") || line.starts_with('|')).collect();
        assert_eq!(rows.matches("(1 of 2)").count(), 4, "{text}");
        // Of four rows three are compared: three pairs at most, of six.
        let pairs = text.split(" pairs").filter_map(|part| part.rsplit("of ").next()?.parse::<usize>().ok());
        assert!(pairs.clone().count() > 0 && pairs.max() <= Some(3), "{text}");
    }
    let lines = lines_of(&sandbox, "out/threshold.csv");
    assert_eq!(lines.iter().filter(|line| line["ours"].is_empty()).count(), 4, "{lines:?}");
}

#[test]
fn any_number_of_threads_and_of_processes_finds_the_same_bytes() {
    let sandbox = Sandbox::new();
    let table = |out: &str, more: &str| format!("table temperature --out {out} {TINY} {more}");
    sandbox.done(&table("alone", "--threads 1"));
    assert_eq!(sandbox.text("alone/temperature.html").matches("Confidence to target of ν").count(), 1);
    let mut two = [3, 2].map(|threads| begun(&sandbox, &table("shared", &format!("--threads {threads}"))));
    two.iter_mut().for_each(|process| assert!(process.wait().unwrap().success()));
    let (alone, shared) = (below(&sandbox, "alone"), below(&sandbox, "shared"));
    assert_eq!(alone.keys().collect::<Vec<_>>(), shared.keys().collect::<Vec<_>>());
    assert!(alone.keys().filter(|name| name.extension().is_some_and(|e| e == "json")).count() >= 6);
    for (name, content) in &alone {
        assert!(shared[name] == *content, "{} differs", name.display());
    }
}

#[test]
fn a_kill_loses_no_finished_cell() {
    let sandbox = Sandbox::new();
    let table = "table ablation --out out --size 16 --cases chest,pepper --threads 1";
    let mut process = begun(&sandbox, table);
    let is = |name: &PathBuf, kind: &str| name.extension().is_some_and(|extension| extension == kind);
    let cells = sandbox.path("out/cells");
    // Only names are compared: other files come and go during the run.
    let names = || std::fs::read_dir(&cells).unwrap().map(|entry| entry.unwrap().path());
    while !cells.exists() || names().filter(|name| is(name, "json")).count() < 3 {
        assert!(process.try_wait().unwrap().is_none(), "it ended before it could be killed");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    process.kill().unwrap();
    process.wait().unwrap();
    let before: Vec<_> = below(&sandbox, "out/cells").into_iter().filter(|(name, _)| is(name, "json")).collect();
    // A process may die after a cell is finished and before its lock is removed.
    let left = PathBuf::from("out/cells").join(before[0].0.with_extension("lock"));
    sandbox.write(left.to_str().unwrap(), "");
    let found = sandbox.done(table);
    assert_eq!(found["tables"][0]["cells"], 40);
    assert!(!sandbox.text("out/ablation.html").contains("Confidence to target"), "all rows have one temperature");
    let after = below(&sandbox, "out/cells");
    for (name, content) in before {
        assert!(after[&name] == content, "{}", name.display());
    }
    assert!(!after.keys().any(|name| is(name, "lock")), "a lock is left");
}

#[test]
fn a_killed_cell_goes_on_from_its_checkpoint() {
    for (method, networks) in [("tr-gs", ""), ("naf", " --networks naf")] {
        let sandbox = Sandbox::new();
        let set = "set = ['iterations=120', 'checkpoint_every=2']";
        let row = format!("[[rows]]\nname = 'one'\nmethod = '{method}'\n{set}\n");
        let head = "title = 'long'\nmetrics = ['psnr_3d']\nviews = [6]\nnoise = ['low']\nfull = 'one'\n";
        sandbox.write("long.toml", head.to_owned() + &row);
        let arguments = |out: &str| format!("long.toml --out {out} --size 8 --cases chest --threads 1{networks}");
        let table = |out: &str| format!("table {}", arguments(out));
        let id = cells(&sandbox, &arguments("out"), "id").remove(0);
        let file = |out: &str, kind: &str| format!("{out}/cells/{id}.{kind}");
        let mut process = begun(&sandbox, &table("out"));
        while !sandbox.path(&file("out", "state")).exists() {
            assert!(process.try_wait().unwrap().is_none(), "{method}: it ended before it could be killed");
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        process.kill().unwrap();
        process.wait().unwrap();
        assert!(!sandbox.path(&file("out", "json")).exists(), "{method}");
        // What it goes on from is read: a file that is damaged is refused.
        let state = std::fs::read(sandbox.path(&file("out", "state"))).unwrap();
        sandbox.write(&file("out", "state"), &state[..state.len() / 2]);
        let refused = sandbox.run(&table("out"));
        let error = crate::program::stderr(&refused);
        assert!(refused.status.code() == Some(2) && error.contains(&id), "{method}: {error}");
        sandbox.write(&file("out", "state"), state);
        sandbox.done(&table("out"));
        sandbox.done(&table("whole"));
        let found = |out: &str| sandbox.text(&file(out, "json"));
        assert_eq!(found("out"), found("whole"), "{method}");
        assert!(!sandbox.path(&file("out", "state")).exists(), "{method}");
    }
}

#[test]
fn a_table_of_a_file_runs_and_its_pages_are_made_again() {
    let sandbox = Sandbox::new();
    let row = |name: &str, set: &str| format!("[[rows]]\nname = '{name}'\nmethod = 'tr-gs'\nset = ['{set}']\n");
    let head = "title = 'ν of the base'\nmetrics = ['psnr_3d']\nviews = [6]\nnoise = ['low']\nfull = 'free'\n";
    let rows = row("free", "wavelet.enabled=false") + &row("fixed", "optimiser.nu=[0,0]");
    sandbox.write("own.toml", format!("{head}{rows}"));
    let found = sandbox.done(&format!("table own.toml --out out {TINY}"));
    assert_eq!((&found["tables"][0]["table"], &found["tables"][0]["cells"]), (&"own".into(), &4.into()));
    assert!(sandbox.text("out/own.md").starts_with("# ν of the base\n"));
    // Wrong data are another scan.
    sandbox.write("wrong.toml", format!("{head}damage = 'pixels'\n{rows}"));
    let ids = |file: &str| cells(&sandbox, &format!("{file} {TINY}"), "id");
    assert!(ids("own.toml").iter().all(|id| !ids("wrong.toml").contains(id)));
    // The folder holds all that its pages are made from.
    std::fs::remove_file(sandbox.path("own.toml")).unwrap();
    std::fs::remove_file(sandbox.path("out/own.html")).unwrap();
    assert_eq!(sandbox.done("report out")["tables"][0]["missing"], 0);
    assert!(sandbox.text("out/own.html").contains("ν of the base"));
    sandbox.write("volume.toml", format!("{head}{rows}"));
    sandbox.write("odd.toml", format!("{head}{rows}").replace("psnr_3d", "psnr"));
    for (file, words) in [("volume.toml", "rename"), ("odd.toml", "spearman"), ("none.toml", "none.toml")] {
        let output = sandbox.run(&format!("table {file} --out new {TINY}"));
        let error = crate::program::stderr(&output);
        assert!(output.status.code() == Some(2) && error.contains(words), "{file}: {error}");
        assert!(!sandbox.path("new").exists());
    }
}

#[test]
fn a_table_is_judged_by_predictions() {
    let sandbox = Sandbox::new();
    let own = "title = 'own'\nmetrics = ['psnr_3d']\nviews = [6]\nnoise = ['low']\nfull = 'a'\n\
               rows = [{ name = 'a', method = 'sart' }, { name = 'b', method = 'fdk' }]\n";
    sandbox.write("own.toml", own);
    let table = format!("table own.toml --out out {TINY}");
    sandbox.done(&table);
    let lines = lines_of(&sandbox, "out/own.csv");
    let ours = |row: &str| lines.iter().find(|line| line["row"] == row).unwrap()["ours"].parse::<f64>().unwrap();
    let prediction = |row: &str, middle: f64| {
        let [low, high] = [middle - 0.1, middle + 0.1];
        format!(
            r#"{{"table":"own","measured":false,"row":"{row}","views":6,"noise":"low","metric":"psnr_3d","low":{low},"expected":{middle},"high":{high}}}"#
        )
    };
    let judged = |predictions: &[String]| {
        sandbox.write("p.json", format!(r#"{{"predictions":[{}]}}"#, predictions.join(",")));
        sandbox.run(&format!("{table} --against p.json"))
    };
    let difference = prediction("a", ours("a") - ours("b")).replace("\"views\"", "\"minus\":\"b\",\"views\"");
    let right = [prediction("a", ours("a")), prediction("b", ours("b")), difference];
    let output = judged(&right);
    assert_eq!(output.status.code(), Some(0), "{}", crate::program::stderr(&output));
    let output = judged(&[right[0].clone(), prediction("b", ours("b") + 0.2)]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("OUTSIDE") && text.contains("1 of 2 figures"), "{text}");
    // Refused before anything runs.
    let other = right[0].replace("\"own\"", "\"volume\"");
    for (predictions, words) in [
        (vec![prediction("c", 1.0)], "\"c\""),
        (vec![other], "none for it"),
        (vec![right[0].replace("low\":", "floor\":")], "floor"),
        (vec![right[0].replace("\"high\":", "\"high\":-")], "at most"),
    ] {
        let output = judged(&predictions);
        let error = crate::program::stderr(&output);
        assert!(output.status.code() == Some(2) && error.contains(words), "{words}: {error}");
    }
}

#[test]
fn an_id_follows_from_configuration_and_data() {
    let sandbox = Sandbox::new();
    let first = |arguments: &str| cells(&sandbox, &format!("threshold {arguments}"), "id")[0].clone();
    let base = first("--size 8 --cases chest");
    assert_eq!(base, first("--size 8 --cases chest"));
    assert_ne!(base, first("--size 16 --cases chest"));
    assert_ne!(base, first("--size 8 --cases pepper"));
    assert!(cells(&sandbox, "threshold --size 8 --cases chest --seeds 2", "id").contains(&base));
    // Equal rows of several tables are the same cells.
    let full = cells(&sandbox, "temperature --size 8 --cases chest", "id")[1].clone();
    assert!(cells(&sandbox, "ablation --size 8 --cases chest", "id").contains(&full));
    assert!(cells(&sandbox, "threshold --size 8 --cases chest", "id").contains(&full));
    assert!(cells(&sandbox, "volume --size 8 --cases chest", "id").contains(&full));
}

#[test]
fn volumes_and_scans_of_a_folder_take_the_place_of_phantoms() {
    let sandbox = Sandbox::new();
    sandbox.done("simulate --phantom pepper --size 16 --detector 16 --views 1 --test-views 0 --out made");
    std::fs::create_dir(sandbox.path("data")).unwrap();
    sandbox.write("data/thing.npy", sandbox.read("made/vol_gt.npy"));
    sandbox.write("data/readme.txt", "no volume");
    let found = sandbox.done("table threshold --out out --size 8 --data data");
    assert_eq!(found["tables"][0]["cells"], 4, "a volume twice as fine");
    sandbox.done(
        "simulate --phantom chest --size 8 --detector 16 --views 25 --test-views 4 --out data/scan --noise medium",
    );
    let names = |table: &str| cells(&sandbox, &format!("{table} --data data --size 8"), "cell");
    assert!(names("threshold").iter().any(|cell| cell.starts_with("scan, 12 views")));
    // A scan has its own noise.
    assert!(names("noise").iter().all(|cell| cell.starts_with("thing") || cell.contains("low noise")));
    let found = sandbox.done("table temperature --out out --size 8 --data data --cases scan");
    assert_eq!((&found["tables"][0]["cells"], &found["tables"][0]["missing"]), (&3.into(), &0.into()));
    // The same cells with the paper's other figures: 40.62 dB of R²-Gaussian at 12 views.
    sandbox.done("table projection --out measured --size 8 --data data --cases scan --measured");
    let table = String::from_utf8(sandbox.read("measured/projection.csv")).unwrap();
    assert!(table.contains(",40.62\n") && table.contains(",45.77\n"), "{table}");
    let again = sandbox.done("report measured");
    assert_eq!(again["tables"][0]["table"], "projection");
    assert_eq!(String::from_utf8(sandbox.read("measured/projection.csv")).unwrap(), table);
}

#[test]
fn experiments_are_matched_by_ray_and_about_the_middle_of_volumes() {
    let sandbox = Sandbox::new();
    let ids = |arguments: &str| cells(&sandbox, &format!("threshold --cases chest {arguments}"), "id");
    assert_eq!(ids("--size 32"), ids("--size 32 --matched edge"));
    assert!(ids("--size 32").iter().zip(ids("--size 32 --matched ray")).all(|(edge, ray)| *edge != ray));

    sandbox.done("table threshold --out ray --size 16 --cases chest --matched ray");
    // 12 · 8² / 16³.
    let expected = "at 16³ voxels, 8² pixels. Matched by ray: 0.19 rays per voxel with 12 views.";
    assert!(sandbox.text("ray/threshold.md").contains(expected), "{}", sandbox.text("ray/threshold.md"));
    assert_eq!(sandbox.done("report ray")["tables"][0]["missing"], 0);

    sandbox.done("simulate --phantom pepper --size 32 --detector 16 --views 1 --test-views 0 --out made");
    std::fs::create_dir(sandbox.path("data")).unwrap();
    sandbox.write("data/thing.npy", sandbox.read("made/vol_gt.npy"));
    let found = sandbox.done("table threshold --out middle --data data --crop 16");
    assert_eq!((&found["tables"][0]["cells"], &found["tables"][0]["missing"]), (&4.into(), &0.into()));
    assert!(sandbox.text("middle/threshold-cases.csv").contains("thing-middle"));
    assert!(sandbox.text("middle/threshold.md").contains("16³ voxels, 8² pixels. Matched by ray"));
    assert_eq!(sandbox.done("report middle")["tables"][0]["missing"], 0);
}

#[test]
fn settings_apply_to_all_rows_with_primitives_and_a_rows_own_win() {
    let sandbox = Sandbox::new();
    let ids = |table: &str, more: &str| cells(&sandbox, &format!("{table} --size 8 --cases chest {more}"), "id");
    let (plain, set) = (ids("temperature", ""), ids("temperature", "--set confidence.temperature=0.9"));
    assert_eq!(plain, set, "each row has a temperature of its own");
    let changed = ids("temperature", "--set confidence.weight=3e-4");
    assert!(plain.iter().zip(&changed).all(|(plain, changed)| plain != changed));
    // Rows of voxels have no primitives: 12, 18 and 25 views of three methods and of two with primitives.
    let (plain, changed) = (ids("volume", ""), ids("volume", "--set model.points=33"));
    let same = plain.iter().filter(|id| changed.contains(id)).count();
    assert_eq!((plain.len(), same), (18, 9));
    sandbox
        .done("table temperature --out out --size 8 --cases chest --set confidence.alpha=median --set model.points=33");
    assert!(sandbox.text("out/temperature.md").contains("1 seed, with confidence.alpha=median, model.points=33 at 8³"));
    assert_eq!(sandbox.done("report out")["tables"][0]["missing"], 0);
}

#[test]
fn what_cannot_be_run_is_refused_in_one_line() {
    let sandbox = Sandbox::new();
    for (arguments, words) in [
        ("table tables --out out", vec!["volume", "ablation"]),
        ("table volume --out out --cases engines", vec!["engines", "engine"]),
        ("table volume --out out --data .", vec!["--data", "--size"]),
        ("table volume --out out --cell 0", vec!["--list-cells"]),
        ("report .", vec!["tables.json"]),
        ("table volume", vec!["--out"]),
        ("table noise --out out --data . --measured", vec!["--measured", "projection"]),
        ("table volume --out out --measured", vec!["--data"]),
        ("table volume --out out --matched pixel", vec!["--matched", "edge or ray"]),
        ("table volume --out out --networks tr-gs", vec!["--networks", "naf"]),
        ("table noise --out out --networks naf", vec!["--networks", "volume or projection"]),
        ("table volume --out out --crop 16", vec!["--data"]),
        ("table volume --out out --set confidence.alpha=mean", vec!["confidence.alpha", "median"]),
        ("table volume --out out --set confidence.alpha=-1", vec!["confidence.alpha", "positive"]),
        ("table volume --out out --data . --crop 16 --matched ray", vec!["--crop", "--matched"]),
        ("table volume --out out --data . --crop 16", vec!["--data", "more than 16 voxels"]),
    ] {
        let output = sandbox.run(arguments);
        let error = crate::program::stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments}: {error}");
        assert!(words.iter().all(|word| error.contains(word)), "{arguments}: {error}");
    }
    assert_eq!(sandbox.done("table list").as_array().unwrap().len(), 8);
}

/// Tables of 16³ and one case, compared with committed results.
///
/// A change of the method changes them: then they are written again (`TRGS_WRITE_TABLES=1`) in a commit that says why.
#[test]
fn a_small_version_of_every_table_is_as_it_was() {
    let sandbox = Sandbox::new();
    sandbox.done("table all --out out --size 16 --cases pepper");
    let expected = Path::new(env!("CARGO_MANIFEST_DIR")).join("reference/expected");
    for table in trgs::experiments::NAMES {
        let (name, found) = (format!("{table}.csv"), sandbox.text(&format!("out/{table}.csv")));
        if std::env::var_os("TRGS_WRITE_TABLES").is_some() {
            std::fs::write(expected.join(&name), &found).unwrap();
        }
        let committed = std::fs::read_to_string(expected.join(&name)).unwrap();
        let read = |text: &str| -> Vec<csv::StringRecord> {
            csv::Reader::from_reader(text.as_bytes()).into_records().collect::<csv::Result<_>>().unwrap()
        };
        let (found, committed) = (read(&found), read(&committed));
        assert_eq!(found.len(), committed.len(), "{table}");
        for (found, committed) in found.iter().zip(&committed) {
            for (column, (ours, theirs)) in found.iter().zip(committed).enumerate() {
                let what = format!("{table}, column {column}: {found:?} against {committed:?}");
                match (ours.parse::<f64>(), theirs.parse::<f64>()) {
                    (Ok(ours), Ok(theirs)) if ours.abs() > 1.0 => within!("decibels", (ours - theirs).abs(), "{what}"),
                    (Ok(ours), Ok(theirs)) => within!("similarity", (ours - theirs).abs(), "{what}"),
                    _ => assert_eq!(ours, theirs, "{what}"),
                }
            }
        }
    }
}
