#include "texturing/import/png_encoder.h"

#include <png.h>
#include <xxhash.h>

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <csetjmp>
#include <cstdlib>
#include <limits>
#include <new>
#include <optional>
#include <string>
#include <vector>

namespace relievo {
namespace {

// One writer or reader of libpng. Its errors come back by longjmp, across frames in C alone: what is called within
// attempt() has nothing to destroy.
class PngStream {
 public:
  PngStream(ImageBytes& bytes, bool reads) : bytes_(bytes), reads_(reads) {
    png_ = reads ? png_create_read_struct_2(PNG_LIBPNG_VER_STRING, this, onError, onWarning, this, allocate, release)
                 : png_create_write_struct_2(PNG_LIBPNG_VER_STRING, this, onError, onWarning, this, allocate, release);
    if (!png_) throw std::bad_alloc();
    info_ = png_create_info_struct(png_);
    if (!info_) {
      destroy();
      throw std::bad_alloc();
    }
    if (reads) png_set_read_fn(png_, this, onRead);
    else png_set_write_fn(png_, this, onWrite, onFlush);
    // Otherwise it refuses sides above a million pixels.
    png_set_user_limits(png_, PNG_UINT_31_MAX, PNG_UINT_31_MAX);
  }
  PngStream(const PngStream&) = delete;
  PngStream& operator=(const PngStream&) = delete;
  ~PngStream() { destroy(); }

  png_structp png() const { return png_; }
  png_infop info() const { return info_; }
  uint64_t position() const { return position_; }
  const std::string& why() const { return why_; }
  const std::optional<Error>& failed() const { return calls_.failed(); }  // of bytes, the first

  template <class Call>
  bool attempt(Call call) {
    if (setjmp(png_jmpbuf(png_))) {
      if (calls_.outOfMemory()) throw std::bad_alloc();
      return false;
    }
    call();
    return true;
  }

 private:
  void destroy() {
    if (reads_) png_destroy_read_struct(&png_, &info_, nullptr);
    else png_destroy_write_struct(&png_, &info_);
  }
  static PngStream& of(void* pointer) { return *static_cast<PngStream*>(pointer); }
  static png_voidp allocate(png_structp png, png_alloc_size_t size) {
    void* memory = std::malloc(size);
    if (!memory) of(png_get_mem_ptr(png)).calls_.noteOutOfMemory();
    return memory;
  }
  static void release(png_structp, png_voidp memory) { std::free(memory); }
  [[noreturn]] static void onError(png_structp png, png_const_charp message) {
    of(png_get_error_ptr(png)).note(message);
    png_longjmp(png, 1);
  }
  static void onWarning(png_structp, png_const_charp) {}
  static void onFlush(png_structp) {}
  static void onWrite(png_structp png, png_bytep from, size_t size) {
    PngStream& stream = of(png_get_io_ptr(png));
    if (!stream.calls_.keep([&] { return stream.bytes_.write(stream.position_, {from, size}); }))
      png_error(png, "write");
    stream.position_ += size;
  }
  static void onRead(png_structp png, png_bytep to, size_t size) {
    PngStream& stream = of(png_get_io_ptr(png));
    if (size > stream.bytes_.size() - stream.position_) png_error(png, "it ends too early");
    if (!stream.calls_.keep([&] { return stream.bytes_.read(stream.position_, {to, size}); })) png_error(png, "read");
    stream.position_ += size;
  }
  void note(const char* message) noexcept {
    try {
      why_ = message;
    } catch (const std::bad_alloc&) {
      calls_.noteOutOfMemory();
    }
  }
  ImageBytes& bytes_;
  const bool reads_;
  png_structp png_ = nullptr;
  png_infop info_ = nullptr;
  uint64_t position_ = 0;
  std::string why_;
  ImageBytesCalls calls_;
};

constexpr int kColourTypes[] = {PNG_COLOR_TYPE_GRAY, PNG_COLOR_TYPE_GRAY_ALPHA, PNG_COLOR_TYPE_RGB,
                                PNG_COLOR_TYPE_RGB_ALPHA};

class PngEncoder final : public ImageEncoder {
 public:
  PngEncoder(const ImageEncoding& encoding, ImageBytes& bytes)
      : encoding_(encoding), bytes_(bytes), out_(bytes, false), hash_(XXH3_createState()) {
    if (!hash_) throw std::bad_alloc();
    XXH3_64bits_reset(hash_);
  }
  ~PngEncoder() override { XXH3_freeState(hash_); }

