//! Shared geometry: the one CPU rasteriser, the one BVH with a watertight test, sampling, colour spaces, deterministic maths.
