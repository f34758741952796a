//! The triangles alive at a threshold; CPU twin of `shaders/tree_draw_list.wgsl`.

/// How many triangles of `deaths` are alive at `threshold`.
pub fn alive_count(deaths: &[u32], threshold: u32) -> usize {
    deaths.iter().filter(|death| **death < threshold).count()
}

/// Writes the triangles alive at `threshold` to `out`, in their order, as far as it reaches; how many are alive. `deaths` are those of
/// `triangles` ([`super::Compact::deaths`], [`super::TreeLeaf::deaths`]); draw ranges are lists of their own.
pub fn draw_list(triangles: &[[u32; 3]], deaths: &[u32], threshold: u32, out: &mut [[u32; 3]]) -> usize {
    let mut count = 0;
    for (triangle, death) in triangles.iter().zip(deaths) {
        // Written always, counted if alive: no branch to mispredict.
        if let Some(slot) = out.get_mut(count) {
            *slot = *triangle;
        }
        count += usize::from(*death < threshold);
    }
    count
}
