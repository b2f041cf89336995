#include "servo.h"

#if !defined(SERVO_IS_FINITE) && \
    (defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__))
#error "the servo looks whether its numbers are finite: compile without -ffast-math"
#endif

#include "joint_number.h"
#include "servo_clock.h"
#include "servo_load.h"
#include "servo_target.h"

/* The largest angle that a joint may be asked for [rad]. */
static const servo_scalar FARTHEST = (servo_scalar)1e6;

SERVO_INLINE servo_real sum_of(const servo_sum* sum, servo_real current, servo_real speed,
                               servo_real voltage, servo_real load) {
  return sum->current * current + sum->speed * speed + sum->voltage * voltage + sum->load * load;
}

/* ---------------------------------------------------------------------------------- one joint */

/* Take the motor as standing in the middle of its count, its load held by its current. */
SERVO_INLINE void start_joint(const servo_joint* joint, servo_state* state, servo_mask where,
                              servo_real current) {
  const servo_real zero = {0};
  if (!any(where)) return;
  state->known |= make_flag(where, 1);
  state->theta = where ? state->theta_measured : state->theta;
  state->omega = where ? zero : state->omega;
  state->load = where ? joint->torque_constant * current : state->load;
  state->current = where ? current : state->current;
  state->integral = where ? current : state->integral;
  state->unknown_voltage = where ? zero : state->unknown_voltage;
}

/* Begin anew where numbers are no longer finite. */
SERVO_INLINE void restart_joint(const servo_joint* joint, servo_state* state, servo_mask where) {
  const servo_real zero = {0};
  if (!any(where)) return;
  start_joint(joint, state, where, is_finite(state->current) ? state->current : zero);
  reset_load(&state->learned, where);
  clear_invalid_target(state, where);
}

/* Return the counts of an absolute encoder that are next to those before; next to 0 first. So a
 * motor may turn by less than half a word in a servo period. */
SERVO_INLINE servo_count unwrap_counts(const servo_joint* joint, servo_state* state,
                                       servo_count word) {
  const servo_count zero = {0}, wrap = joint->wrap != 0 ? joint->wrap : zero + 1;
  const servo_count half = wrap / 2, turned = (word - state->counts + half) % wrap;
  const servo_count forward = turned < 0 ? turned + wrap : turned;
  state->counts += joint->wrap != 0 ? forward - half : zero;
  return joint->wrap != 0 ? state->counts : word;
}

/* Predict over the past period, take what the measured current adds to that, then correct by the
 * encoder. A plain difference of counts would step by a whole count per period (6 rad/s at 1024
 * counts and 1 ms). */
SERVO_INLINE void update_angle(const servo_joint* joint, servo_state* state, servo_real theta,
                               servo_real current, servo_real voltage) {
  const servo_real i = state->current, omega = state->omega, load = state->load;
  const servo_mask unknown = state->known == 0;
  const servo_real predicted = sum_of(&joint->end_current, i, omega, voltage, load);
  const servo_real measured = joint->unsensed != 0 ? predicted : current;
  const servo_real surplus = measured - predicted;
  const servo_real predicted_theta = state->theta + (sum_of(&joint->turn, i, omega, voltage, load) +
                                                     joint->turn_per_surplus * surplus);
  const servo_real predicted_omega =
      sum_of(&joint->end_speed, i, omega, voltage, load) + joint->speed_per_surplus * surplus;
  const servo_real innovation = theta - predicted_theta;
  state->theta_measured = theta;
  state->theta = predicted_theta + joint->theta_gain * innovation;
  state->omega = predicted_omega + joint->omega_gain * innovation;
  state->load = load + joint->load_gain * innovation;
  state->unknown_voltage = joint->voltage_per_surplus * surplus;
  state->current = measured;
  start_joint(joint, state, unknown, current);
}

