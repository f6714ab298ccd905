// mesh_bake.h - bakes a triangle mesh onto a base mesh: heights along the base's interpolated normals, colours and
// normals as textures, and the errors of coarser grids. The result is the same for any number of workers.
// Units: mm. Errors: kUsage (options), kInvalidData (mesh or base mesh), kInterrupted.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/bake/between_samples.h"
#include "geometry/bake/grid_error.h"
#include "geometry/mesh/tri_mesh.h"
#include "src/artwork/base_mesh.h"
#include "src/base/result.h"

namespace relievo {

// What is done where a line meets the scan far from the base, but the base touches the scan.
enum class Touching : uint8_t {
  kIgnored,  // nothing
  kFacing,   // the height is taken there if the scan faces along the line: bases whose sides follow sharp edges need it
  // It is taken there whichever way the line runs, unless the scan faces opposite to the base itself: for bases all of
  // whose corners lie on the scan. At thin parts their normals are so far apart that lines run along the surface, and
  // leave it.
  kSameSheet,
  kAlways,  // it is taken there, whichever way the scan faces
};

struct BakeOptions {
  // log2 of the relief cells of a patch's side, 1 to 14. -1: cells are doubled until 99.9 % of the surface lies within
  // tolerance_mm of the scan, but at most 2^10, and with at most 16 samples for each vertex of the scan (256 if a
  // tolerance is given) or four million, whichever is more. This ends sooner where finer grids hardly help: where a
  // line along the base's normal meets the scan twice, no grid is fine enough.
  int cells_log2 = -1;
  // 0: 1e-4 of the bounding box's diagonal, and at least a sample for every two vertices of the scan.
  double tolerance_mm = 0;
  // Fit the heights to the scan between the samples, too (height_fit.h), instead of taking the scan's at the samples;
  // if cells_log2 is -1, with as few cells for each patch as keep the tolerance. No fit is made if the coarsest grid
  // keeps the tolerance anyway.
  bool fit = true;
  // No fit is made where the deviation is larger than so many times the tolerance when no more cells are tried: a base
  // of another shape is needed there, and a bake that only shows this need not be the best. 0: it is always made.
  double fit_within = 0;
  // It costs a search of the closest point for lines that meet the scan far from the base.
  Touching touching = Touching::kIgnored;
  // Heights are 0 where the scan is within this distance of the base, whichever way it faces there. For bases that lie
  // on the scan. Where such a base is cut, heights and texels are those of the triangles that its halves lie on.
  double touch_mm = 0;
  // False: errorsOfGrid(), errorOfGrid() and errorUnitMm() are known once findErrors() was called. For bakes that are
  // measured, and may be dropped.
  bool errors = true;
  int texture_depth = -1;  // a patch has 128 << this texels a side; -1: each is as fine as the colours there
  // With -1 and an image: patches that it has few texels on have 16 a side, those of a tail (textureDepthOf() is then
  // kNoTexturePage).
  bool tail_textures = false;
  // With tail_textures: patches of the scan's own triangles show plain and vertices' colours themselves (imagesOn()),
  // and images that have fewer texels than these patches would.
  bool show_images = false;
  int workers = 0;  // 0: one for each core
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;  // also stops texels()
};

// Of each channel: of scans without colours or images.
inline constexpr uint8_t kPlainGrey = 200;

// Why the tolerance was not reached.
enum class BakeLimit : uint8_t {
  kNone,     // it was reached
  kCells,    // the largest, or the requested, number of cells was reached
  kSamples,  // the largest number of samples for the scan's vertices was reached
  kShape,    // finer grids hardly help: edges and undercuts remain
};
struct BakeReport {
  int cells_log2 = 0, texture_depth = 0;
  bool fitted = false;   // the heights are a least-squares fit
  bool far_off = false;  // no fit was made: BakeOptions::fit_within
  // (n + 1)^2 for each patch, shared ones counted once. n: 2^cells_log2, or fewer cells where these keep the tolerance.
  uint64_t samples = 0;
  uint64_t by_closest_point = 0;  // samples whose lines do not meet the scan within a patch's width
  // The tolerance, and the distance that 99.9 % of the probes keep whose lines meet the scan.
  double tolerance_mm = 0, deviation_mm = 0;
  BakeLimit limit = BakeLimit::kNone;
  double seconds = 0;
};

class LineRasteriser;
class RayScene;
struct CornerNormals;

// What a patch that is cut shows of images, or which colours its corners have: on the half to the right of its
// diagonal, and on that to its left.
struct ImagesOnPatch {
  int depth = 0;                    // its finest texture level; kNoTexturePage: its tail shows all
  std::array<uint16_t, 2> image{};  // kNoImage: its vertices' colours
  // At a half's corners (0,0), (1,0) or (0,1), and (1,1): texture coordinates, (0, 0) is the image's lower left corner;
  // and the triangle's normals, of length 1.
  std::array<std::array<glm::dvec2, 3>, 2> uv{};
  std::array<std::array<glm::vec3, 3>, 2> normal{};
  // Without an image, in place of texture coordinates: sRGB, 0 to 255, linear between the corners.
  std::array<std::array<glm::vec3, 3>, 2> colour{};
};

// The scan's search structures. The mesh must outlive them unchanged. They can be made while the base mesh is computed,
// and copies share them, so that several bakes of one mesh build them once.
struct BakeScene {
  std::shared_ptr<const RayScene> rays;
  // Only of large scans; rays trace the lines that it leaves open.
  std::shared_ptr<const LineRasteriser> rasteriser;
  size_t rasterise_from_per_patch = 0;  // BakeSceneOptions
  std::shared_ptr<const CornerNormals> normals;
};
struct BakeSceneOptions {
  // Memory for ray hierarchies. With less, a bake takes longer; its result is the same.
  uint64_t ray_bytes = ~uint64_t{0};
  uint32_t region_triangles = 0;  // triangles of each hierarchy; 0: chosen by the mesh's size
  // Meshes with at least so many triangles are rasterised, over bases of which a patch has at least so many of them in
  // the mean. Where it has fewer, rays are faster: up to five times where it has ten. Bases that are cut take
  // kCutTimes as many: their halves are rasterised one after the other, where 360 and 800 took 2.4 and 1.4 times as
  // long as by rays.
  static constexpr size_t kCutTimes = 16;
  size_t rasterise_from_triangles = 100'000, rasterise_from_per_patch = 160;
  int workers = 0;
  const std::atomic<bool>* interrupted = nullptr;
};
Result<BakeScene> makeBakeScene(const TriMesh& mesh, const BakeSceneOptions& options);

class MeshBake {
 public:
  // What the mesh's texture coordinates refer to. Rows top first, channels interleaved. Without `planes` it is sRGB.
  // With `planes` its channels are data (a PTM's coefficients and colour) and become the texture, in place of colour
  // and normal: then there is one image.
  struct Image {
    int width = 0, height = 0;
    std::span<const uint8_t> texels;
    int channels = 3;
    bool planes = false;
    bool repeats = false;  // texture coordinates outside of [0, 1] repeat the image
    // Whole triangles have one of its colours each; of one colour alone no texture coordinates are needed.
    bool palette = false;
    bool has_file = false;  // a file of few bytes, which is kept where patches show the image
    // A map of normals in tangent space for the same texture coordinates (NormalMap, tri_mesh.h), three channels, of
    // any size; or none. Not beside planes or palettes.
    int normals_width = 0, normals_height = 0;
    std::span<const uint8_t> normals;
    bool normals_downwards = false;  // y counts downwards in the image
    // Texture coordinates count by the texels of whichever has more of them.
    int placeWidth() const { return std::max(width, normals_width); }
    int placeHeight() const { return std::max(height, normals_height); }
    double texelsWithNormals() const {
      return static_cast<double>(width) * height + static_cast<double>(normals_width) * normals_height;
    }
  };
  // images: those that TriMesh::image_of names, or none. The mesh and the images' bytes are used in place: they must
  // outlive the bake unchanged. scene: made from the mesh, or empty.
  static Result<std::unique_ptr<MeshBake>> create(const TriMesh& mesh, std::span<const Image> images,
                                                  const BaseMesh& base, const BakeOptions& options,
                                                  BakeScene scene = {});
  ~MeshBake();

