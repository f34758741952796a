//! Closed sets against a naive twin, rules against planted answers, and both on meshes that are no surfaces.

use glam::Vec3;
use kiln_asset::{RawMesh, SubmeshId};
use proptest::prelude::*;

use super::cut::{ClosedSet, Stop, Want, closed_below, cut_by_parts};
use super::parts::{PartLevel, PartRule};
use super::sequence::Replayed;
use super::*;
use crate::fixtures;

/// Small numbers out of one seed.
struct Noise(u64);

impl Noise {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % end.max(1)
    }
}

/// Performs the chosen collapses one by one on a list of triangles; what differs from the log is an error.
fn naive(mesh: &Mesh, sequence: &CollapseSequence, applied: &[bool]) -> Result<Vec<[u32; 3]>, String> {
    let point = |v: u32| mesh.points[v as usize].0;
    let mut faces: Vec<Option<[u32; 3]>> = mesh.triangles.iter().map(|t| Some(*t)).collect();
    for i in (0..applied.len()).filter(|i| applied[*i]) {
        let Collapse { from, to, .. } = sequence.collapses[i];
        let pairs = &sequence.pairs[sequence.pairs_of(i)];
        let mut dying: Vec<u32> = sequence.faces[sequence.faces_of(i)].to_vec();
        dying.sort_unstable();
        let mut found = Vec::new();
        for (f, slot) in faces.iter_mut().enumerate() {
            let Some(triangle) = *slot else { continue };
            let points = triangle.map(point);
            let degenerate = points[0] == points[1] || points[1] == points[2] || points[2] == points[0];
            if degenerate || !points.contains(&from) {
                continue;
            }
            if points.contains(&to) {
                found.push(f as u32);
                *slot = None;
                continue;
            }
            let mut moved = triangle;
            for v in moved.iter_mut().filter(|v| point(**v) == from) {
                let pair = pairs.iter().find(|pair| pair[0] == *v);
                *v = pair.ok_or_else(|| format!("collapse {i}: wedge {v} has no partner"))?[1];
            }
            *slot = Some(moved);
        }
        if found != dying {
            return Err(format!("collapse {i}: {found:?} vanish, logged are {dying:?}"));
        }
    }
    Ok(faces.into_iter().flatten().collect())
}

/// The replay of a closed set is what the naive twin makes, bit for bit.
fn agrees(mesh: &Mesh, sequence: &CollapseSequence, applied: &[bool]) -> Result<(), TestCaseError> {
    let expected = naive(mesh, sequence, applied).map_err(TestCaseError::fail)?;
    let Replayed { level, origin, .. } = sequence.replay_set(mesh, applied).unwrap();
    let mut used: Vec<u32> = expected.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    if !applied.contains(&true) {
        used = (0..mesh.vertex_count() as u32).collect();
    }
    let triangles: Vec<[u32; 3]> = level.triangles.iter().map(|t| t.map(|v| used[v as usize])).collect();
    prop_assert_eq!(&triangles, &expected);
    for (v, old) in used.iter().enumerate() {
        let bits = |p: Vec3| p.to_array().map(f32::to_bits);
        prop_assert_eq!(bits(level.positions[v]), bits(mesh.positions[*old as usize]));
        prop_assert_eq!(level.uv0.as_ref().map(|uv| uv[v]), mesh.uv0.as_ref().map(|uv| uv[*old as usize]));
        prop_assert_eq!(origin[level.points[v].index()], mesh.points[*old as usize].0);
    }
    Ok(())
}

