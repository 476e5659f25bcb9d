//! The table of tolerances `tests/tolerances.toml` is complete, used and justified.

use crate::root;
use crate::tolerances::{ROWS, Row, WIDEST, largest, relative};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Thresholds that select data or repeat a definition: file, text of the comparison, reason.
const NO_TOLERANCES: [(&str, &str, &str); 19] = [
    ("src/methods/classical/algebraic/tests.rs", "length > 0.5 * scanner", "the definition of a ray that counts"),
    ("src/methods/classical/fdk/mod.rs", "distance > 0.5", "inside or outside of the ball"),
    ("src/methods/classical/fdk/mod.rs", "(0.35..0.65).contains(", "the shell that no mean contains"),
    ("src/methods/classical/fdk/tests.rs", ".length() < 0.25", "the middle of the volume"),
    ("src/core/numeric/lanes.rs", "truth < 1e-36", "values that f32 cannot hold are skipped"),
    ("src/scan/noise.rs", "count < 19.5", "the last cell of the histogram"),
    ("src/scan/noise.rs", "count < 0.75", "the first cell of the histogram"),
    ("src/scan/phantom/mod.rs", ".abs() > 0.02", "voxels that count as different"),
    ("src/scan/phantom/mod.rs", ".abs() > 0.1", "voxels that count as different"),
    ("src/scan/phantom/solid.rs", "s.line_integral(r) > 0.1", "rays that hit the solid"),
    ("src/scan/trilinear.rs", "least > 0.5", "rays that are well inside"),
    ("src/core/wavelet/haar.rs", "c.abs() > 1e-14", "bands that hold more than rounding"),
    ("tests/cli/geometry_check.rs", "**value > 0.05", "voxels that become points"),
    ("tests/cli/memory.rs", ".length() < 0.8", "the ball of the scan"),
    ("tests/contracts/extremes.rs", "> 0.01", "quaternions that are drawn"),
    (
        "tests/contracts/oracle.rs",
        "> 0.06 * actual",
        "two digits are stated; the limits are in reference/tolerances.toml",
    ),
    ("tests/contracts/oracle.rs", "x < 0.05", "what the README prints as 0"),
    ("tests/contracts/parity.rs", "dropped > 1e-9", "pixels at which the cutoff drops anything"),
    ("tests/contracts/tolerance_rows.rs", "max_relative", "approx judges the measures of errors"),
];

/// Paths and test code of all Rust files, comments and strings blanked.
fn tests_of_all_files() -> Vec<(String, String)> {
    fn add(folder: &Path, found: &mut Vec<(String, String)>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                add(&path, found);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path.strip_prefix(root()).unwrap().to_str().unwrap().replace('\\', "/");
                let code = blanked(&fs::read_to_string(&path).unwrap());
                let code = match test_module(&code) {
                    _ if name.starts_with("tests/") || name.ends_with("/tests.rs") => code,
                    Some(start) => format!("{}{}", "\n".repeat(code[..start].matches('\n').count()), &code[start..]),
                    None => continue,
                };
                found.push((name, code));
            }
        }
    }
    let mut found = Vec::new();
    ["src", "tests"].iter().for_each(|folder| add(&root().join(folder), &mut found));
    found.sort();
    found
}

/// Where the first test module of a file begins.
fn test_module(code: &str) -> Option<usize> {
    let mut from = 0;
    while let Some(at) = code[from..].find("#[cfg(test)]\nmod ").map(|at| from + at) {
        let line = code[at..].lines().nth(1).unwrap();
        if line.ends_with('{') {
            return Some(at);
        }
        from = at + 1;
    }
    None
}

/// The code with comments and the content of strings and characters replaced by spaces.
fn blanked(code: &str) -> String {
    let chars: Vec<char> = code.chars().collect();
    let mut blank = chars.clone();
    let starts = |i: usize, text: &str| text.chars().enumerate().all(|(k, c)| chars.get(i + k) == Some(&c));
    let mut i = 0;
    while i < chars.len() {
        let within_word = i > 0 && (chars[i - 1].is_alphanumeric() || chars[i - 1] == '_');
        let hashes = chars[(i + 1).min(chars.len())..].iter().take_while(|c| **c == '#').count();
        // First and last character of the content.
        let (from, to) = if starts(i, "//") {
            (i, (i..chars.len()).find(|&k| chars[k] == '\n').unwrap_or(chars.len()))
        } else if chars[i] == 'r' && !within_word && chars.get(i + 1 + hashes) == Some(&'"') {
            let (from, end) = (i + 2 + hashes, format!("\"{}", "#".repeat(hashes)));
            (from, (from..chars.len()).find(|&k| starts(k, &end)).unwrap())
        } else if chars[i] == '"' {
            let mut k = i + 1;
            while chars[k] != '"' {
                k += if chars[k] == '\\' { 2 } else { 1 };
            }
            (i + 1, k)
        } else if chars[i] == '\'' && (chars.get(i + 1) == Some(&'\\') || chars.get(i + 2) == Some(&'\'')) {
            let first = if chars[i + 1] == '\\' { i + 3 } else { i + 2 };
            (i + 1, (first..chars.len()).find(|&k| chars[k] == '\'').unwrap())
        } else {
            i += 1;
            continue;
        };
        blank[from..to].iter_mut().filter(|c| **c != '\n').for_each(|c| *c = ' ');
        i = to + 1;
    }
    blank.into_iter().collect()
}

