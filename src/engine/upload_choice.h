// upload_choice.h - in which format texture pages go to the GPU: RGBA8, which workers decode from any package; or the
// package's compressed blocks, 2.7 to 8 times smaller, where all of its texture planes have the same block codec and
// the context samples it. Pure.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include "src/base/result.h"
#include "texturing/package/package.h"

namespace relievo {

// kAuto: blocks where they are possible, but not with software OpenGL, which takes 1.5 to 57 times as long to sample
// them.
enum class Upload { kAuto, kRgba8, kBlocks };
const char* uploadName(Upload upload);  // "auto", "rgba8", "blocks"
std::optional<Upload> uploadFromName(const std::string& name);

// The block codec that all texture planes have.
std::optional<PageCodec> commonBlockCodec(const Manifest& manifest);
std::string uploadFormatName(PageCodec upload);  // "rgba8", "bc7 blocks"

struct UploadChoice {
  PageCodec codec = PageCodec::kLossless;  // a block codec, or any other for RGBA8
  std::string why_not_blocks;              // empty: blocks were chosen, or not asked for
};
// missing: the GL extension that a codec lacks. An Error (kUnsupported) where blocks are asked for, the package has
// them and the context cannot sample them; packages without blocks fall back to RGBA8.
Result<UploadChoice> chooseUpload(Upload wanted, const Manifest& manifest, bool software,
                                  const std::function<std::optional<std::string>(PageCodec)>& missing);

}  // namespace relievo
