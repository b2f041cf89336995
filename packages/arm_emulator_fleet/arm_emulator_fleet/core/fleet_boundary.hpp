// The functions of arm_fleet.h for one scene. Included last in a scene's unit.
#pragma once

#include "controlled_group.hpp"
#include "fleet_changes.hpp"

#pragma GCC visibility push(default)

std::int32_t arm_fleet_lanes(void) { return arm_fleet::lanes; }

arm_fleet* arm_fleet_new(const arm_options* options, std::int32_t count) {
  if (!options || options->size < sizeof *options || count < 1 ||
      (Scene::parameters && !options->parameters))
    return nullptr;
  arm_fleet* fleet = new arm_fleet(*options, count);
  bool sound = true;
  for (int g = 0; g < fleet->groups() && sound; ++g) sound = fleet->build(g, *options);
  if (sound) return fleet;
  delete fleet;
  return nullptr;
}
void arm_fleet_delete(arm_fleet* fleet) { delete fleet; }

arm_machine* arm_fleet_machine(arm_fleet* fleet, std::int32_t arm) {
  if (!fleet || arm < 0 || arm >= fleet->arms) return nullptr;
  fleet->move_to_machine(arm);
  ++fleet->users[arm];
  return fleet->machine[arm];
}
void arm_fleet_give_back(arm_fleet* fleet, std::int32_t arm) {
  if (fleet && arm >= 0 && arm < fleet->arms && fleet->users[arm] > 0) --fleet->users[arm];
}

int arm_fleet_run(arm_fleet* fleet, std::int32_t first, std::int32_t arms, const double* command,
                  std::int64_t rows, std::int64_t steps, double* q) {
  constexpr int N = arm_fleet::J, lanes = arm_fleet::lanes;
  if (!fleet || !command || !q || !fleet->has_arms(first, arms) || rows < 0 || steps < 0)
    return ARM_REFUSED;
  const std::int32_t end = first + arms;
  const std::int64_t stride = std::int64_t{fleet->arms} * N;
  for (std::int64_t row = 0; row < rows; ++row) {
    bool finite = true;
    for (std::int64_t k = first * N; k < end * N; ++k)
      finite &= arm::is_finite(command[row * stride + k]);
    if (!finite) return ARM_REFUSED;
  }
  for (std::int32_t k = first; k < end; k += lanes)
    fleet->follow_rows(k / lanes, command + k * N, stride, rows, steps, q + k * N);
  return fleet->find_result(first, arms);
}

std::int32_t arm_fleet_refused(const arm_fleet* fleet) { return fleet ? fleet->refused() : -1; }

int arm_fleet_reset(arm_fleet* fleet, const std::uint8_t* mask, const double* q, const double* v) {
  constexpr int N = arm_fleet::J;
  if (!fleet || !q || !v) return ARM_REFUSED;
  const auto check = [&](const arm_machine* arm, int k) {
    return arm->check_finite(q + k * N, "q") || arm->check_finite(v + k * N, "v") ? ARM_REFUSED
                                                                                  : ARM_OK;
  };
  if (fleet->check_all(mask, check)) return ARM_REFUSED;
  fleet->change_arms(mask, [&](arm_machine* arm, int k) { arm_reset(arm, q + k * N, v + k * N); });
  return ARM_OK;
}

int arm_fleet_get_parameter(const arm_fleet* fleet, const char* name, double* values) {
  if (!fleet || !values) return ARM_REFUSED;
  return fleet->check_all(nullptr, [&](const arm_machine* arm, int k) {
    return arm_get_parameter(arm, name, values + k);
  });
}

int arm_fleet_set_parameter(arm_fleet* fleet, const std::uint8_t* mask, const char* name,
                            const double* values) {
  if (!fleet || !values) return ARM_REFUSED;
  const int place = find_parameter(name);
  const auto check = [&](const arm_machine* arm, int k) {
    if (place < 0) return arm->refuse(-1, "parameter", "be varied in this scene", 0.0);
    if (is_within_bounds(place, values[k])) return int{ARM_OK};
    return arm->refuse(-1, "parameter", "be within its bounds", values[k]);
  };
  if (fleet->check_all(mask, check)) return ARM_REFUSED;
  fleet->change_arms(
      mask, [&](arm_machine* arm, int k) { arm->machine.set_parameter(place, values[k]); });
  return ARM_OK;
}

int arm_fleet_set_parameters(arm_fleet* fleet, const std::uint8_t* mask, const double* values) {
  constexpr int count = Scene::parameters;
  if (!fleet || (count > 0 && !values)) return ARM_REFUSED;
  const auto check = [&](const arm_machine* arm, int k) {
    for (int p = 0; p < count; ++p)
      if (const double value = values[k * count + p]; !is_within_bounds(p, value))
        return arm->refuse(-1, "parameter", "be within its bounds", value);
    return int{ARM_OK};
  };
  if (fleet->check_all(mask, check)) return ARM_REFUSED;
  fleet->change_arms(
      mask, [&](arm_machine* arm, int k) { arm->machine.set_parameters(values + k * count); });
  return ARM_OK;
}