/// A number with a fraction, such as 0.02 and 1e-9, or ε.
fn is_tolerance(token: &str) -> bool {
    let number = token.trim_end_matches("f32").trim_end_matches("f64").replace('_', "");
    token == "EPSILON"
        || number.starts_with(|c: char| c.is_ascii_digit())
            && number.parse::<f64>().is_ok_and(|value: f64| value.fract() != 0.0)
}

/// Names and numbers, with their places.
fn tokens(code: &str) -> Vec<(usize, &str)> {
    let bytes = code.as_bytes();
    let (mut found, mut i) = (Vec::new(), 0);
    while i < bytes.len() {
        let number = bytes[i].is_ascii_digit();
        let mut k = i;
        while k < bytes.len() {
            let fraction = number && bytes[k] == b'.' && bytes.get(k + 1).is_some_and(u8::is_ascii_digit);
            let sign = number && bytes[k] == b'-' && bytes[k - 1] == b'e';
            if !(bytes[k].is_ascii_alphanumeric() || bytes[k] == b'_' || fraction || sign) {
                break;
            }
            k += 1;
        }
        if k > i {
            found.push((i, &code[i..k]));
        }
        i = k.max(i + 1);
    }
    found
}

/// Whether an expression has a tolerance outside of the arguments of calls.
fn has_tolerance(expression: &str) -> bool {
    let bytes = expression.as_bytes();
    let mut calls = Vec::new();
    let mut at = 0;
    tokens(expression).into_iter().any(|(place, token)| {
        for i in at..place {
            match bytes[i] {
                b'(' => calls.push(i > 0 && (bytes[i - 1].is_ascii_alphanumeric() || bytes[i - 1] == b'_')),
                b')' => {
                    calls.pop();
                }
                _ => {}
            }
        }
        at = place;
        token == "EPSILON" || is_tolerance(token) && !calls.contains(&true)
    })
}

/// The rest of an expression: to a comma, a block, a logical operator or the end of the parentheses around it.
fn operand(code: &str) -> &str {
    let mut depth = 0;
    let end = code.char_indices().find(|&(i, c)| {
        depth += i32::from(matches!(c, '(' | '[')) - i32::from(matches!(c, ')' | ']'));
        let ends = matches!(c, ',' | ';' | '{' | '}' | '|') || code[i..].starts_with("&&");
        depth < 0 || depth == 0 && ends
    });
    &code[..end.map_or(code.len(), |(i, _)| i)]
}

/// Places of tolerances that are not rows, with the text around them.
fn stray_tolerances(code: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut add = |at: usize| {
        let line = code[..at].matches('\n').count() + 1;
        let from = code[..at].rfind('\n').map_or(0, |i| i + 1);
        let to = code[at..].find('\n').map_or(code.len(), |i| at + i);
        found.push((line, code[from..to].trim().to_owned()));
    };
    // rustfmt puts spaces around comparisons, and around no generic.
    for operator in [" < ", " <= ", " > ", " >= "] {
        for (at, _) in code.match_indices(operator) {
            let before = code[..at].rsplit([' ', '(', '\n']).next().unwrap();
            if has_tolerance(operand(&code[at + operator.len()..])) || is_tolerance(before) {
                add(at + 1);
            }
        }
    }
    for (at, _) in code.match_indices(").contains(") {
        let range = code[..at].rsplit('(').next().unwrap();
        if range.contains("..") && has_tolerance(range) {
            add(at);
        }
    }
    for word in ["relative_eq", "abs_diff_eq", "ulps_eq", "max_relative"] {
        code.match_indices(word).for_each(|(at, _)| add(at));
    }
    for (at, name) in tokens(code) {
        let rest = &code[at + name.len()..];
        let names = ["tolerance", "limit", "accuracy", "allowed", "band"];
        if names.iter().any(|word| name.to_lowercase().contains(word)) {
            // A binding, with or without its type.
            let value = rest.split(';').next().unwrap().split_once(" = ");
            if value.is_some_and(|(kind, value)| kind.len() < 12 && has_tolerance(operand(value))) {
                add(at);
            }
        }
        if name.starts_with("assert_") && rest.starts_with('(') {
            let arguments = operand(&rest[1..]).len();
            let (mut from, end) = (1, rest.len());
            let mut length = arguments;
            loop {
                if is_tolerance(rest[from..from + length].trim()) {
                    add(at);
                }
                from += length + 1;
                if from >= end || rest.as_bytes()[from - 1] != b',' {
                    break;
                }
                length = operand(&rest[from..]).len();
            }
        }
    }
    found
}

