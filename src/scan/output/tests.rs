//! Tests of outputs.

use super::temporary::is_temporary;
use super::*;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};

/// Number of the step at which a process of these tests ends, and what it does until then.
const KILL_AT: &str = "TRGS_TEST_KILL_AT";
const WORK: &str = "TRGS_TEST_WORK";
/// Exit code of a process that was ended at a step.
const KILLED: i32 = 77;

thread_local! {
    /// Whether names are moved one by one, as on a system that cannot exchange two.
    pub(super) static FORBID_EXCHANGE: Cell<bool> = const { Cell::new(false) };
}

/// Ends the process at the step that the environment names: no destructor runs, as after a kill.
pub(super) fn step() {
    static LAST: LazyLock<Option<usize>> = LazyLock::new(|| std::env::var(KILL_AT).ok()?.parse().ok());
    static STEPS: AtomicUsize = AtomicUsize::new(0);
    if LAST.is_some_and(|last| STEPS.fetch_add(1, SeqCst) == last) {
        std::process::exit(KILLED);
    }
}

/// Content of all files below a folder, and its folders, by relative path.
fn content(folder: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    fn add(folder: &Path, root: &Path, found: &mut BTreeMap<PathBuf, Option<Vec<u8>>>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let content = if path.is_dir() { None } else { Some(fs::read(&path).unwrap()) };
            let is_folder = content.is_none();
            found.insert(path.strip_prefix(root).unwrap().into(), content);
            if is_folder {
                add(&path, root, found);
            }
        }
    }
    let mut found = BTreeMap::new();
    add(folder, folder, &mut found);
    found
}

fn entries(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<_> = names.filter(|name| name != MARK).collect();
    names.sort();
    names
}

fn scan(folder: &Path) -> Destination {
    Destination::new(folder, Kind::Scan, "simulate")
}

/// Writes a folder of two or three files.
fn write_scan(destination: Destination, text: &str) -> Result<()> {
    let staged = stage_folder(destination)?;
    fs::create_dir(staged.path().join("views")).unwrap();
    for name in ["meta_data.json", "views/0.npy", &format!("views/{text}.npy"), &format!("{text}.npy")] {
        fs::write(staged.path().join(name), text).unwrap();
    }
    staged.commit()
}

#[test]
fn a_failed_write_leaves_the_old_file_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    write_atomically(&path, |file| file.write_all(b"old")).unwrap();
    let error = write_atomically(&path, |file| {
        file.write_all(b"ne")?;
        Err(io::Error::other("out of ink"))
    });
    assert!(matches!(&error, Err(Error::Write { path: p, .. }) if *p == path), "{error:?}");
    assert_eq!(fs::read(&path).unwrap(), b"old");
    assert_eq!(entries(folder.path()), ["a.txt"]);
}

#[test]
fn a_missing_folder_is_an_error_that_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("missing/a.txt");
    let message = write_atomically(&path, |_| Ok(())).unwrap_err().to_string();
    assert!(message.contains("missing/a.txt") && message.contains("mkdir -p"), "{message}");
    assert_eq!(entries(folder.path()).len(), 0);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_device_is_an_error_and_stays_a_device() {
    let path = Path::new("/dev/full");
    assert!(matches!(write_atomically(path, |file| file.write_all(b"x")), Err(Error::Write { .. })));
    assert!(!fs::metadata(path).unwrap().is_file());
}

#[cfg(unix)]
#[test]
fn files_and_folders_get_ordinary_permissions() {
    use std::os::unix::fs::MetadataExt;
    let folder = tempfile::tempdir().unwrap();
    let (plain, ours) = (folder.path().join("plain"), folder.path().join("ours"));
    fs::write(&plain, "").unwrap();
    write_atomically(&ours, |_| Ok(())).unwrap();
    assert_eq!(fs::metadata(ours).unwrap().mode(), fs::metadata(plain).unwrap().mode());
    let (plain, ours) = (folder.path().join("dir"), folder.path().join("staged"));
    fs::create_dir(&plain).unwrap();
    stage_folder(scan(&ours)).unwrap().commit().unwrap();
    assert_eq!(fs::metadata(ours).unwrap().mode(), fs::metadata(plain).unwrap().mode());
}

