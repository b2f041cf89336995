// The processor: a Cortex-M4F by Unicorn, which runs instructions; exceptions are ours
// (exceptions.hpp).
//
// One class: hooks, interrupts and memory share the state of the processor, hence the length.
#pragma once

#include <unicorn/unicorn.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <limits>
#include <map>
#include <memory>
#include <unordered_map>
#include <utility>
#include <vector>

#include "clock.hpp"
#include "fault.hpp"
#include "memory.hpp"
#include "nvic.hpp"
#include "remembered.hpp"
#include "thumb.hpp"

namespace mcu {

// Reads and writes of memory-mapped registers, by address.
class Bus {
 public:
  virtual ~Bus() = default;
  virtual uint32_t read(uint32_t at, unsigned size) = 0;
  virtual void write(uint32_t at, unsigned size, uint32_t value) = 0;
};

// Instructions run in blocks: up to a branch, or what else ends the straight line. Time goes on,
// and interrupts come, between blocks only; so do steps of a debugger through a block, which
// therefore change nothing.
class Cpu {
 public:
  enum class Stop {
    between,   // before a block, for whatever is due
    sleep,     // after WFI
    event,     // after WFE
    call,      // after SVC
    returned,  // at an exception's return
    stepped,   // within a block, by `step`
    fault
  };

  Time now = 0;
  uint64_t instructions = 0;
  static constexpr uint64_t FOREVER = std::numeric_limits<uint64_t>::max();
  uint64_t awake_until = FOREVER;  // instructions
  bool masked_wait = false;        // an exception waits for a mask register to let it in
  std::vector<uint32_t> stops;     // addresses where a debugger wants to stop, ascending
  uint32_t pc = 0;                 // of the next instruction, while it does not run
  Fault fault;

  Cpu(Memory& memory, Bus& bus, double cycles_per_instruction, double cycles_per_branch)
      : memory_(memory),
        bus_(bus),
        cost_(static_cast<Time>(cycles_per_instruction * CYCLE + 0.5)),
        branch_cost_(static_cast<Time>(cycles_per_branch * CYCLE + 0.5)) {
    open_ = uc_open(UC_ARCH_ARM, static_cast<uc_mode>(UC_MODE_THUMB | UC_MODE_MCLASS), &uc_) ==
            UC_ERR_OK;
    if (!open_) return;
    uc_ctl_set_cpu_model(uc_, UC_CPU_ARM_CORTEX_M4);
    uc_ctl_tlb_mode(uc_, UC_TLB_VIRTUAL);
    add_hook(UC_HOOK_TLB_FILL, reinterpret_cast<void*>(find_first_access));
    uc_ctl_exits_enable(uc_);  // no exit addresses: each would end blocks, too
    add_hook(UC_HOOK_BLOCK, reinterpret_cast<void*>(block_begins));
    add_hook(UC_HOOK_INTR, reinterpret_cast<void*>(handle_interrupt));
    add_hook(UC_HOOK_INSN_INVALID, reinterpret_cast<void*>(handle_invalid_instruction));
  }
  Cpu(const Cpu&) = delete;
  Cpu& operator=(const Cpu&) = delete;
  ~Cpu() {
    for (uc_context* one : {new_, saved_})
      if (one) uc_context_free(one);
    if (open_) uc_close(uc_);
  }

  bool is_open() const { return open_; }

  // Unicorn takes a long way for every write to a page that may have code, or a hook: RAM has
  // neither.
  bool map_memory() {
    std::vector<uint64_t> edges = {0};
    for (const Memory::Region& region : memory_.regions()) {
      const bool code = !region.writable || region.code;
      const uint32_t may =
          UC_PROT_READ | (region.writable ? UC_PROT_WRITE : 0) | (code ? UC_PROT_EXEC : 0);
      if (uc_mem_map_ptr(uc_, region.at, region.size, may, region.bytes.get()) != UC_ERR_OK)
        return false;
      if (code) continue;
      edges.push_back(region.at);
      edges.push_back(static_cast<uint64_t>(region.at) + region.size);
    }
    edges.push_back(1ull << 32);
    std::sort(edges.begin(), edges.end());
    for (size_t k = 0; k < edges.size(); k += 2)
      if (edges[k] < edges[k + 1])
        add_hook(UC_HOOK_MEM_INVALID, reinterpret_cast<void*>(handle_unmapped_access), edges[k],
                 edges[k + 1] - 1);
    return true;
  }
  bool map_bus(uint32_t at, uint32_t size) {
    windows_.push_back(std::make_unique<Window>(Window{this, at}));
    Window* window = windows_.back().get();
    return uc_mmio_map(uc_, at, size, read_bus, window, write_bus, window) == UC_ERR_OK;
  }

