mod hostile;
mod mips;
mod sheets;
mod watched;

use glam::{Quat, Vec2, Vec3};
use kiln_asset::{FaceId, Level, Mesh, QuadricCoefficients, RawMesh, Submesh, SubmeshId, UvLayout};

use super::*;

/// A small indexed surface to build on.
#[derive(Clone, Default)]
struct Shape {
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// `columns x rows` quads over the unit square, mapped by `place`. Rows or columns that fall on one place are welded by
    /// `Mesh::new`, which needs them bitwise equal.
    fn grid(columns: u32, rows: u32, place: impl Fn(f32, f32) -> Vec3) -> Shape {
        let mut shape = Shape::default();
        for y in 0..=rows {
            for x in 0..=columns {
                shape.positions.push(place(x as f32 / columns as f32, y as f32 / rows as f32));
            }
        }
        let vertex = |x, y| y * (columns + 1) + x;
        for (x, y) in (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))) {
            let [a, b, c, d] = [vertex(x, y), vertex(x + 1, y), vertex(x + 1, y + 1), vertex(x, y + 1)];
            shape.triangles.extend([[a, b, c], [a, c, d]]);
        }
        shape
    }

    /// The point on the unit circle after `turns`, closed bit for bit.
    fn circle(turns: f32) -> Vec2 {
        let angle = (turns % 1.0) * std::f32::consts::TAU;
        Vec2::new(kiln_geom::math::cos(angle), kiln_geom::math::sin(angle))
    }

    fn sphere(columns: u32, rows: u32) -> Shape {
        Shape::grid(columns, rows, |u, v| {
            let ring = if v == 0.0 || v == 1.0 { 0.0 } else { kiln_geom::math::sin(v * std::f32::consts::PI) };
            let around = Shape::circle(u) * ring;
            Vec3::new(around.x, -kiln_geom::math::cos(v * std::f32::consts::PI), -around.y)
        })
    }

    fn open_cylinder() -> Shape {
        Shape::grid(32, 4, |u, v| Shape::circle(u).extend(2.0 * v))
    }

    fn cone() -> Shape {
        Shape::grid(32, 6, |u, v| (Shape::circle(u) * (1.0 - v)).extend(2.0 * v))
    }

    fn moebius() -> Shape {
        Shape::grid(48, 2, |u, v| {
            let (middle, half) = (Shape::circle(u) * 2.0, Shape::circle(0.5 * u));
            // The last column is the first one upside down; snapped so that it closes bit for bit.
            let place = middle.extend(0.0) + (v - 0.5) * (half.x * middle.normalize()).extend(half.y);
            (place * 4096.0).round() / 4096.0
        })
    }

    fn cube() -> Shape {
        let corner = |i: u32| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2 & 1) as f32);
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        Shape {
            positions: (0..8).map(corner).collect(),
            triangles: quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect(),
        }
    }

    /// `blades` half-discs that share one axis.
    fn book(blades: u32) -> Shape {
        let mut shape = Shape { positions: vec![Vec3::ZERO, Vec3::Z], triangles: Vec::new() };
        for i in 0..blades {
            let out = Shape::circle(i as f32 / blades as f32);
            let base = shape.positions.len() as u32;
            shape.positions.extend([out.extend(0.0), out.extend(1.0)]);
            shape.triangles.extend([[0, base, base + 1], [0, base + 1, 1]]);
        }
        shape
    }

    /// Small quads of many sizes in all directions, each twice, back to back: both sides of a leaf at the same places.
    fn leaves(count: u32) -> Shape {
        let mut shape = Shape::default();
        for i in 0..count {
            let turn = Quat::from_rotation_y(i as f32 * 0.7) * Quat::from_rotation_x(i as f32 * 0.3);
            let middle = Vec3::new((i % 20) as f32, (i / 20 % 20) as f32, (i / 400) as f32);
            let size = 0.1 + 0.02 * (i % 7) as f32;
            let base = shape.positions.len() as u32;
            for _ in 0..2 {
                for corner in [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y] {
                    shape.positions.push(middle + turn * corner * size);
                }
            }
            let [a, b] = [base, base + 4];
            shape.triangles.extend([[a, a + 1, a + 2], [a, a + 2, a + 3], [b, b + 2, b + 1], [b, b + 3, b + 2]]);
        }
        shape
    }

    fn mirrored(&self) -> Shape {
        Shape {
            positions: self.positions.iter().map(|p| *p * Vec3::new(-1.0, 1.0, 1.0) - Vec3::X * 3.0).collect(),
            triangles: self.triangles.iter().map(|[a, b, c]| [*a, *c, *b]).collect(),
        }
    }

    fn and(mut self, other: Shape) -> Shape {
        let base = self.positions.len() as u32;
        self.positions.extend(other.positions);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + base)));
        self
    }

    /// `shapes`, each a submesh named after its place, none sharing a point with another unless places are equal.
    fn submeshes(shapes: &[Shape]) -> Level {
        let mut raw = RawMesh::default();
        for (i, shape) in (0u32..).zip(shapes) {
            let base = raw.positions.len() as u32;
            raw.positions.extend(&shape.positions);
            raw.triangles.extend(shape.triangles.iter().map(|t| t.map(|v| v + base)));
            raw.face_submesh.extend(shape.triangles.iter().map(|_| SubmeshId(i)));
            raw.submeshes.push(Submesh { name: format!("part{i}"), ..Default::default() });
        }
        level(Mesh::new(raw).expect("valid"))
    }

    fn scaled(&self, scale: f32, to: Vec3) -> Shape {
        Shape { positions: self.positions.iter().map(|p| *p * scale + to).collect(), ..self.clone() }
    }

    fn raw(self) -> RawMesh {
        RawMesh {
            face_submesh: vec![SubmeshId(0); self.triangles.len()],
            positions: self.positions,
            triangles: self.triangles,
            submeshes: vec![Submesh { name: "shape".into(), ..Default::default() }],
            ..Default::default()
        }
    }

    fn level(self) -> Level {
        level(Mesh::new(self.raw()).expect("valid"))
    }
}

