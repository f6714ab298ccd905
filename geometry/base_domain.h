// base_domain.h - the coarse quads over which a scanned mesh becomes a displacement: few, near square, close to the surface, with normals along
// which it is a function (Gobbetti et al. 2012; Pietroni, Tarini, Cignoni 2010).
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>

#include "geometry/tri_mesh.h"
#include "src/base/base_mesh.h"
#include "src/base/result.h"

namespace relievo {

struct BaseDomainOptions {
  uint32_t patches = 0;  // about as many; 0: as the shape asks for
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
Result<BaseMesh> makeBaseMesh(const TriMesh& mesh, const BaseDomainOptions& options = {});

}  // namespace relievo
