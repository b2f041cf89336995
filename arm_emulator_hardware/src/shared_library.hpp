// A shared library and its functions by name.
#pragma once

#include <dlfcn.h>

#include <memory>
#include <string>

namespace arm_emulator_hardware {

class SharedLibrary {
 public:
  // Null functions, and a reason, where the file is no library.
  explicit SharedLibrary(const std::string& file)
      : handle_(dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL)) {
    if (!handle_) why_ = dlerror();
  }
  const std::string& why() const { return why_; }

  // Set `function` to that of the name; false if there is none.
  template <class Function>
  bool find(const char* name, Function*& function) const {
    function = handle_ ? reinterpret_cast<Function*>(dlsym(handle_.get(), name)) : nullptr;
    return function != nullptr;
  }

 private:
  struct Close {
    void operator()(void* handle) const { dlclose(handle); }
  };
  std::unique_ptr<void, Close> handle_;
  std::string why_;
};

}  // namespace arm_emulator_hardware