#[test]
fn every_tolerance_of_a_test_is_a_row() {
    let mut unused: BTreeSet<_> = NO_TOLERANCES.into_iter().map(|(file, text, _)| (file, text)).collect();
    let mut stray = Vec::new();
    let files = tests_of_all_files();
    assert!(files.len() > 120, "{} files", files.len());
    for (file, code) in &files {
        for (line, text) in stray_tolerances(code) {
            let known: Vec<_> =
                NO_TOLERANCES.iter().filter(|known| known.0 == file && text.contains(known.1)).collect();
            unused.retain(|known| known.0 != file || !text.contains(known.1));
            if known.is_empty() {
                stray.push(format!("{file}:{line}: {text}"));
            }
        }
    }
    let remedy = "write within!(error) or beyond!(value) and a row in tests/tolerances.toml";
    assert!(stray.is_empty(), "tolerances outside of the table; {remedy}:\n{}", stray.join("\n"));
    assert!(unused.is_empty(), "exceptions without a comparison: {unused:?}");
}

/// `within!` and `beyond!` by file and name of the row.
fn calls(files: &[(String, String)]) -> BTreeSet<(String, String, bool)> {
    let mut found = BTreeSet::new();
    for (file, code) in files.iter().filter(|(file, _)| file != "tests/common/tolerances.rs") {
        let text = fs::read_to_string(root().join(file)).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let mut function = "";
        for (number, line) in code.lines().enumerate() {
            let words = tokens(line);
            for (k, (at, word)) in words.iter().enumerate() {
                if *word == "fn" && line[at + word.len()..].starts_with(' ') {
                    function = words[k + 1].1;
                } else if (*word == "within" || *word == "beyond") && line[at + word.len()..].starts_with("!(") {
                    // The first argument may be on the next line.
                    let here = lines[number].split(&format!("{word}!(")).last().unwrap();
                    let first = if here.is_empty() { lines[number + 1].trim() } else { here };
                    let part = first.strip_prefix('"').and_then(|rest| rest.split_once('"'));
                    let name = part.map_or(function.to_owned(), |(part, _)| format!("{function}/{part}"));
                    found.insert((file.clone(), name, *word == "within"));
                }
            }
        }
    }
    found
}

#[test]
fn every_row_is_used_and_every_check_has_one() {
    let rows = ROWS
        .iter()
        .flat_map(|(file, rows)| rows.iter().map(|(name, row)| (file.clone(), name.clone(), row.limit.is_some())));
    let (rows, calls): (BTreeSet<_>, _) = (rows.collect(), calls(&tests_of_all_files()));
    assert!(rows.len() > 200, "{} rows", rows.len());
    let (without_call, without_row): (Vec<_>, Vec<_>) =
        (rows.difference(&calls).collect(), calls.difference(&rows).collect());
    assert!(
        without_call.is_empty() && without_row.is_empty(),
        "rows that no test uses (file, name, limit or least): {without_call:#?}\nchecks without a row: {without_row:#?}"
    );
}

/// What is wrong with a row.
fn fault(row: &Row) -> Option<&'static str> {
    let Row { measured, .. } = *row;
    let (holds, wide) = match (row.limit, row.least) {
        (Some(limit), None) => (measured <= limit, limit > WIDEST * measured.abs()),
        (None, Some(least)) => (measured >= least, measured > WIDEST * least),
        _ => return Some("needs either limit or least"),
    };
    let is_reason = |text: &str| text.split_whitespace().count() >= 3;
    if !is_reason(&row.why) {
        Some("needs a reason")
    } else if !holds {
        Some("the measured value is beyond its limit")
    } else if wide && !row.wide.as_deref().is_some_and(is_reason) {
        Some("the limit is far from the measured value: needs the reason `wide`")
    } else if !wide && row.wide.is_some() {
        Some("the limit is near the measured value: needs no reason `wide`")
    } else {
        None
    }
}

