/* A scene's servo as a library: the functions of servo.h and the data of the scene's joints.
 * `arm_emulator compile SCENE --servo --into FOLDER` writes it beside the library of the machine.
 * C99. */
#ifndef SERVO_DATA_H
#define SERVO_DATA_H

#include "servo.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct servo_data {
  uint32_t size;
  int32_t joints;
  int64_t period; /* ns, servo period */
  const char* scene;
  const servo_joint* joint; /* an entry per joint, base to tool, as the next */
  const char* const* name;
} servo_data;

/* Fill `out`; 0 if it is null. */
int servo_get_data(servo_data* out);

#ifdef __cplusplus
}
#endif

#endif
