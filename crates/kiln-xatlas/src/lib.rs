//! xatlas at arm's length: the words that travel between kiln and its worker program, and how the worker is run.
//!
//! The worker `kiln-xatlas` holds a large body of C++ that is not made for input from outside. It is a child process: it reads one
//! [`protocol::Request`] from standard input, writes one [`protocol::Reply`] to standard output and ends. Its memory errors cannot reach kiln, it can be
//! killed, and a limit on its time or memory is an error, never another result. The library beside it is plain Rust: the
//! encoding ([`protocol`], used by both sides) and the launcher ([`spawn`]).
//!
//! The program is built by `cargo build --release -p kiln-xatlas --features xatlas`, which needs libclang (Debian:
//! `apt-get install libclang-dev clang`). Set `CXXFLAGS=-ffp-contract=off` where the compiler might fuse multiplications and
//! additions, so that layouts are the same on all machines of a class.

pub mod protocol;
pub mod spawn;
