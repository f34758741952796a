//! Benchmarks against peers and naive twins; heavy dependencies stay here.
