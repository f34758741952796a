// Decoders for `openContainer`: zstd by fzstd, meshoptimizer's own for geometry.

import { decompress } from "fzstd";
import { MeshoptDecoder } from "meshoptimizer";

await MeshoptDecoder.ready;

export const decoders = {
  zstd: (stored, rawLength) => decompress(stored, new Uint8Array(rawLength)),
  meshoptVertex: (target, count, size, source) => MeshoptDecoder.decodeVertexBuffer(target, count, size, source),
  meshoptIndex: (target, count, size, source) => MeshoptDecoder.decodeIndexBuffer(target, count, size, source),
};
