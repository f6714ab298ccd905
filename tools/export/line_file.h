// line_file.h - lines on a surface as a file: SVG in mm, or CSV of points in mm. (Of a flat artwork of no known size
// all lengths are px.)
//
//   .svg  user units are mm, and so is the picture's size: it prints 1:1. A bar states the scale. Each line is a path;
//         lines of one height are a group with the attribute data-height
//   .csv  a head line, then a line for each point: number of the line, whether it is closed (the first point is not
//         repeated), and coordinates. What each kind has is in the head
#pragma once

#include <string>

#include <glm/glm.hpp>

#include "src/base/result.h"
#include "tools/export/surface_lines.h"

namespace relievo {

struct LineDrawing {
  enum class Kind { kContours, kSection, kPlane };
  Kind kind = Kind::kContours;
  std::string title;
  const char* unit = "mm";
  // Of contours the sheet is the whole artwork, this wide and high around 0; else the lines' own box.
  double width = 0, height = 0;
  glm::dvec3 from{0}, along{1, 0, 0};  // of a section: where distances count from, and their direction
  glm::dvec3 normal{0, 0, 1};          // of a plane: it is seen from that side
};
// kUsage: the name ends in neither .svg nor .csv.
Result<void> checkLineFile(const std::string& path);
Result<void> writeLines(const std::string& path, const LineDrawing& drawing, const SurfaceLines& lines);
// The axes of a plane's drawing: to the right and up, seen from the normal's side. Up is the direction in it nearest to
// y, of planes across y nearest to -z.
std::pair<glm::dvec3, glm::dvec3> planeAxes(const glm::dvec3& normal);

}  // namespace relievo