fn level(mesh: Mesh) -> Level {
    let quadrics: Vec<QuadricCoefficients> = (0..mesh.point_count()).map(|p| [p as f64; 11]).collect();
    Level { mesh, error: 0.25, quadrics }
}

fn options(size: u32, padding: u32) -> AtlasOptions {
    AtlasOptions { size, padding, ..AtlasOptions::default() }
}

/// Unwraps, and checks what must be as it was.
fn unwrapped(level: &Level, options: &AtlasOptions) -> (Level, AtlasReport) {
    let (new, layout, report) = unwrap(level, options, &Uvunwrap::STANDARD).expect("unwraps");
    assert_untouched(level, &new);
    assert_eq!(
        layout,
        UvLayout { size: options.size, padding: options.padding, chart_count: report.charts, sheets: 1 }
    );
    check(&new.mesh, &layout).expect("what `unwrap` returned passes the check");
    (new, report)
}

fn assert_untouched(old: &Level, new: &Level) {
    assert_eq!((new.error, &new.quadrics), (old.error, &old.quadrics));
    assert_eq!(new.mesh.face_submesh, old.mesh.face_submesh);
    assert_eq!(new.mesh.point_count(), old.mesh.point_count());
    assert_eq!(new.mesh.face_count(), old.mesh.face_count());
    for f in (0..old.mesh.face_count() as u32).map(FaceId) {
        assert_eq!(new.mesh.face_points(f), old.mesh.face_points(f));
        assert_eq!(new.mesh.face_positions(f), old.mesh.face_positions(f));
    }
}

