#include "texturing/package/package_base.h"

#include <zstd.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstring>
#include <memory>

#include "texturing/package/package_layout.h"

namespace relievo {
namespace {

// Calls f(first byte, bytes a record, records) for each of the arrays of a section that ends with shapes or behind
// them.
template <class F>
void forEachArray(uint64_t corners, uint64_t patches, BaseSectionEnd end, F f) {
  f(0, kBaseHeadBytes, 1);
  f(kBaseHeadBytes, kBaseCornerBytes, corners);
  uint64_t at = kBaseHeadBytes + kBaseCornerBytes * corners;
  for (uint64_t record : {uint64_t{16}, uint64_t{28}, uint64_t{84}, kBaseSlopesBytes, kBaseShapesBytes}) {
    f(at, record, patches);
    at += record * patches;
  }
  if (end == BaseSectionEnd::kTextureDepths) f(at, kBaseTextureDepthBytes, patches);
}

}  // namespace

Error damagedBaseMesh(const std::string& message, uint64_t offset) {
  return {ErrorKind::kInvalidData, "", "the base mesh is damaged: " + message,
          "rebuild the package, or get a whole copy", offset};
}

std::optional<Error> tooManyCorners(uint64_t corners, uint32_t patches) {
  if (corners <= uint64_t{4} * patches) return std::nullopt;
  return damagedBaseMesh("expected at most four corners a patch, found " + std::to_string(corners));
}

std::optional<BaseSectionFault> baseSectionFault(const BaseSection& section) {
  const uint64_t corners = section.mesh.corners.size(), patches = section.mesh.patches.size();
  if (!std::isfinite(section.error_unit_mm) || section.error_unit_mm < 0)
    return BaseSectionFault{"the unit of errors is not a number of mm", 32};
  if (std::string problem = baseMeshProblem(section.mesh); !problem.empty())
    return BaseSectionFault{problem, kBaseHeadBytes};
  uint64_t at = kBaseHeadBytes + kBaseCornerBytes * corners + 16 * patches;
  for (size_t i = 0; i < section.coarse_errors.size(); ++i) {
    const CoarseErrors& errors = section.coarse_errors[i];
    for (size_t k = 0; k < errors.size(); ++k) {
      if (!std::isfinite(errors[k]) || errors[k] < 0 || (k > 0 && errors[k] > errors[k - 1]))
        return BaseSectionFault{
            "the errors of patch " + std::to_string(i) + " are not bounds that fall from level to level",
            at + i * sizeof(CoarseErrors)};
    }
  }
  at = kBaseHeadBytes + kBaseCornerBytes * corners + kBasePatchBytes * patches;
  for (size_t i = 0; i < section.slopes.size(); ++i) {
    const HeightSlopes& s = section.slopes[i];
    if (!std::isfinite(s.min_u) || !std::isfinite(s.max_u) || !std::isfinite(s.min_v) || !std::isfinite(s.max_v) ||
        s.min_u > s.max_u || s.min_v > s.max_v)
      return BaseSectionFault{"the slopes of patch " + std::to_string(i) + " are not ranges of numbers",
                              at + i * kBaseSlopesBytes};
  }
  at = baseSectionBytes(corners, patches);
  for (size_t i = 0; i < section.texture_depths.size(); ++i) {
    const auto levels = static_cast<uint8_t>(section.texture_depths[i] + 1);
    if (levels > kMaxNodeLevel + 1)
      return BaseSectionFault{"expected at most " + std::to_string(kMaxNodeLevel + 1) + " texture levels of patch " +
                                  std::to_string(i) + ", found " + std::to_string(levels),
                              at + i};
  }
  return std::nullopt;
}

std::vector<uint8_t> encodeBaseSection(const BaseSection& section) {
  const BaseMesh& mesh = section.mesh;
  std::vector<uint8_t> out(baseSectionBytes(mesh.corners.size(), mesh.patches.size(),
                                            !section.texture_depths.empty() ? BaseSectionEnd::kTextureDepths
                                            : !section.shapes.empty()       ? BaseSectionEnd::kShapes
                                            : !section.slopes.empty()       ? BaseSectionEnd::kSlopes
                                                                            : BaseSectionEnd::kBlocks));
  uint8_t* p = out.data();
  auto put = [&](auto v) {
    storeLittle(p, v);
    p += sizeof v;
  };
  put(static_cast<uint32_t>(mesh.corners.size()));
  put(static_cast<uint32_t>(mesh.patches.size()));
  for (int k = 0; k < 3; ++k) put(mesh.origin_mm[k]);
  put(section.error_unit_mm);
  for (const BaseCorner& c : mesh.corners) {
    for (int k = 0; k < 3; ++k) put(c.position_mm[k]);
    for (int k = 0; k < 3; ++k) put(c.normal[k]);
  }
  for (const auto& patch : mesh.patches)
    for (uint32_t corner : patch) put(corner);
  auto forEachPatch = [&](const auto& kept, auto&& use) {
    const size_t times = kept.size() == 1 ? mesh.patches.size() : 1;
    for (size_t i = 0; i < times; ++i)
      for (const auto& of_patch : kept) use(of_patch);
  };
  forEachPatch(section.coarse_errors, [&](const CoarseErrors& errors) {
    for (float e : errors) put(e);
  });
  forEachPatch(section.coarse_blocks, [&](const CoarseBlocks& blocks) {
    for (uint8_t share : blocks) put(share);
  });
  forEachPatch(section.slopes, [&](const HeightSlopes& s) {
    for (float f : {s.min_u, s.max_u, s.min_v, s.max_v}) put(f);
  });
  forEachPatch(section.shapes, [&](const CoarseShapes& shapes) {
    for (const DeviationShape& s : shapes) put(s);
  });
  for (int8_t depth : section.texture_depths) put(static_cast<uint8_t>(depth + 1));
  return out;
}

Result<BaseSection> decodeBaseSection(std::span<const uint8_t> bytes, uint32_t patches) {
  auto invalid = [](uint64_t offset, const std::string& message) { return damagedBaseMesh(message, offset); };
  if (bytes.size() < kBaseHeadBytes)
    return invalid(0, "expected at least 40 bytes, found " + std::to_string(bytes.size()));
  const uint8_t* p = bytes.data();
  auto take = [&]<class T>(T& v) {
    v = loadLittle<T>(p);
    p += sizeof v;
  };
  uint32_t corner_count = 0, patch_count = 0;
  take(corner_count);
  take(patch_count);
  if (patch_count != patches)
    return invalid(4, "expected " + std::to_string(patches) + " patches, found " + std::to_string(patch_count));
  const bool has_depths = bytes.size() == baseSectionBytes(corner_count, patch_count, BaseSectionEnd::kTextureDepths);
  const bool has_shapes = has_depths || bytes.size() == baseSectionBytes(corner_count, patch_count);
  const bool has_slopes =
      has_shapes || bytes.size() == baseSectionBytes(corner_count, patch_count, BaseSectionEnd::kSlopes);
  if (const uint64_t expected = baseSectionBytes(corner_count, patch_count, BaseSectionEnd::kBlocks);
      expected != bytes.size() && !has_slopes) {
    return invalid(0, std::to_string(corner_count) + " corners and " + std::to_string(patch_count) + " patches take " +
                          std::to_string(expected) + " bytes, or " +
                          std::to_string(expected + patch_count * kBaseSlopesBytes) + " with slopes, " +
                          std::to_string(expected + patch_count * (kBaseSlopesBytes + kBaseShapesBytes)) +
                          " with shapes of errors, found " + std::to_string(bytes.size()));
  }
  BaseSection out;
  for (int k = 0; k < 3; ++k) take(out.mesh.origin_mm[k]);
  take(out.error_unit_mm);
  out.mesh.corners.resize(corner_count);
  for (BaseCorner& c : out.mesh.corners) {
    for (int k = 0; k < 3; ++k) take(c.position_mm[k]);
    for (int k = 0; k < 3; ++k) take(c.normal[k]);
  }
  out.mesh.patches.resize(patch_count);
  for (auto& patch : out.mesh.patches)
    for (uint32_t& corner : patch) take(corner);
  out.coarse_errors.resize(patch_count);
  for (CoarseErrors& errors : out.coarse_errors)
    for (float& e : errors) take(e);
  // Where no grid has an error there is nothing to say of its parts.
  const bool any_error = std::any_of(out.coarse_errors.begin(), out.coarse_errors.end(),
                                     [](const CoarseErrors& errors) { return errors[0] > 0; });
  if (any_error) out.coarse_blocks.resize(patch_count);
  else p += patch_count * sizeof(CoarseBlocks);
  for (CoarseBlocks& blocks : out.coarse_blocks)
    for (uint8_t& share : blocks) take(share);
  if (has_slopes) out.slopes.resize(patch_count);
  for (HeightSlopes& s : out.slopes)
    for (float* f : {&s.min_u, &s.max_u, &s.min_v, &s.max_v}) take(*f);
  if (has_shapes && any_error) out.shapes.resize(patch_count);
  else if (has_shapes) p += patch_count * sizeof(CoarseShapes);
  for (CoarseShapes& shapes : out.shapes)
    for (DeviationShape& s : shapes) take(s);
  if (has_depths) out.texture_depths.resize(patch_count);
  for (int8_t& depth : out.texture_depths) {
    uint8_t levels = 0;
    take(levels);
    depth = static_cast<int8_t>(levels - 1);
  }
  if (auto fault = baseSectionFault(out)) return invalid(fault->offset, fault->message);
  return out;
}

std::vector<uint8_t> packBaseSection(std::span<const uint8_t> section, int zstd_level) {
  const auto corners = loadLittle<uint32_t>(section.data()), patches = loadLittle<uint32_t>(section.data() + 4);
  const BaseSectionEnd end =
      section.size() == baseSectionBytes(corners, patches) ? BaseSectionEnd::kShapes : BaseSectionEnd::kTextureDepths;
  assert(section.size() == baseSectionBytes(corners, patches, end));
  std::vector<uint8_t> out(mostPackedBaseBytes(section.size())), planes;
  storeLittle(out.data(), corners);
  const std::unique_ptr<ZSTD_CCtx, size_t (*)(ZSTD_CCtx*)> context(ZSTD_createCCtx(), ZSTD_freeCCtx);
  ZSTD_CCtx_setParameter(context.get(), ZSTD_c_compressionLevel, zstd_level);
  // Without the size its tables would be those of gigabytes, 90 MiB.
  ZSTD_CCtx_setParameter(context.get(), ZSTD_c_contentSizeFlag, 0);
  ZSTD_CCtx_setPledgedSrcSize(context.get(), section.size());
  // As large as the section they would take up to 90 MiB, too, and save 0.1 %: what repeats is near.
  constexpr int kWindowLog = 20;
  if (section.size() > size_t{1} << kWindowLog) ZSTD_CCtx_setParameter(context.get(), ZSTD_c_windowLog, kWindowLog);
  ZSTD_outBuffer to{out.data(), out.size(), 4};
  auto compress = [&](ZSTD_EndDirective how) {
    ZSTD_inBuffer from{planes.data(), planes.size(), 0};
    [[maybe_unused]] const size_t left = ZSTD_compressStream2(context.get(), &to, &from, how);
    assert(left == 0);  // there is room
    planes.clear();
  };
  forEachArray(corners, patches, end, [&](uint64_t first, uint64_t record, uint64_t records) {
    for (uint64_t k = 0; k < record; ++k) {
      for (uint64_t i = 0; i < records; ++i) planes.push_back(section[first + i * record + k]);
      // What comes next is of another kind: its symbols get a table of their own.
      if (planes.size() >= kPackedTogether) compress(ZSTD_e_flush);
    }
  });
  compress(ZSTD_e_end);
  out.resize(to.pos);
  return out;
}

Result<std::vector<uint8_t>> unpackBaseSection(std::span<const uint8_t> packed, uint32_t patches, BaseSectionEnd end) {
  assert(end >= BaseSectionEnd::kShapes);
  if (packed.size() < 4) return damagedBaseMesh("expected at least 4 bytes, found " + std::to_string(packed.size()));
  const uint64_t corners = loadLittle<uint32_t>(packed.data());
  if (auto wrong = tooManyCorners(corners, patches)) return *wrong;
  std::vector<uint8_t> planes(baseSectionBytes(corners, patches, end)), out(planes.size());
  const size_t size = ZSTD_decompress(planes.data(), planes.size(), packed.data() + 4, packed.size() - 4);
  if (ZSTD_isError(size) || size != planes.size())
    return damagedBaseMesh("expected " + std::to_string(planes.size()) + " bytes in a zstd frame, found others");
  const uint8_t* from = planes.data();
  forEachArray(corners, patches, end, [&](uint64_t first, uint64_t record, uint64_t records) {
    for (uint64_t k = 0; k < record; ++k)
      for (uint64_t i = 0; i < records; ++i) out[first + i * record + k] = *from++;
  });
  return out;
}

}  // namespace relievo
