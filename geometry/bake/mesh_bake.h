// mesh_bake.h - a triangle mesh sampled over a base mesh: heights along the base's interpolated normals, colours,
// normals, and how far coarser grids lie from the finest. The same for any number of workers.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "geometry/bake/grid_error.h"
#include "geometry/mesh/tri_mesh.h"
#include "src/artwork/base_mesh.h"
#include "src/base/result.h"

namespace relievo {

struct BakeOptions {
  // 2^this relief cells a patch's side, 1 to 14. -1: as many as it takes for 99.9 % of the surface to lie within
  // tolerance_mm of the scan, but at most 2^10, and at most four million samples or 16 (256 where a tolerance is given)
  // for each of the scan's vertices: where a line along the base's normal meets the scan twice, no grid is fine enough.
  // It ends sooner where finer grids hardly help.
  int cells_log2 = -1;
  double tolerance_mm =
      0;  // 0: 1e-4 of the bounding box's diagonal, and a sample for every two vertices of the scan at least
  // Heights that lie closest to the scan between samples, too (least squares; geometry/bake/height_fit.h), in place of
  // the scan's at the samples; and where cells_log2 is -1, as few cells a patch as keep the tolerance. Not where the
  // coarsest grid keeps it as it is.
  bool fit = true;
  int texture_depth = -1;  // 128 << this texels a patch's side; -1: as fine as the colours
  int workers = 0;         // 0: one a core
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;  // texels() heeds it, too
};

// Why a tolerance was not reached.
enum class BakeLimit : uint8_t {
  kNone,     // it was
  kCells,    // no more cells a patch are made, or were asked for
  kSamples,  // nor samples for a scan of so many vertices
  kShape,    // finer grids hardly come nearer: edges and undercuts that no grid follows
};
struct BakeReport {
  int cells_log2 = 0, texture_depth = 0;
  bool fitted = false;  // heights are a fit, not the scan's at the samples
  uint64_t samples =
      0;  // (n + 1)^2 a patch, shared ones counted once; n: 2^cells_log2, or fewer where fewer keep the tolerance
  uint64_t by_closest_point = 0;  // samples whose line meets the mesh nowhere within a patch's width, nor nearly
  double tolerance_mm = 0,
         deviation_mm = 0;  // asked for; what 99.9 % of places looked at, where lines meet the scan, keep
  BakeLimit limit = BakeLimit::kNone;
  double seconds = 0;
};

class LineSweep;
class RayScene;

// What a bake looks up in the mesh, which must outlive it unchanged: to be made beside the base mesh, which takes as
// long.
// Copies share it: several bakes of one mesh look up the same.
struct BakeScene {
  std::shared_ptr<const RayScene> rays;
  std::shared_ptr<const LineSweep> sweep;                 // of dense scans: rays are for what it does not answer
  std::shared_ptr<const std::vector<glm::vec3>> normals;  // of the mesh's vertices
};
struct BakeSceneOptions {
  uint64_t ray_bytes =
      ~uint64_t{0};               // of ray hierarchies at a time: with less all takes longer, and comes out the same
  uint32_t region_triangles = 0;  // of each hierarchy; 0: what suits the mesh's size
  size_t sweep_from_triangles =
      100'000;  // meshes of so many are swept: smaller ones have few triangles a patch, and rays are as fast
  int workers = 0;
  const std::atomic<bool>* interrupted = nullptr;
};
Result<BakeScene> makeBakeScene(const TriMesh& mesh, const BakeSceneOptions& options);

class MeshBake {
 public:
  // What the mesh's texture coordinates belong to; empty: nothing. Rows top first, channels interleaved: sRGB; or,
  // where `planes` is set, channels that stand for themselves (a PTM's coefficients and colour): they become the
  // texture, in place of colour and normal.
  struct Image {
    int width = 0, height = 0;
    std::span<const uint8_t> texels;
    int channels = 3;
    bool planes = false;
    bool repeats = false;  // beyond its border
  };
  // The mesh and the image's bytes are used in place: they must outlive the bake unchanged. scene: of the mesh, or
  // empty.
  static Result<std::unique_ptr<MeshBake>> create(const TriMesh& mesh, const Image& image, const BaseMesh& base,
                                                  const BakeOptions& options, BakeScene scene = {});
  ~MeshBake();

  const BaseMesh& base() const;
  const BakeReport& report() const;
  // As texturing/package/patch_source.h has them. reliefDepth: max(cells_log2 - 7, 0); where cells_log2 is below 7,
  // values between samples are interpolated on the cells' triangles, rounded alike from both sides of a patch's border.
  int textureDepth() const;
  int reliefDepth() const;
  double reliefOffsetMm() const;
  double reliefScaleMm() const;
  // From here on heights differ by whole steps from what coarser grids show (height_steps.h), so that a package needs
  // few bytes for them; of the heights that were baked, however often it is called. 0: these themselves. No other
  // thread may look at the bake meanwhile. The error: kInterrupted.
  Result<void> setStep(double step_mm);
  double errorUnitMm() const;
  // 6 channels: R G B, then the normal, byte = round(127.5 (n + 1)). Of planes: theirs, filtered as far as they are
  // finer than texels.
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const;
  Result<void> heights(uint32_t patch, std::span<uint16_t> out) const;
  // Of the grid of 2^cells_log2 cells a patch's side, 0 <= cells_log2 <= 7 + reliefDepth(): grids coarser than a root
  // page's are drawn, too. By blocks of 8 x 8 cells, [y * B + x], B = errorBlocks(cells_log2).
  static int errorBlocks(int cells_log2) { return errorBlocksASide(cells_log2); }
  const GridErrors& errorsOfCells(uint32_t patch, int cells_log2) const;
  float errorOfCells(uint32_t patch, int cells_log2) const;  // the whole patch's

 private:
  struct Impl;
  explicit MeshBake(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
