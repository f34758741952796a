//! Incremental execution: actions, fingerprints, store, leases; knows no mesh and no TOML.
