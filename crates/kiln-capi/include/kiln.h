/* kiln: read containers of levels of detail. Generated from crates/kiln-capi and kiln-format; do not edit.
 *
 * Functions fill structs of the caller's with numbers and with pointers that live until kiln_close. A handle never changes: any
 * number of threads may read one. With the static library, link the system's libraries for threads, mathematics and C++. */

#ifndef KILN_H
#define KILN_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

// Flag bit of a window that has `starts`.
#define WINDOW_HAS_STARTS 1

// An index that names nothing.
#define KILN_NONE 4294967295

// What a function came to.
typedef enum kiln_status {
  // Done.
  KILN_STATUS_OK = 0,
  // A pointer that is needed is NULL.
  KILN_STATUS_NULL = 1,
  // A number is not below its count, or what was asked for is not in this container.
  KILN_STATUS_NONE = 2,
  // The bytes are no sound container; the error's message starts with the code of the failed check, such as `K109`.
  KILN_STATUS_INVALID = 3,
  // The file cannot be read.
  KILN_STATUS_IO = 4,
  // A defect of this library; the handle may be closed.
  KILN_STATUS_INTERNAL = 5,
} kiln_status;

// An open container.
typedef struct kiln_container kiln_container;

// What went wrong: filled in by functions that open, where the caller passes one.
typedef struct kiln_error {
  // As returned.
  enum kiln_status status;
  // UTF-8, ended by a zero, cut where it is longer.
  char message[508];
} kiln_error;

// Counts and facts that hold for the whole container.
typedef struct kiln_info {
  // Bytes of the file.
  uint64_t file_length;
  // Major version.
  uint32_t major;
  // Minor version.
  uint32_t minor;
  // Triangles of the source asset.
  uint32_t source_triangles;
  // Sheets of the UV layout, 0 without one.
  uint32_t sheets;
  // Sections.
  uint32_t sections;
  // Levels, at least one.
  uint32_t levels;
  // Submeshes; every level has one draw range for each.
  uint32_t submeshes;
  // Materials.
  uint32_t materials;
  // Textures.
  uint32_t textures;
  // 1 if the container says what made it.
  uint32_t has_provenance;
} kiln_info;

// UTF-8 without a terminator; `data` is never NULL after a function that came to `KILN_STATUS_OK`.
typedef struct kiln_str {
  // First byte.
  const uint8_t *data;
  // Bytes.
  size_t length;
} kiln_str;

// One section of the file.
typedef struct kiln_section {
  // Four letters and a zero.
  char kind[5];
  // 1 if readers that do not know it must refuse the file.
  uint8_t required;
  // Version of its layout.
  uint16_t version;
  // Codec number, 0 for none.
  uint32_t codec;
  // Its name; empty where the number is not registered.
  struct kiln_str codec_name;
  // Bytes.
  uint32_t alignment;
  // From the start of the file, bytes.
  uint64_t offset;
  // Bytes in the file.
  uint64_t stored_length;
  // Bytes after decoding.
  uint64_t raw_length;
  // BLAKE3 of the decoded bytes.
  uint8_t raw_hash[32];
} kiln_section;

// What to draw of one submesh at one level.
typedef struct kiln_draw_range {
  // First index, counted in indices.
  uint32_t first_index;
  // Number of indices, a multiple of 3; 0 where nothing of the submesh is left.
  uint32_t index_count;
  // Least index value in the range.
  uint32_t first_vertex;
  // Greatest index value minus the least plus one; 0 for an empty range.
  uint32_t vertex_count;
  // Least corner of the box over the vertices in use, object units.
  float bounds_min[3];
  // Greatest corner.
  float bounds_max[3];
  // Zero.
  uint32_t reserved[2];
} kiln_draw_range;

// One level.
typedef struct kiln_level {
  // Triangles.
  uint32_t triangles;
  // Vertices.
  uint32_t vertices;
  // Distance to the source surface, object units.
  float error;
  // 1: greatest over samples; 2: nowhere exceeded.
  uint32_t error_kind;
  // Least corner of the box over all vertices, object units.
  float bounds_min[3];
  // Greatest corner.
  float bounds_max[3];
  // Bytes of an index, 2 or 4.
  uint32_t index_width;
  // Vertex arrays.
  uint32_t arrays;
  // `3 * triangles` indices, counter-clockwise front faces; NULL where the level is not at hand.
  const void *indices;
  // `[submeshes]`.
  const struct kiln_draw_range *ranges;
  // Bytes of its vertices and indices in the file.
  uint64_t stored_bytes;
  // Bytes of the file's prefix that has this level and its mip tails.
  uint64_t prefix_bytes;
} kiln_level;

