// fuzz_packages.h - small packages of every kind, from the project's own builders: what fuzzing begins with.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <utility>
#include <vector>

#include "tests/fuzz/fuzz_file.h"
#include "tests/texturing/patch_fixture.h"
#include "texturing/codec/image_jpeg.h"
#include "texturing/codec/page_jpeg_codec.h"
#include "texturing/package/package_builder.h"
#include "texturing/package/patch_package_builder.h"

namespace relievo::fuzz {

inline std::vector<uint8_t> fileBytes(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

// Heights that pack well, the same at both ends of a row: a small file is changed more often where it matters.
class SmoothPatches final : public testing_support::NoisyPatches {
 public:
  using NoisyPatches::NoisyPatches;
  uint16_t height(uint32_t /*patch*/, int x, int y) const override {
    return static_cast<uint16_t>(20000 + 3 * std::abs(x - cells() / 2) + 5 * y);
  }
};

// Waves on the last patch alone: the first one needs no texture pages, the others do.
class PartlyPlainPatches final : public testing_support::NoisyPatches {
 public:
  using NoisyPatches::NoisyPatches;
  uint16_t height(uint32_t /*patch*/, int /*x*/, int /*y*/) const override { return 27'306; }  // others have noise
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    if (patch + 1 < base().patches.size()) {
      std::fill(out.begin(), out.end(), uint8_t{100});
      return {};
    }
    for (size_t i = 0; i < out.size(); ++i)  // waves: noise would take most of the time
      out[i] = static_cast<uint8_t>(128 + 90 * std::sin(static_cast<double>(i % 128) / 9) *
                                              std::cos(static_cast<double>(i / 128) / 17));
    return {};
  }
};

// One patch that shows an image, at two levels, and one whose tail alone does; with a map of normals.
class ShowingPatches final : public testing_support::NoisyPatches {
 public:
  ShowingPatches(BaseMesh mesh, uint64_t seed, bool normals)
      : NoisyPatches(std::move(mesh), 0, 0, seed), normals_(normals) {}
  uint16_t height(uint32_t /*patch*/, int /*x*/, int /*y*/) const override { return 27'306; }
  int textureDepth() const override { return 1; }
  int textureDepthOf(uint32_t /*patch*/) const override { return kNoTexturePage; }
  std::vector<SourceImage> images() const override {
    std::vector<SourceImage> out{{.width = 20, .height = 10, .repeats = true, .rgb = texels_}};
    if (normals_)
      out.push_back(
          {.width = 10, .height = 20, .repeats = true, .rgb = texels_, .is_normals = true, .normals_downwards = true});
    return out;
  }
  PatchImage imageOf(uint32_t patch) const override {
    PatchImage out;
    if (patch == 0) out.depth = 1;
    else out.in_tail = true;
    for (auto& half : out.at) half = {glm::ivec2(0), glm::ivec2(9000, 300), glm::ivec2(9000, -7000)};
    for (auto& half : out.normal) half.fill(glm::u8vec3(128, 128, 255));
    return out;
  }

 private:
  std::vector<uint8_t> texels_ = std::vector<uint8_t>(20 * 10 * 3, 90);
  bool normals_;
};

// The same with an image that came as a JPEG, only part of which is shown.
class ShowingJpeg final : public testing_support::NoisyPatches {
 public:
  ShowingJpeg(BaseMesh mesh, uint64_t seed) : NoisyPatches(std::move(mesh), 0, 0, seed) {
    std::vector<uint8_t> texels, jpeg(1 << 16);
    for (int i = 0; i < 4 * kPageFullPx * kPageFullPx; ++i)
      texels.push_back(static_cast<uint8_t>(128 + 99 * std::sin(i % 4 + 0.3 * (i / 4 % kPageFullPx))));
    jpeg.resize(JpegPageEncoder().encode(texels.data(), 20, true, jpeg));
    jpeg_ = plainJpeg(jpeg);
    auto reader = ImageJpegReader::open(jpeg_, kPageFullPx, kPageFullPx);
    rgb_.resize(3 * kPageFullPx * kPageFullPx);
    require(reader.ok() && reader->read(kPageFullPx, rgb_).ok(), "a JPEG of our own");
  }
  uint16_t height(uint32_t /*patch*/, int /*x*/, int /*y*/) const override { return 27'306; }
  int textureDepthOf(uint32_t patch) const override { return patch == 0 ? kNoTexturePage : 0; }
  std::vector<SourceImage> images() const override {
    return {{.width = kPageFullPx, .height = kPageFullPx, .repeats = false, .rgb = rgb_, .fill = true, .jpeg = jpeg_}};
  }
  PatchImage imageOf(uint32_t patch) const override {
    PatchImage out;
    if (patch > 0) return out;
    out.depth = 0;
    for (auto& half : out.at) half = {glm::ivec2(4000), glm::ivec2(20'000, 4000), glm::ivec2(20'000, 9000)};
    for (auto& half : out.normal) half.fill(glm::u8vec3(128, 128, 255));
    return out;
  }

 private:
  std::vector<uint8_t> rgb_, jpeg_;
};

// Patches with colours of corners, at two levels and in tails alone.
class ColouredPatches final : public testing_support::NoisyPatches {
 public:
  using NoisyPatches::NoisyPatches;
  uint16_t height(uint32_t /*patch*/, int /*x*/, int /*y*/) const override { return 27'306; }
  int textureDepth() const override { return 1; }
  int textureDepthOf(uint32_t /*patch*/) const override { return kNoTexturePage; }
  bool showsImages() const override { return true; }
  PatchImage imageOf(uint32_t patch) const override {
    PatchImage out;
    if (patch == 0) out.depth = 1;
    else out.in_tail = true;
    out.image.fill(kCornerColours);
    for (auto& half : out.colour) half = {glm::u8vec3(9, 200, 77), glm::u8vec3(255, 0, 3), glm::u8vec3(40, 41, 42)};
    for (auto& half : out.normal) half.fill(glm::u8vec3(128, 128, 255));
    return out;
  }
};

// So many squares beside one another.
inline BaseMesh stripOf(uint32_t patches) {
  BaseMesh mesh;
  const uint32_t columns = patches + 1;
  for (uint32_t k = 0; k < 2 * columns; ++k)
    mesh.corners.push_back(
        {glm::vec3(10.0f * static_cast<float>(k % columns), -10.0f * static_cast<float>(k / columns), 0),
         glm::vec3(0, 0, 1)});
  for (uint32_t p = 0; p < patches; ++p) mesh.patches.push_back({p, p + 1, columns + p, columns + p + 1});
  return mesh;
}

inline std::vector<std::vector<uint8_t>> samplePackages() {
  using namespace testing_support;
  std::vector<std::vector<uint8_t>> out;
  auto add = [&](auto&& build) {
    BuildOptions options;
    options.output = folder().file("sample.relievo");
    options.workers = 1;
    options.tool_version = "fuzz";
    options.stretch_relief = true;  // proportions do not matter here
    build(options);
    out.push_back(fileBytes(options.output));
    require(!out.back().empty(), "a sample package could not be built");
  };
  auto flat = [](int64_t width, int64_t height, Basis basis, bool relief, PageEncoding coefficients,
                 PageEncoding colour) {
    return [=](BuildOptions& options) {
      options.coefficients = coefficients, options.colour = colour;
      const NoisyTexture texture(width, height, basis, 7, 0);
      const NoisyHeights heights(17, 13, 5);
      require(static_cast<bool>(buildPackage(texture, relief ? &heights : nullptr, options)), "a flat sample");
    };
  };
  add(flat(40, 30, Basis::kColour, true, {}, {}));
  add(flat(50, 20, Basis::kPtmLrgb, false, {PageCodec::kJpeg, 60}, {PageCodec::kBc1, 0}));
  add(flat(300, 90, Basis::kPtmLrgb, true, {PageCodec::kQuantised, 5}, {PageCodec::kBc7, 0}));
  add([](BuildOptions& options) {
    const BaseMesh mesh = stripOf(2);
    options.coded_tails = false;
    auto built = buildPatchPackage(SmoothPatches(mesh, 0, 0, 3), options);
    require(built.ok(), built ? "" : built.error().text());
  });
  add([](BuildOptions& options) {
    const BaseMesh mesh = stripOf(3);
    options.texture_tolerance = 1;
    auto built = buildPatchPackage(PartlyPlainPatches(mesh, 0, 0, 3), options);
    require(built.ok(), built ? "" : built.error().text());
  });
  for (const bool normals : {false, true})
    add([normals](BuildOptions& options) {
      BaseMesh mesh = stripOf(2);
      mesh.cut = true;
      options.texture_tolerance = 1;
      auto built = buildPatchPackage(ShowingPatches(mesh, 3, normals), options);
      require(built.ok(), built ? "" : built.error().text());
    });
  add([](BuildOptions& options) {
    BaseMesh mesh = stripOf(2);
    mesh.cut = true;
    options.texture_tolerance = 1;
    auto built = buildPatchPackage(ShowingJpeg(mesh, 3), options);
    require(built.ok(), built ? "" : built.error().text());
  });
  add([](BuildOptions& options) {
    BaseMesh mesh = stripOf(2);
    mesh.cut = true;
    options.texture_tolerance = 1;
    auto built = buildPatchPackage(ColouredPatches(mesh, 0, 0, 3), options);
    require(built.ok(), built ? "" : built.error().text());
  });
  return out;
}

}  // namespace relievo::fuzz
