// mapped_sheet.h - a scan of few triangles with a map of the normals of what it was made from, all of it by formula:
// waves, on which there are finer ones that the triangles leave out.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "tests/geometry/mesh_files.h"

namespace relievo::test {

struct MappedSheet {
  static constexpr double kSide = 0.1;  // of the square from (0, 0), in the file's units
  Sample sample;                        // texture coordinates are (x, y) / kSide; with normals, without tangents
  int texels = 0;                       // a side of the map
  std::vector<uint8_t> map;             // RGB, rows from the top
  double fine = 1;                      // how steep the finer waves are
  glm::dvec3 trueNormal(double x, double y) const { return normalOf(x, y, fine); }
  static glm::dvec3 smoothNormal(double x, double y) { return normalOf(x, y, 0); }
  static double height(double x, double y) { return 0.004 * std::sin(70 * x) * std::cos(60 * y); }
  std::string ppm() const {
    const std::string side = std::to_string(texels);
    return "P6\n" + side + " " + side + "\n255\n" + std::string(map.begin(), map.end());
  }

 private:
  static glm::dvec3 normalOf(double x, double y, double fine) {
    double along = 0.28 * std::cos(70 * x) * std::cos(60 * y), across = -0.24 * std::sin(70 * x) * std::sin(60 * y);
    along += fine * 0.3 * std::cos(500 * x), across += fine * 0.2 * std::cos(430 * y + 200 * x);
    return glm::normalize(glm::dvec3(-along, -across, 1));
  }
};

// quads x quads of two triangles each. downwards: y counts so in the map. lean: how much of the waves' slopes the
// file's normals have; the map has the rest.
inline MappedSheet mappedSheet(int quads, int texels, bool downwards = false, double fine = 1, double lean = 1) {
  MappedSheet out;
  out.texels = texels;
  out.fine = fine;
  Sample& s = out.sample;
  const double step = MappedSheet::kSide / quads;
  const auto row = static_cast<uint32_t>(quads) + 1;
  std::vector<glm::dvec3> tangents;
  for (int j = 0; j <= quads; ++j)
    for (int i = 0; i <= quads; ++i) {
      const double x = i * step, y = j * step;
      s.positions.emplace_back(x, y, MappedSheet::height(x, y));
      const glm::dvec3 waves = MappedSheet::smoothNormal(x, y),
                       n = glm::normalize(glm::dvec3(lean * waves.x, lean * waves.y, waves.z));
      s.normals.emplace_back(n);
      tangents.push_back(glm::normalize(glm::dvec3(1, 0, 0) - n.x * n));
    }
  auto uvOf = [&](uint32_t v) { return glm::vec2(glm::dvec2(s.positions[v]) / MappedSheet::kSide); };
  for (uint32_t j = 0; j + 1 < row; ++j)
    for (uint32_t i = 0; i + 1 < row; ++i) {
      const uint32_t a = j * row + i;
      for (const auto& t : {std::array{a, a + 1, a + row + 1}, std::array{a, a + row + 1, a + row}}) {
        s.triangles.push_back(t);
        s.corner_uv.push_back({uvOf(t[0]), uvOf(t[1]), uvOf(t[2])});
      }
    }
  for (int y = 0; y < texels; ++y)
    for (int x = 0; x < texels; ++x) {
      const double u = (x + 0.5) / texels, v = 1 - (y + 0.5) / texels;
      const auto i = static_cast<uint32_t>(u * quads), j = static_cast<uint32_t>(v * quads);
      const double f = u * quads - i, g = v * quads - j;
      const uint32_t a = j * row + i;
      const std::array<uint32_t, 3> corners =
          g > f ? std::array{a, a + row + 1, a + row} : std::array{a, a + 1, a + row + 1};
      const std::array<double, 3> w = g > f ? std::array{1 - g, f, g - f} : std::array{1 - f, f - g, g};
      glm::dvec3 n(0), t(0), b(0);
      for (size_t k = 0; k < 3; ++k) {
        const glm::dvec3 normal(s.normals[corners[k]]);
        n += w[k] * normal;
        t += w[k] * tangents[corners[k]];
        b += w[k] * glm::cross(normal, tangents[corners[k]]);
      }
      const double at_x = u * MappedSheet::kSide, at_y = v * MappedSheet::kSide;
      const glm::dvec3 m = glm::normalize(glm::inverse(glm::dmat3(t, b, n)) * out.trueNormal(at_x, at_y));
      for (int c = 0; c < 3; ++c)
        out.map.push_back(static_cast<uint8_t>(std::lround(127.5 * (c == 1 && downwards ? -m[c] : m[c]) + 127.5)));
    }
  return out;
}

}  // namespace relievo::test
