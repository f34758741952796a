import assert from "node:assert/strict";
import { test } from "node:test";
import { KilnError, allowedForEye, chooseByError, chooseByPixels, chooseByTriangles, distanceToBox, openContainer, pixelsPerUnit } from "./kiln.mjs";
import { shortest, summary } from "./summary.mjs";
import { CLUSTERS, COMPACT, LEAF, POSITIONS, TREE, TREE_INDICES, WINDOW, assemble, bytesOf, rehashed, small, zeros } from "./testing.mjs";

const code = (code) => (error) => error instanceof KilnError && error.code === code;
const everything = () => assemble([...small(), WINDOW, CLUSTERS]);

test("a container lends its tables and arrays", () => {
  const file = assemble(small());
  const container = openContainer(file.buffer);
  container.validate();
  assert.deepEqual(container.version, { major: 1, minor: 2 });
  assert.equal(container.submeshes[0].name, "tëst");
  assert.equal(container.provenance.inputs[0].name, "a.glb");
  const fine = container.level(0);
  assert.deepEqual(fine.positions, POSITIONS);
  assert.equal(fine.positions.buffer, file.buffer, "lent, not copied");
  assert.equal(fine.normals, null);
  assert.deepEqual(container.level(1).indices, Uint16Array.of(0, 1, 2));
  assert.equal(container.level(2), null);
  const [material] = container.materials;
  assert.equal(material.slots["base-color"].wrapV, "mirrored-repeat");
  assert.equal(material.slots.normal, null);
  assert.deepEqual(container.mip(0, 1), { width: 1, height: 1, texels: Uint8Array.of(9, 9, 9, 9) });
  assert.equal(container.mip(0, 2), null);
});

test("bytes at any offset of a buffer are read", () => {
  const file = assemble(small());
  const shifted = new Uint8Array(file.length + 5);
  shifted.set(file, 5);
  assert.deepEqual(openContainer(shifted.subarray(5)).level(0).positions, POSITIONS);
});

test("each prefix and each flipped byte is an error, never another summary", () => {
  const file = everything();
  // The hashes of layouts, as those of all payload, are looked at by validate() only.
  const text = (container) => JSON.stringify({ ...summary(container), layouts: null });
  const expected = text(openContainer(file));
  for (let length = 0; length < file.length; length++) {
    assert.throws(() => openContainer(file.slice(0, length)), KilnError, `${length} bytes`);
  }
  for (let at = 0; at < file.length; at++) {
    const bad = file.slice();
    bad[at] ^= 1 << at % 8;
    let container;
    try {
      container = openContainer(bad);
      assert.equal(text(container), expected, `byte ${at}`);
    } catch (error) {
      assert.ok(error instanceof KilnError, `byte ${at}: ${error.stack}`);
    }
    if (container) assert.throws(() => container.validate(), KilnError, `byte ${at}`);
  }
});

test("a flipped byte under right hashes is an error or lends what lies inside", () => {
  const files = [everything(), assemble([...small(TREE_INDICES), TREE, LEAF, COMPACT])];
  for (const file of files) {
    const { sections } = openContainer(file);
    for (let at = 0; at < file.length; at++) {
      // Hashes are made right again.
      const column = (at - 96) % 128;
      if (at >= 64 && at < 96 + 128 * sections.length && (at < 96 || (column >= 48 && column < 112))) continue;
      const bad = file.slice();
      bad[at] ^= [0xff, 1, 0x80][at % 3];
      try {
        const container = openContainer(rehashed(bad));
        summary(container);
        container.validate();
        for (let lod = 0; lod < container.levels.length; lod++) {
          const { indices, positions } = container.level(lod);
          assert.ok(indices.every((i) => 3 * i < positions.length), `byte ${at}`);
        }
      } catch (error) {
        assert.ok(error instanceof KilnError, `byte ${at}: ${error.stack}`);
      }
    }
  }
});

