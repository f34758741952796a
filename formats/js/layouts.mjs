// The layouts of chapter 5 as views on the file's bytes, and what a vertex picks in each.
//
//   window        a vertex that is gone goes to its parent until one is alive; triangles that are alive are a prefix of each range
//   tree, leaf    at most three reads: the vertex' leaf, then one or two texels of its column
//   compact tree  from the vertex' terminal node up to the first node that is split
//   clusters      draw where the group that replaces a cluster is too coarse and the one that made it is not
//
// Reading a view checks what picking relies on (counts, lengths, order of parents, pointers), once; picking then ends.

import { checkZero } from "./envelope.mjs";
import { align, check, fail, record, readRecord } from "./records.mjs";
import { NONE } from "./registry.mjs";

const WINDOW = record(
  "vertices u32, triangles u32, collapses u32, baseVertices u32, checkpointCount u32, flags u32, reserved u8x40");
const TREE = record("nodes u32, vertices u32, rows u32, columns u32, width u32, checkpointCount u32, reserved u8x40");
const CLUSTERS = record(
  "clusterCount u32, groupCount u32, levels u32, referenceCount u32, triangles u32, vertices u32, reserved u8x40");
const CHECKPOINT = record("detail u32, vertices u32, triangles u32, error f32, level u32, reserved u8x12");

const HEADER_SIZE = 64;
const MAX_TEXELS = 2 ** 24;
/** The error of a group that nothing replaces: the greatest finite f32. */
const ROOT_ERROR = 3.4028234663852886e38;

/**
 * @typedef {object} Checkpoint
 * @property {number} detail window: collapses done; trees: threshold
 * @property {number} vertices
 * @property {number} triangles
 * @property {number} error object units
 * @property {number | null} level the level that it equals
 */

/**
 * @typedef {object} WindowView
 * @property {number} vertices level 0's
 * @property {number} triangles level 0's
 * @property {number} collapses D
 * @property {number} baseVertices
 * @property {Checkpoint[]} checkpoints finest first
 * @property {Uint32Array} parents `[vertices]`
 * @property {Uint32Array | null} starts bit `v % 32` of word `v / 32`: v is the first of its point; null: every vertex is
 */

/**
 * @typedef {object} TreeLeafView
 * @property {number} nodes N
 * @property {number} vertices
 * @property {number} rows R
 * @property {number} columns C
 * @property {number} width W, texels
 * @property {Checkpoint[]} checkpoints finest first
 * @property {Uint32Array} rowStarts `[rows + 1]`
 * @property {Uint32Array} faceCounts `[nodes + 1]`, triangles alive at each threshold
 * @property {Float32Array} tree `[width * rows * ceil(columns / width)] x 4`: x, y, z, q
 * @property {Float32Array} leaf `[vertices] x 4`: x, y, z, number of the terminal node's texel
 */

/**
 * @typedef {object} CompactTreeView
 * @property {number} nodes N
 * @property {number} vertices
 * @property {number} rows R
 * @property {Checkpoint[]} checkpoints finest first
 * @property {Uint32Array} rowStarts `[rows + 1]`
 * @property {Uint32Array} faceCounts `[nodes + 1]`
 * @property {Float32Array} positions `[nodes] x 4`: x, y, z, and bits that are no number
 * @property {Uint32Array} parents `[nodes] x 4`, the same bytes: the fourth word is the parent's rank
 * @property {Uint32Array} terminals `[vertices]`
 */

/**
 * @typedef {object} ClusterView
 * @property {number} clusterCount
 * @property {number} groupCount
 * @property {number} levels of the DAG
 * @property {number} triangles of all clusters
 * @property {number} vertices level 0's
 * @property {Uint32Array} clusters `[clusterCount] x 16`: first reference, vertices, first triangle, triangles, submesh, group, made
 *   by, level, then the bits of `clusterFloats`
 * @property {Float32Array} clusterFloats the same bytes: words 8 to 11 are the sphere, 12 to 15 the cone
 * @property {Float32Array} groups `[groupCount] x 8`: sphere, error, then the bits of `groupWords`
 * @property {Uint32Array} groupWords the same bytes: words 5 to 7 are first cluster, clusters, level
 * @property {Uint32Array} references vertices of level 0, cluster by cluster
 * @property {Uint8Array} corners three a triangle: places in the cluster's references
 */

