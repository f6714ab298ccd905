// ptm_jpeg.cpp - the JPEG variants of .ptm.
//
// Each plane is a grey JPEG, perhaps predicted from a plane decoded before it:
//   sample += reference - 128, the reference inverted (255 - r) if transform bit 0 is set, and taken from
//   (x + motion_x, y + motion_y), clamped to the border, if bit 1 is set (transform 2, motion compensation).
// Then side information replaces single samples: records of a big-endian 32-bit offset and a value.
// Choices where the format's description leaves room, or readers disagree:
//   - The sum is taken modulo 256, as bytes add. That is what the readers of the field do, so what the format's encoder
//     counts on: a residual beyond +-128 wraps in the file and back here, and where JPEG's loss carries a sample over
//     the end of the range, side information is there to put it right. Clamping would spoil the former.
//   - Offsets of side information count in the JPEG's own rows, bottom to top. One reader flips them, but it flips the
//     decoded picture as well, which amounts to the same; another that flips only the offsets contradicts both.
//   - Motion vectors: all x, then all y; in the JPEG's own rows; a reference sample beyond the border is the border's.
//     No file that uses them is known.
#include <algorithm>
#include <atomic>
#include <csetjmp>
#include <cstdio>
#include <optional>

#include <jpeglib.h>

#include <jerror.h>

#include "src/base/parallel_for.h"
#include "texturing/import/ptm_internal.h"

