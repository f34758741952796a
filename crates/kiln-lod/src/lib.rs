//! Geometry: merge, simplify (metrics, placement, budgets, collapse sequence), and the continuous layouts made of a level.
//!
//! Reading order: [`topology`] (points, edges and what they are), [`merge`], [`simplify`], [`normals`], [`check`]; then
//! [`sliding_window`], [`cluster_tree`] and [`cluster_dag`].

pub mod check;
pub mod checkpoint;
pub mod cluster_dag;
pub mod cluster_tree;
#[cfg(test)]
mod fixtures;
pub mod merge;
pub mod normals;
pub mod simplify;
pub mod sliding_window;
pub mod topology;

pub use checkpoint::Checkpoint;
