//! Texture space: atlas, transfer by mirrored vertices, dilation, tangents.
//!
//! Reading order: [`atlas`] (a second UV layout for the low mesh), [`tangents`] (MikkTSpace on the triangles that are
//! written), [`transfer`] (the bake: high mesh onto the low one's sheet), [`occlusion`] and [`curvature`] (what the high mesh has
//! beside its attributes), [`dilation`] (what the empty texels get).

pub mod atlas;
pub mod curvature;
pub mod dilation;
pub mod occlusion;
pub mod tangents;
pub mod transfer;