// One vertex array of a level.
typedef struct kiln_array {
  // 1 positions, 2 normals, 3 tangents, 4 uv0, 5 uv1, 6 colors, 7 joints, 8 weights.
  uint32_t semantic;
  // 1 f32x2, 2 f32x3, 3 f32x4, 4 u16x4.
  uint32_t format;
  // The semantic's name.
  struct kiln_str name;
  // The format's name.
  struct kiln_str format_name;
  // Bytes of one element.
  uint32_t stride;
  // Elements: the level's vertices.
  uint32_t count;
  // Elements, without gap; NULL where the level is not at hand.
  const void *data;
} kiln_array;

// One submesh.
typedef struct kiln_submesh {
  // Name, unique in its asset.
  struct kiln_str name;
  // Material number, or `KILN_NONE` for glTF's default material.
  uint32_t material;
  // Triangles it had in the source asset.
  uint32_t source_triangles;
} kiln_submesh;

// A texture in use by a material.
typedef struct kiln_slot {
  // Texture number, or `KILN_NONE`: then the rest is zero.
  uint32_t texture;
  // UV set: 0 or 1.
  uint32_t uv_set;
  // 0 repeat, 1 mirrored repeat, 2 clamp to edge.
  uint8_t wrap_u;
  // As `wrap_u`.
  uint8_t wrap_v;
  // Magnification: 0 nearest, 1 linear.
  uint8_t mag;
  // Minification inside one mip: 0 nearest, 1 linear.
  uint8_t min;
  // Between mips: 0 mip 0 only, 1 nearest mip, 2 linear.
  uint32_t mip;
  // Added to the UV after scale and rotation.
  float uv_offset[2];
  // Factor on the UV.
  float uv_scale[2];
  // Rotation of the UV, radians.
  float uv_rotation;
} kiln_slot;

// glTF 2.0's metallic-roughness core.
typedef struct kiln_material {
  // Name, may be empty or repeated.
  struct kiln_str name;
  // 0 opaque, 1 mask, 2 blend.
  uint32_t alpha_mode;
  // Cutoff of mode mask.
  float alpha_cutoff;
  // 1 if back faces are drawn too.
  uint32_t double_sided;
  // Linear RGBA.
  float base_color_factor[4];
  // Linear RGB.
  float emissive_factor[3];
  // Factor on metalness.
  float metallic_factor;
  // Factor on roughness.
  float roughness_factor;
  // Factor on x and y of the normal map.
  float normal_scale;
  // Strength of the occlusion.
  float occlusion_strength;
  // Base colour, metallic-roughness, normal, occlusion, emissive.
  struct kiln_slot slots[5];
} kiln_material;

// One texture.
typedef struct kiln_texture {
  // Name, may be empty or repeated.
  struct kiln_str name;
  // Format number of the page's table.
  uint32_t format;
  // Its name.
  struct kiln_str format_name;
  // Bit n: used in slot n of materials; or the bit of one extra.
  uint32_t roles;
  // What an extra picture holds, empty for textures of materials.
  struct kiln_str extra;
  // Sheet on which an extra lies.
  uint32_t sheet;
  // Meaning of R, G, B, A: numbers of the page's table.
  uint8_t channels[4];
  // Their names.
  struct kiln_str channel_names[4];
  // Texels across.
  uint32_t width;
  // Texels down.
  uint32_t height;
  // Mips, at least one.
  uint32_t mips;
  // First mip that lies in the tail.
  uint32_t tail_first;
} kiln_texture;

// Bytes.
typedef struct kiln_bytes {
  // First byte; NULL where the section is not at hand.
  const uint8_t *data;
  // Number of bytes.
  size_t length;
} kiln_bytes;

// One mip of a texture.
typedef struct kiln_mip {
  // Texels across.
  uint32_t width;
  // Texels down.
  uint32_t height;
  // Bytes of its texels or blocks, whether at hand or not.
  uint64_t length;
  // Top row first, rows without gap.
  struct kiln_bytes texels;
} kiln_mip;

// What made the file.
typedef struct kiln_provenance {
  // BLAKE3 of the pipeline.
  uint8_t pipeline[32];
  // Tool and version.
  struct kiln_str tool;
  // Which machines give the same bytes.
  struct kiln_str numeric_class;
  // Device class of GPU stages, or empty.
  struct kiln_str device_class;
  // Inputs.
  uint32_t inputs;
  // Stages.
  uint32_t stages;
} kiln_provenance;

// An input of the build.
typedef struct kiln_input {
  // Relative name.
  struct kiln_str name;
  // BLAKE3 of its bytes.
  uint8_t hash[32];
} kiln_input;

// A stage of the build.
typedef struct kiln_stage {
  // Id or kind.
  struct kiln_str name;
  // Semantic version.
  struct kiln_str version;
} kiln_stage;

