// base_domain.h - makes the base mesh of a scan: few quads, near square and close to the surface, with normals along
// which the surface is a function. Sources: Gobbetti et al. 2012 (adaptive quad patches); Pietroni, Tarini, Cignoni
// 2010 (abstract domains).
// - Topology: that of the scan (pieces, handles, border loops). Two patches share each side, or one has it at a border.
// - Borders: border corners lie on the scan's borders. Each sharp turn of a border is a corner, however rough the
// border is. Between corners the border deviates from the sides, across the normals, by at most 0.2 % of the diagonal
// if the number of patches is free; a border with steps of its own may deviate by as much as these need.
// - Creases: sides along sharp creases have their corners on them.
// - Normals: of length 1 but for 5e-4, never longer, outwards. They are the mean over half a patch's width, turned
// towards parts of the surface that would face away.
// - Rounding: components of normals are multiples of 1/4096, coordinates of corners that of a power of two that is at
// most 1/65536 of the diagonal and 1/32 of any side, but those of faces() and simplifiedFaces() are not rounded.
// - Determinism: the same mesh and options give the same base, bit for bit, with any number of workers.
// - Cost: two million triangles take 0.5 s on two cores, and about 15 bytes a triangle beside the mesh, fewer the
// larger it is.
// Units: the mesh's. Any thread.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>

#include "geometry/mesh/tri_mesh.h"
#include "geometry/remesh/base_faces.h"
#include "src/artwork/base_mesh.h"
#include "src/base/result.h"

namespace relievo {

struct BaseDomainOptions {
  // The approximate number of patches (within 30 %; more where the topology needs them). 0: grows from 64 (a four-sided
  // sheet: from 1) to 800, until the base is worth trying: at most 2 % of the surface are out of reach of lines along
  // the normals; or more patches do not help. grow() goes on from there, until at most 0.15 % are.
  uint32_t patches = 0;
  double mm_per_unit = 1;  // converts positions in error messages
  int workers = 0;         // 0: one for each core
  // Called at most once, when the rest of the work mostly needs one core only and seldom reads the scan.
  std::function<void()> on_serial_phase;
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
// A position that the base missed, in the mesh's coordinates, and the requested increase of the patch density there: 16
// halves the patches' sides.
struct RefineRequest {
  glm::dvec3 position_mm{0};
  float factor = 16;
};
// Makes one base mesh after the other over the same scan. The mesh must outlive this object unchanged. The same calls
// give the same meshes, bit for bit.
class BaseDomain {
 public:
  // Checks the scan.
  static Result<std::unique_ptr<BaseDomain>> create(const TriMesh& mesh, const BaseDomainOptions& options = {});
  ~BaseDomain();
  // The first base mesh. Errors: as makeBaseMesh().
  Result<BaseMesh> make();
  // After make() or itself, before all others, and without a number of patches: a base mesh with more of them
  // everywhere, or an error (kUsage) if there is none that loses less; kToBeFiner: that loses nothing to speak of.
  enum class Growth : uint8_t { kToLoseLess, kToBeFiner };
  Result<BaseMesh> grow(Growth growth = Growth::kToLoseLess);
  // Whether grow() would try to lose less.
  bool mayGrow() const;
  // After make(): a base mesh with smaller patches at the requests and equally large ones elsewhere, of about
  // max_patches at most. least_patches: about so many at least, of which all are smaller where they are more.
  Result<BaseMesh> refine(std::span<const RefineRequest> requests, uint32_t max_patches, uint32_t least_patches = 0);
  // How many patches refine() would aim at without a limit.
  uint32_t patchesToRefine(std::span<const RefineRequest> requests) const;
  // The scan's own triangles as patches (base_faces.h): at most max_patches, or an error (kUsage) if that is too few.
  // It changes nothing of what make() and refine() return.
  Result<BaseMesh> faces(uint32_t max_patches);
  // The same of a scan that was simplified to so few triangles, with its sharp edges, for scans that faces() refuses.
  // From the second call on there are smaller patches at its requests and at those of the calls before, and larger ones
  // elsewhere; those of the first call are not used, since they are of another base.
  Result<BaseMesh> simplifiedFaces(std::span<const RefineRequest> requests, uint32_t max_patches);
  // Of the last base mesh that make(), grow() or refine() returned: its patches, and the share of the scan's area that
  // lines along its normals do not reach, estimated coarsely (base_fit.h).
  size_t patches() const;
  double lostArea() const;

 private:
  struct Impl;
  explicit BaseDomain(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// The last one that make() and grow() make.
// Errors: kInvalidData names what TriMesh excludes (indices out of range, numbers that are not finite, three triangles
// at an edge), pieces without area, and pieces with one side only (Moebius strips); kInterrupted.
Result<BaseMesh> makeBaseMesh(const TriMesh& mesh, const BaseDomainOptions& options = {});

}  // namespace relievo