/** Cuts arrays off a layout section, as views. */
class Slicer {
  constructor(bytes, name, strict) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.name = name;
    this.strict = strict;
    this.at = 0;
  }

  header(type) {
    check(this.bytes.length >= HEADER_SIZE, "K317", this.name, `at least ${HEADER_SIZE} bytes`, this.bytes.length);
    this.at = HEADER_SIZE;
    return readRecord(type, this.view, 0, this.strict, () => this.name);
  }

  /** `count` numbers of a typed array, from the next multiple of `alignment`. */
  array(type, count, alignment = 256) {
    const start = align(this.at, alignment);
    const end = start + count * type.BYTES_PER_ELEMENT;
    check(end <= this.bytes.length, "K317", this.name, `at least ${end} bytes`, this.bytes.length);
    checkZero(this.bytes, this.at, start, this.name);
    this.at = end;
    return new type(this.bytes.buffer, this.bytes.byteOffset + start, count);
  }

  finish() {
    check(this.at === this.bytes.length, "K317", this.name, `${this.at} bytes`, this.bytes.length);
  }

  /** The checkpoints behind a header, from detail `first` to `last`. */
  checkpoints(count, first, last, levels) {
    const place = (i) => `${this.name}.checkpoints[${i}]`;
    const start = this.at;
    this.array(Uint8Array, count * CHECKPOINT.size, 1);
    const least = first === last ? 1 : 2;
    check(count >= least, "K319", `${this.name}.checkpoints`, `at least ${least}`, count);
    const all = Array.from({ length: count }, (_, i) => {
      const point = readRecord(CHECKPOINT, this.view, start + i * CHECKPOINT.size, this.strict, () => place(i));
      check(point.level === NONE || point.level < levels, "K319", () => place(i), `a level below ${levels} or none`, point.level);
      return { ...point, level: point.level === NONE ? null : point.level };
    });
    const direction = Math.sign(last - first);
    check(all[0].detail === first && all[count - 1].detail === last,
      "K319", `${this.name}.checkpoints`, `details ${first} to ${last}`, `${all[0].detail} to ${all[count - 1].detail}`);
    check(all[0].error >= 0, "K319", () => place(0), "an error of 0 or more", all[0].error);
    for (let i = 1; i < count; i++) {
      const [a, b] = [all[i - 1], all[i]];
      check((b.detail - a.detail) * direction > 0 && b.triangles <= a.triangles && b.error >= a.error,
        "K319", () => place(i), "coarser than the one before", JSON.stringify(b));
    }
    return all;
  }
}

function checkFinite(floats, place) {
  for (let i = 0; i < floats.length; i++) if (!Number.isFinite(floats[i])) fail("K306", place, "finite numbers", `${floats[i]} at ${i}`);
}

function checkCount(found, expected, place) {
  check(found === expected, "K318", place, expected, found);
}

/**
 * @param {Uint8Array} bytes of WNDW
 * @param {{vertices: number, triangles: number, levels: number, strict: boolean}} base level 0, and the number of levels
 * @returns {WindowView}
 */
export function readWindow(bytes, base) {
  const slicer = new Slicer(bytes, "WNDW", base.strict);
  const header = slicer.header(WINDOW);
  const { vertices, collapses, baseVertices, flags } = header;
  checkCount(vertices, base.vertices, "WNDW.vertices");
  checkCount(header.triangles, base.triangles, "WNDW.triangles");
  check(collapses <= vertices && baseVertices <= vertices, "K318", "WNDW.collapses", `at most ${vertices}`, collapses);
  check(flags <= 1, "K307", "WNDW.flags", "bit 0 only", flags);
  const checkpoints = slicer.checkpoints(header.checkpointCount, 0, collapses, base.levels);
  const parents = slicer.array(Uint32Array, vertices);
  const starts = flags & 1 ? slicer.array(Uint32Array, Math.ceil(vertices / 32)) : null;
  slicer.finish();
  const window = { vertices, triangles: header.triangles, collapses, baseVertices, checkpoints, parents, starts };
  checkPoints(window);
  return window;
}

