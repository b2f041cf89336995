// States that an instance keeps for its importer: magic number, fingerprint of the binary, content,
// check sum. They live as long as the instance.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

namespace fmu {

class KeptStates {
 public:
  explicit KeptStates(std::size_t content) : size_(kHead + content + sizeof(std::uint64_t)) {}

  std::size_t size() const { return size_; }  // of each, in bytes
  void* make() {
    states_.push_back(std::make_unique<unsigned char[]>(size_));
    return states_.back().get();
  }
  bool is_known(const void* state) const {
    for (const auto& one : states_)
      if (one.get() == state) return true;
    return false;
  }
  // False if there is no such state.
  bool forget(void** state) {
    if (!std::erase_if(states_, [&](const auto& one) { return one.get() == *state; })) return false;
    *state = nullptr;
    return true;
  }

  static unsigned char* count_bytes(void* state) { return static_cast<unsigned char*>(state); }
  static unsigned char* find_content(void* state) { return count_bytes(state) + kHead; }
  // Complete a state whose content is there.
  void compute_seal(void* state, std::uint64_t fingerprint) const {
    unsigned char* bytes = count_bytes(state);
    std::memcpy(bytes, &kMagic, 8);
    std::memcpy(bytes + 8, &fingerprint, 8);
    const std::uint64_t sum = sum_of(bytes);
    std::memcpy(bytes + size_ - 8, &sum, 8);
  }
  // The rule that bytes of a serialized state break; null if they are sound.
  const char* find_obstacle(const void* serialized, std::uint64_t fingerprint) const {
    const auto* const bytes = static_cast<const unsigned char*>(serialized);
    std::uint64_t magic, of, sum;
    std::memcpy(&magic, bytes, 8);
    std::memcpy(&of, bytes + 8, 8);
    std::memcpy(&sum, bytes + size_ - 8, 8);
    if (magic != kMagic || of != fingerprint) return "be of this binary";
    return sum == sum_of(bytes) ? nullptr : "be as it was written";
  }

 private:
  static constexpr std::uint64_t kMagic = 0x32554d464d5241;  // "ARMFMU2"
  static constexpr std::size_t kHead = 2 * sizeof(std::uint64_t);

  std::uint64_t sum_of(const unsigned char* bytes) const {
    std::uint64_t sum = 0xcbf29ce484222325;
    for (std::size_t k = 0; k + 8 < size_; k += 8) {
      std::uint64_t word;
      std::memcpy(&word, bytes + k, 8);
      sum = (sum ^ word) * 0x100000001b3;  // FNV-1a: any one word that is changed changes it
      sum ^= sum >> 32;
    }
    return sum;
  }

  std::size_t size_;
  std::vector<std::unique_ptr<unsigned char[]>> states_;
};

}  // namespace fmu
