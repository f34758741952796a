// The tables: levels, submeshes, materials, textures, provenance, with the checks of chapter 3 between them.

import { Cutter, align, check, record } from "./records.mjs";
import {
  ALPHA_MODES, CHANNELS, ERROR_KINDS, NONE, ROLES, SEMANTICS, TEXTURE_FORMATS, VERTEX_FORMATS, WRAPS, extraOf, mipLength,
} from "./registry.mjs";

/** Most vertices and triangles of a level. */
const MAX_ELEMENTS = 1431655764;

const COUNTS = record("count u32, reserved u8x12");
const LEVELS = record(
  "levels u32, arrays u32, needs u32, sourceTriangles u32, hasLayout u32, layoutSize u32, layoutPadding u32, layoutCharts u32");
const LEVEL = record(
  "triangles u32, vertices u32, error f32, errorKind u32, boundsMin f32x3, boundsMax f32x3, vertexSection u32, indexSection u32, "
  + "indexWidth u32, firstArray u32, arrayCount u32, firstNeed u32, needCount u32, sheets u32, reserved u8x24");
const ARRAY = record("semantic u32, format u32, offset u64, length u64, reserved u8x8");
const SUBMESHES = record("submeshes u32, levels u32, reserved u8x8");
const SUBMESH = record("name u32, material u32, attributes u32, sourceTriangles u32, reserved u8x16");
const RANGE = record(
  "firstIndex u32, indexCount u32, firstVertex u32, vertexCount u32, boundsMin f32x3, boundsMax f32x3, reserved u8x8");
const MATERIAL = record(
  "name u32, alphaMode u32, alphaCutoff f32, flags u32, baseColorFactor f32x4, emissiveFactor f32x3, metallicFactor f32, "
  + "roughnessFactor f32, normalScale f32, occlusionStrength f32, reserved u8x4");
const SLOT = record(
  "texture u32, uvSet u32, wrapU u8, wrapV u8, mag u8, min u8, mip u8, reserved u8x3, uvOffset f32x2, uvScale f32x2, "
  + "uvRotation f32, reserved u8x12");
const TEXTURES = record("textures u32, mips u32, reserved u8x8");
const TEXTURE = record(
  "name u32, format u32, roles u32, channels u8x4, width u32, height u32, mipCount u32, firstMip u32, tailFirst u32, "
  + "tailSection u32, sheet u32, reserved u8x20");
const MIP = record("width u32, height u32, section u32, reserved u8x4, offset u64, length u64");
const PROVENANCE = record("pipeline u8x32, inputs u32, stages u32, reserved u8x24");

/**
 * @typedef {object} Range what to draw of a submesh at a level
 * @property {number} firstIndex
 * @property {number} indexCount a multiple of 3
 * @property {number} firstVertex least index in it
 * @property {number} vertexCount greatest index minus least plus 1
 * @property {number[]} boundsMin
 * @property {number[]} boundsMax
 */

/**
 * @typedef {object} ArrayInfo a vertex array
 * @property {string} name such as `positions`; `semantic N` where a newer version's is not known
 * @property {string} format such as `f32x3`
 * @property {number} semantic
 * @property {number} offset in the VERT section, bytes
 * @property {number} length bytes
 */

/**
 * @typedef {object} Level
 * @property {number} lod 0 is the finest
 * @property {number} triangles
 * @property {number} vertices
 * @property {number} error distance to the source surface, object units
 * @property {"sampled" | "bound"} errorKind
 * @property {number[]} boundsMin
 * @property {number[]} boundsMax
 * @property {number} vertexSection
 * @property {number} indexSection
 * @property {2 | 4} indexWidth
 * @property {ArrayInfo[]} arrays
 * @property {number[]} needs numbers of the sections with which it can be drawn
 * @property {Range[]} ranges by submesh
 */

/**
 * @typedef {object} Submesh
 * @property {string} name
 * @property {number | null} material
 * @property {number} sourceTriangles
 */