test("a prefix offers what lies inside, and no damaged section", () => {
  const file = assemble(small());
  const whole = openContainer(file);
  const end = Math.max(...whole.levels[1].needs.map((n) => whole.sections[n].offset + whole.sections[n].storedLength));
  const prefix = openContainer(file.slice(0, end), { prefix: true });
  assert.equal(prefix.level(0), null);
  assert.deepEqual(prefix.level(1).positions, POSITIONS.slice(0, 9));
  assert.equal(prefix.chooseLevel({ distance: 0.01, verticalFov: 1, viewportHeight: 1000 }, 1), 1);
  const damaged = file.slice(0, end);
  damaged[whole.sections[6].offset] ^= 1;
  assert.equal(openContainer(damaged, { prefix: true }).level(1), null);
});

test("counts and offsets that lie are refused by their code", () => {
  const change = (at, value) => {
    const file = everything();
    new DataView(file.buffer).setUint32(at, value, true);
    return () => openContainer(rehashed(file)).validate();
  };
  const file = everything();
  const { sections } = openContainer(file);
  const start = (kind) => sections.find((s) => s.kind === kind).offset;
  assert.throws(change(0, 0), code("K102"));
  assert.throws(change(8, 0x04030201), code("K103"));
  assert.throws(change(12, 2), code("K104"));
  assert.throws(change(32, 2000000000), code("K107"));
  assert.throws(change(96 + 16, 0), code("K209"));
  assert.throws(change(96 + 28, 5), code("K213"));
  assert.throws(change(start("STRS"), 4000000), code("K302"));
  assert.throws(change(start("STRS") + 16, 65536), code("K303"));
  assert.throws(change(start("LEVL") + 4, 4000000000), code("K301"));
  assert.throws(change(start("LEVL") + 32 + 40, 3), code("K304"));
  assert.throws(change(start("SUBM") + 16 + 4, 1), code("K304"));
  assert.throws(change(start("WNDW"), 7), code("K318"));
  assert.throws(change(start("CLUS"), 4000000000), code("K317"));
});

test("unknown sections are skipped where they are optional and refused by name where they are not", () => {
  const extra = { kind: "mine", bytes: Uint8Array.of(1, 2, 3) };
  const container = openContainer(assemble([...small(), extra]));
  assert.deepEqual(container.sectionBytes(11), Uint8Array.of(1, 2, 3));
  assert.equal(container.sections[11].known, false);
  assert.throws(() => openContainer(assemble([...small(), { ...extra, kind: "NEWS" }])), /K202.*NEWS/);
  const newer = small();
  newer[4] = { ...newer[4], version: 3 };
  assert.throws(() => openContainer(assemble(newer)), /K203.*TEXT/);
});

test("coded sections are refused by name until their decoder is given", () => {
  const sections = small();
  const invert = (bytes) => bytes.map((byte) => byte ^ 0xff);
  const code3 = bytesOf(72, invert(sections[9].bytes));
  sections[9] = { ...sections[9], bytes: code3, raw: sections[9].bytes, codec: 3 };
  sections[10] = { ...sections[10], bytes: invert(sections[10].bytes), raw: sections[10].bytes, codec: 4 };
  const file = assemble([...sections, { ...WINDOW, bytes: invert(WINDOW.bytes), raw: WINDOW.bytes, codec: 1 }]);
  const lacking = openContainer(file);
  assert.deepEqual(lacking.level(1).indices, Uint16Array.of(0, 1, 2));
  assert.throws(() => lacking.level(0), /K205.*meshopt-vertex/);
  assert.throws(() => lacking.layouts, /K205.*WNDW.*zstd/);
  const calls = [];
  const decode = (target, count, size, source) => {
    calls.push([count, size]);
    target.set(invert(source));
  };
  const decoders = { zstd: invert, meshoptVertex: decode, meshoptIndex: decode };
  const container = openContainer(file, { decoders });
  container.validate();
  assert.deepEqual(container.level(0).positions, POSITIONS);
  assert.deepEqual(container.layouts.window.parents, Uint32Array.of(0, 1, 2, 2, 2, 3));
  assert.deepEqual(calls, [[6, 12], [12, 2]], "each section is decoded once");
  const fails = (changed) => openContainer(file, { decoders: { ...decoders, ...changed } });
  assert.throws(() => fails({ zstd: () => new Uint8Array(3) }).layouts, code("K219"));
  assert.throws(() => fails({ meshoptVertex: () => { throw new Error("malformed"); } }).level(0), code("K219"));
  assert.throws(() => fails({ meshoptIndex: () => {} }).validate(), code("K215"));
  const short = assemble([...sections.slice(0, 9), { ...sections[9], bytes: code3.slice(0, 40) }, sections[10]]);
  assert.throws(() => openContainer(short, { decoders }).level(0), code("K219"));
});