int arm_fleet_set_external_wrench(arm_fleet* fleet, const std::uint8_t* mask, std::int32_t link,
                                  const arm_wrench* wrench) {
  if (!fleet || !wrench) return ARM_REFUSED;
  arm::GivenWrench given = {};
  if (fleet->check_all(mask, [&](const arm_machine* arm, int k) {
        return check_wrench(arm, link, wrench + k, given);
      }))
    return ARM_REFUSED;
  fleet->change_arms(
      mask, [&](arm_machine* arm, int k) { arm_set_external_wrench(arm, link, wrench + k); });
  return ARM_OK;
}

void arm_fleet_power(arm_fleet* fleet, const std::uint8_t* on) {
  if (fleet && on)
    fleet->change_arms(nullptr, [&](arm_machine* arm, int k) { arm_power(arm, on[k] != 0); });
}

int arm_fleet_save(const arm_fleet* fleet, void* out, std::int64_t size) {
  const std::int64_t each = arm_saved_size();
  if (!fleet || !out || size != each * fleet->arms) return ARM_REFUSED;
  return fleet->check_all(nullptr, [&](const arm_machine* arm, int k) {
    fleet->move_to_machine(k);
    return arm_save(arm, static_cast<unsigned char*>(out) + k * each, each);
  });
}

int arm_fleet_restore(arm_fleet* fleet, const std::uint8_t* mask, const void* saved,
                      std::int64_t size) {
  const std::int64_t each = arm_saved_size();
  if (!fleet || !saved || (size != each && size != each * fleet->arms)) return ARM_REFUSED;
  const std::int64_t stride = size == each ? 0 : each;
  const auto* bytes = static_cast<const unsigned char*>(saved);
  if (fleet->check_all(mask, [&](const arm_machine* arm, int k) {
        return check_saved(arm, bytes + k * stride, each);
      }))
    return ARM_REFUSED;
  fleet->change_arms(mask,
                     [&](arm_machine* arm, int k) { restore_saved(arm, bytes + k * stride); });
  return ARM_OK;
}

int arm_fleet_measure(const arm_fleet* fleet, arm_fleet_measurement* out) {
  if (!fleet || !out || out->size < sizeof *out) return ARM_REFUSED;
  for (int arm = 0; arm < fleet->arms; ++arm) fleet->measure(arm, *out);
  return ARM_OK;
}

int arm_fleet_exchange(arm_fleet* fleet, std::int32_t first, std::int32_t arms,
                       const arm_command* command) {
  return arm_fleet_step(fleet, first, arms, command, 1, nullptr, nullptr);
}

int arm_fleet_step(arm_fleet* fleet, std::int32_t first, std::int32_t arms,
                   const arm_command* command, std::int64_t periods,
                   arm_fleet_measurement* measurement, arm_fleet_truth* truth) {
  if (!fleet || !fleet->has_arms(first, arms) || periods < 0 ||
      (measurement && measurement->size < sizeof *measurement) ||
      (truth && truth->size < sizeof *truth))
    return ARM_REFUSED;
  constexpr int lanes = arm_fleet::lanes;
  const double* further = nullptr;
  if (periods > 0) {
    if (!fleet->can_take_commands(first, arms, command)) return ARM_REFUSED;
    further = fleet->further_of(*command);
  }
  for (std::int32_t k = first; k < first + arms; k += lanes) {
    if (periods > 0)
      fleet->hold_commands(k / lanes, command->joint, further, command->tick, periods);
    fleet->observe(k / lanes, measurement, truth);
  }
  return fleet->find_result(first, arms);
}

int arm_fleet_follow(arm_fleet* fleet, std::int32_t first, std::int32_t arms,
                     const arm_fleet_control* control, std::int64_t periods,
                     const arm_fleet_way* way, arm_fleet_measurement* measurement,
                     arm_fleet_truth* truth) {
  constexpr int lanes = arm_fleet::lanes;
  if (!fleet || !fleet->has_arms(first, arms) || periods < 0 || !control ||
      (way && (way->size < sizeof *way || !way->change != !way->first_change)) ||
      control->size < sizeof *control || !control->step == !control->step_rows || !control->joint ||
      !measurement || measurement->size < sizeof *measurement || !measurement->joint ||
      !measurement->powered || (truth && truth->size < sizeof *truth))
    return ARM_REFUSED;
  constexpr arm_fleet_way nothing = {};
  const arm_fleet_way& by = way ? *way : nothing;
  if (const int arm = find_refused_change(*fleet, first, arms, by); arm >= 0) {
    fleet->set_refused(arm);
    return ARM_REFUSED;
  }
  int result = ARM_OK;
  for (std::int32_t k = first; k < first + arms; k += lanes)
    if (!ControlledGroup(*fleet, k / lanes, *control, *measurement, by).advance(periods))
      result = ARM_REFUSED;
  for (std::int32_t k = first; k < first + arms; k += lanes)
    fleet->observe(k / lanes, measurement, truth);
  return result == ARM_OK ? fleet->find_result(first, arms) : result;
}

int arm_fleet_get_truth(const arm_fleet* fleet, arm_fleet_truth* out) {
  if (!fleet || !out || out->size < sizeof *out) return ARM_REFUSED;
  for (int arm = 0; arm < fleet->arms; ++arm) fleet->get_truth(arm, *out);
  return ARM_OK;
}

#pragma GCC visibility pop