// One measured place on a layout's scale of detail; they stand finest first.
typedef struct kiln_checkpoint {
  // Window: collapses done, ascending from 0. Trees: threshold rank, descending from the node count.
  uint32_t detail;
  // Window: vertices alive. Trees: different picks of all vertices.
  uint32_t vertices;
  // Triangles alive.
  uint32_t triangles;
  // Distance to the source surface, object units, as a level's; not falling from one checkpoint to the next.
  float error;
  // The level of the level table that it equals, or [`crate::record::NONE`].
  uint32_t level;
  // Zero.
  uint32_t reserved[3];
} kiln_checkpoint;

// A sliding window over level 0.
typedef struct kiln_window {
  // Level 0's vertices.
  uint32_t vertices;
  // Level 0's triangles.
  uint32_t triangles;
  // D: LOD d is 0 to D.
  uint32_t collapses;
  // Vertices that never go.
  uint32_t base_vertices;
  // Bytes of its section in the file.
  uint64_t stored_bytes;
  // Finest first.
  const struct kiln_checkpoint *checkpoints;
  // Number of them.
  size_t checkpoint_count;
  // `[vertices]`.
  const uint32_t *parents;
  // `[ceil(vertices / 32)]`, or NULL: every vertex is a point.
  const uint32_t *starts;
} kiln_window;

// Tree and leaf buffers over level 0.
typedef struct kiln_tree_leaf {
  // N.
  uint32_t nodes;
  // Level 0's vertices.
  uint32_t vertices;
  // R.
  uint32_t rows;
  // C.
  uint32_t columns;
  // W, texels.
  uint32_t width;
  // Number of texels.
  uint32_t texels;
  // Bytes of its two sections in the file.
  uint64_t stored_bytes;
  // Finest first.
  const struct kiln_checkpoint *checkpoints;
  // Number of them.
  size_t checkpoint_count;
  // `[rows + 1]`.
  const uint32_t *row_starts;
  // `[nodes + 1]`.
  const uint32_t *face_counts;
  // `[texels] x 4`: x, y, z, q.
  const float *tree;
  // `[vertices] x 4`: x, y, z, number of the terminal node's texel.
  const float *leaf;
} kiln_tree_leaf;

// One node of a compact tree; its place is its rank.
typedef struct kiln_compact_node {
  // Representative position, object units.
  float position[3];
  // Rank of the parent, below its own; the root's is 0.
  uint32_t parent;
} kiln_compact_node;

// A compact tree over level 0.
typedef struct kiln_compact_tree {
  // N.
  uint32_t node_count;
  // Level 0's vertices.
  uint32_t vertices;
  // R.
  uint32_t rows;
  // Bytes of its section in the file.
  uint64_t stored_bytes;
  // Finest first.
  const struct kiln_checkpoint *checkpoints;
  // Number of them.
  size_t checkpoint_count;
  // `[rows + 1]`.
  const uint32_t *row_starts;
  // `[node_count + 1]`.
  const uint32_t *face_counts;
  // `[node_count]`.
  const struct kiln_compact_node *nodes;
  // `[vertices]`.
  const uint32_t *terminals;
} kiln_compact_tree;

// One cluster.
typedef struct kiln_cluster {
  // First of its references.
  uint32_t first_reference;
  // Its vertices, 1 to [`MAX_CLUSTER_VERTICES`].
  uint32_t vertex_count;
  // First of its triangles.
  uint32_t first_triangle;
  // Its triangles, 1 to [`MAX_CLUSTER_TRIANGLES`].
  uint32_t triangle_count;
  // Its submesh.
  uint32_t submesh;
  // The group whose simplification replaces it; its group's error says from when on.
  uint32_t group;
  // The group whose simplification made it, or [`crate::record::NONE`] for clusters of level 0's triangles.
  uint32_t made_by;
  // Level of the DAG, 0 the finest.
  uint32_t level;
  // Smallest known sphere over its vertices: centre and radius, object units.
  float sphere[4];
  // Axis of its normals' cone, and the cosine of its half angle's complement (`meshopt`'s cutoff; 1: no cone).
  float cone[4];
} kiln_cluster;

// One group of clusters that are simplified together.
typedef struct kiln_group {
  // Holds the spheres of its clusters and of the groups that made them: centre and radius, object units.
  float sphere[4];
  // Error of what replaces its clusters, object units; [`f32::MAX`] where nothing does (roots).
  float error;
  // First of its clusters.
  uint32_t first_cluster;
  // Its clusters, at least one.
  uint32_t cluster_count;
  // Level of its clusters.
  uint32_t level;
} kiln_group;

