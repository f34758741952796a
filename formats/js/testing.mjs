// What the tests build containers from, by hand and by the page: nothing here is shared with the reader but BLAKE3.

import { blake3 } from "./blake3.mjs";

/** Bytes from typed arrays, numbers (u32) and strings with their length, one behind the other; `{ align: n }` pads with zeros. */
export function bytesOf(...parts) {
  const out = [];
  const put = (bytes) => { for (const byte of bytes) out.push(byte); };
  for (const part of parts) {
    if (typeof part === "number") put(new Uint8Array(Uint32Array.of(part).buffer));
    else if (typeof part === "string") {
      const text = new TextEncoder().encode(part);
      put(bytesOf(text.length, text, { align: 4 }));
    } else if (part.align) while (out.length % part.align) out.push(0);
    else put(new Uint8Array(part.buffer, part.byteOffset, part.byteLength));
  }
  return Uint8Array.from(out);
}

export const f32 = (...values) => Float32Array.from(values);
export const zeros = (length) => new Uint8Array(length);
export const NONE = 0xffffffff;

const align = (x, a) => Math.ceil(x / a) * a;
const TABLES = ["STRS", "LEVL", "SUBM", "MATL", "TEXT", "PROV"];
const OPTIONAL = ["PROV", "WNDW", "TREE", "LEAF", "CTRE", "CLUS"];

/** A file of sections `{ kind, bytes, version?, codec?, raw? }`; `raw` are the decoded bytes of a coded one. */
export function assemble(sections, minor = 2) {
  let end = 96 + 128 * sections.length;
  const entries = sections.map(({ kind, bytes, version = 1, codec = 0, raw = bytes }) => {
    const alignment = TABLES.includes(kind) ? 16 : 256;
    const offset = align(end, alignment);
    end = offset + bytes.length;
    return { kind, bytes, version, codec, raw, alignment, offset };
  });
  const file = new Uint8Array(end);
  const view = new DataView(file.buffer);
  for (const [i, e] of entries.entries()) {
    const at = 96 + 128 * i;
    file.set(new TextEncoder().encode(e.kind), at);
    view.setUint16(at + 4, e.version, true);
    view.setUint16(at + 6, OPTIONAL.includes(e.kind) || /^[a-z]/.test(e.kind) ? 0 : 1, true);
    view.setUint32(at + 8, e.codec, true);
    view.setUint32(at + 12, e.alignment, true);
    view.setUint32(at + 16, e.offset, true);
    view.setUint32(at + 24, e.bytes.length, true);
    view.setUint32(at + 32, e.raw.length, true);
    file.set(blake3(e.raw), at + 80);
    file.set(e.bytes, e.offset);
  }
  file.set(Uint8Array.of(0x89, 0x4b, 0x4c, 0x4e, 0x0d, 0x0a, 0x1a, 0x0a, 4, 3, 2, 1, 1, 0, minor, 0));
  view.setUint32(16, end, true);
  view.setUint32(24, 96, true);
  view.setUint32(32, sections.length, true);
  return rehashed(file);
}

/** The file with the hashes that its sections and header should have, as far as they lie inside. */
export function rehashed(file) {
  const right = file.slice();
  const view = new DataView(right.buffer);
  const end = 96 + 128 * view.getUint32(32, true);
  if (end > right.length) return right;
  for (let at = 96; at < end; at += 128) {
    const offset = view.getUint32(at + 16, true) + view.getUint32(at + 20, true) * 2 ** 32;
    const length = view.getUint32(at + 24, true) + view.getUint32(at + 28, true) * 2 ** 32;
    if (offset < end || offset + length > right.length) continue;
    const hash = blake3(right.subarray(offset, offset + length));
    right.set(hash, at + 48);
    if (view.getUint32(at + 8, true) === 0) right.set(hash, at + 80);
  }
  right.set(blake3(bytesOf(right.subarray(0, 64), right.subarray(96, end))), 64);
  return right;
}

/** Six vertices, at x = 0 to 5. */
export const POSITIONS = f32(...[0, 1, 2, 3, 4, 5].flatMap((x) => [x, x * x, 0.1]));

/**
 * The sections of a container of two levels over six vertices, one material with one texture of 2 x 2 texels, one submesh called
 * `tëst`. `indices` are level 0's; level 1 is the triangle 0 1 2 of the first three vertices.
 */
