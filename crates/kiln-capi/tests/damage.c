/* damage FILE.kiln: every prefix and every flipped byte of a small container, lent and copied, at any address: an error, or the same
 * summary. NULL pointers and numbers out of range are answered. Prints what was tried; exit status 1 at the first fault. */

#include <string.h>

#define KILN_SUMMARY_WITHOUT_MAIN
#include "../examples/summary.c"

#define EXPECT(condition)                                                     \
  do {                                                                        \
    if (!(condition)) {                                                       \
      fprintf(stderr, "%s:%d: %s does not hold\n", __FILE__, __LINE__, #condition); \
      exit(1);                                                                \
    }                                                                         \
  } while (0)

/* The summary of the bytes, to be freed; NULL where they are refused. */
static char *summary_of(const uint8_t *bytes, size_t length, int copy) {
  kiln_container *container = NULL;
  kiln_error error = {KILN_STATUS_OK, {0}};
  const kiln_status status = kiln_open_bytes(bytes, length, copy, &container, &error);
  if (status != KILN_STATUS_OK) {
    EXPECT(container == NULL && error.status == status && error.message[0] != 0);
    EXPECT(memchr(error.message, 0, sizeof error.message) != NULL);
    return NULL;
  }
  FILE *out = tmpfile();
  EXPECT(out != NULL && put_summary(out, container) == 0);
  kiln_close(container);
  const long size = ftell(out);
  rewind(out);
  char *text = malloc((size_t)size + 1);
  EXPECT(text != NULL && fread(text, 1, (size_t)size, out) == (size_t)size);
  text[size] = 0;
  fclose(out);
  return text;
}

static void refuse_nonsense(const uint8_t *bytes, size_t length) {
  kiln_container *container = NULL;
  kiln_error error;
  EXPECT(kiln_open_bytes(NULL, 5, 0, &container, &error) == KILN_STATUS_NULL);
  EXPECT(kiln_open_bytes(bytes, length, 0, NULL, NULL) == KILN_STATUS_NULL);
  EXPECT(kiln_open_bytes(bytes, 0, 0, &container, NULL) == KILN_STATUS_INVALID);
  EXPECT(kiln_open_bytes(bytes, SIZE_MAX, 0, &container, &error) == KILN_STATUS_INVALID);
  EXPECT(kiln_open_file(NULL, &container, &error) == KILN_STATUS_NULL);
  EXPECT(kiln_open_file("no such file", &container, &error) == KILN_STATUS_IO && container == NULL);
  kiln_close(NULL);

  EXPECT(kiln_open_bytes(bytes, length, 0, &container, NULL) == KILN_STATUS_OK);
  kiln_info info;
  EXPECT(kiln_get_info(container, &info) == KILN_STATUS_OK);
  EXPECT(kiln_get_info(NULL, &info) == KILN_STATUS_NULL && kiln_get_info(container, NULL) == KILN_STATUS_NULL);
  kiln_section section;
  kiln_bytes stored;
  kiln_level level;
  kiln_array array;
  kiln_submesh submesh;
  kiln_material material;
  kiln_texture texture;
  kiln_mip mip;
  kiln_input input;
  kiln_stage stage;
  const uint32_t beyond[2] = {1000, KILN_NONE};
  for (int i = 0; i < 2; i++) {
    const uint32_t n = beyond[i];
    EXPECT(kiln_get_section(container, n, &section) == KILN_STATUS_NONE);
    EXPECT(kiln_get_section_bytes(container, n, &stored) == KILN_STATUS_NONE);
    EXPECT(kiln_get_level(container, n, &level) == KILN_STATUS_NONE);
    EXPECT(kiln_get_array(container, n, 0, &array) == KILN_STATUS_NONE);
    EXPECT(kiln_get_array(container, 0, n, &array) == KILN_STATUS_NONE);
    EXPECT(kiln_get_submesh(container, n, &submesh) == KILN_STATUS_NONE);
    EXPECT(kiln_get_material(container, n, &material) == KILN_STATUS_NONE);
    EXPECT(kiln_get_texture(container, n, &texture) == KILN_STATUS_NONE);
    EXPECT(kiln_get_mip(container, n, 0, &mip) == KILN_STATUS_NONE && kiln_get_mip(container, 0, n, &mip) == KILN_STATUS_NONE);
    EXPECT(kiln_get_input(container, n, &input) == KILN_STATUS_NONE);
    EXPECT(kiln_get_stage(container, n, &stage) == KILN_STATUS_NONE);
  }
  EXPECT(kiln_get_level(container, 0, NULL) == KILN_STATUS_NULL && kiln_get_level(NULL, 0, &level) == KILN_STATUS_NULL);

  /* Lent pointers lie in the caller's bytes. */
  EXPECT(kiln_get_level(container, 0, &level) == KILN_STATUS_OK && kiln_get_array(container, 0, 0, &array) == KILN_STATUS_OK);
  const uint8_t *positions = array.data;
  EXPECT(positions > bytes && positions + (size_t)array.stride * array.count <= bytes + length && array.count == level.vertices);
  EXPECT((const uint8_t *)level.indices > bytes && (const uint8_t *)level.indices < bytes + length);

  /* One unit covers 100 pixels at distance 1. */
  kiln_view view = {0.001f, 1.5707964f, 200.0f};
  uint32_t lod = 7;
  EXPECT(kiln_choose_level(container, &view, 1.0f, &lod) == KILN_STATUS_OK && lod == 0);
  view.distance = 1e6f;
  EXPECT(kiln_choose_level(container, &view, 1.0f, &lod) == KILN_STATUS_OK && lod + 1 == info.levels);
  EXPECT(kiln_choose_by_error(container, 0.3f, &lod) == KILN_STATUS_OK && lod == 1);
  EXPECT(kiln_choose_by_error(container, 0.2f, &lod) == KILN_STATUS_OK && lod == 0);
  EXPECT(kiln_choose_by_triangles(container, 2, &lod) == KILN_STATUS_OK && lod == 0);
  EXPECT(kiln_choose_by_triangles(container, 1, &lod) == KILN_STATUS_OK && lod == 1);
  EXPECT(kiln_choose_by_triangles(NULL, 1, &lod) == KILN_STATUS_NULL);
  EXPECT(kiln_choose_level(container, NULL, 1.0f, &lod) == KILN_STATUS_NULL);
  EXPECT(kiln_choose_level(NULL, &view, 1.0f, &lod) == KILN_STATUS_NULL && kiln_choose_level(container, &view, 1.0f, NULL) == KILN_STATUS_NULL);
  kiln_close(container);
}

int main(int argc, char **argv) {
  EXPECT(argc == 2);
  FILE *in = fopen(argv[1], "rb");
  EXPECT(in != NULL && fseek(in, 0, SEEK_END) == 0);
  const size_t length = (size_t)ftell(in);
  rewind(in);
  /* A multiple of 256 bytes on a multiple of 256, and room to shift by 1. */
  uint8_t *bytes = aligned_alloc(256, (length / 256 + 2) * 256);
  EXPECT(bytes != NULL && fread(bytes, 1, length, in) == length);
  fclose(in);

  char *expected = summary_of(bytes, length, 0);
  EXPECT(expected != NULL);
  refuse_nonsense(bytes, length);

  size_t refused = 0;
  for (size_t cut = 0; cut < length; cut++) {
    EXPECT(summary_of(bytes, cut, cut % 2 == 0) == NULL);
    refused++;
  }
  for (size_t at = 0; at < length; at++) {
    bytes[at] ^= (uint8_t)(1u << at % 8);
    char *found = summary_of(bytes, length, at % 2 == 0);
    EXPECT(found == NULL || strcmp(found, expected) == 0);
    refused += found == NULL;
    free(found);
    bytes[at] ^= (uint8_t)(1u << at % 8);
  }
  memmove(bytes + 1, bytes, length);
  char *shifted = summary_of(bytes + 1, length, 0);
  EXPECT(shifted != NULL && strcmp(shifted, expected) == 0);
  free(shifted);
  free(expected);
  free(bytes);
  printf("%zu of %zu refused\n", refused, 2 * length);
  return 0;
}
