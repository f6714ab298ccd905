// image_io_oiio.cpp - the only user of OpenImageIO: a module of its own, which image_io.cpp loads when an image is first read or
// written.
//
// Reading. Images may be larger than memory and are asked for in rectangles about as wide as high, from left to right, then
// downwards, by several threads at once; most files hold (compressed) strips or rows. So rows are decoded in bands as wide
// as the image and kept in a bounded cache, least recently used out first: each row is decoded once as long as the rows
// of one rectangle, at the image's full width, fit (cache_bytes, more where a rectangle's rows need it).
// Formats that can only be read from the top (PNG, JPEG) are decoded in order: skipped bands are decoded and kept on the way.
//
// Nothing from OpenImageIO escapes: errors become Results, exceptions are caught at each call.
#include "texturing/image_io_module.h"

#include <OpenImageIO/imageio.h>
#include <OpenImageIO/typedesc.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <limits>
#include <map>
#include <mutex>

#include "src/base/file.h"
#include "texturing/file_provenance.h"

namespace relievo {
namespace {

constexpr uint64_t kMaxCacheBytes = uint64_t{1} << 30;  // for images so wide that a rectangle's rows exceed cache_bytes
constexpr uint64_t kBandBytes = uint64_t{4} << 20;      // as many rows as fit, at least one (or one row of tiles)
// The best that formats in use pack is about 1:1000 (deflate), lossy ones some more on a blank image; a file that claims
// more than this times its own length is damaged, and must not make us allocate what it claims.
constexpr uint64_t kMaxPacking = 20000;
constexpr uint64_t kPackingSlackBytes = uint64_t{1} << 20;
constexpr int64_t kMaxSide = int64_t{1} << 30;

constexpr const char* kDamagedHint = "the file is damaged or cut short; get a whole copy, or write it anew";

// Pixels as stored: no premultiplication, no palette or alpha magic.
OIIO::ImageSpec openConfig() {
  OIIO::ImageSpec config;
  config.attribute("oiio:UnassociatedAlpha", 1);
  return config;
}

std::string oneLine(std::string text) {
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20) c = ' ';
  }
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return text.empty() ? "no reason given" : text;
}

// Runs what calls OpenImageIO; its exceptions (out of memory, damaged files in some readers) become errors.
template <class Call>
auto guarded(const std::string& path, Call call) -> decltype(call()) {
  try {
    return call();
  } catch (const std::exception& e) {
    return Error{ErrorKind::kInvalidData, path, "reading the image failed: " + oneLine(e.what()), kDamagedHint, {}};
  }
}

struct OpenImage {
  std::unique_ptr<OIIO::ImageInput> input;
  OIIO::ImageSpec spec;
  uint64_t file_bytes = 0;
};

Result<OpenImage> openImage(const std::string& path) {
  // The file first, for errors that say what is the matter: OpenImageIO calls a missing file an unknown format.
  auto file = InputFile::open(path);
  if (!file) return file.error();
  if (file->size() == 0) {
    return Error{ErrorKind::kInvalidData, path, "expected an image, found an empty file", kDamagedHint, uint64_t{0}};
  }
  OpenImage image;
  image.file_bytes = file->size();
  const OIIO::ImageSpec config = openConfig();
  image.input = OIIO::ImageInput::open(path, &config);
  if (!image.input) {
    return Error{ErrorKind::kInvalidData, path, "expected an image, found: " + oneLine(OIIO::geterror()),
                 "the file is damaged, or of a format that this build of OpenImageIO does not read", {}};
  }
  image.spec = image.input->spec();
  const auto& s = image.spec;
  if (s.width < 1 || s.height < 1 || s.width > kMaxSide || s.height > kMaxSide || s.nchannels < 1 || s.depth > 1) {
    return Error{ErrorKind::kInvalidData, path,
                 "expected a flat image, found " + std::to_string(s.width) + " x " + std::to_string(s.height) + " x " +
                     std::to_string(s.depth) + " with " + std::to_string(s.nchannels) + " channels",
                 kDamagedHint, {}};
  }
  const unsigned __int128 bytes = static_cast<unsigned __int128>(s.width) * s.height * s.pixel_bytes(true);
  if (bytes > static_cast<unsigned __int128>(image.file_bytes) * kMaxPacking + kPackingSlackBytes) {
    return Error{ErrorKind::kInvalidData, path,
                 "expected at least " + std::to_string(static_cast<uint64_t>(bytes / kMaxPacking)) + " bytes for " +
                     std::to_string(s.width) + " x " + std::to_string(s.height) + " pixels, found " +
                     std::to_string(image.file_bytes),
                 kDamagedHint, {}};
  }
  return image;
}