export function small(indices = [0, 1, 2, 0, 1, 5, 0, 2, 4, 1, 3, 5]) {
  const coarse = POSITIONS.slice(0, 9);
  const box = (p) => [0, 1, 2].map((k) => p.filter((_, i) => i % 3 === k))
    .reduce(([lo, hi], c) => [[...lo, Math.min(...c)], [...hi, Math.max(...c)]], [[], []]).flat();
  // Sections: 0 to 5 tables, 6 and 7 the coarse level, 8 the texture, 9 and 10 the fine one.
  const level = (positions, count, error, vert, array, need) => bytesOf(
    count / 3, positions.length / 3, f32(error), 1, f32(...box(positions)), vert, vert === 6 ? 7 : 10, 2, array, 1, need, 3, zeros(28));
  const array = (positions) => bytesOf(1, 2, 0, 0, positions.byteLength, 0, zeros(8));
  const range = (count, greatest, positions) => bytesOf(0, count, 0, greatest + 1, f32(...box(positions)), zeros(8));
  const slot = bytesOf(0, 0, Uint8Array.of(0, 1, 1, 1, 2, 0, 0, 0), f32(0, 0, 1, 1, 0), zeros(12));
  const empty = bytesOf(NONE, zeros(44));
  const mip = (size, offset) => bytesOf(size, size, 8, 0, offset, 0, 4 * size * size, 0);
  return [
    { kind: "STRS", bytes: bytesOf(3, zeros(12), "tëst", "", "wood") },
    { kind: "LEVL", bytes: bytesOf(2, 2, 6, 40, 0, 0, 0, 0, level(POSITIONS, indices.length, 0, 9, 0, 0),
      level(coarse, 3, 0.1, 6, 1, 3), array(POSITIONS), array(coarse), 8, 9, 10, 6, 7, 8) },
    { kind: "SUBM", bytes: bytesOf(1, 2, zeros(8), 0, 0, 2, 40, zeros(16), range(indices.length, Math.max(...indices), POSITIONS), range(3, 2, coarse)) },
    { kind: "MATL", bytes: bytesOf(1, zeros(12), 1, 1, f32(0.5), 1, f32(1, 1, 1, 1, 0, 0, 0.3, 1, 0.7, 1, 1), 0, slot, empty, empty, empty, empty) },
    { kind: "TEXT", bytes: bytesOf(1, 2, zeros(8), 2, 2, 1, Uint8Array.of(1, 2, 3, 4), 2, 2, 2, 0, 0, 8, 0, zeros(20), mip(2, 0), mip(1, 256)) },
    { kind: "PROV", bytes: bytesOf(zeros(32), 1, 1, zeros(24), "kiln 0", "any", "", zeros(32), "a.glb", "pack", "1") },
    { kind: "VERT", bytes: bytesOf(coarse) },
    { kind: "INDX", bytes: bytesOf(Uint16Array.of(0, 1, 2)) },
    { kind: "MIPT", bytes: bytesOf(Uint8Array.from({ length: 16 }, (_, i) => i), { align: 256 }, Uint8Array.of(9, 9, 9, 9)) },
    { kind: "VERT", bytes: bytesOf(POSITIONS) },
    { kind: "INDX", bytes: bytesOf(Uint16Array.from(indices)) },
  ];
}

const checkpoint = (detail, vertices, triangles, error, level) => bytesOf(detail, vertices, triangles, f32(error), level, zeros(12));

/** A window over {@link small}'s vertices: points {0} {1} {2} {3, 4} {5}, the last two go. */
export const WINDOW = {
  kind: "WNDW",
  bytes: bytesOf(6, 4, 2, 3, 3, 1, zeros(40), checkpoint(0, 6, 4, 0, 0), checkpoint(1, 5, 3, 0.05, NONE), checkpoint(2, 3, 2, 0.1, NONE),
    { align: 256 }, 0, 1, 2, 2, 2, 3, { align: 256 }, 0b101111),
};

/** The triangles over which {@link TREE} counts faces. */
export const TREE_INDICES = [0, 2, 3, 3, 4, 5, 0, 1, 5, 1, 2, 5];

// Root (row 0), its children A and B (row 1), B's child C (row 3). A holds vertices 0 and 1, B 2, C 3 and 4, the root 5.
const treeStart = (columns, width) => [
  4, 6, 4, columns, width, 2, zeros(40), checkpoint(4, 6, 4, 0, 0), checkpoint(0, 1, 0, 7, NONE), 0, 1, 3, 3, 4, { align: 256 }, 0, 1, 2, 3, 4,
  { align: 256 },
];
export const [ROOT, A, B, C] = [[50, 0, 0], [51, 0, 0], [52, 0, 0], [53, 0, 0]];

/** Two columns (root, A) and (root, B, none, C), two texels wide. */
export const TREE = {
  kind: "TREE",
  bytes: bytesOf(...treeStart(2, 2), f32(...ROOT, 1, ...ROOT, 1, ...A, 0.5, ...B, 1, 0, 0, 0, 0, ...C, 1, 0, 0, 0, 0, ...C, 1)),
};
export const LEAF = {
  kind: "LEAF",
  bytes: bytesOf(f32(...[2, 2, 3, 7, 7, 0].flatMap((texel, v) => [...POSITIONS.slice(3 * v, 3 * v + 3), texel]))),
};
export const COMPACT = {
  kind: "CTRE",
  bytes: bytesOf(...treeStart(0, 0), f32(...ROOT), 0, f32(...A), 0, f32(...B), 0, f32(...C), 2, { align: 256 }, 1, 1, 2, 3, 3, 0),
};

const cluster = (reference, vertices, triangle, triangles, group, madeBy, level) => bytesOf(
  reference, vertices, triangle, triangles, 0, group, madeBy, level, f32(0, 0, 0, 99, 0, 0, 1, 1));
const group = (error, first, count, level) => bytesOf(f32(0, 0, 0, 100, error), first, count, level);

/** Two clusters of level 0 in a group of error 0.5, which are replaced by one. */
export const CLUSTERS = {
  kind: "CLUS",
  bytes: bytesOf(3, 2, 2, 13, 5, 6, zeros(40), { align: 256 },
    cluster(0, 4, 0, 2, 0, NONE, 0), cluster(4, 6, 2, 2, 0, NONE, 0), cluster(10, 3, 4, 1, 1, 0, 1), { align: 256 },
    group(0.5, 0, 2, 0), group(3.4028234663852886e38, 2, 1, 1), { align: 256 },
    0, 1, 2, 5, 0, 2, 4, 1, 3, 5, 0, 1, 2, { align: 256 },
    Uint8Array.of(0, 1, 2, 0, 1, 3, 0, 1, 2, 3, 4, 5, 0, 1, 2)),
};
