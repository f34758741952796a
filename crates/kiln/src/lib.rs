//! The kiln command, and the library that build scripts call.