// Bands of decoded rows of one image, shared by the threads that read it.
class BandCache {
 public:
  BandCache(std::string path, OpenImage image, OIIO::TypeDesc type, int channels, uint64_t cache_bytes)
      : path_(std::move(path)), image_(std::move(image)), type_(type), channels_(channels), capacity_(cache_bytes) {
    const auto& s = image_.spec;
    row_bytes_ = static_cast<size_t>(s.width) * channels * type.size();
    band_rows_ = std::clamp<int64_t>(static_cast<int64_t>(std::min(kBandBytes, cache_bytes / 8) / row_bytes_), 1, s.height);
    if (s.tile_height > 0) {
      band_rows_ = std::max<int64_t>(band_rows_ / s.tile_height, 1) * s.tile_height;
    } else if (int strip = s.get_int_attribute("tiff:RowsPerStrip", 1); strip > 1 && strip <= band_rows_) {
      band_rows_ = band_rows_ / strip * strip;
    }
    // A PNG or JPEG that is asked for an earlier row is decoded again from its top.
    const std::string_view format = image_.input->format_name();
    sequential_ = format != "tiff" && format != "openexr";
  }

  int64_t width() const { return image_.spec.width; }
  int64_t height() const { return image_.spec.height; }
  int64_t bandRows() const { return band_rows_; }
  const std::string& path() const { return path_; }

  // Calls use(y, pixels of the whole row y) for the rows y0 .. y0 + rows - 1.
  template <class Use>
  Result<void> rows(int64_t y0, int64_t rows, Use use) {
    for (int64_t band = y0 / band_rows_; band * band_rows_ < y0 + rows; ++band) {
      auto held = get(band, rows);
      if (!held) return held.error();
      const int64_t first = band * band_rows_;
      for (int64_t y = std::max(y0, first); y < std::min(y0 + rows, first + band_rows_); ++y) {
        use(y, (*held)->data() + static_cast<size_t>(y - first) * row_bytes_);
      }
    }
    return {};
  }

 private:
  using Band = std::shared_ptr<std::vector<uint8_t>>;
  struct Entry {
    Band band;  // null: being decoded
    uint64_t last_use = 0;
  };

  Result<Band> get(int64_t band, int64_t rows_wanted) {
    std::unique_lock lock(mutex_);
    const uint64_t bands_wanted = static_cast<uint64_t>(rows_wanted / band_rows_ + 3);
    capacity_ = std::max(capacity_, std::min(kMaxCacheBytes, bands_wanted * band_rows_ * row_bytes_));
    for (;;) {
      auto it = bands_.find(band);
      if (it == bands_.end()) break;
      if (it->second.band) {
        it->second.last_use = ++clock_;
        return it->second.band;
      }
      decoded_.wait(lock);
    }
    // What a sequential format passes over on the way is decoded (by this call) and kept, if it fits the cache.
    int64_t from = band;
    if (sequential_ && next_band_ < band && uint64_t(band - next_band_) * band_rows_ * row_bytes_ < capacity_ / 2) {
      from = next_band_;
    }
    Band wanted;
    for (int64_t b = from; b <= band; ++b) {
      if (bands_.contains(b)) continue;  // there, or coming from another thread
      bands_[b];
      next_band_ = std::max(next_band_, b + 1);
      lock.unlock();
      auto decoded = decode(b);
      lock.lock();
      if (!decoded) {
        bands_.erase(b);
        decoded_.notify_all();
        return decoded.error();
      }
      bands_[b] = {*decoded, ++clock_};
      held_bytes_ += (*decoded)->size();
      evict();
      decoded_.notify_all();
      if (b == band) wanted = *decoded;
    }
    if (wanted) return wanted;
    lock.unlock();
    return get(band, rows_wanted);  // another thread took it on meanwhile
  }

  void evict() {
    while (held_bytes_ > capacity_) {
      auto oldest = bands_.end();
      for (auto it = bands_.begin(); it != bands_.end(); ++it) {
        if (it->second.band && (oldest == bands_.end() || it->second.last_use < oldest->second.last_use)) oldest = it;
      }
      if (oldest == bands_.end()) return;
      held_bytes_ -= oldest->second.band->size();
      bands_.erase(oldest);
    }
  }