SERVO_INLINE void update_counts(const servo_joint* joint, servo_state* state, servo_count counts,
                                servo_real current, servo_real voltage) {
  if (any(joint->wrap != 0)) counts = unwrap_counts(joint, state, counts);
  update_angle(joint, state, (to_real(counts) + HALF) * joint->count_angle, current, voltage);
}

/* Observe numbers that need not be sound. Returns where it began anew. */
SERVO_INLINE servo_mask observe_joint(const servo_joint* joint, servo_state* state,
                                      servo_count counts, servo_real current, servo_real voltage) {
  update_counts(joint, state, counts, current, voltage);
  const servo_mask lost =
      is_finite(state->theta + state->omega + state->load + state->unknown_voltage) == 0;
  restart_joint(joint, state, lost);
  return lost;
}

/* Let the load have changed as the torques of the targets do. */
SERVO_INLINE void expect_load(const servo_joint* joint, servo_state* state,
                              const servo_past* past) {
  state->load += joint->ratio * state->tau_rate * past->changed;
}

/* Learn how much of the torque that was announced to the motor comes. */
SERVO_INLINE void learn_joint_load(const servo_joint* joint, servo_state* state,
                                   const servo_past* past) {
  const servo_sample seen = {
      past->learns,
      past->learns & (joint->theta_gain > SWIFT) & (state->tau_rate != 0) & (state->stood == 0),
      past->passed,
      extrapolate_torque(state, past->ahead),
      joint->motor_turns * state->load,
      joint->motor_turns * joint->load_gain * joint->count_angle,
  };
  state->integral += joint->current_per_tau * learn_load(&state->learned, &seen);
}

SERVO_INLINE void init_setpoint(const servo_joint* joint, servo_wish* setpoint) {
  const servo_real zero = {0};
  const servo_flag none = {0};
  setpoint->wants = SERVO_POSITION;
  setpoint->limited = none;
  setpoint->q_target = setpoint->v_target = setpoint->tau = zero;
  setpoint->omega = setpoint->current = zero;
  setpoint->least_omega = -joint->omega_limit;
  setpoint->most_omega = joint->omega_limit;
  setpoint->least_current = -joint->current_limit;
  setpoint->most_current = joint->current_limit;
}

SERVO_INLINE servo_real compute_speed_reference(const servo_joint* joint, const servo_state* state,
                                                servo_wish* setpoint) {
  const servo_real zero = {0}, theta_target = setpoint->q_target * joint->motor_turns;
  const servo_real off = theta_target - state->theta_measured;
  const servo_mask within_count = (off < 0 ? -off : off) <= HALF * joint->count_angle;
  const servo_real error = within_count ? zero : theta_target - state->theta;
  return setpoint->v_target * joint->motor_turns + joint->position_gain * error;
}

SERVO_INLINE servo_real compute_voltage(const servo_joint* joint, servo_state* state,
                                        servo_wish* setpoint, servo_real* i_ref) {
  const servo_real zero = {0}, current = state->current, memory = joint->current_memory;
  const servo_sum* mean = &joint->mean_current;
  const servo_real at_no_voltage = sum_of(mean, current, state->omega, zero, state->load);
  const servo_real voltage_ref =
      (*i_ref - memory * (*i_ref - current) - at_no_voltage) * joint->voltage_per_current;
  /* No voltage that lets the current beyond its limit within the period. What the model did not
   * know in the last period, an observed speed that lags for one, counts here: the winding turns a
   * few volts into many amperes. */
  const servo_real middle =
      joint->emf * state->omega - state->unknown_voltage - joint->winding * current;
  const servo_real low = middle + joint->current_voltage * setpoint->least_current;
  const servo_real high = middle + joint->current_voltage * setpoint->most_current;
  const servo_real raised = low > voltage_ref ? low : voltage_ref;
  const servo_real voltage = clip(high < raised ? high : raised, joint->voltage_limit);
  const servo_mask limited = voltage != voltage_ref;
  if (any(limited)) { /* what current the limits leave of the reference */
    const servo_real left =
        (mean->voltage * voltage + at_no_voltage - memory * current) / (1 - memory);
    *i_ref = limited ? left : *i_ref;
    setpoint->limited |= make_flag(limited, SERVO_LIMITS_VOLTAGE);
  }
  return voltage;
}

