// image_io_oiio.cpp - reading by OpenImageIO. With image_encode_oiio.cpp, the only users of OpenImageIO: a module of
// their own, which image_io.cpp loads when an image is first read or written.
//
// Images may be larger than memory and are asked for in rectangles about as wide as high, from left to right,
// then downwards, by several threads at once; most files hold (compressed) strips or rows. So rows are decoded in bands
// as wide as the image and kept in a bounded cache, least recently used out first: each row is decoded once as long as
// the rows of one rectangle, at the image's full width, fit (cache_bytes, more where a rectangle's rows need it).
// Formats that can only be read from the top (PNG, JPEG) are decoded in order: skipped bands are decoded and kept on
// the way.
//
// Nothing from OpenImageIO escapes: errors become Results, exceptions are caught at each call.
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <OpenImageIO/typedesc.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <limits>
#include <map>
#include <mutex>
#include <new>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "src/base/file.h"
#include "texturing/import/image_io_module.h"
#include "texturing/import/image_oiio.h"
#include "texturing/import/image_sniff.h"
#include "texturing/package/file_provenance.h"

namespace relievo {
namespace {

constexpr uint64_t kPackingSlackBytes = uint64_t{1} << 20;
constexpr int64_t kMaxSide = int64_t{1} << 30;

// Runs what calls OpenImageIO; its exceptions (out of memory, damaged files in some readers) become errors. No size
// that a damaged file claims gets as far as an allocation that fails: it is the machine that has no memory.
template <class Call>
auto guarded(const std::string& path, Call call) -> decltype(call()) {
  try {
    return call();
  } catch (const std::bad_alloc&) {
    return Error{ErrorKind::kRuntime,
                 path,
                 "out of memory while reading the image",
                 "close other programs, or lower --memory-mib and --workers",
                 {}};
  } catch (const std::exception& e) {
    return Error{ErrorKind::kInvalidData, path, "reading the image failed: " + oneLine(e.what()), kDamagedHint, {}};
  }
}

// How the stored rows and columns lie in the picture (EXIF orientation 1 to 8): the stored columns or rows run
// backwards, then the picture's rows are the stored columns. Of 5 to 8 a rectangle's columns are stored rows: read in
// rectangles, an image that the cache does not hold is decoded once for every column of rectangles.
struct Orientation {
  bool flip_columns = false, flip_rows = false, swap = false;
  static Orientation of(int exif) {
    return {exif == 2 || exif == 3 || exif == 7 || exif == 8, exif == 3 || exif == 4 || exif == 6 || exif == 7,
            exif >= 5 && exif <= 8};
  }
};

// A JPEG file for OpenImageIO, in which some segments are of a kind that it passes over.
class MaskedJpeg {
 public:
  // unsafe: unsafeJpegMarkers(), in ascending order. Null: no memory.
  static std::unique_ptr<MaskedJpeg> make(InputFile file, std::vector<uint64_t> unsafe) {
    std::unique_ptr<MaskedJpeg> out(new MaskedJpeg(std::move(file), std::move(unsafe)));
    out->stream_.reset(
        ::fopencookie(out.get(), "rb", {.read = readNext, .write = nullptr, .seek = seek, .close = nullptr}));
    if (!out->stream_) return nullptr;
    out->proxy_.emplace(*out);
    return out;
  }
  OIIO::Filesystem::IOProxy* proxy() { return &*proxy_; }

 private:
  MaskedJpeg(InputFile file, std::vector<uint64_t> unsafe) : file_(std::move(file)), unsafe_(std::move(unsafe)) {}
  // From there on as many bytes as there are; nothing if the disk does not give them.
  std::optional<size_t> read(uint64_t at, std::span<uint8_t> out) const {
    out = out.first(static_cast<size_t>(std::min<uint64_t>(out.size(), file_.size() - std::min(at, file_.size()))));
    if (!file_.read(at, out)) return std::nullopt;
    constexpr uint8_t kApp3 = 0xe3;  // which OpenImageIO does not ask for
    for (auto marker = std::ranges::lower_bound(unsafe_, at); marker != unsafe_.end() && *marker - at < out.size();
         ++marker)
      out[static_cast<size_t>(*marker - at)] = kApp3;
    return out.size();
  }
  static ssize_t readNext(void* cookie, char* to, size_t size) {
    auto& self = *static_cast<MaskedJpeg*>(cookie);
    const auto bytes = self.read(self.at_, {reinterpret_cast<uint8_t*>(to), size});
    if (!bytes) return -1;
    self.at_ += *bytes;
    return static_cast<ssize_t>(*bytes);
  }
  static int seek(void* cookie, off64_t* offset, int whence) {
    auto& self = *static_cast<MaskedJpeg*>(cookie);
    const auto size = static_cast<off64_t>(self.file_.size());
    const off64_t from = whence == SEEK_SET ? 0 : whence == SEEK_END ? size : static_cast<off64_t>(self.at_);
    if (*offset < -from || *offset > size - from) return -1;
    self.at_ = static_cast<uint64_t>(*offset += from);
    return 0;
  }

