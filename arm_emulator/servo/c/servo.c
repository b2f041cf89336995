#include "servo.h"

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "the servo looks whether its numbers are finite: compile without -ffast-math"
#endif

/* The largest angle that a joint may be asked for [rad]. */
static const servo_real FARTHEST = (servo_real)1e6;
static const servo_real HALF = (servo_real)0.5;
static const servo_real NANOSECONDS = (servo_real)1e9;
/* Of loads: slower changes are the integral's [s]. */
static const servo_real SLOW = (servo_real)0.5;
/* Evidence that the factor is 1: announced torques of so many times what a count of the encoder
 * changes in the observed load, for so long [s]. */
static const servo_real DOUBTS = 10, DOUBTED = (servo_real)0.1;
/* Evidence that is kept, relative to that; older evidence fades beside newer. */
static const servo_real KEPT = 100;

/* Code that every joint runs in every period is inlined: calls cost as much. */
#ifdef __GNUC__
#define SERVO_INLINE static inline __attribute__((always_inline))
#else
#define SERVO_INLINE static inline
#endif

SERVO_INLINE servo_real clip(servo_real value, servo_real limit) {
  return value < -limit ? -limit : value > limit ? limit : value;
}

SERVO_INLINE servo_real bound(servo_real value, servo_real least, servo_real most) {
  return value < least ? least : value > most ? most : value;
}

SERVO_INLINE int is_finite(servo_real value) { return value - value == 0; }

SERVO_INLINE servo_real sum_of(const servo_sum* sum, servo_real current, servo_real speed,
                               servo_real voltage, servo_real load) {
  return sum->current * current + sum->speed * speed + sum->voltage * voltage + sum->load * load;
}

/* ---------------------------------------------------------------------------------- one joint */

static void unlearn(servo_state* state) {
  state->scale = 1;
  state->tau_mean = state->load_mean = state->evidence = state->product = 0;
}

void servo_joint_reset(servo_state* state) {
  if (!state) return;
  state->counts = 0;
  state->known = state->braked = state->stood = 0;
  state->theta_measured = state->theta = state->omega = state->load = 0;
  state->current = state->integral = 0;
  state->voltage = state->unknown_voltage = 0;
  state->q_target = state->v_target = state->tau = 0;
  state->a_target = state->tau_rate = 0;
  state->q_hold = 0;
  unlearn(state);
}

/* Take the motor as standing in the middle of its count, its load held by its current. */
static void start(const servo_joint* joint, servo_state* state, servo_real current) {
  state->known = 1;
  state->theta = state->theta_measured;
  state->omega = 0;
  state->load = joint->torque_constant * current;
  state->current = current;
  state->integral = current;
  state->unknown_voltage = 0;
}

/* Return the counts of an absolute encoder that are next to those before; next to 0 first. So a
 * motor may turn by less than half a word in a servo period. */
static int64_t unwrapped(const servo_joint* joint, servo_state* state, int64_t word) {
  const int64_t half = joint->wrap / 2;
  int64_t turned = (word - state->counts + half) % joint->wrap;
  if (turned < 0) turned += joint->wrap;
  return state->counts += turned - half;
}

/* Predict over the past period, take what the measured current adds to that, then correct by the
 * encoder. A plain difference of counts would step by a whole count per period (6 rad/s at 1024
 * counts and 1 ms). */
SERVO_INLINE void take_angle(const servo_joint* joint, servo_state* state, servo_real theta,
                             servo_real current, servo_real voltage) {
  state->theta_measured = theta;
  if (!state->known) {
    start(joint, state, current);
    return;
  }
  const servo_real i = state->current, omega = state->omega, load = state->load;
  const servo_real predicted = sum_of(&joint->end_current, i, omega, voltage, load);
  const servo_real measured = joint->unsensed ? predicted : current;
  const servo_real surplus = measured - predicted;
  const servo_real predicted_theta = state->theta + (sum_of(&joint->turn, i, omega, voltage, load) +
                                                     joint->turn_per_surplus * surplus);
  const servo_real predicted_omega =
      sum_of(&joint->end_speed, i, omega, voltage, load) + joint->speed_per_surplus * surplus;
  const servo_real innovation = theta - predicted_theta;
  state->theta = predicted_theta + joint->theta_gain * innovation;
  state->omega = predicted_omega + joint->omega_gain * innovation;
  state->load = load + joint->load_gain * innovation;
  state->unknown_voltage = joint->voltage_per_surplus * surplus;
  state->current = measured;
}