  Result<Band> decode(int64_t band) {
    std::lock_guard lock(input_mutex_);
    return guarded(path_, [&]() -> Result<Band> {
      const auto& s = image_.spec;
      const int64_t first = band * band_rows_;
      const int64_t end = std::min<int64_t>(first + band_rows_, s.height);
      auto out = std::make_shared<std::vector<uint8_t>>(static_cast<size_t>(end - first) * row_bytes_);
      const int y0 = s.y + static_cast<int>(first), y1 = s.y + static_cast<int>(end);
      // Samples that need no conversion are asked for as they are: for any type that is named OpenImageIO takes a buffer of 64 MiB on the way.
      const bool as_stored = s.format == type_ && s.channelformats.empty();
      const OIIO::TypeDesc type = as_stored ? OIIO::TypeDesc(OIIO::TypeDesc::UNKNOWN) : type_;
      const bool ok = s.tile_width > 0
                          ? image_.input->read_tiles(0, 0, s.x, s.x + s.width, y0, y1, s.z, s.z + 1, 0, channels_, type, out->data())
                          : image_.input->read_scanlines(0, 0, y0, y1, s.z, 0, channels_, type, out->data());
      if (!ok || image_.input->has_error()) {
        return Error{ErrorKind::kInvalidData, path_,
                     "rows " + std::to_string(first) + " to " + std::to_string(end - 1) + " do not decode: " +
                         oneLine(image_.input->geterror()),
                     kDamagedHint, {}};
      }
      return out;
    });
  }

  std::string path_;
  OpenImage image_;
  OIIO::TypeDesc type_;
  int channels_;
  size_t row_bytes_ = 0;
  int64_t band_rows_ = 1;
  bool sequential_ = false;

  std::mutex input_mutex_;  // decoding, one band at a time (OpenImageIO itself decodes a band's strips in parallel)
  std::mutex mutex_;        // everything below
  std::condition_variable decoded_;
  std::map<int64_t, Entry> bands_;
  int64_t next_band_ = 0;
  uint64_t held_bytes_ = 0, capacity_, clock_ = 0;
};

class ColourImage final : public TextureSource {
 public:
  ColourImage(std::string path, OpenImage image, uint64_t cache_bytes)
      : provenance_(path, true),
        channels_(image.spec.nchannels >= 3 ? 3 : 1),
        cache_(std::move(path), std::move(image), OIIO::TypeUInt8, channels_, cache_bytes) {}
  int64_t width() const override { return cache_.width(); }
  int64_t height() const override { return cache_.height(); }
  TextureFormat format() const override { return {}; }
  Provenance provenance() const override { return provenance_.get(); }
  Result<void> read(const Rect& rect, std::span<uint8_t> out) const override {
    provenance_.start();
    const size_t plane = static_cast<size_t>(rect.width) * rect.height;
    assert(out.size() >= 3 * plane);
    return cache_.rows(rect.y, rect.height, [&](int64_t y, const uint8_t* row) {
      uint8_t* to = out.data() + static_cast<size_t>(y - rect.y) * rect.width;
      const uint8_t* from = row + rect.x * channels_;
      if (channels_ == 1) {
        for (int c = 0; c < 3; ++c) std::memcpy(to + c * plane, from, rect.width);
        return;
      }
      for (int c = 0; c < 3; ++c) {
        for (int64_t x = 0; x < rect.width; ++x) to[c * plane + x] = from[3 * x + c];
      }
    });
  }

 private:
  FileProvenance provenance_;
  int channels_;
  mutable BandCache cache_;
};

// Heights in mm = offset + scale * sample.
class HeightImage final : public HeightSource {
 public:
  HeightImage(std::string path, OpenImage image, OIIO::TypeDesc type, double offset, double scale, uint64_t cache_bytes)
      : provenance_(path, true),
        type_(type),
        offset_(offset),
        scale_(scale),
        cache_(std::move(path), std::move(image), type, 1, cache_bytes) {}
  int64_t width() const override { return cache_.width(); }
  int64_t height() const override { return cache_.height(); }
  double minMm() const override { return min_mm_; }
  double maxMm() const override { return max_mm_; }
  Provenance provenance() const override { return provenance_.get(); }

