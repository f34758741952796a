// Decoders for `openContainer`: zstd by fzstd, meshoptimizer's own for geometry.

import { decompress } from "fzstd";
import { MeshoptDecoder } from "meshoptimizer";

await MeshoptDecoder.ready;

export const decoders = {
  // Without a length the frame tells it.
  zstd: (stored, rawLength) => decompress(stored, rawLength === undefined ? undefined : new Uint8Array(rawLength)),
  meshoptVertex: (target, count, size, source) => MeshoptDecoder.decodeVertexBuffer(target, count, size, source),
  meshoptIndex: (target, count, size, source) => MeshoptDecoder.decodeIndexBuffer(target, count, size, source),
};
