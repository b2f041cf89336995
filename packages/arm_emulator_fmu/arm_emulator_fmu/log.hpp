// Messages of an instance to its importer, by category.
#pragma once

#include <cstdarg>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <functional>
#include <utility>

namespace fmu {

// As fmi3Status and fmi2Status number them.
enum Status { kOk = 0, kWarning = 1, kDiscard = 2, kError = 3 };

// Categories of what is logged, in modelDescription.xml, too.
enum Category { kEvents, kStatusDiscard, kStatusError, kCategories };
constexpr const char* kCategoryNames[kCategories] = {"logEvents", "logStatusDiscard",
                                                     "logStatusError"};

// Destination of messages; `name`: of the instance.
using Log =
    std::function<void(const char* name, Status status, const char* category, const char* text)>;

class Logger {
 public:
  Logger(const char* name, bool logging, Log log) : log_(std::move(log)) {
    std::snprintf(name_, sizeof name_, "%s", name);
    for (bool& on : on_) on = logging;
  }
  Logger(const Logger&) = delete;
  Logger& operator=(const Logger&) = delete;

  void write(Status status, const char* format, va_list arguments) const {
    const Category category = status == kError     ? kStatusError
                              : status == kDiscard ? kStatusDiscard
                                                   : kEvents;
    // The standard requires errors to be reported, whatever categories are on.
    if (status != kError && !on_[category]) return;
    char text[1024], escaped[2 * sizeof text];
    std::vsnprintf(text, sizeof text, format, arguments);
    char* to = escaped;
    for (const char* from = text; *from; ++from) {
      if (*from == '#') *to++ = '#';  // or it would begin a value reference
      *to++ = *from;
    }
    *to = 0;
    log_(name_, status, kCategoryNames[category], escaped);
  }

  // Switch categories on or off; all of them if `count` is 0. Returns one that is not known, null
  // if all are.
  const char* set(bool on, std::size_t count, const char* const* categories) {
    bool chosen[kCategories] = {};
    for (std::size_t k = 0; k < count; ++k) {
      int c = 0;
      while (c < kCategories && (!categories[k] || std::strcmp(categories[k], kCategoryNames[c])))
        ++c;
      if (c == kCategories) return categories[k] ? categories[k] : "none";
      chosen[c] = true;
    }
    for (int c = 0; c < kCategories; ++c)
      if (!count || chosen[c]) on_[c] = on;
    return nullptr;
  }

 private:
  char name_[200];
  Log log_;
  bool on_[kCategories];
};

}  // namespace fmu
