// What stands around the samples of an uncompressed TIFF, as another reader (libtiff, through OpenImageIO) sees it.
#include "texturing/import/tiff_frame.h"

#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

namespace relievo {
namespace tiff_frame_test {

namespace fs = std::filesystem;

// The rows that are given, all others a hole in the file, which reads as zeros.
struct SparseTiff {
  explicit SparseTiff(const TiffFrame& frame) {
    std::string pattern = (fs::temp_directory_path() / "relievo-tiff-XXXXXX").string();
    const int fd = ::mkstemp(pattern.data());
    path = pattern;
    const std::vector<uint8_t> head = tiffHead(frame), tail = tiffTail(frame);
    const uint64_t row = static_cast<uint64_t>(frame.width * frame.channels * frame.sample_bytes),
                   data = row * static_cast<uint64_t>(frame.height);
    const std::vector<uint8_t> last(row, 7);
    const auto put = [&](const std::vector<uint8_t>& bytes, uint64_t at) {
      EXPECT_EQ(::pwrite(fd, bytes.data(), bytes.size(), static_cast<off_t>(at)), static_cast<ssize_t>(bytes.size()));
    };
    put(head, 0);
    put(last, head.size() + data - row);
    put(tail, head.size() + data);
    ::close(fd);
  }
  ~SparseTiff() { fs::remove(path); }
  std::string path;
};

void expectFrame(const TiffFrame& frame) {
  SCOPED_TRACE(std::to_string(frame.width) + " x " + std::to_string(frame.height) + " x " +
               std::to_string(frame.channels) + " of " + std::to_string(frame.sample_bytes));
  const SparseTiff file(frame);
  OIIO::ImageSpec config;
  config.attribute("oiio:UnassociatedAlpha", 1);
  auto in = OIIO::ImageInput::open(file.path, &config);
  ASSERT_TRUE(in) << OIIO::geterror();
  EXPECT_EQ(in->spec().width, frame.width);
  EXPECT_EQ(in->spec().height, frame.height);
  EXPECT_EQ(in->spec().nchannels, frame.channels);
  EXPECT_EQ(in->spec().format.size(), static_cast<size_t>(frame.sample_bytes));
  EXPECT_EQ(in->spec().format.is_floating_point(), frame.floats);
  const int last = static_cast<int>(frame.height) - 1;
  std::vector<uint8_t> row(in->spec().scanline_bytes(true));
  ASSERT_TRUE(in->read_scanlines(0, 0, last, last + 1, 0, 0, frame.channels, OIIO::TypeDesc(OIIO::TypeDesc::UNKNOWN),
                                 row.data()))
      << in->geterror();
  EXPECT_TRUE(row == std::vector<uint8_t>(row.size(), 7)) << "the last row is another";
  if (last == 0) return;
  ASSERT_TRUE(in->read_scanlines(0, 0, last - 1, last, 0, 0, frame.channels, OIIO::TypeDesc(OIIO::TypeDesc::UNKNOWN),
                                 row.data()))
      << in->geterror();
  EXPECT_TRUE(row == std::vector<uint8_t>(row.size(), 0)) << "the row before the last is another";
}

TEST(TiffFrame, OfEveryKindOfSample) {
  for (const int channels : {1, 2, 3, 4}) {
    for (const int bytes : {1, 2, 4}) {
      for (const auto& [width, height] : {std::pair{1, 1}, {3, 5}, {1000, 700}, {1 << 20, 3}})
        expectFrame({.width = width,
                     .height = height,
                     .channels = channels,
                     .sample_bytes = bytes,
                     .floats = bytes == 4,
                     .px_per_cm = 200});
    }
  }
}

// Where 32 bits no longer hold a place in the file. Nearly all of it is a hole.
TEST(TiffFrame, BeyondFourGiB) {
  for (const int64_t height : {1022, 1023, 1024, 1025, 1500}) {  // rows of 4 MiB
    const TiffFrame frame{.width = 1 << 20, .height = height, .channels = 1, .sample_bytes = 4, .floats = true};
    expectFrame(frame);
  }
  EXPECT_EQ(tiffHead({.width = 1 << 20, .height = 1020, .sample_bytes = 4, .floats = true}).size(), 8u);
  EXPECT_EQ(tiffHead({.width = 1 << 20, .height = 1024, .sample_bytes = 4, .floats = true}).size(), 16u);
}

}  // namespace tiff_frame_test
}  // namespace relievo
