// States of groups of lanes in rows of a card's memory. A word of all groups is a row, so that
// threads side by side read words side by side. A thread copies the state of its group to its own
// memory, and back when time has gone on.
#pragma once

#include <cstdint>

namespace arm {

// Groups that have their states themselves.
template <class Group, bool has_rows>
struct StateRows {
  explicit StateRows(int) {}
  static std::int64_t count_bytes(int) { return 0; }
  void clear(int) {}

  struct State {
    State(const StateRows&, Group&, int, const auto&) {}
    void store() {}
  };
};

// Word w of group g is words[w * stride + g].
template <class Group>
class StateRows<Group, true> {
 public:
  using Word = std::uint64_t;

  explicit StateRows(int groups)
      : stride_(stride_of(groups)), words_(new Word[count_words() * stride_]) {}
  ~StateRows() { delete[] words_; }
  StateRows(const StateRows&) = delete;

  static std::int64_t count_bytes(int groups) {
    return count_words() * stride_of(groups) * std::int64_t{sizeof(Word)};
  }
  void clear(int g) {
    for (std::int64_t w = 0; w < count_words(); ++w) words_[w * stride_ + g] = 0;
  }

  // The state of a group in the memory of its thread.
  class State {
   public:
    State(const StateRows& rows, Group& group, int g, const typename Group::Common& common)
        : group_(group),
          words_(rows.words_ + g),
          stride_(rows.stride_),
          state_(group.make_state(common)) {
      for_each_word([](Word& here, const Word& there) { here = there; });
      group_.set_state(&state_);
      group_.set_machines();
    }
    ~State() { group_.set_state(nullptr); }
    State(const State&) = delete;

    // Copy it to the rows: time has gone on.
    void store() {
      for_each_word([](const Word& here, Word& there) { there = here; });
    }

   private:
    void for_each_word(auto&& act) {
      Word* there = words_;
      state_.for_each_number([&](auto& number) {
        Word here[sizeof number / sizeof(Word)];
        __builtin_memcpy(here, &number, sizeof number);
        for (Word& word : here) act(word, *there), there += stride_;
        __builtin_memcpy(&number, here, sizeof number);
      });
    }

    Group& group_;
    Word* words_;
    std::int64_t stride_;
    typename Group::LaneState state_;
  };

 private:
  static constexpr std::int64_t kWarpThreads = 32;  // threads that a card runs together

  static std::int64_t stride_of(int groups) {
    return (groups + kWarpThreads - 1) / kWarpThreads * kWarpThreads;
  }
  static std::int64_t count_words() { return Group::LaneState::count_words(); }

  std::int64_t stride_;
  Word* words_;
};

}  // namespace arm
