// node summary.mjs [--decoders MODULE] FILE.kiln...   prints, a line a file, the summary that `kiln inspect FILE --json` prints, as JSON. Equal as values:
// numbers of 32 bits are printed as the shortest decimal that rounds to them. Exit status 2 at the first file that is not sound. The
// module's `decoders` decode coded sections; without it, files that have some are refused.

import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";
import { hex } from "./blake3.mjs";
import { openContainer } from "./kiln.mjs";
import { ROLES } from "./registry.mjs";

/** The shortest decimal that rounds to the same f32. */
export function shortest(x) {
  for (let digits = 1; digits < 9; digits++) {
    const value = Number(x.toPrecision(digits));
    if (Math.fround(value) === x) return value;
  }
  return Number(x.toPrecision(9));
}

const sum = (list) => list.reduce((total, x) => total + x, 0);

/** The summary of an opened container. */
export function summary(container) {
  const { sections, version, uvLayout, provenance } = container;
  return {
    version: `${version.major}.${version.minor}`,
    file_length: container.fileLength,
    source_triangles: container.sourceTriangles,
    sheets: uvLayout?.sheets ?? 0,
    sections: sections.map((s) => ({
      number: s.number, kind: s.kind, version: s.version, required: s.required, codec: s.codecName, alignment: s.alignment,
      offset: s.offset, stored_length: s.storedLength, raw_length: s.rawLength, raw_hash: hex(s.rawHash),
    })),
    levels: container.levels.map((level) => levelSummary(level, sections)),
    submeshes: container.submeshes.map((s) => ({ name: s.name, material: s.material, source_triangles: s.sourceTriangles })),
    materials: container.materials.map((m) => ({
      name: m.name, alpha_mode: m.alphaMode, double_sided: m.doubleSided,
      textures: ROLES.filter((role) => m.slots[role]).map((role) => [role, m.slots[role].texture]),
    })),
    textures: container.textures.map((t) => ({
      name: t.name, width: t.width, height: t.height, format: t.format, roles: t.roles, extra: t.extra, sheet: t.sheet,
      channels: t.channels, mips: t.mips.length, bytes: sum(t.mips.map((mip) => mip.length)),
      tail_bytes: sum(t.mips.slice(t.tailFirst).map((mip) => mip.length)),
    })),
    provenance: provenance && {
      pipeline: hex(provenance.pipeline), tool: provenance.tool, numeric_class: provenance.numericClass,
      device_class: provenance.deviceClass, inputs: provenance.inputs.map((i) => [i.name, hex(i.hash)]),
      stages: provenance.stages.map((s) => [s.name, s.version]),
    },
    layouts: layoutSummaries(container),
  };
}

function levelSummary(level, sections) {
  const bytes = sections[level.vertexSection].storedLength + sections[level.indexSection].storedLength;
  const ends = level.needs.map((number) => sections[number].offset + sections[number].storedLength);
  return {
    lod: level.lod, triangles: level.triangles, vertices: level.vertices, error: shortest(level.error), error_kind: level.errorKind,
    bytes, bytes_per_triangle: level.triangles > 0 ? bytes / level.triangles : null, prefix_bytes: ends.reduce((a, b) => Math.max(a, b), 0),
    index_width: level.indexWidth, arrays: level.arrays.filter((a) => !a.name.includes(" ")).map((a) => `${a.name} ${a.format}`),
    bounds_min: level.boundsMin.map(shortest), bounds_max: level.boundsMax.map(shortest),
    submesh_triangles: level.ranges.map((range) => range.indexCount / 3),
  };
}

function layoutSummaries({ layouts, sections }) {
  const { window, treeLeaf, compactTree, clusters } = layouts;
  const entry = (name, kinds, view, details, triangles) => view && {
    name, bytes: sum(sections.filter((s) => s.known && kinds.includes(s.kind)).map((s) => s.storedLength)), details, triangles,
    checkpoints: (view.checkpoints ?? []).map((c) => ({ ...c, error: shortest(c.error) })),
  };
  return [
    entry("sliding-window", ["WNDW"], window, window?.collapses, window?.triangles),
    entry("tree-leaf", ["TREE", "LEAF"], treeLeaf, treeLeaf?.nodes, treeLeaf?.faceCounts.at(-1)),
    entry("compact-tree", ["CTRE"], compactTree, compactTree?.nodes, compactTree?.faceCounts.at(-1)),
    entry("clusters", ["CLUS"], clusters, clusters?.clusterCount, clusters?.triangles),
  ].filter(Boolean);
}

async function main(paths) {
  let decoders = {};
  if (paths[0] === "--decoders") ({ decoders } = await import(pathToFileURL(paths[1])));
  for (const path of paths[0] === "--decoders" ? paths.slice(2) : paths) {
    try {
      const container = openContainer(await readFile(path), { decoders });
      container.validate();
      console.log(JSON.stringify(summary(container)));
    } catch (error) {
      console.error(`${path}: ${error.message}`);
      process.exitCode = 2;
      return;
    }
  }
}

if (process.argv[1] && import.meta.url === pathToFileURL(process.argv[1]).href) await main(process.argv.slice(2));
