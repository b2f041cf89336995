// The dictionary of a drive behind an SDO server, and the server of one on CANopen.
#pragma once

#include "../drive.hpp"
#include "sdo_server.hpp"

namespace fieldbus {

// One drive's dictionary as a server needs it.
class DriveDictionary : public SdoDictionary {
 public:
  explicit DriveDictionary(Drive& drive) : drive_(drive) {}

  std::uint32_t read(const SdoObject& at, Bytes& out) const override {
    std::byte value[kLongestText];
    std::size_t size = 0;
    const std::uint32_t abort = drive_.read(at.index, at.sub, value, size);
    const auto* const from = reinterpret_cast<const std::uint8_t*>(value);
    if (!abort) out.insert(out.end(), from, from + size);
    return abort;
  }
  std::uint32_t write(const SdoObject& at, std::span<const std::uint8_t> in) override {
    return drive_.write(at.index, at.sub, std::as_bytes(in));
  }
  bool has(std::uint16_t index) const override { return drive_.values().find(index, 0) >= 0; }
  std::size_t length(const SdoObject& at) const override {
    const int slot = drive_.values().find(at.index, at.sub);
    const std::size_t bits = slot < 0 ? 0 : Values::entry(slot).bits;
    return bits ? bits / 8 : 4;
  }

 protected:
  ~DriveDictionary() = default;
  Drive& drive_;
};

struct CanopenSdo {
  struct Dictionary final : DriveDictionary {
    using DriveDictionary::DriveDictionary;
  };
  explicit CanopenSdo(Drive& drive) : dictionary(drive) {}
  CanopenSdo(const CanopenSdo&) = delete;
  CanopenSdo& operator=(const CanopenSdo&) = delete;

  Dictionary dictionary;
  SdoServer server{dictionary, SdoServer::Carrier::can};
};

}  // namespace fieldbus
