#define _POSIX_C_SOURCE 200809L
#include "record_ring.h"

#include <poll.h>
#include <stddef.h>
#include <string.h>

static int has_room(const record_writer* writer) {
  const int64_t taken = __atomic_load_n(&writer->ring->taken, __ATOMIC_ACQUIRE);
  return writer->ring->written - taken < writer->capacity;
}

/* Whether there is room, at once or after the reader has made some. */
static int make_room(record_writer* writer) {
  while (!has_room(writer)) {
    struct pollfd reader = {writer->reader, 0, 0};
    if (!writer->waits) {
      ++writer->ring->dropped;
      return 0;
    }
    if (poll(&reader, 1, 1) > 0) writer->ended = 1;
    if (writer->ended) return 0;
  }
  return 1;
}

void record_take(void* with, const arm_machine* machine) {
  record_writer* writer = with;
  if (!writer || !writer->ring || !machine || writer->ended || !make_room(writer)) return;
  record_ring* ring = writer->ring;
  writer->measure(machine, writer->measurement);
  writer->get_truth(machine, writer->truth);
  writer->row->time = writer->truth->time;
  writer->row->tick = writer->measurement->tick;
  const size_t size = (size_t)writer->row_bytes;
  memcpy(writer->rows + (size_t)(ring->written % writer->capacity) * size, writer->row, size);
  __atomic_store_n(&ring->written, ring->written + 1, __ATOMIC_RELEASE);
}

int64_t record_waiting(const record_ring* ring) {
  return ring ? __atomic_load_n(&ring->written, __ATOMIC_ACQUIRE) - ring->taken : 0;
}

void record_release(record_ring* ring, int64_t rows) {
  if (ring) __atomic_store_n(&ring->taken, ring->taken + rows, __ATOMIC_RELEASE);
}
