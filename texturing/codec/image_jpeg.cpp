#include "texturing/codec/image_jpeg.h"

#include <cassert>

#include "texturing/codec/jpeg_errors.h"

namespace relievo {
namespace {

enum Marker : uint8_t {
  kBaseline = 0xC0,
  kExtended = 0xC1,
  kProgressive = 0xC2,
  kHuffmanTables = 0xC4,
  kStart = 0xD8,
  kEnd = 0xD9,
  kScan = 0xDA,
  kQuantisation = 0xDB,
  kRestartInterval = 0xDD,
  kJfif = 0xE0,
  kAdobe = 0xEE,  // says how colours are encoded
  kLastApplication = 0xEF,
  kComment = 0xFE
};

bool isKept(uint8_t marker) {
  return marker == kBaseline || marker == kExtended || marker == kProgressive || marker == kHuffmanTables ||
         marker == kQuantisation || marker == kRestartInterval || marker == kJfif || marker == kAdobe ||
         marker == kScan;
}

Error damagedJpeg(const char* what) {
  return {ErrorKind::kInvalidData, "", what, "rebuild the package, or get a whole copy", {}};
}

// Called while scans are read.
void countScans(j_common_ptr info) {
  if (reinterpret_cast<j_decompress_ptr>(info)->input_scan_number > kMostJpegScans) jpeg::leave(info);
}

}  // namespace

std::vector<uint8_t> plainJpeg(std::span<const uint8_t> file) {
  if (file.size() < 4 || file[0] != 0xFF || file[1] != kStart) return {};
  std::vector<uint8_t> out{0xFF, kStart};
  auto keep = [&](size_t from, size_t to) {
    out.insert(out.end(), file.begin() + static_cast<std::ptrdiff_t>(from),
               file.begin() + static_cast<std::ptrdiff_t>(to));
  };
  int scans = 0;
  for (size_t at = 2; at < file.size() && file.size() - at >= 2;) {
    if (file[at] != 0xFF) return {};
    const uint8_t marker = file[at + 1];
    if (marker == 0xFF) {  // a byte of padding
      ++at;
      continue;
    }
    if (marker == kEnd) {
      keep(at, at + 2);
      return scans > 0 ? out : std::vector<uint8_t>();
    }
    if (file.size() - at < 4) return {};
    size_t end = at + 2 + (size_t{file[at + 2]} << 8 | file[at + 3]);
    if (end > file.size()) return {};
    if (marker == kScan) {
      if (++scans > kMostJpegScans) return {};
      // Up to the next marker that is no restart, and no byte of the code.
      while (end + 1 < file.size() && !(file[end] == 0xFF && file[end + 1] != 0 && (file[end + 1] & 0xF8) != 0xD0))
        ++end;
    }
    const bool describes = (marker > kJfif && marker <= kLastApplication) || marker == kComment;
    if (isKept(marker)) keep(at, end);
    else if (!describes) return {};
    at = end;
  }
  return {};
}

std::optional<JpegSize> sizeOfPlainJpeg(std::span<const uint8_t> jpeg) {
  const auto two = [&](size_t at) { return uint32_t{jpeg[at]} << 8 | jpeg[at + 1]; };
  // Behind a frame's marker lie its length, its precision, then height and width.
  for (size_t at = 2; at < jpeg.size() && jpeg.size() - at >= 9 && jpeg[at] == 0xFF; at += 2 + size_t{two(at + 2)}) {
    const uint8_t marker = jpeg[at + 1];
    if (marker == kBaseline || marker == kExtended || marker == kProgressive) return JpegSize{two(at + 7), two(at + 5)};
    if (marker == kScan) break;
  }
  return std::nullopt;
}

struct ImageJpegReader::Impl {
  jpeg_decompress_struct info;
  jpeg::JumpingErrors errors;
  jpeg_source_mgr source;
  jpeg_progress_mgr progress;

  Impl() {
    info.err = jpeg::jumpingErrors(&errors);
    jpeg_create_decompress(&info);
    jpeg::readFromMemory(info, source);
    progress.progress_monitor = countScans;
    info.progress = &progress;
  }
  ~Impl() { jpeg_destroy_decompress(&info); }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  // Null, or what is wrong.
  const char* open(const uint8_t* bytes, size_t size, uint32_t width, uint32_t height) {
    source.next_input_byte = bytes;
    source.bytes_in_buffer = size;
    if (setjmp(errors.jump)) return "it holds a damaged JPEG";
    jpeg_read_header(&info, TRUE);
    const bool colours = info.jpeg_color_space == JCS_GRAYSCALE ? info.num_components == 1
                         : info.jpeg_color_space == JCS_RGB || info.jpeg_color_space == JCS_YCbCr
                             ? info.num_components == 3
                             : false;
    if (info.image_width != width || info.image_height != height || info.data_precision != 8 || info.arith_code ||
        !colours)
      return "it holds a JPEG of another size or kind";
    info.out_color_space = JCS_RGB;
    info.dct_method = JDCT_ISLOW;
    info.do_fancy_upsampling = TRUE;
    info.do_block_smoothing = FALSE;
    jpeg_start_decompress(&info);
    return nullptr;
  }
  const char* read(size_t rows, uint8_t* rgb) {
    if (setjmp(errors.jump)) return "it holds a damaged JPEG";
    const size_t stride = size_t{3} * info.output_width;
    for (size_t done = 0; done < rows;) {
      JSAMPROW row = rgb + stride * done;
      done += jpeg_read_scanlines(&info, &row, 1);
    }
    if (info.output_scanline < info.output_height) return nullptr;
    jpeg_finish_decompress(&info);
    return source.bytes_in_buffer == 0 ? nullptr : "it goes on behind its JPEG";
  }
};

ImageJpegReader::ImageJpegReader() : impl_(std::make_unique<Impl>()) {}
ImageJpegReader::ImageJpegReader(ImageJpegReader&&) noexcept = default;
ImageJpegReader::~ImageJpegReader() = default;

Result<ImageJpegReader> ImageJpegReader::open(std::span<const uint8_t> jpeg, uint32_t width, uint32_t height) {
  ImageJpegReader reader;
  if (const char* wrong = reader.impl_->open(jpeg.data(), jpeg.size(), width, height)) return damagedJpeg(wrong);
  return reader;
}

Result<void> ImageJpegReader::read(size_t rows, std::span<uint8_t> rgb) {
  assert(rgb.size() == size_t{3} * impl_->info.output_width * rows &&
         impl_->info.output_scanline + rows <= impl_->info.output_height);
  if (const char* wrong = impl_->read(rows, rgb.data())) return damagedJpeg(wrong);
  return {};
}

}  // namespace relievo