#[test]
fn a_staged_folder_appears_as_a_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("deep/set");
    let staged = stage_folder(scan(&target)).unwrap();
    fs::write(staged.path().join("a"), "1").unwrap();
    assert!(!target.exists());
    drop(staged);
    assert_eq!(entries(folder.path()).len(), 0, "folders that it created go with it");

    let staged = stage_folder(scan(&target)).unwrap();
    fs::write(staged.path().join("a"), "1").unwrap();
    staged.commit().unwrap();
    assert_eq!(entries(&target), ["a"]);
    assert_eq!(entries(&folder.path().join("deep")), ["set"]);
}

#[test]
fn only_unchanged_folders_of_the_same_writer_are_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("set");
    fs::create_dir(&target).unwrap();
    for text in ["1", "2", "3"] {
        write_scan(scan(&target), text).unwrap();
        assert_eq!(entries(&target), [&*format!("{text}.npy"), "meta_data.json", "views"]);
    }
    let message = |destination: &Destination| destination.check().unwrap_err().to_string();
    // Measured data: the same files without a mark.
    let measured = folder.path().join("measured");
    write_scan(scan(&measured), "1").unwrap();
    fs::remove_file(measured.join(MARK)).unwrap();
    let before = content(folder.path());
    let refused = message(&scan(&measured));
    assert!(refused.contains("did not write") && refused.contains("`overwrite`"), "{refused}");
    assert!(message(&scan(&target).by("convert")).contains("a scan of another command, simulate"));
    assert!(message(&scan(&target).of(Kind::Run)).contains("a scan of simulate"));
    assert!(message(&scan(&target.join("meta_data.json"))).contains("not a directory"));
    assert!(write_scan(scan(&measured), "2").is_err());
    assert_eq!(content(folder.path()), before);
    // Anything that was added, at any depth, and a file that was changed.
    for (name, expected) in [("thesis.txt", "thesis.txt"), ("views/a/b", "views/a"), ("views/0.npy", "was changed")] {
        let path = target.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let older = fs::read(&path).ok();
        fs::write(&path, "years").unwrap();
        assert!(message(&scan(&target)).contains(expected), "{}", message(&scan(&target)));
        match older {
            Some(content) => fs::write(&path, content).unwrap(),
            None => fs::remove_file(&path).unwrap(),
        }
        let _ = fs::remove_dir(target.join("views/a"));
        scan(&target).check().unwrap();
    }
    fs::create_dir(target.join("views/empty")).unwrap();
    assert!(message(&scan(&target)).contains("views/empty"));
    write_scan(scan(&target).overwrite(true), "4").unwrap();
    assert_eq!(entries(&target.join("views")), ["0.npy", "4.npy"]);
    assert_eq!(entries(folder.path()), ["measured", "set", "set.replaced-1"]);
    assert!(folder.path().join("set.replaced-1/views/empty").exists());
}

#[cfg(unix)]
#[test]
fn links_are_foreign_and_a_folder_of_inputs_is_never_replaced() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_scan(scan(&at("in")), "1").unwrap();
    symlink(at("in"), at("link")).unwrap();
    let refused = |out: &str, input: &str| {
        let destination = Destination::new(format!("{}/{out}", folder.path().display()), Kind::Scan, "simulate");
        destination
            .overwrite(true)
            .input(format!("{}/{input}", folder.path().display()))
            .check()
            .unwrap_err()
            .to_string()
    };
    for out in ["in", "in/", "./in/.", "in/views/..", "link", "link/"] {
        assert!(refused(out, "in").contains("the folder that is read"), "{out}");
        assert!(refused(out, "link/").contains("the folder that is read"), "{out}");
        assert!(refused(out, "link/views/0.npy").contains("0.npy, which is read"), "{out}");
    }
    assert!(refused("in/views", "in/views/0.npy").contains("0.npy, which is read"));
    // A folder in the input is no input.
    scan(&at("in/more")).input(at("in")).check().unwrap();
    symlink(at("nowhere"), at("dangling")).unwrap();
    assert!(scan(&at("dangling")).check().unwrap_err().to_string().contains("a link to nothing"));
    // A link to a folder is followed; a link in one is nothing of ours.
    write_scan(scan(&at("link")), "2").unwrap();
    assert_eq!((entries(&at("in")).len(), at("link").is_symlink()), (3, true));
    fs::remove_file(at("in/2.npy")).unwrap();
    symlink(at("nowhere"), at("in/2.npy")).unwrap();
    assert!(scan(&at("in")).check().unwrap_err().to_string().contains("2.npy"));
}

