use glam::Vec3;
use kiln_asset::{ImageFormat, ImageInfo, Material, MaterialId, RawMesh, Sampler, Texture, TextureId, TextureRef};
use proptest::prelude::*;

use super::*;
use crate::fixtures;
use crate::simplify::collapse::Collapser;
use crate::simplify::metric::bordered::Bordered;
use crate::simplify::metric::quadric::Forms;
use crate::simplify::rest::{MetricRest, Rest};
use crate::simplify::{
    CollapseSequence, Conditions, MetricKind, Placement, QuadricRest, SimplifyOptions, collapse, collapse_under, cut,
    regions,
};
use crate::topology::Topology;

fn bordered(mesh: &Mesh, borders: &TextureBorders, options: &SimplifyOptions) -> CollapseSequence {
    collapse_under(mesh, &[], None, options, &Conditions { borders: Some(borders), ..Conditions::default() })
}

/// One material that reads picture 0 as base colour in UV set 0, and picture 1 as normals in UV set 1.
fn materials() -> MaterialSet {
    let image = |name: &str| ImageInfo { name: name.into(), format: ImageFormat::Png, hash: [0; 32] };
    let sampler = Sampler { wrap_u: Wrap::ClampToEdge, wrap_v: Wrap::ClampToEdge, ..Sampler::default() };
    let map = |k: u32| Some(TextureRef { texture: TextureId(k), uv_set: k });
    MaterialSet {
        materials: vec![
            Material { base_color: map(0), normal: map(1), ..Material::default() },
            Material { name: "bare".into(), ..Material::default() },
        ],
        textures: [0, 1].map(|k| Texture { image: ImageId(k), sampler }).into(),
        images: vec![image("paint"), image("bumps")],
        ..MaterialSet::default()
    }
}

fn painted(size: u32, code: impl Fn(u32, u32) -> u8) -> Arc<Raster> {
    let texel = |i: u32| [[code(i % size, i / size); 3].as_slice(), &[255]].concat();
    let texels = (0..size * size).map(|i| texel(i).try_into().unwrap()).collect();
    Arc::new(Raster { width: size, height: size, texels })
}

/// Bright right of `u`.
fn step_at(u: f32) -> Arc<Raster> {
    painted(64, |x, _| if (x as f32 + 0.5) / 64.0 < u { 20 } else { 220 })
}

/// The mesh with UV set 0 its x and y over their extent, UV set 1 the same turned by a quarter, and material 0.
fn with_uvs(mesh: Mesh) -> Mesh {
    let mut raw = mesh.into_raw();
    let extent = raw.positions.iter().fold(Vec3::ZERO, |most, p| most.max(*p));
    let uv = |p: &Vec3| Vec2::new(p.x / extent.x, p.y / extent.y);
    raw.uv0 = Some(raw.positions.iter().map(uv).collect());
    raw.uv1 = Some(raw.positions.iter().map(|p| Vec2::new(uv(p).y, uv(p).x)).collect());
    for submesh in &mut raw.submeshes {
        submesh.material = Some(MaterialId(0));
        (submesh.attributes.uv0, submesh.attributes.uv1) = (true, true);
    }
    Mesh::new(raw).unwrap()
}

fn borders_with(mesh: &Mesh, pictures: [Arc<Raster>; 2], options: &TextureBorderOptions) -> TextureBorders {
    TextureBorders::new(mesh, &materials(), &|image| Ok(Arc::clone(&pictures[image.index()])), options).unwrap()
}

fn borders_of(mesh: &Mesh, paint: &Arc<Raster>) -> TextureBorders {
    borders_with(mesh, [Arc::clone(paint), step_at(2.0)], &TextureBorderOptions::default())
}

/// Edges with one end in `x < cut` and one in `x > cut`.
fn edges_across(mesh: &Mesh, cut: f32) -> u32 {
    let mut edges: Vec<[u32; 2]> = mesh
        .triangles
        .iter()
        .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    edges.sort_unstable();
    edges.dedup();
    edges.retain(|e| (mesh.positions[e[0] as usize].x - cut) * (mesh.positions[e[1] as usize].x - cut) < 0.0);
    edges.len() as u32
}