  // As after a reset, with stack pointer and program counter of the vector table.
  void reset(uint32_t sp, uint32_t start) {
    if (new_)
      uc_context_restore(uc_, new_);
    else if (uc_context_alloc(uc_, &new_) == UC_ERR_OK)
      uc_context_save(uc_, new_);
    set(UC_ARM_REG_SP, sp);
    masked_wait = false;
    pc = start & ~1u;
    inside_until_ = 0;
  }

  // When the instruction that runs now, and accesses a register `at`, began. `now` is the end of
  // its block. Where in it the instruction stands is known from the second time on that the block
  // asks; the first time it is looked for.
  Time time_of_instruction(uint32_t at) {
    if (!block_) return now;
    if (!exact_.count(block_->at)) {
      asks_ = {block_->at, block_->size};
      stop_soon();
      at_ = find_access(at);
    }
    return now - block_->cost + count_to(at_) * cost_;
  }
  // When the next instruction begins, for a debugger.
  Time time_of_instruction() const {
    return block_ ? now - block_->cost + count_to(pc) * cost_ : now;
  }

  // Run until something stops it; `deadline` lets it stop between blocks.
  Stop run(Time deadline) {
    // A block that may have to stop for something else than the time is looked at first.
    const bool by_time = stops.empty() && !masked_wait && awake_until == FOREVER;
    until_ = by_time ? deadline : ALWAYS;
    deadline_ = deadline;
    stepping_ = false;
    watch_closely();
    return start(0);
  }

  // Run one instruction (a whole IT block is one), within a block or at the beginning of one.
  Stop step() {
    // Code translated for a run does not stop within blocks.
    if (!stepping_) uc_ctl_flush_tb(uc_);
    if (!inside()) watch_closely();
    stepping_ = true;
    until_ = ALWAYS;
    const uint32_t before = pc;
    begun_ = inside();
    const Stop stop = start(1);
    if (stop != Stop::stepped || pc <= before || pc >= inside_until_) inside_until_ = 0;
    return stop;
  }

  // Between blocks, before the first reset or after it. `other_code`: memory has another than
  // before.
  void visit_state(Checkpoint& list, bool other_code) {
    list(now, instructions, awake_until, masked_wait, pc, fault, asks_, at_, until_, deadline_);
    list(waited_, stop_, inside_until_);
    std::map<uint32_t, uint32_t> watched;  // sizes of blocks
    for (const auto& [at, one] : exact_) watched[at] = one.size;
    list(watched);
    if (!list.reads()) uc_context_save(uc_, saved());
    list.bytes(saved(), uc_context_size(uc_));
    if (!list.reads()) return;
    set_watched(std::move(watched));
    uc_context_restore(uc_, saved_);
    refresh();
    block_ = nullptr;
    if (!other_code) return;
    uc_ctl_flush_tb(uc_);
    blocks_.fill({});
  }

  // Whether it stands within a block, where neither time nor interrupts come.
  bool inside() const { return inside_until_ != 0; }
  // Whether the block at which it stands has a stop.
  bool stop_near() const { return stop_near_; }
  bool is_stop_here() const { return std::binary_search(stops.begin(), stops.end(), pc); }

  // Continue at another address, as a debugger requests.
  void jump(uint32_t to) {
    pc = to;
    inside_until_ = 0;
  }
  // Discard the translation of code that a debugger has changed.
  void forget(uint32_t at, uint32_t size) {
    uc_ctl_remove_cache(uc_, static_cast<uint64_t>(at), static_cast<uint64_t>(at) + size);
    blocks_.fill({});
  }

