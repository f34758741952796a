// BLAKE3 (O'Connor, Aumasson, Neves, Wilcox-O'Hearn, 2020), unkeyed, 32 bytes out.
//
//   hash(bytes):     at most 1024 bytes are a chunk; more are a parent of two subtrees, the left one the largest power of two
//                    of whole chunks that leaves at least one byte to the right
//   chunk:           blocks of 64 bytes through `compress`, each with the chaining value of the one before
//   compress:        7 rounds of 8 mixes over a state of 16 words

const IV = Int32Array.of(
  0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19,
);
const CHUNK = 1024;
const BLOCK = 64;
const CHUNK_START = 1;
const CHUNK_END = 2;
const PARENT = 4;
const ROOT = 8;

/** Message words of each round: the paper's permutation, applied again and again. */
const SCHEDULE = (() => {
  const permutation = [2, 6, 3, 10, 7, 0, 4, 13, 1, 11, 12, 5, 9, 14, 15, 8];
  const rounds = [Array.from({ length: 16 }, (_, k) => k)];
  while (rounds.length < 7) rounds.push(permutation.map((k) => rounds.at(-1)[k]));
  return Uint8Array.from(rounds.flat());
})();

const state = new Int32Array(16);
const message = new Int32Array(16);

/** Mixes words `a` to `d` of the state with the message words that the schedule has at `k` and `k + 1`. */
function mix(a, b, c, d, k) {
  let va = state[a];
  let vb = state[b];
  let vc = state[c];
  let vd = state[d];
  va = (va + vb + message[SCHEDULE[k]]) | 0;
  vd ^= va;
  vd = (vd >>> 16) | (vd << 16);
  vc = (vc + vd) | 0;
  vb ^= vc;
  vb = (vb >>> 12) | (vb << 20);
  va = (va + vb + message[SCHEDULE[k + 1]]) | 0;
  vd ^= va;
  vd = (vd >>> 8) | (vd << 24);
  vc = (vc + vd) | 0;
  vb ^= vc;
  vb = (vb >>> 7) | (vb << 25);
  state[a] = va;
  state[b] = vb;
  state[c] = vc;
  state[d] = vd;
}

/** Replaces the chaining value `cv` by that of `message` behind it. */
function compress(cv, counter, length, flags) {
  for (let k = 0; k < 8; k++) state[k] = cv[k];
  for (let k = 0; k < 4; k++) state[8 + k] = IV[k];
  state[12] = counter | 0;
  state[13] = Math.floor(counter / 2 ** 32);
  state[14] = length;
  state[15] = flags;
  for (let at = 0; at < SCHEDULE.length; at += 16) {
    mix(0, 4, 8, 12, at);
    mix(1, 5, 9, 13, at + 2);
    mix(2, 6, 10, 14, at + 4);
    mix(3, 7, 11, 15, at + 6);
    mix(0, 5, 10, 15, at + 8);
    mix(1, 6, 11, 12, at + 10);
    mix(2, 7, 8, 13, at + 12);
    mix(3, 4, 9, 14, at + 14);
  }
  for (let k = 0; k < 8; k++) cv[k] = state[k] ^ state[k + 8];
}

/** Chaining value of one chunk: bytes start..end, at most 1024. */
function chunk(bytes, start, end, counter, root) {
  const cv = IV.slice();
  let at = start;
  do {
    const length = Math.min(BLOCK, end - at);
    if (length < BLOCK) message.fill(0);
    for (let k = 0, i = at; k < length >> 2; k++, i += 4) {
      message[k] = bytes[i] | (bytes[i + 1] << 8) | (bytes[i + 2] << 16) | (bytes[i + 3] << 24);
    }
    for (let k = length & ~3; k < length; k++) message[k >> 2] |= bytes[at + k] << ((k & 3) * 8);
    const last = at + length === end;
    compress(cv, counter, length, (at === start && CHUNK_START) | (last && CHUNK_END | root));
    at += length;
  } while (at < end);
  return cv;
}

/** Chaining value of the subtree over bytes start..end, whose first chunk is number `counter`. */
function subtree(bytes, start, end, counter, root) {
  if (end - start <= CHUNK) return chunk(bytes, start, end, counter, root);
  const chunks = 2 ** Math.floor(Math.log2(Math.ceil((end - start) / CHUNK) - 1));
  const left = subtree(bytes, start, start + chunks * CHUNK, counter, 0);
  const right = subtree(bytes, start + chunks * CHUNK, end, counter + chunks, 0);
  const cv = IV.slice();
  message.set(left);
  message.set(right, 8);
  compress(cv, 0, BLOCK, PARENT | root);
  return cv;
}

/**
 * The BLAKE3 hash of bytes.
 * @param {Uint8Array} bytes
 * @returns {Uint8Array} 32 bytes
 */
export function blake3(bytes) {
  return new Uint8Array(subtree(bytes, 0, bytes.length, 0, ROOT).buffer);
}

/**
 * Bytes as lower-case hexadecimal digits.
 * @param {Uint8Array} bytes
 * @returns {string}
 */
export function hex(bytes) {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
