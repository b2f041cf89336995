/* Bytes of messages for rcl. C99. */
#ifndef BYTES_H
#define BYTES_H

#include "rcl_calls.h"

/* Room of no bytes, which rcl enlarges; its buffer is given back by free(). */
rcl_bytes ros_no_bytes(void);

#endif