#[test]
fn a_result_that_cannot_be_moved_is_kept_and_its_place_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("set");
    write_scan(scan(&target), "1").unwrap();
    let staged = stage_folder(scan(&target)).unwrap();
    fs::write(staged.path().join("hours"), "of work").unwrap();
    fs::write(target.join("thesis.txt"), "years").unwrap();
    let place = staged.path();
    let message = staged.commit().unwrap_err().to_string();
    assert!(message.contains("thesis.txt") && message.contains(place.to_str().unwrap()), "{message}");
    assert_eq!(fs::read_to_string(place.join("hours")).unwrap(), "of work");
    assert_eq!(fs::read_to_string(target.join("thesis.txt")).unwrap(), "years");
    // Nothing takes it for a temporary folder.
    sweep::sweep(folder.path());
    write_scan(scan(&folder.path().join("other")), "1").unwrap();
    assert!(place.join("hours").exists());
}

#[test]
fn dead_temporary_files_are_removed_and_those_of_others_stay() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let foreign =
        [".trgs-notes", ".trgs-tmp-", ".trgs-tmp-0123456789a", ".trgs-tmp-0123456789abc", ".trgs-tmp-0123456789-b"];
    for name in foreign {
        fs::write(at(name), "mine").unwrap();
    }
    // The name of a temporary folder, but content of somebody else.
    fs::create_dir(at(".trgs-tmp-AAAAAAAAAAAA")).unwrap();
    fs::write(at(".trgs-tmp-AAAAAAAAAAAA/thesis.txt"), "years").unwrap();
    fs::write(at(".trgs-tmp-BBBBBBBBBBBB"), "dead").unwrap();
    fs::create_dir(at(".trgs-tmp-CCCCCCCCCCCC")).unwrap();
    let alive = stage_folder(scan(&at("set"))).unwrap();
    let file = locked_file(folder.path()).unwrap();
    sweep::sweep(folder.path());
    let mut expected: Vec<String> = foreign.map(Into::into).into();
    expected.push(".trgs-tmp-AAAAAAAAAAAA".into());
    for path in [alive.path().parent().unwrap(), file.path()] {
        expected.push(path.file_name().unwrap().to_str().unwrap().into());
    }
    expected.sort();
    assert_eq!(entries(folder.path()), expected);
    assert!(at(".trgs-tmp-AAAAAAAAAAAA/thesis.txt").exists());
}

#[test]
fn one_process_at_a_time_writes_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let run = || Destination::new(folder.path().join("deep/run"), Kind::Run, "tv");
    let first = Claim::new(run()).unwrap();
    let message = Claim::new(run()).unwrap_err().to_string();
    assert!(message.contains("another process") && message.contains(&std::process::id().to_string()), "{message}");
    first.begin(&run()).unwrap();
    drop(first);
    assert_eq!(content(folder.path()), BTreeMap::new(), "nothing is left of a run without a state");
    // A lock whose process is dead.
    fs::create_dir_all(folder.path().join("deep/run")).unwrap();
    fs::write(folder.path().join("deep/run").join(LOCK), " (1)").unwrap();
    let claim = Claim::new(run()).unwrap();
    claim.begin(&run()).unwrap();
    fs::create_dir(folder.path().join("deep/run/checkpoints")).unwrap();
    fs::write(folder.path().join("deep/run/checkpoints/last.msgpack"), "state").unwrap();
    drop(claim);
    assert_eq!(entries(&folder.path().join("deep/run")), ["checkpoints"]);
    run().check().unwrap();
    assert!(run().by("sart").check().unwrap_err().to_string().contains("a run of another method, tv"));
    fs::write(folder.path().join("deep/run/checkpoints/mine.msgpack"), "state").unwrap();
    assert!(run().check().unwrap_err().to_string().contains("checkpoints/mine.msgpack"));
}

