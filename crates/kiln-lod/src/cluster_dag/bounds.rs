//! Spheres that hold one another to the last bit of a reader's arithmetic.

use glam::{DVec3, Vec3};

/// By how much spheres and errors grow from a group to the next beyond what they must: readers that work in single precision, whose
/// roundings are a sixteenth of that, find them in the same order.
const MARGIN: f64 = 1.0 / (1 << 20) as f64;

/// An error that a reader finds above `error`, or 0.
pub(super) fn above(error: f32) -> f32 {
    up(f64::from(error) * (1.0 + MARGIN))
}

/// The least f32 that is not below `value`; `value` is not negative.
fn up(value: f64) -> f32 {
    let near = value as f32;
    if f64::from(near) < value { near.next_up() } else { near }
}

/// A sphere that holds spheres (centre and radius), object units; zeros for none. Ritter's method.
pub(super) fn around(spheres: &[[f32; 4]]) -> [f32; 4] {
    let parts = |s: &[f32; 4]| (Vec3::new(s[0], s[1], s[2]).as_dvec3(), f64::from(s[3]));
    let reach = |from: DVec3, s: &[f32; 4]| (parts(s).0 - from).length() + parts(s).1;
    let Some(first) = spheres.first() else { return [0.0; 4] };
    let farthest = |from: DVec3| {
        let most = |a: (f64, usize), (i, s)| if reach(from, s) > a.0 { (reach(from, s), i) } else { a };
        parts(&spheres[spheres.iter().zip(0..).map(|(s, i)| (i, s)).fold((-1.0, 0), most).1])
    };
    let a = farthest(parts(first).0);
    let b = farthest(a.0);
    // Around both.
    let apart = (b.0 - a.0).length();
    let (mut centre, mut radius) = if apart + b.1 <= a.1 {
        a
    } else if apart + a.1 <= b.1 {
        b
    } else {
        let radius = 0.5 * (apart + a.1 + b.1);
        (a.0 + (b.0 - a.0) * ((radius - a.1) / apart), radius)
    };
    for sphere in spheres {
        let far = reach(centre, sphere);
        if far > radius {
            let grown = 0.5 * (radius + far);
            centre += (parts(sphere).0 - centre).normalize_or_zero() * (grown - radius);
            radius = grown;
        }
    }
    let centre = centre.as_vec3();
    let radius = spheres.iter().map(|s| reach(centre.as_dvec3(), s)).fold(0.0, f64::max);
    [centre.x, centre.y, centre.z, up(radius * (1.0 + MARGIN))]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn two_points_give_the_sphere_between_them() {
        let [x, y, z, r] = around(&[[-1.0, 0.0, 0.0, 0.0], [3.0, 0.0, 0.0, 0.0]]);
        assert_eq!([x, y, z], [1.0, 0.0, 0.0]);
        assert!((2.0..2.00001).contains(&r));
        assert_eq!(around(&[]), [0.0; 4]);
        assert_eq!(around(&[[5.0, 5.0, 5.0, 0.0]]), [5.0, 5.0, 5.0, 0.0]);
    }

    proptest! {
        #[test]
        fn all_spheres_are_held_and_not_much_more(spheres in prop::collection::vec(
            (prop::array::uniform3(-10.0f32..10.0), 0.0f32..3.0).prop_map(|(c, r)| [c[0], c[1], c[2], r]), 1..20)) {
            let out = around(&spheres);
            let part = |s: &[f32; 4]| (DVec3::new(s[0].into(), s[1].into(), s[2].into()), f64::from(s[3]));
            let (centre, radius) = part(&out);
            let mut least = 0.0_f64;
            for a in &spheres {
                prop_assert!((part(a).0 - centre).length() + part(a).1 <= radius);
                for b in &spheres {
                    least = least.max(0.5 * ((part(a).0 - part(b).0).length() + part(a).1 + part(b).1));
                }
            }
            // Ritter's are within a fifth of the smallest on points like these; the smallest is at most 2 / sqrt(3) of half the width.
            prop_assert!(radius <= 1.5 * least + 1e-6);
        }
    }
}
