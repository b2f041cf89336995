// What the machine is at one instant.
#pragma once

namespace arm {

// Current i [A], motor angle tm [rad] and speed wm [rad/s], link angle q [rad] and speed v [rad/s]
// (m and m/s for prismatic joints). The motor behind a rigid gear has no tm and wm of its own: they
// are q / Ng and v / Ng. Without inductance i follows from V and wm.
template <int N>
struct State {
  double i[N], tm[N], wm[N], q[N], v[N];
};

}  // namespace arm
