// ptm_reader.cpp - the .ptm header, and reading uncompressed files in rectangles straight from the file.
//
// Header: items separated by white space, so that "width newline height" and "width space height", trailing spaces and
// CRLF line ends are all one case. Only the end of the header is strict: blanks, then one line feed (or CR LF), then
// data. Data (rows bottom to top):
//   RGB       three blocks (R, G, B) of 6 bytes a pixel, a0..a5
//   LRGB 1.2  a block of 6 bytes a pixel, a0..a5, then a block of 3 bytes a pixel, R G B
//   LRGB 1.1  9 bytes a pixel, a0..a5 R G B
//   LUM       a line of 16 numbers, a 4x4 colour matrix, ends the header; then 8 bytes a pixel, a0..a5 Cr Cb
//
// LUM becomes an RGB PTM. The only known writer of LUM files multiplies the matrix, row by row, with the column
// (Cr, Y, Cb, 1), Y being the polynomial; as in JPEG we centre the two chroma bytes at 128. If the Y column of the rows
// R, G and B is one number m > 0 (in all matrices known it is 1), then colour c is
//   m (a0 u^2 + a1 v^2 + a2 u v + a3 u + a4 v) + [m a5 + o_c(Cr, Cb)]
//   with o_c = M_c0 (Cr - 128) + M_c2 (Cb - 128) + M_c3:
// a0..a4 are shared by the colours and keep their bytes (scale times m); only a5 differs. Its new scale and bias are
// common to the colours and follow from the ranges alone, before any pixel is read: with [lo, hi] the smallest interval
// that holds m a5 + o_c for all raw bytes and the three colours, step = (hi - lo) / 254 and bias = ceil(-lo / step), so
// that 0..255 covers [lo, hi] with an integer bias (254, not 255, pays for rounding the bias). A grey matrix (o_c = 0)
// keeps a5's own bytes. Other Y columns are refused.

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <string_view>

#if defined(__x86_64__)
#include <tmmintrin.h>
#endif

#include "texturing/import/ptm.h"
#include "texturing/import/ptm_internal.h"
#include "texturing/package/file_provenance.h"

namespace relievo {
namespace ptm_detail {
namespace {

// The longest real headers (JPEG_RGB, 18 planes) take about 1.2 KB.
constexpr uint64_t kMaxHeaderBytes = 16384;
// A few trailing bytes (line ends added on the way) do no harm; a whole row more means that the header is wrong.
constexpr uint64_t kMaxTrailingBytes = 16;
// JPEG's own limit on a side (jmorecfg.h: JPEG_MAX_DIMENSION).
constexpr int64_t kMaxJpegSide = 65500;

std::string printable(std::string_view text) {
  std::string out = "\"";
  for (char c : text.substr(0, 40)) out += c >= 0x20 && c < 0x7f ? c : '?';
  if (text.size() > 40) out += "...";
  return out + "\"";
}

class HeaderParser {
 public:
  HeaderParser(const InputFile& file, std::string_view text) : file_(file), text_(text) {}

  // Every step below does nothing once an error is noted, so that the reading of a header is written straight down.
  std::string_view token(const char* what) {
    if (error_) return {};
    while (at_ < text_.size() && isSpace(text_[at_])) ++at_;
    token_offset_ = at_;
    size_t end = at_;
    while (end < text_.size() && !isSpace(text_[end])) ++end;
    if (end == text_.size()) {  // no token, or one that may be cut short: something always follows in the header
      noteEnd(what);
      return {};
    }
    auto result = text_.substr(at_, end - at_);
    at_ = end;
    return result;
  }

  int64_t integer(const char* what, int64_t min, int64_t max) {
    std::string_view t = token(what);
    if (error_) return min;
    std::string_view digits = t.size() > 1 && t[0] == '+' ? t.substr(1) : t;
    int64_t value = 0;
    auto [end, status] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (status != std::errc() || end != digits.data() + digits.size() || value < min || value > max) {
      note(std::string("expected ") + what + ", a whole number from " + std::to_string(min) + " to " +
           std::to_string(max) + ", found " + printable(t));
      return min;
    }
    return value;
  }