/**
 * @typedef {object} Slot
 * @property {number} texture
 * @property {number} uvSet
 * @property {string} wrapU
 * @property {string} wrapV
 * @property {boolean} magLinear
 * @property {boolean} minLinear
 * @property {"none" | "nearest" | "linear"} mip
 * @property {number[]} uvOffset
 * @property {number[]} uvScale
 * @property {number} uvRotation radians
 */

/**
 * @typedef {object} Material
 * @property {string} name
 * @property {"opaque" | "mask" | "blend"} alphaMode
 * @property {number} alphaCutoff
 * @property {boolean} doubleSided
 * @property {number[]} baseColorFactor
 * @property {number[]} emissiveFactor
 * @property {number} metallicFactor
 * @property {number} roughnessFactor
 * @property {number} normalScale
 * @property {number} occlusionStrength
 * @property {Record<string, Slot | null>} slots by role: `base-color`, `metallic-roughness`, `normal`, `occlusion`, `emissive`
 */

/**
 * @typedef {object} MipInfo
 * @property {number} width
 * @property {number} height
 * @property {number} section
 * @property {number} offset
 * @property {number} length
 */

/**
 * @typedef {object} Texture
 * @property {string} name
 * @property {string} format
 * @property {number} formatNumber
 * @property {string[]} roles
 * @property {string | null} extra
 * @property {number} sheet
 * @property {string[]} channels
 * @property {number} width
 * @property {number} height
 * @property {number} tailFirst first mip in the tail
 * @property {number} tailSection
 * @property {MipInfo[]} mips largest first
 */

/**
 * @typedef {object} Provenance
 * @property {Uint8Array} pipeline
 * @property {string} tool
 * @property {string} numericClass
 * @property {string} deviceClass
 * @property {{name: string, hash: Uint8Array}[]} inputs
 * @property {{name: string, version: string}[]} stages
 */

/**
 * Reads all tables.
 * @param {import("./envelope.mjs").Section[]} sections
 * @param {(kind: string) => Uint8Array | null} table the bytes of the table of a kind
 * @param {boolean} strict whether reserved bytes must be zero
 * @param {number} minor
 */
export function readTables(sections, table, strict, minor) {
  const cutter = (kind) => new Cutter(table(kind), kind, strict);
  const strings = readStrings(cutter("STRS"));
  const context = { sections, strings, strict, minor };
  const versionOf = (kind) => sections.find((s) => s.kind === kind).version;
  const { levels, header } = readLevels(cutter("LEVL"), { ...context, isShared: versionOf("LEVL") >= 2 });
  const wide = versionOf("TEXT") >= 2;
  const textures = readTextures(cutter("TEXT"), wide, context);
  const materials = readMaterials(cutter("MATL"), textures, context);
  checkRoles(textures, materials, wide);
  const submeshes = readSubmeshes(cutter("SUBM"), levels, materials.length, context);
  const provenance = table("PROV") ? readProvenance(cutter("PROV")) : null;
  const uvLayout = header.hasLayout === 0 ? null : {
    size: header.layoutSize, padding: header.layoutPadding, charts: header.layoutCharts, sheets: Math.max(1, levels[0].sheets),
  };
  for (const level of levels) delete level.sheets;
  return { levels, submeshes, materials, textures, provenance, uvLayout, sourceTriangles: header.sourceTriangles };
}

function readStrings(table) {
  const { count } = table.one(COUNTS);
  // Every string takes at least the 4 bytes of its length.
  const most = Math.min(1 << 22, Math.floor((table.bytes.length - table.at) / 4));
  check(count <= most, "K302", "STRS.count", `at most ${most}`, count);
  const strings = Array.from({ length: count }, (_, i) => table.string(`strings[${i}]`));
  table.finish();
  return strings;
}

function stringOf({ strings }, number, place) {
  check(number < strings.length, "K304", place, `a string below ${strings.length}`, number);
  return strings[number];
}