SERVO_INLINE servo_real drive_joint(const servo_joint* joint, servo_state* state,
                                    servo_wish* setpoint) {
  const servo_real zero = {0}, feedforward = setpoint->wants == SERVO_CURRENT
                                                 ? zero
                                                 : setpoint->tau * joint->current_per_tau;
  const servo_flag none = {0};
  servo_real i_ref, asked;
  setpoint->limited = none;
  if (setpoint->wants == SERVO_CURRENT) {
    /* The current is limited to what the velocity stage asks for at the largest speeds. */
    asked = bound(setpoint->current, joint->velocity_gain * (setpoint->least_omega - state->omega),
                  joint->velocity_gain * (setpoint->most_omega - state->omega));
    setpoint->limited |= make_flag(asked != setpoint->current, SERVO_LIMITS_SPEED);
  } else {
    const servo_real omega = setpoint->wants == SERVO_SPEED
                                 ? setpoint->omega
                                 : compute_speed_reference(joint, state, setpoint);
    const servo_real omega_ref = bound(omega, setpoint->least_omega, setpoint->most_omega);
    setpoint->limited |= make_flag(omega_ref != omega, SERVO_LIMITS_SPEED);
    asked = joint->velocity_gain * (omega_ref - state->omega) + state->integral + feedforward;
  }
  i_ref = bound(asked, setpoint->least_current, setpoint->most_current);
  setpoint->limited |= make_flag(i_ref != asked, SERVO_LIMITS_CURRENT);

  state->voltage = compute_voltage(joint, state, setpoint, &i_ref);
  /* Automatic reset: with no limit active this is the integral of Kv error / integral time. It goes
   * on from the current that was asked for when speed or position are controlled again. */
  if (setpoint->wants == SERVO_CURRENT)
    state->integral = i_ref;
  else
    state->integral += joint->reset_rate * (i_ref - feedforward - state->integral);
  return state->voltage;
}

/* A command, 0 where it would not be finite: returns where it began anew. */
SERVO_INLINE servo_mask ensure_finite(const servo_joint* joint, servo_state* state,
                                      servo_real* command) {
  const servo_real zero = {0};
  const servo_mask lost = is_finite(*command + state->integral) == 0;
  restart_joint(joint, state, lost);
  state->voltage = lost ? zero : state->voltage;
  *command = lost ? zero : *command;
  return lost;
}

SERVO_INLINE servo_mask control_joint(const servo_joint* joint, servo_state* state, servo_real q,
                                      servo_real v, servo_real tau, servo_real* command) {
  servo_wish setpoint;
  init_setpoint(joint, &setpoint);
  setpoint.q_target = q;
  setpoint.v_target = v;
  setpoint.tau = tau;
  *command = drive_joint(joint, state, &setpoint);
  return ensure_finite(joint, state, command);
}

/* Follow the newest target, or hold. Returns where it began anew. */
SERVO_INLINE servo_mask follow_target(const servo_joint* joint, servo_state* state,
                                      const servo_decision* decision, servo_real* command) {
  const servo_real zero = {0}, middle = decision->ahead - HALF * decision->period;
  const servo_mask braked = state->braked != 0, moves = decision->follows & (state->braked == 0);
  const servo_motion target = interpolate_target(state, decision->ahead, decision->period);
  const servo_real load = compute_expected_load(&state->learned, extrapolate_torque(state, middle));
  state->stood |= make_flag(braked, 1);
  state->q_hold =
      (decision->latches | braked) ? state->theta_measured * joint->ratio : state->q_hold;
  return control_joint(joint, state, moves ? clip(target.q, broadcast(FARTHEST)) : state->q_hold,
                       moves ? target.v : zero,
                       moves ? load + joint->rotor * target.a : (decision->follows ? load : zero),
                       command);
}

