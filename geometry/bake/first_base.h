// first_base.h - how many patches a base mesh of a scan may have, what takes the place of a first base that can only
// miss the scan, and what is left where all others did. Pure.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "src/artwork/base_mesh.h"
#include "src/artwork/patch_domain.h"
#include "src/base/result.h"

namespace relievo {

// More patches take ever more: some two hundred bytes each in a package, and up to 4 KiB that stay resident. Those of a
// scan's own triangles take a tenth of these bytes, and show what nothing else does.
inline constexpr uint32_t kMostPatches = 4096, kFewFaces = 36'864, kManyFaces = 65'536, kManyShownFaces = 131'072,
                          kManyLightFaces = 262'144;
// Where all of that misses, as of scans of many small pieces: simplified triangles, and the scan's own.
inline constexpr uint32_t kMostSimplified = 131'072, kMostFaces = 262'144, kMostLightFaces = 1'048'576;

// Of a scan's triangles beside a crease: beyond it own triangles take fewer bytes than larger patches.
inline constexpr double kMostlyCreased = 0.5;

// What patches of the scan's own triangles have for texels: each has pages, as under a basis of light; those have that
// need them; or none, as they show images (MeshBake::imagesOn()), whose tails stay resident in up to 2 KiB; or as they
// show colours of triangles or vertices, and take some six bytes, and a tenth of that memory.
enum class FaceTexels : uint8_t { kEach, kSome, kShown, kNone };

// Beyond so many times the default tolerance other bases take ever fewer bytes.
inline constexpr double kMuchCoarser = 2;
// So many of them are fewer bytes than other bases that keep the tolerance; 0: others may be fewer. of_default: it, in
// times of the default one; with a larger one larger patches need fewer samples.
constexpr uint32_t mostLightFaces(FaceTexels texels, double of_default) {
  if (texels != FaceTexels::kShown && texels != FaceTexels::kNone) return 0;
  const double many = texels == FaceTexels::kShown ? kManyShownFaces : kManyLightFaces;
  return std::max(kMostPatches, static_cast<uint32_t>(many * std::min(1.0, kMuchCoarser / of_default)));
}
// And so many, exact and soon made as they are, before more than kMostPatches others.
constexpr uint32_t mostLightFacesAtLast(FaceTexels texels, double of_default) {
  return mostLightFaces(texels, of_default) > 0 && of_default <= kMuchCoarser ? kMostLightFaces : 0;
}
// Unless these have fewer samples than this for each vertex of the scan: of 20 scans and shapes of 10,000 to 86,000
// triangles own ones took 0.2 to 0.8 times the bytes above it, and 0.7 to 4.1 times below.
inline constexpr double kFewSamples = 8;
// Where vertices tell so much (vertexDetail()), in times of the RMS that is aimed at, no other base is tried. Of 24
// scans and shapes of 10,000 to 110,000 triangles 18 of 19 above it took fewer bytes as own triangles, or had become
// these in the end, and five of five below it took 1.4 to 4.1 times as many.
inline constexpr double kMuchDetail = 7;
// Where they tell less than so much, larger patches are tried as long as they help, even if the first ones miss: of two
// such shapes own triangles took 1.5 and 2 times the bytes.
inline constexpr double kSomeDetail = 4;

// So many patches of the scan's own triangles come before smaller ones where the first base missed: smaller patches of
// even size often take fewer bytes than more of them. creased: the share of triangles beside a crease, which larger
// patches need pages of normals for.
constexpr uint32_t mostFacesBeforeSmaller(double creased) { return creased >= kMostlyCreased ? 12'288 : kMostPatches; }

// So many patches of the scan's own triangles come before simplified ones, since they take about as many
// bytes as kMostPatches of these, a third of the time, and are exact. Where most lie beside creases, more triangles do.
// Of seven public scans that smaller patches missed, of 10,000 to 100,000 triangles, own triangles took 0.4 to 1.1
// times the bytes of simplified ones up to these numbers, and 1.5 and 1.6 times beyond. of_default: as above; with a
// larger tolerance simplified triangles are fewer.
constexpr uint32_t mostFacesFirst(double creased, double of_default, FaceTexels texels) {
  if (texels == FaceTexels::kEach) return mostFacesBeforeSmaller(creased);
  if (const uint32_t light = mostLightFaces(texels, of_default); light > 0) return light;
  const double most = creased >= kMostlyCreased ? kManyFaces : kFewFaces;
  return std::max(kMostPatches, static_cast<uint32_t>(most * std::min(1.0, kMuchCoarser / of_default)));
}

// So few of them are not even compared with others: they are the scan, at once, and take no more bytes. Where images
// have many texels a triangle these take most bytes, and fewest where patches show them, which own triangles can.
// of_images: texels of images that they may show, of a triangle in the mean.
constexpr uint32_t mostFacesAtOnce(FaceTexels texels, double of_images) {
  constexpr double kManyTexels = 128;
  if (texels == FaceTexels::kEach) return 0;
  return of_images >= kManyTexels ? kFewFaces : kMostPatches;
}

// Of the lattice that corners of base meshes are moved to before they are baked (onLattice()): packages need few bytes
// for them, and heights make up for it. The scan's own triangles have none, so that theirs is finer.
constexpr double finestBaseStep(double diagonal) { return diagonal / (kMostPositionSteps / 4); }
// target_rms: that is aimed at; all lengths in one unit.
constexpr double baseStepFor(double target_rms, double diagonal) {
  constexpr double kOfTarget = 0.2;  // hardly seen where heights are 0, too
  return std::max(kOfTarget * target_rms, finestBaseStep(diagonal));
}
constexpr double faceStepFor(double target_rms, double diagonal) {
  constexpr double kOfTarget = 0.03;  // by default no corner moves by a millionth of the diagonal
  return std::max(kOfTarget * target_rms, finestBaseStep(diagonal));
}

// Of a first base (BaseDomain::make()): a bake takes long and misses.
// - So many holes or pieces that they take more than twice the patches there may be: these are large where the shape
//   needs small ones.
// - So much area out of reach of its lines (BaseDomain::lostArea()): thin parts, and sheets behind one another. Of some
//   70 scans those that lost more missed the target by 22 to 2,100 times; those that lost less, and kept it with
//   smaller patches, lost 1.3 % at most.
// of_default: the target's tolerance, in times of the default one's. A larger one forgives more.
constexpr bool isHopeless(size_t first_patches, double lost_area, double of_default) {
  constexpr double kMostLost = 0.03;
  return first_patches > 2 * size_t{kMostPatches} || lost_area > kMostLost * std::max(of_default, 1.0);
}

// Tries the bases that may take its place, those of the fewest bytes first, until there is one: false if there is
// none. faces(max_patches): of the scan's own triangles (BaseDomain::faces()), first at most most_faces_first of them;
// simplified(): of simplified ones (simplifiedFaces()). Each answers whether there is such a base, or with an error,
// which is handed on.
template <class Faces, class Simplified>
Result<bool> replaceFirstBase(uint32_t most_faces_first, Faces faces, Simplified simplified) {
  Result<bool> replaced = faces(most_faces_first);
  if (replaced && !*replaced) replaced = simplified();
  if (replaced && !*replaced) replaced = faces(kManyFaces);
  return replaced;
}

// Of a scan of more triangles a bake takes many seconds, and more patches take few more of all bytes.
inline constexpr size_t kLargeScan = 2 * size_t{kManyLightFaces};
// At least so many patches the next base (BaseDomain::refine()) of such a scan has, where one of so many was missed,
// with heights of so many samples and at most 2^cells_log2 cells a patch's side: half as many again; where heights took
// several pages a patch, two for each page. A bust of 3.2 million triangles kept its target after one such base of
// 1,240 patches in 38 s; where patches were smaller near what was missed only, after four of 141 to 1,320 in 243 s.
constexpr uint32_t leastRefined(size_t triangles, size_t patches, uint64_t samples, int cells_log2) {
  if (triangles <= kLargeScan) return 0;
  const uint64_t pages = samples >> 2 * kPageCellsLog2;
  const uint64_t least = cells_log2 > kPageCellsLog2 ? 2 * pages : patches + patches / 2;
  return static_cast<uint32_t>(std::min<uint64_t>(least, kMostPatches));
}

// The next base where those of at most most_simplified simplified triangles, and of kManyFaces own ones, missed or were
// not possible; raises most_simplified to what it tried. First the scan's own, up to most_light
// (mostLightFacesAtLast()). Then four times as many simplified triangles at a time; the scan's own, which then take
// fewer bytes, after the first step. False: nothing is left. simplified(max_patches): as simplifiedFaces().
template <class Faces, class Simplified>
Result<bool> moreOf(uint32_t& most_simplified, uint32_t most_light, Faces faces, Simplified simplified) {
  Result<bool> done = false;
  if (most_light > 0 && most_simplified == kMostPatches) done = faces(most_light);
  while (done && !*done && most_simplified < kMostSimplified) {
    if (most_simplified > kMostPatches) done = faces(kMostFaces);
    most_simplified = std::min(4 * most_simplified, kMostSimplified);
    if (done && !*done) done = simplified(most_simplified);
  }
  return done;
}

}  // namespace relievo
