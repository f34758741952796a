//! A model of two levels, two submeshes and one texture, as plain data that tests may spoil.

use crate::prelude::*;
use alloc::borrow::Cow;

use bytemuck::{Zeroable, cast_slice};

use crate::record::NONE;
use crate::{
    Content, ErrorKind, LevelContent, MaterialRecord, PrivateSection, Provenance, Role, Semantic, SlotRecord,
    SubmeshContent, TextureContent, TextureFormat,
};

pub(super) struct Model {
    pub(super) levels: Vec<ModelLevel>,
    pub(super) names: [String; 2],
    pub(super) submesh_material: u32,
    pub(super) roughness: f32,
    pub(super) size: [u32; 2],
    pub(super) mips: Vec<Vec<u8>>,
    pub(super) private: Vec<PrivateSection<'static>>,
}

pub(super) struct ModelLevel {
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) uv0: Vec<[f32; 2]>,
    pub(super) indices: Vec<u32>,
    pub(super) counts: [u32; 2],
    pub(super) error: f32,
}

pub(super) fn level(positions: &[[f32; 3]], indices: &[u32], counts: [u32; 2], error: f32) -> ModelLevel {
    let uv0 = positions.iter().map(|p| [p[0] * 0.5, 0.25]).collect();
    ModelLevel { positions: positions.to_vec(), uv0, indices: indices.to_vec(), counts, error }
}

pub(super) fn tiny() -> Model {
    let square = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.5], [2.0, 0.0, 0.0]];
    // 129 x 1: mip 0 is wider than a tail holds, so there is one large mip.
    let mips = (0..8).map(|k| (0..(129usize >> k).max(1) * 4).map(|i| (i * 7 + k) as u8).collect()).collect();
    Model {
        levels: vec![level(&square, &[0, 1, 2, 1, 4, 2], [3, 3], 0.0), level(&square[..3], &[0, 1, 2], [3, 0], 0.125)],
        names: ["pot".into(), "lid".into()],
        submesh_material: 0,
        roughness: 0.5,
        size: [129, 1],
        mips,
        private: Vec::new(),
    }
}

impl Model {
    pub(super) fn content(&self) -> Content<'_> {
        let empty = SlotRecord { texture: NONE, ..SlotRecord::zeroed() };
        let base_color = SlotRecord { texture: 0, mag: 1, min: 1, mip: 2, uv_scale: [1.0; 2], ..SlotRecord::zeroed() };
        let mut material = MaterialRecord {
            base_color_factor: [1.0; 4],
            roughness_factor: self.roughness,
            normal_scale: 1.0,
            alpha_cutoff: 0.5,
            ..MaterialRecord::zeroed()
        };
        material.slots = [base_color, empty, empty, empty, empty];
        let submesh = |k: usize, material| SubmeshContent {
            name: self.names[k].clone(),
            material,
            attributes: 2 | 1 << Semantic::Uv0.number(),
            source_triangles: 40,
        };
        Content {
            source_triangles: 80,
            layout: Some([64, 4, 1, 1]),
            levels: self.levels.iter().map(ModelLevel::content).collect(),
            submeshes: vec![submesh(0, Some(self.submesh_material)), submesh(1, None)],
            materials: vec![("clay".into(), material)],
            textures: vec![TextureContent {
                name: "clay".into(),
                format: TextureFormat::Rgba8Srgb,
                channels: Role::BaseColor.channels(),
                extra: None,
                width: self.size[0],
                height: self.size[1],
                mips: self.mips.iter().map(|mip| Cow::Borrowed(&mip[..])).collect(),
            }],
            provenance: Some(Provenance {
                pipeline: [7; 32],
                tool: "kiln 0.1.0".into(),
                numeric_class: "any".into(),
                device_class: String::new(),
                inputs: vec![("models/pot.glb".into(), [9; 32])],
                stages: vec![("simplify".into(), "1".into())],
            }),
            private: self.private.clone(),
            ..Content::default()
        }
    }
}

impl ModelLevel {
    fn content(&self) -> LevelContent<'_> {
        LevelContent {
            error: self.error,
            error_kind: ErrorKind::Sampled,
            arrays: vec![(Semantic::Positions, cast_slice(&self.positions)), (Semantic::Uv0, cast_slice(&self.uv0))],
            indices: &self.indices,
            index_counts: self.counts.to_vec(),
            shares_vertices: false,
        }
    }
}
