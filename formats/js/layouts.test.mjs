// Layouts assembled by hand; what each vertex must pick is worked out on paper.

import assert from "node:assert/strict";
import { test } from "node:test";
import {
  KilnError, aliveVertices, clusterIndices, countAlive, openContainer, pickCompactTree, pickTreeLeaf, pickWindow, selectClusters, treeLevel,
} from "./kiln.mjs";
import { A, B, C, CLUSTERS, COMPACT, LEAF, POSITIONS, ROOT, TREE, TREE_INDICES, WINDOW, assemble, small } from "./testing.mjs";

const vertices = [0, 1, 2, 3, 4, 5];
const place = (v) => Array.from(POSITIONS.slice(3 * v, 3 * v + 3));

/** What the six vertices pick at thresholds 0 to 4: a node's position, or their own. */
const PICKS = [
  [ROOT, ROOT, ROOT, ROOT, ROOT, ROOT],
  [A, A, B, B, B, place(5)],
  [place(0), place(1), B, B, B, place(5)],
  [place(0), place(1), place(2), C, C, place(5)],
  vertices.map(place),
];

test("a window's picks and prefixes are those of its points", () => {
  const container = openContainer(assemble([...small(), WINDOW]));
  const { window } = container.layouts;
  const { indices, ranges } = container.level(0);
  assert.deepEqual([0, 1, 2, 3].map((d) => aliveVertices(window, d)), [6, 5, 3, 3]);
  assert.deepEqual(vertices.map((i) => pickWindow(window, i, 6)), vertices);
  assert.deepEqual(vertices.map((i) => pickWindow(window, i, 5)), [0, 1, 2, 3, 4, 3]);
  assert.deepEqual(vertices.map((i) => pickWindow(window, i, 3)), [0, 1, 2, 2, 2, 2]);
  assert.deepEqual([6, 5, 3].map((v) => countAlive(window, indices, ranges[0], v)), [4, 3, 2]);
  assert.deepEqual(window.checkpoints.map((c) => [c.detail, c.triangles, c.level]), [[0, 4, 0], [1, 3, null], [2, 2, null]]);
});

test("a window without starts counts vertices as points", () => {
  const window = { vertices: 40, collapses: 39, baseVertices: 1, starts: null, parents: Uint32Array.from({ length: 40 }, (_, i) => Math.max(0, i - 1)) };
  assert.equal(aliveVertices(window, 7), 33);
  assert.equal(pickWindow(window, 39, 5), 4);
  // The same points said with bits, over more than one word.
  const flagged = { ...window, starts: Uint32Array.of(0xffffffff, 0xff) };
  for (let d = 0; d <= 39; d++) assert.equal(aliveVertices(flagged, d), 40 - d);
});

test("tree and leaf buffer and the compact tree pick the same", () => {
  const { treeLeaf, compactTree } = openContainer(assemble([...small(TREE_INDICES), TREE, LEAF, COMPACT])).layouts;
  PICKS.forEach((expected, threshold) => {
    const wanted = treeLevel(treeLeaf, threshold);
    vertices.forEach((vertex) => {
      const texel = pickTreeLeaf(treeLeaf, vertex, wanted);
      const found = texel < 0 ? treeLeaf.leaf.slice(4 * vertex, 4 * vertex + 3) : treeLeaf.tree.slice(4 * texel, 4 * texel + 3);
      assert.deepEqual(Array.from(found), expected[vertex], `vertex ${vertex} at ${threshold}`);
      const node = pickCompactTree(compactTree, vertex, threshold);
      const position = node < 0 ? place(vertex) : Array.from(compactTree.positions.slice(4 * node, 4 * node + 3));
      assert.deepEqual(position, expected[vertex], `vertex ${vertex} at ${threshold}, compact`);
    });
  });
});

test("a tree's face counts are the triangles with three different picks", () => {
  const { compactTree: tree } = openContainer(assemble([...small(TREE_INDICES), COMPACT])).layouts;
  const picks = (threshold) => vertices.map((v) => {
    const node = pickCompactTree(tree, v, threshold);
    return node < 0 ? `leaf ${v}` : node;
  });
  for (let threshold = 0; threshold <= tree.nodes; threshold++) {
    const picked = picks(threshold);
    const alive = [0, 3, 6, 9].filter((at) => new Set([0, 1, 2].map((k) => picked[TREE_INDICES[at + k]])).size === 3);
    assert.equal(alive.length, tree.faceCounts[threshold], `threshold ${threshold}`);
  }
});

test("clusters are drawn on one side of the allowed error", () => {
  const { clusters } = openContainer(assemble([...small(), CLUSTERS])).layouts;
  const drawn = (allowed) => Array.from(selectClusters(clusters, allowed));
  assert.deepEqual(drawn(0), [0, 1]);
  assert.deepEqual(drawn(0.49), [0, 1]);
  assert.deepEqual(drawn(0.5), [2]);
  assert.deepEqual(drawn(Infinity), [2], "the root goes on for ever");
  assert.deepEqual(drawn((x, y, z, radius) => radius), [2]);
  const indices = [];
  for (const cluster of drawn(0)) clusterIndices(clusters, cluster, indices);
  assert.deepEqual(indices, [0, 1, 2, 0, 1, 5, 0, 2, 4, 1, 3, 5]);
});

test("layouts that would lead a reader astray are refused", () => {
  const refuses = (section, at, value, code, indices) => {
    const bytes = section.bytes.slice();
    new DataView(bytes.buffer).setUint32(at, value, true);
    const others = section === TREE ? [LEAF] : [];
    const before = section === LEAF ? [TREE] : [];
    const container = openContainer(assemble([...small(indices), ...before, { ...section, bytes }, ...others]));
    assert.throws(() => container.layouts, (error) => error instanceof KilnError && error.code === code, `${section.kind} at ${at}`);
  };
  const parents = 256;
  refuses(WINDOW, parents + 4 * 4, 3, "K321");
  refuses(WINDOW, parents + 4 * 5, 5, "K321");
  refuses(WINDOW, parents, 1, "K321");
  refuses(WINDOW, parents + 256, 0b1101111, "K320");
  refuses(WINDOW, 8, 3, "K319");
  refuses(WINDOW, 16, 400, "K317");
  refuses(TREE, 0, 3, "K319", TREE_INDICES);
  refuses(TREE, 12, 1, "K325", TREE_INDICES);
  refuses(TREE, 128 + 4, 4, "K323", TREE_INDICES);
  refuses(TREE, 256, 2, "K326", TREE_INDICES);
  refuses(LEAF, 12, 0x41000000, "K325", TREE_INDICES);
  refuses(LEAF, 12, 0x40200000, "K325", TREE_INDICES);
  refuses(LEAF, 12, 0x7fc00000, "K306", TREE_INDICES);
  refuses(COMPACT, 512 + 3 * 16 + 12, 3, "K323", TREE_INDICES);
  refuses(COMPACT, 768, 4, "K325", TREE_INDICES);
  refuses(CLUSTERS, 768, 6, "K328");
  refuses(CLUSTERS, 256 + 24, 0, "K329");
  refuses(CLUSTERS, 256 + 4, 300, "K327");
  refuses(CLUSTERS, 512 + 20, 1, "K327");
  assert.throws(() => openContainer(assemble([...small(TREE_INDICES), TREE])).layouts, KilnError);
});
