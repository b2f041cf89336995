/* Conversion of currents and voltages. Used by the firmware, and by a library on a
 * computer that shall give the same bits. */
#ifndef CONVERTERS_H
#define CONVERTERS_H

#include <stdint.h>

#include "servo.h"

#define FULL_SCALE ((servo_real)48) /* A, at a duty of 1 */
enum { PWM_TOP = 8400, ADC_MIDDLE = 2048 };

/* Counts per ampere of a joint's current sensor. */
static inline servo_real adc_scale(int joint) { return joint < 3 ? 40 : 160; }

static inline servo_real amperes(int joint, uint32_t counts) {
  return (servo_real)((int32_t)counts - ADC_MIDDLE) / adc_scale(joint);
}

/* The compare value of an amplifier that takes a current of full scale (2 compare / top - 1), and
 * that current. */
static inline uint32_t compare_of(servo_real current) {
  const servo_real value =
      (current / FULL_SCALE + 1) * (servo_real)(0.5 * PWM_TOP) + (servo_real)0.5;
  return value <= 0 ? 0 : value >= PWM_TOP ? PWM_TOP : (uint32_t)value;
}
static inline servo_real command_of(uint32_t compare) {
  return FULL_SCALE * (2 * (servo_real)compare / PWM_TOP - 1);
}

#endif
