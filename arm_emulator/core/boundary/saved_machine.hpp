// The functions of arm.h that save a machine and restore it, to the last bit.
#pragma once

#include "boundary/arm_machine.hpp"

#pragma GCC visibility push(default)

namespace {

constexpr std::int64_t kWord = 8;

// Reader or writer of the words of a saved machine. They end with a checksum, which detects
// damaged bytes.
struct Words {
  unsigned char* at;
  std::uint64_t sum = 0xcbf29ce484222325;

  template <class Number>
  void write(const Number& number) {
    static_assert(sizeof number == kWord);
    __builtin_memcpy(at, &number, kWord);
    advance();
  }
  template <class Number>
  void read(Number& number) {
    static_assert(sizeof number == kWord);
    __builtin_memcpy(&number, at, kWord);
    advance();
  }
  ARM_ONCE void advance() {
    std::uint64_t word;
    __builtin_memcpy(&word, at, kWord);
    sum = (sum ^ word) * 0x100000001b3;  // FNV-1a: a change of any one word changes the sum
    sum ^= sum >> 32;
    at += kWord;
  }
};

}  // namespace

namespace {

std::int64_t count_saved_bytes(arm_machine& machine) {
  arm_machine::Machine::FullState make_full_state = {};
  arm_machine::Values values = {};
  std::int64_t words = 2;  // the fingerprint, the sum
  arm_machine::for_each_saved_number(machine, make_full_state, values,
                                     [&](const auto&) { ++words; });
  return words * kWord;
}

void write_saved(const arm_machine* machine, void* out) {
  Words words = {static_cast<unsigned char*>(out)};
  words.write(std::uint64_t{ARM_FINGERPRINT});
  auto make_full_state = machine->machine.make_full_state();
  arm_machine::Values values = {};
  for (int k = 0; k < arm::kOwnNumbers<Scene>; ++k) values[k] = machine->machine.parameter(k);
  arm_machine::for_each_saved_number(const_cast<arm_machine&>(*machine), make_full_state, values,
                                     [&](const auto& number) { words.write(number); });
  words.write(std::uint64_t{words.sum});
}

// ARM_OK if a machine can go on from saved bytes.
int check_saved(const arm_machine* machine, const void* saved, std::int64_t size) {
  const auto* begin = static_cast<const unsigned char*>(saved);
  Words words = {const_cast<unsigned char*>(begin)};
  std::uint64_t fingerprint = 0, sum = 0;
  double step = 0.0;
  std::int64_t steps_per_period = 0;
  words.read(fingerprint);
  words.read(step);
  words.read(steps_per_period);
  if (fingerprint != ARM_FINGERPRINT)
    return machine->refuse(-1, "saved machine", "be of this library", 0.0);
  if (step != machine->step)
    return machine->refuse(-1, "saved machine", "have this step [s]", step);
  if (steps_per_period != machine->steps_per_period)
    return machine->refuse(-1, "saved machine", "have as many steps per period",
                           static_cast<double>(steps_per_period));
  while (words.at != begin + size - kWord) words.advance();
  const std::uint64_t expected = words.sum;
  words.read(sum);
  return sum == expected ? ARM_OK : machine->refuse(-1, "saved machine", "be as it was saved", 0.0);
}

void restore_saved(arm_machine* machine, const void* saved) {
  Words words = {const_cast<unsigned char*>(static_cast<const unsigned char*>(saved)) + kWord};
  arm_machine::Machine::FullState make_full_state = {};
  arm_machine::Values values = {};
  arm_machine::for_each_saved_number(*machine, make_full_state, values,
                                     [&](auto& number) { words.read(number); });
  for (int k = 0; k < arm::kOwnNumbers<Scene>; ++k) machine->machine.set_parameter(k, values[k]);
  if constexpr (Scene::external_wrench)
    for (int link = 0; link < Scene::L; ++link)
      machine->set_external_wrench(link, machine->wrenches[link]);
  machine->machine.restore(make_full_state);
}

}  // namespace

#ifndef __CUDA__  // functions of a card have no static variables
ARM_ONCE std::int64_t arm_saved_size(void) {
  static const std::int64_t size = [] {
    const arm::SomeValues<Scene> some;
    arm_machine none({sizeof(arm_options), -1, 1.0, 1, some.p});
    return count_saved_bytes(none);
  }();
  return size;
}

ARM_ONCE int arm_save(const arm_machine* machine, void* out, std::int64_t size) {
  if (!machine || machine->check_pointer(out, "out")) return ARM_REFUSED;
  if (size != arm_saved_size())
    return machine->refuse(-1, "size", "be arm_saved_size()", static_cast<double>(size));
  write_saved(machine, out);
  return ARM_OK;
}

ARM_ONCE int arm_restore(arm_machine* machine, const void* saved, std::int64_t size) {
  if (!machine || machine->check_pointer(saved, "saved machine")) return ARM_REFUSED;
  if (size != arm_saved_size())
    return machine->refuse(-1, "size", "be arm_saved_size()", static_cast<double>(size));
  if (check_saved(machine, saved, size)) return ARM_REFUSED;
  restore_saved(machine, saved);
  return ARM_OK;
}
#endif

#pragma GCC visibility pop