  Result<void> open() {
    const bool good = out_.attempt([&] {
      png_structp png = out_.png();
      png_set_IHDR(png, out_.info(), static_cast<png_uint_32>(encoding_.width),
                   static_cast<png_uint_32>(encoding_.height), bits(), kColourTypes[encoding_.channels - 1],
                   PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
      if (bits() == 8) png_set_sRGB_gAMA_and_cHRM(png, out_.info(), PNG_sRGB_INTENT_ABSOLUTE);
      const double px_per_m = encoding_.mm_per_px > 0 ? std::round(1000 / encoding_.mm_per_px) : 0;
      if (px_per_m >= 1 && px_per_m < 2e9) {
        const auto whole = static_cast<png_uint_32>(px_per_m);
        png_set_pHYs(png, out_.info(), whole, whole, PNG_RESOLUTION_METER);
      }
      png_write_info(png, out_.info());
      if (bits() == 16 && std::endian::native == std::endian::little) png_set_swap(png);
    });
    return good ? Result<void>() : failure();
  }
  Result<void> appendRows(int64_t rows, const void* samples) override {
    assert(rows >= 0 && next_row_ + rows <= encoding_.height);
    const auto* first = static_cast<const uint8_t*>(samples);
    const bool good = out_.attempt([&] {
      for (int64_t y = 0; y < rows; ++y) png_write_row(out_.png(), first + static_cast<size_t>(y) * rowBytes());
    });
    if (!good) return failure();
    XXH3_64bits_update(hash_, samples, static_cast<size_t>(rows) * rowBytes());
    next_row_ += rows;
    return {};
  }
  Result<void> finish() override {
    assert(next_row_ == encoding_.height);
    if (!out_.attempt([&] { png_write_end(out_.png(), out_.info()); })) return failure();
    return decodes();
  }

 private:
  int bits() const { return encoding_.type == SampleType::kUint16 ? 16 : 8; }
  size_t rowBytes() const {
    return static_cast<size_t>(encoding_.width) * static_cast<size_t>(encoding_.channels * bits() / 8);
  }
  Error failure() const {
    if (out_.failed()) return *out_.failed();
    return {ErrorKind::kIo, encoding_.path, "writing failed: " + out_.why(), "is the disk full?", {}};
  }
  // What a full or damaged disk made of it shows only here.
  Result<void> decodes() {
    PngStream in(bytes_, true);
    const auto broken = [&](const std::string& why) -> Error {
      if (in.failed()) return *in.failed();
      return {ErrorKind::kIo,
              encoding_.path,
              "what was written does not read back: " + why,
              "is the disk full, or damaged?",
              {}};
    };
    if (bytes_.size() != out_.position())
      return broken("expected " + std::to_string(out_.position()) + " bytes, found " + std::to_string(bytes_.size()));
    if (!in.attempt([&] { png_read_info(in.png(), in.info()); })) return broken(in.why());
    if (png_get_image_width(in.png(), in.info()) != static_cast<png_uint_32>(encoding_.width) ||
        png_get_image_height(in.png(), in.info()) != static_cast<png_uint_32>(encoding_.height) ||
        png_get_rowbytes(in.png(), in.info()) != rowBytes())
      return broken("its header says something else");
    std::vector<uint8_t> row(rowBytes());
    XXH3_state_t* state = XXH3_createState();
    if (!state) throw std::bad_alloc();
    const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> held(state, XXH3_freeState);
    XXH3_64bits_reset(state);
    const bool good = in.attempt([&] {
      if (bits() == 16 && std::endian::native == std::endian::little) png_set_swap(in.png());
      for (int64_t y = 0; y < encoding_.height; ++y) {
        png_read_row(in.png(), row.data(), nullptr);
        XXH3_64bits_update(state, row.data(), row.size());
      }
      png_read_end(in.png(), nullptr);
    });
    if (!good) return broken(in.why());
    if (XXH3_64bits_digest(state) != XXH3_64bits_digest(hash_)) return broken("its samples are others");
    return {};
  }

  ImageEncoding encoding_;
  ImageBytes& bytes_;
  PngStream out_;
  XXH3_state_t* hash_;  // of the rows as they came
  int64_t next_row_ = 0;
};

}  // namespace

Result<std::unique_ptr<ImageEncoder>> createPngEncoder(const ImageEncoding& e, ImageBytes& bytes) {
  assert(e.channels >= 1 && e.channels <= 4 && (e.type == SampleType::kUint8 || e.type == SampleType::kUint16));
  constexpr int64_t kLongest = std::numeric_limits<int32_t>::max();
  if (e.width < 1 || e.height < 1 || e.width > kLongest || e.height > kLongest) {
    return Error{ErrorKind::kUsage,
                 e.path,
                 "expected sides from 1 to " + std::to_string(kLongest) + ", found " + std::to_string(e.width) + " x " +
                     std::to_string(e.height),
                 "",
                 {}};
  }
  auto encoder = std::make_unique<PngEncoder>(e, bytes);
  if (auto opened = encoder->open(); !opened) return opened.error();
  return std::unique_ptr<ImageEncoder>(std::move(encoder));
}

}  // namespace relievo
