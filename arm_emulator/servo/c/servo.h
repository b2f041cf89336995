/* The servo: cascaded position and velocity control of geared motors, from encoder counts and
 * currents alone, under a watchdog. C99 without heap and without a C library.
 *
 * Per joint and servo period, in motor quantities:
 *
 *   measure    theta = (counts + 1/2) count_angle                  the middle of the count
 *   observe    theta, omega, load from theta, current, voltage     tracking observer
 *   position   omega_ref = v_target / Ng + Kp (q_target / Ng - theta), 0 within the count
 *   velocity   i_ref = Kv (omega_ref - omega) + integral + tau_feedforward Ng / Kt
 *   current    V such that the mean current of the coming period is i_ref - c (i_ref - i)
 *
 * The last stage is exact for winding and rotor over a period in which voltage and load are held.
 * The law therefore holds for motors slower and faster than the period alike. For slow ones
 * V = R i_ref + Kb omega + Rc (i_ref - i).
 *
 * A drive that closes a current loop takes a current in the place of a voltage. To the law that is
 * a winding of 1 ohm without back EMF whose voltages are amperes
 * (arm_emulator/servo/servo_config.py): read A for V in all that follows. A drive that is commanded
 * a torque measures no current: the torque that is predicted takes its place, with a torque
 * constant of 1; read N m for V and A.
 *
 * The announced torque of a target is multiplied by a factor that the servo learns: how much the
 * observed load changes per announced change, by least squares, from SERVO_LEAST to SERVO_MOST. So
 * links that are 30 % heavier than the motion controller believes do not wait for the integral.
 * It multiplies what has changed since the joint rested; what lasts for some 1.5 s goes over into
 * the integral, without a change of their sum (servo_load.h). Little evidence beside the
 * resolution of the encoder leaves the factor near 1, and so does less than 0.05 s of motion: the
 * load on a soft gear follows its torques late.
 *
 * Every stage is limited (speed, current, supply voltage). The integral follows the current that
 * the limits have left over (automatic reset), so that it cannot wind up.
 *
 * "Within the count": the servo asks for no correction where the target lies in the count that the
 * encoder shows. Drives that are commanded in counts do the same. An encoder cannot report
 * positions within a count apart, and integral action on a difference that cannot be measured would
 * hunt indefinitely. So the servo guarantees, at rest, a measured angle within half a count of the
 * target, and no more.
 *
 * A null pointer where none may be: nothing happens, and what is returned is 0 (SERVO_CUT).
 *
 * Numbers are `double`, or `float` with SERVO_FLOAT defined. With SERVO_LANES defined the law of a
 * joint works on vectors, a lane for each of several arms, to the same bits: what differs from arm
 * to arm is decided by masks (arm_emulator_fleet/core/servo_fleet.cpp). Compile without contraction
 * of products and sums (-ffp-contract=off), and every compiler and processor gives the same bits.
 */
#ifndef SERVO_H
#define SERVO_H

#include <float.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifdef SERVO_LANES
/* Joints of so many arms side by side, each in a lane of vectors (C++ alone). */
typedef double servo_real __attribute__((vector_size(8 * SERVO_LANES)));
typedef int64_t servo_count __attribute__((vector_size(8 * SERVO_LANES)));
typedef servo_count servo_flag;
typedef double servo_scalar;
#else
#ifdef SERVO_FLOAT
typedef float servo_real;
#define SERVO_UNLIMITED FLT_MAX
#else
typedef double servo_real;
#define SERVO_UNLIMITED DBL_MAX
#endif
typedef int64_t servo_count;
typedef int32_t servo_flag;
typedef servo_real servo_scalar;
#endif

/* A quantity of a period as a sum over current, speed, voltage and load at its start. */
typedef struct servo_sum {
  servo_real current, speed, voltage, load;
} servo_sum;

/* Data of a joint: its numbers follow from the data sheet and the gains
 * (arm_emulator/servo/servo_numbers.py; `arm_emulator servo-header SCENE` writes them as
 * C). */
