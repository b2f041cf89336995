/* The factor by which a link's load follows the torques that are announced for it. servo.c includes
 * this after joint_number.h, once for a number type.
 *
 * By least squares over the last motion: load = load_mean + (1 + excess) (tau - tau_mean). A load
 * that nobody announced is part of the mean and not of the factor. Loads at rest do not count: the
 * friction that holds a joint there has any size up to its limit, and lets go of it at the start.
 * What was announced at rest is the integral's; what is added since is multiplied:
 *
 *   expected load = tau + excess (tau - tau_base)
 *
 * A lasting load moves to the integral, too. The base follows slowly, and the expected load falls
 * with it. In the same period the integral rises by as much, so that their sum does not change. */

/* Slower changes of loads are the integral's [s]; and shares of it per second. */
static const servo_scalar SLOW = (servo_scalar)1.5, PER_SLOW = 1 / (servo_scalar)1.5;
/* Evidence that the factor is 1: announced torques of so many times what a count of the encoder
 * changes in the observed load, for so long [s]. */
static const servo_scalar DOUBTS = 10, DOUBTED = (servo_scalar)0.1;
/* Announced torques that are right within such a factor stay as they are. */
static const servo_scalar RIGHT = (servo_scalar)1.1;
/* The load on a soft gear follows its torques late: no factor counts before so long a motion [s].
 */
static const servo_scalar SETTLED = (servo_scalar)0.05;
/* Observers that take less of a difference of angles in a period see loads too late to learn. */
static const servo_scalar SWIFT = (servo_scalar)0.5;
/* For so long of a motion evidence counts [s]; and shares of it per second. */
static const servo_scalar KEPT = 2, PER_KEPT = (servo_scalar)0.5;

/* A servo period, in quantities of the link. */
typedef struct servo_sample {
  servo_mask follows; /* a target */
  servo_mask moves;   /* with torques that change */
  servo_real passed;  /* s */
  servo_real tau;     /* announced, N m */
  servo_real load;    /* observed, N m */
  servo_real count;   /* change of the observed load by one count of the encoder, N m */
} servo_sample;

SERVO_INLINE void reset_load(servo_learned* learned, servo_mask where) {
  const servo_real zero = {0};
  learned->excess = where ? zero : learned->excess;
  learned->tau_base = where ? zero : learned->tau_base;
  learned->tau_mean = where ? zero : learned->tau_mean;
  learned->load_mean = where ? zero : learned->load_mean;
  learned->evidence = where ? zero : learned->evidence;
  learned->product = where ? zero : learned->product;
  learned->watched = where ? zero : learned->watched;
}

SERVO_INLINE servo_real compute_expected_load(const servo_learned* learned, servo_real tau) {
  return tau + learned->excess * (tau - learned->tau_base);
}

/* The base follows slowly; where no factor counts it is what is announced at rest. Returns by how
 * much the base has changed. */
SERVO_INLINE servo_real update_load_base(servo_learned* learned, const servo_sample* seen) {
  const servo_real zero = {0}, one = broadcast(1);
  const servo_mask rests = seen->follows & (seen->moves == 0);
  const servo_real slow = seen->passed < SLOW ? seen->passed * PER_SLOW : one;
  const servo_real share = (rests & (learned->excess == 0)) ? one : slow;
  const servo_real change = seen->follows ? share * (seen->tau - learned->tau_base) : zero;
  learned->tau_base += change;
  return change;
}

/* Go on with means, evidence and product by one period of motion (Welford's update). */
SERVO_INLINE void update_means(servo_learned* learned, const servo_sample* seen) {
  const servo_real zero = {0}, one = broadcast(1);
  const servo_real kept = seen->passed < KEPT ? one - seen->passed * PER_KEPT : zero;
  const servo_real watched = kept * learned->watched + seen->passed;
  const servo_real tau = seen->tau - learned->tau_mean, load = seen->load - learned->load_mean;
  const servo_real share = watched > 0 ? seen->passed / watched : zero;
  const servo_real rest = (one - share) * seen->passed * tau;
  const servo_mask moves = seen->moves;
  learned->watched = moves ? watched : learned->watched;
  learned->tau_mean = moves ? learned->tau_mean + share * tau : learned->tau_mean;
  learned->load_mean = moves ? learned->load_mean + share * load : learned->load_mean;
  learned->evidence = moves ? kept * learned->evidence + rest * tau : learned->evidence;
  learned->product = moves ? kept * learned->product + rest * load : learned->product;
}

/* Return the torque that the expected load loses because the base has changed: the integral's. */
SERVO_INLINE servo_real learn_load(servo_learned* learned, const servo_sample* seen) {
  const servo_real zero = {0}, one = broadcast(1);
  const servo_mask moves = seen->moves;
  if (!any(moves | (seen->tau != learned->tau_base))) return zero;
  const servo_real lost = learned->excess * update_load_base(learned, seen);
  if (!any(moves)) return lost;
  update_means(learned, seen);
  const servo_real doubt = DOUBTS * DOUBTS * DOUBTED * seen->count * seen->count;
  const servo_real factor = (doubt + learned->product) / (doubt + learned->evidence);
  const servo_mask sound = is_finite(factor + lost);
  const servo_mask right = ((factor * RIGHT > 1) & (factor < RIGHT)) | (learned->watched < SETTLED);
  const servo_real bounded = bound(factor, broadcast(SERVO_LEAST), broadcast(SERVO_MOST));
  learned->excess = moves ? (right ? zero : bounded - one) : learned->excess;
  reset_load(learned, moves & (sound == 0));
  return sound ? lost : zero;
}