void servo_joint_take(const servo_joint* joint, servo_state* state, servo_real theta,
                      servo_real current, servo_real voltage) {
  if (joint && state) take_angle(joint, state, theta, current, voltage);
}

SERVO_INLINE void observe(const servo_joint* joint, servo_state* state, int64_t counts,
                          servo_real current, servo_real voltage) {
  if (joint->wrap) counts = unwrapped(joint, state, counts);
  take_angle(joint, state, ((servo_real)counts + HALF) * joint->count_angle, current, voltage);
}

void servo_joint_observe(const servo_joint* joint, servo_state* state, int64_t counts,
                         servo_real current, servo_real voltage) {
  if (joint && state) observe(joint, state, counts, current, voltage);
}

SERVO_INLINE void wish_within(const servo_joint* joint, servo_wish* wish) {
  wish->wants = SERVO_POSITION;
  wish->limited = 0;
  wish->q_target = wish->v_target = wish->tau = 0;
  wish->omega = wish->current = 0;
  wish->least_omega = -joint->omega_limit;
  wish->most_omega = joint->omega_limit;
  wish->least_current = -joint->current_limit;
  wish->most_current = joint->current_limit;
}

void servo_wish_within(const servo_joint* joint, servo_wish* wish) {
  if (joint && wish) wish_within(joint, wish);
}

SERVO_INLINE servo_real position_stage(const servo_joint* joint, const servo_state* state,
                                       servo_wish* wish) {
  const servo_real theta_target = wish->q_target * joint->motor_turns;
  const servo_real off = theta_target - state->theta_measured;
  const int within_count = (off < 0 ? -off : off) <= HALF * joint->count_angle;
  const servo_real error = within_count ? 0 : theta_target - state->theta;
  return wish->v_target * joint->motor_turns + joint->position_gain * error;
}

SERVO_INLINE servo_real current_stage(const servo_joint* joint, servo_state* state,
                                      servo_wish* wish, servo_real* i_ref) {
  const servo_real current = state->current, memory = joint->current_memory;
  const servo_sum* mean = &joint->mean_current;
  const servo_real at_no_voltage = sum_of(mean, current, state->omega, 0, state->load);
  const servo_real wanted =
      (*i_ref - memory * (*i_ref - current) - at_no_voltage) * joint->voltage_per_current;
  /* No voltage that lets the current beyond its limit within the period. What the model did not
   * know in the last period, an observed speed that lags for one, counts here: the winding turns a
   * few volts into many amperes. */
  const servo_real middle =
      joint->emf * state->omega - state->unknown_voltage - joint->winding * current;
  const servo_real least = middle + joint->current_voltage * wish->least_current;
  const servo_real most = middle + joint->current_voltage * wish->most_current;
  servo_real voltage = least > wanted ? least : wanted;
  voltage = clip(most < voltage ? most : voltage, joint->voltage_limit);
  if (voltage != wanted) { /* what current the limits leave of the reference */
    *i_ref = (mean->voltage * voltage + at_no_voltage - memory * current) / (1 - memory);
    wish->limited |= SERVO_LIMITS_VOLTAGE;
  }
  return voltage;
}

SERVO_INLINE servo_real drive(const servo_joint* joint, servo_state* state, servo_wish* wish) {
  const servo_real feedforward =
      wish->wants == SERVO_CURRENT ? 0 : wish->tau * joint->current_per_tau;
  servo_real i_ref, asked;
  wish->limited = 0;
  if (wish->wants == SERVO_CURRENT) {
    /* The current is limited to what the velocity stage asks for at the largest speeds. */
    asked = bound(wish->current, joint->velocity_gain * (wish->least_omega - state->omega),
                  joint->velocity_gain * (wish->most_omega - state->omega));
    if (asked != wish->current) wish->limited |= SERVO_LIMITS_SPEED;
  } else {
    const servo_real omega =
        wish->wants == SERVO_SPEED ? wish->omega : position_stage(joint, state, wish);
    const servo_real omega_ref = bound(omega, wish->least_omega, wish->most_omega);
    if (omega_ref != omega) wish->limited |= SERVO_LIMITS_SPEED;
    asked = joint->velocity_gain * (omega_ref - state->omega) + state->integral + feedforward;
  }
  i_ref = bound(asked, wish->least_current, wish->most_current);
  if (i_ref != asked) wish->limited |= SERVO_LIMITS_CURRENT;

  state->voltage = current_stage(joint, state, wish, &i_ref);
  /* Automatic reset: with no limit active this is the integral of Kv error / integral time. It goes
   * on from the current that was asked for when speed or position are controlled again. */
  if (wish->wants == SERVO_CURRENT)
    state->integral = i_ref;
  else
    state->integral += joint->reset_rate * (i_ref - feedforward - state->integral);
  return state->voltage;
}