/** Starts are bits of vertices, D points lie at and behind the base vertices, and parents before their children's points. */
function checkPoints(window) {
  const { vertices, collapses, baseVertices, parents, starts } = window;
  if (starts) {
    const spare = vertices % 32 === 0 ? 0 : starts[starts.length - 1] >>> (vertices % 32);
    check(spare === 0 && (vertices === 0 || starts[0] & 1), "K320", "WNDW.starts", "bit 0, and none behind the vertices", "others");
  }
  check(baseVertices === vertices || isStart(window, baseVertices), "K320", "WNDW.base_vertices", "the start of a point", baseVertices);
  let [own, points] = [0, 0];
  for (let v = 0; v < vertices; v++) {
    if (isStart(window, v)) {
      own = v;
      if (v >= baseVertices) points += 1;
    }
    const holds = v < baseVertices ? parents[v] === v : parents[v] < own;
    if (!holds) fail("K321", `WNDW.parents[${v}]`, v < baseVertices ? v : `below ${own}`, parents[v]);
  }
  check(points === collapses, "K320", "WNDW.collapses", `${points} points behind the base`, collapses);
}

const isStart = (window, v) => window.starts === null || ((window.starts[v >>> 5] >>> (v & 31)) & 1) === 1;

const bitCount = (x) => {
  let count = 0;
  for (; x !== 0; x &= x - 1) count += 1;
  return count;
};

/**
 * v(d): vertices alive at LOD d, which is the first vertex of the earliest of the last d points.
 * @param {WindowView} window
 * @param {number} d collapses done, 0 the finest; more than there are count as all
 */
export function aliveVertices(window, d) {
  const gone = Math.min(Math.max(0, Math.floor(d)), window.collapses);
  if (gone === 0) return window.vertices;
  if (window.starts === null) return window.vertices - gone;
  let left = gone;
  for (let word = window.starts.length - 1; word >= 0; word--) {
    const count = bitCount(window.starts[word]);
    if (count < left) {
      left -= count;
      continue;
    }
    for (let bit = 31; bit >= 0; bit--) {
      if ((window.starts[word] >>> bit) & 1 && --left === 0) return word * 32 + bit;
    }
  }
  return 0;
}

/**
 * The vertex that vertex `i` picks while `v` vertices are alive.
 * @param {WindowView} window
 * @param {number} i
 * @param {number} v {@link aliveVertices}
 */
export function pickWindow(window, i, v) {
  const floor = Math.max(v, window.baseVertices);
  while (i >= floor) i = window.parents[i];
  return i;
}

/** Whether two vertices belong to one point. */
function isSamePoint(window, a, b) {
  const [least, greatest] = a < b ? [a, b] : [b, a];
  for (let v = least + 1; v <= greatest; v++) if (isStart(window, v)) return false;
  return true;
}

/**
 * Triangles of a draw range of level 0 that are alive while `v` vertices are: they stand first, so bisection finds the last.
 * @param {WindowView} window
 * @param {Uint16Array | Uint32Array} indices level 0's
 * @param {import("./tables.mjs").Range} range
 * @param {number} v {@link aliveVertices}
 */