  double number(const char* what) {
    std::string_view t = token(what);
    if (error_) return 0;
    std::string_view digits = t.size() > 1 && t[0] == '+' ? t.substr(1) : t;
    double value = 0;
    auto [end, status] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (status != std::errc() || end != digits.data() + digits.size() || !std::isfinite(value)) {
      note(std::string("expected ") + what + ", a finite number, found " + printable(t));
      return 0;
    }
    return value;
  }

  // Blanks, then the line's end: where the data begin.
  void lastLineEnd() {
    if (error_) return;
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t')) ++at_;
    token_offset_ = at_;
    if (at_ < text_.size() && text_[at_] == '\r') ++at_;
    if (at_ >= text_.size()) {
      noteEnd("the header's last line end");
    } else if (text_[at_] != '\n') {
      note("expected the end of the header's last line, found " + printable(text_.substr(token_offset_, 8)));
    } else {
      ++at_;
    }
  }

  void note(std::string message, ErrorKind kind = ErrorKind::kInvalidData, std::string hint = kDamaged) {
    if (!error_) error_ = Error{kind, file_.path(), std::move(message), std::move(hint), token_offset_};
  }
  bool failed() const { return error_.has_value(); }
  const Error& error() const { return *error_; }
  uint64_t offset() const { return at_; }

  static constexpr const char* kDamaged = "the file is damaged or is no .ptm; get a whole copy, or write it anew";

 private:
  static bool isSpace(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }
  void noteEnd(const char* what) {
    if (text_.size() < file_.size()) {
      note(std::string("expected ") + what + " within the first " + std::to_string(kMaxHeaderBytes) +
           " bytes, found a longer header");
    } else {
      note(std::string("expected ") + what + ", found the end of the file", ErrorKind::kInvalidData,
           "it is truncated; get a whole copy");
    }
  }

