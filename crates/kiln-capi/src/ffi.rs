//! Every function that C calls, and all `unsafe` of the crate.
//!
//! Three things need it, each in one place: names that the linker sees (`no_mangle`), what callers point to (read in `get`,
//! `bytes_of` and the open functions, under the contract that each function states), and a handle that holds bytes together with
//! what borrows them ([`Handle`]). Panics end in `caught`.

#![allow(unsafe_code, reason = "the C boundary; audited as the module page says")]

use std::ffi::{CStr, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

use kiln_runtime::{AlignedBytes, Lods};

use crate::fill;
use crate::types::*;

/// An open container.
pub struct Handle {
    /// Borrows from `bytes`, or from what the caller keeps alive; dropped first, because fields drop in order.
    lods: Lods<'static>,
    /// What was copied or read; its heap block stays where it is when the handle moves.
    #[allow(dead_code, reason = "kept for what borrows it")]
    bytes: Option<AlignedBytes>,
}

/// Any number of threads may read one handle.
const _: fn() = || {
    fn is_shared<T: Send + Sync>() {}
    is_shared::<Handle>();
};

/// Runs `body`; a panic becomes [`Status::Internal`].
fn caught(body: impl FnOnce() -> Status) -> Status {
    catch_unwind(AssertUnwindSafe(body)).unwrap_or(Status::Internal)
}

/// Fills `out` from the container.
///
/// # Safety
/// `container` is NULL or a handle that is open; `out` is NULL or may be written.
unsafe fn get<T>(container: *const Handle, out: *mut T, fill: impl FnOnce(&Lods<'_>) -> Option<T>) -> Status {
    caught(|| {
        // SAFETY: the caller's contract.
        let Some(handle) = (unsafe { container.as_ref() }) else { return Status::Null };
        if out.is_null() {
            return Status::Null;
        }
        let Some(value) = fill(&handle.lods) else { return Status::None };
        // SAFETY: the caller's contract; `write` neither reads nor drops what was there.
        unsafe { out.write(value) };
        Status::Ok
    })
}

/// Tells the caller what went wrong, if it wants to know.
///
/// # Safety
/// `error` is NULL or may be written.
unsafe fn tell(error: *mut Error, status: Status, message: &str) -> Status {
    if !error.is_null() {
        // SAFETY: the caller's contract.
        unsafe { error.write(Error { status, message: fill::c_text(message.as_bytes()) }) };
    }
    status
}

/// A new handle for the bytes, written to `out`.
///
/// # Safety
/// `out` may be written; `lent`, where given, stays valid and unchanged until the handle is closed.
unsafe fn open(lent: Option<&'static [u8]>, bytes: Option<AlignedBytes>, out: *mut *mut Handle) -> Result<(), String> {
    let all: &[u8] = lent.unwrap_or_else(|| bytes.as_deref().unwrap_or(&[]));
    // SAFETY: `all` is either lent until the handle is closed, or the heap block of `bytes`, which lives in the handle beside
    // what borrows it and is never written.
    let all: &'static [u8] = unsafe { std::slice::from_raw_parts(all.as_ptr(), all.len()) };
    let lods = Lods::open(all).map_err(|e| e.to_string())?;
    let handle = Box::new(Handle { lods, bytes });
    // SAFETY: the caller's contract.
    unsafe { out.write(Box::into_raw(handle)) };
    Ok(())
}

/// Opens the container in `length` bytes, the whole file, and checks everything once. `*out` is the handle, NULL on failure.
///
/// With `copy` 0, bytes on a multiple of 16 are lent and not copied: they must stay valid and unchanged until `kiln_close`. Bytes
/// elsewhere are copied in any case.
///
/// # Safety
/// `bytes` is NULL or points to `length` bytes; `out` and `error` are NULL or may be written; with `copy` 0 the bytes outlive the
/// handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_open_bytes(
    bytes: *const u8,
    length: usize,
    copy: i32,
    out: *mut *mut Handle,
    error: *mut Error,
) -> Status {
    let status = caught(|| {
        if out.is_null() || bytes.is_null() {
            // SAFETY: this function's contract.
            return unsafe { tell(error, Status::Null, "a pointer is NULL") };
        }
        // SAFETY: this function's contract.
        unsafe { out.write(std::ptr::null_mut()) };
        if length > isize::MAX as usize {
            // SAFETY: this function's contract.
            return unsafe { tell(error, Status::Invalid, "more bytes than an address space has") };
        }
        // SAFETY: this function's contract.
        let all: &'static [u8] = unsafe { std::slice::from_raw_parts(bytes, length) };
        let lend = copy == 0 && (bytes as usize).is_multiple_of(16);
        let (lent, copied) = if lend { (Some(all), None) } else { (None, Some(AlignedBytes::copy_of(all))) };
        // SAFETY: this function's contract.
        match unsafe { open(lent, copied, out) } {
            Ok(()) => Status::Ok,
            // SAFETY: this function's contract.
            Err(message) => unsafe { tell(error, Status::Invalid, &message) },
        }
    });
    // SAFETY: this function's contract.
    if status == Status::Internal { unsafe { tell(error, status, "a defect of this library") } } else { status }
}

/// Opens the container in a file, and checks everything once. `*out` is the handle, NULL on failure.
///
/// # Safety
/// `path` is NULL or ends with a zero; `out` and `error` are NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_open_file(path: *const c_char, out: *mut *mut Handle, error: *mut Error) -> Status {
    let status = caught(|| {
        if out.is_null() || path.is_null() {
            // SAFETY: this function's contract.
            return unsafe { tell(error, Status::Null, "a pointer is NULL") };
        }
        // SAFETY: this function's contract.
        let path = unsafe {
            out.write(std::ptr::null_mut());
            path_of(CStr::from_ptr(path))
        };
        let read = std::fs::File::open(&path).and_then(|mut file| AlignedBytes::read_from(&mut file));
        let bytes = match read {
            Ok(bytes) => bytes,
            // SAFETY: this function's contract.
            Err(e) => return unsafe { tell(error, Status::Io, &e.to_string()) },
        };
        // SAFETY: this function's contract.
        match unsafe { open(None, Some(bytes), out) } {
            Ok(()) => Status::Ok,
            // SAFETY: this function's contract.
            Err(message) => unsafe { tell(error, Status::Invalid, &message) },
        }
    });
    // SAFETY: this function's contract.
    if status == Status::Internal { unsafe { tell(error, status, "a defect of this library") } } else { status }
}

