// node kaitai.mjs FILE.kiln...   compiles ../../formats/kiln.ksy to JavaScript and prints, a line a file, the summary that
// `kiln inspect FILE --json` prints, from the generated parser alone.

import { createRequire } from "node:module";
import { readFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";
import KaitaiStream from "kaitai-struct/KaitaiStream.js";
import compiler from "kaitai-struct-compiler";
import { decompress } from "fzstd";
import { parse } from "yaml";

/** The generated parser and its enums: `Kiln.Level`, `Kiln.Texture.Channel` and so on. */
export async function compiled() {
  const description = parse(await readFile(fileURLToPath(new URL("../../formats/kiln.ksy", import.meta.url)), "utf8"));
  const files = await compiler.compile("javascript", description, { importYaml: () => Promise.reject(new Error("no imports")) }, false);
  const module = { exports: {} };
  const require = createRequire(import.meta.url);
  const run = new Function("module", "exports", "require", files["Kiln.js"]);
  run(module, module.exports, require);
  return module.exports.Kiln ?? module.exports;
}

/** The shortest decimal that rounds to the same f32. */
function shortest(x) {
  for (let digits = 1; digits < 9; digits++) {
    const value = Number(x.toPrecision(digits));
    if (Math.fround(value) === x) return value;
  }
  return Number(x.toPrecision(9));
}

const hex = (bytes) => Buffer.from(bytes).toString("hex");
const sum = (list) => list.reduce((total, x) => total + x, 0);
const point = (p) => [p.x, p.y, p.z].map(shortest);
/** An enum's name as the page writes it. */
const named = (names, value) => (names[value] ?? `codec ${value}`).toLowerCase().replaceAll("_", "-");

const ROLES = ["base-color", "metallic-roughness", "normal", "occlusion", "emissive"];
const EXTRAS = [
  "height", "position", "object-normal", "object-id", "material-id", "curvature", "ambient-occlusion", "bent-normal", "opacity", "coverage",
];

/** The summary of a file by the generated parser `Kiln`. */
export function summary(Kiln, bytes) {
  const file = new Kiln(new KaitaiStream(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength)));
  const { header, sections, tables } = file;
  const { levels, submeshes, provenance } = tables;
  return {
    version: `${header.major}.${header.minor}`,
    file_length: header.fileLength,
    source_triangles: levels.sourceTriangles,
    sheets: levels.hasLayout ? Math.max(1, levels.levels[0].layoutSheets) : 0,
    sections: sections.map((s, number) => ({
      number, kind: s.kind, version: s.version, required: s.isRequired, codec: named(Kiln.Section.Codec, s.codec), alignment: s.alignment,
      offset: s.offset, stored_length: s.storedLength, raw_length: s.rawLength, raw_hash: hex(s.rawHash),
    })),
    levels: levels.levels.map((level, lod) => levelSummary(Kiln, file, level, lod)),
    submeshes: submeshes.submeshes.map((s) => ({
      name: s.name.text, material: s.hasMaterial ? s.material : null, source_triangles: s.sourceTriangles,
    })),
    materials: tables.materials.materials.map((m) => ({
      name: m.name.text, alpha_mode: named(Kiln.Material.AlphaMode, m.alphaMode), double_sided: m.isDoubleSided,
      textures: ROLES.map((role, k) => [role, m.slots[k]]).filter(([, slot]) => slot.isUsed).map(([role, slot]) => [role, slot.texture]),
    })),
    textures: tables.textures.textures.map((t) => textureSummary(Kiln, t)),
    provenance: tables.hasProvenance ? {
      pipeline: hex(provenance.pipeline), tool: provenance.tool.text, numeric_class: provenance.numericClass.text,
      device_class: provenance.deviceClass.text, inputs: provenance.inputs.map((i) => [i.name.text, hex(i.hash)]),
      stages: provenance.stages.map((s) => [s.name.text, s.version.text]),
    } : null,
    layouts: layoutSummaries(Kiln, sections),
  };
}

function levelSummary(Kiln, { sections, tables }, level, lod) {
  const bytes = sections[level.vertexSection].storedLength + sections[level.indexSection].storedLength;
  const needs = tables.levels.needs.slice(level.firstNeed, level.firstNeed + level.needCount).map((n) => sections[n]);
  const count = tables.submeshes.submeshCount;
  const ranges = tables.submeshes.ranges.slice(lod * count, (lod + 1) * count);
  return {
    lod, triangles: level.triangles, vertices: level.vertices, error: shortest(level.error),
    error_kind: named(Kiln.Level.ErrorKind, level.errorKind), bytes,
    bytes_per_triangle: level.triangles > 0 ? bytes / level.triangles : null,
    prefix_bytes: Math.max(0, ...needs.map((s) => s.offset + s.storedLength)), index_width: level.indexWidth,
    arrays: level.arrays.map(({ record: a }) => `${named(Kiln.Array.Semantic, a.semantic)} ${named(Kiln.Array.VertexFormat, a.format)}`),
    bounds_min: point(level.boundsMin), bounds_max: point(level.boundsMax), submesh_triangles: ranges.map((r) => r.indexCount / 3),
  };
}

function textureSummary(Kiln, t) {
  const lengths = t.mips.map((mip) => mip.record.length);
  const isExtra = t.roles !== 0 && (t.roles & (t.roles - 1)) === 0;
  return {
    name: t.name.text, width: t.width, height: t.height, format: named(Kiln.Texture.TextureFormat, t.format),
    roles: ROLES.filter((_, k) => (t.roles >> k) & 1), extra: (isExtra && EXTRAS[Math.log2(t.roles) - 5]) || null, sheet: t.sheet,
    channels: t.channels.map((c) => named(Kiln.Texture.Channel, c)), mips: t.mipCount, bytes: sum(lengths),
    tail_bytes: sum(lengths.slice(t.tailFirst)),
  };
}

/** A layout section, parsed; decoded first where it is coded. */
function bodyOf(type, section) {
  return section.body ?? new type(new KaitaiStream(decompress(section.stored).slice().buffer));
}

function layoutSummaries(Kiln, sections) {
  const of = (kind) => sections.find((s) => s.kind === kind);
  const types = { WNDW: Kiln.Window, TREE: Kiln.Tree, CTRE: Kiln.CompactTree, CLUS: Kiln.Clusters };
  const entry = (name, kinds, details) => of(kinds[0]) && {
    name, bytes: sum(kinds.map((kind) => of(kind).storedLength)), ...details(bodyOf(types[kinds[0]], of(kinds[0]))),
  };
  const checkpoints = (list) => list.map((c) => ({
    detail: c.detail, vertices: c.vertices, triangles: c.triangles, error: shortest(c.error), level: c.hasLevel ? c.level : null,
  }));
  const tree = ({ header }) => ({
    details: header.nodes, triangles: header.lastFaceCount, checkpoints: checkpoints(header.checkpoints),
  });
  return [
    entry("sliding-window", ["WNDW"], (w) => ({ details: w.collapses, triangles: w.triangles, checkpoints: checkpoints(w.checkpoints) })),
    entry("tree-leaf", ["TREE", "LEAF"], tree),
    entry("compact-tree", ["CTRE"], tree),
    entry("clusters", ["CLUS"], (c) => ({ details: c.clusterCount, triangles: c.triangles, checkpoints: [] })),
  ].filter(Boolean);
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const Kiln = await compiled();
  for (const path of process.argv.slice(2)) console.log(JSON.stringify(summary(Kiln, await readFile(path))));
}
