// The functions of arm.h that meter energy: powers supplied and dissipated, and their integrals.
#pragma once

#include "boundary/arm_machine.hpp"

#pragma GCC visibility push(default)

namespace {

void write_flow(const auto& flow, double* out) {
  constexpr int J = arm_machine::J;
  arm_machine::copy_to_joints(flow.supplied, out);
  arm_machine::copy_to_joints(flow.dissipated, out + J);
  for (int drive = 0; drive < arm_machine::N; ++drive)  // deflections count to their joint
    if (const int j = arm::find_joint<Scene>(drive); drive != arm::drive_of<Scene>(j)) {
      out[j] += flow.supplied[drive];
      out[J + j] += flow.dissipated[drive];
    }
}

// Call meter(), which is compiled for scenes that meter energy alone.
template <class S>
int call_metered([[maybe_unused]] auto* machine, [[maybe_unused]] auto&& meter) {
  if (!machine) return ARM_REFUSED;
  if constexpr (S::energy_flow)
    return meter(*machine);
  else
    return machine->refuse(-1, "energy_flow", "be true in the scene", 0.0);
}

}  // namespace

int arm_powers(const arm_machine* machine, const double* command, double* out) {
  return call_metered<Scene>(machine, [&](const auto& one) {
    if (one.check_finite(command, "command") || one.check_pointer(out, "out")) return ARM_REFUSED;
    write_flow(one.machine.measure_powers(one.apply_power(command).of), out);
    return ARM_OK;
  });
}

int arm_advance_metered(arm_machine* machine, const double* command, std::int64_t steps,
                        double* out) {
  return call_metered<Scene>(machine, [&](auto& one) -> int {
    if (one.check_finite(command, "command") || one.check_pointer(out, "out") ||
        one.check_count(steps, "steps"))
      return ARM_REFUSED;
    arm::EnergyFlow<Scene> flow;
    const arm_machine::Drives applied = one.apply_power(command);
    one.advance_with_sensors(
        steps, [&](std::int64_t some) { one.machine.advance_metered(applied.of, some, flow); });
    write_flow(flow, out);
    return one.result();
  });
}

#pragma GCC visibility pop
