// The microcontroller in the loop: in each servo period measurements go into registers, the
// firmware runs for that time, and compare registers become voltages.
#pragma once

#include <cstdio>
#include <cstring>
#include <memory>
#include <vector>

#include "clock.hpp"
#include "cpu.hpp"
#include "devices.hpp"
#include "exceptions.hpp"
#include "gdb_server.hpp"
#include "memory.hpp"
#include "nvic.hpp"
#include "runner.h"
#include "system_control.hpp"
#include "systick.hpp"

namespace mcu {

class Runner : public Bus {
 public:
  explicit Runner(const mcu_board& board)
      : board_(board),
        cpu_(memory_, *this, board.cycles_per_instruction, board.cycles_per_branch),
        nvic_(board.interrupts, board.priority_bits),
        systick_(nvic_),
        system_(
            nvic_, systick_,
            [this](uint32_t at, bool look) {
              return look ? cpu_.time_of_instruction() : cpu_.time_of_instruction(at);
            },
            board.vectors),
        devices_(board_, nvic_, cpu_.now) {
    for (int k = 0; k < board.regions; ++k) {
      const mcu_region& one = board.region[k];
      if (one.kind != MCU_REGISTERS)
        memory_.add(one.at, one.size, one.kind != MCU_FLASH, one.kind != MCU_RAM);
    }
    devices_.connect_devices();
  }

  // Return null, or the reason for a failure.
  const char* open() {
    if (!cpu_.is_open()) return "Unicorn does not give a Cortex-M";
    if (!cpu_.map_memory()) return "flash and RAM cannot be mapped";
    for (int k = 0; k < board_.regions; ++k)
      if (const mcu_region& one = board_.region[k]; one.kind == MCU_REGISTERS)
        if (!cpu_.map_bus(one.at, one.size)) return "registers cannot be mapped";
    if (!cpu_.map_bus(SystemControl::AT, SystemControl::SIZE)) return "registers cannot be mapped";
    return nullptr;
  }

  bool load(uint32_t at, const void* bytes, uint64_t size) {
    return memory_.write(at, bytes, size);
  }

  void attach_debugger(int socket) {
    debugger_ = std::make_unique<GdbServer<Runner>>(*this, socket);
  }

  void step(const firmware_input& in, firmware_output& out) {
    if (stopped) return;
    in_ = &in;
    if (!begun_) {
      begun_ = true;
      devices_.measure(in, false);
      reset();
      boot_ = count_cycles(board_.boot);
      run_until(boot_);
      if (stopped) return;
    }
    if (board_.preload) devices_.command(out);
    devices_.measure(in, true);
    run_until(boot_ + count_cycles(static_cast<double>(in.time + board_.period) * 1e-9));
    if (!board_.preload) devices_.command(out);
  }

  uint32_t read(uint32_t at, unsigned size) override {
    if (at >= SystemControl::AT) return system_.read(at, size);
    const uint32_t value = devices_.registers.read(at, size);
    if (devices_.registers.has_special_access()) update_deadline();
    return value;
  }
  void write(uint32_t at, unsigned size, uint32_t value) override {
    if (at >= SystemControl::AT) {
      system_.write(at, size, value);
      return cpu_.stop_soon();
    }
    devices_.registers.write(at, size, value);
    if (devices_.registers.has_special_access()) update_deadline();
  }

  // Reason for which no checkpoint can be made; null: it can.
  const char* unkept() const {
    if (debugger_) return "a debugger";
    return devices_.is_wired() ? "a serial line that leads out of the process" : nullptr;
  }
  // Return all that decides how it goes on, for `restore` of this runner; valid up to the next one.
  const std::vector<uint8_t>& save() {
    saved_.clear();
    visit_state(Checkpoint(saved_));
    return saved_;
  }
  void restore(const uint8_t* saved) { visit_state(Checkpoint(saved)); }

