// triangle_simplify.h - fewer triangles between some of the same vertices. meshoptimizer stays behind this file.
// Source: Garland, Heckbert 1997 (quadric error metrics), as meshoptimizer has it: edges collapse onto one of their
// vertices. Vertices of the same position, bit for bit, move together: what is closed stays closed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

// triangles: three indices into positions each. kept: a byte a vertex, or empty; other than 0: it stays where it is.
// At least target_triangles are left. Pure, any thread. About 150 bytes a vertex of memory while it works.
std::vector<uint32_t> simplifiedTriangles(std::span<const glm::vec3> positions, std::span<const uint8_t> kept,
                                          std::span<const uint32_t> triangles, size_t target_triangles);

}  // namespace relievo