  void setRange(double min_mm, double max_mm) { min_mm_ = min_mm, max_mm_ = max_mm; }
  // Floats: the range of the heights by reading all of them; the place of the first that is not a number.
  Result<void> scanRange() {
    float lo = std::numeric_limits<float>::infinity(), hi = -lo;
    int64_t bad_x = -1, bad_y = -1;
    auto scanned = cache_.rows(0, height(), [&](int64_t y, const uint8_t* row) {
      if (bad_y >= 0) return;
      float row_lo = std::numeric_limits<float>::infinity(), row_hi = -row_lo, sum = 0;
      for (int64_t x = 0; x < width(); ++x) {
        float v;
        std::memcpy(&v, row + 4 * x, 4);
        row_lo = v < row_lo ? v : row_lo;
        row_hi = v > row_hi ? v : row_hi;
        sum += v * 0.0f;  // not 0 as soon as one is infinite or not a number
      }
      if (!(sum == 0)) {
        bad_y = y;
        for (bad_x = 0; bad_x < width(); ++bad_x) {
          float v;
          std::memcpy(&v, row + 4 * bad_x, 4);
          if (!std::isfinite(v)) return;
        }
      }
      lo = std::min(lo, row_lo);
      hi = std::max(hi, row_hi);
    });
    if (!scanned) return scanned;
    if (bad_y >= 0) {
      return Error{ErrorKind::kInvalidData, cache_.path(),
                   "expected a finite height, found none at pixel (" + std::to_string(bad_x) + ", " + std::to_string(bad_y) +
                       "), counted from the top left",
                   "fill the holes of the height map before", {}};
    }
    // As read() computes them, so that the range holds every sample to the last bit.
    const float a = toMm(lo), b = toMm(hi);
    setRange(std::min(a, b), std::max(a, b));
    if (!std::isfinite(min_mm_) || !std::isfinite(max_mm_)) {
      return Error{ErrorKind::kInvalidData, cache_.path(), "expected heights that single precision holds, found larger ones", "", {}};
    }
    return {};
  }

  Result<void> read(const Rect& rect, std::span<float> out) const override {
    provenance_.start();
    assert(out.size() >= static_cast<size_t>(rect.width) * rect.height);
    return cache_.rows(rect.y, rect.height, [&](int64_t y, const uint8_t* row) {
      float* to = out.data() + static_cast<size_t>(y - rect.y) * rect.width;
      switch (type_.basetype) {
        case OIIO::TypeDesc::UINT8: convert<uint8_t>(row, rect, to); break;
        case OIIO::TypeDesc::UINT16: convert<uint16_t>(row, rect, to); break;
        case OIIO::TypeDesc::UINT32: convert<uint32_t>(row, rect, to); break;
        default: convert<float>(row, rect, to); break;
      }
    });
  }

 private:
  float toMm(double sample) const { return static_cast<float>(offset_ + scale_ * sample); }
  template <class T>
  void convert(const uint8_t* row, const Rect& rect, float* out) const {
    const uint8_t* from = row + rect.x * sizeof(T);
    for (int64_t x = 0; x < rect.width; ++x) {
      T sample;
      std::memcpy(&sample, from + x * sizeof(T), sizeof(T));
      out[x] = toMm(static_cast<double>(sample));
    }
  }

  FileProvenance provenance_;
  OIIO::TypeDesc type_;
  double offset_, scale_, min_mm_ = 0, max_mm_ = 0;
  mutable BandCache cache_;
};

std::string lowerExtension(const std::string& path) {
  const size_t dot = path.find_last_of("./");
  std::string out = dot == std::string::npos || path[dot] != '.' ? "" : path.substr(dot + 1);
  for (char& c : out) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return out;
}

// Writes through OpenImageIO into the part file that OutputFile made, registered for removal and renamed by it.
class OiioWriter final : public ImageWriter {
 public:
  static Result<std::unique_ptr<ImageWriter>> open(const std::string& path, const char* format, OIIO::ImageSpec spec) {
    auto file = OutputFile::create(path);
    if (!file) return file.error();
    auto writer = std::unique_ptr<OiioWriter>(new OiioWriter(std::move(*file), std::move(spec)));
    writer->output_ = OIIO::ImageOutput::create(format);
    if (!writer->output_) {
      return Error{ErrorKind::kUnsupported, path, std::string("this build of OpenImageIO does not write ") + format, "", {}};
    }
    if (!writer->output_->open(writer->file_.partPath(), writer->spec_)) return writer->failure("creating");
    return std::unique_ptr<ImageWriter>(std::move(writer));
  }
  ~OiioWriter() override {
    if (output_) output_->close();  // before the part file goes
  }

