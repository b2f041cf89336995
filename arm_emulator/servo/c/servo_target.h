/* Targets of a joint, and the way from one to the next. servo.c includes this after joint_number.h,
 * once for a number type. */

/* Accelerations are taken to go on changing as they did by this share of it: a change that comes to
 * its end is known a period late only. Where they turn, as those of speeds in steps or with noise
 * do, by half of it. */
static const servo_scalar GOES_ON = (servo_scalar)0.8, TURNS = (servo_scalar)0.4;

/* Multiplied, since a division takes as long as ten products. */
static const servo_scalar SIXTH = (servo_scalar)1 / 6;

/* Take a target; `since`: seconds since the one before, if that was followed until now. */
SERVO_INLINE void set_target(servo_state* state, servo_mask where, servo_real q, servo_real v,
                             servo_real tau, servo_real since) {
  const servo_real zero = {0};
  const servo_mask goes_on = where & (since > 0);
  servo_real a = zero, jerk = zero, tau_rate = zero;
  if (any(goes_on)) {
    const servo_real rate = broadcast(1) / since, changed = (v - state->v_target) * rate,
                     change = (changed - state->a_target) * rate;
    const servo_real share =
        change * state->jerk_target < 0 ? broadcast(TURNS) : broadcast(GOES_ON);
    a = goes_on ? changed : zero;
    jerk = goes_on ? share * change : zero;
    tau_rate = goes_on ? (tau - state->tau) * rate : zero;
  }
  state->stood &= ~make_flag(where, 1);
  state->q_target = where ? q : state->q_target;
  state->v_target = where ? v : state->v_target;
  state->tau = where ? tau : state->tau;
  state->a_target = where ? a : state->a_target;
  state->jerk_target = where ? jerk : state->jerk_target;
  state->tau_rate = where ? tau_rate : state->tau_rate;
}

/* Stay at the target's angle without what is not finite. Without an angle the joint has no command
 * until the next target. */
SERVO_INLINE void clear_invalid_target(servo_state* state, servo_mask where) {
  servo_real* const numbers[] = {&state->v_target, &state->tau, &state->a_target,
                                 &state->jerk_target, &state->tau_rate};
  const servo_real zero = {0};
  for (int k = 0; k < 5; ++k)
    *numbers[k] = (where & (is_finite(*numbers[k]) == 0)) ? zero : *numbers[k];
}

/* Motion that is asked of a link. */
typedef struct servo_motion {
  servo_real q, v, a;
} servo_motion;

/* Return the motion s after a target came: the cubic whose mean speeds are those of the targets. */
SERVO_INLINE servo_motion interpolate_target(const servo_state* state, servo_real s,
                                             servo_real period) {
  const servo_real a = state->a_target, jerk = state->jerk_target;
  const servo_real v = state->v_target - (HALF * a + jerk * period * SIXTH) * period;
  const servo_motion way = {state->q_target + (v + (HALF * a + jerk * s * SIXTH) * s) * s,
                            v + (a + HALF * jerk * s) * s, a + jerk * s};
  return way;
}

/* Return the announced torque, `since` the middle of the target's motion period. */
SERVO_INLINE servo_real extrapolate_torque(const servo_state* state, servo_real since) {
  return state->tau + since * state->tau_rate;
}
