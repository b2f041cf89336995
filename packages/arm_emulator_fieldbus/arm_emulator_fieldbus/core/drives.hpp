// The functions of drives.h. Included once in the unit of a bus, before what uses it.
#pragma once

#include <deque>
#include <memory>
#include <vector>

#include "canopen/sdo_server.hpp"
#include "drive.hpp"

struct drives {
  explicit drives(const drives_machine& of)
      : machine(of),
        joints(static_cast<std::size_t>(of.at->joints)),
        further(joints.size() * static_cast<std::size_t>(of.further)) {
    for (int j = 0; j < count(); ++j) one.emplace_back(of.joint[j], machine, j);
    for (fieldbus::Drive& drive : one) sdo.emplace_back(drive, fieldbus::SdoServer::Carrier::can);
    command.size = sizeof command;
    command.joint = joints.data();
    command.further = further.data();
  }

  int count() const { return machine.at->joints; }
  fieldbus::Drive& at(int j) { return one[static_cast<std::size_t>(j)]; }
  const fieldbus::Drive& at(int j) const { return one[static_cast<std::size_t>(j)]; }
  const arm_measurement& measurement() const { return *machine.at->measurement; }
  std::int64_t tick() const { return measurement().tick; }

  // Restart at the machine's present state.
  void begin() {
    tick_measure(machine.at);
    const arm_measurement& now = measurement();
    for (int j = 0; j < count(); ++j) at(j).begin(now.joint[j], now.sensors[j], now.powered != 0);
  }
  // Servo periods of every drive and the machine.
  int periods(std::int64_t count) {
    const tick_controller controller = {this, begin_period, end_period};
    return tick_run(machine.at, &controller, count);
  }
  static const arm_command* begin_period(void* with, const tick_machine*) {
    drives& all = *static_cast<drives*>(with);
    arm_joint_command* joint = all.joints.data();
    for (fieldbus::Drive& drive : all.one) {
      *joint++ = drive.begin_period();
      drive.put_further(all.further.data());
    }
    all.command.tick = all.tick();
    return &all.command;
  }
  static void end_period(void* with, const tick_machine* at, int result) {
    const arm_joint_measurement* joint = at->measurement->joint;
    const arm_joint_sensors* sensors = at->measurement->sensors;
    const bool powered = at->measurement->powered != 0;
    for (fieldbus::Drive& drive : static_cast<drives*>(with)->one) {
      if (result != ARM_OK) drive.handle_divergence();
      drive.end_period(*joint++, *sensors++, powered);
    }
  }
  // body(drive) for a drive, -1: for all.
  template <class Does>
  void with(int j, Does&& does) {
    for (int k = 0; k < count(); ++k)
      if (j < 0 || j == k) does(at(k));
  }

  drives_machine machine;
  std::deque<fieldbus::Drive> one;
  std::deque<fieldbus::SdoServer> sdo;
  std::vector<arm_joint_command> joints;  // of the command
  std::vector<double> further;            // of the command
  arm_command command = {};
};

struct drives_state {
  const drives* of;
  std::vector<fieldbus::Drive> one;
};

namespace {

bool has(const drives* all, std::int32_t drive) {
  return all && drive >= 0 && drive < all->count();
}

}  // namespace

#pragma GCC visibility push(default)

drives* drives_new(const drives_machine* machine) {
  const bool sound =
      machine && machine->size >= sizeof *machine && machine->at && machine->at->joints >= 0 &&
      machine->at->machine && machine->at->measure && machine->at->exchange &&
      machine->at->period > 0 && machine->at->measurement &&
      (machine->joint || !machine->at->joints) && machine->further >= 0 &&
      machine->outputs == std::ssize(fieldbus::kReported) &&
      machine->inputs == std::ssize(fieldbus::kTaken) && machine->place && machine->input &&
      machine->get_parameter && machine->set_parameter && machine->faults >= 0 &&
      machine->faults <= 0xFFFF && (machine->fault || !machine->faults) &&
      (machine->bus == DRIVES_ETHERCAT || machine->bus == DRIVES_CANOPEN) &&
      (machine->home_offset == DRIVES_HOME_TO_ZERO || machine->home_offset == DRIVES_ZERO_TO_HOME);
  if (!sound) return nullptr;
  drives* all = new drives(*machine);
  all->begin();
  return all;
}
void drives_delete(drives* all) { delete all; }
std::int32_t drives_count(const drives* all) { return all ? all->count() : 0; }
void drives_begin(drives* all) {
  if (all) all->begin();
}
drives_state* drives_save(const drives* all) {
  return all ? new drives_state{all, {all->one.begin(), all->one.end()}} : nullptr;
}
void drives_state_delete(drives_state* state) { delete state; }
int drives_restore(drives* all, const drives_state* state) {
  if (!all || !state || state->of != all) return ARM_REFUSED;
  for (std::size_t j = 0; j < all->one.size(); ++j) {
    std::destroy_at(&all->one[j]);  // at its place, which others know
    std::construct_at(&all->one[j], state->one[j]);
  }
  for (int j = 0; j < all->count(); ++j) drives_sdo_begin(all, j);
  tick_measure(all->machine.at);
  return ARM_OK;
}
std::uint64_t drives_state_size(const drives* all) {
  return all ? all->one.size() * sizeof(fieldbus::Drive) : 0;
}
int drives_period(drives* all) { return drives_periods(all, 1); }
int drives_periods(drives* all, std::int64_t periods) {
  return all ? all->periods(periods) : int{ARM_REFUSED};
}
std::int64_t drives_tick(const drives* all) { return all ? all->tick() : 0; }