  uint32_t get(int reg) const {
    uint32_t value = 0;
    uc_reg_read(uc_, reg, &value);
    return value;
  }
  void set(int reg, uint32_t value) { uc_reg_write(uc_, reg, &value); }
  Masks masks() const {
    return {get(UC_ARM_REG_PRIMASK), get(UC_ARM_REG_BASEPRI), get(UC_ARM_REG_FAULTMASK)};
  }

  // A debugger has changed what lets exceptions in, or which stack is used.
  void handle_mask_change() {
    refresh();
    masked_wait = false;
    stop_soon();
  }
  // Set N, Z, C, V and Q; what else xPSR holds is the processor's own.
  void set_flags(uint32_t xpsr) {
    set(UC_ARM_REG_XPSR_NZCVQG, (get(UC_ARM_REG_XPSR) & 0x07ffffffu) | (xpsr & 0xf8000000u));
  }

  // The translator updates its mode and FPU state only after this write.
  void refresh() { set(UC_ARM_REG_APSR_NZCV, get(UC_ARM_REG_XPSR) & 0xf0000000u); }

  bool fail(const char* what, uint32_t address, Fault::Kind kind = Fault::Kind::none) {
    fault = {what, address, true, kind};
    return false;
  }
  bool fail(Fault::Kind kind, const char* what) {
    fault = {what, 0, false, kind};
    return false;
  }
  bool fail(const char* what) { return fail(Fault::Kind::none, what); }

 private:
  static constexpr Time ALWAYS = std::numeric_limits<Time>::min();

  struct Window {
    Cpu* cpu;
    uint32_t at;
  };
  // Data of a block.
  struct Block {
    uint32_t at = 1, size = 0;
    uint32_t count = 0;
    Time cost = 0;
  };

  uc_hook add_hook(int kind, void* call, uint64_t from = 1, uint64_t to = 0) {
    uc_hook handle = 0;
    uc_hook_add(uc_, &handle, kind, call, this, from, to);
    return handle;
  }
  uc_context* saved() {
    if (!saved_) uc_context_alloc(uc_, &saved_);
    return saved_;
  }

  Stop start(size_t count) {
    stop_near_ = false;
    stop_ = Stop::fault;
    description_ = false;
    fault = {};
    const uint32_t from = pc;
    const uc_err error = uc_emu_start(uc_, from | 1, 0, 0, count);
    if (!description_) {
      pc = get(UC_ARM_REG_PC) & ~1u;
      if (error != UC_ERR_OK) {
        stop_ = Stop::fault;
        if (!fault.what) fault.what = uc_strerror(error);
      } else {
        stop_ = !count || is_wfi_at(from) ? Stop::sleep : Stop::stepped;
      }
    }
    if (stop_ != Stop::stepped) block_ = nullptr;
    return stop_;
  }

  // Whether an instruction is WFI.
  bool is_wfi_at(uint32_t at) const {
    uint16_t code[2] = {};
    if (!memory_.read(at, code, 2)) return false;
    memory_.read(at, code, 4);
    return thumb::is_wfi(code);
  }

  void report(Stop stop) {
    stop_ = stop;
    description_ = true;
    uc_emu_stop(uc_);
  }

  static void block_begins(uc_engine*, uint64_t address, uint32_t size, void* self) {
    static_cast<Cpu*>(self)->begin(static_cast<uint32_t>(address), size);
  }

  void begin(uint32_t at, uint32_t size) {
    if (now >= until_) [[unlikely]] {
      if (!may_begin(at, size)) return;
    }
    const Block& block = find_block(at, size);
    instructions += block.count;
    now += block.cost;
    block_ = &block;
    at_ = NOWHERE;
  }