  const InputFile& file_;
  std::string_view text_;
  size_t at_ = 0;
  uint64_t token_offset_ = 0;
  std::optional<Error> error_;
};

// a * b + c, or nothing when it does not fit 63 bits.
std::optional<uint64_t> mulAdd(uint64_t a, uint64_t b, uint64_t c) {
  unsigned __int128 v = static_cast<unsigned __int128>(a) * b + c;
  if (v >> 63) return std::nullopt;
  return static_cast<uint64_t>(v);
}

void readJpegTables(HeaderParser& p, const InputFile& file, FileHeader& h) {
  const int n = h.header.format == PtmFormat::kJpegRgb ? 18 : 9;
  h.planes.resize(n);
  constexpr int64_t kMaxBytes = std::numeric_limits<int64_t>::max() / 64;  // 18 planes' sum cannot overflow
  p.integer("the JPEG quality", 0, 1000);
  for (auto& plane : h.planes) plane.transform = static_cast<int>(p.integer("a plane's transform", 0, 3));
  for (auto& plane : h.planes) plane.motion_x = p.integer("a motion vector's x", -kMaxJpegSide, kMaxJpegSide);
  for (auto& plane : h.planes) plane.motion_y = p.integer("a motion vector's y", -kMaxJpegSide, kMaxJpegSide);
  uint32_t seen = 0;
  for (auto& plane : h.planes) {
    plane.order = static_cast<int>(p.integer("a plane's place in the decoding order", 0, n - 1));
    if (!p.failed() && (seen >> plane.order & 1)) {
      p.note("expected each place of the decoding order once, found " + std::to_string(plane.order) + " twice");
    }
    seen |= 1u << plane.order;
  }
  for (auto& plane : h.planes) {
    plane.reference = static_cast<int>(p.integer("a plane's reference plane", -1, n - 1));
    if (p.failed()) return;
    if (plane.reference >= 0 && h.planes[plane.reference].order >= plane.order) {
      p.note("expected a reference plane that is decoded earlier, found plane " + std::to_string(plane.reference) +
             " (step " + std::to_string(h.planes[plane.reference].order) + ") for step " + std::to_string(plane.order));
    }
  }
  for (auto& plane : h.planes) plane.jpeg_bytes = p.integer("a plane's compressed size", 1, kMaxBytes);
  for (auto& plane : h.planes) {
    plane.side_bytes = p.integer("the size of a plane's side information", 0, kMaxBytes);
    if (!p.failed() && plane.side_bytes % 5 != 0) {
      p.note("expected side information in records of 5 bytes, found " + std::to_string(plane.side_bytes) + " bytes");
    }
  }
  p.lastLineEnd();
  if (p.failed()) return;
  uint64_t offset = p.offset();
  for (size_t i = 0; i < h.planes.size(); ++i) {
    auto& plane = h.planes[i];
    plane.offset = offset;
    offset += plane.jpeg_bytes + plane.side_bytes;
    if (offset > file.size()) {
      p.note("expected plane " + std::to_string(i) + " to end at byte " + std::to_string(offset) +
                 ", found the file's end at byte " + std::to_string(file.size()),
             ErrorKind::kInvalidData, "it is truncated; get a whole copy");
      return;
    }
  }
  if (file.size() - offset > kMaxTrailingBytes) {
    p.note("expected the file to end at byte " + std::to_string(offset) + ", found " + std::to_string(file.size()) +
           " bytes");
  }
}

}  // namespace

Result<FileHeader> readFileHeader(const InputFile& file) {
  std::string text(std::min(file.size(), kMaxHeaderBytes), '\0');
  if (auto read = file.read(0, {reinterpret_cast<uint8_t*>(text.data()), text.size()}); !read) return read.error();
  HeaderParser p(file, text);
  FileHeader h;

  std::string_view version = p.token("the version \"PTM_1.2\"");
  if (!p.failed()) {
    if (version == "PTM_1.1") h.header.version_minor = 1;
    else if (version == "PTM_1.2") h.header.version_minor = 2;
    else if (version.starts_with("PTM_") && version.size() < 16) {
      p.note("expected version PTM_1.1 or PTM_1.2, found " + printable(version), ErrorKind::kUnsupported,
             "convert it to PTM_1.2");
    } else {
      p.note("expected \"PTM_1.2\" at its beginning, found " + printable(version), ErrorKind::kInvalidData,
             "this is no .ptm file");
    }
  }
  std::string_view format = p.token("the format");
  if (!p.failed()) {
    using namespace std::string_view_literals;
    if (format == "PTM_FORMAT_RGB") h.header.format = PtmFormat::kRgb;
    else if (format == "PTM_FORMAT_LRGB") h.header.format = PtmFormat::kLrgb;
    else if (format == "PTM_FORMAT_LUM") h.header.format = PtmFormat::kLum;
    else if (format == "PTM_FORMAT_JPEG_RGB") h.header.format = PtmFormat::kJpegRgb;
    else if (format == "PTM_FORMAT_JPEG_LRGB") h.header.format = PtmFormat::kJpegLrgb;
    else {
      for (auto name :
           {"PTM_FORMAT_PTM_LUT"sv, "PTM_FORMAT_PTM_C_LUT"sv, "PTM_FORMAT_JPEGLS_RGB"sv, "PTM_FORMAT_JPEGLS_LRGB"sv}) {
        if (format == name) {
          p.note(std::string(name) + " is not supported", ErrorKind::kUnsupported,
                 "convert it to PTM_FORMAT_LRGB or PTM_FORMAT_RGB");
        }
      }
      p.note("expected a format PTM_FORMAT_..., found " + printable(format));
    }
  }
  const bool jpeg = h.header.format == PtmFormat::kJpegRgb || h.header.format == PtmFormat::kJpegLrgb;
  const int64_t max_side = jpeg ? kMaxJpegSide : int64_t{1} << 40;  // the file's length decides below
  h.header.width = p.integer("the width", 1, max_side);
  h.header.height = p.integer("the height", 1, max_side);
  for (double& scale : h.header.scale) {
    scale = p.number("a scale");
    // Bounds that keep every coefficient a normal single-precision number.
    if (!p.failed() && !(scale >= 1e-12 && scale <= 1e12)) {
      p.note("expected a scale from 1e-12 to 1e12, found " + std::to_string(scale));
    }
  }
  for (int& bias : h.header.bias) bias = static_cast<int>(p.integer("a bias", -1'000'000, 1'000'000));
  if (jpeg) {
    readJpegTables(p, file, h);
    if (p.failed()) return p.error();
    h.header.data_offset = h.planes[0].offset;
    return h;
  }
  if (h.header.format == PtmFormat::kLum) {
    for (double& m : h.colour_matrix) {
      m = p.number("an entry of the colour matrix");
      if (!p.failed() && std::abs(m) > 1e6)
        p.note("expected an entry of the colour matrix up to 1e6, found " + std::to_string(m));
    }
    const auto& m = h.colour_matrix;
    if (!p.failed() && !(m[1] >= 1e-6 && m[5] == m[1] && m[9] == m[1])) {
      p.note(
          "PTM_FORMAT_LUM with a colour matrix that weighs luminance differently for red, green and blue is not "
          "supported",
          ErrorKind::kUnsupported, "convert it to PTM_FORMAT_LRGB or PTM_FORMAT_RGB");
    }
  }
  p.lastLineEnd();
  if (p.failed()) return p.error();
  h.header.data_offset = p.offset();

  const uint64_t pixel_bytes = h.header.format == PtmFormat::kRgb ? 18 : h.header.format == PtmFormat::kLum ? 8 : 9;
  auto pixels = mulAdd(h.header.width, h.header.height, 0);
  auto end = pixels ? mulAdd(*pixels, pixel_bytes, h.header.data_offset) : std::nullopt;
  const std::string size_text = std::to_string(h.header.width) + " x " + std::to_string(h.header.height) + " pixels";
  if (!end || *end > file.size()) {
    return Error{ErrorKind::kInvalidData, file.path(),
                 "expected " + (end ? std::to_string(*end) : "more than 2^63") + " bytes for " + size_text +
                     ", found " + std::to_string(file.size()),
                 "it is truncated; get a whole copy", std::min(file.size(), end.value_or(file.size()))};
  }
  if (file.size() - *end > kMaxTrailingBytes) {
    return Error{
        ErrorKind::kInvalidData, file.path(),
        "expected " + std::to_string(*end) + " bytes for " + size_text + ", found " + std::to_string(file.size()),
        HeaderParser::kDamaged, *end};
  }
  return h;
}

}  // namespace ptm_detail

namespace {

using ptm_detail::FileHeader;

#if defined(__x86_64__)
// Shuffle masks: byte i of 16 of channel k lies at stride * i + k of 16 * stride interleaved bytes; mask[k][j] gathers
// what the j-th 16 of these hold of it (0x80: nothing, which pshufb turns into 0).
template <int kStride>
struct ShuffleTable {
  alignas(16) uint8_t mask[kStride][kStride][16];
  constexpr ShuffleTable() : mask() {
    for (int k = 0; k < kStride; ++k)
      for (int j = 0; j < kStride; ++j)
        for (int i = 0; i < 16; ++i) {
          int at = kStride * i + k - 16 * j;
          mask[k][j][i] = static_cast<uint8_t>(at >= 0 && at < 16 ? at : 0x80);
        }
  }
};

// As deinterleaveRow, of the pixels in whole 16s: how many.
template <int kStride>
__attribute__((target("ssse3"))) size_t deinterleaveBySsse3(const uint8_t* in, size_t pixels, uint8_t* out,
                                                            size_t channel_stride) {
  static constexpr ShuffleTable<kStride> kTable;
  size_t i = 0;
  for (; i + 16 <= pixels; i += 16) {
    __m128i block[kStride];
    for (int j = 0; j < kStride; ++j) {
      block[j] = _mm_loadu_si128(reinterpret_cast<const __m128i*>(in + i * kStride + 16 * j));
    }
    for (int k = 0; k < kStride; ++k) {
      __m128i gathered = _mm_setzero_si128();
      for (int j = 0; j < kStride; ++j) {
        auto mask = _mm_load_si128(reinterpret_cast<const __m128i*>(kTable.mask[k][j]));
        gathered = _mm_or_si128(gathered, _mm_shuffle_epi8(block[j], mask));
      }
      _mm_storeu_si128(reinterpret_cast<__m128i*>(out + k * channel_stride + i), gathered);
    }
  }
  return i;
}
#endif

// in: kStride bytes a pixel; out: one row of each channel, channel_stride bytes apart.
template <int kStride>
void deinterleaveRow(const uint8_t* in, size_t pixels, uint8_t* out, size_t channel_stride) {
  size_t i = 0;
#if defined(__x86_64__)
  if (__builtin_cpu_supports("ssse3")) i = deinterleaveBySsse3<kStride>(in, pixels, out, channel_stride);
#endif
  for (; i < pixels; ++i) {
    for (int k = 0; k < kStride; ++k) out[k * channel_stride + i] = in[i * kStride + k];
  }
}

// Calls use(y, row) for each of the rectangle's rows (y from its top), row holding its pixels' bytes. One read a row,
// or one for many rows where the rectangle is (nearly) as wide as the image: a system call costs about as much as
// copying 4 KiB, so reading what lies between the rows is worth it up to there.
template <class Use>
Result<void> readBlockRows(const InputFile& file, uint64_t block_offset, int pixel_bytes, int64_t width, int64_t height,
                           const Rect& rect, Use use) {
  constexpr uint64_t kMaxGapBytes = 4096;
  constexpr uint64_t kChunkBytes = 256 << 10;  // stays in the second-level cache until it is taken apart
  const uint64_t row_bytes = static_cast<uint64_t>(rect.width) * pixel_bytes;
  const uint64_t pitch = static_cast<uint64_t>(width) * pixel_bytes;
  const int64_t rows_a_read =
      pitch - row_bytes > kMaxGapBytes ? 1 : std::clamp<int64_t>(kChunkBytes / pitch, 1, rect.height);
  static thread_local std::vector<uint8_t> buffer;
  buffer.resize(pitch * (rows_a_read - 1) + row_bytes);
  // In the file's order, bottom row first.
  const int64_t first = height - rect.y - rect.height;
  // Rows far apart look random to the system, which then reads one at a time, at the disk's latency. As soon as one is
  // not in memory, many rows to come are asked for at once.
  constexpr int64_t kRowsAhead = 256;
  int64_t asked_to = 0;
  for (int64_t r = 0; r < rect.height; r += rows_a_read) {
    const int64_t rows = std::min(rows_a_read, rect.height - r);
    const uint64_t offset =
        block_offset + static_cast<uint64_t>(first + r) * pitch + static_cast<uint64_t>(rect.x) * pixel_bytes;
    std::span<uint8_t> bytes(buffer.data(), pitch * (rows - 1) + row_bytes);
    if (rows_a_read > 1 || !file.readIfCached(offset, bytes)) {
      for (asked_to = std::max(asked_to, r + 1); rows_a_read == 1 && asked_to < std::min(rect.height, r + kRowsAhead);
           ++asked_to) {
        file.willNeed(offset + static_cast<uint64_t>(asked_to - r) * pitch, row_bytes);
      }
      if (auto read = file.read(offset, bytes); !read) return read;
    }
    for (int64_t i = 0; i < rows; ++i) use(rect.height - 1 - (r + i), buffer.data() + i * pitch);
  }
  return {};
}

[[maybe_unused]] bool inside(const Rect& r, int64_t width, int64_t height) {
  return r.x >= 0 && r.y >= 0 && r.width >= 0 && r.height >= 0 && r.x <= width - r.width && r.y <= height - r.height;
}

class PtmSource : public TextureSource {
 public:
  PtmSource(InputFile file, FileHeader header, bool hash)
      : file_(std::move(file)), h_(std::move(header)), provenance_(file_.path(), hash) {}
  int64_t width() const override { return h_.header.width; }
  int64_t height() const override { return h_.header.height; }
  TextureFormat format() const override { return format_; }
  Provenance provenance() const override { return provenance_.get(); }

