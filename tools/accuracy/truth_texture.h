// truth_texture.h - an artwork's texture as the truth samples it: in double precision, from every texel that a pixel's
// footprint covers. The levels are the package's own pages; that these equal a pyramid computed from the source is
// tested elsewhere (tests/render/package_agrees_test.cpp).
//
// A pixel is the mean over its footprint, a parallelogram spanned by the texel position's derivatives: trilinear taps
// along the ellipse's major axis, as the renderer's anisotropic sampling is defined (tests/render/dense_reference.h),
// with up to kTruthTaps of them, so that no footprint of a picture is cut short. A tap beyond the artwork's border, or
// beyond a patch of a base mesh, takes the nearest texel within.
#pragma once

#include <cstdint>
#include <list>
#include <memory>
#include <mutex>
#include <span>
#include <unordered_map>
#include <vector>

#include <glm/glm.hpp>

#include "src/engine/effect_plan.h"
#include "texturing/codec/mip.h"
#include "texturing/package/package.h"
#include "texturing/package/texture_pages.h"
#include "texturing/stream/relief_normals.h"

namespace relievo {

inline constexpr int kTruthTaps = 64;

// A place on the artwork, in texels of the finest level: of a flat artwork from its top left corner, over a base mesh
// from the patch's corner; and its derivatives along the picture's x and y.
struct TexelFootprint {
  uint32_t patch = 0;
  glm::dvec2 texel{0}, dx{0}, dy{0};
};

// Thread-safe. Errors of pages are kept (problem()) and read as zero.
class TruthTexture {
 public:
  // plan: what the scene shows. budget_bytes: of decoded pages.
  TruthTexture(std::shared_ptr<const Package> package, const EffectPlan& plan, double exaggerate,
               uint64_t budget_bytes);
  const TextureFormat& format() const { return format_; }
  // Raw channels, format().channels() of them.
  void filter(const TexelFootprint& at, std::span<double> channels) const;
  Result<void> problem() const;

 private:
  struct Node {  // decoded: plane by plane RGBA8 of kPageFullPx^2; then, over a base mesh, coarser levels of a root
    std::vector<uint8_t> texels;
    std::vector<std::vector<double>> coarser;
  };
  std::shared_ptr<const Node> node(const NodeId& id) const;
  std::shared_ptr<const Node> load(const NodeId& id) const;
  void addCoarser(Node& node) const;
  void bilinear(uint32_t patch, int level, glm::dvec2 texel, double weight, std::span<double> sum) const;
  void bilinearCoarser(uint32_t patch, int below_root, glm::dvec2 texel, double weight, std::span<double> sum) const;

  std::shared_ptr<const Package> package_;
  TexturePages pages_;
  PatchDomain domain_;
  TextureFormat format_;
  int stored_planes_ = 0;
  std::unique_ptr<ReliefNormals> normals_;
  MipFilter mip_;
  size_t most_nodes_;
  mutable std::mutex mutex_;
  mutable std::unordered_map<NodeId, std::shared_ptr<const Node>> nodes_;
  mutable std::optional<Error> problem_;
};

}  // namespace relievo
