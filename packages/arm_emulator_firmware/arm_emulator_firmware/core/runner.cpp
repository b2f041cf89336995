#include "runner.hpp"

#include <cstdio>

struct mcu_runner : mcu::Runner {
  using mcu::Runner::Runner;
};

#define MCU_CALL extern "C" __attribute__((visibility("default")))

MCU_CALL mcu_runner* mcu_new(const mcu_board* board, char* why) {
  auto* runner = new mcu_runner(*board);
  const char* reason = runner->open();
  if (!reason) return runner;
  std::snprintf(why, 120, "%s", reason);
  delete runner;
  return nullptr;
}

MCU_CALL void mcu_delete(mcu_runner* runner) { delete runner; }

MCU_CALL int mcu_load(mcu_runner* runner, uint32_t at, const void* bytes, int64_t size) {
  return runner->load(at, bytes, static_cast<uint64_t>(size));
}

MCU_CALL void mcu_debug(mcu_runner* runner, int socket) { runner->attach_debugger(socket); }

MCU_CALL void mcu_break(mcu_runner* runner, int32_t* flag) { runner->breaks = flag; }

MCU_CALL void mcu_step(void* with, const firmware_input* in, firmware_output* out) {
  static_cast<mcu_runner*>(with)->step(*in, *out);
}

MCU_CALL const char* mcu_unkept(const mcu_runner* runner) { return runner->unkept(); }

MCU_CALL const uint8_t* mcu_save(mcu_runner* runner, int64_t* size) {
  const auto& saved = runner->save();
  *size = static_cast<int64_t>(saved.size());
  return saved.data();
}

MCU_CALL void mcu_restore(mcu_runner* runner, const uint8_t* saved) { runner->restore(saved); }

MCU_CALL const int32_t* mcu_stopped(const mcu_runner* runner) { return &runner->stopped; }

MCU_CALL void mcu_get_fault(const mcu_runner* runner, mcu_fault* out) { *out = runner->fault; }

MCU_CALL void mcu_get_figures(const mcu_runner* runner, mcu_figures* out) {
  *out = runner->figures;
}
