//! Typed 32-bit ids: one type for each kind of index, so that two kinds cannot be mixed up.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

macro_rules! ids {
    ($($(#[$doc:meta])* $name:ident),* $(,)?) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable, Serialize, Deserialize)]
        #[repr(transparent)]
        pub struct $name(pub u32);

        impl $name {
            /// The id as an array index.
            #[inline]
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                self.0.fmt(f)
            }
        }
    )*};
}

ids! {
    /// A triangle of a mesh.
    FaceId,
    /// A place in the topology: a position shared by all wedges that lie there.
    PointId,
    /// One set of attributes at a point; what an index refers to (a *vertex* in buffers).
    WedgeId,
    /// A triangle's use of a vertex: `3 * face + k`.
    CornerId,
    /// An input part with one material: one glTF primitive in place.
    SubmeshId,
    /// An entry of [`crate::MaterialSet::materials`].
    MaterialId,
    /// An entry of [`crate::MaterialSet::textures`].
    TextureId,
    /// An entry of [`crate::MaterialSet::images`].
    ImageId,
}
