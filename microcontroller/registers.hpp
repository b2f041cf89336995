// Memory-mapped registers: words that keep what was written, some of which do more.
#pragma once

#include <bit>
#include <cstdint>
#include <functional>
#include <unordered_map>
#include <utility>
#include <vector>

namespace mcu {

class Registers {
 public:
  // What a read of a register gives, by what is stored; with `look` it must change nothing.
  using Read = std::function<uint32_t(uint32_t stored, bool look)>;
  // What is stored after a write, by what was written and what was stored.
  using Write = std::function<uint32_t(uint32_t value, uint32_t stored)>;

  // Both are multiples of 1024.
  void add(uint32_t at, uint32_t size) { blocks_.push_back({at, std::vector<uint32_t>(size / 4)}); }

  bool has(uint32_t at) const { return const_cast<Registers*>(this)->find(at); }
  // The stored word of a register that is there.
  uint32_t& word(uint32_t at) { return *find(at); }
  float number(uint32_t at) { return std::bit_cast<float>(word(at)); }
  void put(uint32_t at, float number) { word(at) = std::bit_cast<uint32_t>(number); }

  // Whether one that does more was read or written since it was asked last.
  bool special() { return std::exchange(special_, false); }

  void on_read(uint32_t at, Read read) { reads_[at] = std::move(read); }
  void on_write(uint32_t at, Write write) { writes_[at] = std::move(write); }

  uint32_t read(uint32_t at, unsigned size, bool look = false) {
    const uint32_t whole = at & ~3u;
    const uint32_t* stored = find(whole);
    if (!stored) return 0;
    uint32_t value = *stored;
    if (const auto one = reads_.find(whole); one != reads_.end()) {
      value = one->second(value, look);
      special_ = true;
    }
    return size == 4 ? value : value >> 8 * (at & 3) & mask_of(size);
  }

  void write(uint32_t at, unsigned size, uint32_t value) {
    const uint32_t whole = at & ~3u;
    uint32_t* stored = find(whole);
    if (!stored) return;
    if (size < 4) {
      const unsigned shift = 8 * (at & 3);
      const uint32_t mask = mask_of(size) << shift;
      value = (*stored & ~mask) | (value << shift & mask);
    }
    if (const auto one = writes_.find(whole); one != writes_.end()) {
      value = one->second(value, *stored);
      special_ = true;
    }
    *stored = value;
  }

 private:
  struct Block {
    uint32_t at;
    std::vector<uint32_t> words;
  };

  static uint32_t mask_of(unsigned size) { return size == 1 ? 0xffu : 0xffffu; }

  uint32_t* find(uint32_t at) {
    for (Block& block : blocks_)
      if (at - block.at < 4 * block.words.size()) return &block.words[(at - block.at) / 4];
    return nullptr;
  }

  std::vector<Block> blocks_;
  bool special_ = false;
  std::unordered_map<uint32_t, Read> reads_;
  std::unordered_map<uint32_t, Write> writes_;
};

}  // namespace mcu
