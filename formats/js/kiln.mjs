// A reader of kiln containers, versions 1.0 to 1.2, without dependencies. `README.md` shows its use, `../container-v1.md` is the
// specification.
//
//   openContainer   header, section table, tables: all checked before an offset in them is used; their hashes agree
//   level, mip      typed arrays on the caller's bytes; nothing is copied but sections in a codec
//   layouts         views of chapter 5 with the same picking, checked when they are first asked for
//   validate        what is left: hashes of all sections, indices, finite numbers

import { blake3, hex } from "./blake3.mjs";
import { checkZero, placeOf, readEnvelope } from "./envelope.mjs";
import { readClusters, readCompactTree, readTreeLeaf, readWindow } from "./layouts.mjs";
import { KilnError, check, isKnown, isSame } from "./records.mjs";
import { SEMANTICS, TEXTURE_FORMATS, VERTEX_FORMATS } from "./registry.mjs";
import { readTables } from "./tables.mjs";
import { chooseByPixels } from "./view.mjs";

export { KilnError } from "./records.mjs";
export * from "./layouts.mjs";
export * from "./view.mjs";

/**
 * Decoders of coded sections; the latter two are `decodeVertexBuffer` and `decodeIndexBuffer` of meshoptimizer's `MeshoptDecoder`.
 * @typedef {object} Decoders
 * @property {(stored: Uint8Array, rawLength?: number) => Uint8Array} [zstd] one frame; a length that is not given stands in the frame
 * @property {(target: Uint8Array, count: number, size: number, source: Uint8Array) => void} [meshoptVertex] `count` elements of `size`
 *   bytes
 * @property {(target: Uint8Array, count: number, size: number, source: Uint8Array) => void} [meshoptIndex] `count` indices of `size`
 *   bytes
 */

/**
 * The geometry of a level.
 * @typedef {object} Geometry
 * @property {Float32Array} positions `[vertices] x 3`, object space
 * @property {Float32Array | null} normals `[vertices] x 3`
 * @property {Float32Array | null} tangents `[vertices] x 4`, w is +1 or -1
 * @property {Float32Array | null} uv0 `[vertices] x 2`, V downwards
 * @property {Float32Array | null} uv1 `[vertices] x 2`
 * @property {Float32Array | null} colors `[vertices] x 4`, linear
 * @property {Uint16Array | null} joints `[vertices] x 4`
 * @property {Float32Array | null} weights `[vertices] x 4`
 * @property {Uint16Array | Uint32Array} indices three a triangle
 * @property {import("./tables.mjs").Range[]} ranges by submesh
 */

/**
 * @typedef {object} Layouts
 * @property {import("./layouts.mjs").WindowView | null} window
 * @property {import("./layouts.mjs").TreeLeafView | null} treeLeaf
 * @property {import("./layouts.mjs").CompactTreeView | null} compactTree
 * @property {import("./layouts.mjs").ClusterView | null} clusters
 */

/**
 * Opens a container.
 * @param {ArrayBuffer | ArrayBufferView} source the file; copied if it is a view that does not start on a multiple of 16
 * @param {object} [options]
 * @param {boolean} [options.prefix] the bytes may be the first ones of the file: what lies behind them is not at hand
 * @param {Decoders} [options.decoders]
 * @returns {Container}
 * @throws {KilnError} the first check that fails
 */
export function openContainer(source, { prefix = false, decoders = {} } = {}) {
  return new Container(bytesOf(source), prefix, decoders);
}

const IS_LITTLE = new Uint8Array(Uint16Array.of(1).buffer)[0] === 1;

function bytesOf(source) {
  if (!IS_LITTLE) throw new Error("containers are lent in place, which needs a little-endian machine");
  if (!ArrayBuffer.isView(source)) return new Uint8Array(source);
  const bytes = new Uint8Array(source.buffer, source.byteOffset, source.byteLength);
  return source.byteOffset % 16 === 0 ? bytes : bytes.slice();
}