/// A mesh of some trouble: parts side by side with seams through them, or a soup of parts.
fn troubled(kind: usize, noise: &mut Noise, faces: &[(u32, u32, u32)]) -> Mesh {
    match kind {
        0 => {
            let mut raw = fixtures::quilt(3, 2, 4, |x, y| (x * 0.9).sin() * (y * 0.7).cos()).into_raw();
            // Random seams: some wedges get UVs of their own.
            if let Some(uv) = &mut raw.uv0 {
                for t in raw.triangles.clone() {
                    if noise.below(6) == 0 {
                        uv[t[noise.below(3)] as usize].x += 3.0;
                    }
                }
            }
            Mesh::new(raw).unwrap()
        }
        1 => fixtures::hard_cube(3),
        2 => {
            // An open sheet of one part, cut at random: borders, ears and single triangles.
            let mut raw = fixtures::field(7, 6, |x, y| (x * 1.3).sin() + (y * 1.1).cos()).into_raw();
            raw.triangles.retain(|_| noise.below(4) > 0);
            raw.face_submesh = vec![SubmeshId(0); raw.triangles.len()];
            Mesh::new(raw).unwrap()
        }
        _ => {
            let triangles: Vec<[u32; 3]> = faces.iter().map(|(a, b, c)| [*a, *b, *c]).collect();
            let mut raw = fixtures::soup(&triangles).into_raw();
            // Two parts over the same places.
            let half = raw.triangles.len() / 2;
            let count = raw.positions.len() as u32;
            raw.positions.extend_from_within(..);
            for t in &mut raw.triangles[half..] {
                *t = t.map(|v| v + count);
            }
            for s in &mut raw.face_submesh[half..] {
                *s = SubmeshId(1);
            }
            raw.points.clear();
            raw.submeshes.push(raw.submeshes[0].clone());
            raw.submeshes[1].name = "other".into();
            for (s, submesh) in raw.submeshes.iter_mut().enumerate() {
                submesh.source_triangles = raw.face_submesh.iter().filter(|f| f.index() == s).count() as u32;
            }
            crate::merge::merge(&Mesh::new(raw).unwrap(), &Default::default()).0
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(120))]

    #[test]
    fn every_closed_set_replays_as_if_done_one_by_one(
        kind in 0_usize..4,
        seed in 0_u64..1_000_000,
        faces in prop::collection::vec((0_u32..14, 0_u32..14, 0_u32..14), 1..60),
    ) {
        let mut noise = Noise(seed);
        let mesh = troubled(kind, &mut noise, &faces);
        let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
        let dependencies = Dependencies::new(&mesh, &sequence).unwrap();
        let count = dependencies.len();
        for i in 0..count {
            prop_assert!(dependencies.of(i).iter().all(|d| (*d as usize) < i));
            let vanish: u32 = dependencies.touches(i).iter().map(|t| t[1]).sum();
            prop_assert_eq!(vanish as usize, sequence.faces_of(i).len());
        }
        // By thresholds a submesh, and by whim.
        let until: Vec<u32> = mesh.submeshes.iter().map(|_| noise.below(count + 1) as u32).collect();
        agrees(&mesh, &sequence, &closed_below(&dependencies, &until))?;
        let mut set = ClosedSet::new(&dependencies);
        let often = 2 + noise.below(12);
        for i in 0..count {
            if noise.below(often) > 0 {
                set.collapse(i);
            }
        }
        agrees(&mesh, &sequence, set.applied())?;
        prop_assert!(ClosedSet::of(&dependencies, set.applied()).is_some());

        // Splits in any order, each legal one to a closed set, and back again.
        let before = set.applied().to_vec();
        let mut undone = Vec::new();
        for _ in 0..3 * count {
            let i = noise.below(count);
            let legal = set.applied()[i] && (i + 1..count).all(|j| !set.applied()[j] || !dependencies.of(j).contains(&(i as u32)));
            prop_assert_eq!(set.may_split(i), legal);
            if set.split(i) {
                undone.push(i);
            }
        }
        agrees(&mesh, &sequence, set.applied())?;
        prop_assert!(ClosedSet::of(&dependencies, set.applied()).is_some());
        while let Some(i) = undone.pop() {
            prop_assert!(set.collapse(i));
        }
        prop_assert_eq!(set.applied(), before.as_slice());

        // A set that lacks what one of its collapses rests on is refused.
        if let Some(i) = (0..count).rev().find(|i| !dependencies.of(*i).is_empty()) {
            let mut alone = vec![false; count];
            alone[i] = true;
            prop_assert!(ClosedSet::of(&dependencies, &alone).is_none());
        }
        let whole = vec![true; count];
        prop_assert_eq!(sequence.replay_set(&mesh, &whole).unwrap().level, sequence.replay(&mesh, count).unwrap());
    }

    #[test]
    fn a_cut_by_parts_is_the_closed_set_of_its_thresholds_and_the_least_that_does_it(
        seed in 0_u64..1_000_000,
        loose in any::<bool>(),
    ) {
        let mut noise = Noise(seed);
        let mut mesh = troubled(0, &mut noise, &[]);
        if loose {
            // As it was before the merge: every part a component.
            let mut raw = mesh.into_raw();
            raw.points.clear();
            mesh = Mesh::new(raw).unwrap();
        }
        let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
        let dependencies = Dependencies::new(&mesh, &sequence).unwrap();
        let faces = continuation::submesh_faces(&mesh);
        let wants: Vec<Want> = faces
            .iter()
            .map(|f| if noise.below(2) == 0 { Want::Free } else { Want::Faces(noise.below(*f as usize + 1) as u32) })
            .collect();
        let free: u32 = faces.iter().zip(&wants).filter(|w| *w.1 == Want::Free).map(|w| *w.0).sum();
        let stop = Stop { faces: noise.below(free as usize + 1) as u32, earliest: 0, latest: dependencies.len() };
        let cut = cut_by_parts(&dependencies, &faces, &wants, stop, true);
        prop_assert_eq!(&cut.applied, &closed_below(&dependencies, &cut.until));
        let few = Dependencies::for_cuts(&mesh, &sequence).unwrap();
        prop_assert_eq!(&cut, &cut_by_parts(&few, &faces, &wants, stop, true));
        let level = sequence.replay_set(&mesh, &cut.applied).unwrap().level;
        prop_assert_eq!(&continuation::submesh_faces(&level), &cut.faces);
        for (s, want) in wants.iter().enumerate() {
            let Want::Faces(most) = *want else { continue };
            if cut.faces[s] <= most && cut.until[s] > 0 {
                let mut less = cut.until.clone();
                less[s] -= 1;
                let level = sequence.replay_set(&mesh, &closed_below(&dependencies, &less)).unwrap().level;
                prop_assert!(level.submesh_faces(SubmeshId(s as u32)).len() as u32 > most, "submesh {} could stop earlier", s);
            }
        }
    }

    /// Soups under rules: whatever comes, no panic, and a budget is met or the reason is given.
    #[test]
    fn soups_under_rules_meet_their_budgets_or_say_why(
        seed in 0_u64..1_000_000,
        faces in prop::collection::vec((0_u32..14, 0_u32..14, 0_u32..14), 1..60),
        keep in 0.01_f64..1.0,
        own in 0.01_f64..1.0,
    ) {
        let mesh = troubled(3, &mut Noise(seed), &faces);
        let rules = [rule("part", PartLevel::Keep(own)), rule("other", PartLevel::Relative { to: 0, factor: 0.5 })];
        for rules in [&rules[..1], &rules[..]] {
            let (set, report) = by_rules(&mesh, &[Budget::Keep(keep), Budget::Keep(keep * 0.5)], rules, Placement::Free);
            let source: u32 = mesh.submeshes.iter().map(|s| s.source_triangles).sum();
            for (n, (level, report)) in set.levels.iter().zip(&report.levels).enumerate() {
                let most = (keep * [1.0, 0.5][n] * f64::from(source)).floor() as usize;
                let missed = level.mesh.face_count() > most || report.parts.iter().any(|p| p.triangles > p.asked);
                prop_assert_eq!(missed, report.short.is_some(), "{:?}", report);
                prop_assert_eq!(crate::check::degenerate_faces(&level.mesh), crate::check::degenerate_faces(&mesh));
            }
        }
    }
}

