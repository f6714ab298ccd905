// scene_path.h - a scene's camera path as the views of relievo compare and accuracy: the cameras that view and render
// show at these times.
#pragma once

#include <string>
#include <vector>

#include "src/base/result.h"
#include "texturing/package/package.h"
#include "tools/compare/compare_path.h"

namespace relievo {

// Does the scene's file say how its camera moves?
Result<bool> hasCameraPath(const std::string& scene_file);
// `frames` moments at even distances, in the middle of as many parts of its duration. kUsage: there is no path, or the
// artwork has a pose, which these commands leave out.
Result<std::vector<CompareCamera>> scenePath(const std::string& scene_file, const Manifest& artwork, int frames,
                                             int width_px, int height_px);

}  // namespace relievo
