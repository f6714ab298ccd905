#include "texturing/package/page_failures.h"

#include "texturing/package/package_layout.h"

namespace relievo {

void PageFailures::add(PageId id, const Error& error) {
  unreadable += error.kind == ErrorKind::kIo;
  if (pages++ > 0) return;
  first = error.message;
  if (first.find(describePage(id)) == std::string::npos) first = "page " + describePage(id) + ": " + first;
  if (error.offset) first += " (byte " + std::to_string(*error.offset) + ")";
}

}  // namespace relievo