#[test]
fn a_cube_without_normals_gets_at_most_six_square_charts_at_one_scale() {
    let (_, report) = unwrapped(&Shape::cube().level(), &options(256, 8));
    assert_eq!(report.unwrapper, "uvunwrap");
    assert!((2..=6).contains(&report.charts), "{report:?}");
    assert!(report.stretch < 1.001 && report.anisotropy < 1.001, "a cube unfolds without stretch: {report:?}");
    assert!(report.coverage > 0.4, "{report:?}");
}

#[test]
fn a_cube_with_flat_normals_and_shared_points_is_cut_along_its_edges_only_where_normals_are_not_all_hard() {
    // 12 of 18 inner edges are hard: more than half, so that geometry alone decides.
    let cube = Shape::cube();
    let mut raw = RawMesh { submeshes: vec![Submesh::default()], ..Default::default() };
    let mut normals = Vec::new();
    for t in &cube.triangles {
        let [a, b, c] = t.map(|v| cube.positions[v as usize]);
        let base = raw.positions.len() as u32;
        raw.positions.extend([a, b, c]);
        normals.extend([(b - a).cross(c - a).normalize(); 3]);
        raw.triangles.push([base, base + 1, base + 2]);
        raw.face_submesh.push(SubmeshId(0));
    }
    raw.normals = Some(normals);
    let (_, report) = unwrapped(&level(Mesh::new(raw).expect("valid")), &options(256, 4));
    assert_eq!(report.hard_edges, 0);
}

#[test]
fn a_hard_ridge_on_a_smooth_sheet_is_a_chart_border() {
    // A bent strip that would be one chart: 20 columns, bent by 40 degrees in the middle.
    let shape = Shape::grid(20, 20, |u, v| Vec3::new(u, v, 0.36 * (0.5 - (u - 0.5).abs())));
    let soft = shape.clone().level();
    let (_, report) = unwrapped(&soft, &options(256, 4));
    assert_eq!((report.charts, report.hard_edges), (1, 0));

    let mut raw = RawMesh { submeshes: vec![Submesh::default()], ..Default::default() };
    let mut normals = Vec::new();
    for t in &shape.triangles {
        let [a, b, c] = t.map(|v| shape.positions[v as usize]);
        let base = raw.positions.len() as u32;
        raw.positions.extend([a, b, c]);
        normals.extend([(b - a).cross(c - a).normalize(); 3]);
        raw.triangles.push([base, base + 1, base + 2]);
        raw.face_submesh.push(SubmeshId(0));
    }
    raw.normals = Some(normals);
    let (_, report) = unwrapped(&level(Mesh::new(raw).expect("valid")), &options(256, 4));
    assert_eq!((report.charts, report.hard_edges), (2, 20));
}

#[test]
fn curved_shapes_unwrap_with_little_stretch() {
    for (name, shape, stretch) in [
        ("sphere", Shape::sphere(32, 16), 1.3),
        ("open cylinder", Shape::open_cylinder(), 1.01),
        ("cone", Shape::cone(), 1.1),
        ("Möbius strip", Shape::moebius(), 1.2),
    ] {
        let (_, report) = unwrapped(&shape.level(), &options(512, 8));
        assert_eq!(report.unwrapper, "uvunwrap", "{name}");
        assert!(report.stretch < stretch, "{name}: {report:?}");
        assert!(report.coverage > 0.3, "{name}: {report:?}");
        assert!(report.padding_measured.is_none_or(|p| p >= 8), "{name}: {report:?}");
    }
}

#[test]
fn blades_that_share_an_axis_do_not_overlap() {
    let (_, report) = unwrapped(&Shape::book(7).level(), &options(256, 4));
    assert_eq!(report.charts, 7, "an edge of seven faces joins no two of them");
}

#[test]
fn disjoint_and_mirrored_parts_all_wind_the_same_way() {
    let part = Shape::sphere(16, 8);
    let (new, _) = unwrapped(&part.clone().and(part.mirrored()).level(), &options(512, 8));
    let uvs = new.mesh.atlas_uv.as_ref().expect("made");
    for t in &new.mesh.triangles {
        let [a, b, c] = t.map(|v| uvs[v as usize]);
        // The faces at the poles have no area.
        assert!((b - a).perp_dot(c - a) <= 0.0, "counter-clockwise in a picture whose v runs downwards");
    }
}

