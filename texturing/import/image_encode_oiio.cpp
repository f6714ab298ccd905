// image_encode_oiio.cpp - TIFF, EXR and JPEG by OpenImageIO, through the program's own file (ImageBytes); what was
// written is decoded again.
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <OpenImageIO/typedesc.h>
#include <xxhash.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <mutex>
#include <new>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "texturing/import/image_oiio.h"
#include "texturing/import/image_sniff.h"
#include "texturing/import/tiff_frame.h"

namespace relievo {
namespace {

// OpenImageIO's view of ImageBytes. What a library does not notice stays: the first write that failed is the image's
// error.
class BytesProxy final : public OIIO::Filesystem::IOProxy {
 public:
  BytesProxy(ImageBytes& bytes, Mode mode) : IOProxy("", mode), bytes_(bytes) {}
  const char* proxytype() const override { return "relievo"; }
  size_t read(void* to, size_t size) override {
    const size_t n = pread(to, size, m_pos);
    m_pos += static_cast<int64_t>(n);
    return n;
  }
  size_t write(const void* from, size_t size) override {
    const size_t n = pwrite(from, size, m_pos);
    m_pos += static_cast<int64_t>(n);
    return n;
  }
  size_t pread(void* to, size_t size, int64_t offset) override {
    const std::lock_guard lock(mutex_);
    const uint64_t end = bytes_.size();
    if (offset < 0 || static_cast<uint64_t>(offset) >= end) return 0;
    size = static_cast<size_t>(std::min<uint64_t>(size, end - static_cast<uint64_t>(offset)));
    return calls_.keep([&] {
      return bytes_.read(static_cast<uint64_t>(offset), {static_cast<uint8_t*>(to), size});
    })
               ? size
               : 0;
  }
  size_t pwrite(const void* from, size_t size, int64_t offset) override {
    const std::lock_guard lock(mutex_);
    if (offset < 0 || calls_.broken()) return 0;
    end_ = std::max(end_, static_cast<uint64_t>(offset) + size);
    return calls_.keep([&] {
      return bytes_.write(static_cast<uint64_t>(offset), {static_cast<const uint8_t*>(from), size});
    })
               ? size
               : 0;
  }
  size_t size() const override { return bytes_.size(); }
  const std::optional<Error>& failed() const { return calls_.failed(); }
  uint64_t end() const { return end_; }  // of what was written

