// Base of the schemes. A scheme is a struct that inherits this one and has
//
//   template <class S, class X> using Method = ...;
//
// the class that takes its steps, of numbers X: a double, or lanes. A scene has its own as
// S::Scheme.
#pragma once

namespace arm {

struct AnyScheme {
  // Whether it keeps the accelerations of the last step, and the torques M a + nle that they took.
  static constexpr bool extrapolates = false;
  // The speed with which links move on over a step: 0 that at its beginning, 1 that at its end.
  static constexpr double end_of_step = 1.0;
};

template <class S, class X>
using MethodOf = typename S::Scheme::template Method<S, X>;

// Replaces the exchange with the thread of the links.
struct NullExchange {
  void receive_links(const auto&) {}
  void send_state(const auto&) {}
};

}  // namespace arm