#[test]
fn both_sides_of_two_thousand_leaves_get_a_chart_each() {
    // Both sides lie on the same points: four faces meet at every diagonal.
    let (_, report) = unwrapped(&Shape::leaves(2000).level(), &options(2048, 4));
    assert_eq!(report.charts, 4000, "{report:?}");
    assert!(report.coverage > 0.3, "{report:?}");
}

#[test]
fn charts_too_many_for_the_sheet_are_an_error_that_says_what_to_change() {
    let error = unwrap(&Shape::leaves(500).level(), &options(64, 8), &Uvunwrap::STANDARD).expect_err("1000 charts");
    let AtlasError::Failed { attempts } = &error else { panic!("{error}") };
    assert!(attempts.iter().all(|a| a.does_not_fit), "{error}");
    assert!(error.to_string().contains("larger size or a smaller padding"), "{error}");
}

#[test]
fn degenerate_faces_stay_and_cover_nothing() {
    let mut shape = Shape::grid(4, 4, |u, v| Vec3::new(u, v, 0.0));
    // Two corners at one place; three places on a line; a face far away that is a mere point.
    shape.triangles.extend([[0, 1, 1], [0, 2, 4]]);
    shape.positions.push(Vec3::new(0.5, 0.5, 1.0));
    shape.triangles.push([25, 25, 25]);
    let (new, report) = unwrapped(&shape.level(), &options(128, 2));
    assert_eq!((report.degenerate_faces, report.charts), (3, 1));
    let uvs = new.mesh.atlas_uv.as_ref().expect("made");
    for t in &new.mesh.triangles[32..] {
        let [a, b, c] = t.map(|v| uvs[v as usize]);
        assert!(a == b && b == c);
    }
}

#[test]
fn a_mesh_without_any_area_is_an_error() {
    let shape = Shape { positions: vec![Vec3::ZERO, Vec3::X], triangles: vec![[0, 1, 1]] };
    let result = unwrap(&shape.level(), &options(128, 2), &Uvunwrap::STANDARD);
    assert!(matches!(result, Err(AtlasError::Empty { faces: 1, degenerate: 1 })), "{result:?}");
    let result = unwrap(&Level::default(), &options(128, 2), &Uvunwrap::STANDARD);
    assert!(matches!(result, Err(AtlasError::Empty { faces: 0, .. })), "{result:?}");
}

#[test]
fn options_out_of_range_are_errors() {
    let cube = Shape::cube().level();
    assert_eq!(unwrap(&cube, &options(8, 1), &Planar).expect_err("small"), AtlasError::Size { size: 8 });
    assert_eq!(unwrap(&cube, &options(99999, 1), &Planar).expect_err("large"), AtlasError::Size { size: 99999 });
    let padding = AtlasError::Padding { padding: 65, size: 256 };
    assert_eq!(unwrap(&cube, &options(256, 65), &Planar).expect_err("wide"), padding);
}

#[test]
fn charts_cross_the_boundary_of_merged_submeshes_and_wedges_stay_apart() {
    // A flat strip of two submeshes whose boundary points are shared, as `merge` leaves them.
    let shape = Shape::grid(2, 1, |u, v| Vec3::new(u, v, 0.0));
    let mut raw = RawMesh { submeshes: vec![Submesh::default(); 2], ..Default::default() };
    for (i, t) in [shape.triangles[0], shape.triangles[1], shape.triangles[2], shape.triangles[3]].iter().enumerate() {
        let base = raw.positions.len() as u32;
        raw.positions.extend(t.map(|v| shape.positions[v as usize]));
        raw.points.extend(t.map(kiln_asset::PointId));
        raw.triangles.push([base, base + 1, base + 2]);
        raw.face_submesh.push(SubmeshId(i as u32 / 2));
    }
    let (new, report) = unwrapped(&level(Mesh::new(raw).expect("valid")), &options(128, 4));
    assert_eq!(report.charts, 1);
    assert_eq!(new.mesh.vertex_count(), 12, "no wedge is split: the chart is one");
}