fn rule(name: &str, level: PartLevel) -> PartRule {
    PartRule { name: name.into(), level }
}

fn by_rules(mesh: &Mesh, budgets: &[Budget], rules: &[PartRule], placement: Placement) -> (LodSet, SimplifyReport) {
    let sequence = collapse(mesh, &[], None, &SimplifyOptions::default());
    let options = LevelsOptions { samples: 5_000, placement, ..LevelsOptions::default() };
    let parts = Parts { rules, ..Parts::default() };
    levels_by_parts(mesh, &[], &sequence, mesh, budgets, &options, &parts)
}

use kiln_asset::LodSet;

fn waves(x: f32, y: f32) -> f32 {
    (x * 0.4).sin() * (y * 0.3).cos() * 0.5
}

/// Positions, attributes and index order of a submesh, positions of the whole mesh's numbering taken out.
fn submesh_bits(mesh: &Mesh, s: u32) -> Vec<[u32; 6]> {
    let range = mesh.submesh_faces(SubmeshId(s));
    let base = mesh.triangles[range.clone()].iter().flatten().min().copied().unwrap_or(0);
    let uv = mesh.uv0.as_ref().unwrap();
    mesh.triangles[range]
        .iter()
        .flatten()
        .map(|v| {
            let (p, t) = (mesh.positions[*v as usize], uv[*v as usize]);
            [v - base, p.x.to_bits(), p.y.to_bits(), p.z.to_bits(), t.x.to_bits(), t.y.to_bits()]
        })
        .collect()
}