 protected:
  void setFormat(Basis basis) {
    format_.basis = basis;
    for (int k = 0; k < 6; ++k) {
      format_.scale[k] = h_.header.scale[k];
      format_.bias[k] = h_.header.bias[k];
    }
  }
  // A block of kStride bytes a pixel into channels first_channel, first_channel + channel_step, ...
  template <int kStride>
  Result<void> readBlock(uint64_t block_offset, const Rect& rect, uint8_t* out, int first_channel,
                         int channel_step) const {
    const size_t plane = static_cast<size_t>(rect.width) * rect.height;
    return readBlockRows(file_, block_offset, kStride, width(), height(), rect, [&](int64_t y, const uint8_t* row) {
      deinterleaveRow<kStride>(row, rect.width, out + first_channel * plane + y * rect.width, channel_step * plane);
    });
  }
  void checkRead(const Rect& rect, std::span<uint8_t> out) const {
    assert(inside(rect, width(), height()));
    assert(out.size() >= static_cast<size_t>(format_.channels()) * rect.width * rect.height);
    (void)rect, (void)out;
    provenance_.start();
  }

  InputFile file_;
  FileHeader h_;
  TextureFormat format_;
  FileProvenance provenance_;
};

class RawPtm final : public PtmSource {
 public:
  RawPtm(InputFile file, FileHeader header, bool hash) : PtmSource(std::move(file), std::move(header), hash) {
    setFormat(h_.header.format == PtmFormat::kRgb ? Basis::kPtmRgb : Basis::kPtmLrgb);
  }
  Result<void> read(const Rect& rect, std::span<uint8_t> out) const override {
    checkRead(rect, out);
    if (rect.width == 0 || rect.height == 0) return {};
    const uint64_t data = h_.header.data_offset;
    const uint64_t pixels = static_cast<uint64_t>(width()) * height();
    if (h_.header.format == PtmFormat::kRgb) {
      for (int c = 0; c < 3; ++c) {
        if (auto done = readBlock<6>(data + 6 * pixels * c, rect, out.data(), c, 3); !done) return done;
      }
      return {};
    }
    if (h_.header.version_minor == 1) return readBlock<9>(data, rect, out.data(), 0, 1);
    if (auto done = readBlock<6>(data, rect, out.data(), 0, 1); !done) return done;
    return readBlock<3>(data + 6 * pixels, rect, out.data(), 6, 1);
  }
};

// See the head of this file.
class LumPtm final : public PtmSource {
 public:
  LumPtm(InputFile file, FileHeader header, bool hash) : PtmSource(std::move(file), std::move(header), hash) {
    setFormat(Basis::kPtmRgb);
    const auto& m = h_.colour_matrix;
    const double weight = m[1];
    for (double& scale : std::span(format_.scale).first<6>()) scale *= weight;
    double lo_offset = 0, hi_offset = 0;
    for (int c = 0; c < 3; ++c) {
      const double* row = &m[4 * c];
      double lo = row[3], hi = row[3];
      for (double f : {row[0], row[2]}) {
        lo += std::min(f * -128, f * 127);
        hi += std::max(f * -128, f * 127);
      }
      lo_offset = c == 0 ? lo : std::min(lo_offset, lo);
      hi_offset = c == 0 ? hi : std::max(hi_offset, hi);
    }
    a5_scale_ = format_.scale[5];
    a5_bias_ = format_.bias[5];
    grey_ = lo_offset == 0 && hi_offset == 0;
    if (grey_) return;
    const double lo = (0 - a5_bias_) * a5_scale_ + lo_offset, hi = (255 - a5_bias_) * a5_scale_ + hi_offset;
    format_.scale[5] = (hi - lo) / 254;
    format_.bias[5] = std::ceil(-lo / format_.scale[5]);
  }
  Result<void> read(const Rect& rect, std::span<uint8_t> out) const override {
    checkRead(rect, out);
    if (rect.width == 0 || rect.height == 0) return {};
    const size_t plane = static_cast<size_t>(rect.width) * rect.height;
    static thread_local std::vector<uint8_t> row_channels;
    row_channels.resize(8 * static_cast<size_t>(rect.width));
    const double inverse_scale = 1 / format_.scale[5], bias = format_.bias[5];
    return readBlockRows(file_, h_.header.data_offset, 8, width(), height(), rect, [&](int64_t y, const uint8_t* row) {
      const size_t w = rect.width;
      deinterleaveRow<8>(row, w, row_channels.data(), w);
      for (int k = 0; k < 6; ++k) {
        for (int c = 0; c < 3; ++c) std::memcpy(out.data() + (3 * k + c) * plane + y * w, &row_channels[k * w], w);
      }
      if (grey_) return;
      for (int c = 0; c < 3; ++c) {
        const double* m = &h_.colour_matrix[4 * c];
        uint8_t* to = out.data() + (15 + c) * plane + y * w;
        for (size_t x = 0; x < w; ++x) {
          double a5 = (row_channels[5 * w + x] - a5_bias_) * a5_scale_ + m[0] * (row_channels[6 * w + x] - 128.0) +
                      m[2] * (row_channels[7 * w + x] - 128.0) + m[3];
          to[x] = static_cast<uint8_t>(std::clamp(std::floor(a5 * inverse_scale + bias + 0.5), 0.0, 255.0));
        }
      }
    });
  }