#[test]
fn the_edges_over_a_painted_step_are_affected_and_no_others() {
    // Columns of the grid lie at whole x; the step lies at x = 8.5.
    let mesh = with_uvs(fixtures::grid(16, 6));
    let borders = borders_of(&mesh, &step_at(8.5 / 16.0));
    let report = borders.report(&mesh, &materials());
    assert_eq!((report.edges, report.affected), (16 * 7 + 17 * 6 + 16 * 6, 7 + 6));
    assert_eq!(report.affected, edges_across(&mesh, 8.5));
    let picture = &report.pictures[0];
    assert_eq!((picture.name.as_str(), picture.map.as_str(), picture.border_texels), ("paint", "base-color", 64));
    assert_eq!(picture.affected_segments, 13);
}

#[test]
fn several_maps_give_the_union_of_their_borders_each_in_its_own_uv_set() {
    let mesh = with_uvs(fixtures::grid(16, 6));
    let count = |maps: &[MapRole]| {
        let options = TextureBorderOptions { maps: maps.to_vec(), ..TextureBorderOptions::default() };
        borders_with(&mesh, [step_at(8.5 / 16.0), step_at(2.5 / 6.0)], &options).report(&mesh, &materials()).affected
    };
    let (paint, bumps) = (count(&[MapRole::BaseColor]), count(&[MapRole::Normal]));
    assert_eq!((paint, bumps), (13, 17 + 16));
    // The square of the grid where both steps cross: its diagonal crosses both.
    assert_eq!(count(&[MapRole::BaseColor, MapRole::Normal]), paint + bumps - 1);
    assert_eq!(count(&[MapRole::Emissive]), 0, "no such map");
}

#[test]
fn a_submesh_without_texture_or_without_its_uvs_has_no_border() {
    let textured = with_uvs(fixtures::grid(16, 6));
    let affected = |change: fn(&mut RawMesh)| {
        let mut raw = textured.clone().into_raw();
        change(&mut raw);
        let mesh = Mesh::new(raw).unwrap();
        borders_of(&mesh, &step_at(0.53)).report(&mesh, &materials()).affected
    };
    assert_eq!(affected(|_| {}), 13);
    assert_eq!(affected(|raw| raw.submeshes[0].material = Some(MaterialId(1))), 0);
    assert_eq!(affected(|raw| raw.submeshes[0].material = None), 0);
    assert_eq!(affected(|raw| raw.submeshes[0].attributes.uv0 = false), 0);
    assert_eq!(affected(|raw| (raw.uv0 = None, raw.submeshes[0].attributes.uv0 = false).0), 0);
}

#[test]
fn an_edge_on_a_seam_is_affected_if_either_side_crosses() {
    // Two quads side by side; the right one's UVs lie elsewhere, so the edge between them is a seam.
    let mut raw = with_uvs(fixtures::grid(2, 1)).into_raw();
    raw.points = (0..6).map(kiln_asset::PointId).collect();
    let (mut positions, mut uv0, mut uv1) = (raw.positions.clone(), raw.uv0.clone().unwrap(), raw.uv1.clone().unwrap());
    for v in [1, 4] {
        positions.push(raw.positions[v]);
        uv0.push(Vec2::new(0.9, uv0[v].y));
        uv1.push(uv1[v]);
        raw.points.push(kiln_asset::PointId(v as u32));
    }
    for triangle in &mut raw.triangles {
        if triangle.iter().any(|v| [2, 5].contains(v)) {
            *triangle = triangle.map(|v| match v {
                1 => 6,
                4 => 7,
                v => v,
            });
        }
    }
    (raw.positions, raw.uv0, raw.uv1) = (positions, Some(uv0), Some(uv1));
    let mesh = Mesh::new(raw).unwrap();
    // A lying step across u = 0.9 only: on the seam's right side.
    let paint = painted(64, |x, y| if x > 52 && y > 30 { 220 } else { 20 });
    let borders = borders_of(&mesh, &paint);
    let side = |a, b| borders.affected(SubmeshId(0), uv_sets(&mesh, a), uv_sets(&mesh, b));
    assert!(!side(1, 4) && side(6, 7));
    assert_eq!(
        borders.report(&mesh, &materials()).pictures[0].affected_segments,
        3,
        "both upright edges of the right quad and its diagonal"
    );
}

