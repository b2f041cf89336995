/* Rows of a machine behind arm.h, from the thread that exchanges to a reader in another process,
 * through memory that both share. C99. */
#ifndef RECORD_RING_H
#define RECORD_RING_H

#include "arm.h"

#ifdef __cplusplus
extern "C" {
#endif

/* In the shared memory; zeros at first. What each side writes lies in a cache line of its own. */
typedef struct record_ring {
  int64_t written; /* rows, by the machine's thread */
  int64_t dropped; /* rows that found no room */
  int64_t apart[6];
  int64_t taken; /* rows, by the reader */
} record_ring;

/* Header of a row. The arrays of `truth` and `measurement` follow it. */
typedef struct record_row {
  double time; /* s */
  int64_t tick;
} record_row;

/* The machine's side. */
typedef struct record_writer {
  uint32_t size;
  int32_t waits;  /* 1: for room; 0: a row that finds none is dropped and counted */
  int32_t reader; /* the end of a pipe that reports when the reader has ended */
  int32_t ended;  /* 1: it has; no row is written any more */
  int (*measure)(const arm_machine*, arm_measurement*);
  int (*get_truth)(const arm_machine*, arm_truth*);
  arm_measurement* measurement;
  arm_truth* truth;
  record_row* row; /* the newest one */
  int64_t row_bytes;
  int64_t capacity; /* rows of the ring */
  record_ring* ring;
  char* rows;
} record_writer;

/* Write a row of the machine as it is now; a listener of arm_listen, `with` being the writer. */
void record_take(void* with, const arm_machine* machine);

/* The reader's side: how many rows wait behind `taken`, and that so many of them have been read. */
int64_t record_waiting(const record_ring* ring);
void record_release(record_ring* ring, int64_t rows);

#ifdef __cplusplus
}
#endif

#endif
