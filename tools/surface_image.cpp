#include "tools/surface_image.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "geometry/bake/mip_image.h"
#include "geometry/bake/normal_map_fit.h"
#include "geometry/bake/vertex_normals.h"
#include "geometry/scan/mesh_read.h"
#include "src/artwork/shown_images.h"
#include "src/base/file.h"
#include "src/base/progress.h"
#include "src/base/srgb.h"
#include "texturing/codec/image_jpeg.h"
#include "texturing/import/image_io.h"
#include "texturing/import/ptm.h"
#include "texturing/package/file_provenance.h"
#include "tools/build_run.h"
#include "tools/commands.h"

namespace relievo {
namespace {

// Of its own, not those that name materials' colours.
bool hasTextureCoordinates(const TriMesh& mesh) {
  return !mesh.corner_uv.empty() &&
         std::none_of(mesh.images.begin(), mesh.images.end(), [](const MeshImage& i) { return !i.palette.empty(); });
}

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

Image8 paletteImage(const std::vector<glm::u8vec3>& palette) {
  const size_t columns = std::min(palette.size(), kPaletteColumns), rows = palette.size() / columns;
  Image8 image{static_cast<int>(columns), static_cast<int>(rows), 3, {}};
  for (const glm::u8vec3& c : palette) image.pixels.insert(image.pixels.end(), {c.r, c.g, c.b});
  return image;
}

void toThreeChannels(Image8& image) {
  if (image.channels == 3) return;
  const size_t channels = static_cast<size_t>(image.channels), pixels = image.pixels.size() / channels;
  std::vector<uint8_t> rgb(pixels * 3);
  for (size_t i = 0; i < pixels; ++i)
    for (size_t c = 0; c < 3; ++c) rgb[3 * i + c] = image.pixels[i * channels + (channels >= 3 ? c : 0)];
  image = {image.width, image.height, 3, std::move(rgb)};
}

// True: it is another one now.
bool multiply(Image8& image, const glm::vec3& tint) {
  if (tint == glm::vec3(1)) return false;
  std::array<std::array<uint8_t, 256>, 3> tinted;
  for (size_t c = 0; c < 3; ++c)
    for (size_t v = 0; v < 256; ++v) {
      const double linear = linearFromSrgb(static_cast<double>(v) / 255) * tint[static_cast<int>(c)];
      tinted[c][v] = static_cast<uint8_t>(std::clamp(255 * srgbFromLinear(std::max(linear, 0.0)) + 0.5, 0.0, 255.0));
    }
  for (size_t i = 0; i < image.pixels.size(); ++i) image.pixels[i] = tinted[i % 3][image.pixels[i]];
  return true;
}

// An image, and the JPEG that it came as, if it is one that patches may show as it is; its texels are then the image's.
struct ImageAndJpeg {
  Image8 image;
  std::vector<uint8_t> jpeg;
};

// The file's bytes, if it is a JPEG of no unusual size; none: the reader of image files is to look at it.
std::vector<uint8_t> jpegFileBytes(const std::string& path) {
  constexpr uint64_t kMostBytes = uint64_t{256} << 20;
  auto file = InputFile::open(path);
  std::array<uint8_t, 2> first{};
  if (!file || file->size() > kMostBytes || file->size() < first.size() || !file->read(0, first) ||
      first != std::array<uint8_t, 2>{0xFF, 0xD8})
    return {};
  std::vector<uint8_t> bytes(file->size());
  return file->read(0, bytes) ? bytes : std::vector<uint8_t>();
}

// One of the usual kinds of JPEG, without the libraries of all other formats. Nothing: those are to look at it, and to
// say what is wrong.
std::optional<ImageAndJpeg> readJpeg(std::span<const uint8_t> bytes, const ImageReadOptions& options) {
  std::vector<uint8_t> jpeg = plainJpeg(bytes);
  const std::optional<JpegSize> size = sizeOfPlainJpeg(jpeg);
  if (!size || size->width < 1 || size->height < 1) return std::nullopt;
  const uint64_t texels = uint64_t{size->width} * size->height;
  if (3 * texels > options.decodedLimit() || 3 * texels / options.max_packing > bytes.size()) return std::nullopt;
  auto reader = ImageJpegReader::open(jpeg, size->width, size->height);
  if (!reader) return std::nullopt;
  Image8 image{static_cast<int>(size->width), static_cast<int>(size->height), 3, {}};
  image.pixels.resize(3 * texels);
  if (!reader->read(size->height, image.pixels)) return std::nullopt;
  if (texels > kMostShownTexels) jpeg = {};
  return ImageAndJpeg{std::move(image), std::move(jpeg)};
}

// An image file, or the one in a mesh's file.
Result<ImageAndJpeg> readImageOrJpeg(const MeshBuildArguments& a, const ImageFile& file) {
  const std::vector<uint8_t> read = file.bytes ? std::vector<uint8_t>() : jpegFileBytes(file.path);
  if (auto jpeg = readJpeg(file.bytes ? *file.bytes : read, a.images)) return std::move(*jpeg);
  auto image = file.bytes ? readInnerImage(a, *file.bytes) : readImage8(file.path, a.images);
  if (!image) return image.error();
  return ImageAndJpeg{std::move(*image), {}};
}

// Most texels of a map of normals are one of length 1 that points outwards; a map of heights is grey.
bool hasNormals(const Image8& image) {
  constexpr size_t kLooks = 4096;
  constexpr double kShare = 0.9, kOff = 0.35;
  const size_t pixels = image.pixels.size() / 3, step = std::max<size_t>(pixels / kLooks, 1) | 1;
  size_t looked = 0, normals = 0;
  for (size_t i = 0; i < pixels; i += step, ++looked) {
    glm::dvec3 n;
    for (int c = 0; c < 3; ++c) n[c] = image.pixels[3 * i + static_cast<size_t>(c)] / 127.5 - 1;
    normals += n.z > 0 && std::abs(glm::length(n) - 1) < kOff;
  }
  return static_cast<double>(normals) >= kShare * static_cast<double>(looked);
}

// As NormalMap::scale says. True: it is another one now.
bool scaleNormals(Image8& image, float scale) {
  if (scale == 1 || !std::isfinite(scale)) return false;
  for (size_t i = 0; i < image.pixels.size(); i += 3) {
    glm::dvec3 n;
    for (int c = 0; c < 3; ++c) n[c] = (image.pixels[i + static_cast<size_t>(c)] / 127.5 - 1) * (c < 2 ? scale : 1);
    const double length = glm::length(n);
    for (int c = 0; c < 3 && length > 0; ++c)
      image.pixels[i + static_cast<size_t>(c)] =
          static_cast<uint8_t>(std::clamp(127.5 * (n[c] / length) + 128, 0.0, 255.0));
  }
  return true;
}

void halve(Image8& image) {
  image = {(image.width + 1) / 2, (image.height + 1) / 2, image.channels,
           halvedTexels(image.width, image.height, image.channels, image.pixels)};
}

// The images that the scan's texture coordinates belong to, as three channels.
class TextureReader {
 public:
  TextureReader(const MeshBuildArguments& a, TriMesh& mesh) : a_(a), mesh_(mesh) {}

