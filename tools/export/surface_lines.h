// surface_lines.h - lines on an artwork's surface: contours of a flat one's heights, and where planes cut a surface, as
// joined lines in mm. The surface is the triangles of a mesh of that level (mesh_export.h); a line's points lie on
// their edges. Lines are closed where they close; others end at the artwork's border.
//
// A vertex on a level counts as above it, so that every triangle has two crossed edges or none, and what is flat at a
// level has its upper rim as the line.
//
// Memory: about 160 bytes a point; more of them than memory_bytes allow are kUsage. Deterministic, one thread.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/result.h"
#include "texturing/package/package.h"

namespace relievo {

struct SurfaceLine {
  bool closed = false;  // the last point is followed by the first
  double level = 0;     // of contours: the height
  std::vector<glm::dvec3>
      points;  // as exported meshes have them: a scan's own coordinates, a flat one's from its centre
};

struct SurfaceLineOptions {
  std::optional<int> level;  // nothing: full detail
  uint64_t memory_bytes = uint64_t{768} << 20;
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
struct SurfaceLines {
  int level = 0;
  std::vector<SurfaceLine> lines;
};

// Of a flat artwork with relief: at all multiples of step_mm (above 0).
Result<SurfaceLines> contoursOf(std::shared_ptr<const Package> package, double step_mm,
                                const SurfaceLineOptions& options);
// Where dot(normal, p) = offset; the normal has any length but 0. Of any artwork with relief.
Result<SurfaceLines> planeCutOf(std::shared_ptr<const Package> package, const glm::dvec3& normal, double offset,
                                const SurfaceLineOptions& options);
// Of a flat artwork: the profile above the straight line from one place to another, in its direction. One line, or
// none where they miss the artwork.
Result<SurfaceLines> sectionOf(std::shared_ptr<const Package> package, const glm::dvec2& from, const glm::dvec2& to,
                               const SurfaceLineOptions& options);

}  // namespace relievo
