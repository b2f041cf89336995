/* The boundary of an emulated arm: commands in, measurements out, one servo period at a time.
 *
 * The compiled library of a scene has the functions of this header. A user links it, or loads it
 * with dlopen. It needs no Python, ROS or clock. C99.
 *
 * Ticks count servo periods. `arm_exchange` takes the command of tick k through the period to the
 * measurement of tick k + 1. `arm_measurement` has what the sensors report, `arm_truth` the true
 * state, for judging and not for control.
 *
 * Arrays have one entry per joint, base to tool. Units are SI, angles in rad (m for prismatic
 * joints). What bearings give way is no joint here: readings show it.
 *
 * A struct begins with its size, which the user sets to its sizeof: a library reads and writes no
 * more than that, so that later versions can add fields at the end. Only `arm_new` allocates
 * memory. One thread at a time may use a machine; machines are independent of each other.
 *
 * A null pointer that is not permitted is refused with ARM_REFUSED (without a machine, no
 * `arm_why`), or nothing happens.
 */
#ifndef ARM_H
#define ARM_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ARM_VERSION 7

typedef struct arm_machine arm_machine; /* one machine of the library's scene */

enum arm_result {
  ARM_OK = 0,
  ARM_REFUSED = 1, /* refused, nothing has changed; `arm_why` gives the reason */
  ARM_DIVERGED = 2 /* the machine stays at its last sound state until it is reset or restored */
};

/* Why the newest call was refused: `quantity` must satisfy `rule`, but was `got` at `joint`. */
typedef struct arm_refusal {
  uint32_t size;
  int32_t joint; /* -1: none */
  char quantity[40];
  char rule[120];
  double got;
} arm_refusal;

/* -------------------------------------------------------------------------------- what it is */

typedef struct arm_description {
  uint32_t size;
  uint32_t version; /* ARM_VERSION of the library */
  int32_t joints;
  int32_t parameters;    /* that are varied */
  uint64_t fingerprint;  /* of scene and core: equal ones give equal bits, whatever compiled them */
  double supply_voltage; /* V */
  int32_t imus;          /* inertial measurement units; since version 2 */
  int32_t readings;      /* rows of arm_measurement.readings; since version 4 */
  /* Since version 3: the scene's values for arm_options in a library from `compile --into`, else 0.
   * A machine may have others. */
  double servo_period;      /* s */
  double step;              /* s, of the integrator */
  int64_t steps_per_period; /* of a servo period */
  int32_t inputs;           /* rows of arm_command.further; since version 5 */
  /* Version of the rounding: libraries with the same number give the same bits of the same scene,
   * whatever compiled them and for which processor. Since version 7. */
  int32_t arithmetic;
} arm_description;

enum arm_kind { ARM_REVOLUTE = 0, ARM_PRISMATIC = 1 };

/* Quantity set by a command; bits of arm_joint_description.modes. */
enum arm_mode {
  ARM_VOLTAGE = 1,
  ARM_TORQUE = 2,
  ARM_CURRENT = 4,
  ARM_VOLTAGE_DQ = 8 /* across the rotor's flux; the voltage along it is a further input */
};

typedef struct arm_joint_description {
  uint32_t size;
  uint32_t modes; /* modes of its drive; 0: no motor */
  const char* name;
  int32_t kind; /* enum arm_kind */
  int32_t reserved;
  double gear_ratio;     /* link turns (or m per rad) per motor turn */
  double counts_per_rad; /* encoder counts at the motor */
  double current_limit;  /* A, 0: none */
  /* Since version 2. */
  int64_t encoder_wrap; /* an absolute encoder's counts are modulo this; 0: no wrap */
  int64_t link_encoder_wrap;
  double link_counts_per_rad; /* counts of the encoder at the link (per m for prismatic joints) */
  uint32_t sensors;           /* bits of enum arm_sensor: its further sensors */
  uint32_t more;
} arm_joint_description;

enum arm_sensor {
  ARM_HAS_INDEX = 1, /* of the encoder at the motor */
  ARM_HAS_LINK_ENCODER = 2,
  ARM_HAS_LINK_INDEX = 4, /* of the encoder at the link */
  ARM_HAS_TORQUE = 8
};

/* Meaning of a row at a joint: of arm_measurement.readings, or of arm_command.further. */
typedef struct arm_reading {
  uint32_t size;
  int32_t present; /* 1: the joint has such a sensor or input; else the number is 0 */
  const char* name;
  const char* unit;
} arm_reading;

/* Fill `out`. ARM_REFUSED if there is no such joint, reading or input. */
int arm_describe(arm_description* out);
int arm_describe_joint(int32_t joint, arm_joint_description* out);
int arm_describe_reading(int32_t reading, int32_t joint, arm_reading* out); /* since version 4 */
/* Describes a row of arm_command.further at a joint. */
int arm_describe_input(int32_t input, int32_t joint, arm_reading* out); /* since version 5 */