#[test]
fn scale_and_place_do_not_change_the_layout() {
    let shape = Shape::sphere(16, 8);
    let (_, small) = unwrapped(&shape.clone().level(), &options(256, 4));
    let mut large = shape;
    large.positions.iter_mut().for_each(|p| *p *= 1024.0);
    let (_, large) = unwrapped(&large.level(), &options(256, 4));
    assert_eq!((small.charts, small.coverage), (large.charts, large.coverage));
    assert!((small.texels_per_unit / large.texels_per_unit / 1024.0 - 1.0).abs() < 1e-5);
}

#[test]
fn every_size_is_kept_exactly_and_every_padding_is_found_again() {
    let level = Shape::sphere(24, 12).level();
    for (size, padding) in [(16, 0), (64, 1), (100, 3), (333, 7), (512, 32), (1024, 16)] {
        let (new, report) = unwrapped(&level, &options(size, padding));
        let uvs = new.mesh.atlas_uv.as_ref().expect("made");
        assert!(uvs.iter().all(|uv| uv.min_element() >= 0.0 && uv.max_element() <= 1.0));
        assert!(report.padding_measured.is_none_or(|p| p >= padding), "{size} {padding}: {report:?}");
        assert!(report.edge_measured >= padding / 2, "{size} {padding}: {report:?}");
        let widest = uvs.iter().map(|uv| uv.x).fold(0.0, f32::max) * size as f32;
        assert!(widest > 0.6 * (size - padding) as f32, "{size} {padding}: the sheet is used: {widest}");
    }
}

#[test]
fn one_thread_and_four_give_the_same_bytes() {
    let level = Shape::sphere(48, 24).and(Shape::open_cylinder().mirrored()).level();
    let bytes = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| unwrapped(&level, &options(512, 8)).0.mesh.to_blob())
    };
    assert!(bytes(1) == bytes(4));
}

#[test]
fn planar_charts_pass_the_check_on_every_shape() {
    for (name, shape) in [
        ("cube", Shape::cube()),
        ("sphere", Shape::sphere(32, 16)),
        ("cone", Shape::cone()),
        ("Möbius strip", Shape::moebius()),
        ("book", Shape::book(9)),
        ("leaves", Shape::leaves(100)),
        // A ramp that winds three times about its axis: flat enough for one cluster, and it covers itself.
        ("ramp", Shape::grid(90, 2, |u, v| (Shape::circle(3.0 * u) * (1.0 + v)).extend(0.9 * u))),
    ] {
        let level = shape.level();
        let (new, layout, report) = unwrap(&level, &options(512, 4), &Planar).expect(name);
        assert_untouched(&level, &new);
        check(&new.mesh, &layout).expect(name);
        assert_eq!(report.unwrapper, "planar", "{name}: {report:?}");
        assert!(report.stretch < 1.2, "{name}: {report:?}");
    }
}

/// An unwrapper that gives a fixed answer.
struct Canned(fn(&UnwrapInput) -> Result<UnwrapOutput, UnwrapError>);

impl Unwrapper for Canned {
    fn name(&self) -> &str {
        "canned"
    }

    fn unwrap(&self, input: &UnwrapInput, _: &Watch<'_>) -> Result<UnwrapOutput, UnwrapError> {
        self.0(input)
    }
}

/// Every face in the same corner of the sheet.
fn all_in_one_place(input: &UnwrapInput) -> Result<UnwrapOutput, UnwrapError> {
    let face = [Vec2::new(20.0, 20.0), Vec2::new(20.0, 60.0), Vec2::new(60.0, 20.0)];
    let faces = input.triangles.len();
    Ok(UnwrapOutput { corners: vec![face; faces], charts: (0..faces as u32).collect() })
}

