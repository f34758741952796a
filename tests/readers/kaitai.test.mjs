// The parser that kiln.ksy describes against the reader in formats/js, on containers assembled by hand.

import assert from "node:assert/strict";
import { test } from "node:test";
import KaitaiStream from "kaitai-struct/KaitaiStream.js";
import { openContainer } from "../../formats/js/kiln.mjs";
import { summary as expectedSummary } from "../../formats/js/summary.mjs";
import { CLUSTERS, COMPACT, LEAF, TREE, TREE_INDICES, WINDOW, assemble, small } from "../../formats/js/testing.mjs";
import { compiled, summary } from "./kaitai.mjs";

const Kiln = await compiled();
const WINDOWED = assemble([...small(), WINDOW, CLUSTERS, { kind: "mine", bytes: Uint8Array.of(1, 2, 3) }]);
const TREES = assemble([...small(TREE_INDICES), TREE, LEAF, COMPACT]);
const parse = (file) => new Kiln(new KaitaiStream(file.slice().buffer));
const body = (file, kind) => parse(file).sections.find((s) => s.kind === kind).body;
const flat = (points) => points.flatMap((p) => [p.x, p.y, p.z, p.w]);

test("summaries are equal, layouts included", () => {
  for (const file of [WINDOWED, TREES]) assert.deepEqual(summary(Kiln, file), expectedSummary(openContainer(file)));
});

test("arrays, indices and mips are the same bytes", () => {
  const file = parse(WINDOWED);
  const container = openContainer(WINDOWED);
  const level = file.tables.levels.levels[0];
  const { positions, indices } = container.level(0);
  const bytesOf = (array) => new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
  assert.deepEqual(level.arrays[0].values, bytesOf(positions));
  assert.deepEqual(level.indices, bytesOf(indices));
  assert.deepEqual(file.tables.textures.textures[0].mips[1].texels, container.mip(0, 1).texels);
  assert.deepEqual(file.sections.at(-1).body, Uint8Array.of(1, 2, 3));
});

test("layouts are the same arrays", () => {
  const { window, clusters } = openContainer(WINDOWED).layouts;
  const w = body(WINDOWED, "WNDW");
  assert.deepEqual(w.parents, Array.from(window.parents));
  assert.deepEqual(w.starts, Array.from(window.starts));
  const c = body(WINDOWED, "CLUS");
  assert.deepEqual(c.references, Array.from(clusters.references));
  assert.deepEqual(c.corners, clusters.corners.slice());
  const words = (k) => [k.firstReference, k.vertexCount, k.firstTriangle, k.triangleCount, k.submesh, k.group, k.madeBy, k.level];
  assert.deepEqual(c.clusters.map(words), [0, 1, 2].map((k) => Array.from(clusters.clusters.slice(16 * k, 16 * k + 8))));
  assert.deepEqual(flat(c.clusters.map((k) => k.sphere)), [0, 1, 2].flatMap((k) => Array.from(clusters.clusterFloats.slice(16 * k + 8, 16 * k + 12))));
  assert.deepEqual(c.groups.map((g) => [g.error, g.firstCluster, g.clusterCount, g.level]), [[0.5, 0, 2, 0], [3.4028234663852886e38, 2, 1, 1]]);

  const { treeLeaf, compactTree } = openContainer(TREES).layouts;
  const tree = body(TREES, "TREE");
  assert.deepEqual(flat(tree.texels), Array.from(treeLeaf.tree));
  assert.deepEqual(tree.header.rowStarts, Array.from(treeLeaf.rowStarts));
  assert.deepEqual(tree.header.faceCounts, Array.from(treeLeaf.faceCounts));
  assert.deepEqual(flat(body(TREES, "LEAF").leaves), Array.from(treeLeaf.leaf));
  const compact = body(TREES, "CTRE");
  assert.deepEqual(compact.nodes.map((n) => n.parent), [0, 1, 2, 3].map((n) => compactTree.parents[4 * n + 3]));
  assert.deepEqual(compact.nodes.map((n) => n.position.x), [50, 51, 52, 53]);
  assert.deepEqual(compact.terminals, Array.from(compactTree.terminals));
});

test("a file that is none, cut or of another major version is refused", () => {
  for (const change of [(f) => f.fill(0, 0, 1), (f) => f.fill(2, 12, 13), (f) => f.subarray(0, f.length - 1)]) {
    assert.throws(() => parse(change(TREES.slice())));
  }
});
