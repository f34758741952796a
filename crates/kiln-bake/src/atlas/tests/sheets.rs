//! Several sheets, and densities of submeshes.

use super::*;

fn spread(sheets: u32, size: u32, padding: u32) -> AtlasOptions {
    AtlasOptions { sheets, ..options(size, padding) }
}

/// The sheet of each submesh; asserts that there is one.
fn sheet_of(mesh: &Mesh) -> Vec<Option<u32>> {
    let uvs = mesh.atlas_uv.as_ref().expect("made");
    let mut found = vec![None; mesh.submeshes.len()];
    for (t, submesh) in mesh.triangles.iter().zip(&mesh.face_submesh) {
        let corners = t.map(|v| uvs[v as usize]);
        let sheet = UvLayout::sheet_of(corners);
        assert_eq!(*found[submesh.index()].get_or_insert(sheet), sheet, "a submesh on two sheets");
        let inside = |uv: &Vec2| (sheet as f32..=sheet as f32 + 1.0).contains(&uv.x) && (0.0..=1.0).contains(&uv.y);
        assert!(corners.iter().all(inside), "{corners:?}");
    }
    found
}

/// `count` spheres of several sizes in a row.
fn spheres(count: u32, size: impl Fn(u32) -> f32) -> Level {
    let sphere = Shape::sphere(16, 8);
    let parts: Vec<Shape> = (0..count).map(|i| sphere.scaled(size(i), Vec3::X * 4.0 * i as f32)).collect();
    Shape::submeshes(&parts)
}

fn laid(level: &Level, options: &AtlasOptions) -> (Level, UvLayout, AtlasReport) {
    let out = unwrap(level, options, &Uvunwrap::STANDARD).expect("unwraps");
    assert_untouched(level, &out.0);
    check(&out.0.mesh, &out.1).expect("what `unwrap` returned passes the check");
    out
}

#[test]
fn submeshes_are_spread_over_sheets_by_their_area_and_all_at_one_density() {
    let level = spheres(5, |i| [1.01, 0.6, 1.0, 0.8, 0.6][i as usize]);
    let (new, layout, report) = laid(&level, &spread(2, 256, 4));
    assert_eq!(layout.sheets, 2);
    // Areas 1.02, 0.36, 1, 0.64, 0.36: the two large ones part, 0.64 goes to the second, 0.36 twice to the first.
    assert_eq!(sheet_of(&new.mesh), [Some(0), Some(0), Some(1), Some(1), Some(0)]);
    assert_eq!(report.sheets.iter().map(|s| s.submeshes).collect::<Vec<_>>(), [3, 2]);
    assert_eq!(report.charts, report.sheets.iter().map(|s| s.charts).sum::<u32>());
    let got = check(&new.mesh, &layout).expect("sound").of_submesh;
    let (low, high) = got.iter().fold((f64::MAX, 0.0f64), |(lo, hi), d| (lo.min(*d), hi.max(*d)));
    assert!(report.uneven.is_empty() && high / low < 1.02, "{got:?}");
    let (_, _, one) = laid(&level, &spread(1, 256, 4));
    assert!(report.texels_per_unit > 1.3 * one.texels_per_unit, "twice the room: {report:?}");
}

#[test]
fn one_submesh_makes_one_sheet_with_the_same_bytes_whatever_is_allowed() {
    let level = Shape::sphere(16, 8).level();
    let (one, ..) = laid(&level, &spread(1, 256, 4));
    let (many, layout, report) = laid(&level, &spread(64, 256, 4));
    assert!(one.mesh.to_blob() == many.mesh.to_blob());
    assert_eq!((layout.sheets, report.sheets.len()), (1, 0));
}

#[test]
fn a_sheet_is_not_opened_for_a_trifle() {
    let level = spheres(2, |i| [1.0, 0.1][i as usize]);
    assert_eq!(laid(&level, &spread(2, 256, 4)).1.sheets, 1);
}