  struct Close {
    void operator()(FILE* file) const { std::fclose(file); }
  };
  // IOFile would ask the file's descriptor, which a stream of functions has none of.
  class Proxy final : public OIIO::Filesystem::IOFile {
   public:
    Proxy(MaskedJpeg& jpeg) : IOFile(jpeg.stream_.get(), Read), jpeg_(jpeg) {}
    size_t size() const override { return static_cast<size_t>(jpeg_.file_.size()); }
    // It looks at a file's beginning whenever it decodes from there, and leaves it to its proxy to be there again.
    size_t pread(void* to, size_t bytes, int64_t offset) override {
      if (offset == 0) std::rewind(m_file);
      return jpeg_.read(static_cast<uint64_t>(offset), {static_cast<uint8_t*>(to), bytes}).value_or(0);
    }

   private:
    const MaskedJpeg& jpeg_;
  };
  InputFile file_;
  std::vector<uint64_t> unsafe_;
  uint64_t at_ = 0;
  std::unique_ptr<FILE, Close> stream_;
  std::optional<Proxy> proxy_;
};

struct OpenImage {
  std::unique_ptr<MaskedJpeg> jpeg;  // that is read in place of the file; null: the file is
  std::unique_ptr<OIIO::ImageInput> input;
  OIIO::ImageSpec spec;
  uint64_t file_bytes = 0;
  std::optional<double> no_data;  // the sample that is no height
  Orientation orientation;
  int64_t width() const { return orientation.swap ? spec.height : spec.width; }  // as shown
  int64_t height() const { return orientation.swap ? spec.width : spec.height; }
};

std::string mib(unsigned __int128 bytes) {
  return std::to_string(static_cast<uint64_t>((bytes + (1 << 20) - 1) >> 20)) + " MiB";
}

// More than one of the limits allows: it is the limit that is in the way, not the file.
Error beyond(const std::string& path, const std::string& what, unsigned __int128 bytes, uint64_t limit,
             const char* option, unsigned budget_share, const ImageReadOptions& options) {
  std::string hint = "raise ";
  if (option) hint += std::string(option) + " to " + std::to_string(static_cast<uint64_t>((bytes >> 20) + 1)) + ", or ";
  hint += "--memory-mib to " + std::to_string(static_cast<uint64_t>(bytes * budget_share >> 20) + 1);
  return {ErrorKind::kRuntime,
          path,
          what + " " + mib(bytes) + " decoded, expected at most " + mib(limit) + " with --memory-mib " +
              std::to_string(options.memory_budget_bytes >> 20),
          hint,
          {}};
}

// Rows that an OpenEXR file packs together.
int64_t exrChunkRows(const OIIO::ImageSpec& spec) {
  const std::string name = spec.get_string_attribute("compression");
  return name.starts_with("dwab")                                                         ? 256
         : name.starts_with("piz") || name.starts_with("b44") || name.starts_with("dwaa") ? 32
         : name == "zip" || name.starts_with("pxr24")                                     ? 16
                                                                                          : 1;
}

using Bytes = unsigned __int128;

// More than a file of this length can hold?
std::optional<Error> tooManyPixels(const std::string& path, int64_t width, int64_t height, Bytes bytes,
                                   uint64_t file_bytes, const ImageReadOptions& options) {
  if (bytes <= static_cast<Bytes>(file_bytes) * options.max_packing + kPackingSlackBytes) return std::nullopt;
  return Error{ErrorKind::kInvalidData,
               path,
               "expected at least " + std::to_string(static_cast<uint64_t>(bytes / options.max_packing)) +
                   " bytes for " + std::to_string(width) + " x " + std::to_string(height) + " pixels, found " +
                   std::to_string(file_bytes),
               std::string(kDamagedHint) + "; --max-packing allows more than 1:" + std::to_string(options.max_packing),
               {}};
}

Result<OpenImage> openImage(const std::string& path, const ImageReadOptions& options) {
  // The file first, for errors that say what is the matter: OpenImageIO calls a missing file an unknown format.
  auto file = InputFile::open(path);
  if (!file) return file.error();
  if (file->size() == 0) {
    return Error{ErrorKind::kInvalidData, path, "expected an image, found an empty file", kDamagedHint, uint64_t{0}};
  }
  auto sniffed = sniffImage(*file);
  if (!sniffed) return sniffed.error();
  constexpr const char* kWhole = "it only decodes as a whole, which takes";
  constexpr const char* kWholeOption = "--max-image-mib";
  if (sniffed->whole_bytes / options.max_packing > file->size() + kPackingSlackBytes) {
    return Error{
        ErrorKind::kInvalidData,
        path,
        "expected pixels that a file of " + std::to_string(file->size()) + " bytes can hold, found a header of " +
            mib(sniffed->whole_bytes) + " decoded",
        std::string(kDamagedHint) + "; --max-packing allows more than 1:" + std::to_string(options.max_packing),
        {}};
  }
  if (sniffed->whole_bytes > options.decodedLimit())
    return beyond(path, kWhole, sniffed->whole_bytes, options.decodedLimit(), kWholeOption, 3, options);
  // OpenEXR makes room for rows as it opens a file, other readers only as they are read.
  const auto claimed = checkExrHeader(*file);
  if (!claimed) return claimed.error();
  if (auto few = tooManyPixels(path, claimed->width, claimed->height, claimed->bytes(), file->size(), options))
    return *few;
  auto unsafe = unsafeJpegMarkers(*file);
  if (!unsafe) return unsafe.error();
  OpenImage image;
  image.file_bytes = file->size();
  auto no_data = noDataOf(*file);
  if (!no_data) return no_data.error();
  image.no_data = *no_data;
  OIIO::ImageSpec config = openConfig();
  if (!unsafe->empty()) {
    image.jpeg = MaskedJpeg::make(std::move(*file), std::move(*unsafe));
    if (!image.jpeg) throw std::bad_alloc();
    OIIO::Filesystem::IOProxy* proxy = image.jpeg->proxy();
    config.attribute("oiio:ioproxy", OIIO::TypeDesc::PTR, &proxy);
  }
  std::string why;
  {
    // The library's own limit is the whole program's and is looked at on opening. What is read in parts is checked
    // below.
    static std::mutex opening;
    std::lock_guard lock(opening);
    OIIO::attribute(
        "limits:imagesize_MB",
        sniffed->in_parts ? 0 : static_cast<int>(std::min<uint64_t>((options.decodedLimit() >> 20) + 1, 1 << 30)));
    image.input = OIIO::ImageInput::open(path, &config);
    if (!image.input) {
      // The library opens the file a second time. Where the system refuses that (too many open files), it says that it
      // could not, or, of OpenEXR, that the file is none: neither is damage, and the refusal may have passed.
      why = oneLine(OIIO::geterror());
      if (why.find("Could not open") != std::string::npos || why.find("not an OpenEXR file") != std::string::npos) {
        if (auto again = InputFile::open(path); !again) return again.error();
        image.input = OIIO::ImageInput::open(path, &config);
        if (!image.input) why = oneLine(OIIO::geterror());
      }
    }
  }
  if (!image.input) {
    if (why.find("not supported") != std::string::npos)
      return Error{ErrorKind::kUnsupported, path, why, "write it as a TIFF or PNG", {}};
    return Error{ErrorKind::kInvalidData,
                 path,
                 "expected an image, found: " + why,
                 "the file is damaged, or of a format that this build of OpenImageIO does not read",
                 {}};
  }
  image.spec = image.input->spec();
  const auto& s = image.spec;
  if (s.width < 1 || s.height < 1 || s.width > kMaxSide || s.height > kMaxSide || s.nchannels < 1 || s.depth > 1) {
    return Error{ErrorKind::kInvalidData,
                 path,
                 "expected a flat image, found " + std::to_string(s.width) + " x " + std::to_string(s.height) + " x " +
                     std::to_string(s.depth) + " with " + std::to_string(s.nchannels) + " channels",
                 kDamagedHint,
                 {}};
  }
  const Bytes pixel = s.pixel_bytes(true), bytes = static_cast<Bytes>(s.width) * s.height * pixel;
  if (auto few = tooManyPixels(path, s.width, s.height, bytes, image.file_bytes, options)) return *few;
  if (!sniffed->in_parts && bytes > options.decodedLimit())
    return beyond(path, kWhole, bytes, options.decodedLimit(), kWholeOption, 3, options);
  const auto sides = [](int64_t w, int64_t h) { return std::to_string(w) + " x " + std::to_string(h) + " px take"; };
  if (s.tile_width > 0 && s.tile_height > 0) {
    const Bytes tile = static_cast<Bytes>(s.tile_width) * s.tile_height * std::max(s.tile_depth, 1) * pixel;
    if (tile > options.tileLimit())
      return beyond(path, "its tiles of " + sides(s.tile_width, s.tile_height), tile, options.tileLimit(),
                    "--max-tile-mib", 8, options);
  }
  // The fewest rows that are decoded together, at full width, twice: as they are stored and as they are asked for.
  const bool exr = std::string_view(image.input->format_name()) == "openexr";
  const int64_t rows = std::min<int64_t>(s.tile_height > 0 ? s.tile_height : exr ? exrChunkRows(s) : 1, s.height);
  const Bytes band = 2 * static_cast<Bytes>(s.width) * static_cast<Bytes>(rows) * pixel;
  if (const uint64_t limit = options.memory_budget_bytes / 2; band > limit)
    return beyond(path, "its rows of " + sides(s.width, rows), band, limit, nullptr, 2, options);
  if (options.orient) image.orientation = Orientation::of(s.get_int_attribute("Orientation", 1));
  return image;
}

// From rows of the file to a rectangle of the picture: where its pixels lie in the file, and where those of a row go.
struct Placement {
  Rect stored;
  // Of the stored row y: the place of its first pixel, stored.x, in the rectangle, and how far apart its pixels lie
  // there.
  struct Row {
    int64_t first = 0, step = 1;
  };
  Row row(int64_t y) const {
    const int64_t across = o.flip_columns ? stored.width - 1 : 0,
                  down = o.flip_rows ? stored.y + stored.height - 1 - y : y - stored.y;
    const int64_t step = o.flip_columns ? -1 : 1;
    return o.swap ? Row{across * width + down, step * width} : Row{down * width + across, step};
  }
  Placement(const Rect& rect, const Orientation& orientation, int64_t stored_width, int64_t stored_height)
      : o(orientation), width(rect.width) {
    stored = o.swap ? Rect{rect.y, rect.x, rect.height, rect.width} : rect;
    if (o.flip_columns) stored.x = stored_width - stored.x - stored.width;
    if (o.flip_rows) stored.y = stored_height - stored.y - stored.height;
  }
  Orientation o;
  int64_t width;
};

// Bands of decoded rows of one image, shared by the threads that read it.
class BandCache {
 public:
  BandCache(std::string path, OpenImage image, OIIO::TypeDesc type, int channels, const ImageReadOptions& options)
      : path_(std::move(path)),
        image_(std::move(image)),
        type_(type),
        channels_(channels),
        capacity_(std::min(options.cache_bytes, options.memory_budget_bytes / 3)),
        max_capacity_(options.memory_budget_bytes / 2) {
    const uint64_t cache_bytes = capacity_;
    const auto& s = image_.spec;
    row_bytes_ = static_cast<size_t>(s.width) * channels * type.size();
    band_rows_ =
        std::clamp<int64_t>(static_cast<int64_t>(std::min(kBandBytes, cache_bytes / 8) / row_bytes_), 1, s.height);
    if (s.tile_height > 0) {
      band_rows_ = std::max<int64_t>(band_rows_ / s.tile_height, 1) * s.tile_height;
    } else if (int strip = s.get_int_attribute("tiff:RowsPerStrip", 1); strip > 1 && strip <= band_rows_) {
      band_rows_ = band_rows_ / strip * strip;
    }
    // A PNG or JPEG that is asked for an earlier row is decoded again from its top.
    const std::string_view format = image_.input->format_name();
    sequential_ = format != "tiff" && format != "openexr";
  }

