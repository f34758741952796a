use super::*;
use kiln_format::{Content, ErrorKind, LevelContent, SubmeshContent, write};

/// Three levels of one triangle each, with the given errors.
fn container(errors: &[f32]) -> AlignedBytes {
    let positions: [[f32; 3]; 3] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
    let bytes: Vec<u8> = positions.iter().flatten().flat_map(|f| f.to_le_bytes()).collect();
    let level = |error: &f32| LevelContent {
        error: *error,
        error_kind: ErrorKind::Sampled,
        arrays: vec![(Semantic::Positions, &bytes)],
        indices: &[0, 1, 2],
        index_counts: vec![3],
        shares_vertices: false,
    };
    let submesh = SubmeshContent { name: "all".into(), material: None, attributes: 2, source_triangles: 1 };
    let levels = errors.iter().map(level).collect();
    let content = Content { source_triangles: 1, levels, submeshes: vec![submesh], ..Content::default() };
    AlignedBytes::copy_of(&write(&content).expect("valid"))
}

/// One unit covers 100 pixels at distance 1, because tan(45 degrees) = 1.
fn view(distance: f32) -> View {
    View { distance, vertical_fov_radians: std::f32::consts::FRAC_PI_2, viewport_height_px: 200.0 }
}

#[test]
fn the_coarsest_level_within_the_threshold_is_chosen() {
    let bytes = container(&[0.0, 0.01, 0.1]);
    let lods = Lods::open(&bytes).expect("sound");
    assert!((view(1.0).pixels_per_unit() - 100.0).abs() < 1e-3);
    // Errors in pixels at distance d: 0, 1/d, 10/d.
    assert_eq!(lods.choose_level(&view(0.5), 1.0), 0);
    assert_eq!(lods.choose_level(&view(1.01), 1.0), 1);
    assert_eq!(lods.choose_level(&view(9.0), 1.0), 1);
    assert_eq!(lods.choose_level(&view(10.1), 1.0), 2);
    assert_eq!(lods.choose_level(&view(9.0), 2.0), 2);
}

#[test]
fn views_that_make_no_sense_get_the_finest_level() {
    let bytes = container(&[0.001, 0.01]);
    let lods = Lods::open(&bytes).expect("sound");
    for distance in [0.0, -1.0, f32::NAN] {
        assert_eq!(lods.choose_level(&view(distance), 1.0), 0, "distance {distance}");
    }
    assert_eq!(lods.choose_level(&view(1e30), 1.0), 1);
    assert_eq!(lods.choose_level(&View { viewport_height_px: f32::NAN, ..view(1.0) }, 1.0), 0);
}

#[test]
fn only_levels_at_hand_are_chosen_from_a_prefix() {
    let bytes = container(&[0.0, 0.01, 0.1]);
    let lods = Lods::open(&bytes).expect("sound");
    let needs = lods.container().level_needs(2);
    let ends = lods
        .container()
        .sections()
        .filter(|s| needs.contains(&s.number))
        .map(|s| s.entry.offset + s.entry.stored_length);
    let end = ends.max().expect("needs sections") as usize;
    let prefix = Lods::open_prefix(&bytes[..end]).expect("tables are whole");
    assert_eq!(prefix.choose_level(&view(0.1), 1.0), 2);
    assert!(prefix.level(1).is_none());
    assert_eq!(prefix.level(2).expect("at hand").positions().len(), 3);
}

#[test]
fn slices_are_lent_from_the_callers_bytes() {
    let bytes = container(&[0.0]);
    let lods = Lods::open(&bytes).expect("sound");
    let level = lods.level(0).expect("at hand");
    let range = bytes.as_ptr_range();
    assert!(range.contains(&level.positions().as_ptr().cast()));
    assert_eq!(level.positions().as_ptr() as usize % 256, 0);
    assert_eq!(level.indices(), Indices::U16(&[0, 1, 2]));
    assert_eq!(lods.submesh(0).map(|s| (s.name, s.material)), Some(("all", None)));
    assert_eq!(lods.bounds(), ([0.0; 3], [1.0, 2.0, 0.0]));
    assert_eq!((lods.level(1).is_none(), lods.submesh(1), lods.mip(0, 0).is_none()), (true, None, true));
}

#[test]
fn the_distance_to_a_box_is_zero_inside_and_euclidean_outside() {
    let bounds = ([0.0; 3], [1.0; 3]);
    assert_eq!(View::distance_to_box([0.5; 3], bounds), 0.0);
    assert_eq!(View::distance_to_box([4.0, 5.0, 0.5], bounds), 5.0);
}

#[test]
fn levels_are_chosen_by_error_and_by_triangles() {
    // Levels of 4, 2, 2 and 1 triangles; errors rise.
    let positions: [[f32; 3]; 3] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
    let bytes: Vec<u8> = positions.iter().flatten().flat_map(|f| f.to_le_bytes()).collect();
    let indices = [0, 1, 2].repeat(4);
    let level = |(triangles, error): (usize, f32)| LevelContent {
        error,
        error_kind: ErrorKind::Sampled,
        arrays: vec![(Semantic::Positions, &bytes)],
        indices: &indices[..triangles * 3],
        index_counts: vec![triangles as u32 * 3],
        shares_vertices: false,
    };
    let levels = [(4, 0.0), (2, 0.25), (2, 0.5), (1, 1.0)].map(level).to_vec();
    let submesh = SubmeshContent { name: "all".into(), material: None, attributes: 2, source_triangles: 4 };
    let content = Content { levels, submeshes: vec![submesh], ..Content::default() };
    let bytes = AlignedBytes::copy_of(&write(&content).expect("valid"));
    let lods = Lods::open_tables(&bytes).expect("sound");
    lods.validate().expect("sound");
    let by_triangles = [u32::MAX, 4, 3, 2, 1, 0].map(|budget| lods.choose_by_triangles(budget));
    assert_eq!(by_triangles, [0, 0, 1, 1, 3, 3]);
    let by_error = [2.0, 1.0, 0.75, 0.25, 0.1, 0.0, -1.0, f32::NAN].map(|error| lods.choose_by_error(error));
    assert_eq!(by_error, [3, 3, 2, 1, 0, 0, 0, 0]);
    assert_eq!([0, 3, 4].map(|lod| lods.triangles(lod)), [Some(4), Some(1), None]);
}

#[cfg(feature = "map")]
#[test]
#[allow(unsafe_code, reason = "nobody else knows the file")]
fn a_mapped_file_is_read_where_it_lies() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("three.kiln");
    let bytes = container(&[0.0, 0.01, 0.1]);
    std::fs::write(&path, &*bytes).expect("written");
    // SAFETY: the file lives in a folder of this test.
    let mapped = unsafe { MappedFile::open(&path) }.expect("mapped");
    let lods = Lods::open(&mapped).expect("sound");
    assert_eq!(lods.level(2).expect("at hand").indices(), Indices::U16(&[0, 1, 2]));
    assert!(mapped.as_ptr_range().contains(&lods.level(0).expect("at hand").positions().as_ptr().cast()));
    // Removing the name leaves the mapping whole.
    std::fs::remove_file(&path).expect("removed");
    lods.validate().expect("still sound");
    std::fs::write(&path, []).expect("written");
    // SAFETY: as above.
    let empty = unsafe { MappedFile::open(&path) }.expect("no bytes");
    assert!(empty.is_empty() && Lods::open(&empty).is_err());
    // SAFETY: as above.
    assert!(unsafe { MappedFile::open(folder.path().join("none.kiln")) }.is_err());
}