 private:
  ImageBytes& bytes_;
  std::mutex mutex_;
  ImageBytesCalls calls_;
  uint64_t end_ = 0;
};

OIIO::TypeDesc typeOf(SampleType type) {
  switch (type) {
    case SampleType::kUint8:
      return OIIO::TypeUInt8;
    case SampleType::kUint16:
      return OIIO::TypeUInt16;
    case SampleType::kHalf:
      return OIIO::TypeHalf;
    default:
      return OIIO::TypeFloat;
  }
}

const char* nameOf(ImageFormat format) {
  switch (format) {
    case ImageFormat::kTiff:
      return "tiff";
    case ImageFormat::kExr:
      return "openexr";
    default:
      return "jpeg";
  }
}

// How large to print it, as exactly as the format can say; nothing where it is less than a pixel a metre, or more than
// can be counted.
void setResolution(OIIO::ImageSpec& spec, ImageFormat format, double mm_per_px) {
  const double px_per_m = 1000 / mm_per_px;
  if (!(mm_per_px > 0) || px_per_m < 1 || px_per_m >= 2e9) return;
  double px = px_per_m / 100;
  const char* unit = "cm";
  if (format == ImageFormat::kJpeg) {
    // JFIF counts whole pixels, up to 16 bits, a centimetre or an inch: whichever is nearer.
    const double px_per_inch = px * 2.54;
    const auto off = [](double v) { return std::abs(std::round(v) - v) / v; };
    if (off(px_per_inch) < off(px)) px = px_per_inch, unit = "in";
    px = std::round(px);
    if (px < 1 || px > 65535) return;
  } else if (format == ImageFormat::kExr) {
    px *= 2.54, unit = "in";  // its xDensity is pixels an inch
  }
  spec.attribute("ResolutionUnit", unit);
  for (const char* axis : {"XResolution", "YResolution"}) spec.attribute(axis, static_cast<float>(px));
}

// Encodes through OpenImageIO, then decodes what it wrote: the library's own word that all went well is not enough, as
// its close() knows nothing of a full disk. TIFFs, which are uncompressed, are written here: through a proxy
// OpenImageIO 2.4 ends them with a directory that is not the image's.
class OiioEncoder final : public ImageEncoder {
 public:
  OiioEncoder(const ImageEncoding& encoding, ImageBytes& bytes)
      : encoding_(encoding), bytes_(bytes), proxy_(bytes, BytesProxy::Write), hash_(XXH3_createState()) {
    XXH3_64bits_reset(hash_);
  }
  ~OiioEncoder() override {
    try {
      if (output_) output_->close();
    } catch (const std::exception&) {  // what is given up may be broken
    }
    XXH3_freeState(hash_);
  }
  Result<void> open() {
    return guard("creating", [&]() -> Result<void> {
      spec_ = OIIO::ImageSpec(static_cast<int>(encoding_.width), static_cast<int>(encoding_.height), encoding_.channels,
                              typeOf(encoding_.type));
      const bool exr = encoding_.format == ImageFormat::kExr;
      if (!exr) spec_.attribute("oiio:UnassociatedAlpha", 1);
      if (exr) {
        spec_.attribute("oiio:ColorSpace", "Linear");
        spec_.attribute("compression", "zip");
        spec_.attribute("DateTime", "");  // or it writes the time, and the same picture has other bytes
      } else if (encoding_.type == SampleType::kUint8 && encoding_.channels >= 3) {
        spec_.attribute("oiio:ColorSpace", "sRGB");
      }
      if (encoding_.format == ImageFormat::kJpeg) {
        spec_.attribute("compression", "jpeg:95");
        spec_.attribute("jpeg:subsampling", "4:4:4");
      }
      if (encoding_.format == ImageFormat::kTiff) {
        // Uncompressed: read anywhere at any speed; deflate would take longer than everything before it.
        tiff_ = {encoding_.width,
                 encoding_.height,
                 encoding_.channels,
                 static_cast<int>(spec_.format.size()),
                 spec_.format.is_floating_point(),
                 encoding_.mm_per_px > 0 ? 10 / encoding_.mm_per_px : 0};
        return put(tiffHead(*tiff_));
      }
      setResolution(spec_, encoding_.format, encoding_.mm_per_px);
      output_ = OIIO::ImageOutput::create(nameOf(encoding_.format));
      if (!output_ || !output_->supports("ioproxy")) {
        return Error{ErrorKind::kUnsupported,
                     encoding_.path,
                     std::string("this build of OpenImageIO does not write ") + nameOf(encoding_.format),
                     "name a .png",
                     {}};
      }
      output_->set_ioproxy(&proxy_);
      return output_->open(encoding_.path, spec_) ? Result<void>() : failure("creating", output_->geterror());
    });
  }
  Result<void> appendRows(int64_t rows, const void* samples) override {
    assert(rows >= 0 && next_row_ + rows <= spec_.height);
    return guard("writing", [&]() -> Result<void> {
      if (tiff_) {
        if (auto done = put({static_cast<const uint8_t*>(samples), static_cast<size_t>(rows) * spec_.scanline_bytes()});
            !done)
          return done;
      } else if (!output_->write_scanlines(static_cast<int>(next_row_), static_cast<int>(next_row_ + rows), 0,
                                           spec_.format, samples) ||
                 proxy_.failed()) {
        return failure("writing", output_->geterror());
      }
      XXH3_64bits_update(hash_, samples, static_cast<size_t>(rows) * spec_.scanline_bytes());
      next_row_ += rows;
      return {};
    });
  }
  Result<void> finish() override {
    assert(next_row_ == spec_.height);
    auto closed = guard("writing", [&]() -> Result<void> {
      if (tiff_) return put(tiffTail(*tiff_));
      const bool good = output_->close();
      if (!good || proxy_.failed()) return failure("writing", output_->geterror());
      output_.reset();
      return {};
    });
    if (!closed) return closed;
    return guard("reading it back", [&] { return decodes(); });
  }

