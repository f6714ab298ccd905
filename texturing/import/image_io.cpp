#include "texturing/import/image_io.h"

#include <dlfcn.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <limits>

#include "src/base/file.h"
#include "src/base/srgb.h"
#include "src/base/worker_threads.h"
#include "texturing/import/image_io_module.h"
#include "texturing/import/png_encoder.h"

namespace relievo {
#ifdef RELIEVO_IMAGE_LINKED
Result<const ImageIoModule*> imageIoModule() { return &relievo_image_io; }
#else
// Beside the program, or where the build left it.
Result<const ImageIoModule*> imageIoModule() {
  static const Result<const ImageIoModule*> loaded = []() -> Result<const ImageIoModule*> {
    std::error_code ignored;
    auto beside = std::filesystem::read_symlink("/proc/self/exe", ignored).parent_path() / RELIEVO_IMAGE_MODULE_NAME;
    // Libraries that OpenImageIO needs start threads as they are loaded (log4cplus, of OpenVDB, as many as there are
    // cores and a few), and end the process where they cannot.
    if (const auto needed = static_cast<size_t>(2 * workerCount(0) + 8); threadsToBeHad(needed) < needed)
      return Error{ErrorKind::kRuntime,
                   RELIEVO_IMAGE_MODULE_NAME,
                   "could not start the " + std::to_string(needed) + " threads that the image libraries may need",
                   ThreadStartFailure::kHint,
                   {}};
    std::string why;
    for (const std::string& path : {beside.string(), std::string(RELIEVO_IMAGE_MODULE)}) {
      void* library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
      if (library) {
        if (const void* symbol = dlsym(library, "relievo_image_io")) return static_cast<const ImageIoModule*>(symbol);
      }
      const char* reason = dlerror();
      why += (why.empty() ? "" : "; ") + std::string(reason ? reason : "no reason given");
    }
    return Error{ErrorKind::kRuntime,
                 RELIEVO_IMAGE_MODULE_NAME,
                 "cannot load the module that reads and writes images: " + why,
                 "it belongs beside the program; install OpenImageIO (libopenimageio2.4)",
                 {}};
  }();
  return loaded;
}
#endif

Result<ImageFacts> readImageFacts(const std::string& path, const ImageReadOptions& options) {
  auto module = imageIoModule();
  if (!module) return module.error();
  return (*module)->read_facts(path, options);
}

Result<std::unique_ptr<TextureSource>> openColourImage(const std::string& path, const ImageReadOptions& options) {
  auto module = imageIoModule();
  if (!module) return module.error();
  return (*module)->open_colour(path, options);
}

Result<std::unique_ptr<HeightSource>> openHeightImage(const std::string& path,
                                                      std::optional<std::pair<double, double>> range_mm,
                                                      const ImageReadOptions& options) {
  auto module = imageIoModule();
  if (!module) return module.error();
  return (*module)->open_height(path, range_mm, options);
}

Result<Image8> readImage8(const std::string& path, const ImageReadOptions& options) {
  auto module = imageIoModule();
  if (!module) return module.error();
  return (*module)->read_image8(path, options);
}

Result<ImageFormat> imageFormatOf(const std::string& path) {
  if (path == "-") return ImageFormat::kPng;
  const size_t dot = path.find_last_of("./");
  std::string suffix = dot == std::string::npos || path[dot] != '.' ? "" : path.substr(dot);
  for (char& c : suffix) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  constexpr std::pair<const char*, ImageFormat> kFormats[] = {
      {".png", ImageFormat::kPng}, {".tif", ImageFormat::kTiff}, {".tiff", ImageFormat::kTiff},
      {".exr", ImageFormat::kExr}, {".jpg", ImageFormat::kJpeg}, {".jpeg", ImageFormat::kJpeg}};
  for (const auto& [name, format] : kFormats)
    if (suffix == name) return format;
  return Error{ErrorKind::kUsage,
               path,
               "expected a picture's name that ends in .png, .tif, .exr or .jpg, found " +
                   (suffix.empty() ? "none of these" : suffix),
               "the name says which format is written",
               {}};
}

Result<std::unique_ptr<ImageEncoder>> createEncoder(const ImageEncoding& encoding, ImageBytes& bytes) {
  if (encoding.format == ImageFormat::kPng) return createPngEncoder(encoding, bytes);
  auto module = imageIoModule();
  if (!module) return module.error();
  return (*module)->create_encoder(encoding, bytes);
}

namespace {

class FileBytes final : public ImageBytes {
 public:
  explicit FileBytes(OutputFile& file) : file_(file) {}
  Result<void> write(uint64_t offset, std::span<const uint8_t> bytes) override {
    // What follows on what is there is gathered into large writes.
    const bool follows = offset == end_ && end_ == file_.size();
    end_ = std::max(end_, offset + bytes.size());
    return follows ? file_.append(bytes) : file_.writeAt(offset, bytes);
  }
  Result<void> read(uint64_t offset, std::span<uint8_t> out) override { return file_.readBack(offset, out); }
  uint64_t size() const override { return end_; }

