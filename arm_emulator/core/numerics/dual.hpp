// Dual numbers: a value and its derivatives in some directions (forward mode; Griewank and Walther,
// Evaluating Derivatives, 2008, ch. 3). Comparisons are those of the values, so that a branch is
// the one of the values alone.
#pragma once

#include <type_traits>

#include "numerics/loops.hpp"

// On processors with narrower registers the compiler splits the vectors. Its warning about how
// vectors are passed does not matter: functions that take or return them are inlined.
#pragma GCC diagnostic ignored "-Wpsabi"
// Comparisons of lanes are masks, which `&` combines; those of dual numbers are bools.
#ifdef __clang__
#pragma clang diagnostic ignored "-Wbitwise-instead-of-logical"
#endif

namespace arm {

template <int directions>
struct Dual {
  // Without gaps: nearly half of the memory would be gaps, and more of it would be moved.
  typedef double Row
      __attribute__((vector_size(directions * sizeof(double)), aligned(sizeof(double))));

  double value;
  Row by;  // derivatives

  Dual() = default;
  template <class Number>
    requires std::is_arithmetic_v<Number>
  ARM_INLINE constexpr Dual(Number number) : value(static_cast<double>(number)), by{} {}
  ARM_INLINE constexpr Dual(double number, const Row& derivatives)
      : value(number), by(derivatives) {}

  ARM_INLINE constexpr Dual operator-() const { return {-value, -by}; }
  ARM_INLINE constexpr Dual& operator+=(const Dual& b) { return *this = *this + b; }
  ARM_INLINE constexpr Dual& operator-=(const Dual& b) { return *this = *this - b; }
  ARM_INLINE constexpr Dual& operator*=(const Dual& b) { return *this = *this * b; }
  ARM_INLINE constexpr Dual& operator/=(const Dual& b) { return *this = *this / b; }

  friend ARM_INLINE constexpr Dual operator+(const Dual& a, const Dual& b) {
    return {a.value + b.value, a.by + b.by};
  }
  friend ARM_INLINE constexpr Dual operator-(const Dual& a, const Dual& b) {
    return {a.value - b.value, a.by - b.by};
  }
  friend ARM_INLINE constexpr Dual operator*(const Dual& a, const Dual& b) {
    return {a.value * b.value, a.value * b.by + b.value * a.by};
  }
  friend ARM_INLINE constexpr Dual operator/(const Dual& a, const Dual& b) {
    const double share = 1.0 / b.value, quotient = a.value * share;
    return {quotient, share * (a.by - quotient * b.by)};
  }
  // Operations with a constant.
  friend ARM_INLINE constexpr Dual operator+(const Dual& a, double b) {
    return {a.value + b, a.by};
  }
  friend ARM_INLINE constexpr Dual operator+(double a, const Dual& b) {
    return {a + b.value, b.by};
  }
  friend ARM_INLINE constexpr Dual operator-(const Dual& a, double b) {
    return {a.value - b, a.by};
  }
  friend ARM_INLINE constexpr Dual operator-(double a, const Dual& b) {
    return {a - b.value, -b.by};
  }
  friend ARM_INLINE constexpr Dual operator*(const Dual& a, double b) {
    return {a.value * b, a.by * b};
  }
  friend ARM_INLINE constexpr Dual operator*(double a, const Dual& b) {
    return {a * b.value, a * b.by};
  }
  friend ARM_INLINE constexpr Dual operator/(const Dual& a, double b) { return a * (1.0 / b); }

  friend ARM_INLINE constexpr bool operator==(const Dual& a, const Dual& b) {
    return a.value == b.value;
  }
  friend ARM_INLINE constexpr auto operator<=>(const Dual& a, const Dual& b) {
    return a.value <=> b.value;
  }

  // See number.hpp.
  friend ARM_INLINE constexpr Dual select(bool mask, const Dual& a, const Dual& b) {
    return mask ? a : b;
  }
  friend ARM_INLINE constexpr Dual clamp(const Dual& x, const Dual& limit) {
    return x > limit ? limit : x < -limit ? -limit : x;
  }
  friend ARM_INLINE constexpr Dual lane_of(const Dual& x, int) { return x; }
  friend ARM_INLINE constexpr void set_lane(Dual& x, int, const Dual& value) { x = value; }
};

// f(x) with the slope of f there.
template <int directions>
ARM_INLINE constexpr Dual<directions> chained(double f, double slope, const Dual<directions>& x) {
  return {f, slope * x.by};
}

template <int directions>
ARM_INLINE Dual<directions> square_root(const Dual<directions>& x) {
  const double root = __builtin_sqrt(x.value);
  return chained(root, root > 0.0 ? 0.5 / root : 0.0, x);
}

ARM_INLINE constexpr double value_of(double x) { return x; }
template <int directions>
ARM_INLINE constexpr double value_of(const Dual<directions>& x) {
  return x.value;
}
// The same number as a constant.
template <class X>
ARM_INLINE constexpr X constant(const X& x) {
  return value_of(x);
}

// Whether any derivative differs from 0.
constexpr bool has_derivatives(double) { return false; }
template <int directions>
bool has_derivatives(const Dual<directions>& x) {
  bool result = false;
  for (int d = 0; d < directions; ++d) result = result || x.by[d] != 0.0;
  return result;
}

}  // namespace arm
