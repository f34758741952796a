// Records as the page's tables: field names with their types, one behind the other.

import { CHECKS, MINOR } from "./registry.mjs";

/** A check of the format that failed. */
export class KilnError extends Error {
  /**
   * @param {string} code the check's number, such as `K208`
   * @param {string} place where: `section 7 (VERT).offset`, `levels[2].error`
   * @param {unknown} expected what would be right
   * @param {unknown} found what is there
   */
  constructor(code, place, expected, found) {
    super(`${code} ${CHECKS[code]}: ${place}: expected ${expected}, found ${found}`);
    this.name = "KilnError";
    /** @type {string} */
    this.code = code;
    /** @type {string} */
    this.place = place;
  }
}

/** Throws a {@link KilnError}. */
export function fail(code, place, expected, found) {
  throw new KilnError(code, typeof place === "function" ? place() : place, expected, found);
}

/** Throws a {@link KilnError} unless `holds`. Loops over payload call {@link fail} instead, so that no words are made in vain. */
export function check(holds, code, place, expected, found) {
  if (!holds) fail(code, place, expected, found);
}

/** Least multiple of `a` not below `x`. */
export const align = (x, a) => Math.ceil(x / a) * a;

/** An unsigned 64-bit integer; inexact above 2^53, where no file reaches. */
export const u64 = (view, at) => view.getUint32(at, true) + view.getUint32(at + 4, true) * 2 ** 32;

const TYPES = {
  u8: [1, (view, at) => view.getUint8(at)],
  u16: [2, (view, at) => view.getUint16(at, true)],
  u32: [4, (view, at) => view.getUint32(at, true)],
  u64: [8, u64],
  f32: [4, (view, at) => view.getFloat32(at, true)],
};

/**
 * A record of a table. `text` lists fields as `name type` or `name typexN`, separated by commas; bytes (`u8xN`) are lent, other
 * lists are copied. Fields called `reserved` must be zero in files whose minor version is known, and are not kept.
 */
export function record(text) {
  let size = 0;
  const fields = text.split(",").map((field) => {
    const [name, type, times] = field.trim().split(/ |x(?=\d+$)/);
    const [bytes, read] = TYPES[type];
    const at = size;
    size += bytes * Number(times ?? 1);
    return { name, at, bytes, read, times: times && Number(times), isFloat: type === "f32", isBytes: type === "u8" && times };
  });
  return { size, fields };
}

/** Reads a record at `at`; `place` gives its name for errors. Numbers must be finite, reserved fields zero if `strict`. */
export function readRecord(type, view, at, strict, place) {
  const out = {};
  for (const field of type.fields) {
    const value = readField(field, view, at + field.at);
    if (field.name === "reserved") {
      check(!strict || value.every((x) => x === 0), "K108", () => `${place()}.reserved`, "zero", "another value");
      continue;
    }
    if (field.isFloat) {
      const isFinite = field.times ? value.every(Number.isFinite) : Number.isFinite(value);
      check(isFinite, "K306", () => `${place()}.${field.name}`, "a finite number", value);
    }
    out[field.name] = value;
  }
  return out;
}

function readField(field, view, at) {
  if (field.isBytes) return new Uint8Array(view.buffer, view.byteOffset + at, field.times);
  if (field.times === undefined) return field.read(view, at);
  const values = [];
  for (let k = 0; k < field.times; k++) values.push(field.read(view, at + k * field.bytes));
  return values;
}

/** Whether two hashes agree. */
export const isSame = (a, b) => a.every((byte, i) => byte === b[i]);

/** Cuts records and strings off the front of a table; never reads or keeps more than the table has bytes for. */
export class Cutter {
  /**
   * @param {Uint8Array} bytes the table
   * @param {string} name its kind
   * @param {boolean} strict whether reserved bytes must be zero
   */
  constructor(bytes, name, strict) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.name = name;
    this.strict = strict;
    this.at = 0;
  }

  /** Offset of the next `length` bytes, which are cut off. */
  skip(length, place = this.name) {
    const rest = this.bytes.length - this.at;
    check(length <= rest, "K301", place, `${length} bytes`, `${rest} bytes`);
    this.at += length;
    return this.at - length;
  }

  /** One record. */
  one(type, place = () => this.name) {
    return readRecord(type, this.view, this.skip(type.size), this.strict, place);
  }

  /** `count` records; `place` names number `i`. */
  many(type, count, place) {
    const start = this.skip(count * type.size);
    return Array.from({ length: count }, (_, i) =>
      readRecord(type, this.view, start + i * type.size, this.strict, () => place(i)));
  }

  /** `count` u32. */
  words(count) {
    const start = this.skip(count * 4);
    return Array.from({ length: count }, (_, i) => this.view.getUint32(start + i * 4, true));
  }

  /** A string with its length before it and zeros behind it. */
  string(place) {
    const length = this.view.getUint32(this.skip(4, place), true);
    check(length <= 65535, "K303", place, "at most 65535 bytes", length);
    const start = this.skip(length, place);
    const padding = this.skip(align(length, 4) - length, place);
    check(this.bytes.subarray(padding, this.at).every((byte) => byte === 0), "K211", place, "zeros behind the string", "another");
    let text;
    try {
      text = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(this.bytes.subarray(start, start + length));
    } catch {
      throw new KilnError("K303", place, "UTF-8", "bad bytes");
    }
    check(text === text.normalize("NFC"), "K303", place, "normalisation form C", JSON.stringify(text));
    return text;
  }

  /** Nothing may be left. */
  finish() {
    const rest = this.bytes.length - this.at;
    check(rest === 0, "K301", this.name, "the end", `${rest} bytes more`);
  }
}

/** Whether all that a file of this minor version may hold is known here. */
export const isKnown = (minor) => minor <= MINOR;