function checkSection({ sections }, number, kind, place) {
  check(sections[number]?.kind === kind, "K304", place, `the number of a ${kind} section`, number);
}

function readLevels(table, context) {
  const header = table.one(LEVELS);
  check(header.levels >= 1 && header.levels <= 256, "K302", "LEVL.level_count", "1 to 256", header.levels);
  const layout = [header.layoutSize, header.layoutPadding, header.layoutCharts];
  check(header.hasLayout === 1 || (header.hasLayout === 0 && layout.every((x) => x === 0)),
    "K307", "LEVL.has_layout", "0 with zeros behind it, or 1", header.hasLayout);
  const levels = table.many(LEVEL, header.levels, (lod) => `levels[${lod}]`);
  const arrays = table.many(ARRAY, header.arrays, (i) => `arrays[${i}]`);
  const needs = table.words(header.needs);
  table.finish();
  let [firstArray, firstNeed, lastError] = [0, 0, 0];
  for (const [lod, level] of levels.entries()) {
    const at = (field) => () => `levels[${lod}].${field}`;
    check(level.error >= lastError, "K308", at("error"), `at least ${lastError}`, level.error);
    lastError = level.error;
    check(ERROR_KINDS[level.errorKind], "K307", at("error_kind"), "a registered error kind", level.errorKind);
    for (const key of ["triangles", "vertices"]) {
      check(level[key] <= MAX_ELEMENTS, "K302", at(key), `at most ${MAX_ELEMENTS}`, level[key]);
    }
    checkSection(context, level.vertexSection, "VERT", at("vertex_section"));
    checkSection(context, level.indexSection, "INDX", at("index_section"));
    const width = level.vertices <= 65535 ? 2 : 4;
    check(level.indexWidth === width, "K311", at("index_width"), width, level.indexWidth);
    check(level.firstArray === firstArray && level.firstNeed === firstNeed,
      "K304", at("first_array"), `array ${firstArray} and need ${firstNeed}`, `array ${level.firstArray} and need ${level.firstNeed}`);
    firstArray += level.arrayCount;
    firstNeed += level.needCount;
    check(firstArray <= arrays.length && firstNeed <= needs.length, "K304", at("first_array"), "arrays and needs inside", "more");
    const sheetsOk = level.sheets === 0 || (level.sheets > 1 && header.hasLayout === 1);
    check(sheetsOk && level.sheets === levels[0].sheets,
      "K307", at("layout_sheets"), "0 or, with a layout, the same number above 1 at every level", level.sheets);
    check(level.sheets === 0 || context.minor > 0, "K108", at("reserved"), "zero", "another value");
    const own = arrays.slice(level.firstArray, firstArray);
    levels[lod] = {
      lod, ...level, errorKind: ERROR_KINDS[level.errorKind], arrays: checkArrays(own, level, lod, levels, context),
      needs: needs.slice(level.firstNeed, firstNeed), ranges: [],
    };
    for (const need of levels[lod].needs) {
      check(need < context.sections.length, "K304", at("needs"), `a section below ${context.sections.length}`, need);
    }
    const stored = context.sections[level.indexSection].rawLength;
    const length = 3 * level.triangles * level.indexWidth;
    check(stored === length, "K313", at("index_section"), `${length} bytes`, stored);
    for (const key of ["firstArray", "arrayCount", "firstNeed", "needCount"]) delete levels[lod][key];
  }
  check(firstArray === arrays.length && firstNeed === needs.length, "K304", "LEVL",
    `${firstArray} arrays and ${firstNeed} needs in all`, `${arrays.length} and ${needs.length}`);
  return { levels, header };
}

/**
 * Arrays tile their section: semantics ascending, positions first, each on a multiple of 256. Since version 2 of the table they may
 * be the first elements of level 0's instead.
 */