  Result<void> appendRows(int64_t rows, const void* samples) override {
    assert(rows >= 0 && next_row_ + rows <= spec_.height);
    try {
      if (!output_->write_scanlines(static_cast<int>(next_row_), static_cast<int>(next_row_ + rows), 0, spec_.format, samples)) {
        return failure("writing");
      }
    } catch (const std::exception& e) {
      return Error{ErrorKind::kIo, file_.path(), "writing failed: " + oneLine(e.what()), "", {}};
    }
    next_row_ += rows;
    return {};
  }
  Result<void> commit() override {
    assert(next_row_ == spec_.height);
    const bool closed = output_->close();
    if (!closed) return failure("writing");
    output_.reset();
    return file_.commit();
  }

 private:
  OiioWriter(OutputFile file, OIIO::ImageSpec spec) : file_(std::move(file)), spec_(std::move(spec)) {}
  Error failure(const char* doing) {
    return {ErrorKind::kIo, file_.path(), std::string(doing) + " failed: " + oneLine(output_->geterror()),
            "is the disk full?", {}};
  }

  OutputFile file_;
  OIIO::ImageSpec spec_;
  std::unique_ptr<OIIO::ImageOutput> output_;
  int64_t next_row_ = 0;
};

Result<std::unique_ptr<TextureSource>> openColour(const std::string& path, const ImageReadOptions& options) {
  return guarded(path, [&]() -> Result<std::unique_ptr<TextureSource>> {
    auto image = openImage(path);
    if (!image) return image.error();
    if (image->spec.format.is_floating_point()) {
      return Error{ErrorKind::kUnsupported, path,
                   std::string("expected 8- or 16-bit colour, found samples of type ") + image->spec.format.c_str(),
                   "develop it to sRGB first", {}};
    }
    return std::unique_ptr<TextureSource>(new ColourImage(path, std::move(*image), options.cache_bytes));
  });
}

Result<std::unique_ptr<HeightSource>> openHeight(const std::string& path,
                                                      std::optional<std::pair<double, double>> range_mm,
                                                      const ImageReadOptions& options) {
  return guarded(path, [&]() -> Result<std::unique_ptr<HeightSource>> {
    auto image = openImage(path);
    if (!image) return image.error();
    const auto& s = image->spec;
    if (s.nchannels != 1) {
      return Error{ErrorKind::kUnsupported, path,
                   "expected a height image of 1 channel, found " + std::to_string(s.nchannels),
                   "save it as a grey image without alpha", {}};
    }
    if (range_mm && !(std::isfinite(range_mm->first) && std::isfinite(range_mm->second) && range_mm->first <= range_mm->second)) {
      return Error{ErrorKind::kUsage, path,
                   "expected a height range from low to high, found " + std::to_string(range_mm->first) + " to " +
                       std::to_string(range_mm->second) + " mm", "", {}};
    }
    OIIO::TypeDesc type;
    double full = 1;  // the sample that range_mm's end stands for
    switch (s.format.basetype) {
      case OIIO::TypeDesc::UINT8: type = OIIO::TypeUInt8, full = 255; break;
      case OIIO::TypeDesc::UINT16: type = OIIO::TypeUInt16, full = 65535; break;
      case OIIO::TypeDesc::UINT32: type = OIIO::TypeUInt32, full = 4294967295.0; break;
      case OIIO::TypeDesc::HALF:
      case OIIO::TypeDesc::FLOAT:
      case OIIO::TypeDesc::DOUBLE: type = OIIO::TypeFloat; break;
      default:
        return Error{ErrorKind::kUnsupported, path,
                     std::string("expected unsigned integer or floating-point heights, found samples of type ") + s.format.c_str(),
                     "save it as unsigned 16 bit or as floats in mm", {}};
    }
    const bool floats = type == OIIO::TypeFloat;
    if (!floats && !range_mm) {
      return Error{ErrorKind::kUsage, path, "expected a height range, as its samples are integers",
                   "say which heights in mm the lowest and the highest sample stand for", {}};
    }
    const double offset = range_mm ? range_mm->first : 0;
    const double scale = range_mm ? (range_mm->second - range_mm->first) / full : 1;
    auto source = std::make_unique<HeightImage>(path, std::move(*image), type, offset, scale, options.cache_bytes);
    if (floats) {
      if (auto scanned = source->scanRange(); !scanned) return scanned.error();
    } else {
      // As read() rounds them.
      source->setRange(static_cast<float>(offset), static_cast<float>(offset + scale * full));
    }
    return std::unique_ptr<HeightSource>(std::move(source));
  });
}

