// displacement_kinds.h - ways to displace the samples of a base mesh by three components, made from a bake's heights.
// For tools/bench/displacement_table.cpp. Units: mm, in the scan's coordinates. Components: those of DisplacedSamples.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/bake/fidelity.h"
#include "geometry/mesh/tri_mesh.h"
#include "src/artwork/base_mesh.h"
#include "tools/bench/displacement_planes.h"

namespace relievo {

// Of each sample 1 where a patch has it for which patches[patch] is 1.
std::vector<uint8_t> samplesOn(const DisplacedSamples& samples, std::span<const uint8_t> patches);

// The chosen samples lie where the scan is nearest to them.
std::vector<glm::dvec3> nearestComponents(const DisplacedSamples& samples, std::span<const glm::dvec3> components,
                                          std::span<const uint8_t> chosen, const ClosestSearch& scan);

// The chosen samples are moved step by step towards the places of the scan that lie nearest to their triangles, and to
// the scan's place nearest to each of them: so that the triangles come near the scan where no sample would by itself.
std::vector<glm::dvec3> fittedComponents(const DisplacedSamples& samples, std::span<const glm::dvec3> components,
                                         std::span<const uint8_t> chosen, const FidelityScan& scan);

// The samples on the open borders of the base lie where the scan's open border is nearest. moved: patches with such
// samples. The components as they are, if there is no border.
std::vector<glm::dvec3> borderComponents(const DisplacedSamples& samples, std::span<const glm::dvec3> components,
                                         size_t& moved);

// The base with the mean of the scan's normals around each corner, by area, within half of the mean length of the
// corner's sides: of triangles that face along the corner's normal.
BaseMesh withFittedDirections(const BaseMesh& base, const TriMesh& scan);

}  // namespace relievo
