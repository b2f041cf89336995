// Memory-mapped registers: words that keep the written value, some with side effects.
#pragma once

#include <bit>
#include <cstdint>
#include <functional>
#include <unordered_map>
#include <utility>
#include <vector>

#include "remembered.hpp"

namespace mcu {

class Registers {
 public:
  // Value read from a register, from the stored one; with `look` nothing may change.
  using Read = std::function<uint32_t(uint32_t stored, bool look)>;
  // Value stored after a write, from the written and the stored one.
  using Write = std::function<uint32_t(uint32_t value, uint32_t stored)>;

  // Both are multiples of 1024.
  void add(uint32_t at, uint32_t size) {
    blocks_.push_back({at, std::vector<uint32_t>(size / 4), std::vector<bool>(size / 4)});
  }

  bool has(uint32_t at) { return find(at).block; }
  // The stored word of an existing register.
  uint32_t& word(uint32_t at) { return find(at).word(); }
  float number(uint32_t at) { return std::bit_cast<float>(word(at)); }
  void put(uint32_t at, float number) { word(at) = std::bit_cast<uint32_t>(number); }

  // Whether a register with side effects was accessed since the last call.
  bool has_special_access() { return std::exchange(special_, false); }

  void set_read_handler(uint32_t at, Read read) {
    reads_[at] = std::move(read);
    find(at).does_more() = true;
  }
  void set_write_handler(uint32_t at, Write write) {
    writes_[at] = std::move(write);
    find(at).does_more() = true;
  }

  uint32_t read(uint32_t at, unsigned size, bool look = false) {
    const uint32_t word_at = at & ~3u;
    const Place place = find(word_at);
    if (!place.block) return 0;
    uint32_t value = place.word();
    if (place.does_more())
      if (const auto one = reads_.find(word_at); one != reads_.end()) {
        value = one->second(value, look);
        special_ = true;
      }
    return size == 4 ? value : value >> 8 * (at & 3) & make_mask(size);
  }

  void write(uint32_t at, unsigned size, uint32_t value) {
    const uint32_t word_at = at & ~3u;
    const Place place = find(word_at);
    if (!place.block) return;
    if (size < 4) {
      const unsigned shift = 8 * (at & 3);
      const uint32_t mask = make_mask(size) << shift;
      value = (place.word() & ~mask) | (value << shift & mask);
    }
    if (place.does_more())
      if (const auto one = writes_.find(word_at); one != writes_.end()) {
        value = one->second(value, place.word());
        special_ = true;
      }
    place.word() = value;
  }

  void visit_state(Checkpoint& list) {
    list(special_);
    for (Block& block : blocks_) list(block.words);
  }

 private:
  struct Block {
    uint32_t at;
    std::vector<uint32_t> words;
    std::vector<bool> does_more;
  };
  struct Place {
    Block* block;
    size_t index;

    uint32_t& word() const { return block->words[index]; }
    std::vector<bool>::reference does_more() const { return block->does_more[index]; }
  };

  static uint32_t make_mask(unsigned size) { return size == 1 ? 0xffu : 0xffffu; }

  Place find(uint32_t at) {
    for (Block& block : blocks_)
      if (at - block.at < 4 * block.words.size()) return {&block, (at - block.at) / 4};
    return {nullptr, 0};
  }

  std::vector<Block> blocks_;
  bool special_ = false;
  std::unordered_map<uint32_t, Read> reads_;
  std::unordered_map<uint32_t, Write> writes_;
};

}  // namespace mcu