function checkArrays(arrays, level, lod, levels, { sections, strict, isShared }) {
  if (isShared && lod > 0 && level.vertexSection === levels[0].vertexSection) return checkShared(arrays, level, lod, levels[0]);
  const stored = sections[level.vertexSection].rawLength;
  let [end, last] = [0, 0];
  const checked = arrays.map((array, number) => {
    const at = () => `levels[${lod}].arrays[${number}]`;
    const semantic = SEMANTICS[array.semantic];
    const format = VERTEX_FORMATS[array.format];
    const registered = semantic !== undefined && semantic.format === array.format;
    check(registered || (semantic === undefined && !strict),
      "K313", at, "a registered pair", `semantic ${array.semantic} in format ${array.format}`);
    const start = align(end, 256);
    // A newer minor may add semantics; their arrays are still tiled.
    const length = registered ? level.vertices * format.size : array.length;
    check(array.offset === start && array.length === length && array.semantic > last && start + length <= stored, "K313", at,
      `${length} bytes at ${start}, semantic above ${last}`, `${array.length} bytes at ${array.offset}, semantic ${array.semantic}`);
    [end, last] = [start + length, array.semantic];
    const name = semantic?.name ?? `semantic ${array.semantic}`;
    return { ...array, name, format: registered ? format.name : `format ${array.format}` };
  });
  check(end === stored && checked[0]?.semantic === 1,
    "K313", () => `levels[${lod}].arrays`, `positions first and ${stored} bytes in all`, `${end} bytes`);
  return checked;
}

/** Arrays that are the first elements of level 0's. */
function checkShared(arrays, level, lod, finest) {
  const inside = level.vertices <= finest.vertices && arrays.length === finest.arrays.length;
  check(inside, "K313", () => `levels[${lod}].arrays`, "the first elements of level 0's arrays", "others");
  return arrays.map((array, number) => {
    const first = finest.arrays[number];
    const length = finest.vertices === 0 ? 0 : (first.length / finest.vertices) * level.vertices;
    check(array.semantic === first.semantic && array.offset === first.offset && array.length === length,
      "K313", () => `levels[${lod}].arrays[${number}]`, `${length} bytes at ${first.offset}`, `${array.length} bytes at ${array.offset}`);
    return { ...array, name: first.name, format: first.format };
  });
}

function readSubmeshes(table, levels, materials, context) {
  const header = table.one(SUBMESHES);
  check(header.submeshes <= 1 << 20, "K302", "SUBM.submesh_count", `at most ${1 << 20}`, header.submeshes);
  check(header.levels === levels.length, "K302", "SUBM.level_count", levels.length, header.levels);
  const records = table.many(SUBMESH, header.submeshes, (i) => `submeshes[${i}]`);
  const submeshes = records.map((submesh, i) => {
    const at = (field) => () => `submeshes[${i}].${field}`;
    const hasMaterial = submesh.material !== NONE;
    check(!hasMaterial || submesh.material < materials, "K304", at("material"), `a material below ${materials}`, submesh.material);
    check((submesh.attributes & ~0x1fe) === 0, "K307", at("attributes"), "registered bits", submesh.attributes);
    return { ...submesh, name: stringOf(context, submesh.name, at("name")), material: hasMaterial ? submesh.material : null };
  });
  for (const level of levels) {
    const at = (i) => `levels[${level.lod}].ranges[${i}]`;
    level.ranges = table.many(RANGE, header.submeshes, at);
    let next = 0;
    for (const [i, range] of level.ranges.entries()) {
      check(range.firstIndex === next && range.indexCount % 3 === 0, "K310", () => `${at(i)}.first_index`,
        `whole triangles from index ${next}`, `${range.indexCount} from ${range.firstIndex}`);
      next += range.indexCount;
      check(range.firstVertex + range.vertexCount <= level.vertices, "K312", () => `${at(i)}.first_vertex`,
        `vertices below ${level.vertices}`, `${range.vertexCount} from ${range.firstVertex}`);
    }
    check(next === 3 * level.triangles, "K310", () => `levels[${level.lod}].ranges`, `${3 * level.triangles} indices in all`, next);
  }
  table.finish();
  return submeshes;
}

