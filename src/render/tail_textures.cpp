#include "src/render/tail_textures.h"

#include <algorithm>
#include <vector>

namespace relievo {
namespace {

// Of the layers; known to shaders/tails.glsl. Those of heights are as wide as one of the page pool's.
constexpr uint32_t kHeightColumns = 64, kHeightRows = 64;
constexpr uint32_t kTileColumns = 64, kTileRows = 32;

uint32_t layersOf(uint32_t patches, uint32_t a_layer) { return (patches + a_layer - 1) / a_layer; }
// A layer's rows: all of them, or as few as the only layer needs.
uint32_t rowsOf(uint32_t patches, uint32_t columns, uint32_t rows) { return std::min(rows, (patches + columns - 1) / columns); }

gl::Texture makeArray(const char* label, GLint filter) {
  gl::Texture texture = gl::createTexture(GL_TEXTURE_2D_ARRAY, label);
  glBindTexture(GL_TEXTURE_2D_ARRAY, texture.id());
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER, filter);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, filter);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  return texture;
}

}  // namespace

uint64_t TailTextures::maxPatches(int planes) {
  GLint layers = 256;
  glGetIntegerv(GL_MAX_ARRAY_TEXTURE_LAYERS, &layers);
  const auto most = static_cast<uint64_t>(layers);
  return std::min(most * kHeightColumns * kHeightRows, most / static_cast<uint64_t>(std::max(planes, 1)) * kTileColumns * kTileRows);
}

TailTextures::TailTextures(const PatchTails& tails) : heights_(makeArray("tails: heights", GL_NEAREST)), patches_(tails.patches) {
  const uint32_t rows = rowsOf(patches_, kHeightColumns, kHeightRows), layers = layersOf(patches_, kHeightColumns * kHeightRows);
  const uint32_t width = kHeightColumns * kTailSamples, height = rows * kTailSamples;
  glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, GL_R16UI, static_cast<GLsizei>(width), static_cast<GLsizei>(height), static_cast<GLsizei>(layers), 0, GL_RED_INTEGER,
               GL_UNSIGNED_SHORT, nullptr);
  std::vector<uint16_t> texels(size_t{width} * height);
  for (uint32_t layer = 0; layer < layers; ++layer) {
    const uint32_t first = layer * kHeightColumns * kHeightRows, count = std::min(patches_ - first, kHeightColumns * kHeightRows);
    for (uint32_t i = 0; i < count; ++i) {
      const uint16_t* from = tails.heights.data() + size_t{first + i} * kTailHeights;
      uint16_t* to = texels.data() + (size_t{i / kHeightColumns} * width + i % kHeightColumns) * kTailSamples;
      for (int y = 0; y < kTailSamples; ++y, from += kTailSamples, to += width) std::copy_n(from, kTailSamples, to);
    }
    glTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, 0, static_cast<GLint>(layer), static_cast<GLsizei>(width), static_cast<GLsizei>(height), 1, GL_RED_INTEGER,
                    GL_UNSIGNED_SHORT, texels.data());
  }
}

void TailTextures::setTexels(const PatchTails& tails, const BaseMesh& base) {
  const TailTiles tiles(tails, base);
  const uint32_t planes = static_cast<uint32_t>(tails.channels) / 3;
  const uint32_t rows = rowsOf(patches_, kTileColumns, kTileRows), layers = layersOf(patches_, kTileColumns * kTileRows);
  const uint32_t width = kTileColumns * kTileWidth, height = rows * kTileHeight;
  texels_ = makeArray("tails: texels", GL_LINEAR);  // borders keep the filter inside a tile's level
  glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, GL_RGBA8, static_cast<GLsizei>(width), static_cast<GLsizei>(height), static_cast<GLsizei>(layers * planes), 0, GL_RGBA,
               GL_UNSIGNED_BYTE, nullptr);
  std::vector<uint8_t> texels(size_t{width} * height * 4);
  for (uint32_t layer = 0; layer < layers * planes; ++layer) {
    const uint32_t first = layer % layers * kTileColumns * kTileRows, count = std::min(patches_ - first, kTileColumns * kTileRows);
    for (uint32_t i = 0; i < count; ++i) {
      const size_t at = size_t{i / kTileColumns} * kTileHeight * width + size_t{i % kTileColumns} * kTileWidth;
      tiles.write(first + i, static_cast<int>(layer / layers), texels.data() + 4 * at, width);
    }
    glTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, 0, static_cast<GLint>(layer), static_cast<GLsizei>(width), static_cast<GLsizei>(height), 1, GL_RGBA,
                    GL_UNSIGNED_BYTE, texels.data());
  }
}

void TailTextures::bind(const gl::Program& program, double reach) const {
  glActiveTexture(GL_TEXTURE0 + kHeightUnit);
  glBindTexture(GL_TEXTURE_2D_ARRAY, heights_.id());
  glActiveTexture(GL_TEXTURE0 + kTexelUnit);
  glBindTexture(GL_TEXTURE_2D_ARRAY, texels_.id());
  glActiveTexture(GL_TEXTURE0);
  glUniform1i(program.uniform("u_tail_heights"), kHeightUnit);
  glUniform1i(program.uniform("u_tails"), kTexelUnit);
  glUniform1i(program.uniform("u_tail_layers"), static_cast<GLint>(layersOf(patches_, kTileColumns * kTileRows)));
  glUniform1f(program.uniform("u_tail_reach"), static_cast<float>(reach));
}

}  // namespace relievo
