// The processor's own registers, 0xe0000000 to 0xe00fffff: NVIC, SysTick, system control, cycle
// counter.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <utility>

#include "clock.hpp"
#include "cpu.hpp"
#include "nvic.hpp"
#include "systick.hpp"

namespace mcu {

class SystemControl {
 public:
  static constexpr uint32_t AT = 0xe0000000, SIZE = 0x100000;

  // `instant` gives the time of the instruction that accesses a register now, or is looked at.
  SystemControl(Nvic& nvic, SysTick& systick, std::function<Time(uint32_t, bool)> instant,
                uint32_t vectors)
      : vectors(vectors), nvic_(nvic), systick_(systick), instant_(std::move(instant)) {
    words_[FPCCR] = 0xc0000000;  // registers of the FPU are kept
  }

  uint32_t vectors;            // VTOR
  bool sleep_on_exit = false;  // SCR
  bool reset_asked = false;    // AIRCR
  uint32_t active = 0;         // exception number of the handler that runs

  uint32_t read(uint32_t at, unsigned size, bool look = false) {
    const uint32_t value = read_word(at & ~3u, look);
    return size == 4 ? value : value >> 8 * (at & 3) & (size == 1 ? 0xff : 0xffff);
  }

  void write(uint32_t at, unsigned size, uint32_t value) {
    const uint32_t word_at = at & ~3u;
    if (size < 4) {
      const unsigned shift = 8 * (at & 3);
      const uint32_t mask = (size == 1 ? 0xffu : 0xffffu) << shift;
      value = value << shift & mask;
      // Registers of which only the ones count keep the rest by zeros.
      const bool by_ones =
          (word_at >= 0xe000e100 && word_at < 0xe000e300) || word_at == CFSR || word_at == HFSR;
      if (!by_ones) value |= read_word(word_at, true) & ~mask;
    }
    write_word(word_at, value);
  }

  // As after a reset; the cycle counter goes on.
  void begin_again(uint32_t table) {
    vectors = table;
    sleep_on_exit = reset_asked = false;
    active = prigroup_ = sleep_control_ = 0;
    words_ = {{FPCCR, 0xc0000000}};
  }

  void visit_state(Checkpoint& list) {
    list(vectors, sleep_on_exit, reset_asked, active, prigroup_, sleep_control_, cycles_from_);
    list(words_);
  }

  // Whether firmware has a handler of its own for a kind of faults switched on.
  bool has_handler(int exception) const {
    if (exception == Nvic::HARD_FAULT) return true;
    const auto entry = words_.find(SHCSR);
    return entry != words_.end() && entry->second >> (exception - Nvic::MEMORY_FAULT + 16) & 1;
  }
  static int find_handler(Fault::Kind kind) {
    using Kind = Fault::Kind;
    switch (kind) {
      case Kind::bus:
      case Kind::bus_fetch:
        return Nvic::BUS_FAULT;
      case Kind::memory_fetch:
        return Nvic::MEMORY_FAULT;
      case Kind::breakpoint:
      case Kind::escalated:
        return Nvic::HARD_FAULT;
      default:
        return Nvic::USAGE_FAULT;
    }
  }
  // Set the status registers to the fault (ARMv7-M, B3.2.15).
  void record(const Fault& fault) {
    using Kind = Fault::Kind;
    switch (fault.kind) {
      case Kind::memory_fetch:
        words_[CFSR] |= 1u << 0;
        break;
      case Kind::bus_fetch:
        words_[CFSR] |= 1u << 8;
        break;
      case Kind::bus:
        words_[CFSR] |= 1u << 9;
        if (fault.has_address) words_[CFSR] |= 1u << 15, words_[BFAR] = fault.address;
        break;
      case Kind::undefined:
        words_[CFSR] |= 1u << 16;
        break;
      case Kind::state:
        words_[CFSR] |= 1u << 17;
        break;
      case Kind::coprocessor:
        words_[CFSR] |= 1u << 19;
        break;
      case Kind::unaligned:
        words_[CFSR] |= 1u << 24;
        break;
      case Kind::breakpoint:
        words_[HFSR] |= 1u << 31;
        break;
      case Kind::escalated:
        set_forced_fault();
        break;
      case Kind::none:
        break;
    }
  }
  // Another handler is not switched on, or may not enter now.
  void set_forced_fault() { words_[HFSR] |= 1u << 30; }

 private:
  static constexpr uint32_t SHCSR = 0xe000ed24, CFSR = 0xe000ed28, HFSR = 0xe000ed2c,
                            BFAR = 0xe000ed38, FPCCR = 0xe000ef34;

  template <class Bit>
  uint32_t gather(uint32_t first, Bit bit) const {
    uint32_t value = 0;
    for (uint32_t k = 0; k < 32; ++k)
      if (const int n = exception(first + k); n && bit(n)) value |= 1u << k;
    return value;
  }
  template <class Do>
  void for_each_bit(uint32_t first, uint32_t value, Do todo) {
    for (uint32_t k = 0; k < 32; ++k)
      if (const int n = exception(first + k); n && (value >> k & 1)) todo(n);
  }
  int exception(uint32_t interrupt) const {
    const int n = static_cast<int>(Nvic::EXTERNAL + interrupt);
    return n < nvic_.exceptions() ? n : 0;
  }
  uint32_t read_priorities(int first) const {
    uint32_t value = 0;
    for (int k = 0; k < 4; ++k)
      if (first + k < nvic_.exceptions()) value |= nvic_.priority(first + k) << 8 * k;
    return value;
  }

