/* Numbers of joints and arms for servo.c, which includes this once for a number type, so without a
 * guard.
 */

/* Code that every joint runs in every period is inlined: calls cost as much. */
#ifdef __GNUC__
#define SERVO_INLINE static inline __attribute__((always_inline))
#else
#define SERVO_INLINE static inline
#endif

/* Numbers are one arm's, or lanes of several. `mask ? a : b` decides for each lane, with numbers of
 * the same type on both sides; masks of one arm are 0 or 1. */

#ifdef SERVO_LANES
typedef servo_count servo_mask;

SERVO_INLINE servo_real to_real(servo_count counts) {
  return __builtin_convertvector(counts, servo_real);
}
SERVO_INLINE servo_flag make_flag(servo_mask mask, int bit) { return mask & bit; }
SERVO_INLINE int any(servo_mask mask) {
#ifdef __AVX512DQ__ /* one instruction */
  typedef long long whole __attribute__((vector_size(64)));
  if (sizeof(whole) == sizeof mask) {
    whole lanes;
    __builtin_memcpy(&lanes, &mask, sizeof mask);
    return __builtin_ia32_cvtq2mask512(lanes) != 0;
  }
#endif
  int64_t set_bits = 0;
  for (int lane = 0; lane < SERVO_LANES; ++lane) set_bits |= mask[lane];
  return set_bits != 0;
}
#else
typedef int servo_mask;

SERVO_INLINE servo_real to_real(servo_count counts) { return (servo_real)counts; }
SERVO_INLINE servo_flag make_flag(servo_mask mask, int bit) { return mask ? bit : 0; }
SERVO_INLINE int any(servo_mask mask) { return mask; }
#endif

SERVO_INLINE servo_real broadcast(servo_scalar value) {
  const servo_real zero = {0};
  return zero + value;
}
SERVO_INLINE servo_flag broadcast_flags(int value) {
  const servo_flag zero = {0};
  return zero + value;
}

static const servo_scalar HALF = (servo_scalar)0.5;

SERVO_INLINE servo_real bound(servo_real value, servo_real low, servo_real high) {
  const servo_real below = value > high ? high : value;
  return value < low ? low : below;
}

SERVO_INLINE servo_real clip(servo_real value, servo_real limit) {
  return bound(value, -limit, limit);
}

#ifdef SERVO_IS_FINITE /* of code that is compiled for finite numbers alone */
SERVO_INLINE servo_mask is_finite(servo_real value) { return SERVO_IS_FINITE(value); }
#else
SERVO_INLINE servo_mask is_finite(servo_real value) { return value - value == 0; }
#endif
