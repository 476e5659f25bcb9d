//! No circle of imports between source files: of two files, at most one needs the other.
//!
//! Files are read as tokens. An import is a path that begins with `crate`, `super`, `self` or a child module, in a `use` or
//! elsewhere. It leads to the file of its longest prefix that is a module; a name that this module imports itself leads on
//! to where it comes from, but for names behind `*`. Imports between a module and those within it do not count.

use crate::root;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs;
use std::path::{Path, PathBuf};

/// Traits whose types name each other, and which therefore have no order.
const MUTUAL: [&str; 4] = ["lanes.rs", "polynomials.rs", "real.rs", "reduce.rs"];

type Names = Vec<String>;

/// A source file: its modules, and its imports by the name that each gets.
#[derive(Default)]
struct Source {
    file: PathBuf,
    children: BTreeSet<String>,
    imports: Vec<(String, Names)>,
}

/// Words and signs of Rust code without comments, texts and characters.
fn tokens(code: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = code;
    let after = |rest: &str, end: &str| rest.find(end).map_or(rest.len(), |at| at + end.len());
    while let Some(first) = rest.chars().next() {
        let word = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        let raw = rest.trim_start_matches('b').strip_prefix('r').map(|text| text.split('"').next().unwrap());
        let length = if rest.starts_with("//") {
            after(rest, "\n")
        } else if let Some(marks) = raw.filter(|marks| marks.chars().all(|c| c == '#') && rest.contains('"')) {
            let start = after(rest, "\"");
            start + after(&rest[start..], &format!("\"{marks}"))
        } else if first == '"' {
            let mut is_escaped = false;
            let end = rest[1..].find(|c| {
                let ends = c == '"' && !is_escaped;
                is_escaped = c == '\\' && !is_escaped;
                ends
            });
            2 + end.expect("texts end")
        } else if first == '\'' {
            let character = rest[1..].chars().next().map_or(1, char::len_utf8);
            match rest[1..].starts_with('\\') {
                true => 3 + rest[3..].find('\'').expect("characters end") + 1,
                false if rest[1 + character..].starts_with('\'') => 2 + character,
                false => 1,
            }
        } else if word > 0 {
            found.push(rest[..word].to_owned());
            word
        } else if rest.starts_with("::") {
            found.push("::".to_owned());
            2
        } else {
            found.extend((!first.is_whitespace()).then(|| first.to_string()));
            first.len_utf8()
        };
        rest = &rest[length..];
    }
    found
}

/// Tokens without the items of tests.
fn without_tests(tokens: &[String]) -> Vec<&str> {
    let mut kept = Vec::new();
    let mut i = 0;
    while i < tokens.len() {
        let is = |expected: &[&str]| tokens[i..].iter().take(expected.len()).map(|s| &**s).eq(expected.iter().copied());
        if !is(&["#", "[", "cfg", "(", "test", ")", "]"]) {
            kept.push(&*tokens[i]);
            i += 1;
            continue;
        }
        let mut depth = 0;
        i += 7;
        while i < tokens.len() {
            depth += i32::from(tokens[i] == "{") - i32::from(tokens[i] == "}");
            i += 1;
            if depth == 0 && [";", "}"].contains(&&*tokens[i - 1]) {
                break;
            }
        }
    }
    kept
}

/// Adds the paths of a tree of imports behind `prefix`; returns how many tokens it has.
fn add_tree(tokens: &[&str], prefix: &[String], into: &mut Vec<(String, Names)>) -> usize {
    let mut path = prefix.to_vec();
    let mut i = 0;
    loop {
        match tokens[i] {
            "{" => {
                while tokens[i] != "}" {
                    i += 1;
                    i += if tokens[i] == "}" { 0 } else { add_tree(&tokens[i..], &path, into) };
                }
                return i + 1;
            }
            "::" => {}
            "as" => {
                into.push((tokens[i + 1].to_owned(), path));
                return i + 2;
            }
            "self" if !path.is_empty() => {}
            "*" => path.push("*".into()),
            word if word.chars().all(|c| c.is_alphanumeric() || c == '_') => path.push(word.to_owned()),
            _ => {
                into.push((path.last().unwrap().clone(), path));
                return i;
            }
        }
        i += 1;
    }
}

fn read(module: &[String], file: &Path, sources: &mut BTreeMap<Names, Source>) {
    let all = tokens(&fs::read_to_string(file).unwrap());
    let tokens = without_tests(&all);
    let mut source = Source { file: file.to_owned(), ..Source::default() };
    let stem = file.file_stem().unwrap();
    let is_root = ["mod", "lib", "main"].iter().any(|root| stem == *root);
    let folder = file.parent().unwrap().join(if is_root { Path::new("") } else { Path::new(stem) });
    let mut i = 0;
    while i + 2 < tokens.len() {
        match (tokens[i], tokens[i + 1], tokens[i + 2]) {
            ("mod", name, ";") => {
                let files = [folder.join(format!("{name}.rs")), folder.join(name).join("mod.rs")];
                let child = files.iter().find(|file| file.exists()).expect("a file for each module");
                source.children.insert(name.to_owned());
                read(&[module, &[name.to_owned()]].concat(), child, sources);
                i += 3;
            }
            // Not the captures of `impl Trait + use<…>`.
            ("use", name, _) if name != "<" => i += 1 + add_tree(&tokens[i + 1..], &[], &mut source.imports),
            ("crate" | "super" | "self", "::", _) if i == 0 || tokens[i - 1] != "::" => {
                let end = (i..tokens.len()).step_by(2).find(|&k| tokens.get(k + 1) != Some(&"::")).unwrap();
                let path: Names = tokens[i..=end].iter().filter(|word| **word != "::").map(|s| s.to_string()).collect();
                source.imports.push((String::new(), path));
                i = end + 1;
            }
            _ => i += 1,
        }
    }
    sources.insert(module.to_vec(), source);
}

