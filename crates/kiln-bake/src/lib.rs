//! Texture space: atlas, transfer by mirrored vertices, dilation, tangents.
