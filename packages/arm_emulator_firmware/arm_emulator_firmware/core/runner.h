/* A microcontroller in the loop with a machine: unmodified firmware behind
 * arm_emulator/core/boundary/arm.h. The contents of a board file, as plain structs;
 * board.py reads it. An address of 0: not present. C99. */
#ifndef MICROCONTROLLER_RUNNER_H
#define MICROCONTROLLER_RUNNER_H

#include "firmware.h"

#ifdef __cplusplus
extern "C" {
#endif

enum mcu_kind { MCU_FLASH = 0, MCU_RAM = 1, MCU_REGISTERS = 2, MCU_CODE_RAM = 3 };

typedef struct mcu_region {
  uint32_t at, size; /* bytes, multiples of 1024 */
  int32_t kind;      /* enum mcu_kind */
  int32_t reserved;
} mcu_region;

/* A register that does not begin with 0, or bits of one that always read alike. */
typedef struct mcu_word {
  uint32_t at, value;
  uint32_t fixed; /* these bits always read as in `value`; 0: all bits begin as in `value` */
  uint32_t reserved;
} mcu_word;

typedef struct mcu_encoder {
  uint32_t at;
  int32_t bits, joint, reserved;
} mcu_encoder;

typedef struct mcu_adc {
  uint32_t status, control; /* registers of end of conversion: that it came, that it interrupts */
  int32_t flag, enable;     /* their bits */
  int32_t interrupt;        /* -1: none */
  int32_t clear_by_one;     /* the flag is cleared by writing 1, else by writing 0 */
} mcu_adc;

typedef struct mcu_channel {
  uint32_t at;
  int32_t joint;
  int32_t bits; /* of the converter; 0: the register holds amperes as a float */
  int32_t adc;  /* its place in mcu_board.adc */
  double counts_per_ampere, offset;
} mcu_channel;

enum mcu_pwm_kind {
  MCU_VOLTS = 0,    /* the register holds volts as a float */
  MCU_BIPOLAR = 1,  /* full scale (2 duty - 1) */
  MCU_UNIPOLAR = 2, /* full scale duty, with the sign of the direction */
  MCU_PAIR = 3      /* full scale (duty - duty of the other half-bridge) */
};

typedef struct mcu_pwm {
  int32_t kind; /* enum mcu_pwm_kind */
  int32_t joint;
  uint32_t compare, reload, minus, direction; /* registers */
  int32_t direction_bit;                      /* set: negative */
  int32_t counts_more;                        /* counts of a PWM period beyond `reload`: 0 or 1 */
  double full_scale;                          /* V or A, as the motor takes it, at a duty of 1 */
} mcu_pwm;

enum mcu_pin_kind { MCU_ENABLE = 0, MCU_BRAKE = 1, MCU_FAULT = 2, MCU_POWERED = 3 };

typedef struct mcu_pin {
  uint32_t at;
  int32_t bit, kind, joint; /* joint -1: all of them */
  int32_t low;              /* active low */
  int32_t reserved;
} mcu_pin;

/* Registers that change bits of an output register. */
typedef struct mcu_port {
  uint32_t output, set_reset, set, clear;
} mcu_port;

typedef struct mcu_uart {
  uint32_t status, data, control; /* bits as of STM32: 5 received, 7 empty, 6 sent */
  int32_t interrupt;              /* -1: none */
  double baud;
  int32_t out, in; /* file descriptors; -1: none */
  int32_t targets; /* 1: joint targets come here, see uart.hpp */
  int32_t reserved;
} mcu_uart;

/* Registers from which joint targets are read as floats. */
typedef struct mcu_mailbox {
  uint32_t count; /* register: how often targets have come */
  int32_t interrupt;
  const uint32_t* at; /* an entry per joint */
} mcu_mailbox;

typedef struct mcu_board {
  uint32_t size;
  int32_t joints;
  double clock;                  /* Hz */
  double cycles_per_instruction; /* 0, and no cycles_per_branch: time passes in sleep only */
  double cycles_per_branch;      /* more than that, of the last one of a straight line */
  double boot;                   /* s before the machine's time begins */
  int64_t period;                /* ns */
  uint32_t vectors;
  int32_t interrupts, priority_bits;
  int32_t preload; /* 1: compare registers take effect when the next period begins */
  const mcu_region* region;
  const mcu_word* word;
  const mcu_encoder* encoder;
  const mcu_adc* adc;
  const mcu_channel* channel;
  const mcu_pwm* pwm;
  const mcu_pin* pin;
  const mcu_port* port;
  const mcu_uart* uart;
  const mcu_mailbox* mailbox; /* null: none */
  int32_t regions, words, encoders, adcs, channels, pwms, pins, ports, uarts, reserved;
} mcu_board;

/* Why a run has ended. */
typedef struct mcu_fault {
  uint32_t pc, address;
  double time; /* s of the microcontroller */
  char what[240];
} mcu_fault;

typedef struct mcu_figures {
  uint64_t instructions;
  uint64_t cycles;
  uint64_t asleep; /* cycles in sleep */
  uint64_t exceptions;
  uint64_t faults; /* that went to handlers of the firmware */
  uint64_t resets; /* that the firmware asked for */
} mcu_figures;

typedef struct mcu_runner mcu_runner;

/* Return a microcontroller before its reset, or null: `why` (120 characters) gets the reason. */
mcu_runner* mcu_new(const mcu_board* board, char* why);
void mcu_delete(mcu_runner* runner);
/* Put bytes into memory; 0: they lie outside of flash and RAM. */
int mcu_load(mcu_runner* runner, uint32_t at, const void* bytes, int64_t size);
/* Wait for a debugger at an open socket that listens. */
void mcu_debug(mcu_runner* runner, int socket);
/* Let the debugger halt the processor before its next instruction when a flag is not 0, which is 0
 * again then; null: never. */
void mcu_break(mcu_runner* runner, int32_t* flag);
/* firmware_controller's step; `with` is the runner. */
void mcu_step(void* with, const firmware_input* in, firmware_output* out);
/* Reason for which no checkpoint can be made now, or null. */
const char* mcu_unkept(const mcu_runner* runner);
/* Return `size` bytes with all that decides how the runner goes on, valid up to the next call. */
const uint8_t* mcu_save(mcu_runner* runner, int64_t* size);
/* Go on from what mcu_save of the same runner has returned. */
void mcu_restore(mcu_runner* runner, const uint8_t* saved);
/* Pointer to the result of the run: 0, or 1 after a fault or the debugger's kill. */
const int32_t* mcu_stopped(const mcu_runner* runner);
/* The fault that ended the run, or the first one that went to a handler. */
void mcu_get_fault(const mcu_runner* runner, mcu_fault* out);
void mcu_get_figures(const mcu_runner* runner, mcu_figures* out);

#ifdef __cplusplus
}
#endif

#endif