  Result<SurfaceImage> read() {
    if (!a_.texture.empty() && a_.texture != "none") {
      if (!hasTextureCoordinates(mesh_))
        return Error{ErrorKind::kUsage,
                     a_.mesh,
                     "--texture needs texture coordinates, found none in the mesh",
                     "leave --texture out: colours of vertices or materials are used",
                     {}};
      const MeshImage named{.file = {a_.texture, {}}, .repeats = mesh_.texture_repeats};
      auto image = readImageOrJpeg(a_, named.file);
      if (!image) return image.error();
      add(std::move(*image), named);
    } else if (a_.texture.empty()) {
      for (const MeshImage& image : mesh_.images) {
        if (interruptedFlag()) return Error{ErrorKind::kInterrupted, a_.mesh, "interrupted", "", {}};
        if (auto done = addOwn(image); !done) return done.error();
      }
    }
    if (missing_ > 0 && read_ == 0) return first_missing_;
    if (out_.images.empty()) {
      // No triangle shows any image from here on, or all show one of one texel.
      mesh_.corner_uv = {}, mesh_.image_of = {}, mesh_.images = {};
      if (const auto colour = oneColour()) add({paletteImage({*colour}), {}}, {.palette = {*colour}});
    }
    shrinkNormals();
    finishImages();
    warnOfWhatIsLost();
    return std::move(out_);
  }

