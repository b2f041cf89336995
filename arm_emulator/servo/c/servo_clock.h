/* Times of an arm: silence of targets and states, and what a servo period is about. servo.c
 * includes this after joint_number.h, once for a number type. */

static const servo_scalar NANOSECONDS = (servo_scalar)1e9;

/* ------------------------------------------------------------------------------- the watchdog */

SERVO_INLINE void reset_watchdog(servo_watchdog* dog, servo_mask where) {
  const servo_count zero = {0};
  const servo_flag none = {0};
  dog->does = where ? broadcast_flags(SERVO_HOLDS) : dog->does;
  dog->cause = where ? broadcast_flags(SERVO_NO_TARGET) : dog->cause;
  dog->silence = where ? zero : dog->silence;
  dog->target_came = where ? none : dog->target_came;
  dog->state_came = where ? none : dog->state_came;
}

SERVO_INLINE void record_target(servo_watchdog* dog, servo_mask where, servo_count now) {
  dog->target_came |= make_flag(where, 1);
  dog->last_target = where ? now : dog->last_target;
}

SERVO_INLINE void record_state(servo_watchdog* dog, servo_count now) {
  dog->state_came = broadcast_flags(1);
  dog->last_state = now;
}

SERVO_INLINE void check_silence(servo_watchdog* dog, servo_mask where, servo_count* last,
                                servo_count now, int cause) {
  const servo_count back = where ? now : *last;
  *last = *last > now ? back : *last;
  const servo_count silence = now - *last;
  const servo_mask late = where & (silence > dog->hold_after);
  if (!any(late)) return;
  dog->does =
      late ? (silence > dog->cut_after ? broadcast_flags(SERVO_CUT) : broadcast_flags(SERVO_HOLDS))
           : dog->does;
  dog->cause = late ? broadcast_flags(cause) : dog->cause;
  dog->silence = late ? silence : dog->silence;
}

SERVO_INLINE servo_flag check_watchdog(servo_watchdog* dog, servo_count now) {
  const servo_mask on = dog->does != broadcast_flags(SERVO_CUT), heard = dog->target_came != 0;
  dog->does =
      on ? (heard ? broadcast_flags(SERVO_FOLLOWS) : broadcast_flags(SERVO_HOLDS)) : dog->does;
  dog->cause =
      on ? (heard ? broadcast_flags(SERVO_HEARS) : broadcast_flags(SERVO_NO_TARGET)) : dog->cause;
  check_silence(dog, on & heard, &dog->last_target, now, SERVO_LATE_TARGET);
  check_silence(dog, (dog->does != broadcast_flags(SERVO_CUT)) & (dog->state_came != 0),
                &dog->last_state, now, SERVO_LATE_STATE);
  return dog->does;
}

/* ------------------------------------------------------------------------------------ an arm */

SERVO_INLINE void reset_clock(servo* arm, servo_mask where) {
  const servo_count zero = {0};
  const servo_flag none = {0};
  reset_watchdog(&arm->watchdog, where);
  arm->now = where ? zero : arm->now;
  arm->target_time = where ? zero : arm->target_time;
  arm->measured = where ? none : arm->measured;
  arm->aimed = where ? none : arm->aimed;
  arm->holding = where ? none : arm->holding;
  arm->does = where ? broadcast_flags(SERVO_HOLDS) : arm->does;
}

SERVO_INLINE servo_real to_seconds(servo_count time) { return to_real(time) / NANOSECONDS; }

/* Whether the newest command followed a target. */
SERVO_INLINE servo_mask is_following(const servo* arm) {
  return (arm->does == broadcast_flags(SERVO_FOLLOWS)) & (arm->aimed != 0);
}

/* The servo period that ends now. */
typedef struct servo_past {
  servo_mask learns;  /* a target was followed in it */
  servo_real changed; /* s, in which the torques of the targets changed */
  servo_real passed;  /* s */
  servo_real ahead;   /* s, of its end since the middle of the target's motion period */
} servo_past;

/* The clock of an arm goes on to `now`. */
SERVO_INLINE servo_past advance_clock(servo* arm, servo_count now) {
  const servo_real zero = {0};
  const servo_count begins = arm->now, ends = arm->target_time + arm->motion_period;
  const servo_count last = now < ends ? now : ends, since = now - arm->target_time;
  const servo_mask follows = is_following(arm);
  const servo_past past = {
      follows & (arm->measured != 0) & (now > begins) & (since <= arm->motion_period),
      (follows & (last > begins)) ? to_seconds(last - begins) : zero,
      to_seconds(now - begins),
      to_seconds(since) - HALF * to_real(arm->motion_period) / NANOSECONDS,
  };
  arm->now = now;
  arm->measured = broadcast_flags(1);
  record_state(&arm->watchdog, now);
  return past;
}

/* A target comes now. Returns the seconds since the one before, if that was followed until now,
 * period after period; else 0. */
SERVO_INLINE servo_real register_target(servo* arm, servo_mask where) {
  const servo_real zero = {0};
  const servo_count since = arm->now - arm->target_time;
  const servo_mask measured = arm->measured != 0, goes_on = is_following(arm) & measured;
  arm->aimed |= make_flag(where, 1);
  arm->target_time = (where & measured) ? arm->now : arm->target_time;
  record_target(&arm->watchdog, where & measured, arm->now);
  return (goes_on & (since == arm->motion_period)) ? to_seconds(since) : zero;
}

/* Decision of an arm for the period that begins. */
typedef struct servo_decision {
  servo_mask cut;     /* command nothing */
  servo_mask follows; /* a target, `ahead` seconds after it came */
  servo_mask latches; /* hold from here where the joint stands */
  servo_real ahead;
  servo_real period; /* s, of the motion */
} servo_decision;

SERVO_INLINE servo_decision decide_period(servo* arm, servo_mask powered) {
  const servo_flag none = {0};
  const servo_count zero = {0}, since = arm->now - arm->target_time;
  const servo_mask dead = powered == 0, lost = dead & (arm->measured != 0);
  const servo_count positive = since < 0 ? zero : since;
  const servo_count ahead = positive > arm->motion_period ? arm->motion_period : positive;
  const servo_flag does = check_watchdog(&arm->watchdog, arm->now);
  arm->does = (dead | (arm->measured == 0)) ? broadcast_flags(SERVO_CUT) : does;
  arm->aimed = lost ? none : arm->aimed;
  arm->watchdog.target_came = lost ? none : arm->watchdog.target_came;
  const servo_mask cut = arm->does == broadcast_flags(SERVO_CUT), follows = is_following(arm);
  const servo_mask holds = (cut == 0) & (follows == 0);
  const servo_decision decision = {cut, follows, holds & (arm->holding == 0), to_seconds(ahead),
                                   to_seconds(arm->motion_period)};
  arm->holding = make_flag(holds, 1);
  return decision;
}