/* ---------------------------------------------------------------------------------- a machine */

typedef struct arm_options {
  uint32_t size;
  int32_t core;             /* processor core of a second thread; -1: any */
  double step;              /* s, of the integrator */
  int64_t steps_per_period; /* of a servo period */
  const double* parameters; /* values of the varied numbers; null without any */
} arm_options;

/* Return a machine at rest at q = 0, or null if the options make no sense. */
arm_machine* arm_new(const arm_options* options);
void arm_delete(arm_machine* machine);

/* Set the links to (q, v) and the motors to match, at tick 0, without current or gear torque. */
int arm_reset(arm_machine* machine, const double* q, const double* v);

/* Schedule the machine's own threads as the calling one; 0 if the system does not permit it. */
int arm_join_schedule(arm_machine* machine);
/* In a child of `fork`, which has no thread of its parent: start the machine's threads again. Call
 * it once, before the machine is used. */
void arm_begin_threads(arm_machine* machine);

/* ------------------------------------------------------------------------------- the exchange */

enum arm_enable { ARM_ENABLED = 1, ARM_CLOSE_BRAKE = 2 };

typedef struct arm_joint_command {
  int32_t mode;    /* enum arm_mode */
  uint32_t enable; /* bits of enum arm_enable; 0: the command is 0, and a brake closes */
  double value;    /* V, clamped to the supply; N m or A, clamped to the motor's limit */
} arm_joint_command;

typedef struct arm_command {
  uint32_t size;
  uint32_t came; /* 1: what the drives received in an earlier run; faults of lines leave it */
  int64_t tick;  /* that it answers, repeated in the measurement; -1: none */
  const arm_joint_command* joint;
  /* Inputs of motors beside `value`: arm_description.inputs rows, an entry per joint each;
   * null: 0. Since version 2, then the voltage along the rotor's flux. */
  const double* further;
} arm_command;

enum arm_fault {
  ARM_FAULT_DIVERGED = 1,
  /* The winding is beyond its limit: in a period that begins so its drive is not enabled. */
  ARM_FAULT_THERMAL = 2
};

typedef struct arm_joint_measurement {
  int64_t encoder; /* counts at the motor, as its encoder measures them */
  double current;  /* A, as its sensor measures it */
  double applied; /* V, N m or A: share of the command that the motor received in the past period */
  uint32_t faults; /* bits of enum arm_fault */
  uint32_t brake;  /* 1: it is closed */
} arm_joint_measurement;

/* Readings of further sensors of a joint; 0 for absent sensors. */
typedef struct arm_joint_sensors {
  int64_t index;        /* counts of the encoder at the motor when its newest index pulse came */
  int64_t index_pulses; /* pulses so far */
  int64_t link_encoder; /* counts at the link */
  int64_t link_index;
  int64_t link_index_pulses;
  double torque; /* N m or N, of the gear on the link */
} arm_joint_sensors;

/* An inertial measurement unit, in its own frame. */
typedef struct arm_imu_measurement {
  double specific_force[3]; /* m/s2: acceleration less that of free fall */
  double angular_rate[3];   /* rad/s */
} arm_imu_measurement;

typedef struct arm_measurement {
  uint32_t size;
  uint32_t powered;
  int64_t tick;
  int64_t answered; /* tick that the newest command answered; -1: none */
  arm_joint_measurement* joint;
  /* Since version 2; each may be null. */
  arm_joint_sensors* sensors; /* an entry per joint */
  arm_imu_measurement* imu;   /* an entry per unit */
  double* current_d;          /* A, along the rotor's flux, an entry per joint; null: not written */
  /* Since version 4. */
  double* readings; /* of further sensors: arm_description.readings rows, an entry per joint each */
  /* Since version 5. */
  double* further; /* what the motors got of arm_command.further, rows as there */
} arm_measurement;

/* Go through one servo period; `out` is as of its end, or of the last sound state. */
int arm_exchange(arm_machine* machine, const arm_command* command, arm_measurement* out);
/* Read the measurement of this tick again. */
int arm_measure(const arm_machine* machine, arm_measurement* out);
/* Switch the power of all drives: without it every command is 0, and brakes close after their
 * delay. A machine starts with power on. A reset keeps it and sets the brakes to match. */
void arm_power(arm_machine* machine, int on);

/* Call `listener` at the end of every exchange that is not refused, on the thread that exchanges;
 * null: none. It may read the machine. Since version 5. */
void arm_listen(arm_machine* machine, void (*listener)(void* with, const arm_machine* machine),
                void* with);

/* Reason of the newest refusal on this machine. */
int arm_why(const arm_machine* machine, arm_refusal* out);

/* -------------------------------------------------------------------------- varied parameters */

/* A number that the scene lists as varied, by its place in the scene. */
typedef struct arm_parameter {
  uint32_t size;
  int32_t reserved;
  const char* name;
  double least, most;
} arm_parameter;

