// scan_distance SCAN OTHER - how far two meshes lie apart, in dB: 20 log10(diagonal of SCAN / RMS), the larger RMS of
// both ways, over the same places as build's fidelity has on SCAN, and as many on OTHER. For tools/bench/scan_bytes.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "geometry/bake/fidelity.h"
#include "geometry/scan/mesh_read.h"
#include "src/base/standard_output.h"

using namespace relievo;

namespace {

double rmsBetween(const FidelityScan& from, const FidelityScan& to) {
  const glm::dvec3 shift = from.mesh().origin_mm - to.mesh().origin_mm;
  double squares = 0;
  size_t part = kNoPart;
  for (size_t i = 0; i < from.areaSamples(); ++i) {
    const double distance =
        to.search().distance(from.positions()[i] + shift, std::numeric_limits<double>::infinity(), part);
    squares += distance * distance;
  }
  return std::sqrt(squares / static_cast<double>(std::max<size_t>(from.areaSamples(), 1)));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return std::fprintf(stderr, "usage: scan_distance SCAN OTHER\n"), 1;
  auto a = readMesh(argv[1]), b = readMesh(argv[2]);
  for (const auto* mesh : {&a, &b})
    if (!*mesh) return std::fprintf(stderr, "%s\n", mesh->error().text().c_str()), 2;
  const FidelityScan scan(a->mesh, 0), other(b->mesh, 0);
  const double rms = std::max(rmsBetween(scan, other), rmsBetween(other, scan));
  printOutf("%.3f\n", rms > 0 ? std::min(20 * std::log10(scan.diagonalMm() / rms), 240.0) : 240.0);
  if (auto written = flushOut(); !written) return std::fprintf(stderr, "%s\n", written.error().text().c_str()), 2;
  return 0;
}
