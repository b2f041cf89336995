// The functions of arm.h and arm_fleet.h for one scene. Included last in a scene's unit.
#pragma once

#include "arm_fleet.h"
#include "boundary.hpp"
#include "machine/side_by_side.hpp"

struct arm_fleet {
  using Machine = arm_machine::Machine;
  static constexpr int N = Scene::N;
  // Steps that are cut at events, or shared by two threads, are not the same in every lane.
  static constexpr bool together =
      std::is_same_v<Machine::Threads, arm::OneThread<Scene, Machine::Method>>;
  static constexpr int lanes = together ? arm::kNativeLanes : 1;
  using Group = arm::SideBySide<Scene, lanes>;

  arm_fleet(const arm_options& options, int count) : arms(count), machine(new arm_machine*[count]) {
    arm_options own = options;
    for (int k = 0; k < arms; ++k, own.parameters += Scene::parameters) machine[k] = arm_new(&own);
    for (int k = 0; k < arms; ++k) sound = sound && machine[k];
    if (!sound) return;
    group = new Group*[groups()];
    for (int k = 0; k < groups(); ++k) {
      Machine* members[lanes];
      int of_group = 0;
      for (; of_group < lanes && k * lanes + of_group < arms; ++of_group)
        members[of_group] = &machine[k * lanes + of_group]->machine;
      group[k] = new Group(options.step, members, of_group);
    }
  }
  ~arm_fleet() {
    for (int k = 0; group && k < groups(); ++k) delete group[k];
    delete[] group;
    for (int k = 0; k < arms; ++k) arm_delete(machine[k]);
    delete[] machine;
  }
  arm_fleet(const arm_fleet&) = delete;

  // Take a group through rows of commands, see SideBySide; sensors look at every tick. Arms without
  // power get none of them.
  void follow(int g, const double* command, std::int64_t stride, std::int64_t rows,
              std::int64_t steps, double* q) {
    const int first = g * lanes, end = first + lanes < arms ? first + lanes : arms;
    bool powered = true;
    for (int k = first; k < end; ++k) powered = powered && machine[k]->powered;
    if (powered) {
      follow_given(g, command, stride, rows, steps, q);
      return;
    }
    for (; rows > 0; --rows, command += stride, q += stride) {
      double given[lanes * N] = {};
      for (int k = first; k < end; ++k) {
        const double* own = machine[k]->with_power(command + (k - first) * N);
        for (int j = 0; j < N; ++j) given[(k - first) * N + j] = own[j];
      }
      follow_given(g, given, 0, 1, steps, q);
    }
  }
  void follow_given(int g, const double* command, std::int64_t stride, std::int64_t rows,
                    std::int64_t steps, double* q) {
    if constexpr (!arm_machine::Sensors::present) {
      group[g]->follow(command, stride, rows, steps, q);
    } else {
      const int first = g * lanes, end = first + lanes < arms ? first + lanes : arms;
      for (; rows > 0; --rows, command += stride, q += stride) {
        if (steps == 0) group[g]->follow(command, stride, 1, 0, q);
        for (std::int64_t left = steps; left > 0;) {
          std::int64_t some = left;  // up to the next tick of one of them
          for (int k = first; k < end; ++k) {
            const std::int64_t period = machine[k]->steps_per_period;
            const std::int64_t due = period - machine[k]->machine.steps() % period;
            if (machine[k]->machine.faulty_joint() < 0 && due < some) some = due;
          }
          group[g]->follow(command, stride, 1, some, q);
          for (int k = first; k < end; ++k) machine[k]->look();
          left -= some;
        }
      }
    }
  }

  // One servo period under the commands that each has taken.
  void exchange(int g) {
    const int first = g * lanes, end = first + lanes < arms ? first + lanes : arms;
    double given[lanes * N] = {}, q[lanes * N];
    for (int k = first; k < end; ++k)
      for (int j = 0; j < N; ++j) given[(k - first) * N + j] = machine[k]->applied[j];
    follow_given(g, given, 0, 1, machine[first]->steps_per_period, q);
  }

  // OK if check(machine, arm) is for all arms of a mask.
  template <class Check>
  int check_all(const std::uint8_t* mask, Check&& check) const {
    refused = -1;
    for (int k = 0; k < arms; ++k)
      if ((!mask || mask[k]) && check(machine[k], k) != ARM_OK) {
        refused = k;
        return ARM_REFUSED;
      }
    return ARM_OK;
  }
  template <class Do>
  void for_all(const std::uint8_t* mask, Do&& act) {
    for (int k = 0; k < arms; ++k)
      if (!mask || mask[k]) act(machine[k], k);
  }

