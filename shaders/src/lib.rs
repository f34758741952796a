//! Every shader pass as a constant, with its hash and the path of its CPU twin.
//!
//! A pass is one `.wgsl` file in this package's folder. Its opening comment says what one invocation computes, what it
//! reads and writes, and names its twin: the Rust file that computes the same thing without a GPU and that a test compares it
//! with. It has the same stem, or names the pass's file.

/// One shader pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shader {
    /// Stem of its file.
    pub name: &'static str,
    /// WGSL text.
    pub source: &'static str,
    /// Path of its CPU twin from the workspace's root, '/'-separated.
    pub twin: &'static str,
}

impl Shader {
    /// BLAKE3 of the WGSL text: what a fingerprint of a GPU stage covers.
    pub fn hash(&self) -> [u8; 32] {
        *blake3::hash(self.source.as_bytes()).as_bytes()
    }
}

/// What an engine draws a level with: its maps on its triangles, lit.
pub const APPLY_MAPS: Shader = Shader {
    name: "apply_maps",
    source: include_str!("../apply_maps.wgsl"),
    twin: "crates/kiln-measure/src/render/apply_maps.rs",
};

/// The bake's hit pass: which high triangle the line of a sample meets first, or nearest.
pub const MIRRORED_VERTEX: Shader = Shader {
    name: "mirrored_vertex",
    source: include_str!("../mirrored_vertex.wgsl"),
    twin: "crates/kiln-bake/src/transfer/search.rs",
};

/// Views' second pass: what views lose by candidate collapses.
pub const FORMULA: Shader = Shader {
    name: "formula",
    source: include_str!("../formula.wgsl"),
    twin: "crates/kiln-lod/src/simplify/viewpoint/formula.rs",
};

/// Views' first pass: how many pixels each region wins or loses by candidate collapses.
pub const PRICE: Shader = Shader {
    name: "price",
    source: include_str!("../price.wgsl"),
    twin: "crates/kiln-lod/src/simplify/viewpoint/price.rs",
};

/// Sliding window: the vertex shader that picks while it draws.
pub const WINDOW_DRAW: Shader = Shader {
    name: "window_draw",
    source: include_str!("../window_draw.wgsl"),
    twin: "crates/kiln-runtime/src/window/pick.rs",
};

/// Sliding window: passes that fill vertex buffers, index buffers and draw arguments of a LOD.
pub const WINDOW_PICK: Shader = Shader {
    name: "window_pick",
    source: include_str!("../window_pick.wgsl"),
    twin: "crates/kiln-runtime/src/window/pick.rs",
};

/// Vertices' picks in a compact tree.
pub const TREE_COMPACT_PICK: Shader = Shader {
    name: "tree_compact_pick",
    source: include_str!("../tree_compact_pick.wgsl"),
    twin: "crates/kiln-runtime/src/tree/compact.rs",
};

/// Draws what vertices pick: goes behind one of the two picks in trees.
pub const TREE_DRAW: Shader = Shader {
    name: "tree_draw",
    source: include_str!("../tree_draw.wgsl"),
    twin: "crates/kiln-runtime/src/tree/mod.rs",
};

/// The triangles alive at a threshold of a tree, and their draws' arguments.
pub const TREE_DRAW_LIST: Shader = Shader {
    name: "tree_draw_list",
    source: include_str!("../tree_draw_list.wgsl"),
    twin: "crates/kiln-runtime/src/tree/draw_list.rs",
};

/// Vertices' picks in tree and leaf buffers.
pub const TREE_LEAF_PICK: Shader = Shader {
    name: "tree_leaf_pick",
    source: include_str!("../tree_leaf_pick.wgsl"),
    twin: "crates/kiln-runtime/src/tree/tree_leaf.rs",
};

/// Which clusters of a DAG a view draws.
pub const SELECT_CLUSTERS: Shader = Shader {
    name: "select_clusters",
    source: include_str!("../select_clusters.wgsl"),
    twin: "crates/kiln-runtime/src/clusters.rs",
};

/// All passes, by name.
pub const ALL: &[Shader] = &[
    APPLY_MAPS,
    FORMULA,
    MIRRORED_VERTEX,
    PRICE,
    SELECT_CLUSTERS,
    TREE_COMPACT_PICK,
    TREE_DRAW,
    TREE_DRAW_LIST,
    TREE_LEAF_PICK,
    WINDOW_DRAW,
    WINDOW_PICK,
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn every_wgsl_file_is_a_constant_and_names_its_twin() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut stems: Vec<String> = std::fs::read_dir(folder)
            .expect("the package's folder")
            .map(|entry| entry.expect("entry").path())
            .filter(|path| path.extension().is_some_and(|e| e == "wgsl"))
            .map(|path| path.file_stem().expect("stem").to_string_lossy().into_owned())
            .collect();
        stems.sort();
        assert_eq!(stems, ALL.iter().map(|s| s.name).collect::<Vec<_>>());
        for shader in ALL {
            let opening: Vec<&str> = shader.source.lines().take_while(|l| l.starts_with("//")).collect();
            assert!(opening.iter().any(|l| l.contains(shader.twin)), "{} does not name {}", shader.name, shader.twin);
            let twin = std::fs::read_to_string(folder.join("..").join(shader.twin)).expect(shader.twin);
            let stem = shader.twin.ends_with(&format!("/{}.rs", shader.name));
            assert!(stem || twin.contains(&format!("shaders/{}.wgsl", shader.name)), "{} names another", shader.twin);
        }
    }

    #[test]
    fn the_hash_is_that_of_the_text() {
        let hash = MIRRORED_VERTEX.hash();
        assert_eq!(hash, *blake3::hash(include_bytes!("../mirrored_vertex.wgsl")).as_bytes());
        let other = Shader { source: "// another text", ..MIRRORED_VERTEX };
        assert_ne!(hash, other.hash());
    }
}