export function countAlive(window, indices, range, v) {
  const isAlive = (triangle) => {
    const [a, b, c] = [0, 1, 2].map((k) => pickWindow(window, indices[range.firstIndex + 3 * triangle + k], v));
    return !isSamePoint(window, a, b) && !isSamePoint(window, b, c) && !isSamePoint(window, c, a);
  };
  let [low, high] = [0, range.indexCount / 3];
  while (low < high) {
    const middle = (low + high) >>> 1;
    if (isAlive(middle)) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Header, checkpoints, row starts and face counts that TREE and CTRE share. */
function readTree(bytes, name, base) {
  const slicer = new Slicer(bytes, name, base.strict);
  const header = slicer.header(TREE);
  const { nodes, vertices, rows, checkpointCount } = header;
  checkCount(vertices, base.vertices, `${name}.vertices`);
  check(nodes >= 1 && nodes <= MAX_TEXELS * 256, "K318", `${name}.nodes`, "at least 1", nodes);
  check(rows >= 1 && rows <= 64, "K318", `${name}.rows`, "1 to 64", rows);
  const checkpoints = slicer.checkpoints(checkpointCount, nodes, 0, base.levels);
  const rowStarts = slicer.array(Uint32Array, rows + 1, 4);
  const rise = rowStarts.every((start, row) => row === 0 ? start === 0 : start >= rowStarts[row - 1]);
  check(rise && rowStarts[rows] === nodes, "K323", `${name}.row_starts`, `0, rising to ${nodes}`, rowStarts.join(" "));
  const faceCounts = slicer.array(Uint32Array, nodes + 1);
  const growing = faceCounts.every((count, t) => t === 0 || count >= faceCounts[t - 1]);
  check(growing && faceCounts[nodes] === base.triangles, "K326", `${name}.face_counts`, `rising to ${base.triangles}`, faceCounts[nodes]);
  return { slicer, header, view: { nodes, vertices, rows, checkpoints, rowStarts, faceCounts } };
}

/**
 * @param {Uint8Array} treeBytes of TREE
 * @param {Uint8Array} leafBytes of LEAF
 * @param {{vertices: number, triangles: number, levels: number, strict: boolean}} base
 * @returns {TreeLeafView}
 */
export function readTreeLeaf(treeBytes, leafBytes, base) {
  const { slicer, header, view } = readTree(treeBytes, "TREE", base);
  const { columns, width } = header;
  check(columns >= 1 && width >= 1 && width <= 8192, "K318", "TREE.width", "1 to 8192, and columns", `${width} and ${columns}`);
  const texels = width * view.rows * Math.ceil(columns / width);
  check(texels <= MAX_TEXELS, "K318", "TREE.texels", `at most ${MAX_TEXELS}`, texels);
  const tree = slicer.array(Float32Array, texels * 4);
  slicer.finish();
  checkFinite(tree, "TREE.texels");
  const leaves = new Slicer(leafBytes, "LEAF", base.strict);
  const leaf = leaves.array(Float32Array, view.vertices * 4, 1);
  leaves.finish();
  checkFinite(leaf, "LEAF");
  for (let v = 0; v < view.vertices; v++) {
    const texel = leaf[4 * v + 3];
    const column = Math.floor(texel / (width * view.rows)) * width + (texel % width);
    const holds = Number.isInteger(texel) && texel >= 0 && texel < texels && column < columns;
    if (!holds) fail("K325", `LEAF[${v}]`, `a texel of ${columns} columns`, texel);
  }
  return { ...view, columns, width, tree, leaf };
}

/**
 * The row and the part of it of the r_level at a threshold: of node `threshold - 1`, 0 for threshold 0. The part is below 1.
 * @param {TreeLeafView | CompactTreeView} tree
 * @param {number} threshold 0 to N
 * @returns {{row: number, part: number}}
 */
export function treeLevel(tree, threshold) {
  const rank = Math.min(threshold, tree.nodes) - 1;
  if (rank < 0) return { row: 0, part: 0 };
  let row = 0;
  while (row + 1 < tree.rows && tree.rowStarts[row + 1] <= rank) row += 1;
  const [k, n] = [rank - tree.rowStarts[row] + 1, tree.rowStarts[row + 1] - tree.rowStarts[row]];
  return k === n ? { row: row + 1, part: 0 } : { row, part: Math.fround(k / n) };
}

/**
 * The texel that a vertex picks, or -1 where it picks its leaf. At most three reads.
 * @param {TreeLeafView} tree
 * @param {number} vertex
 * @param {{row: number, part: number}} wanted {@link treeLevel}
 */
export function pickTreeLeaf(tree, vertex, wanted) {
  const terminal = tree.leaf[4 * vertex + 3];
  const terminalRow = Math.floor(terminal / tree.width) % tree.rows;
  if (wanted.row > terminalRow) return -1;
  if (wanted.row === terminalRow) return tree.tree[4 * terminal + 3] > wanted.part ? terminal : -1;
  const texel = terminal + (wanted.row - terminalRow) * tree.width;
  return tree.tree[4 * texel + 3] > wanted.part ? texel : texel + tree.width;
}

/**
 * @param {Uint8Array} bytes of CTRE
 * @param {{vertices: number, triangles: number, levels: number, strict: boolean}} base
 * @returns {CompactTreeView}
 */
export function readCompactTree(bytes, base) {
  const { slicer, header, view } = readTree(bytes, "CTRE", base);
  check(header.columns === 0 && header.width === 0, "K318", "CTRE.columns", 0, header.columns);
  const positions = slicer.array(Float32Array, view.nodes * 4);
  const parents = new Uint32Array(positions.buffer, positions.byteOffset, positions.length);
  const terminals = slicer.array(Uint32Array, view.vertices);
  slicer.finish();
  for (let node = 0; node < view.nodes; node++) {
    const parent = parents[4 * node + 3];
    if (node === 0 ? parent !== 0 : parent >= node) fail("K323", `CTRE.nodes[${node}].parent`, `below ${node}`, parent);
    for (let k = 0; k < 3; k++) {
      const x = positions[4 * node + k];
      if (!Number.isFinite(x)) fail("K306", `CTRE.nodes[${node}]`, "finite numbers", x);
    }
  }
  const astray = terminals.findIndex((node) => node >= view.nodes);
  check(astray < 0, "K325", `CTRE.terminals[${astray}]`, `below ${view.nodes}`, terminals[astray]);
  return { ...view, positions, parents, terminals };
}

/**
 * The rank of the node that a vertex picks, or -1 where it picks itself.
 * @param {CompactTreeView} tree
 * @param {number} vertex
 * @param {number} threshold 0 to N
 */
export function pickCompactTree(tree, vertex, threshold) {
  let node = tree.terminals[vertex];
  if (node < threshold) return -1;
  while (node > 0 && tree.parents[4 * node + 3] >= threshold) node = tree.parents[4 * node + 3];
  return node;
}

/**
 * @param {Uint8Array} bytes of CLUS
 * @param {{vertices: number, triangles: number, submeshes: number, strict: boolean}} base
 * @returns {ClusterView}
 */
export function readClusters(bytes, base) {
  const slicer = new Slicer(bytes, "CLUS", base.strict);
  const { clusterCount, groupCount, levels, referenceCount, triangles, vertices } = slicer.header(CLUSTERS);
  checkCount(vertices, base.vertices, "CLUS.vertices");
  const clusters = slicer.array(Uint32Array, clusterCount * 16);
  const groups = slicer.array(Float32Array, groupCount * 8);
  const references = slicer.array(Uint32Array, referenceCount);
  const corners = slicer.array(Uint8Array, triangles * 3);
  slicer.finish();
  const view = {
    clusterCount, groupCount, levels, triangles, vertices, clusters,
    clusterFloats: new Float32Array(clusters.buffer, clusters.byteOffset, clusters.length), groups,
    groupWords: new Uint32Array(groups.buffer, groups.byteOffset, groups.length), references, corners,
  };
  checkGroups(view);
  checkClusters(view, base.submeshes);
  return view;
}

function checkGroups({ clusterCount, groupCount, levels, groups, groupWords }) {
  let [next, level] = [0, 0];
  for (let g = 0; g < groupCount; g++) {
    const [first, count, own] = groupWords.subarray(8 * g + 5, 8 * g + 8);
    const at = () => `CLUS.groups[${g}]`;
    checkFinite(groups.subarray(8 * g, 8 * g + 5), at);
    const isNext = own === level || (g > 0 && own === level + 1);
    const holds = first === next && count >= 1 && isNext && own < levels;
    if (!holds) fail("K327", at, `clusters from ${next}, by level`, `${count} from ${first}`);
    if (!(groups[8 * g + 4] >= 0)) fail("K330", at, "an error of 0 or more", groups[8 * g + 4]);
    [next, level] = [first + count, own];
  }
  check(next === clusterCount, "K327", "CLUS.groups", `${clusterCount} clusters in all`, next);
}

function checkClusters(view, submeshes) {
  const { clusterCount, groups, groupWords, clusters, clusterFloats, references, corners, triangles, vertices } = view;
  let [reference, triangle, inGroup] = [0, 0, 0];
  for (let c = 0; c < clusterCount; c++) {
    const [firstReference, count, firstTriangle, own, submesh, group, madeBy, level] = clusters.subarray(16 * c, 16 * c + 8);
    const at = () => `CLUS.clusters[${c}]`;
    checkFinite(clusterFloats.subarray(16 * c + 8, 16 * c + 16), at);
    const isInside = firstReference === reference && count >= 1 && count <= 256 && reference + count <= references.length
      && firstTriangle === triangle && own >= 1 && own <= 128 && triangle + own <= triangles;
    if (!isInside) fail("K327", at, `1 to 256 vertices from ${reference}, 1 to 128 triangles from ${triangle}`, `${count} and ${own}`);
    if (submesh >= submeshes) fail("K328", at, `a submesh below ${submeshes}`, submesh);
    while (c >= groupWords[8 * inGroup + 5] + groupWords[8 * inGroup + 6]) inGroup += 1;
    const isMade = level === 0 ? madeBy === NONE : madeBy < group;
    if (group !== inGroup || level !== groupWords[8 * group + 7] || !isMade) {
      fail("K329", at, `group ${inGroup} and its level`, `group ${group}, level ${level}, made by ${madeBy}`);
    }
    if (level > 0 && groups[8 * madeBy + 4] > groups[8 * group + 4]) fail("K330", at, "an error not below its maker's", "less");
    for (let i = reference; i < reference + count; i++) {
      if (references[i] >= vertices) fail("K328", at, `references below ${vertices}`, references[i]);
    }
    for (let i = 3 * triangle; i < 3 * (triangle + own); i++) {
      if (corners[i] >= count) fail("K328", at, `corners below ${count}`, corners[i]);
    }
    [reference, triangle] = [reference + count, triangle + own];
  }
  const isAll = reference === references.length && triangle === triangles;
  check(isAll, "K327", "CLUS", `${reference} references and ${triangle} triangles`, `${references.length} and ${triangles}`);
}

/**
 * The numbers of the clusters to draw.
 * @param {ClusterView} view
 * @param {number | ((x: number, y: number, z: number, radius: number) => number)} allowed error that is allowed, object units: one for
 *   all, or by a group's sphere (`allowedForEye`)
 * @returns {Uint32Array}
 */
export function selectClusters(view, allowed) {
  const { clusterCount, groupCount, groups, clusters } = view;
  const allowedOf = typeof allowed === "function" ? allowed : () => allowed;
  const isCoarse = new Uint8Array(groupCount);
  for (let g = 0; g < groupCount; g++) {
    const at = 8 * g;
    const error = groups[at + 4];
    const most = allowedOf(groups[at], groups[at + 1], groups[at + 2], groups[at + 3]);
    isCoarse[g] = error === ROOT_ERROR || error > most ? 1 : 0;
  }
  const drawn = new Uint32Array(clusterCount);
  let count = 0;
  for (let c = 0; c < clusterCount; c++) {
    const [group, madeBy] = [clusters[16 * c + 5], clusters[16 * c + 6]];
    if (isCoarse[group] && (madeBy === NONE || !isCoarse[madeBy])) drawn[count++] = c;
  }
  return drawn.subarray(0, count);
}

/**
 * Indices of level 0's vertices that draw a cluster, appended to `out`.
 * @param {ClusterView} view
 * @param {number} cluster
 * @param {number[]} out
 */
export function clusterIndices(view, cluster, out) {
  const [firstReference, , firstTriangle, count] = view.clusters.subarray(16 * cluster, 16 * cluster + 4);
  for (let i = 3 * firstTriangle; i < 3 * (firstTriangle + count); i++) out.push(view.references[firstReference + view.corners[i]]);
}
