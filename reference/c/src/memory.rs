//! Memory of the callers: arrays, objects and errors.

use crate::{trgs_error, trgs_gradient};
use std::any::Any;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice::from_raw_parts;
use trgs::error::{Error, Result};
use trgs::primitives::{Group, Parameters};
use trgs::projector::Kernels;

/// The numbers of arrays.
pub(crate) trait Number: Kernels {}
impl Number for f32 {}
impl Number for f64 {}

fn missing(what: &str) -> Error {
    Error::invalid(what, "NULL", "a pointer", format!("give {what}"))
}

/// `length` numbers of a caller.
///
/// # Safety
/// `array` is NULL or has `length` numbers, which nobody changes in the meantime.
pub(crate) unsafe fn read<'a, T>(array: *const T, length: usize, what: &str) -> Result<&'a [T]> {
    match (array.is_null(), length) {
        (_, 0) => Ok(&[]),
        (true, _) => Err(missing(what)),
        // SAFETY: as above.
        (false, _) => Ok(unsafe { from_raw_parts(array, length) }),
    }
}

/// Copies numbers to a caller.
///
/// # Safety
/// `array` is NULL or has room for the values.
pub(crate) unsafe fn write<T: Copy>(array: *mut T, values: &[T], what: &str) -> Result<()> {
    if array.is_null() && !values.is_empty() {
        return Err(missing(what));
    }
    // SAFETY: as above; `values` is memory of this library.
    unsafe { array.copy_from_nonoverlapping(values.as_ptr(), values.len()) };
    Ok(())
}

/// An object of a caller.
///
/// # Safety
/// `object` is NULL or valid.
pub(crate) unsafe fn object<'a, T>(object: *const T, what: &str) -> Result<&'a T> {
    // SAFETY: as above.
    unsafe { object.as_ref() }.ok_or_else(|| missing(what))
}

/// A text of a caller.
///
/// # Safety
/// `text` is NULL or ends with a zero.
pub(crate) unsafe fn text<'a>(text: *const c_char, what: &str) -> Result<&'a str> {
    if text.is_null() {
        return Err(missing(what));
    }
    // SAFETY: as above.
    let text = unsafe { CStr::from_ptr(text) };
    text.to_str().map_err(|_| Error::invalid(what, text.to_string_lossy(), "UTF-8", "give the path as UTF-8"))
}

/// The arrays of a gradient.
pub(crate) struct Gradient([*mut f64; 5]);

impl Gradient {
    /// # Safety
    /// `gradient` is NULL or valid.
    pub(crate) unsafe fn new(gradient: *const trgs_gradient) -> Result<Self> {
        // SAFETY: as above.
        let trgs_gradient { mean, scale, quaternion, density, nu } = *unsafe { object(gradient, "gradient") }?;
        Ok(Self([mean, scale, quaternion, density, nu]))
    }

    /// Copies the groups whose pointers are not NULL.
    ///
    /// # Safety
    /// The arrays have as many rows as `parameters`.
    pub(crate) unsafe fn write(&self, parameters: &Parameters) {
        for (group, array) in Group::ALL.into_iter().zip(self.0).filter(|(_, array)| !array.is_null()) {
            let values = parameters.group(group);
            // SAFETY: as above.
            unsafe { array.copy_from_nonoverlapping(values.as_ptr(), values.len()) };
        }
    }
}

/// Runs `work`; puts its error, or that of a panic, into `place`.
///
/// # Safety
/// `place` is NULL or a place for an error.
pub(crate) unsafe fn attempt<T>(place: *mut *mut trgs_error, work: impl FnOnce() -> Result<T>) -> Option<T> {
    let message = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(value)) => return Some(value),
        Ok(Err(error)) => error.to_string(),
        Err(panic) => format!("internal error: {}; report it", panicked(&*panic)),
    };
    if !place.is_null() {
        let message = CString::new(message.replace('\0', " ")).expect("without zeros");
        // SAFETY: as above.
        unsafe { place.write(Box::into_raw(Box::new(trgs_error(message)))) };
    }
    None
}

fn panicked(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("unknown")
}