#[cfg(unix)]
fn path_of(path: &CStr) -> std::path::PathBuf {
    use std::os::unix::ffi::OsStrExt;
    std::ffi::OsStr::from_bytes(path.to_bytes()).into()
}

#[cfg(not(unix))]
fn path_of(path: &CStr) -> std::path::PathBuf {
    path.to_string_lossy().into_owned().into()
}

/// Closes a container and frees what was copied; all pointers that it lent are void. NULL is allowed.
///
/// # Safety
/// `container` is NULL or an open handle, which no thread uses any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_close(container: *mut Handle) {
    if !container.is_null() {
        let _ = caught(|| {
            // SAFETY: the handle came from `Box::into_raw` in `open` and is closed once.
            drop(unsafe { Box::from_raw(container) });
            Status::Ok
        });
    }
}

/// Counts and facts that hold for the whole container.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_info(container: *const Handle, out: *mut Info) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| Some(fill::info(lods.container()))) }
}

/// A section, by its place in the table.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_section(container: *const Handle, number: u32, out: *mut Section) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::section(lods.container(), number as usize)) }
}

/// A level, 0 the finest.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_level(container: *const Handle, lod: u32, out: *mut Level) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::level(lods.container(), lod as usize)) }
}

/// A vertex array of a level, by its place among the level's arrays.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_array(container: *const Handle, lod: u32, number: u32, out: *mut Array) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::array(lods.container(), lod as usize, number as usize)) }
}

