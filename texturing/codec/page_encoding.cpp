#include "texturing/codec/page_encoding.h"

#include <algorithm>
#include <charconv>

namespace relievo {
namespace {

constexpr const char* kNames = "lossless, q8 (the same), q7, q6, q5, q4, jpeg, bc1, bc4, bc5, bc7";

bool validParameter(PageCodec codec, uint8_t parameter) {
  switch (codec) {
    case PageCodec::kQuantised:
      return parameter >= kMinQuantisedBits && parameter <= kMaxQuantisedBits;
    case PageCodec::kJpeg:
    case PageCodec::kJpegYcc:
      return parameter >= 1 && parameter <= 100;
    default:
      return parameter == 0;
  }
}

bool known(PageCodec codec) {
  switch (codec) {
    case PageCodec::kLossless:
    case PageCodec::kQuantised:
    case PageCodec::kJpeg:
    case PageCodec::kJpegYcc:
    case PageCodec::kBc1:
    case PageCodec::kBc4:
    case PageCodec::kBc5:
    case PageCodec::kBc7:
      return true;
  }
  return false;
}

}  // namespace

std::string encodingName(PageEncoding e) {
  switch (e.codec) {
    case PageCodec::kLossless:
      return "lossless";
    case PageCodec::kQuantised:
      return "q" + std::to_string(e.parameter);
    case PageCodec::kJpeg:
      return "jpeg" + std::to_string(e.parameter);
    case PageCodec::kJpegYcc:
      return "jpeg" + std::to_string(e.parameter) + "-ycc";
    case PageCodec::kBc1:
      return "bc1";
    case PageCodec::kBc4:
      return "bc4";
    case PageCodec::kBc5:
      return "bc5";
    case PageCodec::kBc7:
      return "bc7";
  }
  return "unknown";
}

Result<PageEncoding> parseEncoding(const std::string& name, int jpeg_quality) {
  auto number = [](std::string_view text) {
    int v = -1;
    auto [end, bad] = std::from_chars(text.data(), text.data() + text.size(), v);
    return bad == std::errc() && end == text.data() + text.size() ? v : -1;
  };
  if (name == "lossless" || name == "q8") return PageEncoding{};
  for (PageCodec c : {PageCodec::kBc1, PageCodec::kBc4, PageCodec::kBc5, PageCodec::kBc7})
    if (name == encodingName({c, 0})) return PageEncoding{c, 0};
  if (name.starts_with("q")) {
    int bits = number(std::string_view(name).substr(1));
    if (bits >= kMinQuantisedBits && bits <= kMaxQuantisedBits)
      return PageEncoding{PageCodec::kQuantised, static_cast<uint8_t>(bits)};
  }
  if (name.starts_with("jpeg")) {
    std::string_view rest = std::string_view(name).substr(4);
    const bool ycc = rest.ends_with("-ycc");
    if (ycc) rest.remove_suffix(4);
    int quality = rest.empty() ? jpeg_quality : number(rest);
    if (quality >= 1 && quality <= 100)
      return PageEncoding{ycc ? PageCodec::kJpegYcc : PageCodec::kJpeg, static_cast<uint8_t>(quality)};
  }
  return Error{ErrorKind::kUsage,
               "",
               "there is no page encoding '" + name + "'",
               std::string("use one of ") + kNames + ", jpegQUALITY",
               {}};
}

Result<PageEncoding> encodingFromBytes(uint8_t codec, uint8_t parameter) {
  PageEncoding e{static_cast<PageCodec>(codec), parameter};
  if (known(e.codec) && validParameter(e.codec, parameter)) return e;
  return Error{
      ErrorKind::kUnsupported,
      "",
      "page encoding " + std::to_string(codec) + " with parameter " + std::to_string(parameter) + " is not known",
      "use a newer relievo, or rebuild the package",
      {}};
}

bool isColourPlane(const TextureFormat& format, int plane) {
  const BasisChannel* of_plane = describe(format.basis).channels.data() + 3 * plane;
  return std::all_of(of_plane, of_plane + 3,
                     [](const BasisChannel& c) { return c.holds == BasisChannel::Holds::kColour; });
}

namespace {

// Do its channels belong to red, green and blue?
bool isRgbPlane(const TextureFormat& format, int plane) {
  const BasisChannel* of_plane = describe(format.basis).channels.data() + 3 * plane;
  for (int c = 0; c < 3; ++c) {
    const bool of_colour =
        of_plane[c].holds == BasisChannel::Holds::kColour || of_plane[c].holds == BasisChannel::Holds::kCoefficient;
    if (!of_colour || of_plane[c].of != c) return false;
  }
  return true;
}

}  // namespace

PlaneEncodings planeEncodings(const TextureFormat& format, PageEncoding coefficients, PageEncoding colour) {
  PlaneEncodings out;
  for (int k = 0; k < format.planes(); ++k) {
    PageEncoding e = isColourPlane(format, k) ? colour : coefficients;
    if (e.codec == PageCodec::kJpeg && isRgbPlane(format, k)) e.codec = PageCodec::kJpegYcc;
    out[static_cast<size_t>(k)] = e;
  }
  return out;
}

}  // namespace relievo