/* ------------------------------------------------------------- a period of a joint in an arm */

/* Take its measurement. Returns where it began anew. */
SERVO_INLINE servo_mask measure_joint(const servo_joint* joint, servo_state* state,
                                      const servo_past* past, servo_count counts,
                                      servo_real current, servo_real applied, servo_mask closed) {
  if (any(past->changed > 0)) expect_load(joint, state, past);
  const servo_mask lost = observe_joint(joint, state, counts, current, applied);
  if (any(past->learns)) learn_joint_load(joint, state, past);
  state->braked = make_flag(closed, 1);
  return lost;
}

/* Give its command. Returns where it began anew. */
SERVO_INLINE servo_mask command_joint(const servo_joint* joint, servo_state* state,
                                      const servo_decision* decision, servo_real* command) {
  const servo_real zero = {0};
  servo_mask lost = {0};
  *command = zero;
  if (any(decision->cut == 0))
    lost = follow_target(joint, state, decision, command) & (decision->cut == 0);
  if (any(decision->cut)) {
    *command = decision->cut ? zero : *command;
    state->integral = decision->cut ? zero : state->integral;
    state->voltage = decision->cut ? zero : state->voltage;
    state->stood |= make_flag(decision->cut, 1);
  }
  return lost;
}

#ifndef SERVO_LANES

void servo_joint_reset(servo_state* state) {
  if (!state) return;
  state->counts = 0;
  state->known = state->braked = state->stood = 0;
  state->theta_measured = state->theta = state->omega = state->load = 0;
  state->current = state->integral = 0;
  state->voltage = state->unknown_voltage = 0;
  state->q_target = state->v_target = state->tau = 0;
  state->a_target = state->jerk_target = state->tau_rate = 0;
  state->q_hold = 0;
  reset_load(&state->learned, 1);
}

void servo_joint_take(const servo_joint* joint, servo_state* state, servo_real theta,
                      servo_real current, servo_real voltage) {
  if (joint && state) update_angle(joint, state, theta, current, voltage);
}

void servo_joint_observe(const servo_joint* joint, servo_state* state, int64_t counts,
                         servo_real current, servo_real voltage) {
  if (joint && state) update_counts(joint, state, counts, current, voltage);
}

void servo_wish_within(const servo_joint* joint, servo_wish* setpoint) {
  if (joint && setpoint) init_setpoint(joint, setpoint);
}

servo_real servo_joint_drive(const servo_joint* joint, servo_state* state, servo_wish* setpoint) {
  return joint && state && setpoint ? drive_joint(joint, state, setpoint) : 0;
}

servo_real servo_joint_control(const servo_joint* joint, servo_state* state, servo_real q_target,
                               servo_real v_target, servo_real tau) {
  servo_wish setpoint;
  if (!joint || !state) return 0;
  init_setpoint(joint, &setpoint);
  setpoint.q_target = q_target;
  setpoint.v_target = v_target;
  setpoint.tau = tau;
  return drive_joint(joint, state, &setpoint);
}

/* ------------------------------------------------------------------------------- the watchdog */

void servo_watchdog_reset(servo_watchdog* dog) {
  if (dog) reset_watchdog(dog, 1);
}

void servo_watchdog_target(servo_watchdog* dog, int64_t now) {
  if (dog) record_target(dog, 1, now);
}

void servo_watchdog_state(servo_watchdog* dog, int64_t now) {
  if (dog) record_state(dog, now);
}

int32_t servo_watchdog_check(servo_watchdog* dog, int64_t now) {
  return dog ? check_watchdog(dog, now) : SERVO_CUT;
}

/* ------------------------------------------------------------------------------------ an arm */

