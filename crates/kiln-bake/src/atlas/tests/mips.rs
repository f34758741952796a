//! What [`super::mips`] promises, against the texels themselves.

use super::*;
use crate::atlas::mips::{Fetch, foreign_share};

#[test]
fn the_table_of_the_page_holds() {
    let rows = [(0u32, 0, 1), (1, 1, 2), (2, 3, 5), (3, 7, 11), (4, 15, 23), (5, 31, 47)];
    for (level, texel, bilinear) in rows {
        assert_eq!((Fetch::Texel.reach(level), Fetch::Bilinear.reach(level)), (texel, bilinear));
        for (fetch, padding) in [(Fetch::Texel, 2 * texel), (Fetch::Bilinear, 2 * bilinear)] {
            assert_eq!(fetch.padding_for(level), padding);
            assert_eq!(fetch.coarsest_clean(padding), Some(level));
            assert_eq!(fetch.coarsest_clean(padding + 1), Some(level));
            assert!(padding == 0 || fetch.coarsest_clean(padding - 1) == level.checked_sub(1));
        }
    }
    assert_eq!((Fetch::Texel.coarsest_clean(16), Fetch::Bilinear.coarsest_clean(16)), (Some(3), Some(2)));
    assert_eq!(Fetch::Bilinear.coarsest_clean(1), None);
}

/// First texels, along one axis, of the footprints of all bilinear fetches at level `level` from places in texel `t`.
fn footprints(t: i64, level: u32) -> Vec<i64> {
    let side = 1i64 << level;
    // Places at 16 of a texel, the last one just before its end.
    let mut starts: Vec<i64> = (0..16)
        .map(|sixteenth| {
            let p = t as f64 + if sixteenth == 15 { 1.0 - 1e-9 } else { f64::from(sixteenth) / 16.0 };
            side * (p / side as f64 - 0.5).floor() as i64
        })
        .collect();
    starts.dedup();
    starts
}

#[test]
fn a_fetch_reaches_as_far_as_it_says_and_somewhere_does() {
    for level in 0..6 {
        let side = 1i64 << level;
        let mut farthest = 0;
        for t in 0..4 * side {
            for x in footprints(t, level) {
                farthest = farthest.max(t - x).max(x + 2 * side - 1 - t);
            }
        }
        assert_eq!(farthest, i64::from(Fetch::Bilinear.reach(level)), "level {level}");
        let farthest = (0..4 * side).map(|t| (t % side).max(side - 1 - t % side)).max();
        assert_eq!(farthest, Some(i64::from(Fetch::Texel.reach(level))));
    }
}

#[test]
fn the_foreign_share_is_what_weights_and_texels_add_up_to() {
    for padding in 0..40u32 {
        for level in 0..6 {
            let (side, band) = (1i64 << level, i64::from(padding / 2));
            let mut most = 0.0f64;
            for step in 0..side * 64 {
                let p = step as f64 / 64.0 + side as f64 * 2.0;
                let (t, x) = (p.floor() as i64, side * (p / side as f64 - 0.5).floor() as i64);
                let weight = |i: i64| 1.0 - (p - (x + i * side) as f64 - side as f64 / 2.0).abs() / side as f64;
                let foreign = |i: i64| (0..side).filter(|k| x + i * side + k < t - band).count() as f64 / side as f64;
                most = most.max(weight(0) * foreign(0) + weight(1) * foreign(1));
            }
            let told = foreign_share(padding, level);
            assert!((told - most).abs() < 0.02 && told >= most - 1e-9, "{padding}, {level}: {told} against {most}");
            let clean = Fetch::Bilinear.coarsest_clean(padding).is_some_and(|coarsest| level <= coarsest);
            assert_eq!(told == 0.0, clean, "{padding}, {level}");
        }
    }
    assert!((foreign_share(16, 3) - 1.0 / 16.0).abs() < 1e-12);
}

/// A sheet's texels: which each chart touches (charts by shared point and UV, found anew), and whose band each lies in.
struct Bands {
    size: i64,
    touched: Vec<(i64, i64, u32)>,
    /// `[size * size]`, the chart in whose band the texel lies.
    owner: Vec<Option<u32>>,
}

