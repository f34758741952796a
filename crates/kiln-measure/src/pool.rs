//! One figure from many pixels: over all of them, and over those that the object covers.

use serde::Serialize;

use crate::render::Picture;

/// Means of a per-pixel figure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PixelMeans {
    /// Over all pixels of all pictures.
    pub all: f64,
    /// Over the pixels that either model covers, were it in part: the figure to compare between models.
    pub object: f64,
}

/// The sums behind [`PixelMeans`], picture after picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelSums {
    all: (f64, u64),
    object: (f64, u64),
}

impl PixelSums {
    pub(crate) fn add(&mut self, value: f64, on_object: bool) {
        self.all = (self.all.0 + value, self.all.1 + 1);
        if on_object {
            self.object = (self.object.0 + value, self.object.1 + 1);
        }
    }

    /// Adds the pixels of another picture.
    pub fn merge(&mut self, other: PixelSums) {
        self.all = (self.all.0 + other.all.0, self.all.1 + other.all.1);
        self.object = (self.object.0 + other.object.0, self.object.1 + other.object.1);
    }

    /// The means; `of_none` where there was no pixel.
    pub fn means(&self, of_none: f64) -> PixelMeans {
        let mean = |(sum, count): (f64, u64)| if count == 0 { of_none } else { sum / count as f64 };
        PixelMeans { all: mean(self.all), object: mean(self.object) }
    }
}

/// Whether either picture shows something of its model at pixel `k`.
pub(crate) fn on_object(reference: &Picture, other: &Picture, k: usize) -> bool {
    reference.coverage[k] > 0.0 || other.coverage[k] > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_over_all_pixels_of_all_pictures_and_over_the_objects() {
        let (mut first, mut second) = (PixelSums::default(), PixelSums::default());
        [(1.0, true), (3.0, false)].into_iter().for_each(|(value, on)| first.add(value, on));
        [(5.0, true), (7.0, true), (9.0, false)].into_iter().for_each(|(value, on)| second.add(value, on));
        first.merge(second);
        assert_eq!(first.means(0.0), PixelMeans { all: 5.0, object: 13.0 / 3.0 });
        assert_eq!(PixelSums::default().means(1.0), PixelMeans { all: 1.0, object: 1.0 });
    }
}