  // Registers as read and written by a debugger: 0 to 15, 16 xPSR, from 17 on S0 to S31, 49 FPSCR,
  // 50 MSP, 51 PSP, 52 PRIMASK, 53 BASEPRI, 54 FAULTMASK, 55 CONTROL.
  uint32_t get_register(int number) {
    if (number == 15) return cpu_.pc;
    if (number == 16) return cpu_.get(UC_ARM_REG_XPSR);
    return cpu_.get(register_of(number));
  }
  void set_register(int number, uint32_t value) {
    if (number == 15)
      cpu_.jump(value & ~1u);
    else if (number == 16)
      cpu_.set_flags(value);
    else
      cpu_.set(register_of(number), value);
    if (number >= 50) cpu_.handle_mask_change();
  }
  // Read a byte without side effects; false: no memory there.
  bool look(uint32_t at, uint8_t* out) {
    if (memory_.read(at, out, 1)) return true;
    if (at - SystemControl::AT < SystemControl::SIZE)
      *out = static_cast<uint8_t>(system_.read(at, 1, true));
    else if (devices_.registers.has(at & ~3u))
      *out = static_cast<uint8_t>(devices_.registers.read(at, 1, true));
    else
      return false;
    return true;
  }
  bool write_memory(uint32_t at, const uint8_t* bytes, uint32_t size) {
    if (memory_.write(at, bytes, size)) {
      cpu_.forget(at, size);
      return true;
    }
    uint32_t value = 0;
    if ((size != 1 && size != 2 && size != 4) || at % size) return false;
    std::memcpy(&value, bytes, size);
    if (at < SystemControl::AT && !devices_.registers.has(at & ~3u)) return false;
    write(at, size, value);
    return true;
  }
  void set_stops(std::vector<uint32_t> stops) { cpu_.stops = std::move(stops); }

  mcu_fault fault{};
  mcu_figures figures{};
  int32_t stopped = 0;
  int32_t* breaks = nullptr;  // not 0: the machine is at a breakpoint of its own

 private:
  using Kind = Fault::Kind;
  static constexpr uint64_t LONGEST_AWAKE = 200'000'000;  // instructions, where they take no time

  static int register_of(int number) {
    static constexpr int NAMES[] = {UC_ARM_REG_R0,  UC_ARM_REG_R1, UC_ARM_REG_R2,  UC_ARM_REG_R3,
                                    UC_ARM_REG_R4,  UC_ARM_REG_R5, UC_ARM_REG_R6,  UC_ARM_REG_R7,
                                    UC_ARM_REG_R8,  UC_ARM_REG_R9, UC_ARM_REG_R10, UC_ARM_REG_R11,
                                    UC_ARM_REG_R12, UC_ARM_REG_SP, UC_ARM_REG_LR};
    if (number < 15) return NAMES[number];
    if (number < 49) return UC_ARM_REG_S0 + (number - 17);
    static constexpr int SYSTEM[] = {UC_ARM_REG_FPSCR,   UC_ARM_REG_MSP,     UC_ARM_REG_PSP,
                                     UC_ARM_REG_PRIMASK, UC_ARM_REG_BASEPRI, UC_ARM_REG_FAULTMASK,
                                     UC_ARM_REG_CONTROL};
    return SYSTEM[number - 49];
  }

  void visit_state(Checkpoint list) {
    cpu_.visit_state(list, memory_.visit_state(list));
    nvic_.visit_state(list);
    systick_.visit_state(list);
    system_.visit_state(list);
    devices_.visit_state(list);
    list(fault, figures, stopped, first_fault_, first_fault_pc_, locked_up_, awake_from_, boot_);
    list(deadline_, begun_, asleep_, event_, near_);
  }

  Time count_cycles(double seconds) const {
    return static_cast<Time>(seconds * board_.clock + 0.5) * CYCLE;
  }

  void reset() {
    uint32_t table[2] = {};
    if (!memory_.read(board_.vectors, table, 8))
      return end("a vector table outside of memory", board_.vectors);
    if (!(table[1] & 1)) return end("a reset vector that is no Thumb address", table[1]);
    cpu_.reset(table[0], table[1]);
  }

  // Firmware's access to a device may raise an interrupt, or one sooner than planned.
  void update_deadline() {
    devices_.set_lines();
    if (nvic_.take_change() || next_event() < deadline_) cpu_.stop_soon();
  }

  Time next_event() const { return std::min(systick_.next(), devices_.next()); }