#[test]
fn a_part_at_one_stays_bit_for_bit_and_the_total_is_met_around_it() {
    let mesh = fixtures::quilt(3, 3, 12, waves);
    let rules = [rule("part 1 1", PartLevel::Keep(1.0))];
    let budgets = [Budget::Keep(0.5), Budget::Keep(0.25), Budget::Keep(0.15)];
    for placement in [Placement::HalfEdge, Placement::Free] {
        let (set, report) = by_rules(&mesh, &budgets, &rules, placement);
        for ((level, report), budget) in set.levels.iter().zip(&report.levels).zip([0.5, 0.25, 0.15]) {
            let most = (budget * mesh.face_count() as f64) as u32;
            assert!(report.triangles <= most && report.triangles + 2 > most, "{report:?}");
            assert_eq!(report.short, None);
            assert_eq!(submesh_bits(&level.mesh, 4), submesh_bits(&mesh, 4), "{placement:?}");
            assert_eq!((report.parts[0].asked, report.parts[0].triangles), (288, 288));
            assert_eq!(report.gaps, 0);
            assert_eq!(level.mesh.submeshes, mesh.submeshes);
            assert_eq!(level.quadrics.len(), level.mesh.point_count());
        }
    }
}

#[test]
fn fixed_and_relative_parts_have_what_they_shall_have_at_every_level() {
    let mesh = fixtures::quilt(3, 3, 12, waves);
    let rules = [
        rule("part ? 0", PartLevel::Keep(0.25)),
        rule("part 1 2", PartLevel::Relative { to: 0, factor: 0.5 }),
        rule("part 0 0", PartLevel::Keep(1.0)),
    ];
    let (_, report) = by_rules(&mesh, &[Budget::Keep(0.6), Budget::Keep(0.25)], &rules, Placement::HalfEdge);
    for (report, keep) in report.levels.iter().zip([0.6, 0.25]) {
        let most = (keep * mesh.face_count() as f64) as u32;
        // The last collapse of each of the three parts may take a triangle too many.
        assert!(report.triangles <= most && report.triangles + 5 > most, "{report:?}");
        assert_eq!(report.submeshes[0], 288, "the last rule that matches holds");
        for s in [1, 2] {
            assert!(report.submeshes[s] <= 72 && report.submeshes[s] >= 71, "{report:?}");
        }
        assert!(report.submeshes[7] <= 36 && report.submeshes[7] >= 34, "half of a quarter: {report:?}");
        assert_eq!(report.short, None);
    }
}

#[test]
fn a_part_held_at_a_level_of_the_stage_is_the_same_at_all() {
    let mesh = fixtures::quilt(2, 2, 14, waves);
    let budgets = [Budget::Keep(0.6), Budget::Keep(0.3), Budget::Keep(0.2)];
    let (_, plain) = by_rules(&mesh, &budgets, &[], Placement::HalfEdge);
    let (_, report) = by_rules(&mesh, &budgets, &[rule("part 1 0", PartLevel::AsLevel(1))], Placement::HalfEdge);
    for level in &report.levels {
        let asked = plain.levels[1].submeshes[1];
        assert!(level.submeshes[1] <= asked && level.submeshes[1] + 2 > asked, "{level:?}");
        assert_eq!(level.short, None);
    }
}

