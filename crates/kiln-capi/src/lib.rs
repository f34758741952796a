//! The runtime as a C library with a generated header.
//!
//! **Problem.** An engine in C (or in anything that calls C) has the bytes of a container and wants levels, draw ranges, materials,
//! textures and layouts as pointers and lengths, and a level for a view. Nothing that it passes may bring it down.
//!
//! **Method.** One opaque handle, `kiln_container`, holds the bytes and what was checked about them. Everything else is a plain
//! struct that a function fills in:
//! ```text
//! kiln_open_bytes, kiln_open_file   check everything once -> handle, or a status and words in a kiln_error of the caller's
//! kiln_get_NAME(handle, .., out)    fills `out` with numbers, and pointers that live as long as the handle
//! kiln_choose_level, .._by_error, .._by_triangles   the level for a view or a budget
//! kiln_close                        frees the handle
//! ```
//! [`ffi`] holds the functions and all `unsafe` of the crate, [`types`] the structs, `fill` what goes into them; the structs of the
//! layouts' records are `kiln_format::layout`'s. `include/kiln.h` is generated from these (`tests/header.rs`,
//! `KILN_BLESS=1` writes it); `examples/summary.c` shows every function.
//!
//! **Rules.** Handles are immutable: any number of threads may read one. Errors are returned, never kept. Strings are UTF-8 with a
//! length and without a terminator. NULL where a pointer is needed gives `KILN_STATUS_NULL`; NULL for the error is allowed.
//!
//! **Limits.** Files are read whole, not mapped. Picking in layouts is not wrapped yet: the arrays are lent, the loops are the page's.

pub mod ffi;
mod fill;
pub mod types;
