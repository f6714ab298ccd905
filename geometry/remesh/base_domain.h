// base_domain.h - the coarse quads over which a scanned mesh becomes a displacement: few, near square, close to the
// surface, with normals along which it is a function (Gobbetti et al. 2012; Pietroni, Tarini, Cignoni 2010).
//   topology  the scan's: pieces, handles, border loops; every side shared by two patches, or one at a border
//   borders   border corners lie on the scan's borders, and each sharp turn of a border is a corner, however rough the
//             border is; between corners it deviates from the sides, across the normals, by at most 0.2 % of the
//             diagonal where the number of patches is free (or by what the border's own steps need)
//   creases   sides that follow sharp ones have their corners on them
//   normals   of length 1, outwards; mean normals of what lies within half a patch, turned towards what would face away
//   order     the same mesh and options give the same base, bit for bit
//   workers   do not change it
// Two million triangles take 0.5 s on two cores; some 15 bytes a triangle beside the mesh, fewer the larger it is.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>

#include "geometry/mesh/tri_mesh.h"
#include "src/artwork/base_mesh.h"
#include "src/base/result.h"

namespace relievo {

struct BaseDomainOptions {
  // About as many (within 30 %; more where the topology needs them); 0: from 64 (a four-sided sheet: from 1) up to 800,
  // until no more than 0.15 % of the surface lies where lines along the normals do not reach it, or more patches bring
  // no gain.
  uint32_t patches = 0;
  double mm_per_unit = 1;  // of the mesh's coordinates, for places in errors
  int workers = 0;         // 0: one a core
  std::function<void()>
      scan_done;  // called at most once, when one core suffices and the scan itself is seldom looked at
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
// A place where a base missed the scan, in the mesh's coordinates, and how much finer patches are to be there: 16
// halves their sides.
struct BaseMiss {
  glm::dvec3 place_mm{0};
  float factor = 16;
};
// Base meshes over one scan, one after the other. The mesh must outlive it unchanged. The same calls give the same
// meshes, bit for bit.
class BaseDomain {
 public:
  static Result<std::unique_ptr<BaseDomain>> create(const TriMesh& mesh, const BaseDomainOptions& options = {});
  ~BaseDomain();
  // Errors as makeBaseMesh() has them.
  Result<BaseMesh> make();
  // After make(): with smaller patches there, and elsewhere as many as there were; at most that many, about.
  Result<BaseMesh> refine(std::span<const BaseMiss> misses, uint32_t most_patches);
  size_t patches() const;  // of the last one

 private:
  struct Impl;
  explicit BaseDomain(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// kInvalidData names what TriMesh excludes (indices out of range, numbers that are not finite, three triangles at an
// edge), pieces without area, and pieces with one side only (Moebius strips). kInterrupted: interrupted was set.
Result<BaseMesh> makeBaseMesh(const TriMesh& mesh, const BaseDomainOptions& options = {});

}  // namespace relievo
