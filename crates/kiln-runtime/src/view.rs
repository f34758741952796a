//! How large a length is on a screen.

/// A view of an object through a perspective camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// From the eye to the nearest point of the object's box, object units. Scale it by the inverse of the object's own scale.
    pub distance: f32,
    /// Full vertical angle of view, radians.
    pub vertical_fov_radians: f32,
    /// Height of the viewport, pixels.
    pub viewport_height_px: f32,
}

impl View {
    /// Pixels that one object unit covers, at most, at the view's distance:
    /// `viewport_height_px / (2 * distance * tan(vertical_fov_radians / 2))`.
    ///
    /// Infinite at or behind the eye, and for values that make no view: then the finest level is right.
    pub fn pixels_per_unit(&self) -> f32 {
        let span = 2.0 * self.distance * libm::tanf(self.vertical_fov_radians * 0.5);
        let scale = self.viewport_height_px / span;
        if span > 0.0 && scale.is_finite() && scale >= 0.0 { scale } else { f32::INFINITY }
    }

    /// The distance from `eye` to the nearest point of a box, both in object space; 0 inside it.
    pub fn distance_to_box(eye: [f32; 3], bounds: ([f32; 3], [f32; 3])) -> f32 {
        let outside = |k: usize| (bounds.0[k] - eye[k]).max(eye[k] - bounds.1[k]).max(0.0);
        libm::sqrtf((0..3).map(|k| outside(k) * outside(k)).sum::<f32>())
    }
}