namespace relievo::ptm_detail {
namespace {

// A block of 8x8 samples takes at least one bit (its DC code) in a Huffman-coded JPEG: 512 samples a byte at the very
// most.
constexpr uint64_t kMaxSamplesPerByte = 512;
// Progressive files with thousands of empty scans are an attack on time, not pictures.
constexpr int kMaxScans = 200;

struct ErrorManager {
  jpeg_error_mgr base;
  std::jmp_buf jump;
  bool corrupt = false;
  char message[JMSG_LENGTH_MAX] = {};
};

void onError(j_common_ptr info) {
  auto* manager = reinterpret_cast<ErrorManager*>(info->err);
  if (!manager->corrupt) info->err->format_message(info, manager->message);
  std::longjmp(manager->jump, 1);
}

// Warnings: bytes between markers and odd version numbers lose no sample; anything else means that samples are made up.
void onMessage(j_common_ptr info, int level) {
  if (level >= 0) return;
  const int code = info->err->msg_code;
  if (code == JWRN_EXTRANEOUS_DATA || code == JWRN_JFIF_MAJOR || code == JWRN_ADOBE_XFORM) return;
  auto* manager = reinterpret_cast<ErrorManager*>(info->err);
  if (manager->corrupt) return;
  manager->corrupt = true;
  info->err->format_message(info, manager->message);
}

void onProgress(j_common_ptr info) {
  auto* decompress = reinterpret_cast<j_decompress_ptr>(info);
  if (info->is_decompressor && decompress->input_scan_number > kMaxScans) {
    info->err->msg_code = JERR_BAD_PROGRESSION;
    info->err->error_exit(info);
  }
}

// Empty: decoded. No object with a destructor lives in here, because of longjmp.
bool decodeGrey(const uint8_t* bytes, size_t size, int64_t width, int64_t height, uint8_t* out, ErrorManager& manager) {
  jpeg_decompress_struct info;
  jpeg_progress_mgr progress{};
  info.err = jpeg_std_error(&manager.base);
  manager.base.error_exit = onError;
  manager.base.emit_message = onMessage;
  if (setjmp(manager.jump)) {
    jpeg_destroy_decompress(&info);
    return false;
  }
  jpeg_create_decompress(&info);
  progress.progress_monitor = onProgress;
  info.progress = &progress;
  jpeg_mem_src(&info, bytes, size);
  jpeg_read_header(&info, TRUE);
  if (info.image_width != static_cast<uint64_t>(width) || info.image_height != static_cast<uint64_t>(height) ||
      info.num_components != 1) {
    std::snprintf(manager.message, sizeof manager.message,
                  "expected a grey JPEG of %lld x %lld, found %u x %u with %d channels", static_cast<long long>(width),
                  static_cast<long long>(height), info.image_width, info.image_height, info.num_components);
    jpeg_destroy_decompress(&info);
    return false;
  }
  // Progressive files keep two bytes a coefficient until the last scan; never more than a few times the plane.
  info.mem->max_memory_to_use = static_cast<long>(4 * width * height + (16 << 20));
  info.out_color_space = JCS_GRAYSCALE;
  jpeg_start_decompress(&info);
  while (info.output_scanline < info.output_height) {
    JSAMPROW row = out + static_cast<size_t>(info.output_scanline) * width;
    jpeg_read_scanlines(&info, &row, 1);
  }
  jpeg_finish_decompress(&info);
  jpeg_destroy_decompress(&info);
  return !manager.corrupt;
}

// out += prediction from reference - 128, modulo 256.
void predict(const JpegPlane& plane, const uint8_t* reference, int64_t width, int64_t height, uint8_t* out) {
  const int flip = plane.transform & 1 ? 255 : 0;  // r ^ 255 = 255 - r
  const bool moved = (plane.transform & 2) && (plane.motion_x != 0 || plane.motion_y != 0);
  for (int64_t y = 0; y < height; ++y) {
    const uint8_t* from = reference + (moved ? std::clamp<int64_t>(y + plane.motion_y, 0, height - 1) : y) * width;
    uint8_t* to = out + y * width;
    if (moved) {
      for (int64_t x = 0; x < width; ++x) {
        int r = from[std::clamp<int64_t>(x + plane.motion_x, 0, width - 1)] ^ flip;
        to[x] = static_cast<uint8_t>(to[x] + r - 128);
      }
    } else {
      for (int64_t x = 0; x < width; ++x) to[x] = static_cast<uint8_t>(to[x] + (from[x] ^ flip) - 128);
    }
  }
}

Result<void> applySideInformation(const InputFile& file, const JpegPlane& plane, uint64_t samples, uint8_t* out) {
  std::vector<uint8_t> records(plane.side_bytes);  // checked against the file's length with the header
  const uint64_t offset = plane.offset + plane.jpeg_bytes;
  if (auto read = file.read(offset, records); !read) return read;
  for (size_t i = 0; i + 5 <= records.size(); i += 5) {
    uint64_t at =
        uint64_t{records[i]} << 24 | uint64_t{records[i + 1]} << 16 | uint64_t{records[i + 2]} << 8 | records[i + 3];
    if (at >= samples) {
      return Error{ErrorKind::kInvalidData, file.path(),
                   "expected side information for a sample below " + std::to_string(samples) + ", found sample " +
                       std::to_string(at),
                   "the file is damaged; get a whole copy", offset + i};
    }
    out[at] = records[i + 4];
  }
  return {};
}

}  // namespace

Result<std::vector<uint8_t>> decodeJpegPlanes(const InputFile& file, const FileHeader& h, uint64_t budget_bytes) {
  const int64_t width = h.header.width, height = h.header.height;  // both at most 65,500
  const uint64_t samples = static_cast<uint64_t>(width) * height;
  const uint64_t total = samples * h.planes.size();
  for (size_t i = 0; i < h.planes.size(); ++i) {
    if (samples / kMaxSamplesPerByte > h.planes[i].jpeg_bytes) {
      return Error{ErrorKind::kInvalidData, file.path(),
                   "expected a JPEG of " + std::to_string(width) + " x " + std::to_string(height) +
                       " samples for plane " + std::to_string(i) + ", found only " +
                       std::to_string(h.planes[i].jpeg_bytes) + " bytes",
                   "the file is damaged; get a whole copy", h.planes[i].offset};
    }
  }
  if (total > budget_bytes) {
    return Error{ErrorKind::kUnsupported,
                 file.path(),
                 "JPEG variants are decoded as a whole: expected at most " + std::to_string(budget_bytes >> 20) +
                     " MiB of planes, found " + std::to_string((total >> 20) + 1) + " MiB",
                 "raise the memory budget, or convert it to PTM_FORMAT_LRGB or PTM_FORMAT_RGB",
                 {}};
  }

  std::vector<uint8_t> out(total);
  std::vector<std::optional<Error>> errors(h.planes.size());
  const int workers = samples >= 1 << 16 ? std::min(workerCount(0), 9) : 1;  // small pictures are not worth a thread
  parallelForWith(
      h.planes.size(), workers, nullptr, [] { return std::vector<uint8_t>(); },
      [&](std::vector<uint8_t>& bytes, size_t i) {
        const JpegPlane& plane = h.planes[i];
        bytes.resize(plane.jpeg_bytes);
        if (auto read = file.read(plane.offset, bytes); !read) {
          errors[i] = read.error();
          return;
        }
        ErrorManager manager;
        if (!decodeGrey(bytes.data(), bytes.size(), width, height, out.data() + i * samples, manager)) {
          errors[i] = Error{ErrorKind::kInvalidData, file.path(), "plane " + std::to_string(i) + ": " + manager.message,
                            "the file is damaged; get a whole copy", plane.offset};
        }
      });
  for (auto& error : errors) {
    if (error) return *error;  // the first plane's, whichever thread met it
  }

  std::vector<size_t> plane_at(h.planes.size());
  for (size_t i = 0; i < h.planes.size(); ++i) plane_at[h.planes[i].order] = i;
  for (size_t i : plane_at) {
    const JpegPlane& plane = h.planes[i];
    if (plane.reference >= 0)
      predict(plane, out.data() + plane.reference * samples, width, height, out.data() + i * samples);
    if (plane.side_bytes > 0) {
      if (auto done = applySideInformation(file, plane, samples, out.data() + i * samples); !done) return done.error();
    }
  }
  return out;
}

}  // namespace relievo::ptm_detail
