// The envelope: header, section table, and how sections tile the file. Nothing here knows what is inside a section.

import { blake3, hex } from "./blake3.mjs";
import { KilnError, align, check, fail, isKnown, isSame, readRecord, record } from "./records.mjs";
import { KINDS, MINOR, MOST_EXPANSION, PAYLOAD_RANK, codecName, isCodecOf } from "./registry.mjs";

const MAGIC = [0x89, 0x4b, 0x4c, 0x4e, 0x0d, 0x0a, 0x1a, 0x0a];
const HEADER = record(
  "magic u8x8, endian u32, major u16, minor u16, fileLength u64, tableOffset u64, sectionCount u32, reserved u8x28, hash u8x32");
const ENTRY = record(
  "kind u8x4, version u16, flags u16, codec u32, alignment u32, offset u64, storedLength u64, rawLength u64, reserved u8x8, "
  + "storedHash u8x32, rawHash u8x32, reserved u8x16");

/**
 * A section as the table tells it.
 * @typedef {object} Section
 * @property {number} number its place in the table
 * @property {string} kind four letters
 * @property {number} version
 * @property {boolean} required
 * @property {number} codec
 * @property {string} codecName
 * @property {number} alignment bytes
 * @property {number} offset from the start of the file, bytes
 * @property {number} storedLength bytes in the file
 * @property {number} rawLength bytes after decoding
 * @property {Uint8Array} storedHash BLAKE3
 * @property {Uint8Array} rawHash BLAKE3
 * @property {boolean} known whether this reader knows kind and version; others are lent as bytes
 */

/** How a section is named in errors. */
export const placeOf = (section) => `section ${section.number} (${section.kind})`;

/** Bytes start..end must be zero. */
export function checkZero(bytes, start, end, place) {
  for (let at = start; at < end; at++) if (bytes[at] !== 0) fail("K211", place, "zero", `${bytes[at]} at byte ${at}`);
}

/**
 * Header and section table of a file, or of a prefix of one, with all checks of chapter 2.
 * @param {Uint8Array} bytes
 * @param {boolean} prefix
 * @returns {{minor: number, fileLength: number, sections: Section[]}}
 */
export function readEnvelope(bytes, prefix) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const header = readHeader(bytes, view, prefix);
  const end = HEADER.size + header.sectionCount * ENTRY.size;
  check(end <= bytes.length, "K101", "table", `at least ${end} bytes`, `${bytes.length} bytes`);
  const hashed = new Uint8Array(64 + end - HEADER.size);
  hashed.set(bytes.subarray(0, 64));
  hashed.set(bytes.subarray(HEADER.size, end), 64);
  const found = blake3(hashed);
  if (!isSame(found, header.hash)) throw new KilnError("K109", "header.hash", hex(header.hash), hex(found));

  const strict = isKnown(header.minor);
  const sections = Array.from({ length: header.sectionCount }, (_, number) =>
    readEntry(view, HEADER.size + number * ENTRY.size, number, strict));
  checkTiling(bytes, sections, end, header.fileLength);
  checkOccurrence(sections);
  return { minor: header.minor, fileLength: header.fileLength, sections };
}

function readHeader(bytes, view, prefix) {
  const length = bytes.length;
  const shown = bytes.subarray(0, 8);
  check(shown.every((byte, i) => byte === MAGIC[i]), "K102", "header.magic", "\\x89KLN\\r\\n\\x1a\\n", hex(shown));
  check(length >= HEADER.size, "K101", "header.length", `at least ${HEADER.size} bytes`, length);
  check(view.getUint32(8, true) === 0x01020304, "K103", "header.endian", "0x01020304", view.getUint32(8, true));
  const [major, minor] = [view.getUint16(12, true), view.getUint16(14, true)];
  check(major === 1, "K104", "header.major", `version 1.x (this reader is 1.${MINOR})`, `version ${major}.${minor}`);
  const header = readRecord(HEADER, view, 0, isKnown(minor), () => "header");
  const fits = prefix ? header.fileLength >= length : header.fileLength === length;
  check(fits && Number.isSafeInteger(header.fileLength), "K105", "header.file_length", `${header.fileLength} bytes`, `${length} bytes`);
  check(header.tableOffset === HEADER.size, "K106", "header.table_offset", HEADER.size, header.tableOffset);
  const room = Math.max(0, Math.min(Math.floor((header.fileLength - HEADER.size) / ENTRY.size), 1 << 20));
  check(header.sectionCount <= room, "K107", "header.section_count", `at most ${room}`, header.sectionCount);
  return header;
}