  // Have Unicorn report each instruction of a block that has asked for the time.
  void watch_closely() {
    const auto [at, size] = std::exchange(asks_, {});
    if (size && exact_.size() < MAX_EXACT && !exact_.count(at)) watch(at, size);
  }
  void watch(uint32_t at, uint32_t size) {
    const uint64_t end = static_cast<uint64_t>(at) + size;
    void* call = reinterpret_cast<void*>(handle_instruction);
    exact_[at] = {size, add_hook(UC_HOOK_CODE, call, at, end - 1)};
    uc_ctl_remove_cache(uc_, static_cast<uint64_t>(at), end);
  }
  // Watch the blocks that were watched then, and no others: the first time a block asks for the
  // time it is looked for.
  void set_watched(std::map<uint32_t, uint32_t> then) {
    for (auto one = exact_.begin(); one != exact_.end();) {
      const auto [at, watched] = *one++;
      if (const auto found = then.find(at); found != then.end() && found->second == watched.size) {
        then.erase(found);
        continue;
      }
      uc_hook_del(uc_, watched.hook);
      uc_ctl_remove_cache(uc_, static_cast<uint64_t>(at), static_cast<uint64_t>(at) + watched.size);
      exact_.erase(at);
    }
    for (const auto& [at, size] : then) watch(at, size);
  }
  static void handle_instruction(uc_engine*, uint64_t address, uint32_t, void* self) {
    static_cast<Cpu*>(self)->at_ = static_cast<uint32_t>(address);
  }
  // Number of instructions of the block before an address.
  Time count_to(uint32_t at) const {
    Time count = 0;
    for_each_instruction([&](uint32_t one, const uint16_t*) {
      if (one >= at) return false;
      ++count;
      return true;
    });
    return count;
  }
  // The next instruction of the block, from the last one that accessed a register, that may access
  // this one: base and offset are right. The next of all, if none is.
  uint32_t find_access(uint32_t at) const {
    uint32_t found = 0, next = 0;
    for_each_instruction([&](uint32_t one, const uint16_t* code) {
      if (one <= at_ && at_ != NOWHERE) return true;
      if (!next) next = one;
      if (const auto [base, offset] = thumb::decode_access(code); base && get(base) + offset == at)
        found = one;
      return !found;
    });
    return found ? found : next ? next : at_;
  }
  // body(address, its halfwords) for the instructions of the block, while it returns true.
  template <class Body>
  void for_each_instruction(Body&& body) const {
    const uint8_t* code = memory_.find(block_->at, block_->size);
    for (uint32_t k = 0; code && k + 1 < block_->size; k += thumb::length(code + k)) {
      uint16_t halves[2] = {};
      std::memcpy(halves, code + k, std::min(4u, block_->size - k));
      if (!body(block_->at + k, halves)) return;
    }
  }
  // Whether a block may begin although an interrupt seems to be due.
  bool may_begin(uint32_t at, uint32_t size) {
    if (stepping_) {
      if (begun_) {
        // It has stepped out of its block, or goes on within it.
        if (inside() && at < inside_until_ && at == pc) return false;
        pc = at;
        report(Stop::stepped);
        return false;
      }
      begun_ = true;
      inside_until_ = at + find_block(at, size).size;
      return true;
    }
    const auto stop = std::lower_bound(stops.begin(), stops.end(), at);
    stop_near_ = stop != stops.end() && *stop < at + find_block(at, size).size;
    if (stop_near_ || now >= deadline_ || instructions >= awake_until ||
        (masked_wait && !still_masked())) {
      pc = at;
      report(Stop::between);
      return false;
    }
    return true;
  }

  bool still_masked() const {
    const Masks masks = this->masks();
    return masks.primask == waited_.primask && masks.basepri == waited_.basepri &&
           masks.faultmask == waited_.faultmask;
  }

  const Block& find_block(uint32_t at, uint32_t size) {
    Block& block = blocks_[(at >> 1) % blocks_.size()];
    if (block.at == at && block.size == size) return block;
    block = {at, size, 0, 0};
    const uint8_t* code = memory_.find(at, size);
    for (uint32_t k = 0; code && k + 1 < size; ++block.count) k += thumb::length(code + k);
    block.cost = block.count * cost_ + branch_cost_;
    return block;
  }

  static void handle_interrupt(uc_engine*, uint32_t number, void* self) {
    Cpu& cpu = *static_cast<Cpu*>(self);
    cpu.pc = cpu.get(UC_ARM_REG_PC);
    if (number == 2) return cpu.report(Stop::call);
    if (number == 8) {
      cpu.pc |= 1;
      return cpu.report(Stop::returned);
    }
    const auto [kind, what] = describe_fault(number);
    cpu.fail(kind, what);
    cpu.report(Stop::fault);
  }

