// Memory of a chip in checkpoints: each of its pieces lists it once, for writing and for reading
// alike: `void remembered(Checkpoint& list) { list(one, two); }`.
#pragma once

#include <cstdint>
#include <cstring>
#include <deque>
#include <map>
#include <type_traits>
#include <vector>

namespace mcu {

class Checkpoint {
 public:
  // Values that are listed are appended, or set to those that another one has appended by the same
  // lists.
  explicit Checkpoint(std::vector<uint8_t>& into) : into_(&into) {}
  explicit Checkpoint(const uint8_t* from) : from_(from) {}
  bool reads() const { return from_; }
  // The bytes that are read next.
  const uint8_t* next() const { return from_; }

  template <class... T>
  void operator()(T&... each) {
    (take(each), ...);
  }
  void bytes(void* at, size_t size) {
    auto* const there = static_cast<uint8_t*>(at);
    if (!reads()) return void(into_->insert(into_->end(), there, there + size));
    std::memcpy(there, from_, size);
    from_ += size;
  }

 private:
  template <class T>
  void take(T& one) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes(&one, sizeof one);
  }
  template <class T>
  void take(std::vector<T>& list) {
    take_all(list);
  }
  template <class T>
  void take(std::deque<T>& list) {
    take_all(list);
  }
  template <class List>
  void take_all(List& list) {
    size_t count = list.size();
    take(count);
    list.resize(count);
    for (auto& one : list) take(one);
  }
  template <class K, class V>
  void take(std::map<K, V>& map) {
    std::vector<K> keys;
    std::vector<V> values;
    for (const auto& [key, value] : map) keys.push_back(key), values.push_back(value);
    take_all(keys);
    take_all(values);
    map.clear();
    for (size_t k = 0; k < keys.size(); ++k) map[keys[k]] = values[k];
  }

  std::vector<uint8_t>* into_ = nullptr;
  const uint8_t* from_ = nullptr;
};

}  // namespace mcu
