#include "src/render/block_formats.h"

namespace relievo {
namespace {

// OpenGL and ES use the same numbers.
constexpr GLenum kRgbS3tcDxt1 = 0x83F0, kRedRgtc1 = 0x8DBB, kRgRgtc2 = 0x8DBD, kRgbaBptcUnorm = 0x8E8C;
constexpr BlockFormat kBc1[] = {{kRgbS3tcDxt1, 8}};
constexpr BlockFormat kBc4[] = {{kRedRgtc1, 8}, {kRedRgtc1, 8}, {kRedRgtc1, 8}};
constexpr BlockFormat kBc5[] = {{kRgRgtc2, 16}, {kRedRgtc1, 8}};
constexpr BlockFormat kBc7[] = {{kRgbaBptcUnorm, 16}};

}  // namespace

std::span<const BlockFormat> blockFormats(PageCodec codec) {
  switch (codec) {
    case PageCodec::kBc1:
      return kBc1;
    case PageCodec::kBc4:
      return kBc4;
    case PageCodec::kBc5:
      return kBc5;
    case PageCodec::kBc7:
      return kBc7;
    default:
      return {};
  }
}

std::optional<std::string> missingBlockExtension(PageCodec codec, gl::Api api) {
  const bool es = api == gl::Api::kEs30;
  const char* name = nullptr;
  switch (codec) {
    case PageCodec::kBc1:
      name = "GL_EXT_texture_compression_s3tc";
      break;
    case PageCodec::kBc4:
    case PageCodec::kBc5:
      name = es ? "GL_EXT_texture_compression_rgtc" : "GL_ARB_texture_compression_rgtc";
      break;
    case PageCodec::kBc7:
      name = es ? "GL_EXT_texture_compression_bptc" : "GL_ARB_texture_compression_bptc";
      break;
    default:
      return std::nullopt;
  }
  // Drivers go on naming extensions that became a part of OpenGL.
  if (epoxy_has_gl_extension(name)) return std::nullopt;
  return name;
}

}  // namespace relievo