#[test]
fn fixed_parts_beat_the_total_and_the_report_says_by_how_much() {
    let mesh = fixtures::quilt(2, 2, 8, waves);
    let (set, report) =
        by_rules(&mesh, &[Budget::Triangles(100)], &[rule("*", PartLevel::Keep(0.5))], Placement::HalfEdge);
    // The last collapse of each of the four parts may take a triangle too many.
    let reached = set.levels[0].mesh.face_count();
    assert!(reached <= 256 && reached > 252, "{reached}");
    let short = report.levels[0].short.as_deref().unwrap();
    let expected = format!("{} more: parts with rules of their own hold {reached}", reached - 100);
    assert!(short.contains(&expected), "{short}");
}

#[test]
fn a_neighbour_starved_by_a_fixed_part_is_brought_there_by_a_continuation() {
    // The middle stays whole, so what the log did around it after its first collapses is out of reach.
    let mesh = fixtures::quilt(3, 3, 16, waves);
    let rules = [rule("*", PartLevel::Keep(0.05)), rule("part 1 1", PartLevel::Keep(1.0))];
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let dependencies = Dependencies::new(&mesh, &sequence).unwrap();
    let faces = continuation::submesh_faces(&mesh);
    let wants: Vec<Want> = (0..9).map(|s| Want::Faces(if s == 4 { 512 } else { 25 })).collect();
    let stop = Stop { faces: 0, earliest: 0, latest: dependencies.len() };
    let log_alone = cut_by_parts(&dependencies, &faces, &wants, stop, true);
    assert!((0..9).any(|s| s != 4 && log_alone.faces[s] > 25), "nothing is starved: {:?}", log_alone.faces);
    let (set, report) = by_rules(&mesh, &[Budget::Keep(0.5)], &rules, Placement::Free);
    let level = &report.levels[0];
    assert!(level.continued > 0, "{level:?}");
    let sum = |faces: &[u32]| (0..9).filter(|s| *s != 4).map(|s| faces[s]).sum::<u32>();
    assert!(sum(&level.submeshes) < sum(&log_alone.faces), "{level:?} for {:?}", log_alone.faces);
    assert_eq!(submesh_bits(&set.levels[0].mesh, 4), submesh_bits(&mesh, 4));
    assert_eq!(level.gaps, 0);
}

#[test]
fn an_error_budget_holds_under_rules() {
    let mesh = fixtures::quilt(3, 1, 14, waves);
    let rules = [rule("part 0 0", PartLevel::Keep(1.0))];
    let (set, report) = by_rules(&mesh, &[Budget::Error(0.02), Budget::Error(0.1)], &rules, Placement::HalfEdge);
    for (level, asked) in set.levels.iter().zip([0.02, 0.1]) {
        assert!(level.error <= asked, "{report:?}");
        assert_eq!(submesh_bits(&level.mesh, 0), submesh_bits(&mesh, 0));
    }
    assert!(set.levels[1].mesh.face_count() < set.levels[0].mesh.face_count());
    assert!(set.levels[0].mesh.face_count() < mesh.face_count());
}

#[test]
fn rules_that_match_nothing_leave_the_plain_cut() {
    let mesh = fixtures::quilt(2, 2, 8, waves);
    let budgets = [Budget::Keep(0.3)];
    let none = by_rules(&mesh, &budgets, &[rule("nothing", PartLevel::Keep(1.0))], Placement::Free);
    assert_eq!(none, by_rules(&mesh, &budgets, &[], Placement::Free));
}

#[test]
fn boundaries_go_along_or_last_or_never() {
    let mesh = fixtures::quilt(2, 1, 12, waves);
    let inner = |boundary| {
        let options = SimplifyOptions { boundary, ..SimplifyOptions::default() };
        let sequence = collapse(&mesh, &[], None, &options);
        let kinds = crate::topology::Topology::new(&mesh).kinds;
        let of_boundary: Vec<usize> = (0..sequence.collapses.len())
            .filter(|i| kinds[sequence.collapses[*i].from as usize] == crate::topology::PointKind::Boundary)
            .collect();
        (of_boundary, sequence)
    };
    let (along, sequence) = inner(Boundary::Along);
    assert!(!along.is_empty() && along[0] < sequence.collapses.len() / 2);
    let (never, _) = inner(Boundary::Lock);
    assert!(never.is_empty());
    let (last, sequence) = inner(Boundary::Last);
    assert!(!last.is_empty());
    // Before the first of them, nothing else was legal: the log with boundaries locked ends there.
    let (_, locked) = inner(Boundary::Lock);
    assert_eq!(sequence.collapses[..last[0]], locked.collapses[..last[0]]);
    assert_eq!(last[0], locked.collapses.len());
}

