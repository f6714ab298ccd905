// result.h - a value or an error that a user can act on.
// An Error names the file, what is wrong (expected and found, with the offset where it applies) and what to do about
// it. Its kind is the process's exit code (documented in --help): 1 usage, 2 input/output, 3 invalid data, 4 runtime or
// GL, 5 unsupported, 7 difference found or tolerance missed.
#pragma once

#include <cassert>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "src/base/printable.h"

namespace relievo {

enum class ErrorKind : int {
  kUsage = 1,
  kIo = 2,
  kInvalidData = 3,
  kRuntime = 4,
  kUnsupported = 5,
  kDifference = 7,
  kInterrupted = 130
};

struct Error {
  ErrorKind kind = ErrorKind::kRuntime;
  std::string file;                // the file or device concerned; may be empty
  std::string message;             // what is wrong: "expected X, found Y"
  std::string hint;                // what to do; may be empty
  std::optional<uint64_t> offset;  // byte offset in the file, where it applies

  // One line: "FILE: at byte N: MESSAGE (HINT)". What of it comes from a file, its name included, may hold any bytes:
  // control characters are escaped.
  std::string text() const {
    std::string out;
    if (!file.empty()) out += file + ": ";
    if (offset) out += "at byte " + std::to_string(*offset) + ": ";
    out += message;
    if (!hint.empty()) out += " (" + hint + ")";
    return printable(out);
  }
  int exitCode() const { return static_cast<int>(kind); }
};

template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : state_(std::move(value)) {}      // NOLINT: implicit on purpose, so that `return value;` works
  Result(Error error) : state_(std::move(error)) {}  // NOLINT
  bool ok() const { return std::holds_alternative<T>(state_); }
  explicit operator bool() const { return ok(); }
  T& value() {
    assert(ok());
    return std::get<T>(state_);
  }
  const T& value() const {
    assert(ok());
    return std::get<T>(state_);
  }
  T& operator*() { return value(); }
  const T& operator*() const { return value(); }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }
  const Error& error() const {
    assert(!ok());
    return std::get<Error>(state_);
  }

 private:
  std::variant<T, Error> state_;
};

template <>
class [[nodiscard]] Result<void> {
 public:
  Result() = default;
  Result(Error error) : error_(std::move(error)) {}  // NOLINT
  bool ok() const { return !error_; }
  explicit operator bool() const { return ok(); }
  const Error& error() const {
    assert(!ok());
    return *error_;
  }

 private:
  std::optional<Error> error_;
};

}  // namespace relievo