  int groups() const { return (arms + lanes - 1) / lanes; }

  int arms;
  arm_machine** machine;
  Group** group = nullptr;
  bool sound = true;
  mutable std::int32_t refused = -1;
};

#pragma GCC visibility push(default)

std::int32_t arm_fleet_lanes(void) { return arm_fleet::lanes; }

arm_fleet* arm_fleet_new(const arm_options* options, std::int32_t count) {
  if (!options || options->size < sizeof *options || count < 1 ||
      (Scene::parameters && !options->parameters))
    return nullptr;
  arm_fleet* fleet = new arm_fleet(*options, count);
  if (fleet->sound) return fleet;
  delete fleet;
  return nullptr;
}
void arm_fleet_delete(arm_fleet* fleet) { delete fleet; }

arm_machine* arm_fleet_machine(arm_fleet* fleet, std::int32_t arm) {
  return fleet && arm >= 0 && arm < fleet->arms ? fleet->machine[arm] : nullptr;
}

int arm_fleet_run(arm_fleet* fleet, std::int32_t first, std::int32_t arms, const double* command,
                  std::int64_t rows, std::int64_t steps, double* q) {
  constexpr int N = arm_fleet::N, lanes = arm_fleet::lanes;
  if (!fleet || !command || !q || first < 0 || first % lanes || arms < 0 || first > fleet->arms ||
      arms > fleet->arms - first || rows < 0 || steps < 0)
    return ARM_REFUSED;
  const std::int32_t end = first + arms;
  const std::int64_t stride = std::int64_t{fleet->arms} * N;
  for (std::int64_t row = 0; row < rows; ++row) {
    bool finite = true;
    for (std::int64_t k = first * N; k < end * N; ++k)
      finite &= arm::is_finite(command[row * stride + k]);
    if (!finite) return ARM_REFUSED;
  }
  int result = ARM_OK;
  for (std::int32_t k = first; k < end; k += lanes)
    fleet->follow(k / lanes, command + k * N, stride, rows, steps, q + k * N);
  for (std::int32_t k = first; k < end; ++k)
    if (fleet->machine[k]->result() != ARM_OK) result = ARM_DIVERGED;
  return result;
}

std::int32_t arm_fleet_refused(const arm_fleet* fleet) { return fleet ? fleet->refused : -1; }

int arm_fleet_reset(arm_fleet* fleet, const std::uint8_t* mask, const double* q, const double* v) {
  constexpr int N = arm_fleet::N;
  if (!fleet || !q || !v) return ARM_REFUSED;
  const auto check = [&](const arm_machine* arm, int k) {
    return arm->check_finite(q + k * N, "q") || arm->check_finite(v + k * N, "v") ? ARM_REFUSED
                                                                                  : ARM_OK;
  };
  if (fleet->check_all(mask, check)) return ARM_REFUSED;
  fleet->for_all(mask, [&](arm_machine* arm, int k) { arm_reset(arm, q + k * N, v + k * N); });
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
  const int place = place_of(name);
  const auto check = [&](const arm_machine* arm, int k) {
    if (place < 0) return arm->refuse(-1, "parameter", "be varied in this scene", 0.0);
    if (within_bounds(place, values[k])) return int{ARM_OK};
    return arm->refuse(-1, "parameter", "be within its bounds", values[k]);
  };
  if (fleet->check_all(mask, check)) return ARM_REFUSED;
  fleet->for_all(mask,
                 [&](arm_machine* arm, int k) { arm->machine.set_parameter(place, values[k]); });
  return ARM_OK;
}

void arm_fleet_power(arm_fleet* fleet, const std::uint8_t* on) {
  if (fleet && on)
    fleet->for_all(nullptr, [&](arm_machine* arm, int k) { arm_power(arm, on[k] != 0); });
}

int arm_fleet_save(const arm_fleet* fleet, void* out, std::int64_t size) {
  const std::int64_t each = arm_saved_size();
  if (!fleet || !out || size != each * fleet->arms) return ARM_REFUSED;
  return fleet->check_all(nullptr, [&](const arm_machine* arm, int k) {
    return arm_save(arm, static_cast<unsigned char*>(out) + k * each, each);
  });
}

