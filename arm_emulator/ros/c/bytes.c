#include "bytes.h"

#include <stdlib.h>

static void* new_bytes(size_t size, void* state) {
  (void)state;
  return malloc(size);
}

static void delete_bytes(void* bytes, void* state) {
  (void)state;
  free(bytes);
}

static void* resized_bytes(void* bytes, size_t size, void* state) {
  (void)state;
  return realloc(bytes, size);
}

static void* zero_bytes(size_t number, size_t size, void* state) {
  (void)state;
  return calloc(number, size);
}

rcl_bytes ros_no_bytes(void) {
  const rcl_allocator allocator = {new_bytes, delete_bytes, resized_bytes, zero_bytes, NULL};
  const rcl_bytes none = {NULL, 0, 0, allocator};
  return none;
}
