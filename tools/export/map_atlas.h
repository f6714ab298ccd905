// map_atlas.h - the colours and normals of a scan's patches in two images, a tile for each patch: texels of u from 0 to
// 1 to the right and of v down, around them a border of one texel from the neighbours, for filters. Tiles are as dense
// as the patches' own texels, or all about equally dense where the images would be too large.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/result.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/package.h"
#include "texturing/package/texture_pages.h"

namespace relievo {

class MapAtlas {
 public:
  static constexpr int kBorder = 1;
  struct Tile {
    int x = 0, y = 0, side = 0;  // of the texels at u = v = 0; without the border
  };
  // Images of at most most_px a side. kUsage: the patches are too many for that.
  static Result<MapAtlas> create(std::shared_ptr<const Package> package, int most_px);
  int width() const { return width_; }
  int height() const { return height_; }
  const Tile& tile(uint32_t patch) const { return tiles_[patch]; }
  bool hasNormals() const;

  // A tile with its border, rows top first.
  struct Texels {
    int side = 0;                                 // with the border
    std::vector<std::array<uint8_t, 3>> colours;  // sRGB
    std::vector<glm::vec3> normals;               // of length 1, in the scan's axes; none if the package has none
  };
  Result<void> read(uint32_t patch, PageDecoder& decoder, Texels& out) const;

 private:
  explicit MapAtlas(std::shared_ptr<const Package> package);
  bool pack(const std::vector<int>& sides, int most_px);
  Result<void> readPage(const NodeId& node, PageDecoder& decoder, std::span<uint8_t> colours,
                        std::span<uint8_t> normals) const;

  std::shared_ptr<const Package> package_;
  std::shared_ptr<const TexturePages> pages_;
  std::vector<Tile> tiles_;
  int width_ = 0, height_ = 0;
};

}  // namespace relievo
