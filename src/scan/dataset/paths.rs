//! Remarks on the files that a description lists: outside of its folder, or listed twice.

use super::meta::{Meta, ViewMeta};
use std::collections::BTreeMap;
use std::path::{Component, Path};
use trgs_core::words::{counted, verb};

/// Remarks on the listed files, one for each kind.
pub(super) fn remarks(meta: &Meta) -> Vec<String> {
    let views = || meta.proj_train.iter().chain(&meta.proj_test).map(|view| view.file_path.as_str());
    let volume = meta.vol.iter().chain(&meta.ct).map(String::as_str);
    let outside: Vec<&str> = views().chain(volume).filter(|path| leaves(path)).collect();
    let outside = outside.first().map(|first| {
        let (files, are) = (counted(outside.len(), "listed file"), verb(outside.len(), "is", "are"));
        format!(
            "{files} {are} outside of the scan's folder, as {first}: a copy of the folder lacks {}; put the files into the \
             folder and list them relative to it",
            verb(outside.len(), "it", "them")
        )
    });
    let twice = twice(&meta.proj_train).map(|(path, count, [a, b])| {
        let files = counted(count, "file");
        format!("proj_train lists {files} more than once, as {path} for views {a} and {b}: list every file once")
    });
    outside.into_iter().chain(twice).collect()
}

/// Whether a path is absolute or has a `..`.
fn leaves(path: &str) -> bool {
    let drive = path.as_bytes().get(1) == Some(&b':');
    drive || path.starts_with('/') || Path::new(path).components().any(|part| part == Component::ParentDir)
}

/// The first file that is listed twice, the number of such files, and two of its views.
fn twice(views: &[ViewMeta]) -> Option<(&str, usize, [usize; 2])> {
    let mut places: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (number, view) in views.iter().enumerate() {
        places.entry(&view.file_path).or_default().push(number);
    }
    let repeated = || places.iter().filter(|(_, places)| places.len() > 1);
    let (path, places) = repeated().min_by_key(|(_, places)| places[1])?;
    Some((path, repeated().count(), [places[0], places[1]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(train: &[&str], vol: Option<&str>) -> Vec<String> {
        let views: Vec<_> = train.iter().map(|path| serde_json::json!({ "file_path": path, "angle": 0.0 })).collect();
        let file = serde_json::json!({
            "scanner": { "mode": "cone", "DSD": 7, "DSO": 5, "nDetector": [4, 4], "sDetector": [4, 4],
                         "nVoxel": [4, 4, 4], "sVoxel": [2, 2, 2] },
            "vol": vol, "proj_train": views,
        });
        remarks(&Meta::parse(file.to_string().as_bytes(), Path::new("meta_data.json")).unwrap())
    }

    #[test]
    fn files_outside_of_the_folder_are_said_and_those_inside_are_not() {
        for path in ["/data/a.npy", "../a.npy", "x/../../a.npy", "C:/data/a.npy", "C:\\data\\a.npy", "\\\\host\\a.npy"]
        {
            let found = of(&["x/b.npy", path], None);
            assert!(found.len() == 1 && found[0].starts_with("1 listed file is outside"), "{path}: {found:?}");
        }
        assert!(of(&["../a.npy", "../b.npy"], Some("/v.npy"))[0].starts_with("3 listed files are outside"));
        assert_eq!(of(&["x/a..b.npy", "./c.npy", "x/y/d.npy"], Some("v.npy")), [""; 0]);
    }

    #[test]
    fn a_file_that_is_listed_twice_is_named_with_its_views() {
        let found = of(&["b.npy", "a.npy", "c.npy", "a.npy", "b.npy"], None);
        assert_eq!(
            found,
            ["proj_train lists 2 files more than once, as a.npy for views 1 and 3: list every file once"]
        );
    }
}
