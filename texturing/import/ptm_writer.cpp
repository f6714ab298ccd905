// ptm_writer.cpp - any texture source into an uncompressed PTM_1.2 file.
//
// Bands of rows, from the picture's bottom to its top, so that the file is written front to back (each of its two or
// three blocks is: LRGB has coefficients and colours, RGB a block a colour). Two threads take bands in turn, because a
// source may be a slow generator; every band has its own place in the file, so they need not wait for one another.
#include <algorithm>
#include <atomic>
#include <charconv>
#include <cmath>
#include <mutex>
#include <optional>
#include <vector>

#include "src/artwork/bases/ptm.h"
#include "src/base/file.h"
#include "src/base/parallel_for.h"
#include "texturing/import/ptm.h"

namespace relievo {
namespace {

constexpr int kThreads = 2;
constexpr int64_t kThreadBandBytes = int64_t{8} << 20;  // of the source's channels; a thread holds two such bands

// The shortest text that reads back as the same number.
std::string shortest(double value) {
  char text[32];
  auto [end, status] = std::to_chars(text, text + sizeof text, value);
  return std::string(text, end);
}

// channels: `count` rows of one row-of-pixels each, channel_stride apart; out: count bytes a pixel.
template <int kCount>
void interleaveRow(const uint8_t* const* channels, size_t pixels, uint8_t* out) {
  for (size_t x = 0; x < pixels; ++x) {
    for (int k = 0; k < kCount; ++k) out[x * kCount + k] = channels[k][x];
  }
}

}  // namespace

Result<void> writePtm(const std::string& path, const TextureSource& source, const std::atomic<bool>* interrupted) {
  const TextureFormat format = source.format();
  const int64_t width = source.width(), height = source.height();
  if (!isPtm(format.basis)) {
    return Error{ErrorKind::kUsage,
                 path,
                 std::string("expected polynomial coefficients to write, found ") +
                     (format.basis == Basis::kColour ? "plain colour" : basisName(format.basis)),
                 "write an image instead",
                 {}};
  }
  const bool lrgb = format.basis == Basis::kPtmLrgb;
  std::string header = std::string("PTM_1.2\n") + (lrgb ? "PTM_FORMAT_LRGB" : "PTM_FORMAT_RGB") + "\n" +
                       std::to_string(width) + "\n" + std::to_string(height) + "\n";
  for (int k = 0; k < 6; ++k) header += (k ? " " : "") + shortest(format.scale[k]);
  header += "\n";
  for (int k = 0; k < 6; ++k) {
    if (std::abs(format.bias[k]) > 1e6 || format.bias[k] != std::round(format.bias[k])) {
      return Error{ErrorKind::kUnsupported,
                   path,
                   "a .ptm file holds whole biases: expected one, found " + shortest(format.bias[k]),
                   "",
                   {}};
    }
    header += (k ? " " : "") + std::to_string(static_cast<int>(format.bias[k]));
  }
  header += "\n";

  auto created = OutputFile::create(path);
  if (!created) return created.error();
  OutputFile& file = *created;
  if (auto done = file.writeAt(0, {reinterpret_cast<const uint8_t*>(header.data()), header.size()}); !done) return done;

  const int channels = format.channels();
  const int64_t row_pixels = std::max<int64_t>(width, 1);
  const int64_t band_rows =
      std::clamp<int64_t>(kThreadBandBytes / (row_pixels * channels), 1, std::max<int64_t>(height, 1));
  const int64_t bands = (height + band_rows - 1) / band_rows;
  const uint64_t data = header.size(), pixels = static_cast<uint64_t>(width) * height;

  std::atomic<bool> failed{false};  // the bands that are left are left out
  std::mutex mutex;
  std::optional<Error> first_error;
  auto fail = [&](Error error) {
    std::lock_guard lock(mutex);
    if (!first_error) first_error = std::move(error);
    failed = true;
  };
  struct Buffers {
    std::vector<uint8_t> raster, packed;
  };
  auto makeBuffers = [&] {
    const size_t bytes = static_cast<size_t>(band_rows * width * channels);
    return Buffers{std::vector<uint8_t>(bytes), std::vector<uint8_t>(bytes)};
  };
  parallelForWith(static_cast<size_t>(bands), kThreads, &failed, makeBuffers, [&](Buffers& buffers, size_t band) {
    auto& [raster, packed] = buffers;
    if (interrupted && interrupted->load()) {
      fail({ErrorKind::kInterrupted, path, "interrupted", "", {}});
      return;
    }
    const int64_t first_row = static_cast<int64_t>(band) * band_rows;  // counted from the bottom, as in the file
    const int64_t rows = std::min(band_rows, height - first_row);
    const size_t plane = static_cast<size_t>(rows * width);
    auto read = source.read({0, height - first_row - rows, width, rows}, std::span(raster).first(plane * channels));
    if (!read) {
      fail(read.error());
      return;
    }
    // Blocks in the file's order: which channels, and where the block starts.
    const int blocks = lrgb ? 2 : 3;
    for (int b = 0; b < blocks; ++b) {
      const int count = lrgb && b == 1 ? 3 : 6;
      const uint64_t block_offset = data + 6 * pixels * b;
      for (int64_t r = 0; r < rows; ++r) {
        const uint8_t* rows_in[6];
        for (int k = 0; k < count; ++k) {
          const int channel = lrgb ? 6 * b + k : 3 * k + b;
          rows_in[k] = raster.data() + channel * plane + (rows - 1 - r) * width;
        }
        uint8_t* out = packed.data() + static_cast<size_t>(r * width * count);
        if (count == 6) interleaveRow<6>(rows_in, width, out);
        else interleaveRow<3>(rows_in, width, out);
      }
      auto written = file.writeAt(block_offset + static_cast<uint64_t>(first_row * width) * count,
                                  std::span(packed).first(plane * count));
      if (!written) {
        fail(written.error());
        return;
      }
    }
  });
  if (first_error) return *first_error;
  return file.commit();
}

}  // namespace relievo