function readMaterials(table, textures, context) {
  const { count } = table.one(COUNTS);
  check(count <= 65536, "K302", "MATL.count", "at most 65536", count);
  const materials = Array.from({ length: Math.min(count, table.bytes.length) }, (_, i) => {
    const place = `materials[${i}]`;
    const { name, flags, alphaMode, ...factors } = table.one(MATERIAL, () => place);
    check(alphaMode <= 2, "K307", `${place}.alpha_mode`, "0, 1 or 2", alphaMode);
    check(flags <= 1, "K307", `${place}.flags`, "bit 0 only", flags);
    check(factors.alphaCutoff >= 0, "K307", `${place}.alpha_cutoff`, "0 or more", factors.alphaCutoff);
    const slots = Object.fromEntries(ROLES.map((role) => [role, readSlot(table, textures.length, `${place}.${role}`)]));
    return {
      name: stringOf(context, name, `${place}.name`), alphaMode: ALPHA_MODES[alphaMode], doubleSided: flags === 1, ...factors, slots,
    };
  });
  table.finish();
  return materials;
}

function readSlot(table, textures, place) {
  const start = table.at;
  const isEmpty = table.bytes.length - start >= SLOT.size && table.view.getUint32(start, true) === NONE;
  if (isEmpty) {
    const rest = table.bytes.subarray(start + 4, start + SLOT.size);
    check(rest.every((byte) => byte === 0), "K307", place, "zeros in an empty slot", "another value");
    table.skip(SLOT.size);
    return null;
  }
  const slot = table.one(SLOT, () => place);
  check(slot.uvSet <= 1 && slot.wrapU <= 2 && slot.wrapV <= 2 && slot.mag <= 1 && slot.min <= 1 && slot.mip <= 2,
    "K307", place, "registered UV set and sampler values", "another");
  check(slot.texture < textures, "K304", place, `a texture below ${textures}`, slot.texture);
  const { mag, min, mip, ...rest } = slot;
  return {
    ...rest, wrapU: WRAPS[slot.wrapU], wrapV: WRAPS[slot.wrapV], magLinear: mag === 1, minLinear: min === 1,
    mip: ["none", "nearest", "linear"][mip],
  };
}

function readTextures(table, wide, context) {
  const header = table.one(TEXTURES);
  check(header.textures <= 65536, "K302", "TEXT.count", "at most 65536", header.textures);
  const records = table.many(TEXTURE, header.textures, (i) => `textures[${i}]`);
  const mips = table.many(MIP, header.mips, (i) => `mips[${i}]`);
  table.finish();
  let first = 0;
  const textures = records.map((texture, i) => {
    const at = (field) => () => `textures[${i}].${field}`;
    const format = TEXTURE_FORMATS[texture.format];
    check(format && (wide || texture.format <= 2), "K307", at("format"), "a registered texture format", texture.format);
    for (const channel of texture.channels) {
      check(channel < (wide ? CHANNELS.length : 11), "K307", at("channels"), "a registered channel", channel);
    }
    const sizeOk = [texture.width, texture.height].every((side) => side >= 1 && side <= 65536);
    check(sizeOk, "K302", at("width"), "1 to 65536", `${texture.width} x ${texture.height}`);
    const most = 32 - Math.clz32(Math.max(texture.width, texture.height));
    const countsOk = texture.mipCount >= 1 && texture.mipCount <= most && texture.tailFirst < texture.mipCount
      && texture.firstMip === first && first + texture.mipCount <= mips.length;
    check(countsOk, "K315", at("mip_count"), `1 to ${most} mips from ${first} with a tail`,
      `${texture.mipCount} from ${texture.firstMip}, tail at ${texture.tailFirst}`);
    const own = mips.slice(first, first + texture.mipCount);
    first += texture.mipCount;
    checkSection(context, texture.tailSection, "MIPT", at("tail_section"));
    const extra = wide ? extraOf(texture.roles) : null;
    check(texture.sheet === 0 || !context.strict || extra !== null, "K108", at("reserved"), "zero", "another value");
    checkMips(own, texture, format, i, context);
    const { mipCount, firstMip, roles, ...rest } = texture;
    return {
      ...rest, name: stringOf(context, texture.name, at("name")), format: format.name, formatNumber: texture.format,
      roles: ROLES.filter((_, bit) => (roles >>> bit) & 1), roleBits: roles, extra,
      channels: Array.from(texture.channels, (c) => CHANNELS[c]), mips: own,
    };
  });
  check(first === mips.length, "K315", "TEXT", `${first} mips in all`, mips.length);
  return textures;
}

