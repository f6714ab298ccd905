#include "tools/surface_image.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include "geometry/scan/mesh_read.h"
#include "src/base/progress.h"
#include "texturing/import/image_io.h"
#include "texturing/import/ptm.h"
#include "texturing/package/file_provenance.h"
#include "tools/build_run.h"
#include "tools/commands.h"

namespace relievo {
namespace {

// Of its own, not those that name materials' colours.
bool hasTextureCoordinates(const TriMesh& mesh) { return !mesh.corner_uv.empty() && mesh.palette.empty(); }

// An image that lies inside the mesh's file, decoded by the reader of image files: from a file in memory, without a
// name in any folder.
Result<Image8> readInnerImage(const MeshBuildArguments& a, const std::vector<uint8_t>& bytes) {
  const std::string name = a.mesh + ", the image in it";
  const int fd = ::memfd_create("relievo-image", MFD_CLOEXEC);
  if (fd < 0)
    return Error{ErrorKind::kIo, name, "cannot be kept in memory: " + std::string(std::strerror(errno)), "", {}};
  const std::string path = "/proc/self/fd/" + std::to_string(fd);
  size_t written = 0;
  while (written < bytes.size()) {
    const ssize_t n = ::write(fd, bytes.data() + written, bytes.size() - written);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;
    written += static_cast<size_t>(n);
  }
  auto image = written == bytes.size()
                   ? readImage8(path, a.images)
                   : Result<Image8>(Error{ErrorKind::kIo, name, "cannot be kept in memory", "free some memory", {}});
  ::close(fd);
  if (image.ok()) return image;
  Error error = image.error();
  error.file = name;
  if (const size_t at = error.message.find(path); at != std::string::npos) error.message.replace(at, path.size(), "it");
  return error;
}

// The image that the scan's texture coordinates belong to, as three channels.
Result<Image8> readTexture(const MeshBuildArguments& a, const TriMesh& mesh) {
  if (a.texture == "none") return Image8{};
  if (!a.texture.empty() && !hasTextureCoordinates(mesh))
    return Error{ErrorKind::kUsage,
                 a.mesh,
                 "--texture needs texture coordinates, found none in the mesh",
                 "leave --texture out: colours of vertices or materials are used",
                 {}};
  const std::string path = a.texture.empty() ? mesh.texture_path : a.texture;
  if (path.empty() && !mesh.palette.empty()) {
    const size_t columns = std::min(mesh.palette.size(), kPaletteColumns), rows = mesh.palette.size() / columns;
    Image8 colours{static_cast<int>(columns), static_cast<int>(rows), 3, {}};
    for (const glm::u8vec3& c : mesh.palette) colours.pixels.insert(colours.pixels.end(), {c.r, c.g, c.b});
    return colours;
  }
  const bool inner = path.empty() && !mesh.texture_bytes.empty();
  if ((path.empty() && !inner) || mesh.corner_uv.empty()) return Image8{};
  if (!inner && a.texture.empty() && !a.allow_outside)
    if (auto beside = checkBesideMesh(a.mesh, path, "the image"); !beside) return beside.error();
  auto image = inner ? readInnerImage(a, mesh.texture_bytes) : readImage8(path, a.images);
  if (!image) {
    Error error = image.error();
    if (a.texture.empty())
      error.hint = "the mesh shows it; --texture FILE names another, --texture none builds without";
    return error;
  }
  if (image->channels == 2 || image->channels == 4) warn(alphaWarning(inner ? a.mesh : path));
  if (image->channels == 3) return image;
  Image8 rgb{image->width, image->height, 3, {}};
  const size_t channels = static_cast<size_t>(image->channels), pixels = image->pixels.size() / channels;
  rgb.pixels.resize(pixels * 3);
  for (size_t i = 0; i < pixels; ++i)
    for (size_t c = 0; c < 3; ++c) rgb.pixels[3 * i + c] = image->pixels[i * channels + (channels >= 3 ? c : 0)];
  return rgb;
}

// The coordinates belong to the image that the mesh names: a PTM of other proportions was taken otherwise.
Result<void> checkProportions(const MeshBuildArguments& a, const TriMesh& mesh, int64_t width, int64_t height) {
  if (a.texture == "none" || mesh.texture_path.empty()) return {};
  if (!a.allow_outside)
    if (auto beside = checkBesideMesh(a.mesh, mesh.texture_path, "the image"); !beside) return beside;
  ImageReadOptions as_stored = a.images;
  as_stored.orient = false;
  auto named = openColourImage(mesh.texture_path, as_stored);
  if (!named) return {};
  const double ratio = static_cast<double>(width) / static_cast<double>(height) *
                       static_cast<double>((*named)->height()) / static_cast<double>((*named)->width());
  if (ratio > 0.99 && ratio < 1.01) return {};
  auto size = [](int64_t w, int64_t h) { return std::to_string(w) + " x " + std::to_string(h); };
  return Error{ErrorKind::kInvalidData,
               a.ptm,
               "expected the proportions of the mesh's image " + mesh.texture_path + ", " +
                   size((*named)->width(), (*named)->height()) + ", found " + size(width, height),
               "--texture none: the texture coordinates are the PTM's all the same",
               {}};
}

Result<SurfaceImage> readPtmPlanes(const MeshBuildArguments& a, const TriMesh& mesh) {
  if (!hasTextureCoordinates(mesh))
    return Error{ErrorKind::kUsage,
                 a.mesh,
                 "--ptm needs texture coordinates, found none in the mesh",
                 "export the mesh with texture coordinates for the PTM's pixels, or leave --ptm out",
                 {}};
  auto opened = openPtm(a.ptm, {.memory_budget_bytes = a.package.memory_budget_bytes});
  if (!opened) return opened.error();
  const TextureSource& ptm = **opened;
  SurfaceImage out{{}, ptm.format(), ptm.provenance()};
  const int channels = out.format.channels();
  if (auto fits = checkProportions(a, mesh, ptm.width(), ptm.height()); !fits) return fits.error();
  // With its coarser levels.
  const double bytes = static_cast<double>(ptm.width()) * static_cast<double>(ptm.height()) * channels * 4 / 3;
  if (bytes > static_cast<double>(a.package.memory_budget_bytes))
    return Error{ErrorKind::kUsage,
                 a.ptm,
                 "its planes take " + std::to_string(static_cast<uint64_t>(bytes) >> 20) +
                     " MiB of memory, expected at most " + std::to_string(a.package.memory_budget_bytes >> 20),
                 "--memory-mib allows more",
                 {}};
  out.image = {static_cast<int>(ptm.width()), static_cast<int>(ptm.height()), channels, {}};
  const auto width = static_cast<size_t>(ptm.width()), planes = static_cast<size_t>(channels);
  out.image.pixels.resize(width * static_cast<size_t>(ptm.height()) * planes);
  constexpr int64_t kRows = 64;
  std::vector<uint8_t> band;
  for (int64_t y = 0; y < ptm.height(); y += kRows) {
    if (interruptedFlag()) break;
    const Rect rect{0, y, ptm.width(), std::min(kRows, ptm.height() - y)};
    const size_t texels = width * static_cast<size_t>(rect.height);
    band.resize(texels * planes);
    if (auto read = ptm.read(rect, band); !read) return read.error();
    uint8_t* to = out.image.pixels.data() + static_cast<size_t>(y) * width * planes;
    for (size_t c = 0; c < planes; ++c)
      for (size_t i = 0; i < texels; ++i) to[i * planes + c] = band[c * texels + i];
  }
  return out;
}

}  // namespace

Result<SurfaceImage> readSurfaceImage(const MeshBuildArguments& a, const TriMesh& mesh) {
  if (!a.ptm.empty()) return readPtmPlanes(a, mesh);
  auto image = readTexture(a, mesh);
  if (!image) return image.error();
  SurfaceImage out;
  out.image = std::move(*image);
  const bool inner = a.texture.empty() && mesh.texture_path.empty();  // in the mesh's own file, or of its colours
  if (out.image.width > 0 && !inner)
    out.source = FileProvenance(a.texture.empty() ? mesh.texture_path : a.texture, true).get();
  return out;
}

}  // namespace relievo