Result<void> writePngFile(const std::string& path, int width, int height, int channels, std::span<const uint8_t> pixels, double mm_per_px) {
  assert(width > 0 && height > 0 && channels >= 1 && channels <= 4);
  assert(pixels.size() == static_cast<size_t>(width) * height * channels);
  OIIO::ImageSpec spec(width, height, channels, OIIO::TypeUInt8);
  spec.attribute("oiio:ColorSpace", "sRGB");
  spec.attribute("oiio:UnassociatedAlpha", 1);
  // A picture of less than a pixel a metre, or of more than a PNG can count, says nothing.
  if (const double px_per_m = 1000 / mm_per_px; mm_per_px > 0 && px_per_m >= 1 && px_per_m < 2e9) {
    spec.attribute("ResolutionUnit", "cm");
    // The writer cuts off what is beyond a whole pixel a metre, of a float.
    const auto px_per_cm = static_cast<float>((std::round(px_per_m) + 0.25) / 100);
    for (const char* axis : {"XResolution", "YResolution"}) spec.attribute(axis, px_per_cm);
  }
  auto writer = OiioWriter::open(path, "png", std::move(spec));
  if (!writer) return writer.error();
  if (auto done = (*writer)->appendRows(height, pixels.data()); !done) return done;
  return (*writer)->commit();
}

Result<Image8> readPixels8(const std::string& path) {
  return guarded(path, [&]() -> Result<Image8> {
    auto image = openImage(path);
    if (!image) return image.error();
    Image8 out{image->spec.width, image->spec.height, image->spec.nchannels, {}};
    out.pixels.resize(static_cast<size_t>(out.width) * out.height * out.channels);
    if (!image->input->read_image(0, 0, 0, out.channels, OIIO::TypeUInt8, out.pixels.data()) || image->input->has_error()) {
      return Error{ErrorKind::kInvalidData, path, "the image does not decode: " + oneLine(image->input->geterror()),
                   kDamagedHint, {}};
    }
    return out;
  });
}

Result<std::unique_ptr<ImageWriter>> createWriter(const std::string& path, int64_t width, int64_t height, int channels,
                                                         SampleType type) {
  const std::string extension = lowerExtension(path);
  const bool tiff = extension == "tif" || extension == "tiff", jpeg = extension == "jpg" || extension == "jpeg";
  const bool png = extension == "png";
  if (!tiff && !jpeg && !png) {
    return Error{ErrorKind::kUsage, path, "expected a file name that ends in .tif, .png or .jpg, found \"" + extension + "\"",
                 "name the output accordingly", {}};
  }
  if ((jpeg && type != SampleType::kUint8) || (png && type == SampleType::kFloat)) {
    return Error{ErrorKind::kUsage, path, "." + extension + " cannot hold such samples", "write a .tif", {}};
  }
  const int64_t max_side = jpeg ? 65500 : std::numeric_limits<int>::max();
  if (width < 1 || height < 1 || width > max_side || height > max_side) {
    return Error{ErrorKind::kUsage, path,
                 "expected sides from 1 to " + std::to_string(max_side) + ", found " + std::to_string(width) + " x " +
                     std::to_string(height), "", {}};
  }
  const auto sample = type == SampleType::kUint8 ? OIIO::TypeUInt8 : type == SampleType::kUint16 ? OIIO::TypeUInt16 : OIIO::TypeFloat;
  OIIO::ImageSpec spec(static_cast<int>(width), static_cast<int>(height), channels, sample);
  spec.attribute("oiio:UnassociatedAlpha", 1);
  if (type == SampleType::kUint8 && channels >= 3) spec.attribute("oiio:ColorSpace", "sRGB");
  if (jpeg) {
    spec.attribute("compression", "jpeg:95");
    spec.attribute("jpeg:subsampling", "4:4:4");
  }
  if (tiff) {
    // Uncompressed: read anywhere at any speed; deflate would take longer than everything before it.
    spec.attribute("compression", "none");
    // Classic TIFF ends at 4 GiB; some room for its strip tables.
    if (static_cast<double>(spec.image_bytes()) > 4.2e9) spec.attribute("tiff:bigtiff", 1);
  }
  return OiioWriter::open(path, tiff ? "tiff" : jpeg ? "jpeg" : "png", std::move(spec));
}

}  // namespace

const ImageIoModule relievo_image_io{openColour, openHeight, writePngFile, readPixels8, createWriter};

}  // namespace relievo