#[test]
fn the_surcharge_is_the_share_of_the_mesh_that_stands_on_the_edge() {
    let mesh = with_uvs(fixtures::grid(16, 6));
    let mut borders = borders_of(&mesh, &step_at(8.5 / 16.0));
    borders.weight = 3.0;
    borders.cost = BorderCost::Area;
    let surcharge = Surcharge::new(&borders, &mesh);
    // The diagonal of the quad from column 8 to 9 in the first row, and both its faces; then an edge beside the step.
    let star = |faces: [usize; 2], from: u32, to: u32| faces.map(|f| star_face(&mesh, f, from, to)).into_iter();
    let (base, diagonal, area) = (1e-6, f64::from(mesh.diagonal()), 96.0);
    let cost = surcharge.cost(&mesh, base, true, star([16, 17], 9, 25));
    let length = |cost: f64| cost.sqrt() * diagonal / (area / mesh.point_count() as f64).sqrt();
    assert!((length(cost) - (length(base) + 3.0 * 1.0 / area)).abs() < 1e-12);
    assert_eq!(surcharge.cost(&mesh, base, true, star([14, 15], 8, 24)), base, "its cost stays, bit for bit");
}

/// Face `f`, turned so that `from` comes first.
fn star_face(mesh: &Mesh, f: usize, from: u32, to: u32) -> StarFace {
    let triangle = mesh.triangles[f];
    let k = triangle.iter().position(|v| *v == from).unwrap();
    let wedges = [0, 1, 2].map(|i| triangle[(k + i) % 3]);
    StarFace {
        submesh: SubmeshId(0),
        wedges,
        places: wedges.map(|v| mesh.positions[v as usize].as_dvec3()),
        to: (1..3).find(|i| wedges[*i] == to),
    }
}

#[test]
fn the_shift_is_how_far_the_old_uv_comes_to_lie_from_its_place() {
    // Around the point in the middle of a grid of 2 x 2 quads six faces meet. It goes to its right neighbour.
    let flat = with_uvs(fixtures::grid(2, 2));
    let cost_of = |mesh: &Mesh, weight: f64| {
        let mut borders = borders_of(mesh, &step_at(0.5));
        borders.weight = weight;
        let surcharge = Surcharge::new(&borders, mesh);
        let faces = (0..mesh.face_count()).filter(|f| mesh.triangles[*f].contains(&4));
        let star: Vec<StarFace> = faces.map(|f| star_face(mesh, f, 4, 5)).collect();
        assert_eq!(star.len(), 6);
        assert!(surcharge.near(mesh, star.clone().into_iter()));
        surcharge.cost(mesh, 0.0, true, star.into_iter()).sqrt()
    };
    assert!(cost_of(&flat, 1.0) < 1e-12, "UVs that follow the surface evenly move nothing");
    // The middle's UV lies 0.1 of the sheet off to the right: 0.2 of its length, 2.
    let mut raw = flat.into_raw();
    raw.uv0.as_mut().unwrap()[4].x += 0.1;
    let bent = Mesh::new(raw).unwrap();
    let expected = MOVED * 0.2 * (6.0 * 0.5 / 6.0_f64).sqrt() / 8.0;
    assert!((cost_of(&bent, 1.0) - expected).abs() < 1e-6, "{} for {expected}", cost_of(&bent, 1.0));
    assert!((cost_of(&bent, 3.0) - 3.0 * expected).abs() < 3e-6);
}