#[test]
fn locked_submeshes_are_left_alone_by_the_log_and_by_placement() {
    let mesh = fixtures::quilt(3, 3, 8, waves);
    let locked: Vec<bool> = (0..9).map(|s| s == 4).collect();
    let conditions = Conditions { locked: &locked, ..Conditions::default() };
    let sequence = collapse_under(&mesh, &[], None, &SimplifyOptions::default(), &conditions);
    let options = LevelsOptions { samples: 5_000, placement: Placement::Free, ..LevelsOptions::default() };
    let parts = Parts { locked: &locked, ..Parts::default() };
    let (set, _) = levels_by_parts(&mesh, &[], &sequence, &mesh, &[Budget::Triangles(0)], &options, &parts);
    assert_eq!(submesh_bits(&set.levels[0].mesh, 4), submesh_bits(&mesh, 4));
    assert!(set.levels[0].mesh.face_count() < 400);
}

#[test]
fn loose_components_go_only_where_a_budget_asks() {
    // A tetrahedron cannot lose a face and stay what it is; twenty of them beside a sheet.
    let mut raw = fixtures::field(10, 10, waves).into_raw();
    for i in 0..20 {
        let first = raw.positions.len() as u32;
        let at = Vec3::new(i as f32, 20.0, 0.0);
        raw.positions.extend([Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z].map(|p| at + p * 0.1));
        raw.triangles.extend([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]].map(|t: [u32; 3]| t.map(|v| v + first)));
    }
    raw.points.clear();
    raw.face_submesh = vec![SubmeshId(0); raw.triangles.len()];
    raw.submeshes[0].source_triangles = raw.triangles.len() as u32;
    let mesh = Mesh::new(raw).unwrap();
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let level = |prune: f32, faces: u32| {
        let options = LevelsOptions { samples: 2_000, prune, ..LevelsOptions::default() };
        levels(&mesh, &[], &sequence, &mesh, &[Budget::Triangles(faces)], &options).1.levels.remove(0)
    };
    assert_eq!(level(0.2, 200).pruned, 0, "collapses do it");
    let kept = level(0.0, 40);
    assert!(kept.short.is_some() && kept.pruned == 0, "{kept:?}");
    let pruned = level(0.2, 40);
    assert!(pruned.pruned > 0 && pruned.short.is_none() && pruned.triangles <= 40, "{pruned:?}");
}

#[test]
fn no_face_turns_over_under_rules_and_continuations() {
    let mesh = fixtures::quilt(3, 3, 10, |x, y| waves(x, y) * 0.2);
    let rules = [
        rule("*", PartLevel::Keep(0.1)),
        rule("part 1 1", PartLevel::Keep(1.0)),
        rule("part 2 ?", PartLevel::Relative { to: 0, factor: 0.5 }),
    ];
    for placement in [Placement::HalfEdge, Placement::Free] {
        let (set, _) = by_rules(&mesh, &[Budget::Keep(0.4), Budget::Keep(0.2)], &rules, placement);
        for level in &set.levels {
            for f in 0..level.mesh.face_count() as u32 {
                let [a, b, c] = level.mesh.face_positions(kiln_asset::FaceId(f));
                assert!((b - a).cross(c - a).z > 0.0, "face {f} lies on its back");
            }
        }
    }
}

