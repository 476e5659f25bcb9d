//! The limit on memory that every reader and every command keeps to.
//!
//! A count that a file states, or a size that a user asks for, is compared with the limit before memory is allocated for
//! it, so that a damaged file or a number with a zero too many is an error and never ends the process. Sums over pages,
//! strips, entries and listed files are compared as a whole. Ratios that no sound file can have are refused by the
//! readers themselves.

use bytesize::ByteSize;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};
use trgs_core::error::{Error, Result};
use trgs_core::setting::Text;

/// Part of the machine's memory that is the limit unless another is set: three quarters.
const PART: [u64; 2] = [3, 4];
/// The value of `SET` that stands for the default.
const UNSET: u64 = 0;

static SET: AtomicU64 = AtomicU64::new(UNSET);
static DEFAULT: LazyLock<u64> = LazyLock::new(|| available().map_or(u64::MAX, |bytes| bytes / PART[1] * PART[0]));

/// The limit, bytes.
///
/// By default it is three quarters of the memory that the machine, its control group and the process's address space have.
/// Systems that do not state these in files (`/proc`, `/sys`) have no default limit.
pub fn bytes() -> u64 {
    match SET.load(Ordering::Relaxed) {
        UNSET => *DEFAULT,
        bytes => bytes,
    }
}

/// Sets the limit of this process, or restores the default. All threads use it from then on.
pub fn set(bytes: Option<u64>) {
    SET.store(bytes.map_or(UNSET, |bytes| bytes.max(1)), Ordering::Relaxed);
}

/// Memory that this process can have at most, as far as the system states it: the smallest of its limits.
pub fn available() -> Option<u64> {
    let [machine, space] = [("/proc/meminfo", "MemTotal:"), ("/proc/self/limits", "Max address space")].map(stated);
    let groups = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let groups = groups.lines().filter_map(|line| line.splitn(3, ':').nth(2).map(|path| (path, line)));
    let of_group = |(path, line): (&str, &str)| {
        let (root, file) = match line.starts_with("0::") {
            true => ("/sys/fs/cgroup", "memory.max"),
            false if line.contains(":memory:") => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
            false => return None,
        };
        // A group has the limits of those that contain it. In a container the path of its own group is not there.
        let groups = Path::new(path.trim_start_matches('/')).ancestors();
        let limits = groups.filter_map(|group| {
            fs::read_to_string(Path::new(root).join(group).join(file)).ok()?.trim().parse::<u64>().ok()
        });
        limits.min()
    };
    let smallest = machine.into_iter().chain(space).chain(groups.filter_map(of_group)).min();
    smallest.filter(|bytes| *bytes > 0)
}

/// The first number after a key of a file of the system; kilobytes if it says so.
fn stated((file, key): (&str, &str)) -> Option<u64> {
    let text = fs::read_to_string(file).ok()?;
    let rest = text.lines().find_map(|line| line.strip_prefix(key))?;
    let mut words = rest.split_whitespace();
    let number: u64 = words.next()?.parse().ok()?;
    Some(if words.next() == Some("kB") { number << 10 } else { number })
}

/// Rejects what needs more memory than the limit, before memory is allocated.
///
/// # Errors
/// [`Error::Memory`] with both figures.
pub fn allow(what: impl Into<Text>, bytes: u64) -> Result<()> {
    let limit = self::bytes();
    if bytes <= limit { Ok(()) } else { Err(Error::memory(what, ByteSize(bytes), limit, bytes)) }
}

/// [`allow`] for an array of a shape, with `bytes` for each number.
///
/// # Errors
/// [`Error::Memory`], also for a product beyond all numbers.
pub fn allow_array(what: impl ToString, shape: &[usize], bytes: usize) -> Result<()> {
    let size = shape.iter().fold(bytes as u64, |product, &n| product.saturating_mul(n as u64));
    allow(format!("{} of shape {shape:?}", what.to_string()), size)
}

/// An empty vector with room for `count` numbers.
///
/// # Errors
/// [`Error::Memory`] beyond the limit, or when the system has less.
pub fn room<T>(what: impl ToString, count: usize) -> Result<Vec<T>> {
    let bytes = (count as u64).saturating_mul(size_of::<T>() as u64);
    allow(what.to_string(), bytes)?;
    let mut values = Vec::new();
    let reserved = values.try_reserve_exact(count);
    reserved.map_err(|_| Error::memory(what.to_string(), ByteSize(bytes), self::bytes(), bytes)).map(|()| values)
}

/// The rest of a file, which may be no larger than the limit. Pipes and files of the system state no size.
///
/// # Errors
/// That of the operating system, or an [`Error::Memory`] within one, which [`Error::read`] takes out again.
pub fn read_to_end(file: File) -> io::Result<Vec<u8>> {
    let size = file.metadata()?.len();
    let mut content = room::<u8>("content", usize::try_from(size).unwrap_or(usize::MAX)).map_err(io::Error::other)?;
    let read = file.take(self::bytes().saturating_add(1)).read_to_end(&mut content)?;
    allow("content", read as u64).map_err(io::Error::other)?;
    Ok(content)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_three_quarters_of_what_the_system_states() {
        let Some(available) = available() else { return };
        // Tests of one process share the limit, so none of them sets it.
        assert_eq!(bytes(), available / 4 * 3);
        assert!(available > 64 << 20, "{available}");
    }

    #[test]
    fn sizes_beyond_the_limit_are_errors_with_a_value_to_give() {
        if bytes() == u64::MAX {
            return;
        }
        allow("an image", 1).unwrap();
        let message = allow("an image", bytes() + 1).unwrap_err().to_string();
        assert!(message.starts_with("an image: got ") && message.contains("`max_memory` "), "{message}");
        let error = allow_array("volume", &[usize::MAX, usize::MAX, 3], 4).unwrap_err();
        assert!(matches!(error, Error::Memory { .. }), "{error}");
        assert!(matches!(room::<f64>("numbers", usize::MAX).unwrap_err(), Error::Memory { .. }));
        assert_eq!(room::<f64>("numbers", 3).unwrap().capacity(), 3);
        let message = allow("content", u64::MAX).unwrap_err().in_file(Path::new("a.raw")).to_string();
        assert!(message.starts_with("a.raw: content: got "), "{message}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn files_are_read_whole_unless_they_are_larger_than_the_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let read = |path: &Path| read_to_end(File::open(path).unwrap()).map_err(|source| Error::read(path, source));
        fs::write(&path, [7; 5000]).unwrap();
        assert_eq!(read(&path).unwrap(), [7; 5000]);
        // Files that state no size.
        assert!(!read(Path::new("/proc/self/limits")).unwrap().is_empty());
        assert!(read(Path::new("/dev/null")).unwrap().is_empty());
        assert!(matches!(read(folder.path()).unwrap_err(), Error::Read { .. }));
        // A sparse file takes no space on the disk.
        File::create(&path).unwrap().set_len(bytes().saturating_add(1).min(1 << 42)).unwrap();
        let error = read(&path).unwrap_err();
        assert!(matches!(error, Error::Memory { .. }) && error.to_string().contains("/a: content: got"), "{error}");
    }
}
