// The registries of `container-v1.md`: what numbers and names mean.

/** Newest minor version that this reader knows. */
export const MINOR = 2;
/** An index that names nothing. */
export const NONE = 0xffffffff;

/** Names of the checks of chapter 6. */
export const CHECKS = {
  K101: "too-short",
  K102: "magic",
  K103: "endian",
  K104: "major",
  K105: "file-length",
  K106: "table-offset",
  K107: "section-count",
  K108: "reserved",
  K109: "header-hash",
  K201: "kind",
  K202: "unknown-required",
  K203: "section-version",
  K204: "flags",
  K205: "codec",
  K206: "alignment",
  K207: "misaligned",
  K208: "bounds",
  K209: "overlap",
  K210: "hole",
  K211: "padding",
  K212: "trailing",
  K213: "raw-length",
  K214: "stored-hash",
  K215: "raw-hash",
  K216: "duplicate",
  K217: "missing",
  K218: "order",
  K219: "decode",
  K301: "table-length",
  K302: "count",
  K303: "text",
  K304: "reference",
  K305: "unreferenced",
  K306: "not-finite",
  K307: "value",
  K308: "level-error",
  K309: "needs",
  K310: "ranges",
  K311: "index-width",
  K312: "index-range",
  K313: "arrays",
  K314: "box",
  K315: "mips",
  K316: "role",
  K317: "layout-length",
  K318: "layout-count",
  K319: "checkpoints",
  K320: "points",
  K321: "parents",
  K322: "vanishing",
  K323: "tree-rows",
  K324: "tree-texels",
  K325: "terminals",
  K326: "face-counts",
  K327: "cluster-ranges",
  K328: "cluster-corners",
  K329: "cluster-groups",
  K330: "cluster-errors",
  K331: "cluster-spheres",
  K332: "cluster-triangles",
};

const kind = (version, required, alignment, rank, occurs) => ({ version, required, alignment, rank, occurs });

/** Rank of the first kind that is payload; those below are tables. */
export const PAYLOAD_RANK = 6;

/** Section kinds: newest version known, need, alignment, place in the order, how often. */
export const KINDS = {
  STRS: kind(1, true, 16, 0, "once"),
  LEVL: kind(2, true, 16, 1, "once"),
  SUBM: kind(1, true, 16, 2, "once"),
  MATL: kind(1, true, 16, 3, "once"),
  TEXT: kind(2, true, 16, 4, "once"),
  PROV: kind(1, false, 16, 5, "at most once"),
  VERT: kind(1, true, 256, 6, "any"),
  INDX: kind(1, true, 256, 6, "any"),
  MIPT: kind(1, true, 256, 6, "any"),
  WNDW: kind(1, false, 256, 7, "at most once"),
  TREE: kind(1, false, 256, 8, "at most once"),
  LEAF: kind(1, false, 256, 9, "at most once"),
  CTRE: kind(1, false, 256, 10, "at most once"),
  CLUS: kind(1, false, 256, 11, "at most once"),
  MIPL: kind(1, true, 256, 12, "any"),
};

/** Codecs by number. */
export const CODECS = ["none", "zstd", "lz4", "meshopt-vertex", "meshopt-index", "meshopt-index-zstd"];
/** Which codecs a section of a kind may be in: tables in none, payload in zstd, VERT and INDX also in their own. */
export function isCodecOf(codec, kind, row) {
  return codec === 0 || (row.rank >= PAYLOAD_RANK && (codec === 1 || (codec === 3 && kind === "VERT") || ((codec === 4 || codec === 5) && kind === "INDX")));
}
/** Most raw bytes for a stored one, by codec: more is refused before anything is allocated. */
export const MOST_EXPANSION = [1, 1024, 0, 1024, 12, 1024];
/** The codec's name, or its number. */
export const codecName = (codec) => CODECS[codec] ?? `codec ${codec}`;

/** How a level's error was found, by number. */
export const ERROR_KINDS = [undefined, "sampled", "bound"];

/** Formats of vertex arrays: numbers an element, and the typed array that lends them. */
export const VERTEX_FORMATS = [
  undefined,
  { name: "f32x2", components: 2, size: 8, array: Float32Array },
  { name: "f32x3", components: 3, size: 12, array: Float32Array },
  { name: "f32x4", components: 4, size: 16, array: Float32Array },
  { name: "u16x4", components: 4, size: 8, array: Uint16Array },
];

/** Vertex arrays by number: name, and number of the one format. */
export const SEMANTICS = [
  undefined,
  { name: "positions", format: 2 },
  { name: "normals", format: 2 },
  { name: "tangents", format: 3 },
  { name: "uv0", format: 1 },
  { name: "uv1", format: 1 },
  { name: "colors", format: 3 },
  { name: "joints", format: 4 },
  { name: "weights", format: 3 },
];

/** Texture formats by number: bytes of a unit, and texels on a side of it. */
export const TEXTURE_FORMATS = [
  undefined,
  { name: "rgba8-unorm", unit: 4, side: 1, array: Uint8Array },
  { name: "rgba8-srgb", unit: 4, side: 1, array: Uint8Array },
  { name: "rgba16-unorm", unit: 8, side: 1, array: Uint16Array },
  { name: "rgba16-float", unit: 8, side: 1, array: Uint16Array },
  { name: "rgba32-float", unit: 16, side: 1, array: Float32Array },
  { name: "bc5-unorm", unit: 16, side: 4, array: Uint8Array },
  { name: "bc7-unorm", unit: 16, side: 4, array: Uint8Array },
  { name: "bc7-srgb", unit: 16, side: 4, array: Uint8Array },
];

/** Bytes of a mip. */
export function mipLength(format, width, height) {
  return Math.ceil(width / format.side) * Math.ceil(height / format.side) * format.unit;
}

/** Meanings of a texture's channels, by number; those above 10 came with version 2 of the table. */
export const CHANNELS = [
  "unused", "red", "green", "blue", "alpha", "normal-x", "normal-y", "normal-z", "roughness", "metallic", "occlusion",
  "height", "position-x", "position-y", "position-z", "object-normal-x", "object-normal-y", "object-normal-z", "object-id",
  "material-id", "curvature", "bent-normal-x", "bent-normal-y", "bent-normal-z", "opacity", "coverage",
];

/** Roles of textures in materials, by slot and role bit. */
export const ROLES = ["base-color", "metallic-roughness", "normal", "occlusion", "emissive"];
/** Extra pictures, from role bit 5. */
export const EXTRAS = [
  "height", "position", "object-normal", "object-id", "material-id", "curvature", "ambient-occlusion", "bent-normal",
  "opacity", "coverage",
];

/** The extra of a role set that is exactly one extra's bit, else null. */
export function extraOf(roles) {
  const bit = 31 - Math.clz32(roles);
  return roles !== 0 && (roles & (roles - 1)) === 0 ? (EXTRAS[bit - ROLES.length] ?? null) : null;
}

/** Alpha modes by number. */
export const ALPHA_MODES = ["opaque", "mask", "blend"];
/** Wraps by number. */
export const WRAPS = ["repeat", "mirrored-repeat", "clamp-to-edge"];
