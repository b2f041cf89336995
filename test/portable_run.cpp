// A client of a fleet's library: FILE of commands, as test_other_processors.py writes it, and
// perhaps that of a saved fleet, from which both go on. It prints the links of a single arm and of
// a fleet's arms after each row of commands, as bits.
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <vector>

#include "arm_fleet.h"

namespace {

void print(const std::vector<double>& numbers) {
  for (double number : numbers) {
    std::uint64_t bits;
    number += 0.0;  // the sign of zero is of no importance
    std::memcpy(&bits, &number, sizeof bits);
    std::printf(" %016" PRIx64, bits);
  }
}

template <class Number>
bool read(std::FILE* file, std::vector<Number>& numbers) {
  return std::fread(numbers.data(), sizeof(Number), numbers.size(), file) == numbers.size();
}

}  // namespace

int main(int count, char** words) {
  std::FILE* file = count >= 2 ? std::fopen(words[1], "rb") : nullptr;
  std::vector<double> sizes(7);
  if (!file || !read(file, sizes)) return 2;
  const auto whole = [&](int k) { return static_cast<std::size_t>(sizes[k]); };
  const std::size_t joints = whole(0), arms = whole(1), rows = whole(2), steps = whole(3);
  std::vector<double> parameters(arms * whole(6)), start(arms * joints), none(arms * joints);
  std::vector<double> commands(arms * joints), q(arms * joints), v(arms * joints);
  if (!read(file, parameters) || !read(file, start)) return 2;
  const arm_options options = {sizeof options, -1, sizes[4], static_cast<std::int64_t>(sizes[5]),
                               parameters.data()};
  arm_machine* arm = arm_new(&options);
  arm_fleet* fleet = arm_fleet_new(&options, static_cast<std::int32_t>(arms));
  if (!arm || !fleet) return 3;
  arm_reset(arm, start.data(), none.data());
  arm_fleet_reset(fleet, nullptr, start.data(), none.data());
  if (count == 3) {
    const std::int64_t size = arm_saved_size(), all = size * static_cast<std::int64_t>(arms);
    std::vector<char> saved(static_cast<std::size_t>(all));
    std::FILE* state = std::fopen(words[2], "rb");
    if (!state || !read(state, saved)) return 2;
    if (arm_restore(arm, saved.data(), size) != ARM_OK ||
        arm_fleet_restore(fleet, nullptr, saved.data(), all) != ARM_OK)
      return 6;
  }
  std::vector<double> own_q(joints), own_v(joints);
  for (std::size_t row = 0; row < rows; ++row) {
    if (!read(file, commands)) return 4;
    arm_advance(arm, commands.data(), static_cast<std::int64_t>(steps));
    arm_fleet_run(fleet, 0, static_cast<std::int32_t>(arms), commands.data(), 1,
                  static_cast<std::int64_t>(steps), q.data());
    arm_truth truth = {};
    truth.size = sizeof truth, truth.q = own_q.data(), truth.v = own_v.data();
    arm_fleet_truth all = {};
    all.size = sizeof all, all.q = q.data(), all.v = v.data();
    if (arm_get_truth(arm, &truth) != ARM_OK || arm_fleet_get_truth(fleet, &all) != ARM_OK)
      return 5;
    for (const auto* one : {&own_q, &own_v, &q, &v}) print(*one);
    std::printf("\n");
  }
}