servo_real servo_joint_drive(const servo_joint* joint, servo_state* state, servo_wish* wish) {
  return joint && state && wish ? drive(joint, state, wish) : 0;
}

SERVO_INLINE servo_real follow(const servo_joint* joint, servo_state* state, servo_real q_target,
                               servo_real v_target, servo_real tau) {
  servo_wish wish;
  wish_within(joint, &wish);
  wish.q_target = q_target;
  wish.v_target = v_target;
  wish.tau = tau;
  return drive(joint, state, &wish);
}

servo_real servo_joint_control(const servo_joint* joint, servo_state* state, servo_real q_target,
                               servo_real v_target, servo_real tau) {
  return joint && state ? follow(joint, state, q_target, v_target, tau) : 0;
}

/* ------------------------------------------------------------------------------- the watchdog */

void servo_watchdog_reset(servo_watchdog* dog) {
  if (!dog) return;
  dog->does = SERVO_HOLDS;
  dog->cause = SERVO_NO_TARGET;
  dog->silence = 0;
  dog->target_came = dog->state_came = 0;
}

void servo_watchdog_target(servo_watchdog* dog, int64_t now) {
  if (!dog) return;
  dog->target_came = 1;
  dog->last_target = now;
}

void servo_watchdog_state(servo_watchdog* dog, int64_t now) {
  if (!dog) return;
  dog->state_came = 1;
  dog->last_state = now;
}

static void note_silence(servo_watchdog* dog, int64_t* last, int64_t now, int32_t cause) {
  if (*last > now) *last = now;
  const int64_t silence = now - *last;
  if (silence <= dog->hold_after) return;
  dog->does = silence > dog->cut_after ? SERVO_CUT : SERVO_HOLDS;
  dog->cause = cause;
  dog->silence = silence;
}

int32_t servo_watchdog_check(servo_watchdog* dog, int64_t now) {
  if (!dog) return SERVO_CUT;
  if (dog->does == SERVO_CUT) return dog->does;
  dog->does = dog->target_came ? SERVO_FOLLOWS : SERVO_HOLDS;
  dog->cause = dog->target_came ? SERVO_HEARS : SERVO_NO_TARGET;
  if (dog->target_came) note_silence(dog, &dog->last_target, now, SERVO_LATE_TARGET);
  if (dog->state_came && dog->does != SERVO_CUT)
    note_silence(dog, &dog->last_state, now, SERVO_LATE_STATE);
  return dog->does;
}

/* ------------------------------------------------------------------------------------ an arm */

/* Whether it is a servo with all that it needs. */
SERVO_INLINE int complete(const servo* arm) { return arm && arm->joint && arm->state; }

void servo_reset(servo* arm) {
  if (!complete(arm)) return;
  for (int32_t j = 0; j < arm->joints; ++j) servo_joint_reset(&arm->state[j]);
  servo_watchdog_reset(&arm->watchdog);
  arm->measured = arm->aimed = arm->holding = 0;
  arm->now = arm->target_time = 0;
  arm->does = SERVO_HOLDS;
}

static void begin_anew(servo* arm, int32_t j) {
  servo_state* state = &arm->state[j];
  start(&arm->joint[j], state, is_finite(state->current) ? state->current : 0);
  ++arm->restarts;
}

