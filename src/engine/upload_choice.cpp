#include "src/engine/upload_choice.h"

namespace relievo {

const char* uploadName(Upload upload) {
  switch (upload) {
    case Upload::kAuto:
      return "auto";
    case Upload::kRgba8:
      return "rgba8";
    case Upload::kBlocks:
      return "blocks";
  }
  return "";
}

std::optional<Upload> uploadFromName(const std::string& name) {
  for (Upload upload : {Upload::kAuto, Upload::kRgba8, Upload::kBlocks})
    if (name == uploadName(upload)) return upload;
  return std::nullopt;
}

std::optional<PageCodec> commonBlockCodec(const Manifest& m) {
  const PageCodec first = m.encodings[0].codec;
  for (int k = 0; k < m.texture.planes(); ++k)
    if (m.encodings[static_cast<size_t>(k)].codec != first) return std::nullopt;
  return isBlockCodec(first) ? std::optional(first) : std::nullopt;
}

std::string uploadFormatName(PageCodec upload) {
  return isBlockCodec(upload) ? encodingName({upload, 0}) + " blocks" : "rgba8";
}

Result<UploadChoice> chooseUpload(Upload wanted, const Manifest& m, bool software,
                                  const std::function<std::optional<std::string>(PageCodec)>& missing) {
  if (wanted == Upload::kRgba8) return UploadChoice{};
  const auto codec = commonBlockCodec(m);
  if (!codec) {
    bool any = false;
    for (int k = 0; k < m.texture.planes(); ++k) any = any || isBlockCodec(m.encodings[static_cast<size_t>(k)].codec);
    return UploadChoice{.codec = PageCodec::kLossless,
                        .why_not_blocks = any ? "the package's texture planes have different codecs"
                                              : "the package's texture is not stored as blocks"};
  }
  if (auto extension = missing(*codec)) {
    const std::string what =
        "the OpenGL context has no " + *extension + ", which sampling " + encodingName({*codec, 0}) + " blocks needs";
    if (wanted == Upload::kBlocks) return Error{ErrorKind::kUnsupported, "", what, "use --upload rgba8 (or auto)", {}};
    return UploadChoice{.codec = PageCodec::kLossless, .why_not_blocks = what};
  }
  if (wanted == Upload::kAuto && software)
    return UploadChoice{.codec = PageCodec::kLossless,
                        .why_not_blocks = "the OpenGL driver runs in software, where sampling blocks is slow"};
  return UploadChoice{.codec = *codec, .why_not_blocks = ""};
}

}  // namespace relievo