 private:
  void finishImages() {
    for (size_t k = 0; k < out_.pixels.size(); ++k) {
      MeshBake::Image& image = out_.images[k];
      Image8& normals = out_.normal_pixels[k];
      image.width = out_.pixels[k].width;
      image.height = out_.pixels[k].height;
      image.texels = out_.pixels[k].pixels;
      image.normals_width = normals.width;
      image.normals_height = normals.height;
      image.normals = normals.pixels;
      if (!image.normals.empty()) {
        const NormalMapFit fit = fitOf(k, image);
        image.normals_downwards = fit == NormalMapFit::kDownwards;
        if (fit == NormalMapFit::kNone) {
          leaveOut("expected normals in tangent space, found some that point into the surface",
                   mesh_.images[k].normals.file);
          normals = {};
          image.normals_width = image.normals_height = 0;
          image.normals = {};
        }
      }
      image.has_file = !out_.jpegs[k].empty() && (normals.pixels.empty() || !out_.normal_jpegs[k].empty());
    }
    keepNormalsOfMaps();
  }
  // The mesh's own normals are there for maps of normals alone.
  void keepNormalsOfMaps() {
    const auto hasMap = [](const MeshBake::Image& image) { return !image.normals.empty(); };
    if (std::none_of(out_.images.begin(), out_.images.end(), hasMap)) mesh_.corner_normals = {};
    for (size_t t = 0; t < mesh_.corner_normals.size(); ++t) {
      const size_t image = mesh_.image_of.empty() ? 0 : mesh_.image_of[t];
      if (image >= out_.images.size() || !hasMap(out_.images[image])) mesh_.corner_normals[t] = {};
    }
  }

  Result<void> addOwn(const MeshImage& own) {
    if (!own.palette.empty()) {
      add({paletteImage(own.palette), {}}, own);
      return {};
    }
    if (!own.file.isThere()) {
      addPlain(own);
      return {};
    }
    if (auto beside = checkBeside(own.file); !beside) return beside;
    auto image = readImageOrJpeg(a_, own.file);
    if (image.ok()) {
      ++read_;
      add(std::move(*image), own);
      return {};
    }
    Error error = image.error();
    error.hint = "the mesh shows it; --texture FILE names another, --texture none builds without";
    std::error_code unknown;
    if (own.file.bytes || std::filesystem::exists(own.file.path, unknown)) return error;
    if (++missing_ == 1) first_missing_ = error;
    add({paletteImage({kMissing}), {}}, {.palette = {kMissing}});
    return {};
  }

  // The colour of a material without an image. One grey for all is none, as of scans without any colour.
  void addPlain(MeshImage own) {
    const auto isAlike = [&](const MeshImage& other) {
      return !other.file.isThere() && other.palette.empty() && other.tint == own.tint;
    };
    const bool grey = own.tint.r == own.tint.g && own.tint.g == own.tint.b;
    const bool none = grey && std::all_of(mesh_.images.begin(), mesh_.images.end(), isAlike) &&
                      std::find(mesh_.image_of.begin(), mesh_.image_of.end(), kNoImage) == mesh_.image_of.end();
    if (none) own.tint = glm::vec3(1);
    add({paletteImage({glm::u8vec3(none ? kPlainGrey : uint8_t{255})}), {}}, own);
  }

  // Of a scan without images: of all vertices.
  std::optional<glm::u8vec3> oneColour() const {
    const auto& colours = mesh_.colours;
    if (colours.empty()) return glm::u8vec3(kPlainGrey);
    const bool one = std::all_of(colours.begin(), colours.end(), [&](const auto& c) { return c == colours[0]; });
    return one ? std::optional(colours[0]) : std::nullopt;
  }

  Result<void> checkBeside(const ImageFile& file) const {
    return file.bytes || a_.allow_outside ? Result<void>() : checkBesideMesh(a_.mesh, file.path, "the image");
  }
  void addSource(const ImageFile& file) {
    if (!file.path.empty() && paths_.insert(file.path).second)
      out_.sources.push_back(FileProvenance(file.path, true).get());
  }