impl Bands {
    fn of(mesh: &Mesh, layout: &UvLayout) -> Bands {
        let uvs = mesh.atlas_uv.as_ref().expect("made");
        let size = i64::from(layout.size);
        let corners = |f: usize| mesh.triangles[f].map(|v| uvs[v as usize].as_dvec2() * f64::from(layout.size));
        let mut chart: Vec<u32> = (0..mesh.face_count() as u32).collect();
        let mut first = std::collections::BTreeMap::new();
        // Labels spread until nothing changes: slow and plain.
        loop {
            let before = chart.clone();
            for (f, t) in mesh.triangles.iter().enumerate() {
                for v in t {
                    let key = (mesh.points[*v as usize], uvs[*v as usize].to_array().map(f32::to_bits));
                    let label = first.entry(key).or_insert(chart[f]);
                    let least = (*label).min(chart[f]);
                    (*label, chart[f]) = (least, least);
                }
            }
            if chart == before {
                break;
            }
        }
        let mut bands = Bands { size, touched: Vec::new(), owner: vec![None; (size * size) as usize] };
        let mut seen = std::collections::BTreeSet::new();
        for (f, chart) in chart.iter().enumerate() {
            let triangle = corners(f);
            let [a, b, c] = triangle;
            if (b - a).perp_dot(c - a) == 0.0 {
                continue;
            }
            let (lo, hi) = (a.min(b).min(c).floor(), a.max(b).max(c).floor());
            for y in lo.y as i64..=(hi.y as i64).min(size - 1) {
                for x in lo.x as i64..=(hi.x as i64).min(size - 1) {
                    if reaches(&triangle, x as f64, y as f64) && seen.insert((x, y)) {
                        bands.touched.push((x, y, *chart));
                    }
                }
            }
        }
        let half = i64::from(layout.padding / 2);
        for (x, y, chart) in &bands.touched {
            for yy in (y - half).max(0)..=(y + half).min(size - 1) {
                for xx in (x - half).max(0)..=(x + half).min(size - 1) {
                    let owner = &mut bands.owner[(yy * size + xx) as usize];
                    assert!(owner.is_none_or(|other| other == *chart), "two bands meet at {xx} {yy}");
                    *owner = Some(*chart);
                }
            }
        }
        bands
    }

    fn is_clean(&self, chart: u32, from: (i64, i64), side: i64) -> bool {
        let inside = |c: i64| (0..=self.size - side).contains(&c);
        inside(from.0)
            && inside(from.1)
            && (0..side * side).all(|i| {
                let (x, y) = (from.0 + i % side, from.1 + i / side);
                self.owner[(y * self.size + x) as usize] == Some(chart)
            })
    }

    /// Reads at that level that hold something beyond the chart's own band.
    fn mixed(&self, fetch: Fetch, level: u32) -> usize {
        let side = 1i64 << level;
        let mixes = |(x, y, chart): &&(i64, i64, u32)| match fetch {
            Fetch::Texel => !self.is_clean(*chart, (x - x % side, y - y % side), side),
            Fetch::Bilinear => {
                let rows = footprints(*y, level);
                let starts = footprints(*x, level).into_iter().flat_map(|x| rows.iter().map(move |y| (x, *y)));
                starts.into_iter().any(|from| !self.is_clean(*chart, from, 2 * side))
            }
        };
        self.touched.iter().filter(mixes).count()
    }
}

/// Whether the triangle reaches into the unit square at `(x, y)` by more than 1/128, by separating axes.
fn reaches(triangle: &[glam::DVec2; 3], x: f64, y: f64) -> bool {
    let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(u, v)| glam::DVec2::new(x + u, y + v));
    let edges = (0..3).map(|k| (triangle[(k + 1) % 3] - triangle[k]).perp().normalize_or_zero());
    edges.chain([glam::DVec2::X, glam::DVec2::Y]).all(|axis| {
        let span = |points: &[glam::DVec2]| {
            points.iter().map(|p| p.dot(axis)).fold((f64::MAX, f64::MIN), |(lo, hi), d| (lo.min(d), hi.max(d)))
        };
        let ((a, b), (c, d)) = (span(triangle), span(&square));
        b.min(d) - a.max(c) > 1.0 / 128.0
    })
}

#[test]
fn no_read_that_is_promised_clean_holds_another_charts_texels_and_the_next_level_does() {
    let shapes = [
        ("sphere", Shape::sphere(24, 12)),
        ("cone and cylinder", Shape::cone().and(Shape::open_cylinder().mirrored())),
        ("leaves", Shape::leaves(12)),
        ("book", Shape::book(7)),
    ];
    let mut beyond = [0usize; 2];
    for (name, shape) in &shapes {
        for (size, padding) in [(128, 2), (256, 4), (256, 6), (256, 10), (512, 16), (512, 22)] {
            let (new, layout, _) =
                unwrap(&shape.clone().level(), &options(size, padding), &Uvunwrap::STANDARD).expect(name);
            let bands = Bands::of(&new.mesh, &layout);
            for (fetch, beyond) in [Fetch::Texel, Fetch::Bilinear].into_iter().zip(&mut beyond) {
                let coarsest = fetch.coarsest_clean(padding).expect("two texels keep level 0 clean");
                for level in 0..=coarsest {
                    assert_eq!(bands.mixed(fetch, level), 0, "{name}, {size}/{padding}: {fetch:?} at level {level}");
                }
                *beyond += bands.mixed(fetch, coarsest + 1);
            }
        }
    }
    assert!(beyond.iter().all(|count| *count > 0), "the promise gives nothing away: {beyond:?}");
}

#[test]
fn planar_charts_keep_the_same_promise() {
    for (size, padding) in [(256, 4), (512, 16)] {
        let (new, layout, report) =
            unwrap(&Shape::cone().and(Shape::cube()).level(), &options(size, padding), &Planar).expect("unwraps");
        let bands = Bands::of(&new.mesh, &layout);
        assert_eq!(bands.mixed(Fetch::Texel, report.clean_mip.expect("some")), 0);
        assert_eq!(bands.mixed(Fetch::Bilinear, report.clean_mip_bilinear.expect("some")), 0);
    }
}