  uint32_t read_word(uint32_t at, bool look) {
    const uint32_t bank = (at & 0x1f) * 8;
    switch (at & ~0x1fu) {
      case 0xe000e100:
      case 0xe000e180:
        return gather(bank, [&](int n) { return nvic_.is_enabled(n); });
      case 0xe000e200:
      case 0xe000e280:
        return gather(bank, [&](int n) { return nvic_.is_pending(n); });
      case 0xe000e300:
        return gather(bank, [&](int n) { return nvic_.is_active(n); });
    }
    if (at >= 0xe000e400 && at < 0xe000e4f0)
      return read_priorities(static_cast<int>(Nvic::EXTERNAL + at - 0xe000e400));
    switch (at) {
      case 0xe000e004:
        return static_cast<uint32_t>((nvic_.exceptions() - 17) / 32);
      case 0xe000e010:
        return systick_.control(look);
      case 0xe000e014:
        return systick_.load();
      case 0xe000e018:
        return systick_.value(instant_(at, look));
      case 0xe000ed00:
        return 0x410fc241;  // Cortex-M4 r0p1
      case 0xe000ed04:
        return interrupt_state();
      case 0xe000ed08:
        return vectors;
      case 0xe000ed0c:
        return 0xfa050000 | prigroup_ << 8;
      case 0xe000ed10:
        return sleep_control_;
      case 0xe000ed18:
      case 0xe000ed1c:
      case 0xe000ed20:
        return read_priorities(static_cast<int>(4 + at - 0xe000ed18));
      case 0xe0001004:
        return static_cast<uint32_t>(instant_(at, look) / CYCLE - cycles_from_);  // DWT CYCCNT
    }
    const auto entry = words_.find(at);
    return entry == words_.end() ? 0 : entry->second;
  }

  void write_word(uint32_t at, uint32_t value) {
    const uint32_t bank = (at & 0x1f) * 8;
    switch (at & ~0x1fu) {
      case 0xe000e100:
        return for_each_bit(bank, value, [&](int n) { nvic_.enable(n, true); });
      case 0xe000e180:
        return for_each_bit(bank, value, [&](int n) { nvic_.enable(n, false); });
      case 0xe000e200:
        return for_each_bit(bank, value, [&](int n) { nvic_.set_pending(n); });
      case 0xe000e280:
        return for_each_bit(bank, value, [&](int n) { nvic_.set_pending(n, false); });
      case 0xe000e300:
        return;
    }
    if (at >= 0xe000e400 && at < 0xe000e4f0)
      return set_priorities(static_cast<int>(Nvic::EXTERNAL + at - 0xe000e400), value);
    switch (at) {
      case 0xe000e010:
        return systick_.set_control(value, instant_(at, false));
      case 0xe000e014:
        return systick_.set_load(value);
      case 0xe000e018:
        return systick_.clear_value(instant_(at, false));
      case 0xe000ed00:
        return;
      case 0xe000ed04:
        return set_interrupt_state(value);
      case 0xe000ed08:
        vectors = value & ~0x7fu;
        return;
      case 0xe000ed0c:
        if (value >> 16 != 0x05fa) return;
        prigroup_ = value >> 8 & 7;
        nvic_.set_group(prigroup_);
        if (value & 4) reset_asked = true;
        return;
      case 0xe000ed10:
        sleep_control_ = value & 0x16;
        sleep_on_exit = value & 2;
        return;
      case 0xe000ed18:
      case 0xe000ed1c:
      case 0xe000ed20:
        return set_priorities(static_cast<int>(4 + at - 0xe000ed18), value);
      case CFSR:
      case HFSR:
        words_[at] &= ~value;
        return;
      case 0xe000ef00:
        if (const int n = exception(value & 0x1ff)) nvic_.set_pending(n);  // STIR
        return;
      case 0xe0001004:
        cycles_from_ = instant_(at, false) / CYCLE - value;
        return;
    }
    words_[at] = value;
  }

  void set_priorities(int first, uint32_t value) {
    for (int k = 0; k < 4; ++k)
      if (first + k >= Nvic::SVCALL || first + k <= Nvic::USAGE_FAULT)
        nvic_.set_priority(first + k, value >> 8 * k & 0xff);
  }

  uint32_t interrupt_state() const {  // ICSR
    const int first = nvic_.first();
    uint32_t value = active | static_cast<uint32_t>(first) << 12;
    if (first >= Nvic::EXTERNAL) value |= 1u << 22;
    if (nvic_.is_pending(Nvic::SYSTICK)) value |= 1u << 26;
    if (nvic_.is_pending(Nvic::PENDSV)) value |= 1u << 28;
    return value;
  }
  void set_interrupt_state(uint32_t value) {
    if (value & 1u << 25) nvic_.set_pending(Nvic::SYSTICK, false);
    if (value & 1u << 26) nvic_.set_pending(Nvic::SYSTICK);
    if (value & 1u << 27) nvic_.set_pending(Nvic::PENDSV, false);
    if (value & 1u << 28) nvic_.set_pending(Nvic::PENDSV);
    if (value & 1u << 31) nvic_.set_pending(Nvic::NMI);
  }

  Nvic& nvic_;
  SysTick& systick_;
  std::function<Time(uint32_t, bool)> instant_;
  uint32_t prigroup_ = 0, sleep_control_ = 0;
  Time cycles_from_ = 0;
  std::map<uint32_t, uint32_t> words_;
};

}  // namespace mcu
