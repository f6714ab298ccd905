// image_io_module.h - what the module around OpenImageIO hands to image_io.cpp. OpenImageIO pulls in some 260 shared
// objects, which take 0.2 s to load; so only a program that reads an image, or writes another one than a PNG
// (png_encoder.h), loads them.
#pragma once

#include <new>
#include <optional>

#include "texturing/import/image_io.h"

namespace relievo {

// Where an encoder's bytes go, and come back from when they are checked. The program has it: the module opens no file
// to write.
class ImageBytes {
 public:
  virtual ~ImageBytes() = default;
  virtual Result<void> write(uint64_t offset, std::span<const uint8_t> bytes) = 0;
  virtual Result<void> read(uint64_t offset, std::span<uint8_t> out) = 0;
  virtual uint64_t size() const = 0;
};

// What a library in C, through whose frames no exception may go, calls to reach ImageBytes: the first error stays, and
// that memory ran out.
class ImageBytesCalls {
 public:
  // False: the call failed.
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
  void noteOutOfMemory() noexcept { out_of_memory_ = true; }
  bool outOfMemory() const { return out_of_memory_; }
  bool broken() const { return failed_ || out_of_memory_; }
  // Throws std::bad_alloc where memory ran out.
  const std::optional<Error>& failed() const {
    if (out_of_memory_) throw std::bad_alloc();
    return failed_;
  }

 private:
  std::optional<Error> failed_;
  bool out_of_memory_ = false;
};

struct ImageEncoding {
  std::string path;  // for messages alone
  ImageFormat format = ImageFormat::kPng;
  int64_t width = 0, height = 0;
  int channels = 0;
  SampleType type = SampleType::kUint8;
  double mm_per_px = 0;
};

class ImageEncoder {
 public:
  virtual ~ImageEncoder() = default;
  virtual Result<void> appendRows(int64_t rows, const void* samples) = 0;
  // After the last row: ends the image, decodes it again and compares.
  virtual Result<void> finish() = 0;
};

// Exported as relievo_image_io; the functions are those of image_io.h, but for the encoder.
struct ImageIoModule {
  decltype(&readImageFacts) read_facts;
  decltype(&openColourImage) open_colour;
  decltype(&openHeightImage) open_height;
  decltype(&readImage8) read_image8;
  // TIFF, EXR and JPEG. bytes outlives the encoder.
  Result<std::unique_ptr<ImageEncoder>> (*create_encoder)(const ImageEncoding& encoding, ImageBytes& bytes);
  void (*halves_from_floats)(std::span<const float> floats, uint16_t* halves);
};

Result<const ImageIoModule*> imageIoModule();  // loads it; image_io.cpp
// A PNG's by libpng, any other of the module. bytes outlives it.
Result<std::unique_ptr<ImageEncoder>> createEncoder(const ImageEncoding& encoding, ImageBytes& bytes);

extern "C" __attribute__((visibility("default"))) const ImageIoModule relievo_image_io;  // image_io_oiio.cpp

}  // namespace relievo
