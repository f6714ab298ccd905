// image_io_oiio.cpp - the only user of OpenImageIO: a module of its own, which image_io.cpp loads when an image is
// first read or written.
//
// Reading. Images may be larger than memory and are asked for in rectangles about as wide as high, from left to right,
// then downwards, by several threads at once; most files hold (compressed) strips or rows. So rows are decoded in bands
// as wide as the image and kept in a bounded cache, least recently used out first: each row is decoded once as long as
// the rows of one rectangle, at the image's full width, fit (cache_bytes, more where a rectangle's rows need it).
// Formats that can only be read from the top (PNG, JPEG) are decoded in order: skipped bands are decoded and kept on
// the way.
//
// Writing goes through the program's own file (ImageBytes), and what was written is decoded again.
//
// Nothing from OpenImageIO escapes: errors become Results, exceptions are caught at each call.
#include "texturing/import/image_io_module.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <OpenImageIO/typedesc.h>
#include <xxhash.h>

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

#include "src/base/file.h"
#include "texturing/import/tiff_frame.h"
#include "texturing/package/file_provenance.h"

namespace relievo {
namespace {

constexpr uint64_t kBandBytes = uint64_t{4} << 20;  // as many rows as fit, at least one (or one row of tiles)
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

struct OpenImage {
  std::unique_ptr<OIIO::ImageInput> input;
  OIIO::ImageSpec spec;
  uint64_t file_bytes = 0;
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

// What must be known of a file before OpenImageIO opens it: some of its readers decode all of the image then.
struct Sniffed {
  bool in_parts = false;     // rows or tiles are decoded as they are asked for
  uint64_t whole_bytes = 0;  // else, where the header was understood: what decoding takes
};
Result<Sniffed> sniff(const InputFile& file) {
  std::vector<uint8_t> head(std::min<uint64_t>(file.size(), 32));
  if (auto read = file.read(0, head); !read) return read.error();
  auto starts = [&](std::string_view magic) {
    return head.size() >= magic.size() && std::memcmp(head.data(), magic.data(), magic.size()) == 0;
  };
  auto big = [](const uint8_t* p, int n) {
    uint64_t v = 0;
    for (int i = 0; i < n; ++i) v = v << 8 | p[i];
    return v;
  };
  using namespace std::string_view_literals;
  if (starts("II*\0"sv) || starts("MM\0*"sv) || starts("II+\0"sv) || starts("MM\0+"sv) || starts("\x76\x2f\x31\x01"sv))
    return Sniffed{true, 0};
  if (starts("\x89PNG"sv)) {
    if (head.size() < 29 || head[28] == 0) return Sniffed{true, 0};
    const uint64_t channels = head[25] == 2 || head[25] == 3 ? 3 : head[25] == 6 ? 4 : head[25] == 4 ? 2 : 1;
    return Sniffed{false, big(&head[16], 4) * big(&head[20], 4) * channels * (head[24] == 16 ? 2 : 1)};  // interlaced
  }
  if (!starts("\xff\xd8"sv)) return Sniffed{};
  // A JPEG's segments up to the frame header. A progressive one keeps all coefficients, 16 bit each.
  std::array<uint8_t, 10> segment;
  for (uint64_t at = 2; at + segment.size() <= file.size();) {
    if (auto read = file.read(at, segment); !read) return read.error();
    if (segment[0] != 0xff) break;
    const uint8_t marker = segment[1];
    if (marker == 0xff) {  // filling
      ++at;
      continue;
    }
    if (marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc) {
      const bool progressive = (marker & 3) == 2;
      return Sniffed{!progressive, progressive ? big(&segment[5], 2) * big(&segment[7], 2) * segment[9] * 2 : 0};
    }
    at += 2 + big(&segment[2], 2);
  }
  return Sniffed{true, 0};  // without a frame: the library says what is the matter
}

// Rows that an OpenEXR file packs together.
int64_t exrChunkRows(const OIIO::ImageSpec& spec) {
  const std::string name = spec.get_string_attribute("compression");
  return name.starts_with("dwab")                                                         ? 256
         : name.starts_with("piz") || name.starts_with("b44") || name.starts_with("dwaa") ? 32
         : name == "zip" || name.starts_with("pxr24")                                     ? 16
                                                                                          : 1;
}

// OpenEXR allocates what an attribute of the header claims before it looks for it in the file: 271 bytes take 1.8 GB.
// Each is a name and a type, which end with a 0, a size and that many bytes; a header ends with an empty name, several
// parts with an empty header. What is no such list is left to the library to refuse.
Result<void> checkExrHeader(const InputFile& file) {
  constexpr std::array<uint8_t, 4> kMagic{0x76, 0x2F, 0x31, 0x01};
  constexpr size_t kMostText = 256;  // of a name, with its end
  constexpr int kMostAttributes = 65536;
  constexpr uint8_t kMultiPart = 0x10;  // in the second byte of the flags
  std::array<uint8_t, 8> head{};
  if (file.size() < head.size()) return {};
  if (auto read = file.read(0, head); !read) return read;
  if (!std::equal(kMagic.begin(), kMagic.end(), head.begin())) return {};
  uint64_t at = head.size();
  bool ends = false;
  auto text = [&]() -> Result<std::string> {
    std::array<uint8_t, kMostText> bytes;
    const auto part = std::span(bytes).first(static_cast<size_t>(std::min<uint64_t>(bytes.size(), file.size() - at)));
    if (auto read = file.read(at, part); !read) return read.error();
    const auto end = std::find(part.begin(), part.end(), uint8_t{0});
    ends = end == part.end();
    at += static_cast<uint64_t>(end - part.begin()) + 1;
    return std::string(part.begin(), end);
  };
  bool any = false;  // in this header
  for (int k = 0; k < kMostAttributes; ++k) {
    auto name = text();
    if (!name) return name.error();
    if (ends) return {};
    if (name->empty()) {
      if (!(head[5] & kMultiPart) || !any) return {};
      any = false;
      continue;
    }
    any = true;
    auto type = text();
    if (!type) return type.error();
    std::array<uint8_t, 4> bytes;
    if (ends || file.size() - at < bytes.size()) return {};
    if (auto read = file.read(at, bytes); !read) return read;
    const uint64_t size = bytes[0] | bytes[1] << 8 | bytes[2] << 16 | static_cast<uint64_t>(bytes[3]) << 24;
    if (size > file.size() - at - bytes.size()) {
      return Error{ErrorKind::kInvalidData, file.path(),
                   "expected the EXR header's attribute \"" + oneLine(*name) + "\" within the file of " +
                       std::to_string(file.size()) + " bytes, found a size of " + std::to_string(size),
                   kDamagedHint, at};
    }
    at += bytes.size() + size;
  }
  return {};
}

// OpenImageIO compares the name of a JPEG's segment APP1 or APP13 without looking at the segment's length, and believes
// the size that IPTC metadata claims: both would be read beyond their memory. Looked at as libjpeg goes from marker to
// marker, over bytes that are none, up to the first scan.
Result<void> checkJpegHeader(const InputFile& file) {
  using namespace std::string_view_literals;
  constexpr uint8_t kScan = 0xda, kApp1 = 0xe1, kApp13 = 0xed, kEndOfImage = 0xd9;
  constexpr std::string_view kExif = "Exif\0\0"sv, kXmp = "http://ns.adobe.com/xap/1.0/\0"sv,
                             kPhotoshop = "Photoshop 3.0\0"sv, kIptc = "8BIM\4\4"sv;
  constexpr size_t kTiffHeader = 8;  // what EXIF begins with
  constexpr size_t kIptcHead =
      4 + 2 + 4 + 2;  // of kIptc the type, its name, its size (32 bit, of which the lower 16 are read)
  std::vector<uint8_t> bytes(2);
  if (file.size() < bytes.size()) return {};
  if (auto read = file.read(0, bytes); !read) return read;
  if (bytes[0] != 0xff || bytes[1] != 0xd8) return {};
  uint64_t at = 2;
  // The next n bytes, or as many as there are.
  auto take = [&](size_t n) -> Result<std::string_view> {
    bytes.resize(static_cast<size_t>(std::min<uint64_t>(n, file.size() - at)));
    if (auto read = file.read(at, bytes); !read) return read.error();
    at += bytes.size();
    return std::string_view(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  };
  for (;;) {
    // A marker: 0xff as often as one likes, then a byte that is neither 0 nor 0xff.
    uint8_t marker = 0;
    for (bool prefix = false; marker == 0;) {
      constexpr size_t kStep = 4096;
      const uint64_t start = at;
      auto step = take(kStep);
      if (!step) return step.error();
      if (step->empty()) return {};
      for (size_t k = 0; k < step->size() && marker == 0; ++k) {
        const auto byte = static_cast<uint8_t>((*step)[k]);
        if (prefix && byte != 0 && byte != 0xff) marker = byte, at = start + k + 1;
        prefix = byte == 0xff;
      }
    }
    if (marker == kScan || marker == kEndOfImage) return {};
    if (marker == 0x01 || (marker >= 0xd0 && marker <= 0xd8)) continue;  // alone
    const uint64_t start = at;
    auto length = take(2);
    if (!length) return length.error();
    if (length->size() < 2) return {};
    const size_t size =
        static_cast<size_t>(static_cast<uint8_t>((*length)[0]) << 8 | static_cast<uint8_t>((*length)[1]));
    if (size < 2) return {};  // libjpeg refuses it
    if (marker != kApp1 && marker != kApp13) {
      at += std::min<uint64_t>(size - 2, file.size() - at);
      continue;
    }
    auto data = take(size - 2);
    if (!data) return data.error();
    if (data->size() < size - 2) return {};  // libjpeg fills it up
    auto cutWithin = [&](std::string_view name) { return data->size() < name.size() && name.starts_with(*data); };
    bool cut = marker == kApp1 ? cutWithin(kExif) || cutWithin(kXmp) : cutWithin(kPhotoshop);
    if (marker == kApp1 && data->starts_with(kExif.substr(0, 5))) cut = data->size() < kExif.size() + kTiffHeader;
    if (marker == kApp13 && data->starts_with(kPhotoshop)) {
      const std::string_view block = data->substr(kPhotoshop.size());
      cut = block.size() < kIptc.size() && kIptc.starts_with(block);
      if (block.starts_with(kIptc)) {
        cut = block.size() < kIptcHead ||
              block.size() - kIptcHead < static_cast<size_t>(static_cast<uint8_t>(block[kIptcHead - 2]) << 8 |
                                                             static_cast<uint8_t>(block[kIptcHead - 1]));
      }
    }
    if (cut) {
      return Error{ErrorKind::kInvalidData, file.path(),
                   "expected the metadata that the JPEG's segment of " + std::to_string(size) +
                       " bytes begins with, found its end",
                   "save the image without its metadata, or copy the file again", start};
    }
  }
}

Result<OpenImage> openImage(const std::string& path, const ImageReadOptions& options) {
  // The file first, for errors that say what is the matter: OpenImageIO calls a missing file an unknown format.
  auto file = InputFile::open(path);
  if (!file) return file.error();
  if (file->size() == 0) {
    return Error{ErrorKind::kInvalidData, path, "expected an image, found an empty file", kDamagedHint, uint64_t{0}};
  }
  auto sniffed = sniff(*file);
  if (!sniffed) return sniffed.error();
  constexpr const char* kWhole = "it only decodes as a whole, which takes";
  constexpr const char* kWholeOption = "--max-image-mib";
  if (sniffed->whole_bytes > options.decodedLimit())
    return beyond(path, kWhole, sniffed->whole_bytes, options.decodedLimit(), kWholeOption, 3, options);
  if (auto sound = checkExrHeader(*file); !sound) return sound.error();
  if (auto sound = checkJpegHeader(*file); !sound) return sound.error();
  OpenImage image;
  image.file_bytes = file->size();
  const OIIO::ImageSpec config = openConfig();
  {
    // The library's own limit is the whole program's and is looked at on opening. What is read in parts is checked
    // below.
    static std::mutex opening;
    std::lock_guard lock(opening);
    OIIO::attribute(
        "limits:imagesize_MB",
        sniffed->in_parts ? 0 : static_cast<int>(std::min<uint64_t>((options.decodedLimit() >> 20) + 1, 1 << 30)));
    image.input = OIIO::ImageInput::open(path, &config);
  }
  if (!image.input) {
    return Error{ErrorKind::kInvalidData,
                 path,
                 "expected an image, found: " + oneLine(OIIO::geterror()),
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
  using Bytes = unsigned __int128;
  const Bytes pixel = s.pixel_bytes(true), bytes = static_cast<Bytes>(s.width) * s.height * pixel;
  if (bytes > static_cast<Bytes>(image.file_bytes) * options.max_packing + kPackingSlackBytes) {
    return Error{
        ErrorKind::kInvalidData,
        path,
        "expected at least " + std::to_string(static_cast<uint64_t>(bytes / options.max_packing)) + " bytes for " +
            std::to_string(s.width) + " x " + std::to_string(s.height) + " pixels, found " +
            std::to_string(image.file_bytes),
        std::string(kDamagedHint) + "; --max-packing allows more than 1:" + std::to_string(options.max_packing),
        {}};
  }
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
    if (bad_y >= 0) {
      const auto [first, step] = all.row(bad_y);
      const int64_t place = first + bad_x * step;
      bad_x = place % width(), bad_y = place / width();
      return Error{ErrorKind::kInvalidData,
                   cache_.path(),
                   "expected a finite height, found none at pixel (" + std::to_string(bad_x) + ", " +
                       std::to_string(bad_y) + "), counted from the top left",
                   "fill the holes of the height map before",
                   {}};
    }
    constexpr float kRounding = 1e-6f;
    if (shares && !(lo >= -kRounding && hi <= 1 + kRounding)) {
      return Error{ErrorKind::kUsage,
                   cache_.path(),
                   "expected samples from 0 to 1 beside a height range, found floats from " + std::to_string(lo) +
                       " to " + std::to_string(hi),
                   "leave out --relief-mm: a float map's heights are mm",
                   {}};
    }
    // As read() computes them, so that the range holds every sample to the last bit.
    const float a = toMm(lo), b = toMm(hi);
    setRange(std::min(a, b), std::max(a, b));
    if (!std::isfinite(min_mm_) || !std::isfinite(max_mm_)) {
      return Error{ErrorKind::kInvalidData,
                   cache_.path(),
                   "expected heights that single precision holds, found larger ones",
                   "",
                   {}};
    }
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
  double offset_, scale_, min_mm_ = 0, max_mm_ = 0;
  mutable BandCache cache_;
};

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
    return keep([&] {
      return bytes_.read(static_cast<uint64_t>(offset), {static_cast<uint8_t*>(to), size});
    })
               ? size
               : 0;
  }
  size_t pwrite(const void* from, size_t size, int64_t offset) override {
    const std::lock_guard lock(mutex_);
    if (offset < 0 || failed_ || out_of_memory_) return 0;
    end_ = std::max(end_, static_cast<uint64_t>(offset) + size);
    return keep([&] {
      return bytes_.write(static_cast<uint64_t>(offset), {static_cast<const uint8_t*>(from), size});
    })
               ? size
               : 0;
  }
  size_t size() const override { return bytes_.size(); }
  const std::optional<Error>& failed() const {
    if (out_of_memory_) throw std::bad_alloc();
    return failed_;
  }
  uint64_t end() const { return end_; }  // of what was written

 private:
  // No exception leaves it: the frames of a library in C lie between it and whoever would catch it.
  template <class Call>
  bool keep(Call call) noexcept {
    try {
      const Result<void> done = call();
      if (!done && !failed_) failed_ = done.error();
      return done.ok();
    } catch (const std::bad_alloc&) {
      out_of_memory_ = true;
      return false;
    }
  }
  ImageBytes& bytes_;
  std::mutex mutex_;
  std::optional<Error> failed_;
  bool out_of_memory_ = false;
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
    case ImageFormat::kPng:
      return "png";
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
  if (format == ImageFormat::kPng) {
    // The writer cuts off what is beyond a whole pixel a metre, of a float.
    px = (std::round(px_per_m) + 0.25) / 100;
  } else if (format == ImageFormat::kJpeg) {
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
      } else if (encoding_.type == SampleType::kUint8 &&
                 (encoding_.channels >= 3 || encoding_.format == ImageFormat::kPng)) {
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

Result<std::unique_ptr<ImageEncoder>> createEncoder(const ImageEncoding& e, ImageBytes& bytes) {
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

void halvesFromFloats(std::span<const float> floats, uint16_t* halves) {
  constexpr size_t kPiece = size_t{1} << 20;  // the library counts in int
  for (size_t i = 0; i < floats.size(); i += kPiece)
    OIIO::convert_pixel_values(OIIO::TypeFloat, floats.data() + i, OIIO::TypeHalf, halves + i,
                               static_cast<int>(std::min(kPiece, floats.size() - i)));
}

}  // namespace

// OpenImageIO's own threads end the process where they cannot be started; files are read by several of our threads at
// once.
[[maybe_unused]] static const bool kOneThread = OIIO::attribute("threads", 1) && OIIO::attribute("exr_threads", -1);

const ImageIoModule relievo_image_io{readFacts, openColour, openHeight, readPixels8, createEncoder, halvesFromFloats};

}  // namespace relievo