/** A container whose tables have been checked. Made by {@link openContainer}. */
export class Container {
  #bytes;
  #prefix;
  #decoders;
  #decoded = new Map();
  #layouts;

  constructor(bytes, prefix, decoders) {
    this.#bytes = bytes;
    this.#prefix = prefix;
    this.#decoders = decoders;
    const { minor, fileLength, sections } = readEnvelope(bytes, prefix);
    /** Major and minor version. */
    this.version = { major: 1, minor };
    /** Bytes of the whole file. */
    this.fileLength = fileLength;
    /** @type {import("./envelope.mjs").Section[]} */
    this.sections = sections;
    const table = (kind) => {
      const section = sections.find((s) => s.kind === kind && s.known);
      return section ? this.#checked(section) : null;
    };
    const tables = readTables(sections, table, isKnown(minor), minor);
    /** Triangles of the source asset. */
    this.sourceTriangles = tables.sourceTriangles;
    /** @type {{size: number, padding: number, charts: number, sheets: number} | null} */
    this.uvLayout = tables.uvLayout;
    /** @type {import("./tables.mjs").Level[]} finest first */
    this.levels = tables.levels;
    /** @type {import("./tables.mjs").Submesh[]} */
    this.submeshes = tables.submeshes;
    /** @type {import("./tables.mjs").Material[]} */
    this.materials = tables.materials;
    /** @type {import("./tables.mjs").Texture[]} */
    this.textures = tables.textures;
    /** @type {import("./tables.mjs").Provenance | null} */
    this.provenance = tables.provenance;
  }