  int64_t width() const { return image_.width(); }  // as shown
  int64_t height() const { return image_.height(); }
  int64_t storedHeight() const { return image_.spec.height; }
  Placement placement(const Rect& rect) const {
    return {rect, image_.orientation, image_.spec.width, image_.spec.height};
  }
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
    capacity_ = std::max(capacity_, std::min<uint64_t>(max_capacity_, bands_wanted * band_rows_ * row_bytes_));
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
      // Samples that need no conversion are asked for as they are: for any type that is named OpenImageIO takes a
      // buffer of 64 MiB on the way.
      const bool as_stored = s.format == type_ && s.channelformats.empty();
      const OIIO::TypeDesc type = as_stored ? OIIO::TypeDesc(OIIO::TypeDesc::UNKNOWN) : type_;
      const bool ok = s.tile_width > 0
                          ? image_.input->read_tiles(0, 0, s.x, s.x + s.width, y0, y1, s.z, s.z + 1, 0, channels_, type,
                                                     out->data())
                          : image_.input->read_scanlines(0, 0, y0, y1, s.z, 0, channels_, type, out->data());
      if (!ok || image_.input->has_error()) {
        return Error{ErrorKind::kInvalidData,
                     path_,
                     "rows " + std::to_string(first) + " to " + std::to_string(end - 1) +
                         " do not decode: " + oneLine(image_.input->geterror()),
                     kDamagedHint,
                     {}};
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
  uint64_t held_bytes_ = 0, capacity_, max_capacity_, clock_ = 0;
};

class ColourImage final : public TextureSource {
 public:
  ColourImage(std::string path, OpenImage image, const ImageReadOptions& options)
      : provenance_(path, true),
        channels_(image.spec.nchannels >= 3 ? 3 : 1),
        cache_(std::move(path), std::move(image), OIIO::TypeUInt8, channels_, options) {}
  int64_t width() const override { return cache_.width(); }
  int64_t height() const override { return cache_.height(); }
  TextureFormat format() const override { return {}; }
  Provenance provenance() const override { return provenance_.get(); }
  Result<void> read(const Rect& rect, std::span<uint8_t> out) const override {
    provenance_.start();
    const size_t plane = static_cast<size_t>(rect.width) * rect.height;
    assert(out.size() >= 3 * plane);
    const Placement place = cache_.placement(rect);
    return cache_.rows(place.stored.y, place.stored.height, [&](int64_t y, const uint8_t* row) {
      const auto [first, step] = place.row(y);
      uint8_t* to = out.data() + first;
      const uint8_t* from = row + place.stored.x * channels_;
      if (channels_ == 1 && step == 1) {
        for (int c = 0; c < 3; ++c) std::memcpy(to + c * plane, from, place.stored.width);
        return;
      }
      for (int c = 0; c < 3; ++c) {
        const uint8_t* channel = from + (channels_ == 1 ? 0 : c);
        uint8_t* channel_to = to + c * plane;
        for (int64_t x = 0; x < place.stored.width; ++x) channel_to[x * step] = channel[channels_ * x];
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
  HeightImage(std::string path, OpenImage image, OIIO::TypeDesc type, double offset, double scale,
              const ImageReadOptions& options)
      : provenance_(path, true),
        type_(type),
        no_data_(image.no_data),
        offset_(offset),
        scale_(scale),
        cache_(std::move(path), std::move(image), type, 1, options) {}
  int64_t width() const override { return cache_.width(); }
  int64_t height() const override { return cache_.height(); }
  double minMm() const override { return min_mm_; }
  double maxMm() const override { return max_mm_; }
  Provenance provenance() const override { return provenance_.get(); }

  void setRange(double min_mm, double max_mm) { min_mm_ = min_mm, max_mm_ = max_mm; }
  // Floats: the range of the heights by reading all of them; the place of the first that is not a number. shares: they
  // stand for 0..1.
  Result<void> scanRange(bool shares) {
    float lo = std::numeric_limits<float>::infinity(), hi = -lo;
    int64_t bad_x = -1, bad_y = -1;
    const Placement all = cache_.placement({0, 0, width(), height()});
    auto scanned = cache_.rows(0, all.stored.height, [&](int64_t y, const uint8_t* row) {
      if (bad_y >= 0) return;
      if ((bad_x = firstHole<float>(row, all.stored.width)) >= 0) {
        bad_y = y;
        return;
      }
      float row_lo = std::numeric_limits<float>::infinity(), row_hi = -row_lo, sum = 0;
      for (int64_t x = 0; x < all.stored.width; ++x) {
        float v;
        std::memcpy(&v, row + 4 * x, 4);
        row_lo = v < row_lo ? v : row_lo;
        row_hi = v > row_hi ? v : row_hi;
        sum += v * 0.0f;  // not 0 as soon as one is infinite or not a number
      }
      if (!(sum == 0)) {
        bad_y = y;
        for (bad_x = 0; bad_x < all.stored.width; ++bad_x) {
          float v;
          std::memcpy(&v, row + 4 * bad_x, 4);
          if (!std::isfinite(v)) return;
        }
      }
      lo = std::min(lo, row_lo);
      hi = std::max(hi, row_hi);
    });
    if (!scanned) return scanned;
    if (bad_y >= 0) return hole(all, bad_x, bad_y);
    constexpr float kRounding = 1e-6f;
    if (shares && !(lo >= -kRounding && hi <= 1 + kRounding)) {
      char found[64];
      std::snprintf(found, sizeof found, "%.9g to %.9g", static_cast<double>(lo), static_cast<double>(hi));
      return Error{ErrorKind::kUsage,
                   cache_.path(),
                   std::string("expected samples from 0 to 1 beside a height range, found floats from ") + found,
                   "leave out --relief-mm or --relief-px: a float map's heights are mm",
                   {}};
    }
    // As read() computes them, so that the range holds every sample to the last bit.
    const float a = toMm(lo), b = toMm(hi);
    setRange(std::min(a, b), std::max(a, b));
    // Drawing squares lengths in single precision, which ends at 3.4e38.
    constexpr double kMostMm = 1e18;
    if (!(min_mm_ >= -kMostMm && max_mm_ <= kMostMm)) {
      char found[64];
      std::snprintf(found, sizeof found, "%.9g to %.9g", min_mm_, max_mm_);
      return Error{ErrorKind::kInvalidData,
                   cache_.path(),
                   std::string("expected heights within 1e18 mm, found heights from ") + found + " mm",
                   "if such a height stands for none, fill the holes of the height map before",
                   {}};
    }
    return {};
  }

  // Integers: the place of the first that is no height, where the file names one that is none.
  Result<void> scanHoles() {
    if (!no_data_) return {};
    int64_t bad_x = -1, bad_y = -1;
    const Placement all = cache_.placement({0, 0, width(), height()});
    auto scanned = cache_.rows(0, all.stored.height, [&](int64_t y, const uint8_t* row) {
      if (bad_y >= 0) return;
      bad_x = type_ == OIIO::TypeUInt8    ? firstHole<uint8_t>(row, all.stored.width)
              : type_ == OIIO::TypeUInt16 ? firstHole<uint16_t>(row, all.stored.width)
                                          : firstHole<uint32_t>(row, all.stored.width);
      if (bad_x >= 0) bad_y = y;
    });
    if (!scanned) return scanned;
    if (bad_y >= 0) return hole(all, bad_x, bad_y);
    return {};
  }

  Result<void> read(const Rect& rect, std::span<float> out) const override {
    provenance_.start();
    assert(out.size() >= static_cast<size_t>(rect.width) * rect.height);
    const Placement place = cache_.placement(rect);
    return cache_.rows(place.stored.y, place.stored.height, [&](int64_t y, const uint8_t* row) {
      const auto [first, step] = place.row(y);
      float* to = out.data() + first;
      switch (type_.basetype) {
        case OIIO::TypeDesc::UINT8:
          convert<uint8_t>(row, place.stored, to, step);
          break;
        case OIIO::TypeDesc::UINT16:
          convert<uint16_t>(row, place.stored, to, step);
          break;
        case OIIO::TypeDesc::UINT32:
          convert<uint32_t>(row, place.stored, to, step);
          break;
        default:
          convert<float>(row, place.stored, to, step);
          break;
      }
    });
  }

 private:
  // The first sample of a stored row that the file says is none; -1: there is no such sample.
  template <class T>
  int64_t firstHole(const uint8_t* row, int64_t samples) const {
    if (!no_data_) return -1;
    const double none = std::is_floating_point_v<T> ? static_cast<float>(*no_data_) : *no_data_;
    for (int64_t x = 0; x < samples; ++x) {
      T sample;
      std::memcpy(&sample, row + x * sizeof(T), sizeof(T));
      if (static_cast<double>(sample) == none) return x;
    }
    return -1;
  }
  Error hole(const Placement& all, int64_t stored_x, int64_t stored_y) const {
    const auto [first, step] = all.row(stored_y);
    const int64_t place = first + stored_x * step;
    std::string said;
    if (no_data_) {
      char text[64];
      std::snprintf(text, sizeof text, " (the file says that %.9g stands for none)", *no_data_);
      said = text;
    }
    return {ErrorKind::kInvalidData,
            cache_.path(),
            "expected a finite height, found none at pixel (" + std::to_string(place % width()) + ", " +
                std::to_string(place / width()) + "), counted from the top left" + said,
            "fill the holes of the height map before",
            {}};
  }
  float toMm(double sample) const { return static_cast<float>(offset_ + scale_ * sample); }
  template <class T>
  void convert(const uint8_t* row, const Rect& rect, float* out, int64_t step) const {
    const uint8_t* from = row + rect.x * sizeof(T);
    for (int64_t x = 0; x < rect.width; ++x) {
      T sample;
      std::memcpy(&sample, from + x * sizeof(T), sizeof(T));
      out[x * step] = toMm(static_cast<double>(sample));
    }
  }

  FileProvenance provenance_;
  OIIO::TypeDesc type_;
  std::optional<double> no_data_;
  double offset_, scale_, min_mm_ = 0, max_mm_ = 0;
  mutable BandCache cache_;
};

Result<ImageFacts> readFacts(const std::string& path, const ImageReadOptions& options) {
  return guarded(path, [&]() -> Result<ImageFacts> {
    auto image = openImage(path, options);
    if (!image) return image.error();
    const auto& s = image->spec;
    ImageFacts facts{image->width(),
                     image->height(),
                     s.nchannels,
                     s.alpha_channel >= 0 || s.nchannels == 2 || s.nchannels == 4,
                     0,
                     {}};
    const double x = s.get_float_attribute("XResolution", 0),
                 y = s.get_float_attribute("YResolution", static_cast<float>(x));
    const std::string unit = s.get_string_attribute("ResolutionUnit");
    const double unit_mm = unit == "in" || unit == "inch" ? 25.4 : unit == "cm" ? 10 : unit == "m" ? 1000 : 0;
    // Of pixels that are not square nothing is said: an artwork's are.
    if (unit_mm > 0 && x > 0 && std::isfinite(x) && std::abs(x - y) <= 1e-3 * x) {
      facts.tag_mm_per_px = unit_mm / x;
      char text[48];
      std::snprintf(text, sizeof text, "%.6g %s", x, unit_mm == 25.4 ? "dpi" : unit_mm == 10 ? "px a cm" : "px a m");
      facts.tag = text;
    }
    return facts;
  });
}

Result<std::unique_ptr<TextureSource>> openColour(const std::string& path, const ImageReadOptions& options) {
  return guarded(path, [&]() -> Result<std::unique_ptr<TextureSource>> {
    auto image = openImage(path, options);
    if (!image) return image.error();
    if (image->spec.format.is_floating_point()) {
      return Error{ErrorKind::kUnsupported,
                   path,
                   std::string("expected 8- or 16-bit colour, found samples of type ") + image->spec.format.c_str(),
                   "develop it to sRGB first",
                   {}};
    }
    return std::unique_ptr<TextureSource>(new ColourImage(path, std::move(*image), options));
  });
}

Result<std::unique_ptr<HeightSource>> openHeight(const std::string& path,
                                                 std::optional<std::pair<double, double>> range_mm,
                                                 const ImageReadOptions& options) {
  return guarded(path, [&]() -> Result<std::unique_ptr<HeightSource>> {
    auto image = openImage(path, options);
    if (!image) return image.error();
    const auto& s = image->spec;
    if (s.nchannels != 1) {
      return Error{ErrorKind::kUnsupported,
                   path,
                   "expected a height image of 1 channel, found " + std::to_string(s.nchannels),
                   "save it as a grey image without alpha",
                   {}};
    }
    if (range_mm &&
        !(std::isfinite(range_mm->first) && std::isfinite(range_mm->second) && range_mm->first <= range_mm->second)) {
      return Error{ErrorKind::kUsage,
                   path,
                   "expected a height range from low to high, found " + std::to_string(range_mm->first) + " to " +
                       std::to_string(range_mm->second) + " mm",
                   "",
                   {}};
    }
    OIIO::TypeDesc type;
    double full = 1;  // the sample that range_mm's end stands for
    switch (s.format.basetype) {
      case OIIO::TypeDesc::UINT8:
        type = OIIO::TypeUInt8, full = 255;
        break;
      case OIIO::TypeDesc::UINT16:
        type = OIIO::TypeUInt16, full = 65535;
        break;
      case OIIO::TypeDesc::UINT32:
        type = OIIO::TypeUInt32, full = 4294967295.0;
        break;
      case OIIO::TypeDesc::HALF:
      case OIIO::TypeDesc::FLOAT:
      case OIIO::TypeDesc::DOUBLE:
        type = OIIO::TypeFloat;
        break;
      default:
        return Error{ErrorKind::kUnsupported,
                     path,
                     std::string("expected unsigned integer or floating-point heights, found samples of type ") +
                         s.format.c_str(),
                     "save it as unsigned 16 bit or as floats in mm",
                     {}};
    }
    const bool floats = type == OIIO::TypeFloat;
    if (!floats && !range_mm) {
      return Error{ErrorKind::kUsage,
                   path,
                   "expected a height range, as its samples are integers",
                   "say which heights in mm the lowest and the highest sample stand for",
                   {}};
    }
    const double offset = range_mm ? range_mm->first : 0;
    const double scale = range_mm ? (range_mm->second - range_mm->first) / full : 1;
    auto source = std::make_unique<HeightImage>(path, std::move(*image), type, offset, scale, options);
    if (floats) {
      if (auto scanned = source->scanRange(range_mm.has_value()); !scanned) return scanned.error();
    } else {
      if (auto whole = source->scanHoles(); !whole) return whole.error();
      // As read() rounds them.
      source->setRange(static_cast<float>(offset), static_cast<float>(offset + scale * full));
    }
    return std::unique_ptr<HeightSource>(std::move(source));
  });
}

Result<Image8> readPixels8(const std::string& path, const ImageReadOptions& options) {
  return guarded(path, [&]() -> Result<Image8> {
    auto image = openImage(path, options);
    if (!image) return image.error();
    Image8 out{image->spec.width, image->spec.height, image->spec.nchannels, {}};
    const auto bytes = static_cast<unsigned __int128>(out.width) * static_cast<unsigned>(out.height) *
                       static_cast<unsigned>(out.channels);
    if (bytes > options.decodedLimit())
      return beyond(path, "it is kept as a whole, which takes", bytes, options.decodedLimit(), "--max-image-mib", 3,
                    options);
    out.pixels.resize(static_cast<size_t>(out.width) * out.height * out.channels);
    if (!image->input->read_image(0, 0, 0, out.channels, OIIO::TypeUInt8, out.pixels.data()) ||
        image->input->has_error()) {
      return Error{ErrorKind::kInvalidData,
                   path,
                   "the image does not decode: " + oneLine(image->input->geterror()),
                   kDamagedHint,
                   {}};
    }
    return out;
  });
}

}  // namespace

// OpenImageIO's own threads end the process where they cannot be started; files are read by several of our threads at
// once.
[[maybe_unused]] static const bool kOneThread = OIIO::attribute("threads", 1) && OIIO::attribute("exr_threads", -1);

const ImageIoModule relievo_image_io{readFacts,   openColour,        openHeight,
                                     readPixels8, createOiioEncoder, halvesFromFloatsByOiio};

}  // namespace relievo