  void run_until(Time limit) {
    while (!stopped) {
      if (!cpu_.inside()) {
        const Time now = cpu_.now;
        systick_.advance(now);
        devices_.advance(now);
        if (now >= limit) break;
        if (!take_exception()) return;
        if (asleep_) {
          if (!serve_debugger(false)) return;
          sleep(std::min(limit, next_event()));
          continue;
        }
      }
      if (!serve_debugger(cpu_.is_stop_here()) || !advance(std::min(limit, next_event()))) return;
    }
    figures.instructions = cpu_.instructions;
    figures.cycles = static_cast<uint64_t>(cpu_.now / CYCLE);
  }

  // Let a debugger act; false: it has ended the run.
  bool serve_debugger(bool at_stop) {
    if (debugger_ && breaks && *breaks) {
      *breaks = 0;
      debugger_->halt_here();
    }
    if (debugger_ && !debugger_->serve_debugger(at_stop)) stopped = 1;
    return !stopped;
  }

  void sleep(Time until) {
    figures.asleep += static_cast<uint64_t>((until - cpu_.now) / CYCLE);
    cpu_.now = until;
    awake_from_ = cpu_.instructions;
  }

  // Enter the pending exception of highest priority, if permitted; false: the run has ended.
  bool take_exception() {
    cpu_.masked_wait = false;
    nvic_.take_change();
    const int first = nvic_.first();
    if (!first) return true;
    const Masks masks = cpu_.masks();
    if (asleep_ && nvic_.can_wake_processor(first, masks)) asleep_ = false;
    if (nvic_.may_enter(first, masks)) return enter(first);
    cpu_.wait_for_masks(masks);
    return true;
  }

  bool enter(int exception) {
    if (!mcu::enter(cpu_, memory_, exception, system_.vectors)) return handle_failure();
    nvic_.enter(exception);
    system_.active = static_cast<uint32_t>(exception);
    event_ = true;
    asleep_ = false;
    ++figures.exceptions;
    return true;
  }

  // Run for a while; false: the run has ended.
  bool advance(Time deadline) {
    deadline_ = deadline;
    if (board_.cycles_per_instruction + board_.cycles_per_branch == 0)
      cpu_.awake_until = awake_from_ + LONGEST_AWAKE;
    const bool steps = debugger_ && (debugger_->steps() || cpu_.inside() || near_);
    const Cpu::Stop stop = steps ? cpu_.step() : cpu_.run(deadline);
    near_ = !steps && stop == Cpu::Stop::between && cpu_.stop_near();
    if (debugger_ && !near_) debugger_->report_run();
    if (system_.reset_asked) return restart();  // whatever came behind it in its line
    switch (stop) {
      case Cpu::Stop::call:
        return call();
      case Cpu::Stop::returned:
        return leave();
      case Cpu::Stop::fault:
        return handle_fault();
      case Cpu::Stop::sleep:
        asleep_ = true;
        break;
      case Cpu::Stop::event:
        asleep_ = !std::exchange(event_, false);
        break;
      default:
        break;
    }
    if (system_.active == Nvic::HARD_FAULT && stop == Cpu::Stop::between &&
        is_self_branch(cpu_.pc)) {
      cpu_.fault = first_fault_;
      cpu_.pc = first_fault_pc_;
      return handle_failure();
    }
    if (cpu_.instructions >= cpu_.awake_until) {
      cpu_.fail("200 million instructions without sleep, and they take no time");
      return handle_failure();
    }
    return true;
  }

  bool call() {
    nvic_.set_pending(Nvic::SVCALL);
    if (nvic_.may_enter(Nvic::SVCALL, cpu_.masks())) return true;
    nvic_.set_pending(Nvic::SVCALL, false);
    cpu_.pc -= 2;  // of a fault it is the instruction that made it
    cpu_.fail(Kind::escalated, "hard fault: a supervisor call where its priority is masked");
    return handle_fault();
  }

  // Restart like the reset pin: memory keeps its contents, and time continues.
  bool restart() {
    nvic_ = Nvic(board_.interrupts, board_.priority_bits);
    std::destroy_at(&systick_);
    std::construct_at(&systick_, nvic_);
    system_.begin_again(board_.vectors);
    devices_.connect_devices();
    devices_.measure(*in_, false);
    asleep_ = event_ = false;
    ++figures.resets;
    reset();
    return !stopped;
  }