 private:
  double a5_scale_ = 1, a5_bias_ = 0;
  bool grey_ = false;
};

// Decoded when opened.
class JpegPtm final : public PtmSource {
 public:
  JpegPtm(InputFile file, FileHeader header, bool hash, std::vector<uint8_t> planes)
      : PtmSource(std::move(file), std::move(header), hash), planes_(std::move(planes)) {
    setFormat(h_.header.format == PtmFormat::kJpegRgb ? Basis::kPtmRgb : Basis::kPtmLrgb);
  }
  Result<void> read(const Rect& rect, std::span<uint8_t> out) const override {
    checkRead(rect, out);
    if (rect.width == 0 || rect.height == 0) return {};
    const size_t w = width(), h = height();
    uint8_t* to = out.data();
    for (int channel = 0; channel < format_.channels(); ++channel) {
      const int plane = format_.basis == Basis::kPtmRgb ? channel % 3 * 6 + channel / 3 : channel;
      for (int64_t y = rect.y; y < rect.y + rect.height; ++y, to += rect.width) {
        std::memcpy(to, planes_.data() + (plane * h + (h - 1 - y)) * w + rect.x, rect.width);
      }
    }
    return {};
  }

 private:
  std::vector<uint8_t> planes_;
};

}  // namespace

Result<PtmHeader> readPtmHeader(const std::string& path) {
  auto file = InputFile::open(path);
  if (!file) return file.error();
  auto header = ptm_detail::readFileHeader(*file);
  if (!header) return header.error();
  return header->header;
}

Result<std::unique_ptr<TextureSource>> openPtm(const std::string& path, const PtmOpenOptions& options) {
  auto file = InputFile::open(path);
  if (!file) return file.error();
  auto header = ptm_detail::readFileHeader(*file);
  if (!header) return header.error();
  switch (header->header.format) {
    case PtmFormat::kRgb:
    case PtmFormat::kLrgb:
      return std::unique_ptr<TextureSource>(new RawPtm(std::move(*file), std::move(*header), options.hash));
    case PtmFormat::kLum:
      return std::unique_ptr<TextureSource>(new LumPtm(std::move(*file), std::move(*header), options.hash));
    case PtmFormat::kJpegRgb:
    case PtmFormat::kJpegLrgb: {
      auto planes = ptm_detail::decodeJpegPlanes(*file, *header, options.memory_budget_bytes);
      if (!planes) return planes.error();
      return std::unique_ptr<TextureSource>(
          new JpegPtm(std::move(*file), std::move(*header), options.hash, std::move(*planes)));
    }
  }
  return Error{ErrorKind::kUnsupported, path, "unknown format", "", {}};
}

}  // namespace relievo
