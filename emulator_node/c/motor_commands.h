/* motor_commands as they usually are: for this emulator, without further inputs. C99. */
#ifndef MOTOR_COMMANDS_H
#define MOTOR_COMMANDS_H

#include "message_reader.h"
#include "messages.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct motor_commands {
  message_reader* reader;
  const message_field *input_names, *inputs;
  int64_t largest; /* bytes: longer messages are Python's */
  /* Of the newest message. */
  int64_t tick; /* that it answers */
  uint64_t machine;
  double* came;      /* its commands, by the machine's order of joints, and inputs of 0 */
  uint64_t emulator; /* commands are for this one, or for any: 0 */
  int64_t number;    /* of the topic in the log */
} motor_commands;

/* Read commands into `came`; returns the tick that they answer, -1 if they are refused or not as
 * usual. */
int64_t motor_commands_read(motor_commands* own, const uint8_t* data, int64_t size);

#ifdef __cplusplus
}
#endif

#endif
