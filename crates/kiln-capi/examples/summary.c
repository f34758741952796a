/* Prints what is in a container as JSON, the summary that `kiln inspect FILE --json` prints.
 *
 *   cc -std=c11 -I include examples/summary.c libkiln_capi.a -lpthread -ldl -lm -lstdc++ -o summary
 *   ./summary FILE.kiln
 *
 * Numbers of 32 bits are printed as the shortest decimal that rounds to them. Exit status 2 and words on the standard error where
 * the file is no sound container. */

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "kiln.h"

static void put_string(FILE *out, kiln_str text) {
  fputc('"', out);
  for (size_t i = 0; i < text.length; i++) {
    const unsigned char c = text.data[i];
    if (c == '"' || c == '\\') fprintf(out, "\\%c", c);
    else if (c < 0x20) fprintf(out, "\\u%04x", c);
    else fputc(c, out);
  }
  fputc('"', out);
}

static void put_hash(FILE *out, const uint8_t hash[32]) {
  fputc('"', out);
  for (int i = 0; i < 32; i++) fprintf(out, "%02x", hash[i]);
  fputc('"', out);
}

static void put_float(FILE *out, float value) {
  char text[32];
  for (int digits = 1; digits <= 9; digits++) {
    snprintf(text, sizeof text, "%.*g", digits, (double)value);
    if (strtof(text, NULL) == value) break;
  }
  fputs(text, out);
}

static void put_point(FILE *out, const char *key, const float point[3]) {
  fprintf(out, ",\"%s\":[", key);
  for (int k = 0; k < 3; k++) {
    if (k > 0) fputc(',', out);
    put_float(out, point[k]);
  }
  fputc(']', out);
}

/* A comma before every element of a list but the first. */
static void separate(FILE *out, uint32_t number) {
  if (number > 0) fputc(',', out);
}

static void put_sections(FILE *out, const kiln_container *container, uint32_t count) {
  fputs(",\"sections\":[", out);
  for (uint32_t i = 0; i < count; i++) {
    kiln_section s;
    if (kiln_get_section(container, i, &s) != KILN_STATUS_OK) continue;
    separate(out, i);
    fprintf(out, "{\"number\":%" PRIu32 ",\"kind\":\"%s\",\"version\":%u,\"required\":%s,\"codec\":", i, s.kind, (unsigned)s.version,
            s.required ? "true" : "false");
    if (s.codec_name.length > 0) put_string(out, s.codec_name);
    else fprintf(out, "\"codec %" PRIu32 "\"", s.codec);
    fprintf(out, ",\"alignment\":%" PRIu32 ",\"offset\":%" PRIu64 ",\"stored_length\":%" PRIu64 ",\"raw_length\":%" PRIu64 ",\"raw_hash\":",
            s.alignment, s.offset, s.stored_length, s.raw_length);
    put_hash(out, s.raw_hash);
    fputc('}', out);
  }
  fputc(']', out);
}

static void put_levels(FILE *out, const kiln_container *container, const kiln_info *info) {
  fputs(",\"levels\":[", out);
  for (uint32_t lod = 0; lod < info->levels; lod++) {
    kiln_level level;
    if (kiln_get_level(container, lod, &level) != KILN_STATUS_OK) continue;
    separate(out, lod);
    fprintf(out, "{\"lod\":%" PRIu32 ",\"triangles\":%" PRIu32 ",\"vertices\":%" PRIu32 ",\"error\":", lod, level.triangles, level.vertices);
    put_float(out, level.error);
    fprintf(out, ",\"error_kind\":\"%s\",\"bytes\":%" PRIu64 ",\"bytes_per_triangle\":", level.error_kind == 1 ? "sampled" : "bound",
            level.stored_bytes);
    if (level.triangles == 0) fputs("null", out);
    else fprintf(out, "%.17g", (double)level.stored_bytes / (double)level.triangles);
    fprintf(out, ",\"prefix_bytes\":%" PRIu64 ",\"index_width\":%" PRIu32 ",\"arrays\":[", level.prefix_bytes, level.index_width);
    for (uint32_t i = 0; i < level.arrays; i++) {
      kiln_array array;
      if (kiln_get_array(container, lod, i, &array) != KILN_STATUS_OK) continue;
      separate(out, i);
      fprintf(out, "\"%.*s %.*s\"", (int)array.name.length, (const char *)array.name.data, (int)array.format_name.length,
              (const char *)array.format_name.data);
    }
    fputc(']', out);
    put_point(out, "bounds_min", level.bounds_min);
    put_point(out, "bounds_max", level.bounds_max);
    fputs(",\"submesh_triangles\":[", out);
    for (uint32_t i = 0; i < info->submeshes; i++) {
      separate(out, i);
      fprintf(out, "%" PRIu32, level.ranges[i].index_count / 3);
    }
    fputs("]}", out);
  }
  fputc(']', out);
}

