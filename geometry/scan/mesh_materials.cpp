#include "geometry/scan/mesh_materials.h"

#include <algorithm>
#include <numeric>
#include <utility>
#include <vector>

namespace relievo::mesh_file {
namespace {

constexpr size_t kMostImages = 4096;  // what shows further ones has its material's colour

size_t endOf(const RawMesh& mesh, std::span<const MaterialRun> runs, size_t i) {
  return i + 1 < runs.size() ? runs[i + 1].first : mesh.triangles.size();
}

// Images in the order of how many triangles show them; those that none shows are dropped.
void orderImages(RawMesh& mesh, std::vector<MaterialRun>& runs) {
  std::vector<uint64_t> shown(mesh.images.size(), 0);
  for (size_t i = 0; i < runs.size(); ++i)
    if (runs[i].image != kNoImage) shown[runs[i].image] += endOf(mesh, runs, i) - runs[i].first;
  std::vector<uint16_t> order(shown.size()), place(shown.size(), kNoImage);
  std::iota(order.begin(), order.end(), uint16_t{0});
  std::stable_sort(order.begin(), order.end(), [&](uint16_t a, uint16_t b) { return shown[a] > shown[b]; });
  std::vector<MeshImage> images;
  for (const uint16_t k : order) {
    if (shown[k] == 0) continue;
    place[k] = static_cast<uint16_t>(images.size());
    images.push_back(std::move(mesh.images[k]));
  }
  mesh.images = std::move(images);
  for (MaterialRun& run : runs)
    if (run.image != kNoImage) run.image = place[run.image];
}

// Is there more than one colour, or one that is no grey?
bool isColourful(std::span<const MaterialRun> runs) {
  return std::any_of(runs.begin(), runs.end(), [&](const MaterialRun& run) {
    const glm::u8vec3& c = run.colour;
    return c.r != c.g || c.g != c.b || c != runs[0].colour;
  });
}

}  // namespace

uint16_t addImage(RawMesh& mesh, MeshImage image) {
  if (mesh.images.size() >= kMostImages) return kNoImage;
  mesh.images.push_back(std::move(image));
  return static_cast<uint16_t>(mesh.images.size() - 1);
}

uint16_t shareImage(RawMesh& mesh, MeshImage image) {
  if (!image.file.isThere() && !image.normals.file.isThere()) return kNoImage;
  const auto same = std::find(mesh.images.begin(), mesh.images.end(), image);
  return same != mesh.images.end() ? static_cast<uint16_t>(same - mesh.images.begin())
                                   : addImage(mesh, std::move(image));
}

void useMaterials(RawMesh& mesh, std::span<const MaterialRun> of_file, const MeshReadOptions& options) {
  std::vector<MaterialRun> runs(of_file.begin(), of_file.end());
  if (mesh.corner_uv.empty() && !mesh.images.empty()) {
    for (MaterialRun& run : runs) run.image = kNoImage;
    const auto named = std::find_if(mesh.images.begin(), mesh.images.end(),
                                    [](const MeshImage& image) { return !image.file.path.empty(); });
    if (named != mesh.images.end())
      mesh.findings.push_back(
          {"images without texture coordinates (" + named->file.path + ")", mesh.images.size(), {}, "not used"});
  }
  orderImages(mesh, runs);
  const auto has_image = [](const MaterialRun& run) { return run.image != kNoImage; };
  if (options.other_image || (std::all_of(runs.begin(), runs.end(), has_image) && mesh.images.size() < 2)) return;
  if (!mesh.images.empty()) {
    mesh.image_of.assign(mesh.triangles.size(), kNoImage);
    for (size_t i = 0; i < runs.size(); ++i)
      std::fill(mesh.image_of.begin() + static_cast<std::ptrdiff_t>(runs[i].first),
                mesh.image_of.begin() + static_cast<std::ptrdiff_t>(endOf(mesh, runs, i)), runs[i].image);
    if (std::all_of(runs.begin(), runs.end(), has_image)) return;
  }
  if (!mesh.colours.empty() || !mesh.float_colours.empty() || (mesh.images.empty() && !isColourful(runs))) return;
  mesh.face_colours.assign(mesh.triangles.size(), kPlainColour);
  for (size_t i = 0; i < runs.size(); ++i)
    std::fill(mesh.face_colours.begin() + static_cast<std::ptrdiff_t>(runs[i].first),
              mesh.face_colours.begin() + static_cast<std::ptrdiff_t>(endOf(mesh, runs, i)), runs[i].colour);
}

void paintFaces(RawMesh& mesh) {
  mesh.face_colours.resize(mesh.triangles.size(), kPlainColour);
  const auto isPainted = [&](size_t t) { return mesh.image_of.empty() || mesh.image_of[t] == kNoImage; };
  auto numberOf = [](const glm::u8vec3& c) { return uint32_t{c.r} << 16 | uint32_t{c.g} << 8 | c.b; };
  std::vector<uint32_t> colours;
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    if (isPainted(t)) colours.push_back(numberOf(mesh.face_colours[t]));
  std::sort(colours.begin(), colours.end());
  colours.erase(std::unique(colours.begin(), colours.end()), colours.end());
  const size_t columns = std::min(colours.size(), kPaletteColumns),
               rows = (colours.size() + kPaletteColumns - 1) / kPaletteColumns;
  MeshImage image;
  for (const uint32_t c : colours)
    image.palette.emplace_back(static_cast<uint8_t>(c >> 16), static_cast<uint8_t>(c >> 8), static_cast<uint8_t>(c));
  image.palette.resize(columns * rows, glm::u8vec3(0));
  const auto number = static_cast<uint16_t>(mesh.images.size());
  mesh.images.push_back(std::move(image));
  mesh.corner_uv.resize(mesh.triangles.size());
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (!isPainted(t)) continue;
    const auto at = static_cast<size_t>(
        std::lower_bound(colours.begin(), colours.end(), numberOf(mesh.face_colours[t])) - colours.begin());
    const double u = (static_cast<double>(at % kPaletteColumns) + 0.5) / static_cast<double>(columns),
                 v = 1 - (static_cast<double>(at / kPaletteColumns) + 0.5) / static_cast<double>(rows);
    mesh.corner_uv[t].fill(glm::vec2(u, v));
    if (!mesh.image_of.empty()) mesh.image_of[t] = number;
  }
  std::vector<glm::u8vec3>().swap(mesh.face_colours);
}

void noteNormalMaps(RawMesh& mesh, uint64_t materials) {
  if (materials > 0) mesh.findings.push_back({"maps of normals or bumps", materials, {}, "not used"});
}

}  // namespace relievo::mesh_file
