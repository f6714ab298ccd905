// page_failures.h - pages that a picture needed and that could not be read or decoded: how many, for which kind of
// reason, and the first of them.
#pragma once

#include <cstdint>
#include <string>

#include "src/base/result.h"
#include "texturing/codec/page_id.h"

namespace relievo {

struct PageFailures {
  uint64_t pages = 0;
  uint64_t unreadable = 0;  // of these: input/output errors, not damage
  std::string first;        // which page it was, and why; one line

  void add(PageId id, const Error& error);
  void add(const PageFailures& others) {
    if (pages == 0) first = others.first;
    pages += others.pages;
    unreadable += others.unreadable;
  }
  friend bool operator==(const PageFailures&, const PageFailures&) = default;
};

}  // namespace relievo