static void put_submeshes(FILE *out, const kiln_container *container, uint32_t count) {
  fputs(",\"submeshes\":[", out);
  for (uint32_t i = 0; i < count; i++) {
    kiln_submesh submesh;
    if (kiln_get_submesh(container, i, &submesh) != KILN_STATUS_OK) continue;
    separate(out, i);
    fputs("{\"name\":", out);
    put_string(out, submesh.name);
    if (submesh.material == KILN_NONE) fputs(",\"material\":null", out);
    else fprintf(out, ",\"material\":%" PRIu32, submesh.material);
    fprintf(out, ",\"source_triangles\":%" PRIu32 "}", submesh.source_triangles);
  }
  fputc(']', out);
}

static const char *const ROLES[5] = {"base-color", "metallic-roughness", "normal", "occlusion", "emissive"};

static void put_materials(FILE *out, const kiln_container *container, uint32_t count) {
  static const char *const modes[3] = {"opaque", "mask", "blend"};
  fputs(",\"materials\":[", out);
  for (uint32_t i = 0; i < count; i++) {
    kiln_material material;
    if (kiln_get_material(container, i, &material) != KILN_STATUS_OK) continue;
    separate(out, i);
    fputs("{\"name\":", out);
    put_string(out, material.name);
    fprintf(out, ",\"alpha_mode\":\"%s\",\"double_sided\":%s,\"textures\":[", modes[material.alpha_mode % 3],
            material.double_sided ? "true" : "false");
    uint32_t used = 0;
    for (int role = 0; role < 5; role++) {
      if (material.slots[role].texture == KILN_NONE) continue;
      separate(out, used++);
      fprintf(out, "[\"%s\",%" PRIu32 "]", ROLES[role], material.slots[role].texture);
    }
    fputs("]}", out);
  }
  fputc(']', out);
}

static void put_textures(FILE *out, const kiln_container *container, uint32_t count) {
  fputs(",\"textures\":[", out);
  for (uint32_t i = 0; i < count; i++) {
    kiln_texture texture;
    if (kiln_get_texture(container, i, &texture) != KILN_STATUS_OK) continue;
    separate(out, i);
    fputs("{\"name\":", out);
    put_string(out, texture.name);
    fprintf(out, ",\"width\":%" PRIu32 ",\"height\":%" PRIu32 ",\"format\":", texture.width, texture.height);
    put_string(out, texture.format_name);
    fputs(",\"roles\":[", out);
    uint32_t used = 0;
    for (int role = 0; role < 5; role++) {
      if ((texture.roles >> role & 1) == 0) continue;
      separate(out, used++);
      fprintf(out, "\"%s\"", ROLES[role]);
    }
    fputs("],\"extra\":", out);
    if (texture.extra.length > 0) put_string(out, texture.extra);
    else fputs("null", out);
    fprintf(out, ",\"sheet\":%" PRIu32 ",\"channels\":[", texture.sheet);
    for (uint32_t k = 0; k < 4; k++) {
      separate(out, k);
      put_string(out, texture.channel_names[k]);
    }
    uint64_t bytes = 0, tail_bytes = 0;
    for (uint32_t k = 0; k < texture.mips; k++) {
      kiln_mip mip;
      if (kiln_get_mip(container, i, k, &mip) != KILN_STATUS_OK) continue;
      bytes += mip.length;
      if (k >= texture.tail_first) tail_bytes += mip.length;
    }
    fprintf(out, "],\"mips\":%" PRIu32 ",\"bytes\":%" PRIu64 ",\"tail_bytes\":%" PRIu64 "}", texture.mips, bytes, tail_bytes);
  }
  fputc(']', out);
}

