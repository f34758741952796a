//! The cluster DAG.