  // The limit holds for all together: each is made as much smaller as the others.
  void add(ImageAndJpeg read, const MeshImage& own) {
    auto& [image, jpeg] = read;
    const bool palette = !own.palette.empty();
    if (image.channels == 2 || image.channels == 4)
      if (++with_alpha_ == 1) first_with_alpha_ = own.file.path.empty() ? a_.mesh : own.file.path;
    toThreeChannels(image);
    if (multiply(image, own.tint)) jpeg = {};
    for (int k = 0; k < halvings_ && !palette; ++k) halve(image), jpeg = {};
    out_.images.push_back({.repeats = own.repeats, .palette = palette});
    out_.jpegs.push_back(std::move(jpeg));
    out_.pixels.push_back(std::move(image));
    out_.normal_pixels.emplace_back();
    out_.normal_jpegs.emplace_back();
    addSource(own.file);
    if (!palette && own.normals.file.isThere()) addNormals(own.normals);
    const uint64_t most = std::max(a_.package.memory_budget_bytes / 3, a_.images.decodedLimit());
    if (bytes() > most) shrinkNormals();
    while (read_ + with_normals_ > 1 && bytes() > most && halvings_ < kMostHalvings) {
      ++halvings_;
      for (size_t i = 0; i < out_.pixels.size(); ++i) {
        if (!out_.images[i].palette) halve(out_.pixels[i]), out_.jpegs[i].clear();
        halveNormals(i);
      }
    }
  }
  uint64_t bytes() const {
    uint64_t sum = 0;
    for (const auto* images : {&out_.pixels, &out_.normal_pixels})
      for (const Image8& image : *images) sum += image.pixels.size();
    return sum;
  }

  NormalMapFit fitOf(size_t k, const MeshBake::Image& image) {
    if (vertex_normals_.empty()) makeVertexNormals(mesh_, a_.package.workers, &interruptedFlag(), vertex_normals_);
    return normalMapFit(mesh_, static_cast<uint16_t>(k), image, mesh_.images[k].normals.y, vertex_normals_);
  }

  // Of the last image.
  void addNormals(const NormalMap& map) {
    if (auto beside = checkBeside(map.file); !beside) {
      leaveOut(beside.error().message, map.file);
      return;
    }
    auto read = readImageOrJpeg(a_, map.file);
    if (!read) {
      leaveOut(read.error().message, map.file);
      return;
    }
    auto& [image, jpeg] = *read;
    toThreeChannels(image);
    if (map.may_be_bumps && !hasNormals(image)) {
      leaveOut("expected normals in tangent space, found a map of another kind", map.file);
      return;
    }
    if (!scaleNormals(image, map.scale)) out_.normal_jpegs.back() = std::move(jpeg);
    out_.normal_pixels.back() = std::move(image);
    ++with_normals_;
    addSource(map.file);
    for (int k = 0; k < halvings_; ++k) halveNormals(out_.images.size() - 1);
  }
  void leaveOut(const std::string& why, const ImageFile& map) {
    if (++left_out_ == 1) first_left_out_ = (map.path.empty() ? a_.mesh + ", the image in it" : map.path) + ": " + why;
  }
  void halveNormals(size_t i) {
    if (out_.normal_pixels[i].pixels.empty()) return;
    halve(out_.normal_pixels[i]);
    out_.normal_jpegs[i].clear();
  }
  // So far that patches can show all of them together; not where the images alone are too large for that.
  void shrinkNormals() {
    const auto texels = [](const std::vector<Image8>& images) {
      uint64_t sum = 0;
      for (const Image8& image : images) sum += image.pixels.size() / 3;
      return sum;
    };
    const uint64_t of_images = texels(out_.pixels);
    while (of_images <= kMostShownTexels && of_images + texels(out_.normal_pixels) > kMostShownTexels) {
      const auto largest =
          std::max_element(out_.normal_pixels.begin(), out_.normal_pixels.end(),
                           [](const Image8& a, const Image8& b) { return a.pixels.size() < b.pixels.size(); });
      if (largest->pixels.size() <= 3) return;
      halveNormals(static_cast<size_t>(largest - out_.normal_pixels.begin()));
      normals_are_smaller_ = true;
    }
  }

