//! Benchmarks against peers and naive twins; heavy dependencies stay here.
//!
//! Each program in `src/bin` runs kiln and its peer on the same input in one run and prints a table, ratios last: machines are
//! noisy, ratios less so. `cargo run --release -p kiln-bench --bin simplify -- MODEL...`

use std::path::Path;
use std::time::Instant;

use kiln_asset::Asset;
use kiln_asset::import::{Folder, ImportLimits, import};

/// The model at `path`.
///
/// # Errors
/// It cannot be imported.
pub fn model(path: &Path) -> Result<Asset, String> {
    let folder = path.parent().unwrap_or(Path::new(".")).to_path_buf();
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    import(&Folder(folder), &name, &ImportLimits::default()).map(|(asset, _)| asset).map_err(|e| e.to_string())
}

/// Result of the last of `runs` runs after one to warm up, and the median of their seconds.
///
/// # Panics
/// If `runs` is 0.
pub fn median<T>(runs: usize, mut work: impl FnMut() -> T) -> (T, f64) {
    let mut last = work();
    let mut seconds = Vec::with_capacity(runs);
    for _ in 0..runs {
        let start = Instant::now();
        last = work();
        seconds.push(start.elapsed().as_secs_f64());
    }
    seconds.sort_by(f64::total_cmp);
    (last, seconds[runs / 2])
}