  const TriMesh& mesh() const;
  const BaseMesh& base() const;
  const BakeReport& report() const;
  // As texturing/package/patch_source.h defines them. reliefDepth() is max(cells_log2 - 7, 0). If cells_log2 is below
  // 7, values between samples are interpolated on the cells' triangles, with the same rounding from both sides of a
  // patch's border.
  int textureDepth() const;
  int textureDepthOf(uint32_t patch) const;  // or kNoTexturePage; that of texels()
  // Which of the images patches show themselves (BakeOptions::show_images), and what a patch shows of them, if it does.
  // Of its texels() nothing is needed.
  std::vector<bool> shownImages() const;
  bool showsImages() const;  // some patch does, or shows vertices' colours
  std::optional<ImagesOnPatch> imagesOn(uint32_t patch) const;
  int reliefDepth() const;
  double reliefOffsetMm() const;
  double reliefScaleMm() const;
  // From here on heights differ by whole steps from what coarser grids show (height_steps.h), so that a package needs
  // few bytes for them; of the heights that were baked, however often it is called. 0: these themselves. No other
  // thread may look at the bake meanwhile. The error: kInterrupted.
  Result<void> setStep(double step_mm);
  // How far the heights moved by that, in mm along the base's normals: the root mean square over the base's area.
  double stepChangeMm() const;
  // For BakeOptions::errors = false; setStep() forgets what was found. The error: kInterrupted.
  Result<void> findErrors();
  double errorUnitMm() const;
  // It has no heights over a base that is cut: each half of a patch is one plane.
  bool isFlat() const;
  // Its surface is its base: all heights are the same, and no grid has an error.
  bool isEven() const;
  // 6 channels: R, G, B, then the normal's x, y, z as round(127.5 (n + 1)). With planes: the image's channels, filtered
  // to the texels' size.
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const;
  Result<void> heights(uint32_t patch, std::span<uint16_t> out) const;
  // Of the finest drawn grid, of 2^finestLog2() cells a side, or at the vertices of a coarser one, (2^cells_log2 +
  // 1)^2.
  int finestLog2() const { return 7 + reliefDepth(); }
  void heightsOfGrid(uint32_t patch, int cells_log2, std::span<uint16_t> out) const;
  // The positions of a grid's vertices, in the scan's coordinates. out: of at most finestLog2().
  void surface(uint32_t patch, SurfaceGrid& out) const;
  // How little coarser grids of a patch differ from the finest.
  BetweenSamples betweenSamples(uint32_t patch) const;
  // The errors of a patch's grid of 2^cells_log2 cells a side, 0 <= cells_log2 <= 7 + reliefDepth(), since grids
  // coarser than a root page's are drawn, too. By blocks of 8 x 8 cells: index y * B + x, B = errorBlocks(cells_log2).
  static int errorBlocks(int cells_log2) { return errorBlocksPerSide(cells_log2); }
  GridErrors errorsOfGrid(uint32_t patch, int cells_log2) const;
  float errorOfGrid(uint32_t patch, int cells_log2) const;  // the largest over the patch

 private:
  struct Impl;
  explicit MeshBake(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