/** The entry's own fields. */
function readEntry(view, at, number, strict) {
  const kind = String.fromCharCode(...new Uint8Array(view.buffer, view.byteOffset + at, 4));
  const section = { number, kind };
  const { flags, ...entry } = readRecord(ENTRY, view, at, strict, () => placeOf(section));
  const wrong = (code, field, expected, found) => new KilnError(code, `${placeOf(section)}.${field}`, expected, found);
  if (!/^[A-Za-z][A-Za-z0-9]{3}$/.test(kind)) throw wrong("K201", "kind", "four ASCII letters or digits", JSON.stringify(kind));
  if (flags > 1) throw wrong("K204", "flags", "bit 0 only", flags);
  const required = flags === 1;
  const row = Object.hasOwn(KINDS, kind) ? KINDS[kind] : undefined;
  const known = row !== undefined && entry.version >= 1 && entry.version <= row.version;
  if (known) {
    if (required !== row.required) throw wrong("K204", "flags", `required = ${row.required}`, required);
    if (entry.alignment !== row.alignment) throw wrong("K206", "alignment", row.alignment, entry.alignment);
  } else if (row ? required || row.required : required) {
    if (row) throw wrong("K203", "version", `version 1 to ${row.version} of ${kind}`, entry.version);
    throw wrong("K202", "kind", "a kind that this reader knows", `required section ${kind} version ${entry.version}`);
  }
  if (entry.alignment !== 16 && entry.alignment !== 256) throw wrong("K206", "alignment", "16 or 256", entry.alignment);
  if (known && !isCodecOf(entry.codec, kind, row)) throw wrong("K205", "codec", `a codec of ${kind}`, codecName(entry.codec));
  if (known && entry.codec !== 0) {
    const most = entry.storedLength * MOST_EXPANSION[entry.codec];
    if (entry.rawLength > most) throw wrong("K213", "raw_length", `at most ${most}`, entry.rawLength);
  }
  if (entry.codec === 0) {
    if (entry.rawLength !== entry.storedLength) throw wrong("K213", "raw_length", entry.storedLength, entry.rawLength);
    if (!isSame(entry.rawHash, entry.storedHash)) throw wrong("K215", "raw_hash", "the stored hash", "another");
  }
  return { ...entry, ...section, required, known, codecName: codecName(entry.codec) };
}

/** Sections stand one behind the other from `end` to the end of the file, with zeros between them. */
function checkTiling(bytes, sections, end, fileLength) {
  for (const section of sections) {
    const { offset, storedLength, alignment } = section;
    const at = () => `${placeOf(section)}.offset`;
    check(offset % alignment === 0, "K207", at, `a multiple of ${alignment}`, offset);
    check(offset >= end, "K209", at, `${end} or more`, offset);
    check(offset <= align(end, alignment), "K210", at, align(end, alignment), offset);
    check(offset + storedLength <= fileLength, "K208", at, `within ${fileLength} bytes`, `offset ${offset} + ${storedLength} bytes`);
    checkZero(bytes, end, Math.min(offset, bytes.length), () => `before ${placeOf(section)}`);
    end = offset + storedLength;
  }
  check(end === fileLength, "K212", "header.file_length", `${end} bytes`, `${fileLength} bytes`);
}

/** How often each registered kind occurs, and that tables stand before all else in registry order. */
function checkOccurrence(sections) {
  const counts = new Map();
  let highest = 0;
  for (const section of sections) {
    counts.set(section.kind, (counts.get(section.kind) ?? 0) + 1);
    const rank = Object.hasOwn(KINDS, section.kind) ? KINDS[section.kind].rank : PAYLOAD_RANK;
    check(rank >= Math.min(highest, PAYLOAD_RANK), "K218", () => placeOf(section), "tables first, in the registry's order", "a later place");
    highest = Math.max(highest, rank);
  }
  for (const [kind, row] of Object.entries(KINDS)) {
    const count = counts.get(kind) ?? 0;
    check(count > 0 || row.occurs !== "once", "K217", kind, "one section", "none");
    check(count <= 1 || row.occurs === "any", "K216", kind, "one section", count);
  }
}