typedef struct servo_joint {
  servo_count wrap;           /* counts of an absolute encoder's word; 0: they go on */
  servo_count unsensed;       /* 1: no current is measured, that which is predicted counts */
  servo_real count_angle;     /* rad at the motor */
  servo_real ratio;           /* link turns per motor turn; negative: the other way */
  servo_real motor_turns;     /* 1 / ratio */
  servo_real torque_constant; /* N m/A */
  servo_real current_per_tau; /* ratio / torque_constant, A per N m of the link */
  servo_real emf;             /* V s/rad */
  servo_real rotor;           /* kg m2 at the link: what the motor turns, over ratio squared */
  servo_real omega_limit;     /* rad/s, of the motor, as all that follows */
  servo_real current_limit;   /* A */
  servo_real voltage_limit;   /* V */
  servo_real position_gain;   /* 1/s */
  servo_real velocity_gain;   /* A s/rad */
  servo_real reset_rate;      /* period / integral time */
  /* The motor over a period, voltage and load held. */
  servo_sum end_current, end_speed, turn, mean_current;
  servo_real voltage_per_current; /* 1 / mean_current.voltage */
  /* By current above its prediction: what another voltage has done, and how much it was. */
  servo_real speed_per_surplus, turn_per_surplus, voltage_per_surplus;
  servo_real current_memory;  /* share of a current error that is left in the mean */
  servo_real winding;         /* ohm, on the current that flows */
  servo_real current_voltage; /* ohm, on the current asked for */
  servo_real theta_gain, omega_gain, load_gain; /* of the observer */
} servo_joint;

/* Range of the factor that is learned for announced torques. */
#define SERVO_LEAST ((servo_scalar)0.5)
#define SERVO_MOST ((servo_scalar)2.0)

/* Relation of a link's load to the torques that are announced for it, N m at the link. */
typedef struct servo_learned {
  servo_real excess;              /* 0.3: loads change by 1.3 times what was announced */
  servo_real tau_base;            /* announced torque whose load is the integral's */
  servo_real tau_mean, load_mean; /* of torque and load over the last motion */
  servo_real evidence, product;   /* integrals of tau^2, tau load without them */
  servo_real watched;             /* s of motion that they cover */
} servo_learned;

/* State of a joint, and its newest request. */
typedef struct servo_state {
  servo_count counts; /* that have been turned, of an absolute encoder */
  servo_flag known;   /* 1: something was measured since the reset */
  servo_flag braked;  /* 1: the brake is closed */
  servo_flag stood;   /* 1: it had no power or a closed brake since the newest target */
  servo_flag reserved;
  servo_real theta_measured, theta, omega, load; /* rad, rad, rad/s, N m, of the motor */
  servo_real current, integral;                  /* A */
  servo_real voltage, unknown_voltage;           /* V */
  servo_real q_target, v_target, tau;            /* newest target */
  servo_real a_target, jerk_target, tau_rate;    /* its rates of change, by those before */
  servo_real q_hold;                             /* where it is held without one */
  servo_learned learned;
} servo_state;

/* Request to a joint for one period, beyond a target: a drive that is commanded
 * in speeds or currents, or has limits of its own. */
enum servo_wants { SERVO_POSITION = 0, SERVO_SPEED = 1, SERVO_CURRENT = 2 };
enum servo_limits { SERVO_LIMITS_SPEED = 1, SERVO_LIMITS_CURRENT = 2, SERVO_LIMITS_VOLTAGE = 4 };

typedef struct servo_wish {
  int32_t wants;                      /* enum servo_wants */
  servo_flag limited;                 /* bits of enum servo_limits: what was less than asked for */
  servo_real q_target, v_target;      /* of the link, for SERVO_POSITION */
  servo_real tau;                     /* torque of the link that is known, but for SERVO_CURRENT */
  servo_real omega;                   /* rad/s of the motor, for SERVO_SPEED */
  servo_real current;                 /* A, for SERVO_CURRENT */
  servo_real least_omega, most_omega; /* of the motor; they bound a SERVO_CURRENT, too */
  servo_real least_current, most_current; /* A */
} servo_wish;

/* ------------------------------------------------------------------------------- the watchdog */

enum servo_does { SERVO_FOLLOWS = 0, SERVO_HOLDS = 1, SERVO_CUT = 2 };
enum servo_silence {
  SERVO_HEARS = 0,
  SERVO_NO_TARGET = 1,
  SERVO_LATE_TARGET = 2,
  SERVO_LATE_STATE = 3
};

/* Targets or states silent: hold first, then cut the power.
 *
 * - No target has come yet: hold. A drive that was switched on waits where it stands, indefinitely.
 * - Silence longer than `hold_after`: hold, until both come again.
 * - Silence longer than `cut_after`: cut, until a reset. Power that was cut does not come back by
 *   itself. A person who restarts a silent controller may have a hand in the machine. The arm has
 *   meanwhile sunk to where the last target no longer fits.
 * - A clock that jumps back (an emulator that was reset) starts the silence anew.
 */
typedef struct servo_watchdog {
  servo_count hold_after, cut_after; /* ns */
  servo_count last_target, last_state;
  servo_count silence; /* ns, that led to what it does */
  servo_flag target_came, state_came;
  servo_flag does;  /* enum servo_does */
  servo_flag cause; /* enum servo_silence */
} servo_watchdog;

/* ------------------------------------------------------------------------------------ an arm */

