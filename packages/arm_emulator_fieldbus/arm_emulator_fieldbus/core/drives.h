/* The drives of a scene behind a field bus: CiA 402 drives, one per joint, on one machine of arm.h.
 *
 * The library of the drives is one for all scenes; it gets the functions of the scene's library. A
 * bus reads and writes entries of the drives' object dictionaries between two servo periods, then
 * calls `drives_period`. No call but `drives_new`, `drives_save` and `drives_sdo` allocates memory;
 * one thread at a time. C99.
 */
#ifndef DRIVES_H
#define DRIVES_H

#include <stdint.h>

#include "arm.h"
#include "servo.h"
#include "tick.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct drives drives;
typedef struct drives_state drives_state;

enum drives_bus { DRIVES_ETHERCAT = 1, DRIVES_CANOPEN = 2 };
/* Meaning of the home offset 0x607C: from the home position to the zero position, as CiA 402 has
 * it, or the position of the home, as some makers have it. */
enum drives_home_offset { DRIVES_HOME_TO_ZERO = 0, DRIVES_ZERO_TO_HOME = 1 };
enum { DRIVES_UNITS = 2 }; /* inertial measurement units on a link, at most */

/* Data of a joint. */
typedef struct drives_joint {
  const char* name;
  servo_joint servo;       /* data of its inner loops */
  int64_t counts_per_turn; /* of the encoder at the motor */
  int64_t lower, upper;    /* counts, within which its link may be */
  int32_t brake;           /* 1: it has one */
  int32_t index;           /* 1: its encoder at the motor has an index pulse */
  int32_t stops;           /* 1: it has stops on both sides */
  int32_t mode;            /* enum arm_mode that its motor takes; ARM_VOLTAGE or _CURRENT */
  uint32_t modes;          /* of 0x6502 that its loops hold the machine in */
  uint32_t motor_type;     /* of 0x6402 */
} drives_joint;

/* The machine, functions of its library, and the joints base to tool. */
typedef struct drives_machine {
  uint32_t size;
  int32_t bus;         /* enum drives_bus */
  int32_t home_offset; /* enum drives_home_offset */
  int32_t reserved;
  tick_machine* at;              /* with all arrays of its measurement */
  double supply_voltage;         /* V */
  const char* device_name;       /* of the scene */
  const drives_joint* joint;     /* an entry per joint */
  int32_t further, reserved_too; /* rows of arm_command.further */
  /* Declared by parts, as objects: outputs, inputs of motors. */
  int32_t outputs, inputs;
  /* Where each output is, by joint, output and unit on its link: its row, or the unit; -1: the
   * joint has no such value, which is 0. */
  const int32_t* place;
  /* Rows of arm_command.further, by joint and input; -1: the motor does not take it. */
  const int32_t* input;
  /* Faults of the scene: the varied numbers that are their magnitudes. */
  int (*get_parameter)(const arm_machine*, const char* name, double* value);
  int (*set_parameter)(arm_machine*, const char* name, double value);
  int32_t faults, reserved_last;
  const char* const* fault; /* names, in the order of the scene */
} drives_machine;

/* Return the drives in Switch on disabled, the machine as it is; null: it makes no sense. What the
 * pointers show must outlive them. */
drives* drives_new(const drives_machine* machine);
void drives_delete(drives* all);
int32_t drives_count(const drives* all);
/* Restart at the machine's present state, with initial values of the drives. Call it after a reset
 * or a restore of the machine. */
void drives_begin(drives* all);

/* Return the state of all drives, between two periods: dictionaries, state machines, modes, loops.
 * It is good for these drives alone, which must outlive it. */
drives_state* drives_save(const drives* all);
void drives_state_delete(drives_state* state);
/* Go on from a state, once the machine has been restored to that moment. SDO transfers end.
 * ARM_REFUSED: a state of other drives; nothing has changed. */
int drives_restore(drives* all, const drives_state* state);
/* Bytes of a state. */
uint64_t drives_state_size(const drives* all);

/* Advance by one servo period: every drive's loops, one tick_exchange. Returns its result; once it
 * is not ARM_OK the drives are in Fault. */
int drives_period(drives* all);
/* The same for so many periods, or fewer, see tick_run. */
int drives_periods(drives* all, int64_t periods);
/* Number of the present tick. */
int64_t drives_tick(const drives* all);

/* ---------------------------------------------------------------------------- the dictionaries */