static void put_provenance(FILE *out, const kiln_container *container) {
  kiln_provenance provenance;
  if (kiln_get_provenance(container, &provenance) != KILN_STATUS_OK) {
    fputs(",\"provenance\":null", out);
    return;
  }
  fputs(",\"provenance\":{\"pipeline\":", out);
  put_hash(out, provenance.pipeline);
  fputs(",\"tool\":", out);
  put_string(out, provenance.tool);
  fputs(",\"numeric_class\":", out);
  put_string(out, provenance.numeric_class);
  fputs(",\"device_class\":", out);
  put_string(out, provenance.device_class);
  fputs(",\"inputs\":[", out);
  for (uint32_t i = 0; i < provenance.inputs; i++) {
    kiln_input input;
    if (kiln_get_input(container, i, &input) != KILN_STATUS_OK) continue;
    separate(out, i);
    fputc('[', out);
    put_string(out, input.name);
    fputc(',', out);
    put_hash(out, input.hash);
    fputc(']', out);
  }
  fputs("],\"stages\":[", out);
  for (uint32_t i = 0; i < provenance.stages; i++) {
    kiln_stage stage;
    if (kiln_get_stage(container, i, &stage) != KILN_STATUS_OK) continue;
    separate(out, i);
    fputc('[', out);
    put_string(out, stage.name);
    fputc(',', out);
    put_string(out, stage.version);
    fputc(']', out);
  }
  fputs("]}", out);
}

static void put_layout(FILE *out, uint32_t *number, const char *name, uint64_t bytes, uint32_t details, uint32_t triangles,
                       const kiln_checkpoint *checkpoints, size_t count) {
  separate(out, (*number)++);
  fprintf(out, "{\"name\":\"%s\",\"bytes\":%" PRIu64 ",\"details\":%" PRIu32 ",\"triangles\":%" PRIu32 ",\"checkpoints\":[", name, bytes,
          details, triangles);
  for (size_t i = 0; i < count; i++) {
    const kiln_checkpoint *c = &checkpoints[i];
    fprintf(out, "%s{\"detail\":%" PRIu32 ",\"vertices\":%" PRIu32 ",\"triangles\":%" PRIu32 ",\"error\":", i > 0 ? "," : "", c->detail,
            c->vertices, c->triangles);
    put_float(out, c->error);
    if (c->level == KILN_NONE) fputs(",\"level\":null}", out);
    else fprintf(out, ",\"level\":%" PRIu32 "}", c->level);
  }
  fputs("]}", out);
}

static void put_layouts(FILE *out, const kiln_container *container) {
  kiln_window window;
  kiln_tree_leaf tree;
  kiln_compact_tree compact;
  kiln_clusters clusters;
  uint32_t number = 0;
  fputs(",\"layouts\":[", out);
  if (kiln_get_window(container, &window) == KILN_STATUS_OK) {
    put_layout(out, &number, "sliding-window", window.stored_bytes, window.collapses, window.triangles, window.checkpoints,
               window.checkpoint_count);
  }
  if (kiln_get_tree_leaf(container, &tree) == KILN_STATUS_OK) {
    put_layout(out, &number, "tree-leaf", tree.stored_bytes, tree.nodes, tree.face_counts[tree.nodes], tree.checkpoints,
               tree.checkpoint_count);
  }
  if (kiln_get_compact_tree(container, &compact) == KILN_STATUS_OK) {
    put_layout(out, &number, "compact-tree", compact.stored_bytes, compact.node_count, compact.face_counts[compact.node_count],
               compact.checkpoints, compact.checkpoint_count);
  }
  if (kiln_get_clusters(container, &clusters) == KILN_STATUS_OK) {
    put_layout(out, &number, "clusters", clusters.stored_bytes, clusters.cluster_count, clusters.triangles, NULL, 0);
  }
  fputc(']', out);
}

/* The summary of an open container on one line; nonzero where the library does not answer. */
static int put_summary(FILE *out, const kiln_container *container) {
  kiln_info info;
  if (kiln_get_info(container, &info) != KILN_STATUS_OK) return 1;
  fprintf(out, "{\"version\":\"%" PRIu32 ".%" PRIu32 "\",\"file_length\":%" PRIu64 ",\"source_triangles\":%" PRIu32 ",\"sheets\":%" PRIu32,
          info.major, info.minor, info.file_length, info.source_triangles, info.sheets);
  put_sections(out, container, info.sections);
  put_levels(out, container, &info);
  put_submeshes(out, container, info.submeshes);
  put_materials(out, container, info.materials);
  put_textures(out, container, info.textures);
  put_provenance(out, container);
  put_layouts(out, container);
  fputs("}\n", out);
  return 0;
}

#ifndef KILN_SUMMARY_WITHOUT_MAIN
int main(int argc, char **argv) {
  if (argc != 2) {
    fprintf(stderr, "usage: %s FILE.kiln\n", argv[0]);
    return 64;
  }
  kiln_container *container = NULL;
  kiln_error error;
  if (kiln_open_file(argv[1], &container, &error) != KILN_STATUS_OK) {
    fprintf(stderr, "%s: %s\n", argv[1], error.message);
    return 2;
  }
  const int failed = put_summary(stdout, container);
  kiln_close(container);
  return failed;
}
#endif
