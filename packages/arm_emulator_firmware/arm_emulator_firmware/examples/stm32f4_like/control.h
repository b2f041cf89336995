/* Our servo behind the board's converters: counts in, compare values out. */
#ifndef CONTROL_H
#define CONTROL_H

#include <stdint.h>

#include "servo.h"

void control_start(void);
/* `q`: newest joint targets [rad], null: none have come. */
void control_step(const int64_t* encoder, const uint32_t* adc, const float* q, int powered,
                  uint32_t* compare);

#endif
