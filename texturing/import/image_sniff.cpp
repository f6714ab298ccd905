#include "texturing/import/image_sniff.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <cstring>
#include <span>
#include <string_view>
#include <vector>

namespace relievo {

std::string oneLine(std::string text) {
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20) c = ' ';
  }
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return text.empty() ? "no reason given" : text;
}

Result<Sniffed> sniffImage(const InputFile& file) {
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

Result<std::optional<double>> noDataOf(const InputFile& file) {
  constexpr uint64_t kTag = 42113, kAscii = 2, kMostText = 64;
  std::optional<double> none;
  std::array<uint8_t, 16> head{};
  if (file.size() < head.size()) return none;
  if (auto read = file.read(0, head); !read) return read.error();
  const bool big_endian = head[0] == 'M';
  auto number = [&](const uint8_t* p, size_t bytes) {
    uint64_t v = 0;
    for (size_t i = 0; i < bytes; ++i) v = v << 8 | p[big_endian ? i : bytes - 1 - i];
    return v;
  };
  const uint64_t version = number(&head[2], 2);
  if (head[0] != head[1] || (head[0] != 'I' && !big_endian) || (version != 42 && version != 43)) return none;
  // Bytes of the directory's count, of an offset or an entry's count, and of an entry.
  const size_t count_bytes = version == 43 ? 8 : 2, word = version == 43 ? 8 : 4, entry_bytes = 4 + 2 * word;
  uint64_t at = version == 43 ? number(&head[8], 8) : number(&head[4], 4);
  std::array<uint8_t, 20> entry;
  if (at > file.size() || file.size() - at < count_bytes) return none;
  if (auto read = file.read(at, std::span(entry).first(count_bytes)); !read) return read.error();
  const uint64_t entries = std::min<uint64_t>(number(entry.data(), count_bytes), 65535);
  at += count_bytes;
  for (uint64_t i = 0; i < entries && file.size() - at >= entry_bytes; ++i, at += entry_bytes) {
    if (auto read = file.read(at, std::span(entry).first(entry_bytes)); !read) return read.error();
    if (number(&entry[0], 2) != kTag || number(&entry[2], 2) != kAscii) continue;
    const uint64_t length = number(&entry[4], word);
    const uint64_t place = length <= word ? at + 4 + word : number(&entry[4 + word], word);
    if (length == 0 || length > kMostText || place > file.size() || file.size() - place < length) return none;
    std::string text(length, '\0');
    if (auto read = file.read(place, {reinterpret_cast<uint8_t*>(text.data()), length}); !read) return read.error();
    text.resize(std::strlen(text.c_str()));
    char* end = nullptr;
    const double value = std::strtod(text.c_str(), &end);
    if (end != text.c_str()) return std::optional(value);
    return none;
  }
  return none;
}

namespace {

// Goes through the header of an OpenEXR file.
struct ExrHeader {
  const InputFile& file;
  uint64_t at = 0;
  bool ended = false;  // the text that was read last has no end where it may have one
  ClaimedPixels claimed;

  Result<std::string> text() {
    constexpr size_t kMostText = 256;  // of a name, with its end
    std::array<uint8_t, kMostText> bytes;
    const auto part = std::span(bytes).first(static_cast<size_t>(std::min<uint64_t>(bytes.size(), file.size() - at)));
    if (auto read = file.read(at, part); !read) return read.error();
    const auto end = std::find(part.begin(), part.end(), uint8_t{0});
    ended = end == part.end();
    at += static_cast<uint64_t>(end - part.begin()) + 1;
    return std::string(part.begin(), end);
  }
  Result<uint32_t> number() {
    std::array<uint8_t, 4> bytes;
    if (auto read = file.read(at, bytes); !read) return read.error();
    at += bytes.size();
    return bytes[0] | bytes[1] << 8 | bytes[2] << 16 | static_cast<uint32_t>(bytes[3]) << 24;
  }
  // How many bytes the library reads of a value of this type, of `size` bytes from here, whatever its size claims to
  // be.
  Result<uint64_t> bytesRead(const std::string& type, uint64_t size) {
    constexpr std::pair<const char*, uint64_t> kFixed[] = {{"box2f", 16},
                                                           {"box2i", 16},
                                                           {"chromaticities", 32},
                                                           {"compression", 1},
                                                           {"deepImageState", 1},
                                                           {"double", 8},
                                                           {"envmap", 1},
                                                           {"float", 4},
                                                           {"int", 4},
                                                           {"keycode", 28},
                                                           {"lineOrder", 1},
                                                           {"m33d", 72},
                                                           {"m33f", 36},
                                                           {"m44d", 128},
                                                           {"m44f", 64},
                                                           {"rational", 8},
                                                           {"tiledesc", 9},
                                                           {"timecode", 8},
                                                           {"v2d", 16},
                                                           {"v2f", 8},
                                                           {"v2i", 8},
                                                           {"v3d", 24},
                                                           {"v3f", 12},
                                                           {"v3i", 12}};
    for (const auto& [name, bytes] : kFixed)
      if (type == name) return bytes;
    if (type == "preview" && size >= 8) {
      auto width = number();
      if (!width) return width.error();
      auto height = number();
      if (!height) return height.error();
      const auto pixels = static_cast<unsigned __int128>(*width) * *height;
      return static_cast<uint64_t>(std::min<unsigned __int128>(8 + 4 * pixels, ~uint64_t{0}));
    }
    if (type != "chlist") return size;
    constexpr uint64_t kBytesPerChannel = 16;  // behind its name
    const uint64_t first = at, end = at + size;
    while (at < end) {
      auto channel = text();
      if (!channel) return channel.error();
      if (channel->empty()) return at - first;
      constexpr uint32_t kHalf = 1;
      auto kind = number();
      if (!kind) return kind.error();
      claimed.pixel_bytes += *kind == kHalf ? 2 : 4;
      at += kBytesPerChannel - 4;
    }
    return std::max(at, end + 1) - first;  // the list goes on
  }
  // Of the data window, four numbers.
  Result<void> readWindow() {
    std::array<int32_t, 4> window{};
    for (int32_t& v : window) {
      auto next = number();
      if (!next) return next.error();
      v = static_cast<int32_t>(*next);
    }
    claimed.width = std::max<int64_t>(int64_t{window[2]} - window[0] + 1, 0);
    claimed.height = std::max<int64_t>(int64_t{window[3]} - window[1] + 1, 0);
    return {};
  }
};

}  // namespace

// OpenEXR allocates what an attribute of the header claims before it looks for it in the file: 271 bytes take 1.8 GB.
// Each is a name and a type, which end with a 0, a size and that many bytes; a header ends with an empty name, several
// parts with an empty header. Of the types that the library knows it reads what the type says, and takes what comes
// next for the next attribute: there another size would lead us past claims that the library believes. What is no such
// list is left to the library to refuse.
Result<ClaimedPixels> checkExrHeader(const InputFile& file) {
  constexpr std::array<uint8_t, 4> kMagic{0x76, 0x2F, 0x31, 0x01};
  constexpr int kMostAttributes = 65536;
  constexpr uint8_t kMultiPart = 0x10;  // in the second byte of the flags
  std::array<uint8_t, 8> head{};
  if (file.size() < head.size()) return ClaimedPixels{};
  if (auto read = file.read(0, head); !read) return read.error();
  if (!std::equal(kMagic.begin(), kMagic.end(), head.begin())) return ClaimedPixels{};
  ExrHeader header{file, head.size()};
  ClaimedPixels most;
  bool any = false;  // in this header
  for (int k = 0; k < kMostAttributes; ++k) {
    auto name = header.text();
    if (!name) return name.error();
    if (header.ended) break;
    if (name->empty()) {
      if (header.claimed.bytes() > most.bytes()) most = header.claimed;
      header.claimed = {};
      if (!(head[5] & kMultiPart) || !any) break;
      any = false;
      continue;
    }
    any = true;
    auto type = header.text();
    if (!type) return type.error();
    const uint64_t size_at = header.at;
    if (header.ended || file.size() - size_at < 4) break;
    auto size = header.number();
    if (!size) return size.error();
    const uint64_t value_at = header.at;
    auto attribute = [&](const std::string& expected, const std::string& found) {
      return Error{ErrorKind::kInvalidData, file.path(),
                   "expected the EXR header's attribute \"" + oneLine(*name) + "\" " + expected + ", found " + found,
                   kDamagedHint, size_at};
    };
    if (*size > file.size() - value_at) {
      return attribute("within the file of " + std::to_string(file.size()) + " bytes",
                       "a size of " + std::to_string(*size));
    }
    auto bytes = header.bytesRead(*type, *size);
    if (!bytes) return bytes.error();
    if (*bytes != *size) return attribute("of " + std::to_string(*bytes) + " bytes", std::to_string(*size));
    header.at = value_at;
    if (*name == "dataWindow" && *type == "box2i")
      if (auto read = header.readWindow(); !read) return read.error();
    header.at = value_at + *size;
  }
  return most;
}

namespace {

constexpr uint8_t kApp1 = 0xe1, kApp2 = 0xe2, kApp13 = 0xed;

size_t bigEndian16(std::string_view bytes) {
  return static_cast<size_t>(static_cast<uint8_t>(bytes[0]) << 8 | static_cast<uint8_t>(bytes[1]));
}

// Would OpenImageIO read beyond the end of a segment APP1, APP2 or APP13 that holds these bytes?
bool metadataCutShort(uint8_t marker, std::string_view data) {
  using namespace std::string_view_literals;
  constexpr std::string_view kExif = "Exif\0\0"sv, kXmp = "http://ns.adobe.com/xap/1.0/\0"sv,
                             kPhotoshop = "Photoshop 3.0\0"sv, kIcc = "ICC_PROFILE\0"sv, kIptc = "8BIM\4\4"sv;
  constexpr size_t kTiffHeader = 8;  // what EXIF begins with
  constexpr size_t kIptcHead =
      4 + 2 + 4 + 2;  // of kIptc the type, its name, its size (32 bit, of which the lower 16 are read)
  auto cutWithin = [&](std::string_view name) { return data.size() < name.size() && name.starts_with(data); };
  if (marker == kApp1 && data.starts_with(kExif.substr(0, 5))) return data.size() < kExif.size() + kTiffHeader;
  if (marker == kApp1) return cutWithin(kExif) || cutWithin(kXmp);
  // Of a colour profile, its name, then which part of how many this is.
  if (marker == kApp2) return cutWithin(kIcc) || (data.starts_with(kIcc) && data.size() < kIcc.size() + 2);
  if (!data.starts_with(kPhotoshop)) return cutWithin(kPhotoshop);
  const std::string_view block = data.substr(kPhotoshop.size());
  if (!block.starts_with(kIptc)) return block.size() < kIptc.size() && kIptc.starts_with(block);
  return block.size() < kIptcHead || block.size() - kIptcHead < bigEndian16(block.substr(kIptcHead - 2));
}

}  // namespace

// OpenImageIO compares the name of a JPEG's segment APP1, APP2 or APP13 without looking at the segment's length, and
// believes the size that IPTC metadata claims, or what it takes for one if the metadata has a name: both would be read
// beyond their memory. Looked at as libjpeg goes from marker to marker, over bytes that are none, up to the first scan.
Result<std::vector<uint64_t>> unsafeJpegMarkers(const InputFile& file) {
  constexpr uint8_t kScan = 0xda, kEndOfImage = 0xd9, kNoMarker = 0;
  constexpr size_t kMostUnsafe = 1024;
  std::vector<uint64_t> unsafe;
  std::vector<uint8_t> bytes(2);
  if (file.size() < bytes.size()) return unsafe;
  if (auto read = file.read(0, bytes); !read) return read.error();
  if (bytes[0] != 0xff || bytes[1] != 0xd8) return unsafe;
  uint64_t at = 2;
  // The next n bytes, or as many as there are.
  auto take = [&](size_t n) -> Result<std::string_view> {
    bytes.resize(static_cast<size_t>(std::min<uint64_t>(n, file.size() - at)));
    if (auto read = file.read(at, bytes); !read) return read.error();
    at += bytes.size();
    return std::string_view(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  };
  // 0xff as often as one likes, then a byte that is neither 0 nor 0xff; kNoMarker at the file's end.
  auto nextMarker = [&]() -> Result<uint8_t> {
    constexpr size_t kStep = 4096;
    for (bool prefix = false;;) {
      const uint64_t start = at;
      auto step = take(kStep);
      if (!step) return step.error();
      if (step->empty()) return kNoMarker;
      for (size_t k = 0; k < step->size(); ++k) {
        const auto byte = static_cast<uint8_t>((*step)[k]);
        if (prefix && byte != 0 && byte != 0xff) {
          at = start + k + 1;
          return byte;
        }
        prefix = byte == 0xff;
      }
    }
  };
  for (;;) {
    auto found = nextMarker();
    if (!found) return found.error();
    const uint8_t marker = *found;
    if (marker == kNoMarker) return unsafe;
    if (marker == kScan || marker == kEndOfImage) return unsafe;
    if (marker == 0x01 || (marker >= 0xd0 && marker <= 0xd8)) continue;  // alone
    const uint64_t marker_at = at - 1;
    auto length = take(2);
    if (!length) return length.error();
    if (length->size() < 2) return unsafe;
    const size_t size = bigEndian16(*length);
    if (size < 2) return unsafe;  // libjpeg refuses it
    if (marker != kApp1 && marker != kApp2 && marker != kApp13) {
      at += std::min<uint64_t>(size - 2, file.size() - at);
      continue;
    }
    auto data = take(size - 2);
    if (!data) return data.error();
    if (data->size() < size - 2) return unsafe;  // libjpeg fills it up
    if (!metadataCutShort(marker, *data)) continue;
    if (unsafe.size() == kMostUnsafe) {
      return Error{ErrorKind::kInvalidData, file.path(),
                   "expected metadata in at most " + std::to_string(kMostUnsafe) +
                       " segments that their names or sizes fit, found more",
                   "save the image without its metadata, or copy the file again", marker_at};
    }
    unsafe.push_back(marker_at);
  }
}

}  // namespace relievo
