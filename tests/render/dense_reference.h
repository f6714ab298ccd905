// dense_reference.h - the oracle of "virtual equals dense": the same frame from plain dense textures, in double
// precision. It knows nothing of pages, caches, page tables or shaders. Of the engine it uses plain types only
// (FlatDomain, the raster sources, PatchInstance with its snapping) and src/artwork/basis.h's evaluatePixel. Slow,
// simple, no GL, one thread.
//
// A frame needs a DenseTexture (the whole mip pyramid), perhaps a DenseRelief (all height samples), the list of drawn
// nodes and a DenseView. Limits: everything lies in memory (a texel takes 1.34 bytes per channel), at most 2^20
// instances.
//
// World: x right, y up, z towards the viewer, mm, origin at the artwork's centre. Artwork texel position (X, Y):
//   ((X - W/2) * mm_per_px, (H/2 - Y) * mm_per_px, (offset + q * scale) * exaggerate), without relief z = 0.
// Screen: GL's rules (clip volume -w <= z <= w, smaller z/w is nearer, both faces drawn, a pixel is covered by its
// centre), but images are stored top row first and derivatives are taken per pixel to the right (dx) and per pixel
// downwards (dy).
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/lod/planar_lod.h"
#include "src/artwork/basis.h"
#include "src/artwork/patch_domain.h"
#include "texturing/package/raster_source.h"

