// The modes of operation that drives have. A new one is a file beside this one, and its name here.
#pragma once

#include <variant>

#include "cyclic_position.hpp"
#include "cyclic_torque.hpp"
#include "cyclic_velocity.hpp"
#include "homing_mode.hpp"
#include "profile_position.hpp"
#include "profile_torque.hpp"
#include "profile_velocity.hpp"

namespace fieldbus {

// One of them is chosen.
class Modes {
  template <class... All>
  struct Table {
    using Chosen = std::variant<All...>;
    static constexpr AboutMode about[] = {All::about...};
    static void choose(std::int64_t number, Chosen& chosen) {
      chosen.template emplace<0>();
      ((All::about.number == number ? void(chosen.template emplace<All>()) : void()), ...);
    }
  };
  using All = Table<NoMode, ProfilePosition, ProfileVelocity, ProfileTorque, HomingMode,
                    CyclicPosition, CyclicVelocity, CyclicTorque>;

 public:
  // All of them, behind the absence of one.
  static constexpr std::span<const AboutMode> all() { return std::span(All::about).subspan(1); }
  static constexpr std::uint32_t supported() {  // 0x6502
    std::uint32_t bits = 0;
    for (const AboutMode& one : all()) bits |= std::uint32_t{1} << (one.number - 1);
    return bits;
  }

  void choose(std::int64_t number) { All::choose(number, chosen_); }
  const AboutMode& about() const { return All::about[chosen_.index()]; }
  Mode* operator->() {
    return std::visit([](Mode& one) { return &one; }, chosen_);
  }
  const Mode* operator->() const {
    return std::visit([](const Mode& one) { return &one; }, chosen_);
  }

 private:
  All::Chosen chosen_;
};

static_assert(kEntries[kSlot<0x6502, 0>].standard == Modes::supported(),
              "the dictionary begins with the modes of the table");

}  // namespace fieldbus