/** Sizes halve, and each mip lies where its record says. */
function checkMips(mips, texture, format, number, context) {
  const lengthOf = (section) => context.sections[section].rawLength;
  let end = 0;
  for (const [k, mip] of mips.entries()) {
    const at = `textures[${number}].mips[${k}]`;
    const [width, height] = [Math.max(1, texture.width >>> k), Math.max(1, texture.height >>> k)];
    const length = mipLength(format, width, height);
    const inTail = k >= texture.tailFirst;
    checkSection(context, mip.section, inTail ? "MIPT" : "MIPL", `${at}.section`);
    const offset = inTail ? align(end, 256) : 0;
    const isRight = mip.width === width && mip.height === height && mip.length === length && mip.offset === offset
      && (!inTail || mip.section === texture.tailSection);
    check(isRight, "K315", at, `${width} x ${height}, ${length} bytes at ${offset}`,
      `${mip.width} x ${mip.height}, ${mip.length} bytes at ${mip.offset}`);
    if (inTail) end = offset + length;
    else check(lengthOf(mip.section) === length, "K315", at, `a section of ${length} bytes`, lengthOf(mip.section));
  }
  const tail = lengthOf(texture.tailSection);
  check(tail === end, "K315", `textures[${number}].tail_section`, `a section of ${end} bytes`, tail);
}

/** A texture's roles are those of its users, or one extra that no material uses. */
function checkRoles(textures, materials, wide) {
  const used = new Uint32Array(textures.length);
  for (const material of materials) {
    ROLES.forEach((role, bit) => {
      const slot = material.slots[role];
      if (slot) used[slot.texture] |= 1 << bit;
    });
  }
  for (const [i, texture] of textures.entries()) {
    const isExtra = used[i] === 0 && texture.extra !== null && wide;
    check(texture.roleBits === used[i] || isExtra, "K316", `textures[${i}].roles`, used[i], texture.roleBits);
    check(!isExtra || [1, 3, 4, 5].includes(texture.formatNumber), "K316", `textures[${i}].format`, "linear texels, not in blocks", texture.format);
    delete texture.roleBits;
  }
}

function readProvenance(table) {
  const header = table.one(PROVENANCE);
  // An input takes at least 36 bytes, a stage 8.
  const least = header.inputs * 36 + header.stages * 8;
  const rest = table.bytes.length - table.at;
  check(least <= rest, "K301", "PROV", `${header.inputs} inputs and ${header.stages} stages`, `${rest} bytes`);
  const provenance = {
    pipeline: header.pipeline,
    tool: table.string("PROV.tool"),
    numericClass: table.string("PROV.numeric_class"),
    deviceClass: table.string("PROV.device_class"),
    inputs: Array.from({ length: header.inputs }, (_, i) => {
      const start = table.skip(32, `PROV.inputs[${i}]`);
      return { hash: table.bytes.subarray(start, start + 32), name: table.string(`PROV.inputs[${i}]`) };
    }),
    stages: Array.from({ length: header.stages }, (_, i) =>
      ({ name: table.string(`PROV.stages[${i}]`), version: table.string(`PROV.stages[${i}]`) })),
  };
  table.finish();
  return provenance;
}