namespace relievo {

// --- A. dense pyramid

struct DenseLevel {
  int64_t width = 0, height = 0;
  int64_t stored_width = 0, stored_height = 0;  // equal, or the period after which the texels repeat
  std::vector<uint8_t> texels;                  // the pages' bytes: texels[(y * stored_width + x) * channels + c]
  const uint8_t* texel(int64_t x, int64_t y, int channels) const {
    return &texels[((y % stored_height) * stored_width + x % stored_width) * channels];
  }
};

struct DenseTexture {
  FlatDomain domain;
  TextureFormat format;
  std::vector<DenseLevel> levels;  // [0] coarsest ... [texture_depth] finest
};

// The domain of a source as a build lays it out; mm_per_px 1. relief may be null.
FlatDomain denseDomain(const TextureSource& texture, const HeightSource* relief, double mm_per_px = 1.0);

// The finest level is the source; a coarser one follows by the rule of texturing/codec/mip.h, implemented here on its
// own.
Result<DenseTexture> buildDenseTexture(const TextureSource& source, const FlatDomain& domain);

// An artwork of any size (2^24 texels a side) whose texels repeat. The period's width and height are powers of two that
// divide the artwork's, so that its levels repeat as well, also at odd borders (by then the level is constant).
Result<DenseTexture> buildPeriodicTexture(const TextureSource& period, const FlatDomain& domain);

// What mip.h calls the next coarser level, on channel-interleaved 8.8 fixed point texels of any size (odd borders
// repeated).
std::vector<uint16_t> denseDownsample(const TextureFormat& format, const std::vector<uint16_t>& in, int64_t width,
                                      int64_t height);

// --- B. dense relief

// Every sample of the finest relief level, over the whole artwork: sample (i, j) lies at texel position
// (min(i * spacing, W), min(j * spacing, H)), spacing = 2^(texture_depth - relief_depth) texels.
struct DenseRelief {
  int64_t width = 0, height = 0;
  int samples_per_texel_log2 = 0;  // relief_depth - texture_depth; may be negative
  double offset_mm = 0, scale_mm = 0;
  std::vector<uint16_t> samples;
};

// Colour with the normals of its relief beside it (texturing/stream/relief_normals.h), level by level: six channels,
// the normals as bytes.
DenseTexture denseWithNormals(const DenseTexture& colour, const DenseRelief& relief, double exaggerate);
// Of a texel's middle, before it becomes bytes. k: the level, 0 the coarsest.
glm::dvec3 denseNormal(const DenseRelief& relief, const FlatDomain& domain, int k, int64_t x, int64_t y,
                       double exaggerate);

Result<DenseRelief> buildDenseRelief(const HeightSource& source, const FlatDomain& domain);

// Height in mm (not exaggerated) of a vertex at (x, y) units of 2^-kUnitsPerTexelLog2 texels, before it is clamped to
// the border. Between samples: linear on the sample cell's two triangles, split along (0,0)-(1,1). At or beyond the
// right (bottom) border: the next sample at or beyond it.
double denseHeightMm(const DenseRelief& relief, const FlatDomain& domain, int64_t x, int64_t y);

// --- C. rasteriser

// How dX/dx and its kin are taken. Both come from the perspective mapping of the pixel's own triangle.
enum class DenseDerivatives {
  kExact,  // at the pixel's centre
  kQuad    // differences within the pixel's 2x2 quad, as a fragment shader's dFdxFine and dFdyFine give them
};

// Which texels a pixel's colour comes from; (dX/dx, dY/dx) and (dX/dy, dY/dy) span its footprint.
//   kNearest     the texel whose square holds the place, of the nearest level, floor(lambda + 0.5)
//   kBilinear    bilinear on the nearest level
//   kTrilinear   bilinear on the two levels around lambda, blended. To here lambda follows the longer derivative
//   kAnisotropic the footprint's ellipse has half the singular values of the derivatives as its half axes, major >=
//                minor. With N = anisotropy and size = max(minor, major / N, 1) texels, lambda is log2(size) and the
//                colour's channels are the mean over a box of length major (N size at most) along the major axis, taken
//                as trilinear taps one size apart, symmetric about the place: each counts as much as the part of its
//                interval of one size that lies in the box. As many taps as N is even or odd; but with a ratio r =
//                major / size <= 2 and an even N two, (r - 1) size apart. A tap beyond the artwork is moved to its
//                border, coordinate by coordinate; each tap filters as kTrilinear does. N = 1 is kTrilinear.
enum class DenseSampling { kNearest, kBilinear, kTrilinear, kAnisotropic };

struct DenseView {
  glm::dmat4 clip_from_world{1.0};
  int width_px = 0, height_px = 0;
  double exaggerate = 1.0;
  std::array<double, 3> light{0, 0, 1};  // the unit vector towards it
  DenseSampling sampling = DenseSampling::kTrilinear;
  int anisotropy = 8;
  double lod_bias = 0;
  bool resolved =
      false;  // the light is fixed: each level's texels are evaluated and rounded to bytes before they are filtered
  // In the place of `light`: the colour (1: 255) of raw channels at a place of the surface, mm. Empty: `light`.
  std::function<glm::dvec3(const TextureFormat&, const double* raw, const glm::dvec3& place_mm)> lit;
  std::function<glm::dvec3(const glm::dvec3&)> tone;  // what becomes of a shaded colour (1: 255); empty: nothing
  DenseDerivatives derivatives = DenseDerivatives::kExact;
  double snapped_px =
      0;  // how far to each side the GL may move a corner before it interpolates between them; 0: it does not
};

// Why a pixel's value is not determined. GL snaps vertices to a fixed-point grid (here taken as 1/256 px; the standard
// asks for 1/16 px or better) and computes in single precision. So a triangle that touches the square of +-1/64 px
// around a pixel's centre may be the one that is drawn there, unless it lies behind all that is seen in that square;
// and the gradients of a triangle that is thin on the screen depend on where its corners were snapped to.
//
// "Behind" is by more than 2^-21 of z/w. Nearer than that the depth buffer does not tell two surfaces apart, also where
// both cover the whole square: next to a fold, where a slope goes over into its hidden back side, they come as close as
// one likes. The 2^-21 are the sum of what a common depth buffer leaves open:
//   - 24 bits: two depths within one step, 2^-24 of window depth or 2^-23 of z/w, may be stored as the same number, and
//     which triangle then wins is a matter of the order of drawing;
//   - single precision: a window depth of 1/2 to 1 is rounded by up to 2^-25, or 2^-24 of z/w, each time: z/w at the
//     corners, its window depth there, the interpolation at the pixel: 3 * 2^-24 for each of the two surfaces.
// Errors of the clip coordinates are not counted: at a fold, the case that matters, triangles share corners and move
// together.
enum EdgeReason : uint8_t {
  kEdgeSilhouette = 1,  // the artwork's outline runs through the square
  kEdgeOcclusion =
      2,  // another triangle may show, and its texel position at the pixel's centre is more than half a
          // pixel's footprint (0.5 * sqrt(rho2) texels) away: another part of the artwork. Or, anisotropic, the
          // triangle is so thin beside DenseView::snapped_px that nothing is known of the footprint's direction
  kEdgeColour = 4,  // another triangle may show; the place is the same, but its level of detail gives another colour
                    // (by more than 0.5 of 255 in a channel)
  kEdgeThin = 8,    // of height h px: lambda may be off by log2(1 - sqrt(2) / 256 / h), and the colour by more than 0.5
  kEdgeLevelTie =
      16,  // nearest and bilinear: lambda within 1/256 of the change of level, the other level's colour as above
  kEdgeTexelTie = 32,  // nearest: within 1/128 px of the next texel, whose colour differs as above
  kEdgePlace = 64      // the colour differs as above within DenseView::snapped_px
};

struct DensePixel {
  glm::dvec3 rgb{0};                    // 0..255, not rounded
  glm::dvec2 texel{0};                  // artwork texel position (X, Y)
  glm::dvec2 texel_dx{0}, texel_dy{0};  // (dX/dx, dY/dx) and (dX/dy, dY/dy), y downwards
  double depth = 1;                     // z / w
  double lambda = 0;                    // level of detail after bias and clamping: 0 finest ... texture_depth coarsest
  int32_t triangle = -1;                // instance << 11 | cell << 1 | half; -1: background
  uint8_t edge = 0;                     // EdgeReason bits
  glm::dvec3 low{0},
      high{0};  // the values that rgb may take instead: equal to rgb but for the reasons from kEdgeColour on
  bool covered() const { return triangle >= 0; }
  std::array<uint8_t, 3> bytes() const;
};

struct DenseImage {
  int width = 0, height = 0;
  std::vector<DensePixel> pixels;  // top row first
  const DensePixel& at(int x, int y) const { return pixels[size_t(y) * width + x]; }
  size_t coveredPixels() const;
  size_t edgePixels() const;
  double edgeShare() const;  // edge pixels / (covered or edge pixels); 0 for an empty image
};

// relief null: flat.
DenseImage renderDense(const DenseTexture& texture, const DenseRelief* relief, std::span<const PatchInstance> instances,
                       const DenseView& view);

// The colour at a texel position and level of detail (clamped to 0..texture_depth): the shading part of renderDense
// alone; kAnisotropic with a round footprint. place_mm: for DenseView::lit.
glm::dvec3 shadeDense(const DenseTexture& texture, glm::dvec2 texel, double lambda, const DenseView& view,
                      const glm::dvec3& place_mm = {});
// The same with a footprint, from its derivatives. lambda_offset: as lod_bias, on top of it.
glm::dvec3 shadeDense(const DenseTexture& texture, glm::dvec2 texel, glm::dvec2 dx, glm::dvec2 dy,
                      const DenseView& view, double lambda_offset = 0, const glm::dvec3& place_mm = {});

// All nodes of one level as drawn nodes of 2^grid_level segments: a list that needs no LOD.
std::vector<PatchInstance> uniformInstances(const FlatDomain& domain, int level, int grid_level);

// --- D. comparison with an image of the engine

struct PixelPair {
  int x = -1, y = -1;  // top row first
  int channel = 0;
  glm::dvec3 expected{0};
  std::array<uint8_t, 4> found{};
};

// "Inside" is where the reference is covered and neither a silhouette nor an occlusion edge runs through the pixel.
// Where only the level of detail or the place is undetermined (the reasons from kEdgeColour on) a difference is the
// distance to the range low..high.
struct ImageDifference {
  std::array<int, 3> max_difference{};  // per channel, inside, of the rounded bytes
  double max_exact = 0;                 // the same over all channels, against the reference before rounding
  double percentile_999 = 0;            // of the pixels' largest difference before rounding
  size_t count_above_1 = 0;             // pixels inside whose bytes differ by more than 1
  size_t compared = 0;                  // pixels inside
  size_t compared_to_range = 0;         // of these, pixels whose level of detail is undetermined
  size_t edge_pixels = 0;               // pixels left out
  size_t holes = 0;                     // inside, but the engine shows background: a defect, whatever the colours
  size_t extras = 0;                    // not covered and not an edge pixel, but the engine shows something
  PixelPair worst;                      // a hole before any difference of colour
  int maxDifference() const { return std::max({max_difference[0], max_difference[1], max_difference[2]}); }
  bool within(int limit) const { return maxDifference() <= limit && holes == 0 && extras == 0; }
  std::string text() const;  // one line
};

// rgba: width * height * 4 bytes, tightly packed; alpha 0 is background.
ImageDifference compareImages(const DenseImage& reference, std::span<const uint8_t> rgba, bool bottom_up);

}  // namespace relievo