std::uint32_t drives_read(drives* all, std::int32_t drive, std::uint16_t index, std::uint8_t sub,
                          void* out, std::uint32_t room, std::uint32_t* size) {
  if (!size) return fieldbus::abort_code::general;
  *size = 0;
  if (!has(all, drive) || (!out && room)) return fieldbus::abort_code::general;
  std::size_t bytes = 0;
  const std::uint32_t abort =
      all->at(drive).read(index, sub, {static_cast<std::byte*>(out), room}, bytes);
  *size = static_cast<std::uint32_t>(bytes);
  return abort;
}
std::uint32_t drives_write(drives* all, std::int32_t drive, std::uint16_t index, std::uint8_t sub,
                           const void* in, std::uint32_t size) {
  if (!has(all, drive) || (!in && size)) return fieldbus::abort_code::general;
  return all->at(drive).write(index, sub, {static_cast<const std::byte*>(in), size});
}
std::uint32_t drives_write_number(drives* all, std::int32_t drive, std::uint16_t index,
                                  std::uint8_t sub, std::int64_t value) {
  if (!has(all, drive)) return fieldbus::abort_code::general;
  const int slot = all->at(drive).values().find(index, sub);
  const std::size_t size = slot < 0 ? 0 : fieldbus::Values::entry(slot).bits / 8U;
  const auto* const bytes = reinterpret_cast<const std::byte*>(&value);
  if (size && fieldbus::Values::number(fieldbus::Values::entry(slot), bytes) != value)
    return fieldbus::abort_code::out_of_range;
  return all->at(drive).write(index, sub, {bytes, size});
}

std::int32_t drives_sdo(drives* all, std::int32_t drive, const std::uint8_t* request,
                        std::uint8_t* replies) {
  if (!has(all, drive) || !request || !replies) return 0;
  std::vector<fieldbus::Bytes> out;
  all->sdo[static_cast<std::size_t>(drive)].answer({request, 8}, 8, out);
  for (const fieldbus::Bytes& one : out) replies = std::copy_n(one.begin(), 8, replies);
  return static_cast<std::int32_t>(out.size());
}
void drives_sdo_begin(drives* all, std::int32_t drive) {
  if (has(all, drive)) all->sdo[static_cast<std::size_t>(drive)].begin();
}
std::uint32_t drives_communication(const drives* all, std::int32_t drive) {
  return has(all, drive) ? all->at(drive).communication() : 0;
}

int drives_list(std::int32_t slot, drives_entry* out) {
  if (!out || slot < 0 || slot >= fieldbus::kSlots) return 0;
  const fieldbus::Entry& one = fieldbus::Values::entry(slot);
  *out = {one.index,
          one.sub,
          one.last_sub,
          static_cast<std::uint16_t>(one.type),
          one.bits,
          static_cast<std::uint8_t>(one.access),
          static_cast<std::uint8_t>(one.pdo),
          static_cast<std::uint8_t>(one.code),
          one.buses,
          0,
          one.standard,
          one.least,
          one.most,
          one.object,
          one.name,
          one.unit};
  return 1;
}

int drives_list_mode(std::int32_t row, drives_mode* out) {
  constexpr auto all = fieldbus::Modes::all();
  if (!out || row < 0 || row >= static_cast<std::int32_t>(all.size())) return 0;
  const fieldbus::AboutMode& one = all[static_cast<std::size_t>(row)];
  *out = {one.number, one.loops, one.name};
  return 1;
}

int drives_set(drives* all, std::int32_t drive, std::uint16_t index, std::uint8_t sub,
               std::int64_t value) {
  return has(all, drive) && all->at(drive).set(index, sub, value);
}
std::int32_t drives_periods_per_target(const drives* all, std::int32_t drive) {
  return has(all, drive) ? all->at(drive).periods_per_target() : 1;
}

void drives_set_cycle(drives* all, std::int32_t drive, std::int64_t cycle) {
  if (has(all, drive) && cycle >= 0) all->at(drive).set_cycle(cycle);
}

void drives_lost(drives* all, std::int32_t drive, std::uint16_t error) {
  if (all) all->with(drive, [=](fieldbus::Drive& one) { one.lost(error); });
}
void drives_lock_mapping(drives* all, std::int32_t drive, int locked) {
  if (all) all->with(drive, [=](fieldbus::Drive& one) { one.lock_mapping(locked != 0); });
}
void drives_restart(drives* all, std::int32_t drive) {
  if (all) all->with(drive, [](fieldbus::Drive& one) { one.restart(); });
}

#pragma GCC visibility pop
