//! `include/kiln.h` is what the sources say. `KILN_BLESS=1 cargo test -p kiln-capi` writes it anew.

#![allow(clippy::unwrap_used, reason = "tests")]
#![allow(missing_docs, reason = "tests")]

use std::path::Path;

/// Rust's name and C's.
const NAMES: &[(&str, &str)] = &[
    ("Handle", "kiln_container"),
    ("Status", "kiln_status"),
    ("Error", "kiln_error"),
    ("Str", "kiln_str"),
    ("Bytes", "kiln_bytes"),
    ("Info", "kiln_info"),
    ("Section", "kiln_section"),
    ("DrawRange", "kiln_draw_range"),
    ("Level", "kiln_level"),
    ("Array", "kiln_array"),
    ("Submesh", "kiln_submesh"),
    ("Slot", "kiln_slot"),
    ("Material", "kiln_material"),
    ("Texture", "kiln_texture"),
    ("Mip", "kiln_mip"),
    ("Provenance", "kiln_provenance"),
    ("Input", "kiln_input"),
    ("Stage", "kiln_stage"),
    ("View", "kiln_view"),
    ("Window", "kiln_window"),
    ("TreeLeaf", "kiln_tree_leaf"),
    ("CompactTree", "kiln_compact_tree"),
    ("Clusters", "kiln_clusters"),
    ("Checkpoint", "kiln_checkpoint"),
    ("CompactNode", "kiln_compact_node"),
    ("ClusterRecord", "kiln_cluster"),
    ("GroupRecord", "kiln_group"),
    ("NONE", "KILN_NONE"),
];

/// Constants of the format that C has no use for.
const LEFT_OUT: &[&str] =
    &["MAX_TREE_WIDTH", "MAX_TREE_TEXELS", "MAX_TREE_ROWS", "MAX_CLUSTER_TRIANGLES", "MAX_CLUSTER_VERTICES"];

const OPENING: &str = "\
/* kiln: read containers of levels of detail. Generated from crates/kiln-capi and kiln-format; do not edit.
 *
 * Functions fill structs of the caller's with numbers and with pointers that live until kiln_close. A handle never changes: any
 * number of threads may read one. With the static library, link the system's libraries for threads, mathematics and C++. */";

fn generated() -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut config = cbindgen::Config {
        language: cbindgen::Language::C,
        header: Some(OPENING.into()),
        include_guard: Some("KILN_H".into()),
        cpp_compat: true,
        usize_is_size_t: true,
        documentation_style: cbindgen::DocumentationStyle::C99,
        style: cbindgen::Style::Both,
        line_length: 130,
        ..cbindgen::Config::default()
    };
    config.enumeration.rename_variants = cbindgen::RenameRule::ScreamingSnakeCase;
    config.enumeration.prefix_with_name = true;
    config.export.rename = NAMES.iter().map(|(rust, c)| (rust.to_string(), c.to_string())).collect();
    config.export.exclude = LEFT_OUT.iter().map(|name| name.to_string()).collect();
    let bindings = cbindgen::Builder::new()
        .with_config(config)
        .with_src(root.join("../kiln-format/src/layout.rs"))
        .with_src(root.join("src/types.rs"))
        .with_src(root.join("src/ffi.rs"))
        .generate()
        .unwrap();
    let mut out = Vec::new();
    bindings.write(&mut out);
    String::from_utf8(out).unwrap()
}

#[test]
fn the_header_is_what_the_sources_say() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("include/kiln.h");
    let header = generated();
    if std::env::var_os("KILN_BLESS").is_some() {
        std::fs::write(&path, &header).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(committed == header, "include/kiln.h is stale: run with KILN_BLESS=1 and look at the difference");
}