 private:
  Result<void> put(std::span<const uint8_t> bytes) {
    return proxy_.write(bytes.data(), bytes.size()) == bytes.size() ? Result<void>() : failure("writing", "");
  }
  template <class Call>
  Result<void> guard(const char* doing, Call call) {
    try {
      return call();
    } catch (const std::bad_alloc&) {
      throw;  // the program's to tell
    } catch (const std::exception& e) {
      return failure(doing, e.what());
    }
  }
  Error failure(const char* doing, const std::string& why) const {
    if (proxy_.failed()) return *proxy_.failed();
    return {ErrorKind::kIo, encoding_.path, std::string(doing) + " failed: " + oneLine(why), "is the disk full?", {}};
  }
  Result<void> decodes() {
    // The reader of JPEGs takes no proxies but the library's own: of a file, and of bytes in memory.
    std::vector<uint8_t> all(encoding_.format == ImageFormat::kJpeg ? static_cast<size_t>(bytes_.size()) : 0);
    if (auto read = bytes_.read(0, all); !read) return read;
    OIIO::Filesystem::IOMemReader memory(all.data(), all.size());
    BytesProxy proxy(bytes_, BytesProxy::Read);
    const auto broken = [&](const std::string& why) -> Error {
      if (proxy.failed()) return *proxy.failed();
      return {ErrorKind::kIo,
              encoding_.path,
              "what was written does not read back: " + oneLine(why),
              "is the disk full, or damaged?",
              {}};
    };
    if (bytes_.size() != proxy_.end())
      return broken("expected " + std::to_string(proxy_.end()) + " bytes, found " + std::to_string(bytes_.size()));
    const OIIO::ImageSpec config = openConfig();
    auto input = OIIO::ImageInput::create(nameOf(encoding_.format));
    if (!input) return broken(OIIO::geterror());
    OIIO::ImageSpec found;
    if (all.empty()) input->set_ioproxy(&proxy);
    else input->set_ioproxy(&memory);
    if (!input->open(encoding_.path, found, config)) return broken(input->geterror());
    if (found.width != spec_.width || found.height != spec_.height || found.nchannels != spec_.nchannels ||
        found.format != spec_.format)
      return broken("expected " + described(spec_) + ", found " + described(found));
    const size_t row_bytes = spec_.scanline_bytes();
    const int band = std::clamp(static_cast<int>(kBandBytes / std::max<size_t>(row_bytes, 1)), 1, spec_.height);
    std::vector<uint8_t> rows(static_cast<size_t>(band) * row_bytes);
    XXH3_state_t* state = XXH3_createState();
    XXH3_64bits_reset(state);
    bool good = true;
    for (int y = 0; y < spec_.height && good; y += band) {
      const int end = std::min(y + band, spec_.height);
      good = input->read_scanlines(0, 0, found.y + y, found.y + end, 0, 0, found.nchannels,
                                   OIIO::TypeDesc(OIIO::TypeDesc::UNKNOWN), rows.data()) &&
             !input->has_error();
      if (good) XXH3_64bits_update(state, rows.data(), static_cast<size_t>(end - y) * row_bytes);
    }
    const bool same = XXH3_64bits_digest(state) == XXH3_64bits_digest(hash_);
    XXH3_freeState(state);
    if (!good) return broken(input->geterror());
    if (!same && encoding_.format != ImageFormat::kJpeg) return broken("its samples are others");
    return {};
  }
  static std::string described(const OIIO::ImageSpec& s) {
    return std::to_string(s.width) + " x " + std::to_string(s.height) + " x " + std::to_string(s.nchannels) +
           " of type " + s.format.c_str();
  }

  ImageEncoding encoding_;
  ImageBytes& bytes_;
  BytesProxy proxy_;
  XXH3_state_t* hash_;  // of the rows as they came
  OIIO::ImageSpec spec_;
  std::optional<TiffFrame> tiff_;
  std::unique_ptr<OIIO::ImageOutput> output_;  // of other formats
  int64_t next_row_ = 0;
};

}  // namespace

Result<std::unique_ptr<ImageEncoder>> createOiioEncoder(const ImageEncoding& e, ImageBytes& bytes) {
  const bool jpeg = e.format == ImageFormat::kJpeg;
  const int64_t max_side = jpeg ? 65500 : std::numeric_limits<int>::max();
  if (e.width < 1 || e.height < 1 || e.width > max_side || e.height > max_side) {
    return Error{ErrorKind::kUsage,
                 e.path,
                 "expected sides from 1 to " + std::to_string(max_side) + ", found " + std::to_string(e.width) + " x " +
                     std::to_string(e.height),
                 "",
                 {}};
  }
  if (jpeg && e.channels != 1 && e.channels != 3)
    return Error{ErrorKind::kUsage,
                 e.path,
                 "a JPEG has 1 or 3 channels, found " + std::to_string(e.channels),
                 "name a .png",
                 {}};
  auto encoder = std::make_unique<OiioEncoder>(e, bytes);
  if (auto opened = encoder->open(); !opened) return opened.error();
  return std::unique_ptr<ImageEncoder>(std::move(encoder));
}

void halvesFromFloatsByOiio(std::span<const float> floats, uint16_t* halves) {
  constexpr size_t kPiece = size_t{1} << 20;  // the library counts in int
  for (size_t i = 0; i < floats.size(); i += kPiece)
    OIIO::convert_pixel_values(OIIO::TypeFloat, floats.data() + i, OIIO::TypeHalf, halves + i,
                               static_cast<int>(std::min(kPiece, floats.size() - i)));
}

}  // namespace relievo
