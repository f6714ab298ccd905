// block_formats.h - which GL formats hold a page's blocks (texturing/codec/page_block_codec.h), and which of them a
// context samples.
#pragma once

#include <optional>
#include <span>
#include <string>

#include "src/gl/context.h"
#include "src/gl/objects.h"
#include "texturing/codec/page_encoding.h"

namespace relievo {

// The format of the texture that holds one set of a page's blocks; one for each set, in their order.
struct BlockFormat {
  GLenum format;
  size_t block_bytes;
};
std::span<const BlockFormat> blockFormats(PageCodec codec);  // none for codecs without blocks

// The extension without which the current context cannot sample these blocks; nothing: it can.
std::optional<std::string> missingBlockExtension(PageCodec codec, gl::Api api);

}  // namespace relievo
