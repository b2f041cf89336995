// Memory of a chip in checkpoints: each of its pieces lists it once, for writing and for reading
// alike: `template <class List> void remembered(List& list) { list(one, two); }`.
#pragma once

#include <cstdint>
#include <cstring>
#include <deque>
#include <map>
#include <type_traits>
#include <utility>
#include <vector>

namespace mcu {

// Appends what it is given.
class Writer {
 public:
  explicit Writer(std::vector<uint8_t>& into) : into_(into) {}

  template <class... T>
  void operator()(const T&... each) {
    (put(each), ...);
  }
  void bytes(const void* from, size_t size) {
    const auto* const at = static_cast<const uint8_t*>(from);
    into_.insert(into_.end(), at, at + size);
  }

 private:
  template <class T>
  void put(const T& one) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes(&one, sizeof one);
  }
  template <class T>
  void put(const std::vector<T>& list) {
    put_all(list);
  }
  template <class T>
  void put(const std::deque<T>& list) {
    put_all(list);
  }
  template <class List>
  void put_all(const List& list) {
    put(list.size());
    for (const auto& one : list) put(one);
  }
  template <class K, class V>
  void put(const std::map<K, V>& map) {
    put(map.size());
    for (const auto& [key, value] : map) put(key), put(value);
  }

  std::vector<uint8_t>& into_;
};

// Reads what `Writer` has written by the same lists.
class Reader {
 public:
  explicit Reader(const uint8_t* from) : from_(from) {}

  template <class... T>
  void operator()(T&... each) {
    (take(each), ...);
  }
  void bytes(void* to, size_t size) {
    std::memcpy(to, from_, size);
    from_ += size;
  }
  // The next bytes, which are passed over.
  const uint8_t* next(size_t size) { return std::exchange(from_, from_ + size); }

 private:
  template <class T>
  void take(T& one) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes(&one, sizeof one);
  }
  template <class T>
  T taken() {
    T one{};
    take(one);
    return one;
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
    list.resize(taken<size_t>());
    for (auto& one : list) take(one);
  }
  template <class K, class V>
  void take(std::map<K, V>& map) {
    map.clear();
    for (size_t left = taken<size_t>(); left; --left) {
      const K key = taken<K>();
      map[key] = taken<V>();
    }
  }

  const uint8_t* from_;
};

}  // namespace mcu
