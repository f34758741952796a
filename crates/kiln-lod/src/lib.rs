//! Geometry: merge, simplify (metrics, placement, budgets, collapse sequence).