/* Whether it is a servo with all that it needs. */
SERVO_INLINE int is_complete(const servo* arm) { return arm && arm->joint && arm->state; }

void servo_reset(servo* arm) {
  if (!is_complete(arm)) return;
  for (int32_t j = 0; j < arm->joints; ++j) servo_joint_reset(&arm->state[j]);
  reset_clock(arm, 1);
}

void servo_observe(servo* arm, const int64_t* counts, const servo_real* current,
                   const servo_real* applied) {
  if (!is_complete(arm) || !counts || !current) return;
  for (int32_t j = 0; j < arm->joints; ++j) {
    servo_state* state = &arm->state[j];
    const servo_real voltage = applied ? applied[j] : state->voltage;
    arm->restarts += (uint32_t)observe_joint(&arm->joint[j], state, counts[j], current[j], voltage);
  }
}

servo_real servo_drive(servo* arm, int32_t j, servo_wish* setpoint) {
  if (!is_complete(arm) || !setpoint || j < 0 || j >= arm->joints) return 0;
  servo_real command = drive_joint(&arm->joint[j], &arm->state[j], setpoint);
  arm->restarts += (uint32_t)ensure_finite(&arm->joint[j], &arm->state[j], &command);
  return command;
}

void servo_control(servo* arm, const servo_real* q, const servo_real* v, const servo_real* tau,
                   servo_real* command) {
  if (!is_complete(arm) || !q || !command) return;
  for (int32_t j = 0; j < arm->joints; ++j)
    arm->restarts += (uint32_t)control_joint(&arm->joint[j], &arm->state[j], q[j], v ? v[j] : 0,
                                             tau ? tau[j] : 0, &command[j]);
}

void servo_release(servo* arm) {
  if (!is_complete(arm)) return;
  for (int32_t j = 0; j < arm->joints; ++j) arm->state[j].integral = arm->state[j].voltage = 0;
}

void servo_measure(servo* arm, int64_t now, const int64_t* counts, const servo_real* current,
                   const servo_real* applied, const int64_t* closed) {
  if (!is_complete(arm) || !counts || !current) return;
  const servo_past past = advance_clock(arm, now);
  for (int32_t j = 0; j < arm->joints; ++j) {
    servo_state* state = &arm->state[j];
    const servo_real voltage = applied ? applied[j] : state->voltage;
    arm->restarts += (uint32_t)measure_joint(&arm->joint[j], state, &past, counts[j], current[j],
                                             voltage, closed && closed[j]);
  }
}

void servo_report(const servo* arm, int32_t powered, servo_real* q, servo_real* v, servo_real* tau,
                  int64_t* movable) {
  if (!is_complete(arm) || !q || !v || !tau || !movable) return;
  const int on = powered && arm->watchdog.does != SERVO_CUT;
  for (int32_t j = 0; j < arm->joints; ++j) {
    const servo_state* state = &arm->state[j];
    q[j] = state->theta_measured * arm->joint[j].ratio;
    v[j] = state->omega * arm->joint[j].ratio;
    tau[j] = state->load * arm->joint[j].motor_turns;
    movable[j] = on && !state->braked && !state->stood;
  }
}

void servo_aim(servo* arm, const servo_real* q, const servo_real* v, const servo_real* tau) {
  if (!is_complete(arm) || !q) return;
  const servo_real since = register_target(arm, 1);
  for (int32_t j = 0; j < arm->joints; ++j)
    set_target(&arm->state[j], 1, q[j], v ? v[j] : 0, tau ? tau[j] : 0, since);
}

void servo_command(servo* arm, int32_t powered, servo_real* command) {
  if (!is_complete(arm) || !command) return;
  const servo_decision decision = decide_period(arm, powered != 0);
  for (int32_t j = 0; j < arm->joints; ++j)
    arm->restarts +=
        (uint32_t)command_joint(&arm->joint[j], &arm->state[j], &decision, &command[j]);
}

#endif