/// The work of a process that is ended at some step: see [`after_each_kill`].
#[test]
fn work_of_a_process() {
    let Ok(work) = std::env::var(WORK) else { return };
    let (work, target) = work.split_once(':').unwrap();
    let target = Path::new(target);
    match work {
        "exchange" => write_scan(scan(target), "new").unwrap(),
        "in place" => {
            FORBID_EXCHANGE.set(true);
            write_scan(scan(target), "new").unwrap();
        }
        "run" => {
            let claim = Claim::new(scan(target).by("")).unwrap();
            claim.begin(&scan(target)).unwrap();
            write_scan(scan(target), "new").unwrap();
        }
        "foreign" => write_scan(scan(target).overwrite(true), "new").unwrap(),
        "foreign run" => {
            let claim = Claim::new(scan(target).by("").overwrite(true)).unwrap();
            claim.begin(&scan(target).overwrite(true)).unwrap();
        }
        "file" => write_atomically(&target.join("a.txt"), |file| file.write_all(b"new")).unwrap(),
        _ => panic!("{work}"),
    }
}

/// Ends a process at each of its steps, and calls `check` after each; returns their number.
fn after_each_kill(work: &str, prepare: impl Fn(&Path), check: impl Fn(&Path, &str)) -> usize {
    for step in 0.. {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("set");
        prepare(&target);
        fs::write(folder.path().join(".trgs-notes"), "mine").unwrap();
        let ended = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["output::tests::work_of_a_process", "-q"])
            .env(KILL_AT, step.to_string())
            .env(WORK, format!("{work}:{}", target.display()))
            .stdout(std::process::Stdio::null())
            .status()
            .unwrap();
        check(&target, &format!("{work}, step {step}"));
        assert_eq!(fs::read_to_string(folder.path().join(".trgs-notes")).unwrap(), "mine");
        let left = content(folder.path()).into_keys().find(|path| path.file_name().is_some_and(is_temporary));
        assert_eq!(left, None, "{work}, step {step}");
        match ended.code() {
            Some(0) => return step,
            code => assert_eq!(code, Some(KILLED), "{work}, step {step}"),
        }
    }
    unreachable!("a process has an end");
}

#[test]
fn a_kill_at_any_step_leaves_the_old_or_the_new_folder() {
    let of = |text: &str| {
        let folder = tempfile::tempdir().unwrap();
        write_scan(scan(&folder.path().join("set")), text).unwrap();
        content(&folder.path().join("set"))
    };
    let (old, new, next) = (of("old"), of("new"), of("next"));
    for work in ["exchange", "in place", "run"] {
        for has_older in [true, false] {
            let prepare = |target: &Path| match has_older {
                true => write_scan(scan(target), "old").unwrap(),
                false => fs::create_dir(target).unwrap(),
            };
            let steps = after_each_kill(work, prepare, |target, which| {
                recover(target);
                let mut found = content(target);
                // The lock of a dead process, its temporary files and its empty folder.
                found.retain(|path, _| path.as_os_str() != LOCK && !path.iter().any(is_temporary));
                let is_new = found == new;
                let is_old = found == old || !has_older && found.keys().all(|path| path.as_os_str() == MARK);
                assert!(is_new || is_old, "{which}: {:?}", found.keys());
                drop(Claim::new(scan(target)).unwrap());
                write_scan(scan(target), "next").unwrap();
                assert!(content(target) == next, "{which}");
            });
            assert!(steps > 12, "{work}: {steps} steps");
        }
    }
}

#[test]
fn a_kill_at_any_step_leaves_content_of_others() {
    let prepare = |target: &Path| {
        fs::create_dir(target).unwrap();
        fs::write(target.join("thesis.txt"), "years").unwrap();
    };
    for work in ["foreign", "foreign run"] {
        let steps = after_each_kill(work, prepare, |target, which| {
            let kept = [target.to_owned(), target.with_file_name("set.replaced-1")];
            let texts = kept.map(|folder| fs::read_to_string(folder.join("thesis.txt")).ok());
            assert_eq!(texts.iter().flatten().collect::<Vec<_>>(), ["years"], "{which}");
            write_scan(scan(target).overwrite(true), "next").unwrap();
        });
        assert!(steps > 5, "{work}: {steps} steps");
    }
}

#[test]
fn a_kill_at_any_step_leaves_the_old_or_the_new_file() {
    let prepare = |target: &Path| {
        fs::create_dir(target).unwrap();
        fs::write(target.join("a.txt"), "old").unwrap();
    };
    let steps = after_each_kill("file", prepare, |target, which| {
        let text = fs::read_to_string(target.join("a.txt")).unwrap();
        assert!(["old", "new"].contains(&&*text), "{which}: {text}");
        sweep::sweep(target);
    });
    assert!(steps > 2, "{steps}");
}
