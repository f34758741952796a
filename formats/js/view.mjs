// How large a length is on a screen, and which level that asks for. Lists run from the finest to the coarsest: a container's levels,
// or a layout's checkpoints.

/**
 * @typedef {object} View a perspective camera
 * @property {number} distance from the eye to the nearest point of the object, object units ({@link distanceToBox})
 * @property {number} verticalFov full vertical angle of view, radians
 * @property {number} viewportHeight pixels
 */

/**
 * Pixels that one object unit covers, at most, at the view's distance; infinite at or behind the eye.
 * @param {View} view
 */
export function pixelsPerUnit({ distance, verticalFov, viewportHeight }) {
  const span = 2 * distance * Math.tan(verticalFov / 2);
  const scale = viewportHeight / span;
  return span > 0 && scale >= 0 && Number.isFinite(scale) ? scale : Infinity;
}

/**
 * From a point to the nearest point of a box, both in object space; 0 inside.
 * @param {ArrayLike<number>} eye
 * @param {ArrayLike<number>} boundsMin
 * @param {ArrayLike<number>} boundsMax
 */
export function distanceToBox(eye, boundsMin, boundsMax) {
  return Math.hypot(...[0, 1, 2].map((k) => Math.max(boundsMin[k] - eye[k], eye[k] - boundsMax[k], 0)));
}

/**
 * The finest entry of at most `most` triangles; the coarsest if all have more.
 * @param {{triangles: number}[]} list finest first
 * @param {number} most
 * @returns {number} its index
 */
export function chooseByTriangles(list, most) {
  const index = list.findIndex((entry) => entry.triangles <= most);
  return index < 0 ? list.length - 1 : index;
}

/**
 * The coarsest entry whose error is at most `most` object units; the finest if all have more.
 * @param {{error: number}[]} list finest first
 * @param {number} most
 * @returns {number} its index
 */
export function chooseByError(list, most) {
  return Math.max(0, list.findLastIndex((entry) => entry.error <= most));
}

/**
 * The coarsest entry whose error covers at most `most` pixels; the finest if all cover more.
 * @param {{error: number}[]} list finest first
 * @param {View} view
 * @param {number} most
 * @returns {number} its index
 */
export function chooseByPixels(list, view, most) {
  const scale = pixelsPerUnit(view);
  return Math.max(0, list.findLastIndex((entry) => entry.error * scale <= most));
}

/**
 * What `selectClusters` may allow for an eye: what `pixels` pixels cover at the nearest point of a group's sphere.
 * @param {ArrayLike<number>} eye object space
 * @param {{verticalFov: number, viewportHeight: number}} camera
 * @param {number} pixels
 */
export function allowedForEye(eye, camera, pixels) {
  return (x, y, z, radius) => {
    const distance = Math.hypot(x - eye[0], y - eye[1], z - eye[2]) - radius;
    return pixels / pixelsPerUnit({ ...camera, distance });
  };
}
