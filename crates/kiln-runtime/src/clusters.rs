//! Cluster DAG: which clusters to draw for a view.
