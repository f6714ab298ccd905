// page_source.h - where encoded pages come from at run time. Sources stack: a package file, memory, a procedural
// source, and wrappers that limit the rate, fail or record (page_sources.h). read() is called from several worker
// threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "src/base/result.h"
#include "texturing/codec/page_id.h"

namespace relievo {

// What a page's bytes are; see page_codec.h.
struct EncodedPage {
  std::vector<uint8_t> bytes;
  size_t from_tail = 0;  // of them, those that a package has elsewhere (page_codec.h, addTailHeights())
  size_t storedBytes() const { return bytes.size() - std::min(bytes.size(), from_tail); }
};

class PageSource {
 public:
  virtual ~PageSource() = default;
  // The page's encoded bytes, its checksum verified. An absent page is an error of kind kInvalidData.
  virtual Result<EncodedPage> read(PageId id) const = 0;
};

}  // namespace relievo