/// The module in whose file a path of `module` ends; none for other packages.
fn resolved(module: &[String], path: &[String], sources: &BTreeMap<Names, Source>, depth: usize) -> Option<Names> {
    let supers = path.iter().take_while(|name| *name == "super").count();
    let full = match &*path[0] {
        "crate" => path[1..].to_vec(),
        "self" => [module, &path[1..]].concat(),
        "super" => [&module[..module.len().checked_sub(supers)?], &path[supers..]].concat(),
        child if sources[module].children.contains(child) => [module, path].concat(),
        _ => return None,
    };
    let found = (0..=full.len()).rev().map(|n| &full[..n]).find(|prefix| sources.contains_key(*prefix))?;
    let Some(name) = full.get(found.len()) else { return Some(found.to_vec()) };
    match sources[found].imports.iter().find(|(import, _)| import == name) {
        Some((_, onward)) if depth > 0 => {
            let onward = [onward, &full[found.len() + 1..]].concat();
            resolved(found, &onward, sources, depth - 1)
        }
        _ => Some(found.to_vec()),
    }
}

/// The imports between the files of a package, of which no file is within the module of the other.
fn imports(root: &Path) -> BTreeMap<PathBuf, BTreeSet<PathBuf>> {
    let mut sources = BTreeMap::new();
    read(&[], root, &mut sources);
    let mut all: BTreeMap<PathBuf, BTreeSet<PathBuf>> = BTreeMap::new();
    for (module, source) in &sources {
        for (_, path) in &source.imports {
            let Some(target) = resolved(module, path, &sources, 8) else { continue };
            if !target.starts_with(module) && !module.starts_with(&target) {
                all.entry(source.file.clone()).or_default().insert(sources[&target].file.clone());
            }
        }
    }
    all
}

/// Files that import each other, the first one named twice, for each shortest circle.
fn circles(imports: &BTreeMap<PathBuf, BTreeSet<PathBuf>>) -> BTreeSet<Vec<&Path>> {
    let mut found = BTreeSet::new();
    for (from, targets) in imports {
        // The shortest way back to `from` leads through larger names only: each circle is found from its first file.
        let mut before: BTreeMap<&Path, &Path> = BTreeMap::new();
        let mut next: VecDeque<&Path> = VecDeque::new();
        for target in targets.iter().filter(|target| *target > from) {
            before.insert(target, from);
            next.push_back(target);
        }
        while let Some(file) = next.pop_front() {
            for target in imports.get(file).into_iter().flatten() {
                if target == from {
                    let mut circle = vec![&**from, file];
                    while circle.last() != Some(&&**from) {
                        circle.push(before[circle.last().unwrap()]);
                    }
                    circle.reverse();
                    found.insert(circle);
                } else if target > from && !before.contains_key(&**target) {
                    before.insert(target, file);
                    next.push_back(target);
                }
            }
        }
    }
    found
}

fn report(root: &Path) -> Vec<String> {
    let imports = imports(root);
    let is_mutual = |file: &&Path| {
        file.parent().is_some_and(|folder| folder.ends_with("core/numeric"))
            && MUTUAL.iter().any(|name| file.ends_with(name))
    };
    let names = |circle: &[&Path]| circle.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(" → ");
    let all = circles(&imports);
    all.iter().filter(|circle| !circle.iter().all(is_mutual)).map(|circle| names(circle)).collect()
}

#[test]
fn no_source_files_import_each_other() {
    let root = root().join("src");
    let mut packages = vec![root.join("lib.rs"), root.join("main.rs")];
    let folders = fs::read_dir(&root).unwrap().map(|entry| entry.unwrap().path().join("lib.rs"));
    packages.extend(folders.filter(|file| file.exists()));
    assert!(packages.len() >= 3, "{packages:?}");
    let files: usize = packages.iter().map(|package| imports(package).len()).sum();
    assert!(files >= 150, "only {files} files with imports of others");
    let found: Vec<String> = packages.iter().flat_map(|package| report(package)).collect();
    assert!(found.is_empty(), "{} circles:\n{}", found.len(), found.join("\n"));
}

#[test]
fn circles_are_found_through_names_that_a_parent_passes_on_and_through_paths_in_code() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("lib.rs", "mod a;\nmod b;\nmod c;\nmod d;\npub use {a::One, b::{two, Three as Other}};\n");
    // A sound order; the test of `b` and texts do not count, and `crate::One` is in `a`.
    write("a.rs", "pub struct One;\nconst TEXT: &str = \"use crate::b::two; \\\" {\";\n");
    write("b.rs", "use super::One;\npub fn two() {}\n#[cfg(test)]\nmod tests { use crate::c::four; }\n");
    write("c.rs", "// use crate::d::five;\npub fn four<'a>(c: char) -> bool { super::b::two(); c == '{' }\n");
    write("d.rs", "use crate::{Other, c};\npub fn five() {}\n");
    assert_eq!(report(&folder.path().join("lib.rs")), [""; 0]);
    // `Other` is in `b`, so that `b` → `c` → `d` → `b` is a circle.
    write("b.rs", "use super::One;\npub fn two() { crate::c::four(); }\n");
    write("c.rs", "use super::d::five;\npub fn four() {}\n");
    write("d.rs", "use crate::Other;\npub fn five() {}\n");
    let found = report(&folder.path().join("lib.rs"));
    assert_eq!(found.len(), 1, "{found:?}");
    let files: Vec<&str> = found[0].split(" → ").map(|file| file.rsplit('/').next().unwrap()).collect();
    assert_eq!(files, ["b.rs", "c.rs", "d.rs", "b.rs"]);
}