#[test]
fn triangles_stay_where_the_paint_has_a_border() {
    let mesh = with_uvs(fixtures::field(48, 48, |x, y| 0.05 * ((x * 0.9).sin() + (y * 0.7).cos())));
    let mut borders = borders_of(&mesh, &step_at(0.51));
    (borders.weight, borders.cost) = (10.0, BorderCost::Area);
    for metric in [MetricKind::Quadric, MetricKind::Memoryless] {
        let options = SimplifyOptions { metric, ..SimplifyOptions::default() };
        let placement = if metric == MetricKind::Quadric { Placement::HalfEdge } else { Placement::Free };
        let [plain, bordered] = [collapse(&mesh, &[], None, &options), bordered(&mesh, &borders, &options)]
            .map(|sequence| cut(&mesh, &[], &sequence, 800, placement));
        assert!(plain.face_count().abs_diff(bordered.face_count()) < 2);
        let [without, with] = [&plain, &bordered].map(|level| edges_across(level, 48.0 * 0.51));
        assert!(with * 2 > without * 3, "{metric:?}: {with} edges cross the step where {without} did");
    }
}

#[test]
fn without_a_border_in_the_picture_or_without_weight_the_sequence_is_the_metric_s_own() {
    let mesh = with_uvs(fixtures::field(30, 20, |x, y| (x * 0.9).sin() * (y * 0.7).cos()));
    let options = SimplifyOptions::default();
    let plain = collapse(&mesh, &[], None, &options);
    let flat = borders_of(&mesh, &step_at(2.0));
    assert_eq!(bordered(&mesh, &flat, &options), plain);
    let mut full = borders_of(&mesh, &step_at(0.5));
    full.cost = BorderCost::Area;
    assert_ne!(bordered(&mesh, &full, &options), plain);
    full.weight = 0.0;
    assert_eq!(bordered(&mesh, &full, &options), plain);
}

#[test]
fn one_thread_and_three_find_the_same_borders() {
    let noise = painted(200, |x, y| (kiln_geom::sample::hash(u64::from(y * 200 + x)) % 200) as u8);
    let mesh = with_uvs(fixtures::grid(16, 6));
    let made = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| borders_of(&mesh, &noise).maps[0].borders.clone())
    };
    assert_eq!(made(1), made(3));
}

#[test]
fn a_picture_that_cannot_be_had_is_an_error() {
    let mesh = with_uvs(fixtures::grid(2, 2));
    let failed = TextureBorders::new(&mesh, &materials(), &|_| Err("gone".into()), &TextureBorderOptions::default());
    assert_eq!(failed.unwrap_err(), "gone");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn the_queue_gives_the_order_of_pricing_everything_at_every_step(seed in 0_u64..10_000, weight in 0.0_f64..4.0, area in prop::bool::ANY) {
        let random = |i: u32| (kiln_geom::sample::hash(u64::from(i) ^ seed << 20) % 1000) as f32 / 1000.0;
        let mut raw = with_uvs(fixtures::field(9, 8, |x, y| random((x + 16.0 * y) as u32))).into_raw();
        for (uv, i) in raw.uv0.as_mut().unwrap().iter_mut().zip(500..) {
            *uv += 0.03 * Vec2::new(random(i), random(i + 500));
        }
        let mesh = Mesh::new(raw).unwrap();
        let paint = painted(40, |x, y| if random(x / 7 + 100 * (y / 9)) < 0.5 { 30 } else { 200 });
        let mut borders = borders_of(&mesh, &paint);
        (borders.weight, borders.cost) = (weight, if area { BorderCost::Area } else { BorderCost::Shift });
        let options = SimplifyOptions::default();
        let topology = Topology::new(&mesh);
        let forms = Forms::new(&mesh, &topology, &[], &options);
        let engine = || {
            let mut rest = Rest::new(&mesh, &topology, forms.positions(), &options);
            let metric = QuadricRest::new(forms.initial(), &mut rest);
            let work = regions::whole(&rest, None);
            let metric = Bordered::new(metric.part(&work), &mesh, &borders, &work);
            Collapser::new(work, metric, mesh.face_count() as u32)
        };
        let mut fast = engine();
        fast.run(0, u32::MAX);
        prop_assert_eq!(fast.order(), engine().naive_order());
    }
}