  // Continue in the handler of the fault; false: no handler, the run has ended.
  bool handle_fault() {
    const Fault fault = cpu_.fault;
    if (fault.kind == Kind::none || is_debugger_halting(fault)) return handle_failure();
    system_.record(fault);
    const Masks masks = cpu_.masks();
    int handler = SystemControl::find_handler(fault.kind);
    if (!system_.has_handler(handler) || !nvic_.may_enter(handler, masks)) {
      if (handler != Nvic::HARD_FAULT) system_.set_forced_fault();
      handler = Nvic::HARD_FAULT;
    }
    if (!nvic_.may_enter(handler, masks)) {
      locked_up_ = true;
      return handle_failure();
    }
    uint32_t vector = 0;
    const bool is_there =
        memory_.read(system_.vectors + 4 * static_cast<uint32_t>(handler), &vector, 4);
    if (!is_there || !(vector & 1) || is_self_branch(vector & ~1u)) return handle_failure();
    if (!figures.faults) put_fault(fault.what, fault.address, fault.has_address);
    if (!figures.faults++ || system_.active != Nvic::HARD_FAULT)
      first_fault_ = fault, first_fault_pc_ = cpu_.pc;
    return enter(handler);
  }
  // A debugger, if connected, handles breakpoint instructions.
  bool is_debugger_halting(const Fault& fault) const {
    return debugger_ && fault.kind == Kind::breakpoint;
  }
  // Whether the code is a branch to itself.
  bool is_self_branch(uint32_t at) const {
    uint16_t code = 0;
    return memory_.read(at, &code, 2) && code == 0xe7fe;
  }

  bool leave() {
    const int exception = static_cast<int>(system_.active);
    if (!nvic_.is_active(exception)) {
      cpu_.fail("an exception return outside of handlers");
      return handle_failure();
    }
    if (!mcu::leave(cpu_, memory_, cpu_.pc)) return handle_failure();
    nvic_.leave(exception);
    if (exception != Nvic::NMI) cpu_.set(UC_ARM_REG_FAULTMASK, 0);
    system_.active = cpu_.get(UC_ARM_REG_XPSR) & 0x1ff;
    event_ = true;
    if (system_.sleep_on_exit && !system_.active) asleep_ = true;
    return true;
  }

  bool handle_failure() {
    end(cpu_.fault.what ? cpu_.fault.what : "no reason", cpu_.fault.address,
        cpu_.fault.has_address);
    if (debugger_) debugger_->report_end();
    return false;
  }

  void end(const char* what, uint32_t address, bool has_address = true) {
    put_fault(what, address, has_address);
    stopped = 1;
  }
  void put_fault(const char* what, uint32_t address, bool has_address) {
    char at[24] = "", of[120] = "";
    if (has_address) std::snprintf(at, sizeof at, " (0x%08x)", address);
    if (locked_up_ && first_fault_.what)
      std::snprintf(of, sizeof of, "lock-up in the handler of %s at pc 0x%08x: ", first_fault_.what,
                    first_fault_pc_);
    std::snprintf(fault.what, sizeof fault.what, "%s%s%s", of, what, at);
    fault.pc = cpu_.pc;
    fault.address = address;
    fault.time = static_cast<double>(cpu_.now) / CYCLE / board_.clock;
  }

  mcu_board board_;
  Memory memory_;
  Cpu cpu_;
  Nvic nvic_;
  SysTick systick_;
  SystemControl system_;
  Devices devices_;
  std::unique_ptr<GdbServer<Runner>> debugger_;
  std::vector<uint8_t> saved_;
  const firmware_input* in_ = nullptr;  // of the step that is under way
  Fault first_fault_;
  uint32_t first_fault_pc_ = 0;
  bool locked_up_ = false;
  uint64_t awake_from_ = 0;  // instructions
  Time boot_ = 0, deadline_ = 0;
  bool begun_ = false, asleep_ = false, event_ = false, near_ = false;
};

}  // namespace mcu