#[test]
fn auto_steps_down_the_ladder_when_a_check_fails_and_says_so() {
    let level = Shape::cube().level();
    let (_, _, report) = unwrap(&level, &options(256, 4), &Canned(all_in_one_place)).expect("next rung");
    assert_eq!(report.unwrapper, "uvunwrap-strict");
    assert_eq!(report.failed.len(), 1);
    assert!(report.failed[0].reason.contains("overlap"), "{report:?}");

    let unplaced = Canned(|input| {
        let mut output = all_in_one_place(input)?;
        output.charts[3] = UnwrapOutput::UNPLACED;
        Ok(output)
    });
    let (_, _, report) = unwrap(&level, &options(256, 4), &unplaced).expect("next rung");
    assert!(report.failed[0].reason.contains("not placed"), "{report:?}");
}

#[test]
fn an_unwrapper_that_was_asked_for_by_name_is_not_replaced() {
    let xatlas = AtlasOptions { unwrapper: UnwrapperChoice::Xatlas, ..options(256, 4) };
    let error = unwrap(&Shape::cube().level(), &xatlas, &Canned(all_in_one_place)).expect_err("overlaps");
    assert!(error.to_string().contains("unwrapper = \"auto\""), "{error}");
    let hostile = Canned(|_| Ok(UnwrapOutput { corners: vec![[Vec2::NAN; 3]; 2], charts: vec![0, 7] }));
    assert!(matches!(unwrap(&Shape::cube().level(), &xatlas, &hostile), Err(AtlasError::Failed { .. })));
}

/// A sheet of 128 texels with padding 4 and two triangles; `uvs` in texels.
fn two_triangles(uvs: [Vec2; 6]) -> Result<Measure, Vec<AtlasDefect>> {
    let mut raw = Shape {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::Z + Vec3::X, Vec3::Z + Vec3::Y],
        triangles: vec![[0, 1, 2], [3, 4, 5]],
    }
    .raw();
    raw.atlas_uv = Some(uvs.iter().map(|uv| *uv / 128.0).collect());
    check(&Mesh::new(raw).expect("valid"), &UvLayout { size: 128, padding: 4, chart_count: 0, sheets: 1 })
}

/// Right-angled, 40 texels a side, counter-clockwise in the picture, its right angle at `(x, y)`.
fn right_angle(x: f32, y: f32) -> [Vec2; 3] {
    [Vec2::new(x, y), Vec2::new(x + 40.0, y), Vec2::new(x, y - 40.0)]
}

fn pair(a: [Vec2; 3], b: [Vec2; 3]) -> Result<Measure, Vec<AtlasDefect>> {
    two_triangles([a[0], a[1], a[2], b[0], b[1], b[2]])
}

#[test]
fn the_check_measures_padding_and_edge_in_whole_empty_texels() {
    // The first spans columns 8 to 47, the second begins at column 56: eight are empty.
    let measure = pair(right_angle(8.0, 48.0), right_angle(56.0, 48.0)).expect("apart");
    assert_eq!((measure.charts, measure.padding, measure.edge), (2, Some(8), 8));
    // Starting inside column 56 changes nothing.
    let measure = pair(right_angle(8.0, 48.0), right_angle(56.9, 48.0)).expect("apart");
    assert_eq!(measure.padding, Some(8));
    // Odd gaps are counted too.
    let measure = pair(right_angle(8.0, 48.0), right_angle(55.0, 48.0)).expect("apart");
    assert_eq!(measure.padding, Some(7));
}

#[test]
fn the_check_finds_a_padding_that_is_one_texel_short() {
    let defects = pair(right_angle(8.0, 48.0), right_angle(51.0, 48.0)).expect_err("three of four texels");
    assert_eq!(defects, [AtlasDefect::Padding { expected: 4, found: 3 }]);
    let defects = pair(right_angle(8.0, 48.0), right_angle(48.0, 48.0)).expect_err("they touch");
    assert_eq!(defects, [AtlasDefect::Padding { expected: 4, found: 0 }]);
}