/* Fill `out`; ARM_REFUSED if there are not so many (arm_description.parameters). */
int arm_describe_parameter(int32_t index, arm_parameter* out);
/* The value of this machine. The motion continues from its state when a value is set; a reset does
 * not change it. */
int arm_get_parameter(const arm_machine* machine, const char* name, double* value);
int arm_set_parameter(arm_machine* machine, const char* name, double value);

/* -------------------------------------------------------------------------- external wrenches */

enum arm_axes { ARM_LINK_AXES = 0, ARM_WORLD_AXES = 1 };
#define ARM_LARGEST_WRENCH 1e9 /* of each number */

/* External wrench on the link that a joint moves: a force and a moment at a point that is
 * fixed to the link. Their axes are those of the link's frame in the URDF, with which they turn, or
 * those of the world. */
typedef struct arm_wrench {
  uint32_t size;
  int32_t axes;     /* enum arm_axes, of force and moment */
  double point[3];  /* m, in the link's frame */
  double force[3];  /* N */
  double moment[3]; /* N m, about the point */
} arm_wrench;

/* The wrench that acts on a link until it is set again; a reset removes it. It is part of a saved
 * machine. Both calls need a scene with `external_wrench`. A link has the number of the joint that
 * moves it; with couplings or bearings that give way that is its number among all joints that move,
 * from base to tips, deflections among them. */
int arm_set_external_wrench(arm_machine* machine, int32_t link, const arm_wrench* wrench);
int arm_get_external_wrench(const arm_machine* machine, int32_t link, arm_wrench* out);

/* ------------------------------------------------------------------------------ measuring time */

/* Measure the wall time of steps from now on; this costs some 50 ns per exchange. */
void arm_measure_time(arm_machine* machine);
/* Wall time of the steps since then [ns]. */
int64_t arm_spent(const arm_machine* machine);

/* ------------------------------------------------------------------------------ whole states */

/* Bytes of a saved machine. */
int64_t arm_saved_size(void);
/* Save the whole state, and restore it. A restored machine continues to the last bit, in any
 * library with the same fingerprint and the same options. Power, tick and fault are part of it. The
 * bytes hold no
 * pointers and may be kept in a file; corrupted ones are refused. */
int arm_save(const arm_machine* machine, void* out, int64_t size);
int arm_restore(arm_machine* machine, const void* saved, int64_t size);

/* -------------------------------------------------------------------------------------- truth */

/* Every pointer may be null. Leave out energy and gear torques to save time. */
typedef struct arm_truth {
  uint32_t size;
  int32_t fault;       /* joint that diverged; -1: none */
  double time;         /* s */
  double* energy;      /* J, one number: kinetic, potential, elastic and magnetic */
  double* current;     /* A */
  double* motor_angle; /* rad */
  double* motor_speed; /* rad/s */
  double* q;
  double* v;
  double* gear_torque; /* N m or N, on the link */
} arm_truth;

int arm_get_truth(const arm_machine* machine, arm_truth* out);
/* Temperatures of the windings, an entry per joint [degC]; NaN where the scene has none. */
void arm_get_winding_temperatures(const arm_machine* machine, double* out);
/* The same of the gears. */
void arm_get_gear_temperatures(const arm_machine* machine, double* out);
/* Set currents, motors and links; a null array stays as it is. Time, energy, torque and fault of
 * the struct are ignored. Motor states that contradict a rigid gear or an absent motor are refused.
 * The scheme starts without a past. */
int arm_set_truth(arm_machine* machine, const arm_truth* truth);

/* ----------------------------------------------------------------------- away from the ticks */

/* Take `steps` integration steps under `command` [V, N m, A]; without power the motors get 0. */
int arm_advance(arm_machine* machine, const double* command, int64_t steps);
/* Take `rows` rows of commands, `steps` steps each; q after each row goes to `q`. */
int arm_run(arm_machine* machine, const double* command, int64_t rows, int64_t steps, double* q);

/* Power supplied to each joint by motors and external wrenches, then power dissipated by each, an
 * entry per joint in `out`: now and under `command` [W], or 0 without power. Both calls need a
 * scene with `energy_flow`. */
int arm_powers(const arm_machine* machine, const double* command, double* out);
/* As `arm_advance`; the energy supplied and dissipated meanwhile goes to `out` [J]. */
int arm_advance_metered(arm_machine* machine, const double* command, int64_t steps, double* out);

/* ---------------------------------------------------------------------------------- equations */

/* Write the numbers at which equations.h takes the machine: its varied numbers and brakes, the
 * wrenches on its links, its state. Returns how many; with a null pointer that is all. Since
 * version 6, in which the equations have left this header. */
int32_t arm_get_point(const arm_machine* machine, double* out);

#ifdef __cplusplus
}
#endif

#endif