#[test]
fn the_last_of_the_most_sheets_is_as_sound_as_the_first() {
    // At 1024 texels the last sheet's UVs are as coarse as they may be.
    let level = spheres(64, |i| 1.0 + 0.001 * (i % 5) as f32);
    let options = AtlasOptions { unwrapper: UnwrapperChoice::Planar, ..spread(64, 1024, 16) };
    let (new, layout, report) = unwrap(&level, &options, &Planar).expect("unwraps");
    assert_eq!(layout.sheets, 64);
    check(&new.mesh, &layout).expect("rounding of the last sheet's UVs breaks nothing");
    let mut sheets: Vec<u32> = sheet_of(&new.mesh).into_iter().flatten().collect();
    sheets.sort_unstable();
    assert_eq!(sheets, (0..64).collect::<Vec<u32>>());
    assert!(report.padding_measured.is_some_and(|p| p >= 16) && report.edge_measured >= 8, "{report:?}");
}

#[test]
fn submeshes_that_share_points_part_where_their_sheets_do() {
    let half = Shape::grid(4, 4, |u, v| Vec3::new(u, v, 0.0));
    let mut both = Shape::submeshes(&[half.clone(), half.scaled(1.0, Vec3::X)]);
    // As `merge` leaves them: one point for what lies at one place.
    let mesh = &both.mesh;
    let places: Vec<Vec3> = mesh.positions.clone();
    let points = places.iter().map(|p| kiln_asset::PointId(places.iter().position(|q| q == p).unwrap_or(0) as u32));
    let mut number = std::collections::BTreeMap::new();
    let points: Vec<_> = points
        .map(|p| {
            let next = number.len() as u32;
            kiln_asset::PointId(*number.entry(p.0).or_insert(next))
        })
        .collect();
    let raw = RawMesh {
        positions: places,
        points,
        triangles: mesh.triangles.clone(),
        face_submesh: mesh.face_submesh.clone(),
        submeshes: mesh.submeshes.clone(),
        ..RawMesh::default()
    };
    both = level(Mesh::new(raw).expect("valid"));
    assert_eq!(both.mesh.point_count(), 45);
    assert_eq!(laid(&both, &spread(1, 128, 4)).2.charts, 1);
    let (new, layout, report) = laid(&both, &spread(2, 128, 4));
    assert_eq!((layout.sheets, report.charts), (2, 2));
    assert_eq!(sheet_of(&new.mesh), [Some(0), Some(1)]);
    // On one sheet, too, where their densities differ.
    let dense = AtlasOptions { densities: vec![1.0, 2.0], ..options(256, 4) };
    let (new, layout, report) = laid(&both, &dense);
    assert_eq!((layout.sheets, report.charts), (1, 2));
    let got = check(&new.mesh, &layout).expect("sound").of_submesh;
    assert!((got[1] / got[0] - 2.0).abs() < 0.04, "{got:?}");
}

#[test]
fn degenerate_faces_lie_on_their_submeshs_sheet() {
    let mut parts =
        vec![Shape::sphere(12, 6).scaled(1.01, Vec3::ZERO), Shape::sphere(12, 6).scaled(1.0, Vec3::X * 3.0)];
    for part in &mut parts {
        part.triangles.extend([[0, 1, 1], [20, 20, 20]]);
    }
    // A submesh without any area.
    parts.push(Shape { positions: vec![Vec3::ZERO, Vec3::X], triangles: vec![[0, 1, 1]] });
    let (new, layout, _) = laid(&Shape::submeshes(&parts), &spread(3, 128, 4));
    assert_eq!(layout.sheets, 2);
    assert_eq!(sheet_of(&new.mesh), [Some(0), Some(1), Some(0)]);
}

#[test]
fn without_padding_charts_still_keep_off_the_edge_between_sheets() {
    let (_, _, report) = laid(&spheres(3, |_| 1.0), &spread(3, 128, 0));
    assert!(report.edge_measured >= 1, "{report:?}");
}

#[test]
fn sheets_and_densities_out_of_range_are_errors() {
    let level = spheres(2, |_| 1.0);
    let fails = |options: &AtlasOptions| unwrap(&level, options, &Planar).expect_err("out of range");
    assert_eq!(fails(&spread(0, 256, 4)), AtlasError::Sheets { sheets: 0, size: 256 });
    assert_eq!(fails(&spread(65, 256, 4)), AtlasError::Sheets { sheets: 65, size: 256 });
    let error = fails(&spread(17, 4096, 4));
    assert!(error.to_string().contains("1 to 16 of that size"), "{error}");
    let dense = |densities: &[f32]| AtlasOptions { densities: densities.to_vec(), ..options(256, 4) };
    assert_eq!(fails(&dense(&[1.0])), AtlasError::Densities { found: 1, submeshes: 2 });
    assert_eq!(fails(&dense(&[1.0, 17.0])), AtlasError::Density { factor: 17.0 });
    assert!(matches!(fails(&dense(&[1.0, f32::NAN])), AtlasError::Density { .. }));
}