// A cluster DAG over level 0.
typedef struct kiln_clusters {
  // K.
  uint32_t cluster_count;
  // G.
  uint32_t group_count;
  // Levels of the DAG.
  uint32_t levels;
  // Number of references.
  uint32_t reference_count;
  // Triangles of all clusters.
  uint32_t triangles;
  // Level 0's vertices.
  uint32_t vertices;
  // Bytes of its section in the file.
  uint64_t stored_bytes;
  // `[cluster_count]`.
  const struct kiln_cluster *clusters;
  // `[group_count]`.
  const struct kiln_group *groups;
  // `[reference_count]`: vertices of level 0, cluster by cluster.
  const uint32_t *references;
  // `[triangles] x 3`: places in the cluster's references.
  const uint8_t *corners;
} kiln_clusters;

// A view through a perspective camera.
typedef struct kiln_view {
  // From the eye to the nearest point of the object's box, object units.
  float distance;
  // Full vertical angle of view, radians.
  float vertical_fov_radians;
  // Height of the viewport, pixels.
  float viewport_height_px;
} kiln_view;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Opens the container in `length` bytes, the whole file, and checks everything once. `*out` is the handle, NULL on failure.
//
// With `copy` 0, bytes on a multiple of 16 are lent and not copied: they must stay valid and unchanged until `kiln_close`. Bytes
// elsewhere are copied in any case.
//
// # Safety
// `bytes` is NULL or points to `length` bytes; `out` and `error` are NULL or may be written; with `copy` 0 the bytes outlive the
// handle.
enum kiln_status kiln_open_bytes(const uint8_t *bytes,
                                 size_t length,
                                 int32_t copy,
                                 struct kiln_container **out,
                                 struct kiln_error *error);

// Opens the container in a file, and checks everything once. `*out` is the handle, NULL on failure.
//
// # Safety
// `path` is NULL or ends with a zero; `out` and `error` are NULL or may be written.
enum kiln_status kiln_open_file(const char *path, struct kiln_container **out, struct kiln_error *error);

// Closes a container and frees what was copied; all pointers that it lent are void. NULL is allowed.
//
// # Safety
// `container` is NULL or an open handle, which no thread uses any more.
void kiln_close(struct kiln_container *container);

// Counts and facts that hold for the whole container.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_info(const struct kiln_container *container, struct kiln_info *out);

// A section, by its place in the table.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_section(const struct kiln_container *container, uint32_t number, struct kiln_section *out);

// A level, 0 the finest.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_level(const struct kiln_container *container, uint32_t lod, struct kiln_level *out);

// A vertex array of a level, by its place among the level's arrays.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_array(const struct kiln_container *container, uint32_t lod, uint32_t number, struct kiln_array *out);

// A submesh.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_submesh(const struct kiln_container *container, uint32_t number, struct kiln_submesh *out);

// A material.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_material(const struct kiln_container *container, uint32_t number, struct kiln_material *out);

// A texture.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_texture(const struct kiln_container *container, uint32_t number, struct kiln_texture *out);

// A mip of a texture, 0 the picture itself.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_mip(const struct kiln_container *container, uint32_t texture, uint32_t number, struct kiln_mip *out);

// What made the file; `KILN_STATUS_NONE` if it does not say so.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_provenance(const struct kiln_container *container, struct kiln_provenance *out);

// An input of the build that made the file.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_input(const struct kiln_container *container, uint32_t number, struct kiln_input *out);

// A stage of the build that made the file.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_stage(const struct kiln_container *container, uint32_t number, struct kiln_stage *out);

// The sliding window; `KILN_STATUS_NONE` if there is none.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_window(const struct kiln_container *container, struct kiln_window *out);

// Tree and leaf buffers; `KILN_STATUS_NONE` if there are none.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_tree_leaf(const struct kiln_container *container, struct kiln_tree_leaf *out);

// The compact tree; `KILN_STATUS_NONE` if there is none.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_compact_tree(const struct kiln_container *container, struct kiln_compact_tree *out);

// The cluster DAG; `KILN_STATUS_NONE` if there is none.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_clusters(const struct kiln_container *container, struct kiln_clusters *out);

// The stored bytes of a section, by its place in the table: for private ones. Its bytes are as they stand in the file, coded or not.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_get_section_bytes(const struct kiln_container *container,
                                        uint32_t number,
                                        struct kiln_bytes *out);

// The coarsest level whose error covers at most `max_error_px` pixels in a view; the finest if there is none.
//
// # Safety
// `container` is NULL or an open handle; `view` is NULL or points to a view; `out` is NULL or may be written.
enum kiln_status kiln_choose_level(const struct kiln_container *container,
                                   const struct kiln_view *view,
                                   float max_error_px,
                                   uint32_t *out);

// The coarsest level whose error is at most `max_error` object units; the finest if there is none.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_choose_by_error(const struct kiln_container *container, float max_error, uint32_t *out);

// The finest level of at most `budget` triangles; the coarsest if there is none.
//
// # Safety
// `container` is NULL or an open handle; `out` is NULL or may be written.
enum kiln_status kiln_choose_by_triangles(const struct kiln_container *container, uint32_t budget, uint32_t *out);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* KILN_H */