int arm_fleet_restore(arm_fleet* fleet, const std::uint8_t* mask, const void* saved,
                      std::int64_t size) {
  const std::int64_t each = arm_saved_size();
  if (!fleet || !saved || size != each * fleet->arms) return ARM_REFUSED;
  const auto* bytes = static_cast<const unsigned char*>(saved);
  if (fleet->check_all(
          mask, [&](const arm_machine* arm, int k) { return check_saved(arm, bytes + k * each); }))
    return ARM_REFUSED;
  fleet->for_all(mask, [&](arm_machine* arm, int k) { take_saved(arm, bytes + k * each); });
  return ARM_OK;
}

int arm_fleet_measure(const arm_fleet* fleet, arm_fleet_measurement* out) {
  constexpr int N = arm_fleet::N, M = arm_machine::Sensors::M;
  if (!fleet || !out || out->size < sizeof *out) return ARM_REFUSED;
  const auto row = [](auto* rows, int first) { return rows ? rows + first : nullptr; };
  for (int arm = 0; arm < fleet->arms; ++arm) {
    arm_joint_measurement joint[N];
    arm_measurement one = {};
    one.size = sizeof one;
    one.joint = out->joint ? out->joint + arm * N : joint;
    one.sensors = row(out->sensors, arm * N);
    one.imu = row(out->imu, arm * M);
    one.current_d = row(out->current_d, arm * N);
    one.readings = row(out->readings, arm * Scene::readings * N);
    fleet->machine[arm]->measure(&one);
    if (out->powered) out->powered[arm] = one.powered != 0;
    if (out->tick) out->tick[arm] = one.tick;
    if (out->answered) out->answered[arm] = one.answered;
  }
  return ARM_OK;
}

int arm_fleet_exchange(arm_fleet* fleet, std::int32_t first, std::int32_t arms,
                       const arm_command* command) {
  constexpr int N = arm_fleet::N, lanes = arm_fleet::lanes;
  if (!fleet || !command || command->size < offsetof(arm_command, value_d) || !command->joint ||
      first < 0 || first % lanes || arms < 0 || first > fleet->arms || arms > fleet->arms - first)
    return ARM_REFUSED;
  const double* second = command->size >= sizeof *command ? command->value_d : nullptr;
  const std::int32_t end = first + arms;
  const auto of = [&](std::int32_t k) { return second ? second + k * N : nullptr; };
  for (std::int32_t k = first; k < end; ++k)
    if (fleet->machine[k]->check_commands(command->joint + k * N, of(k))) return ARM_REFUSED;
  for (std::int32_t k = first; k < end; ++k)
    fleet->machine[k]->take_commands(command->joint + k * N, of(k), command->tick);
  for (std::int32_t k = first; k < end; k += lanes) fleet->exchange(k / lanes);
  for (std::int32_t k = first; k < end; ++k)
    if (fleet->machine[k]->result() != ARM_OK) return ARM_DIVERGED;
  return ARM_OK;
}

int arm_fleet_get_truth(const arm_fleet* fleet, arm_fleet_truth* out) {
  constexpr int N = arm_fleet::N;
  if (!fleet || !out || out->size < sizeof *out) return ARM_REFUSED;
  const auto row = [](double* rows, int arm) { return rows ? rows + arm * N : nullptr; };
  for (int arm = 0; arm < fleet->arms; ++arm) {
    const arm_machine& machine = *fleet->machine[arm];
    arm_truth truth = {sizeof truth,
                       0,
                       0.0,
                       out->energy ? out->energy + arm : nullptr,
                       row(out->current, arm),
                       row(out->motor_angle, arm),
                       row(out->motor_speed, arm),
                       row(out->q, arm),
                       row(out->v, arm),
                       row(out->gear_torque, arm)};
    arm_get_truth(&machine, &truth);
    if (out->fault) out->fault[arm] = truth.fault;
    if (out->time) out->time[arm] = truth.time;
    if (!out->encoder) continue;
    arm_joint_measurement joint[N];
    arm_measurement measurement = {};
    measurement.size = sizeof measurement, measurement.joint = joint;
    arm_measure(&machine, &measurement);
    for (int j = 0; j < N; ++j) out->encoder[arm * N + j] = joint[j].encoder;
  }
  return ARM_OK;
}

#pragma GCC visibility pop