 private:
  OutputFile& file_;
  uint64_t end_ = 0;
};

class MemoryBytes final : public ImageBytes {
 public:
  Result<void> write(uint64_t offset, std::span<const uint8_t> from) override {
    if (bytes.size() < offset + from.size()) bytes.resize(offset + from.size());
    std::copy(from.begin(), from.end(), bytes.begin() + static_cast<std::ptrdiff_t>(offset));
    return {};
  }
  Result<void> read(uint64_t offset, std::span<uint8_t> out) override {
    assert(offset + out.size() <= bytes.size());
    std::copy_n(bytes.begin() + static_cast<std::ptrdiff_t>(offset), out.size(), out.begin());
    return {};
  }
  uint64_t size() const override { return bytes.size(); }
  std::vector<uint8_t> bytes;
};

class FileImageWriter final : public ImageWriter {
 public:
  FileImageWriter(OutputFile file) : file_(std::move(file)), bytes_(file_) {}
  Result<void> start(const ImageEncoding& encoding) {
    auto encoder = createEncoder(encoding, bytes_);
    if (!encoder) return encoder.error();
    encoder_ = std::move(*encoder);
    return {};
  }
  Result<void> appendRows(int64_t rows, const void* samples) override { return encoder_->appendRows(rows, samples); }
  Result<void> commit() override {
    if (auto finished = encoder_->finish(); !finished) return finished;
    return file_.commit();
  }

 private:
  OutputFile file_;
  FileBytes bytes_;
  std::unique_ptr<ImageEncoder> encoder_;  // the first to go: it may still write
};

Result<std::unique_ptr<ImageWriter>> createWriter(const ImageEncoding& encoding) {
  if (encoding.format != ImageFormat::kPng)  // before a file is there
    if (auto module = imageIoModule(); !module) return module.error();
  auto file = OutputFile::create(encoding.path);
  if (!file) return file.error();
  auto writer = std::make_unique<FileImageWriter>(std::move(*file));
  if (auto started = writer->start(encoding); !started) return started.error();
  return std::unique_ptr<ImageWriter>(std::move(writer));
}

// The samples that an EXR has: linear light as half floats, premultiplied.
Result<std::vector<uint16_t>> linearHalves(std::span<const uint8_t> pixels, int channels) {
  auto module = imageIoModule();
  if (!module) return module.error();
  std::array<float, 256> linear;
  for (size_t i = 0; i < 256; ++i) linear[i] = static_cast<float>(linearFromSrgb(static_cast<double>(i) / 255));
  const bool has_alpha = channels == 2 || channels == 4;
  const size_t n = static_cast<size_t>(channels);
  std::vector<float> row(pixels.size());
  for (size_t i = 0; i < pixels.size(); i += n) {
    const float alpha = has_alpha ? static_cast<float>(pixels[i + n - 1]) / 255 : 1;
    for (size_t c = 0; c < n; ++c) row[i + c] = has_alpha && c == n - 1 ? alpha : alpha * linear[pixels[i + c]];
  }
  std::vector<uint16_t> halves(pixels.size());
  (*module)->halves_from_floats(row, halves.data());
  return halves;
}

}  // namespace

Result<void> writeImage(const std::string& path, int width, int height, int channels, std::span<const uint8_t> pixels,
                        double mm_per_px) {
  assert(width > 0 && height > 0 && channels >= 1 && channels <= 4);
  assert(pixels.size() == static_cast<size_t>(width) * static_cast<size_t>(height) * static_cast<size_t>(channels));
  auto format = imageFormatOf(path);
  if (!format) return format.error();
  const bool exr = *format == ImageFormat::kExr;
  auto writer =
      createWriter({path, *format, width, height, channels, exr ? SampleType::kHalf : SampleType::kUint8, mm_per_px});
  if (!writer) return writer.error();
  // In bands: the encoder converts what it is given, and an EXR's samples are twice as large.
  const int band = std::clamp(static_cast<int>((int64_t{4} << 20) / (int64_t{width} * channels)), 1, height);
  for (int y = 0; y < height; y += band) {
    const int rows = std::min(band, height - y);
    const size_t row_samples = static_cast<size_t>(width) * static_cast<size_t>(channels);
    const auto part = pixels.subspan(static_cast<size_t>(y) * row_samples, static_cast<size_t>(rows) * row_samples);
    Result<void> done;
    if (exr) {
      auto halves = linearHalves(part, channels);
      if (!halves) return halves.error();
      done = (*writer)->appendRows(rows, halves->data());
    } else {
      done = (*writer)->appendRows(rows, part.data());
    }
    if (!done) return done;
  }
  return (*writer)->commit();
}

Result<std::vector<uint8_t>> encodePng(int width, int height, int channels, std::span<const uint8_t> pixels,
                                       double mm_per_px) {
  MemoryBytes memory;
  auto encoder =
      createEncoder({"a picture", ImageFormat::kPng, width, height, channels, SampleType::kUint8, mm_per_px}, memory);
  if (!encoder) return encoder.error();
  if (auto done = (*encoder)->appendRows(height, pixels.data()); !done) return done.error();
  if (auto done = (*encoder)->finish(); !done) return done.error();
  return std::move(memory.bytes);
}

Result<std::unique_ptr<ImageWriter>> ImageWriter::create(const std::string& path, int64_t width, int64_t height,
                                                         int channels, SampleType type, double mm_per_px) {
  auto format = imageFormatOf(path);
  if (!format) return format.error();
  const bool fits = *format == ImageFormat::kExr    ? type == SampleType::kHalf || type == SampleType::kFloat
                    : *format == ImageFormat::kJpeg ? type == SampleType::kUint8
                    : *format == ImageFormat::kPng  ? type == SampleType::kUint8 || type == SampleType::kUint16
                                                    : type != SampleType::kHalf;
  if (!fits) return Error{ErrorKind::kUsage, path, "a file of this name cannot hold such samples", "write a .tif", {}};
  return createWriter({path, *format, width, height, channels, type, mm_per_px});
}

}  // namespace relievo