#[test]
fn the_check_finds_a_chart_too_near_the_edge() {
    let defects = pair(right_angle(1.0, 48.0), right_angle(56.0, 48.0)).expect_err("one of two texels");
    assert_eq!(defects, [AtlasDefect::Edge { expected: 2, found: 1 }]);
}

#[test]
fn the_check_finds_an_overlap_that_no_texel_centre_sees() {
    // Two slivers of a tenth of a texel that cross between texel centres.
    let flat = [Vec2::new(20.0, 30.2), Vec2::new(60.0, 30.2), Vec2::new(60.0, 30.1)];
    let upright = [Vec2::new(40.2, 50.0), Vec2::new(40.2, 10.0), Vec2::new(40.1, 10.0)];
    let defects = pair(flat, upright).expect_err("they cross");
    assert!(defects.contains(&AtlasDefect::Overlap(vec![(FaceId(0), FaceId(1))])), "{defects:?}");
}

#[test]
fn the_check_finds_a_face_inside_another() {
    let small = right_angle(10.0, 46.0).map(|p| Vec2::new(10.0, 46.0) + (p - Vec2::new(10.0, 46.0)) * 0.1);
    let defects = pair(right_angle(8.0, 48.0), small).expect_err("one covers the other");
    assert!(defects.contains(&AtlasDefect::Overlap(vec![(FaceId(0), FaceId(1))])), "{defects:?}");
}

#[test]
fn the_check_finds_mirrored_outside_and_collapsed_faces() {
    let [a, b, c] = right_angle(8.0, 48.0);
    let defects = pair([a, c, b], right_angle(56.0, 48.0)).expect_err("mirrored");
    assert_eq!(defects, [AtlasDefect::Mirrored(vec![FaceId(0)])]);
    let defects = pair([a, b, c], right_angle(100.0, 48.0)).expect_err("beyond the right edge");
    assert_eq!(defects, [AtlasDefect::Outside(vec![FaceId(1)])]);
    let defects = pair([a, b, b], right_angle(56.0, 48.0)).expect_err("a line");
    assert_eq!(defects, [AtlasDefect::Collapsed(vec![FaceId(0)])]);
}

#[test]
fn a_mesh_without_an_atlas_fails_the_check() {
    let mesh = Shape::cube().level().mesh;
    let layout = UvLayout { size: 128, padding: 4, chart_count: 0, sheets: 1 };
    assert_eq!(check(&mesh, &layout), Err(vec![AtlasDefect::NoUvs]));
}

#[test]
fn a_scanned_animal_unwraps_without_a_second_try() {
    let Some(corpus) = std::env::var_os("KILN_CORPUS") else {
        let required = std::env::var_os("KILN_REQUIRE_ALL").is_some_and(|v| v == "1");
        assert!(!required, "KILN_REQUIRE_ALL is set, but KILN_CORPUS is not");
        eprintln!("skipped: needs KILN_CORPUS");
        return;
    };
    let folder = kiln_asset::import::Folder(std::path::Path::new(&corpus).join("gltf"));
    let (asset, _) = kiln_asset::import::import(&folder, "Spot.glb", &Default::default()).expect("Spot.glb");
    let (_, report) = unwrapped(&level(asset.mesh), &options(1024, 8));
    assert_eq!(report.unwrapper, "uvunwrap");
    assert!(report.charts < 100 && report.stretch < 1.2 && report.coverage > 0.5, "{report:?}");
}

