// raster_source.h - where an artwork's texels and heights come from: a file reader or a procedural generator.
// Everything is asked for in rectangles, so that inputs larger than memory work. read() is called from several threads
// at once; implementations are const and thread-safe. Rectangles lie inside the raster; the caller clamps.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "src/artwork/basis.h"
#include "src/base/result.h"

namespace relievo {

struct Rect {
  int64_t x = 0, y = 0, width = 0, height = 0;
  friend bool operator==(const Rect&, const Rect&) = default;
};

// Where the data came from; kept in the package's manifest.
struct Provenance {
  std::string name;              // file name without its folder, or the generator's name and seed
  std::string xxh3;              // hex digest of the file's bytes; empty for a generator
  std::string generator;         // empty for a file
  std::optional<Error> failure;  // the digest could not be taken: no package is made without it
};

class TextureSource {
 public:
  virtual ~TextureSource() = default;
  virtual int64_t width() const = 0;
  virtual int64_t height() const = 0;
  virtual TextureFormat format() const = 0;
  virtual Provenance provenance() const = 0;
  // Channel-major, top row first: out[(c * rect.height + y) * rect.width + x], format().channels() channels.
  virtual Result<void> read(const Rect& rect, std::span<uint8_t> out) const = 0;
};

class HeightSource {
 public:
  virtual ~HeightSource() = default;
  virtual int64_t width() const = 0;  // samples, pixel-centred; may differ from the texture's size
  virtual int64_t height() const = 0;
  virtual double minMm() const = 0;  // a range that holds every sample; it becomes the artwork's one range
  virtual double maxMm() const = 0;
  virtual Provenance provenance() const = 0;
  // Heights in mm, towards the viewer positive, top row first.
  virtual Result<void> read(const Rect& rect, std::span<float> out) const = 0;
};

}  // namespace relievo
