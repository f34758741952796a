//! The runtime as a C library with a generated header.
