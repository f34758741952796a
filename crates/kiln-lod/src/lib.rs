//! Geometry: merge, simplify (metrics, placement, budgets, collapse sequence).
//!
//! Reading order: [`topology`] (points, edges and what they are), [`merge`], [`simplify`], [`normals`], [`check`].

pub mod check;
#[cfg(test)]
mod fixtures;
pub mod merge;
pub mod normals;
pub mod simplify;
pub mod topology;