test("codecs stand where they belong and expand no more than they can", () => {
  const coded = (number, codec, bytes) => {
    const sections = small();
    sections[number] = { ...sections[number], raw: sections[number].bytes, bytes, codec };
    return () => openContainer(assemble(sections));
  };
  assert.throws(coded(1, 1, zeros(64)), code("K205"));
  assert.throws(coded(7, 3, zeros(64)), code("K205"));
  assert.throws(coded(9, 4, zeros(64)), code("K205"));
  assert.throws(coded(9, 2, zeros(64)), code("K205"));
  assert.throws(coded(10, 4, zeros(1)), code("K213"));
  assert.throws(coded(9, 1, zeros(0)), code("K213"));
});

test("levels may be the first elements of level 0's arrays", () => {
  const sections = small();
  const levels = sections[1].bytes.slice();
  const view = new DataView(levels.buffer);
  view.setUint32(32 + 96 + 40, 8, true);
  view.setUint32(32 + 96 + 44, 6, true);
  view.setUint32(32 + 40, 8, true);
  view.setUint32(32 + 44, 9, true);
  const needs = 32 + 2 * 96 + 2 * 32;
  [7, 8, 9, 6, 7, 8].forEach((need, i) => view.setUint32(needs + 4 * i, need, true));
  const textures = sections[4].bytes.slice();
  const mips = new DataView(textures.buffer);
  for (const at of [16 + 36, 16 + 64 + 8, 16 + 96 + 8]) mips.setUint32(at, 7, true);
  const shared = [sections[0], { ...sections[1], bytes: levels, version: 2 }, sections[2], sections[3], { ...sections[4], bytes: textures },
    sections[5], sections[7], sections[8], sections[9], sections[10]];
  const container = openContainer(assemble(shared));
  container.validate();
  assert.deepEqual(container.level(1).positions, POSITIONS.slice(0, 9));
  assert.equal(container.level(1).positions.byteOffset, container.level(0).positions.byteOffset);
});

test("levels are chosen by triangles, by error and by pixels", () => {
  const list = [{ triangles: 100, error: 0 }, { triangles: 10, error: 0.01 }, { triangles: 1, error: 0.1 }];
  assert.deepEqual([1000, 100, 99, 5, 0].map((most) => chooseByTriangles(list, most)), [0, 0, 1, 2, 2]);
  assert.deepEqual([0, 0.01, 0.05, 1].map((most) => chooseByError(list, most)), [0, 1, 1, 2]);
  // One unit covers 100 pixels at distance 1, because tan(45 degrees) = 1.
  const view = (distance) => ({ distance, verticalFov: Math.PI / 2, viewportHeight: 200 });
  assert.ok(Math.abs(pixelsPerUnit(view(1)) - 100) < 1e-9);
  assert.deepEqual([0.5, 1.01, 9, 10.1, 0, -1, NaN].map((d) => chooseByPixels(list, view(d), 1)), [0, 1, 1, 2, 0, 0, 0]);
  assert.equal(distanceToBox([4, 5, 0.5], [0, 0, 0], [1, 1, 1]), 5);
  assert.equal(distanceToBox([0.5, 0.5, 0.5], [0, 0, 0], [1, 1, 1]), 0);
  const allowed = allowedForEye([3, 0, 0], view(0), 1);
  assert.ok(Math.abs(allowed(0, 0, 0, 1) - 0.02) < 1e-12, "two units from the sphere a pixel covers 2 / 100");
  assert.equal(allowed(0, 0, 0, 4), 0, "inside the sphere nothing is allowed");
});

test("numbers are printed as the shortest decimal that rounds to the f32", () => {
  const cases = [[0.1, 0.1], [1 / 3, 0.33333334], [16777216, 16777216], [1e-45, 1e-45], [3.4028234663852886e38, 3.4028235e38], [0, 0]];
  for (const [value, expected] of cases) assert.equal(shortest(Math.fround(value)), expected);
});