void servo_observe(servo* arm, const int64_t* counts, const servo_real* current,
                   const servo_real* applied) {
  if (!complete(arm) || !counts || !current) return;
  for (int32_t j = 0; j < arm->joints; ++j) {
    servo_state* state = &arm->state[j];
    observe(&arm->joint[j], state, counts[j], current[j], applied ? applied[j] : state->voltage);
    if (!is_finite(state->theta + state->omega + state->load + state->unknown_voltage))
      begin_anew(arm, j);
  }
}

SERVO_INLINE servo_real sound(servo* arm, int32_t j, servo_real voltage) {
  servo_state* state = &arm->state[j];
  if (is_finite(voltage + state->integral)) return voltage;
  begin_anew(arm, j);
  return state->voltage = 0;
}

SERVO_INLINE servo_real control(servo* arm, int32_t j, servo_real q, servo_real v, servo_real tau) {
  return sound(arm, j, follow(&arm->joint[j], &arm->state[j], q, v, tau));
}

servo_real servo_drive(servo* arm, int32_t j, servo_wish* wish) {
  if (!complete(arm) || !wish || j < 0 || j >= arm->joints) return 0;
  return sound(arm, j, drive(&arm->joint[j], &arm->state[j], wish));
}

void servo_control(servo* arm, const servo_real* q, const servo_real* v, const servo_real* tau,
                   servo_real* command) {
  if (!complete(arm) || !q || !command) return;
  for (int32_t j = 0; j < arm->joints; ++j)
    command[j] = control(arm, j, q[j], v ? v[j] : 0, tau ? tau[j] : 0);
}

void servo_release(servo* arm) {
  if (!complete(arm)) return;
  for (int32_t j = 0; j < arm->joints; ++j) arm->state[j].integral = arm->state[j].voltage = 0;
}

/* Let the loads of the past servo period have changed as the torques of the targets do. */
static void expect_load(servo* arm, int64_t now) {
  const int64_t begins = arm->now, ends = arm->target_time + arm->motion_period;
  const int64_t last = now < ends ? now : ends;
  if (arm->does != SERVO_FOLLOWS || !arm->aimed || last <= begins) return;
  const servo_real passed = (servo_real)(last - begins) / NANOSECONDS;
  for (int32_t j = 0; j < arm->joints; ++j)
    arm->state[j].load += arm->joint[j].ratio * arm->state[j].tau_rate * passed;
}

/* Learn from a servo period in which `tau` was announced to the motor [N m] how much of it comes.
 */
static void learn(const servo_joint* joint, servo_state* state, servo_real tau, servo_real passed) {
  if (state->tau_rate == 0 || state->stood) { /* all that is at rest is the integral's */
    state->tau_mean = tau;
    state->load_mean = state->load;
    return;
  }
  const servo_real count = joint->load_gain * joint->count_angle;
  const servo_real doubt = DOUBTS * DOUBTS * DOUBTED * count * count, most = KEPT * doubt;
  const servo_real share = passed < SLOW ? passed / SLOW : 1;
  state->tau_mean += share * (tau - state->tau_mean);
  state->load_mean += share * (state->load - state->load_mean);
  const servo_real fast = tau - state->tau_mean;
  state->evidence += passed * fast * fast;
  state->product += passed * fast * (state->load - state->load_mean);
  if (state->evidence > most) {
    state->product *= most / state->evidence;
    state->evidence = most;
  }
  const servo_real learned = (doubt + state->product) / (doubt + state->evidence);
  if (!is_finite(learned)) {
    unlearn(state);
    return;
  }
  const servo_real scale = bound(learned, SERVO_LEAST, SERVO_MOST);
  state->integral -= (scale - state->scale) * state->tau_mean / joint->torque_constant;
  state->scale = scale;
}

/* Learn from the servo period that ends now, if a target was followed in it. */
static void learn_of_targets(servo* arm, int64_t now) {
  const int64_t since = now - arm->target_time;
  if (arm->does != SERVO_FOLLOWS || !arm->aimed || now <= arm->now || since > arm->motion_period)
    return;
  const servo_real passed = (servo_real)(now - arm->now) / NANOSECONDS;
  const servo_real middle = HALF * (servo_real)arm->motion_period / NANOSECONDS;
  const servo_real ahead = (servo_real)since / NANOSECONDS - middle;
  for (int32_t j = 0; j < arm->joints; ++j) {
    servo_state* state = &arm->state[j];
    const servo_real tau = state->tau + ahead * state->tau_rate;
    learn(&arm->joint[j], state, arm->joint[j].ratio * tau, passed);
  }
}

