// shown_images.h - limits of images that patches show (texturing/package/patch_images.h), which whoever bakes a scan
// keeps, and who reads a package checks.
#pragma once

#include <cstdint>

namespace relievo {

inline constexpr int kMostShownDepth = 8;  // the finest texture level of a patch that shows one
inline constexpr uint32_t kMostShownImages = 65535, kMostShownSide = 16384;  // texels of an image
// In place of an image's number: colours of corners, which are linear between them.
inline constexpr uint16_t kCornerColours = 65535;
// Of all images: they stay in memory once they are read, four bytes a texel with those of coarser levels. One of
// 8192 x 8192 fits with a map of normals of half its width. Packages of more than the latter are of version 19.
inline constexpr uint64_t kMostShownTexels = uint64_t{80} << 20, kMostTexelsBefore19 = uint64_t{48} << 20;
// Of a patch's corner in an image, either way: 256ths of a texel.
inline constexpr int32_t kMostShownPlace = (int32_t{1} << 30) - 1;

}  // namespace relievo
