//! Which LOD a budget or a view wants.

use kiln_format::layout::Checkpoint;

use super::{Window, WindowLod};
use crate::View;

impl Window<'_> {
    /// The finest LOD of at most `budget` triangles; the coarsest if none has so few.
    pub fn lod_for_triangles(&self, budget: u64) -> WindowLod {
        let (mut low, mut high) = (0, self.collapses());
        while low < high {
            let middle = low + (high - low) / 2;
            if self.triangle_count(self.lod(middle)) <= budget { high = middle } else { low = middle + 1 }
        }
        self.lod(low)
    }

    /// The coarsest checkpoint whose measured error is at most `error`, object units; the finest if there is none such.
    pub fn checkpoint_for_error(&self, error: f32) -> Option<&Checkpoint> {
        let allowed = self.view.checkpoints.partition_point(|c| c.error <= error);
        self.view.checkpoints.get(allowed.saturating_sub(1))
    }

    /// The coarsest LOD whose error is at most `error`, object units: measured at checkpoints, taken to rise in proportion to collapses
    /// between two.
    pub fn lod_for_error(&self, error: f32) -> WindowLod {
        let allowed = self.view.checkpoints.partition_point(|c| c.error <= error);
        let Some(fine) = allowed.checked_sub(1).and_then(|i| self.view.checkpoints.get(i)) else { return self.lod(0) };
        let Some(coarse) = self.view.checkpoints.get(allowed) else { return self.lod(fine.detail) };
        // Between 0 and 1, since the one's error is allowed and the other's is not; hostile numbers saturate.
        let share = f64::from(error - fine.error) / f64::from(coarse.error - fine.error);
        let steps = f64::from(coarse.detail.saturating_sub(fine.detail)) * share.clamp(0.0, 1.0);
        self.lod(fine.detail.saturating_add(steps as u32))
    }

    /// The coarsest LOD whose error covers at most `max_error_px` pixels in `view`, by [`Window::lod_for_error`].
    pub fn lod_for_view(&self, view: &View, max_error_px: f32) -> WindowLod {
        let scale = view.pixels_per_unit();
        // Infinite: at the eye, or no view at all.
        if scale.is_finite() { self.lod_for_error(max_error_px / scale) } else { self.lod(0) }
    }
}