  static bool handle_invalid_instruction(uc_engine*, void* self) {
    Cpu& cpu = *static_cast<Cpu*>(self);
    cpu.pc = cpu.get(UC_ARM_REG_PC) & ~1u;
    uint16_t before = 0;
    cpu.memory_.read(cpu.pc - 2, &before, 2);
    if (before == thumb::WFE) {
      cpu.report(Stop::event);
      return true;
    }
    if (before == thumb::YIELD) return true;
    cpu.fail(Fault::Kind::undefined, "an undefined instruction");
    cpu.report(Stop::fault);
    return true;
  }

  static bool handle_unmapped_access(uc_engine*, uc_mem_type type, uint64_t address, int, int64_t,
                                     void* self) {
    Cpu& cpu = *static_cast<Cpu*>(self);
    const auto [kind, what] = describe_fault(type);
    cpu.fail(what, static_cast<uint32_t>(address), kind);
    return false;
  }

  // Permission for the first access to a page.
  static bool find_first_access(uc_engine*, uint64_t address, uc_mem_type type, uc_tlb_entry* out,
                                void* self) {
    Cpu& cpu = *static_cast<Cpu*>(self);
    const Memory::Region* region = cpu.memory_.find_region(static_cast<uint32_t>(address));
    out->paddr = address;
    out->perms = UC_PROT_ALL;  // where it is not: `no_memory` knows the address
    if (!region || !region->writable || region->code) return true;
    out->perms = static_cast<uc_prot>(UC_PROT_READ | UC_PROT_WRITE);
    if (type == UC_MEM_FETCH)
      cpu.fail("instructions from RAM that is not of kind code_ram", static_cast<uint32_t>(address),
               Fault::Kind::memory_fetch);
    return true;
  }

  static uint64_t read_bus(uc_engine*, uint64_t offset, unsigned size, void* window) {
    const Window& one = *static_cast<Window*>(window);
    return one.cpu->bus_.read(one.at + static_cast<uint32_t>(offset), size);
  }
  static void write_bus(uc_engine*, uint64_t offset, unsigned size, uint64_t value, void* window) {
    const Window& one = *static_cast<Window*>(window);
    one.cpu->bus_.write(one.at + static_cast<uint32_t>(offset), size, static_cast<uint32_t>(value));
  }

 public:
  // Let blocks begin, masks being as they are: an exception waits for one of them to change.
  void wait_for_masks(const Masks& masks) {
    masked_wait = true;
    waited_ = masks;
  }
  // Stop before the next block, whatever the time.
  void stop_soon() { until_ = deadline_ = ALWAYS; }

 private:
  Memory& memory_;
  Bus& bus_;
  Time cost_, branch_cost_;
  uc_engine* uc_ = nullptr;
  uc_context* new_ = nullptr;    // registers before the first instruction
  uc_context* saved_ = nullptr;  // room for them
  bool open_ = false;
  std::vector<std::unique_ptr<Window>> windows_;
  std::array<Block, 1 << 14> blocks_;
  static constexpr size_t MAX_EXACT = 1000;  // each takes time of those that are watched
  struct Watched {
    uint32_t size;
    uc_hook hook;
  };
  std::unordered_map<uint32_t, Watched> exact_;  // blocks of which each instruction is reported
  const Block* block_ = nullptr;                 // that runs
  struct Asks {
    uint32_t at, size;
  };
  Asks asks_{};  // has asked for the time, is not in `exact_`
  static constexpr uint32_t NOWHERE = ~0u;
  uint32_t at_ = NOWHERE;  // of the instruction that runs, as far as that is known
  Time until_ = 0, deadline_ = 0;
  Masks waited_{};
  Stop stop_ = Stop::fault;
  bool description_ = false, stepping_ = false, begun_ = false, stop_near_ = false;
  uint32_t inside_until_ = 0;  // end of the block within which it stands; 0: it stands between
};

}  // namespace mcu
