//! The calls into `shim.cpp`: the only unsafe code of the crate.

#![allow(unsafe_code, reason = "calls into the C++ shim; each states why it is sound")]

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::path::Path;

use crate::{FileLevel, OiioError, Size, Texels};

unsafe extern "C" {
    fn kiln_oiio_version() -> c_int;
    fn kiln_oiio_size(bytes: *const u8, length: usize, out: *mut u32, message: *mut c_char, capacity: usize) -> c_int;
    fn kiln_oiio_read(
        bytes: *const u8,
        length: usize,
        expected: *const u32,
        out: *mut f32,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn kiln_oiio_make_texture(
        path: *const c_char,
        format: *const c_char,
        texels: *const c_void,
        width: u32,
        height: u32,
        channels: u32,
        kind: c_int,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn kiln_oiio_read_level(
        path: *const c_char,
        level: c_int,
        size: *mut u32,
        out: *mut f32,
        count: usize,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
}

/// Longest message that is kept, bytes.
const MESSAGE: usize = 1024;

/// Runs a call that writes a message of at most [`MESSAGE`] bytes, zero at the end, if it does not give 0.
fn call(run: impl FnOnce(*mut c_char, usize) -> c_int) -> Result<(), OiioError> {
    let mut message = [0u8; MESSAGE];
    if run(message.as_mut_ptr().cast(), MESSAGE) == 0 {
        return Ok(());
    }
    let text = CStr::from_bytes_until_nul(&message).map_or_else(|_| "?".into(), CStr::to_string_lossy);
    Err(OiioError::Refused(text.trim().to_owned()))
}

pub(super) fn version() -> String {
    // SAFETY: reads a constant of the library.
    let number = unsafe { kiln_oiio_version() };
    format!("{}.{}.{}", number / 10_000, number / 100 % 100, number % 100)
}

pub(super) fn size(bytes: &[u8]) -> Result<Size, OiioError> {
    let mut out = [0u32; 3];
    // SAFETY: the bytes are only read, and not kept; `out` has the three places that the shim fills.
    call(|message, capacity| unsafe {
        kiln_oiio_size(bytes.as_ptr(), bytes.len(), out.as_mut_ptr(), message, capacity)
    })?;
    let [width, height, channels] = out;
    Ok(Size { width, height, channels })
}

pub(super) fn read(bytes: &[u8], size: Size) -> Result<Vec<f32>, OiioError> {
    let count = usize::try_from(size.values()).map_err(|_| OiioError::Refused("too large".into()))?;
    let mut out = vec![0f32; count];
    let expected = [size.width, size.height, size.channels];
    // SAFETY: the bytes are only read, and not kept; the shim writes `expected`'s product of floats, which `out` holds, and nothing
    // if the header tells another size.
    call(|message, capacity| unsafe {
        kiln_oiio_read(bytes.as_ptr(), bytes.len(), expected.as_ptr(), out.as_mut_ptr(), message, capacity)
    })?;
    Ok(out)
}

fn c_path(path: &Path) -> Result<CString, OiioError> {
    let text = path.to_str().ok_or_else(|| OiioError::Refused("a path that is no UTF-8".into()))?;
    CString::new(text).map_err(|_| OiioError::Refused("a path with a zero in it".into()))
}

pub(super) fn make_texture(path: &Path, size: Size, texels: Texels<'_>) -> Result<(), OiioError> {
    let (kind, length, pointer): (c_int, usize, *const c_void) = match texels {
        Texels::Bytes(values) => (0, values.len(), values.as_ptr().cast()),
        Texels::Words(values) => (1, values.len(), values.as_ptr().cast()),
        Texels::Halves(values) => (2, values.len(), values.as_ptr().cast()),
        Texels::Floats(values) => (3, values.len(), values.as_ptr().cast()),
    };
    let side = |side: u32| (1..=1 << 20).contains(&side);
    if length as u64 != size.values() || !side(size.width) || !side(size.height) || !(1..=4).contains(&size.channels) {
        return Err(OiioError::Refused(format!("{length} values do not make {size:?}")));
    }
    let (path, format) = (c_path(path)?, if kind >= 2 { c"openexr" } else { c"tiff" });
    // SAFETY: the strings end with a zero; the texels are as many as the size says, of the type that `kind` says, only read, and
    // not kept.
    call(|message, capacity| unsafe {
        kiln_oiio_make_texture(
            path.as_ptr(),
            format.as_ptr(),
            pointer,
            size.width,
            size.height,
            size.channels,
            kind,
            message,
            capacity,
        )
    })
}

pub(super) fn read_level(path: &Path, level: u32, most: usize) -> Result<FileLevel, OiioError> {
    let path = c_path(path)?;
    let (mut size, mut values) = ([0u32; 4], vec![0f32; most]);
    // SAFETY: the string ends with a zero; the shim fills four numbers and at most `most` floats.
    call(|message, capacity| unsafe {
        kiln_oiio_read_level(
            path.as_ptr(),
            level as c_int,
            size.as_mut_ptr(),
            values.as_mut_ptr(),
            most,
            message,
            capacity,
        )
    })?;
    let [width, height, channels, tile] = size;
    let size = Size { width, height, channels };
    values.truncate(size.values() as usize);
    Ok(FileLevel { size, tile, values })
}