  void warnOfWhatIsLost() const {
    const auto further = [](size_t n) { return n > 1 ? " (and " + std::to_string(n - 1) + " more)" : std::string(); };
    if (with_alpha_ > 0) warn(alphaWarning(first_with_alpha_ + further(with_alpha_)));
    if (missing_ > 0)
      warn(first_missing_.file + further(missing_) +
           ": not found; what shows it is grey (--texture none builds without images)");
    if (left_out_ > 0) warn(first_left_out_ + further(left_out_) + "; its normals are not used");
    if (normals_are_smaller_)
      warn(a_.mesh + ": its maps of normals are made smaller; images may have " +
           std::to_string(kMostShownTexels >> 20) + " Mi texels together");
    if (halvings_ > 0)
      warn(a_.mesh + ": its " + std::to_string(read_ + with_normals_) + " images are read at 1/" +
           std::to_string(1 << halvings_) + " of their width and height; more --memory-mib keeps more of them");
  }

  static constexpr glm::u8vec3 kMissing{204, 204, 204};
  static constexpr int kMostHalvings = 15;  // an image's side has fewer bits
  const MeshBuildArguments& a_;
  TriMesh& mesh_;
  SurfaceImage out_;
  std::set<std::string> paths_;
  size_t read_ = 0, missing_ = 0, with_alpha_ = 0, with_normals_ = 0, left_out_ = 0;
  Error first_missing_;
  std::string first_with_alpha_, first_left_out_;
  int halvings_ = 0;
  bool normals_are_smaller_ = false;
  std::vector<glm::vec3> vertex_normals_;
};

// The coordinates belong to the image that the mesh names: a PTM of other proportions was taken otherwise.
Result<void> checkProportions(const MeshBuildArguments& a, const TriMesh& mesh, int64_t width, int64_t height) {
  if (a.texture == "none" || mesh.images.empty()) return {};
  const std::string& path = mesh.images[0].file.path;
  if (mesh.images.size() > 1)
    return Error{ErrorKind::kInvalidData,
                 a.ptm,
                 "expected a mesh that shows one image, found " + std::to_string(mesh.images.size()),
                 "--texture none: the texture coordinates are the PTM's all the same",
                 {}};
  if (path.empty()) return {};
  if (!a.allow_outside)
    if (auto beside = checkBesideMesh(a.mesh, path, "the image"); !beside) return beside;
  ImageReadOptions as_stored = a.images;
  as_stored.orient = false;
  auto named = openColourImage(path, as_stored);
  if (!named) return {};
  const double ratio = static_cast<double>(width) / static_cast<double>(height) *
                       static_cast<double>((*named)->height()) / static_cast<double>((*named)->width());
  if (ratio > 0.99 && ratio < 1.01) return {};
  auto size = [](int64_t w, int64_t h) { return std::to_string(w) + " x " + std::to_string(h); };
  return Error{ErrorKind::kInvalidData,
               a.ptm,
               "expected the proportions of the mesh's image " + path + ", " +
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
  SurfaceImage out{.format = ptm.format(), .sources = {ptm.provenance()}};
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
  Image8 image{static_cast<int>(ptm.width()), static_cast<int>(ptm.height()), channels, {}};
  const auto width = static_cast<size_t>(ptm.width()), planes = static_cast<size_t>(channels);
  image.pixels.resize(width * static_cast<size_t>(ptm.height()) * planes);
  constexpr int64_t kRows = 64;
  std::vector<uint8_t> band;
  for (int64_t y = 0; y < ptm.height(); y += kRows) {
    if (interruptedFlag()) break;
    const Rect rect{0, y, ptm.width(), std::min(kRows, ptm.height() - y)};
    const size_t texels = width * static_cast<size_t>(rect.height);
    band.resize(texels * planes);
    if (auto read = ptm.read(rect, band); !read) return read.error();
    uint8_t* to = image.pixels.data() + static_cast<size_t>(y) * width * planes;
    for (size_t c = 0; c < planes; ++c)
      for (size_t i = 0; i < texels; ++i) to[i * planes + c] = band[c * texels + i];
  }
  out.pixels.push_back(std::move(image));
  const Image8& kept = out.pixels[0];
  out.images.push_back(
      {kept.width, kept.height, kept.pixels, channels, /*planes=*/true, /*repeats=*/mesh.texture_repeats});
  return out;
}

}  // namespace

Result<SurfaceImage> readSurfaceImage(const MeshBuildArguments& a, TriMesh& mesh) {
  if (a.ptm.empty()) return TextureReader(a, mesh).read();
  mesh.corner_normals = {};
  return readPtmPlanes(a, mesh);
}

}  // namespace relievo