  /** Whether a section lies within the bytes at hand; of a prefix also whether it is sound. */
  has(number) {
    const section = this.sections[number];
    if (!section || section.offset + section.storedLength > this.#bytes.length) return false;
    return !this.#prefix || this.#isSound(section);
  }

  /** The stored bytes of a section, lent. */
  storedBytes(number) {
    const section = this.sections[number];
    check(section, "K304", "section", `a number below ${this.sections.length}`, number);
    const end = section.offset + section.storedLength;
    check(end <= this.#bytes.length, "K208", placeOf(section), `${end} bytes`, `${this.#bytes.length} bytes at hand`);
    return this.#bytes.subarray(section.offset, end);
  }

  /**
   * The bytes of a section: lent, or decoded where it is in a codec.
   * @param {number} number
   * @returns {Uint8Array}
   */
  sectionBytes(number) {
    const stored = this.storedBytes(number);
    const section = this.sections[number];
    if (section.codec === 0) return stored;
    if (!this.#decoded.has(number)) this.#decoded.set(number, this.#decode(section, stored));
    return this.#decoded.get(number);
  }

  /** Whether the sections that a level needs are at hand. */
  isAtHand(lod) {
    return this.levels[lod]?.needs.every((number) => this.has(number)) ?? false;
  }

  /**
   * The geometry of a level as typed arrays.
   * @param {number} lod 0 is the finest
   * @returns {Geometry | null} null where it is not at hand
   */
  level(lod) {
    const level = this.levels[lod];
    if (!level || !this.has(level.vertexSection) || !this.has(level.indexSection)) return null;
    const vertices = this.sectionBytes(level.vertexSection);
    const indices = this.sectionBytes(level.indexSection);
    const geometry = Object.fromEntries(SEMANTICS.slice(1).map(({ name }) => [name, null]));
    for (const array of level.arrays) {
      const format = VERTEX_FORMATS[SEMANTICS[array.semantic]?.format];
      if (!format) continue;
      geometry[array.name] = new format.array(vertices.buffer, vertices.byteOffset + array.offset, level.vertices * format.components);
    }
    const type = level.indexWidth === 2 ? Uint16Array : Uint32Array;
    geometry.indices = new type(indices.buffer, indices.byteOffset, 3 * level.triangles);
    geometry.ranges = level.ranges;
    return geometry;
  }

  /**
   * A mip of a texture; texels are a typed array of the format's components, bytes for block formats.
   * @param {number} texture
   * @param {number} mip 0 is the picture itself
   * @returns {{width: number, height: number, texels: Uint8Array | Uint16Array | Float32Array} | null} null where it is not at hand
   */
  mip(texture, mip) {
    const info = this.textures[texture]?.mips[mip];
    if (!info || !this.has(info.section)) return null;
    const bytes = this.sectionBytes(info.section);
    const type = TEXTURE_FORMATS[this.textures[texture].formatNumber].array;
    const texels = new type(bytes.buffer, bytes.byteOffset + info.offset, info.length / type.BYTES_PER_ELEMENT);
    return { width: info.width, height: info.height, texels };
  }

  /**
   * The coarsest level at hand whose error covers at most `mostPixels` in the view, else the finest at hand (0 if none is).
   * @param {import("./view.mjs").View} view
   * @param {number} mostPixels
   */
  chooseLevel(view, mostPixels) {
    const atHand = this.levels.filter((level) => this.isAtHand(level.lod));
    return atHand.length === 0 ? 0 : atHand[chooseByPixels(atHand, view, mostPixels)].lod;
  }

  /**
   * The layouts of chapter 5 that are there (and, of a prefix, at hand).
   * @returns {Layouts}
   */
  get layouts() {
    this.#layouts ??= this.#readLayouts();
    return this.#layouts;
  }

  /**
   * Checks what opening did not: hashes of all sections, padding between arrays, indices below their level's vertices, finite
   * numbers in arrays and float textures, and the layouts. Not checked are boxes, lists of needs and the order of payload.
   * @throws {KilnError} the first check that fails
   */
  validate() {
    for (const section of this.sections) {
      if (this.#prefix && !this.has(section.number)) continue;
      this.#checked(section);
      if (!section.known) continue;
      if (section.codec !== 0) {
        const found = blake3(this.sectionBytes(section.number));
        if (!isSame(found, section.rawHash)) throw new KilnError("K215", `${placeOf(section)}.raw_hash`, hex(section.rawHash), hex(found));
      }
    }
    for (const level of this.levels) if (this.isAtHand(level.lod)) this.#checkGeometry(level);
    for (const [number, texture] of this.textures.entries()) this.#checkTexels(number, texture);
    void this.layouts;
  }

  #isSound(section) {
    const key = `sound ${section.number}`;
    if (!this.#decoded.has(key)) {
      this.#decoded.set(key, isSame(blake3(this.storedBytes(section.number)), section.storedHash));
    }
    return this.#decoded.get(key);
  }

  /** The stored bytes of a section whose hash agrees. */
  #checked(section) {
    const bytes = this.storedBytes(section.number);
    const found = blake3(bytes);
    if (!isSame(found, section.storedHash)) throw new KilnError("K214", `${placeOf(section)}.stored_hash`, hex(section.storedHash), hex(found));
    return bytes;
  }

  #decode(section, stored) {
    const names = { 1: "zstd", 3: "meshoptVertex", 4: "meshoptIndex", 5: "meshoptIndex" };
    const decoder = this.#decoders[names[section.codec]];
    const zstd = this.#decoders.zstd;
    check(decoder && (section.codec !== 5 || zstd), "K205", `${placeOf(section)}.codec`, "none, or a codec whose decoder is given", section.codecName);
    let raw;
    try {
      // A stream of indices in a frame: how long it is, the frame says.
      const stream = section.codec === 5 ? zstd(stored, undefined) : stored;
      raw = section.codec === 1 ? decoder(stored, section.rawLength) : this.#decodeGeometry(section, stream, decoder);
    } catch (error) {
      if (error instanceof KilnError) throw error;
      throw new KilnError("K219", placeOf(section), `${section.rawLength} bytes`, error.message);
    }
    check(raw instanceof Uint8Array && raw.length === section.rawLength, "K219", placeOf(section), `${section.rawLength} bytes`, `${raw?.length} bytes`);
    return raw.byteOffset % 16 === 0 ? raw : raw.slice();
  }

  /** meshoptimizer's streams: one of all indices, or one for each array with its length before it. */
  #decodeGeometry(section, stored, decoder) {
    // The finest level has all elements of a shared section.
    const level = this.levels.find((l) => l.vertexSection === section.number || l.indexSection === section.number);
    check(level, "K305", placeOf(section), "a level that uses it", "none");
    const raw = new Uint8Array(section.rawLength);
    if (section.codec === 4 || section.codec === 5) {
      decoder(raw, 3 * level.triangles, level.indexWidth, stored);
      return raw;
    }
    const view = new DataView(stored.buffer, stored.byteOffset, stored.byteLength);
    let at = 0;
    for (const array of level.arrays) {
      const length = at + 4 <= stored.length ? view.getUint32(at, true) : Infinity;
      const end = at + 4 + length;
      check(end <= stored.length, "K219", placeOf(section), `a stream for ${array.name}`, `${stored.length - at} bytes`);
      decoder(raw.subarray(array.offset, array.offset + array.length), level.vertices, array.length / level.vertices, stored.subarray(at + 4, end));
      at = end;
    }
    check(at === stored.length, "K219", placeOf(section), `${at} bytes`, stored.length);
    return raw;
  }