void servo_measure(servo* arm, int64_t now, const int64_t* counts, const servo_real* current,
                   const servo_real* applied) {
  if (!complete(arm) || !counts || !current) return;
  expect_load(arm, now);
  servo_observe(arm, counts, current, applied);
  if (arm->measured) learn_of_targets(arm, now);
  arm->now = now;
  arm->measured = 1;
  servo_watchdog_state(&arm->watchdog, now);
}

void servo_brakes(servo* arm, const int64_t* closed) {
  if (!complete(arm)) return;
  for (int32_t j = 0; j < arm->joints; ++j) arm->state[j].braked = closed && closed[j];
}

/* Seconds since the target before, if that was followed until now, period after period; else 0. */
static servo_real since_target(const servo* arm) {
  const int64_t since = arm->now - arm->target_time;
  const int follows = arm->aimed && arm->measured && arm->does == SERVO_FOLLOWS;
  return follows && since == arm->motion_period ? (servo_real)since / NANOSECONDS : 0;
}

void servo_aim(servo* arm, const servo_real* q, const servo_real* v, const servo_real* tau) {
  if (!complete(arm) || !q) return;
  const servo_real since = since_target(arm);
  for (int32_t j = 0; j < arm->joints; ++j) {
    servo_state* state = &arm->state[j];
    const servo_real v_before = state->v_target, tau_before = state->tau;
    state->stood = 0;
    state->q_target = q[j];
    state->v_target = v ? v[j] : 0;
    state->tau = tau ? tau[j] : 0;
    state->a_target = since > 0 ? (state->v_target - v_before) / since : 0;
    state->tau_rate = since > 0 ? (state->tau - tau_before) / since : 0;
  }
  arm->aimed = 1;
  if (!arm->measured) return;
  arm->target_time = arm->now;
  servo_watchdog_target(&arm->watchdog, arm->now);
}

/* Seconds that the newest target has gone on. */
static servo_real ahead_of(const servo* arm) {
  int64_t ahead = arm->now - arm->target_time;
  if (ahead < 0) ahead = 0;
  if (ahead > arm->motion_period) ahead = arm->motion_period;
  return (servo_real)ahead / NANOSECONDS;
}

/* Follow the newest target, so many seconds after it came. */
SERVO_INLINE servo_real pursue(servo* arm, int32_t j, servo_real ahead) {
  const servo_state* state = &arm->state[j];
  const servo_real a = state->a_target, period = (servo_real)arm->motion_period / NANOSECONDS;
  const servo_real begins = state->v_target - HALF * a * period;
  const servo_real q = state->q_target + (begins + HALF * a * ahead) * ahead;
  const servo_real tau = state->scale * state->tau + arm->joint[j].rotor * a;
  return control(arm, j, clip(q, FARTHEST), begins + a * ahead, tau);
}

void servo_command(servo* arm, int32_t powered, servo_real* command) {
  if (!complete(arm) || !command) return;
  arm->does = servo_watchdog_check(&arm->watchdog, arm->now);
  if (!powered || !arm->measured) arm->does = SERVO_CUT;
  if (!powered && arm->measured) arm->aimed = arm->watchdog.target_came = 0;
  if (arm->does == SERVO_CUT) {
    arm->holding = 0;
    servo_release(arm);
    for (int32_t j = 0; j < arm->joints; ++j) {
      arm->state[j].stood = 1;
      command[j] = 0;
    }
    return;
  }
  const int follows = arm->does == SERVO_FOLLOWS && arm->aimed;
  const servo_real ahead = ahead_of(arm);
  for (int32_t j = 0; j < arm->joints; ++j) {
    servo_state* state = &arm->state[j];
    if (state->braked) state->stood = 1;
    if ((!follows && !arm->holding) || state->braked)
      state->q_hold = state->theta_measured * arm->joint[j].ratio;
    command[j] = follows && !state->braked
                     ? pursue(arm, j, ahead)
                     : control(arm, j, state->q_hold, 0, follows ? state->scale * state->tau : 0);
  }
  arm->holding = !follows;
}
