/* A segment of EtherCAT slaves, one CiA 402 drive each, for frames that come from anywhere: a
 * network interface, or a test. The library is one for all scenes; it gets the functions of the
 * drives' library. One thread at a time. C99. */
#ifndef ETHERCAT_H
#define ETHERCAT_H

#include <stdint.h>

#include "drives.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct ethercat_segment ethercat_segment;

typedef struct ethercat_options {
  uint32_t size;
  int32_t lockstep; /* 1: a servo period per frame of process data; 0: by the clock */
  drives* all;      /* they must outlive the segment */
  int64_t period;   /* ns, servo period */
} ethercat_options;

/* Since the segment was made. */
typedef struct ethercat_figures {
  int64_t frames;      /* that were sound, and carried out */
  int64_t exchanges;   /* frames that completed an exchange of process data with all drives */
  int64_t periods;     /* servo periods that have passed */
  int64_t malformed;   /* frames thrown away: lengths that do not fit */
  int64_t foreign;     /* frames thrown away that are not EtherCAT's */
  int64_t circulating; /* frames thrown away that have passed the segment already */
  int64_t unknown;     /* datagrams with an unknown command, which pass as they are */
  int64_t lost_cycles; /* by the clock: periods with a drive in OP and no complete exchange */
  int64_t
      late_periods; /* by the clock: periods that the host was too late for, lost to logical time */
  int64_t watchdogs;   /* of slaves that have run out */
  int32_t operational; /* slaves in OP now */
  int32_t diverged;    /* 1: the machine has; it stands still */
} ethercat_figures;

/* Return the segment, all slaves in INIT, or null if the options make no sense. */
ethercat_segment* ethercat_new(const ethercat_options* options);
void ethercat_delete(ethercat_segment* segment);

/* Pass a frame through the segment, in place, at the time `now` [ns] (not used in lock-step).
 * Returns the number of bytes that come back, 0: none. In lock-step the servo period of an exchange
 * follows. */
int64_t ethercat_frame(ethercat_segment* segment, uint8_t* frame, int64_t size, int64_t now);
/* Advance by a servo period, by the clock. Returns the result of the machine's exchange. */
int ethercat_period(ethercat_segment* segment, int64_t now);
void ethercat_get_figures(const ethercat_segment* segment, ethercat_figures* out);
/* Registers and memory of a slave, 0x3000 bytes; null if there are not so many. */
const uint8_t* ethercat_memory(const ethercat_segment* segment, int32_t slave);

/* Open a network interface for `ethercat_serve`: a descriptor, or -errno. */
int ethercat_open(const char* interface);
/* Serve frames of that descriptor for `duration` [ns], until a signal, or until the machine
 * diverges. While the interface is down and slaves are in SAFEOP or OP, servo periods pass by the
 * clock in lock-step, too. Returns 0, or -errno. */
int ethercat_serve(ethercat_segment* segment, int descriptor, int64_t duration);

#ifdef __cplusplus
}
#endif

#endif