#[test]
fn every_row_has_a_reason_and_a_limit_near_its_measured_value() {
    let faults = ROWS.iter().flat_map(|(file, rows)| rows.iter().map(move |(name, row)| (file, name, fault(row))));
    let faults: Vec<_> =
        faults.filter_map(|(file, name, fault)| fault.map(|f| format!("{file} {name}: {f}"))).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn faults_of_rows_are_found() {
    let row = |text: &str| -> Row { toml::from_str(text).unwrap() };
    let good = "measured = 1e-9\nwhy = \"a sum of roundings\"\n";
    for (text, expected) in [
        (format!("{good}limit = 2e-8"), None),
        (format!("{good}limit = 2e-8\nleast = 0.1"), Some("either")),
        (good.into(), Some("either")),
        (format!("{good}limit = 5e-10"), Some("beyond")),
        (format!("{good}limit = 1e-7"), Some("far")),
        (format!("{good}limit = 1e-7\nwide = \"so it is\""), None),
        (format!("{good}limit = 1e-8\nwide = \"so it is\""), Some("near")),
        (format!("{good}least = 1e-8"), Some("beyond")),
        (format!("{good}least = 1e-12"), Some("far")),
        ("measured = 0.0\nlimit = 0.0\nwhy = \"\"".into(), Some("a reason")),
    ] {
        let found = fault(&row(&text));
        assert!(
            found.is_some() == expected.is_some() && expected.is_none_or(|e| found.unwrap().contains(e)),
            "{text}: {found:?}"
        );
    }
}

#[test]
fn checks_fail_beyond_their_rows_and_for_what_is_not_a_number() {
    let fails = |check: fn(f64), value: f64| std::panic::catch_unwind(move || check(value)).is_err();
    let above: fn(f64) = |error| within!("above", error);
    let below: fn(f64) = |value| beyond!("below", value, "message {}", 1);
    assert_eq!([0.4, 0.5, 0.6, f64::NAN].map(|error| fails(above, error)), [false, false, true, true]);
    assert_eq!([0.6, 0.5, 0.4, f64::NAN].map(|value| fails(below, value)), [false, false, true, true]);
    assert_eq!(
        (relative(1.0, 1.0), relative(0.0, 0.0), relative(-1.0, 2.0), largest([0.1, -0.3])),
        (0.0, 0.0, 1.5, 0.3)
    );
    assert!(relative(f64::NAN, 1.0).is_nan() && largest([1.0, f64::NAN, 2.0]).is_nan());
}

/// approx judges the two measures, just above and just below the limit.
#[test]
fn errors_are_those_of_approx() {
    for (a, b) in [(1.0, 1.5), (-3.0, 2.0), (1e-300, 3e-300), (7.0, 7.0 + 1e-12), (0.0, -4.0)] {
        let holds = |factor| approx::Relative { epsilon: 0.0, max_relative: factor * relative(a, b) }.eq(&a, &b);
        assert_eq!([holds(1.0 + 1e-9), holds(1.0 - 1e-9)], [true, false], "relative, {a} {b}");
        let holds = |factor| approx::AbsDiff { epsilon: factor * largest([a - b]) }.eq(&a, &b);
        assert_eq!([holds(1.0 + 1e-9), holds(1.0 - 1e-9)], [true, false], "largest, {a} {b}");
    }
}

#[test]
fn tolerances_outside_of_the_table_are_found() {
    for stray in [
        "assert!((a - b).abs() < 1e-9);",
        "assert!(error <= 0.02 * peak, \"{error}\");",
        "assert!(1e-3 > error);",
        "assert!(all.iter().all(|x| (x - 1.0).abs() <= 2.0 * f64::from(f32::EPSILON)));",
        "assert!(pair[1] <= pair[0] * (1.0 + 1e-12));",
        "assert!((0.4..2.5).contains(&ratio));",
        "approx::assert_relative_eq!(a, b);",
        "assert!(a.abs_diff_eq(b, tolerance));",
        "const TOLERANCE: f64 = 1e-9;",
        "let limit = 3e-7;",
        "assert_close(&a, &b, 1e-12, what);",
        "assert!(found > best - 0.5);",
    ] {
        assert_eq!(stray_tolerances(&blanked(stray)).len(), 1, "{stray}");
    }
    for sound in [
        "within!((a - b).abs(), \"< 1e-9\"); // < 1e-9",
        "assert!(found > psnr(0.03) + 1.0);",
        "assert!(count > 100 && ratio < 2.0);",
        "let x: Vec<f64> = values.iter().map(|x| 0.5 * x).collect();",
        "match x { Some(y) => 0.5 * y, None => 0.0 }",
        "assert!((3..100).contains(&count));",
        "assert_named(&blob(8.8), what);",
        "let step = 1e-5;",
        "let c = '\"'; let d = \"assert!(x < 0.5)\";",
    ] {
        assert_eq!(stray_tolerances(&blanked(sound)), [], "{sound}");
    }
}