/* Read or write an entry of a drive, little-endian. Returns 0 or the abort code of an SDO server; a
 * refused access changes nothing. `size` gets the bytes that the entry has, also where `room` is
 * too small for them (0x05040005). */
uint32_t drives_read(drives* all, int32_t drive, uint16_t index, uint8_t sub, void* out,
                     uint32_t room, uint32_t* size);
uint32_t drives_write(drives* all, int32_t drive, uint16_t index, uint8_t sub, const void* in,
                      uint32_t size);
/* Write a number in as many bytes as the entry has; 0x06090030: they do not hold it. */
uint32_t drives_write_number(drives* all, int32_t drive, uint16_t index, uint8_t sub,
                             int64_t value);

/* An entry of the dictionary, the same for all drives. Texts live indefinitely. */
typedef struct drives_entry {
  uint16_t index;
  uint8_t sub, last_sub; /* last_sub: of its object */
  uint16_t type;         /* of CiA 301: 2 INTEGER8 ... 8 REAL32, 9 VISIBLE_STRING, 17 REAL64 */
  uint16_t bits;         /* 0: text */
  uint8_t access;        /* 0 constant, 1 read, 2 write, 3 both */
  uint8_t pdo;           /* bits: 1 may be mapped to receive, 2 to transmit */
  uint8_t code;          /* 7 variable, 8 array, 9 record */
  uint8_t buses;         /* bits of enum drives_bus */
  uint32_t reserved;
  int64_t standard, least, most;
  const char *object, *name, *unit;
} drives_entry;

/* Walk the dictionary: entries 0, 1, ... in ascending order; 0 where there are no more, else 1. */
int drives_list(int32_t slot, drives_entry* out);

/* Controlled quantity of a mode of operation: position; speed; torque; a torque at the speed limit.
 */
enum drives_loops {
  DRIVES_LOOP_POSITION = 1,
  DRIVES_LOOP_SPEED = 2,
  DRIVES_LOOP_TORQUE = 4,
  DRIVES_LOOP_SPEED_LIMIT = 8
};
typedef struct drives_mode {
  int32_t number; /* of 0x6060 */
  uint32_t loops; /* bits of enum drives_loops */
  const char* name;
} drives_mode;

/* Walk the modes of operation that drives have, as drives_list. */
int drives_list_mode(int32_t row, drives_mode* out);

/* ------------------------------------------------------------------------------------ the bus */

/* Set an entry that belongs to the bus (COB-IDs, sync manager parameters), whatever its access and
 * range; 0: no such entry. */
int drives_set(drives* all, int32_t drive, uint16_t index, uint8_t sub, int64_t value);
/* Servo periods in a drive's interpolation time 0x60C2, one at least. */
int32_t drives_periods_per_target(const drives* all, int32_t drive);

/* Report the cycle of the bus in which targets come [ns]; 0: unknown, a servo period. The
 * interpolation time 0x60C2 follows it, until a master writes that. */
void drives_set_cycle(drives* all, int32_t drive, int64_t cycle);

/* Report the loss of the master to a drive (-1: all), once per loss: a controlled motor reacts by
 * 0x6007, with this error code (0x603F), 0x8100 in general; a drive that is only ready returns to
 * Switch on disabled. */
void drives_lost(drives* all, int32_t drive, uint16_t error);
/* Forbid or allow that the mapping of process data is changed (-1: of all drives), of CANopen only
 * where a PDO uses it. Buses forbid it beyond pre-operational. */
void drives_lock_mapping(drives* all, int32_t drive, int locked);
/* Reset a drive (-1: all) as NMT or a new start does: initial values, Switch on disabled. The motor
 * continues to turn. */
void drives_restart(drives* all, int32_t drive);

/* ----------------------------------------------------------- service data objects on CANopen */

/* Answer a request of 8 bytes. Returns how many replies of 8 bytes there are. */
enum { DRIVES_SDO_REPLIES = 127 }; /* at most */
int32_t drives_sdo(drives* all, int32_t drive, const uint8_t* request, uint8_t* replies);
/* Discard a transfer in progress. */
void drives_sdo_begin(drives* all, int32_t drive);
/* Times that an object of a drive's communication, 0x1005 to 0x1FFF, was written. */
uint32_t drives_communication(const drives* all, int32_t drive);

#ifdef __cplusplus
}
#endif

#endif
