/* motor_commands in the form that is known: what they must be like, and where their numbers lie.
 * C99. */
#ifndef MOTOR_COMMANDS_H
#define MOTOR_COMMANDS_H

#include "messages.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct motor_commands {
  ros_pattern pattern;
  int64_t tick_at, machine_at, command_at;
  int64_t joints;
  const int64_t* place; /* of each joint of the message */
  const double* most;   /* of the commands, as all arrays by the machine's order of joints */
  double* came;         /* of the newest message */
  uint64_t emulator;    /* commands are for this one, or for any: 0 */
  int64_t number;       /* of the topic in the log */
} motor_commands;

/* Read commands into `came`; returns the tick that they answer, -1 if they are not of the known
 * form, for another emulator, or out of their bounds. */
int64_t motor_commands_read(motor_commands* own, const uint8_t* data, int64_t size);

#ifdef __cplusplus
}
#endif

#endif