/// A closed strip with a twist, in two halves, one of them fixed.
#[test]
fn a_moebius_strip_of_two_parts_comes_through() {
    let n = 40_u32;
    let mut raw = RawMesh { submeshes: vec![Default::default(); 2], ..Default::default() };
    for half in 0..2 {
        let first = raw.positions.len() as u32;
        for i in half * n / 2..=(half + 1) * n / 2 {
            let turn = i as f32 / n as f32 * std::f32::consts::TAU;
            let across =
                Vec3::new((turn / 2.0).cos() * turn.cos(), (turn / 2.0).sin(), (turn / 2.0).cos() * turn.sin());
            let centre = Vec3::new(turn.cos(), 0.0, turn.sin()) * 3.0;
            raw.positions.extend([centre - across, centre + across]);
        }
        for i in 0..n / 2 {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| first + 2 * i + k);
            raw.triangles.extend([[a, b, c], [b, d, c]]);
            raw.face_submesh.extend([SubmeshId(half); 2]);
        }
        raw.submeshes[half as usize].name = format!("half {half}");
        raw.submeshes[half as usize].source_triangles = n;
    }
    let (mesh, _) =
        crate::merge::merge(&Mesh::new(raw).unwrap(), &crate::merge::MergeOptions { weld: 1e-4, ..Default::default() });
    let rules = [rule("half 0", PartLevel::Keep(0.9)), rule("half 1", PartLevel::Relative { to: 0, factor: 0.3 })];
    let (_, report) = by_rules(&mesh, &[Budget::Keep(0.5)], &rules, Placement::Free);
    let level = &report.levels[0];
    assert!(level.triangles <= 40 || level.short.is_some(), "{level:?}");
}

#[test]
fn a_blob_of_dependencies_comes_back_and_no_prefix_or_flip_panics() {
    let mesh = fixtures::quilt(2, 1, 3, waves);
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let found = Dependencies::new(&mesh, &sequence).unwrap();
    let blob = found.to_blob();
    assert_eq!(Dependencies::from_blob(&blob, 2).unwrap(), found);
    assert!(Dependencies::from_blob(&blob, 1).is_err(), "a submesh that there is not");
    for end in 0..blob.len() {
        assert!(Dependencies::from_blob(&blob[..end], 2).is_err());
    }
    for at in 0..blob.len() {
        let mut flipped = blob.clone();
        flipped[at] ^= 0x81;
        if let Ok(read) = Dependencies::from_blob(&flipped, 2) {
            // It may promise what the sequence does not keep: any cut of it is still a cut.
            let wants = [Want::Faces(3), Want::Free];
            let stop = Stop { faces: 2, earliest: 0, latest: read.len() };
            cut_by_parts(&read, &continuation::submesh_faces(&mesh), &wants, stop, true);
        }
    }
    let other = fixtures::quilt(1, 1, 2, waves);
    assert!(Dependencies::new(&other, &sequence).is_err(), "another mesh");
}

#[test]
fn one_thread_and_four_give_the_same_cut_by_parts() {
    let mesh = fixtures::quilt(3, 2, 10, waves);
    let rules = [rule("part 0 *", PartLevel::Keep(0.1)), rule("part 1 1", PartLevel::Keep(1.0))];
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (set, report) = by_rules(&mesh, &[Budget::Keep(0.3)], &rules, Placement::Free);
            (set.to_blob(), report)
        })
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn a_placed_collapse_rests_on_what_placed_its_ends() {
    let mesh = fixtures::field(10, 10, |x, y| (x * 0.7).sin() * (y * 0.5).cos());
    let options = SimplifyOptions { metric: MetricKind::Memoryless, ..SimplifyOptions::default() };
    let sequence = collapse(&mesh, &[], None, &options);
    let dependencies = Dependencies::new(&mesh, &sequence).unwrap();
    let mut seen = 0;
    for (i, own) in sequence.collapses.iter().enumerate() {
        // All that it rests on, near and far.
        let mut rests = vec![false; i];
        let mut open: Vec<usize> = vec![i];
        while let Some(at) = open.pop() {
            for on in dependencies.of(at) {
                if !std::mem::replace(&mut rests[*on as usize], true) {
                    open.push(*on as usize);
                }
            }
        }
        // A neighbour of a placed point sees its faces change; so does whoever takes it in.
        for end in [own.from, own.to] {
            if let Some(placed) = sequence.collapses[..i].iter().rposition(|c| c.to == end) {
                assert!(rests[placed], "collapse {i} does not rest on {placed}, which placed point {end}");
                seen += 1;
            }
        }
    }
    assert!(seen > 50, "{seen}");
}
