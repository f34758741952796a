//! Texture space: atlas, transfer by mirrored vertices, dilation, tangents.
//!
//! Reading order: [`atlas`] (a second UV layout for the low mesh), [`tangents`] (MikkTSpace on the triangles that are
//! written), [`transfer`] (the bake: high mesh onto the low one's sheet), [`dilation`] (what the empty texels get).

pub mod atlas;
pub mod dilation;
pub mod tangents;
pub mod transfer;