/// The worker program, or `None` after saying so.
fn worker() -> Option<std::path::PathBuf> {
    let named = std::env::var_os("KILN_XATLAS").map(std::path::PathBuf::from);
    // Test programs lie one folder below the programs of their profile.
    let beside = std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.parent()?.join("kiln-xatlas")));
    let found = named.or(beside).filter(|path| path.is_file());
    if found.is_none() {
        let required = std::env::var_os("KILN_REQUIRE_ALL").is_some_and(|v| v == "1");
        assert!(!required, "KILN_REQUIRE_ALL is set, but kiln-xatlas is not built");
        eprintln!("skipped: needs kiln-xatlas (libclang)");
    }
    found
}

#[test]
fn xatlas_unwraps_in_its_worker_at_the_size_asked_with_one_winding() {
    let Some(program) = worker() else { return };
    let run = |request: &[u8]| {
        let cancel = std::sync::atomic::AtomicBool::new(false);
        kiln_xatlas::spawn::run_worker(&program, request, &Default::default(), &cancel)
            .map_err(|e| UnwrapError::Worker(e.to_string()))
    };
    let xatlas = xatlas::Xatlas::new(&run);
    for (name, shape) in [
        ("cube", Shape::cube()),
        ("sphere", Shape::sphere(48, 24)),
        ("cylinder and its mirror image", Shape::open_cylinder().and(Shape::open_cylinder().mirrored())),
        ("leaves", Shape::leaves(60)),
    ] {
        for (size, padding) in [(512, 8), (300, 3)] {
            let level = shape.clone().level();
            let options = AtlasOptions { unwrapper: UnwrapperChoice::Xatlas, ..options(size, padding) };
            let (new, layout, report) = unwrap(&level, &options, &xatlas).expect(name);
            assert_untouched(&level, &new);
            check(&new.mesh, &layout).expect(name);
            assert_eq!(report.unwrapper, "xatlas");
            assert!(report.coverage > 0.25 && report.stretch < 1.5, "{name}: {report:?}");
            let (again, ..) = unwrap(&level, &options, &xatlas).expect(name);
            assert!(again == new, "{name}: same bytes twice");
        }
    }
}

#[test]
fn a_worker_that_fails_or_sends_rubbish_is_an_error_of_the_stage() {
    let options = AtlasOptions { unwrapper: UnwrapperChoice::Xatlas, ..options(256, 4) };
    let fail = |_: &[u8]| Err(UnwrapError::Worker("killed after 10 s".into()));
    let error = unwrap(&Shape::cube().level(), &options, &xatlas::Xatlas::new(&fail)).expect_err("no reply");
    assert!(error.to_string().contains("xatlas: killed after 10 s"), "{error}");
    let rubbish = |_: &[u8]| Ok(b"KXRPrubbish".to_vec());
    assert!(unwrap(&Shape::cube().level(), &options, &xatlas::Xatlas::new(&rubbish)).is_err());
}

#[test]
fn charts_of_xatlas_that_cover_themselves_are_divided_and_asked_for_again() {
    // A worker that lays the second triangle of a quad on the first as long as both are one group.
    let quad = Shape::grid(1, 1, |u, v| Vec3::new(u, v, 0.0)).level();
    let rounds = std::cell::Cell::new(0);
    let fold = |request: &[u8]| {
        rounds.set(rounds.get() + 1);
        let groups = kiln_xatlas::protocol::Request::decode(request).expect("sound").groups;
        let apart = groups[0] != groups[1];
        let second = if apart { right_angle(70.0, 60.0) } else { right_angle(25.0, 60.0) };
        let corners = [right_angle(20.0, 60.0), second].map(|c| c.map(|uv| uv.to_array())).to_vec();
        Ok(kiln_xatlas::protocol::Reply::Placed { charts: vec![0, u32::from(apart)], corners }.encode())
    };
    let options = AtlasOptions { unwrapper: UnwrapperChoice::Xatlas, ..options(128, 4) };
    let (_, _, report) = unwrap(&quad, &options, &xatlas::Xatlas::new(&fold)).expect("mended");
    assert_eq!((rounds.get(), report.charts), (2, 2));
}