#[test]
fn the_check_finds_a_submesh_on_two_sheets_and_a_chart_on_the_edge_between_them() {
    let square = |x: f32| [[0.0, 0.5], [0.25, 0.25], [0.0, 0.25]].map(|[u, v]| Vec2::new(x + u, v));
    let atlas = |first: f32, second: f32| {
        let mut raw = Shape {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::Z + Vec3::X, Vec3::Z + Vec3::Y],
            triangles: vec![[0, 1, 2], [3, 4, 5]],
        }
        .raw();
        raw.atlas_uv = Some([square(first), square(second)].concat());
        check(&Mesh::new(raw).expect("valid"), &UvLayout { size: 128, padding: 0, chart_count: 0, sheets: 2 })
    };
    assert_eq!(atlas(0.5, 1.5).expect_err("one submesh"), [AtlasDefect::Scattered(vec![FaceId(1)])]);
    assert_eq!(atlas(1.0, 1.5).expect_err("at the edge"), [AtlasDefect::Edge { expected: 1, found: 0 }]);
    assert_eq!(atlas(1.1, 1.5).expect("sound").charts, 2);
}

/// Spheres of one size with these factors, and what each got in texels per unit.
fn densities(factors: &[f32], sheets: u32, choice: UnwrapperChoice, unwrapper: &dyn Unwrapper) -> Vec<f64> {
    let level = spheres(factors.len() as u32, |_| 1.0);
    let options = AtlasOptions { densities: factors.to_vec(), unwrapper: choice, sheets, ..options(512, 4) };
    let (new, layout, report) = unwrap(&level, &options, unwrapper).expect("unwraps");
    assert!(report.failed.is_empty() && report.uneven.is_empty(), "{report:?}");
    check(&new.mesh, &layout).expect("sound").of_submesh
}

fn assert_proportional(factors: &[f32], got: &[f64]) {
    let one = got.iter().zip(factors).map(|(d, f)| d / f64::from(*f)).sum::<f64>() / got.len() as f64;
    for (d, f) in got.iter().zip(factors) {
        let ratio = d / (one * f64::from(*f));
        assert!((ratio - 1.0).abs() < 0.02, "factors {factors:?} gave {got:?}");
    }
}

#[test]
fn texels_per_unit_follow_the_factors_within_two_percent() {
    let lists: [&[f32]; 4] = [&[1.0, 2.0], &[1.0, 1.0, 0.5, 3.0], &[0.0625, 1.0], &[4.0, 4.0]];
    for factors in lists {
        for sheets in [1, 2] {
            assert_proportional(factors, &densities(factors, sheets, UnwrapperChoice::Uvunwrap, &Uvunwrap::STANDARD));
            assert_proportional(factors, &densities(factors, sheets, UnwrapperChoice::Uvunwrap, &Uvunwrap::STRICT));
            assert_proportional(factors, &densities(factors, sheets, UnwrapperChoice::Planar, &Planar));
        }
    }
}

#[test]
fn xatlas_follows_factors_and_sheets_too() {
    let Some(program) = worker() else { return };
    let run = |request: &[u8]| {
        let cancel = std::sync::atomic::AtomicBool::new(false);
        kiln_xatlas::spawn::run_worker(&program, request, &Default::default(), &cancel)
            .map_err(|e| UnwrapError::Worker(e.to_string()))
    };
    let xatlas = xatlas::Xatlas::new(&run);
    for sheets in [1, 2] {
        let factors = [1.0, 2.0, 0.5];
        assert_proportional(&factors, &densities(&factors, sheets, UnwrapperChoice::Xatlas, &xatlas));
    }
}

#[test]
fn several_sheets_are_the_same_on_one_thread_and_four() {
    let level = spheres(4, |i| 1.0 + 0.2 * i as f32);
    let options = AtlasOptions { densities: vec![1.0, 2.0, 1.0, 0.5], ..spread(3, 256, 4) };
    let bytes = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| laid(&level, &options).0.mesh.to_blob())
    };
    assert!(bytes(1) == bytes(4));
}
