//! kiln's integration tests, by topic. Each drives the command or the library as a user does, on the project's own fixtures;
//! those that need real models take them from `KILN_CORPUS` and say so where it is not set.

#![allow(clippy::unwrap_used, reason = "tests")]
#![allow(missing_docs, reason = "tests")]

mod space;

mod bake;
mod buildsystems;
mod cache;
mod command;
mod compare;
mod container;
mod continuous;
mod corpus;
mod crash;
mod determinism;
mod families;
mod farm;
mod gltfpack;
mod goldens;
mod init;
mod inputs;
mod parts;
mod pipelines;
mod readers;
mod rebuild;
mod watch;
mod why;
