//! Metrics: what a collapse costs, and where it puts the point that stays.
//!
//! A metric is one file that implements [`Metric`]; the loop ([`super::collapse`]) knows no more of it. Costs are unitless,
//! by a power of the diagonal, and comparable along a sequence: square lengths times areas, or square volumes.
//!
//! | file | cost |
//! | --- | --- |
//! | `quadric` | area-weighted square distance to planes (Garland and Heckbert), with `attributes`: how far texture, shading and colours slide (Hoppe) |
//! | `memoryless` | square volume between the mesh as it is now and after, with volume and border kept (Lindstrom and Turk) |
//! | `bordered` | any of them, with a surcharge near borders in a texture (González) |

pub(super) mod attributes;
pub(super) mod bordered;
pub(super) mod memoryless;
pub(super) mod quadric;

use glam::DVec3;

use super::working::Working;

/// What prices collapses.
pub(super) trait Metric {
    /// Whether a cost may fall while a sequence goes on. If not, a cost is a lower bound for ever, and the loop prices only what
    /// comes to the front of its queue.
    const FALLS: bool;

    /// Whether points that stay move; then the log keeps their places.
    const PLACES: bool = false;

    /// What brings a cost to square distance times area by the diagonal to the fourth, in the mean over the mesh.
    fn quadric_unit(&self) -> f32 {
        1.0
    }

    /// What taking `from` to `to` costs: unitless, 0 or more. `corner`, if the caller
    /// has one, lies at `from`, and its face holds `to`, too; else it is [`NONE`](crate::topology::NONE).
    fn cost(&self, work: &Working<'_>, from: u32, to: u32, corner: u32) -> f32;

    /// The costs of taking `from`, which lies inside a patch, to the points that follow it in the faces at its corners; `out` takes
    /// (cost, point) each.
    fn costs(&self, work: &Working<'_>, from: u32, mut out: impl FnMut(f32, u32)) {
        for corner in work.corners(from) {
            let to = work.others(*corner)[0];
            if self.offers(work, from, to) {
                out(self.cost(work, from, to, *corner), to);
            }
        }
    }

    /// What a texture border adds to a cost in another unit (that of views): unitless, the extension's weight by a length over the
    /// diagonal, or by a share of the mesh's area.
    fn surcharge(&self, _work: &Working<'_>, _from: u32, _to: u32) -> f64 {
        0.0
    }

    /// Whether `from` is the end that offers the edge; where points that stay move, both ends would offer the same.
    fn offers(&self, _work: &Working<'_>, _from: u32, _to: u32) -> bool {
        true
    }

    /// Where `to` goes when it takes in `from`; `None` where it stays.
    fn place(&self, _work: &Working<'_>, _from: u32, _to: u32) -> Option<DVec3> {
        None
    }

    /// Faces at `p` have changed; called after each collapse where points move, and before `p` is priced anew where costs may fall.
    fn star_changed(&mut self, _work: &Working<'_>, _p: u32) {}

    /// `from` falls to `to`, which goes to `place` ([`Metric::place`]); called before the faces change, with the pairs of wedges in
    /// [`Working::map`]. The length, in object units, that `to` is off its source by from now on, as the metric sees it.
    fn merge(&mut self, work: &mut Working<'_>, from: u32, to: u32, place: Option<DVec3>) -> f64;
}