/// A submesh.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_submesh(container: *const Handle, number: u32, out: *mut Submesh) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::submesh(lods.container(), number as usize)) }
}

/// A material.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_material(container: *const Handle, number: u32, out: *mut Material) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::material(lods.container(), number as usize)) }
}

/// A texture.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_texture(container: *const Handle, number: u32, out: *mut Texture) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::texture(lods.container(), number as usize)) }
}

/// A mip of a texture, 0 the picture itself.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_mip(container: *const Handle, texture: u32, number: u32, out: *mut Mip) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::mip(lods.container(), texture as usize, number as usize)) }
}

/// What made the file; `KILN_STATUS_NONE` if it does not say so.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_provenance(container: *const Handle, out: *mut Provenance) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::provenance(lods.container())) }
}

/// An input of the build that made the file.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_input(container: *const Handle, number: u32, out: *mut Input) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::input(lods.container(), number as usize)) }
}

/// A stage of the build that made the file.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_stage(container: *const Handle, number: u32, out: *mut Stage) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::stage(lods.container(), number as usize)) }
}

/// The sliding window; `KILN_STATUS_NONE` if there is none.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_window(container: *const Handle, out: *mut Window) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::window(lods.container())) }
}

/// Tree and leaf buffers; `KILN_STATUS_NONE` if there are none.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_tree_leaf(container: *const Handle, out: *mut TreeLeaf) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::tree_leaf(lods.container())) }
}

/// The compact tree; `KILN_STATUS_NONE` if there is none.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_compact_tree(container: *const Handle, out: *mut CompactTree) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::compact_tree(lods.container())) }
}

/// The cluster DAG; `KILN_STATUS_NONE` if there is none.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_clusters(container: *const Handle, out: *mut Clusters) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| fill::clusters(lods.container())) }
}

/// The stored bytes of a section, by its place in the table: for private ones. Its bytes are as they stand in the file, coded or not.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_get_section_bytes(container: *const Handle, number: u32, out: *mut Bytes) -> Status {
    // SAFETY: this function's contract.
    unsafe {
        get(container, out, |lods| {
            lods.container().section_bytes(number).map(|b| Bytes { data: b.as_ptr(), length: b.len() })
        })
    }
}

/// The coarsest level whose error covers at most `max_error_px` pixels in a view; the finest if there is none.
///
/// # Safety
/// `container` is NULL or an open handle; `view` is NULL or points to a view; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_choose_level(
    container: *const Handle,
    view: *const View,
    max_error_px: f32,
    out: *mut u32,
) -> Status {
    // SAFETY: this function's contract.
    let Some(view) = (unsafe { view.as_ref() }) else { return Status::Null };
    let View { distance, vertical_fov_radians, viewport_height_px } = *view;
    let view = kiln_runtime::View { distance, vertical_fov_radians, viewport_height_px };
    // SAFETY: this function's contract.
    unsafe { choose(container, out, |lods| lods.choose_level(&view, max_error_px)) }
}

/// The coarsest level whose error is at most `max_error` object units; the finest if there is none.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_choose_by_error(container: *const Handle, max_error: f32, out: *mut u32) -> Status {
    // SAFETY: this function's contract.
    unsafe { choose(container, out, |lods| lods.choose_by_error(max_error)) }
}

/// The finest level of at most `budget` triangles; the coarsest if there is none.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_choose_by_triangles(container: *const Handle, budget: u32, out: *mut u32) -> Status {
    // SAFETY: this function's contract.
    unsafe { choose(container, out, |lods| lods.choose_by_triangles(budget)) }
}

/// Writes the number of a level.
///
/// # Safety
/// `container` is NULL or an open handle; `out` is NULL or may be written.
unsafe fn choose(container: *const Handle, out: *mut u32, choice: impl FnOnce(&Lods<'_>) -> usize) -> Status {
    // SAFETY: this function's contract.
    unsafe { get(container, out, |lods| Some(choice(lods) as u32)) }
}