/* In lanes of several arms without what their joints are: those are side by side, too. */
typedef struct servo {
#ifndef SERVO_LANES
  int32_t joints;
  uint32_t restarts; /* how often a joint's numbers were no longer finite, and it began anew */
  const servo_joint* joint;
  servo_state* state;
#endif
  servo_watchdog watchdog;
  servo_count motion_period; /* ns, that a target with a speed goes on at most */
  servo_count now;           /* ns, of the newest measurement */
  servo_count target_time;   /* ns, of the newest target */
  servo_flag measured, aimed, holding;
  servo_flag does; /* enum servo_does, of the newest `servo_command` */
} servo;

#ifndef SERVO_LANES

void servo_watchdog_reset(servo_watchdog* dog);
void servo_watchdog_target(servo_watchdog* dog, int64_t now);
void servo_watchdog_state(servo_watchdog* dog, int64_t now);
/* Return what to do at `now`, enum servo_does. */
int32_t servo_watchdog_check(servo_watchdog* dog, int64_t now);

/* Forget everything, a cut too; what is known of the joints and all times stay. To be called once
 * before anything else. */
void servo_reset(servo* arm);

/* Per servo period: measure once, aim when a target comes, then ask for the commands. Arrays have
 * an entry per joint; times are ns of any clock that all calls share. Numbers must be finite. */

/* `applied` is what the motors got in the period that ends now; null: what was asked for. `closed`:
 * which brakes are closed; null: all are open. A joint with a closed brake is held at its position,
 * with the torque of its target. No difference to a target therefore adds up that would be released
 * with the brake. */
void servo_measure(servo* arm, int64_t now, const int64_t* counts, const servo_real* current,
                   const servo_real* applied, const int64_t* closed);
/* Write what is measured at the links: angles by the encoders [rad], speeds [rad/s] and loads [N m]
 * by the observer; and which joints can be moved, and could since the newest target, 1 or 0: not
 * without power, not with a closed brake. */
void servo_report(const servo* arm, int32_t powered, servo_real* q, servo_real* v, servo_real* tau,
                  int64_t* movable);
/* Link angles [rad], speeds with which they go on [rad/s], and torques of the links that are known
 * beforehand [N m]; speeds and torques may be null: 0.
 *
 * A target continues with its speed until the next one comes, for a motion period T at most, so
 * that the reference has no steps: it ends at q + v T. Speeds and torques are the means over the
 * period. Where targets come every period, the differences of their speeds give acceleration a and
 * jerk j at its begin. They define the way in between, s = t - t_target:
 *
 *   q + v0 s + a s^2 / 2 + j s^3 / 6,   v0 = v - a T / 2 - j T^2 / 6
 *
 * A smooth motion of the targets stays smooth: steps of acceleration or torque in every motion
 * period would make a gear ring that resonates at its rate. The torque goes on by its rate
 * likewise. The rotors' part of it is added here, rotor (a + j s), and the observer takes the load
 * to change as the torques do: it lags a load that grows. From torques that change between targets
 * the servo learns by which factor the load follows them.
 */
void servo_aim(servo* arm, const servo_real* q, const servo_real* v, const servo_real* tau);
/* Commands for the period that begins with the newest measurement: follow the newest target, hold
 * without one, or 0 where nothing was measured yet, the watchdog has cut the power or the drives
 * have none. Drives that get their power back hold until a new target comes: the arm has moved
 * meanwhile. */
void servo_command(servo* arm, int32_t powered, servo_real* command);

/* Measurement and commands without watchdog and clock. */
void servo_observe(servo* arm, const int64_t* counts, const servo_real* current,
                   const servo_real* applied);
void servo_control(servo* arm, const servo_real* q, const servo_real* v, const servo_real* tau,
                   servo_real* command);
/* Report that the motors get no command; control will start without an integral again. */
void servo_release(servo* arm);

/* Command of one joint, whatever is asked of it. */
servo_real servo_drive(servo* arm, int32_t j, servo_wish* wish);

/* ---------------------------------------------------------------------------------- one joint */

void servo_joint_reset(servo_state* state);
void servo_joint_observe(const servo_joint* joint, servo_state* state, int64_t counts,
                         servo_real current, servo_real voltage);
/* Observe an angle of the motor that was measured in another way [rad]. */
void servo_joint_take(const servo_joint* joint, servo_state* state, servo_real theta,
                      servo_real current, servo_real voltage);
/* Return the voltage for the period that begins now. */
servo_real servo_joint_control(const servo_joint* joint, servo_state* state, servo_real q_target,
                               servo_real v_target, servo_real tau);
/* Set a wish to a position of 0 within the limits of the joint. */
void servo_wish_within(const servo_joint* joint, servo_wish* wish);
/* As servo_joint_control, for whatever is wished. */
servo_real servo_joint_drive(const servo_joint* joint, servo_state* state, servo_wish* wish);

#endif

#ifdef __cplusplus
}
#endif

#endif