  #readLayouts() {
    const { vertices, triangles } = this.levels[0];
    const base = {
      vertices, triangles, levels: this.levels.length, submeshes: this.submeshes.length, strict: isKnown(this.version.minor),
    };
    const bytes = (kind) => {
      const section = this.sections.find((s) => s.kind === kind && s.known);
      return section && (!this.#prefix || this.has(section.number)) ? this.sectionBytes(section.number) : null;
    };
    const [window, tree, leaf, compact, clusters] = ["WNDW", "TREE", "LEAF", "CTRE", "CLUS"].map(bytes);
    check(this.#prefix || (tree === null) === (leaf === null), "K317", "TREE", "LEAF with TREE", "one without the other");
    return {
      window: window && readWindow(window, base),
      treeLeaf: tree && leaf && readTreeLeaf(tree, leaf, base),
      compactTree: compact && readCompactTree(compact, base),
      clusters: clusters && readClusters(clusters, base),
    };
  }

  #checkGeometry(level) {
    const { lod } = level;
    const geometry = this.level(lod);
    const bytes = this.sectionBytes(level.vertexSection);
    const isShared = lod > 0 && level.vertexSection === this.levels[0].vertexSection;
    let end = 0;
    for (const array of level.arrays) {
      if (!isShared) checkZero(bytes, end, array.offset, `levels[${lod}].${array.name}`);
      end = array.offset + array.length;
      const values = geometry[array.name];
      if (values instanceof Float32Array) {
        const bad = values.findIndex((x) => !Number.isFinite(x));
        check(bad < 0, "K306", `levels[${lod}].${array.name}`, "finite numbers", values[bad]);
      }
    }
    for (const [number, range] of level.ranges.entries()) {
      const last = range.firstVertex + range.vertexCount;
      const own = geometry.indices.subarray(range.firstIndex, range.firstIndex + range.indexCount);
      const bad = own.findIndex((index) => index < range.firstVertex || index >= last);
      check(bad < 0, "K312", `levels[${lod}].ranges[${number}]`, `indices from ${range.firstVertex} to below ${last}`, own[bad]);
    }
  }

  #checkTexels(number, texture) {
    const isFloat = { "rgba16-float": (x) => (x & 0x7c00) !== 0x7c00, "rgba32-float": Number.isFinite }[texture.format];
    for (let k = 0; k < texture.mips.length; k++) {
      const mip = this.mip(number, k);
      const bad = isFloat && mip ? mip.texels.findIndex((x) => !isFloat(x)) : -1;
      check(bad < 0, "K306", `textures[${number}].mips[${k}]`, "finite texels", "another");
    }
    if (!this.has(texture.tailSection)) return;
    const bytes = this.sectionBytes(texture.tailSection);
    let end = 0;
    for (const mip of texture.mips.slice(texture.tailFirst)) {
      checkZero(bytes, end, mip.offset, `section ${texture.tailSection}`);
      end = mip.offset + mip.length;
    }
  }
}
