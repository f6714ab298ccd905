#include "geometry/bake/texture_resolution.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "geometry/bake/repeated_images.h"
#include "geometry/mesh/triangle_point.h"
#include "src/artwork/patch_domain.h"
#include "src/artwork/shown_images.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

constexpr uint64_t kMostTexels = uint64_t{64} << 20;  // of all patches, where colours are vertices'
// Where they are an image's; of one that is too large for that texels are left out.
constexpr uint64_t kMostImageTexels = uint64_t{128} << 20;
constexpr int kMostDepth = 5;  // a patch's texels are held in memory, but for those of images that it shows

// How many of the images' texels lie across a patch, along u or v, whichever are more: at most places, and at the
// densest one; and how many lie on it.
struct TexelsAcross {
  double most = 0, densest = 0, on_patch = 0;
  bool shown = false;    // some place shows an image
  bool creased = false;  // the places' triangles lie on both sides of a crease
};
// Normals further apart than those that patches of few triangles smooth over.
class CreaseFinder {
 public:
  explicit CreaseFinder(const BakeContext& context) : c_(context) {}
  void add(uint32_t triangle) {
    if (triangle == last_ || !c_.normals->isSplit(triangle)) return;
    last_ = triangle;
    for (const uint32_t corner : c_.normals->ofTriangle(*c_.mesh, triangle)) {
      const glm::vec3& n = c_.normals->normals[corner];
      if (first_ == glm::vec3(0)) first_ = n;
      found_ = found_ || glm::dot(first_, n) < kCosine;
    }
  }
  bool found() const { return found_; }

 private:
  static constexpr float kCosine = 0.9659f;  // 15 degrees
  const BakeContext& c_;
  uint32_t last_ = ~uint32_t{0};
  glm::vec3 first_{0};
  bool found_ = false;
};
TexelsAcross imageTexelsAcross(const BakeContext& context, const BakeTexture& texture, uint32_t patch) {
  constexpr size_t kPlaces = 5;  // a side
  constexpr double kMost = 0.9;  // few triangles, such as those beside an atlas's seam, may be stretched by far
  std::array<glm::dvec3, 4> p;
  for (size_t k = 0; k < 4; ++k) p[k] = context.cornerPoint(context.base.patches[patch][k]).position;
  std::array<double, kPlaces * kPlaces> across{};
  double on_patch = 0;
  bool shown = false;
  CreaseFinder creases(context);
  for (size_t i = 0; i < across.size(); ++i) {
    const double u = (static_cast<double>(i % kPlaces) + 0.5) / kPlaces,
                 v = (static_cast<double>(i / kPlaces) + 0.5) / kPlaces;
    const SurfacePoint at = context.pointAt(patch, u, v);
    creases.add(at.triangle);
    const BakeTexture::Image* image = texture.imageOf(*context.mesh, at.triangle);
    if (!image || image->palette) continue;
    shown = true;
    const glm::dvec2 size(image->places);
    const TriangleCorners t = cornersOf(*context.mesh, at.triangle);
    const auto& uv = context.mesh->corner_uv[at.triangle];
    const glm::dvec3 e = t.b - t.a, g = t.c - t.a;
    const glm::dvec2 texels_e = glm::dvec2(uv[1] - uv[0]) * size, texels_g = glm::dvec2(uv[2] - uv[0]) * size;
    const double ee = glm::dot(e, e), eg = glm::dot(e, g), gg = glm::dot(g, g), det = ee * gg - eg * eg;
    if (!(det > 1e-12 * ee * gg)) continue;
    auto texelsAlong = [&](const glm::dvec3& along) {
      const double a = glm::dot(along, e), b = glm::dot(along, g);
      return (a * gg - b * eg) / det * texels_e + (b * ee - a * eg) / det * texels_g;
    };
    // Of a patch that is cut, the same everywhere on a half.
    const double at_bottom = context.base.cut ? v > u : v, at_right = context.base.cut ? u >= v : u;
    const glm::dvec2 along_u = texelsAlong(glm::mix(p[1] - p[0], p[3] - p[2], at_bottom)),
                     along_v = texelsAlong(glm::mix(p[2] - p[0], p[3] - p[1], at_right));
    across[i] = std::max(glm::length(along_u), glm::length(along_v));
    on_patch += std::abs(along_u.x * along_v.y - along_u.y * along_v.x) / static_cast<double>(across.size());
  }
  std::sort(across.begin(), across.end());
  return {across[static_cast<size_t>(kMost * across.size())], across.back(), on_patch, shown, creases.found()};
}

// Is a patch smooth, and shows no image, but vertices' colours or one of the palette's? What a tail shows of it is all
// that there is.
bool isPlain(const BakeContext& context, const BakeTexture& texture, uint32_t patch) {
  constexpr size_t kPlaces = 8;  // a side
  CreaseFinder creases(context);
  glm::vec2 colour(-1);
  for (size_t i = 0; i < kPlaces * kPlaces; ++i) {
    const double u = (static_cast<double>(i % kPlaces) + 0.5) / kPlaces,
                 v = (static_cast<double>(i / kPlaces) + 0.5) / kPlaces;
    const uint32_t triangle = context.pointAt(patch, u, v).triangle;
    creases.add(triangle);
    const BakeTexture::Image* image = texture.imageOf(*context.mesh, triangle);
    if (image && !image->palette) return false;
    const glm::vec2 own = image ? texture.coordinates(*context.mesh, triangle)[0] : glm::vec2(-2);
    if (creases.found() || (i > 0 && own != colour)) return false;
    colour = own;
  }
  return true;
}

int log2Above(double value) { return value > 1 ? static_cast<int>(std::ceil(std::log2(std::min(value, 0x1p30)))) : 0; }

// At most `most`.
int depthFor(const TexelsAcross& image, bool tails, int most) {
  // A texel is at most so many of the image's long; but a patch has at most so many for each of the image's, where
  // these are stretched.
  constexpr double kLongest = 1.42, kMostForEach = 8;
  const double across = std::min(image.most / kLongest, std::sqrt(kMostForEach * image.on_patch));
  if (tails && !image.creased && across <= kTailTexels && image.densest <= 2 * kTailTexels) return kNoTexturePage;
  return std::clamp(log2Above(across) - kPageCellsLog2, 0, most);
}

// The patches that could show images themselves, and how deep they would be.
struct ShowingPatch {
  uint32_t patch;
  int8_t depth;
  std::array<uint16_t, 2> image;
};

// Is there a crease between a patch's halves, or a border between their colours? A tail blurs these over a 16th of the
// patch.
bool halvesDiffer(const ImagesOnPatch& on) {
  constexpr float kCosine = 0.9659f;  // of halves' normals: 15 degrees
  const auto colourDiffers = [&](size_t k) {
    constexpr float kSteps = 2;  // of 255
    return glm::distance(on.colour[0][k], on.colour[1][k]) > kSteps;
  };
  return on.image[0] != on.image[1] || on.uv[0][0] != on.uv[1][0] || colourDiffers(0) || colourDiffers(2) ||
         glm::dot(on.normal[0][0], on.normal[1][0]) < kCosine || glm::dot(on.normal[0][2], on.normal[1][2]) < kCosine;
}

// Images that are on the scan several times over, and those of many small triangles, which take a page each, take more
// texels as patches than they have; files that are kept take a fraction of an image's bytes. Those whose patches would
// take the most are shown, as far as readers hold them in memory. Palettes always are.
void chooseShownImages(const std::vector<ShowingPatch>& showing, BakeTexture& texture) {
  constexpr double kOfTexels = 2, kOfFile = 0.5;  // texels as patches, in times of the image's own
  std::vector<double> texels(texture.images.size());
  for (const ShowingPatch& s : showing)
    for (const uint16_t image : s.image) {
      if (image == kNoImage) continue;
      const auto side = static_cast<double>(texelsASide(s.depth));
      texels[image] += 0.5 * side * side;
    }
  std::vector<size_t> order;
  // Colours of whole triangles are shown as well where they share a patch with an image.
  auto isPalette = [&](size_t i) { return texture.images[i].palette; };
  auto texelsOf = [](const MipImage& image) {
    return image.empty() ? 0 : static_cast<double>(image.width()) * static_cast<double>(image.height());
  };
  // As a patch's texels have both, colour and normal.
  auto own = [&](size_t i) {
    return std::max(texelsOf(texture.images[i].texels), texelsOf(texture.images[i].normals));
  };
  auto inMemory = [&](size_t i) { return texelsOf(texture.images[i].texels) + texelsOf(texture.images[i].normals); };
  double held = 0;
  for (size_t i = 0; i < texels.size(); ++i) {
    const BakeTexture::Image& image = texture.images[i];
    if (isPalette(i)) held += own(i);
    else if (texels[i] >= (image.has_file ? kOfFile : kOfTexels) * own(i) &&
             std::max(image.places.x, image.places.y) <= static_cast<int>(kMostShownSide))
      order.push_back(i);
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return texels[a] * own(b) > texels[b] * own(a); });
  std::vector<uint8_t> may_be_shown(texels.size(), 0);
  for (const size_t i : order) {
    if (held + inMemory(i) > static_cast<double>(kMostShownTexels)) continue;
    held += inMemory(i);
    may_be_shown[i] = 1;
  }
  for (const ShowingPatch& s : showing) {
    auto isShown = [&](uint16_t image) { return image == kNoImage || may_be_shown[image] || isPalette(image); };
    if (!isShown(s.image[0]) || !isShown(s.image[1])) continue;
    for (const uint16_t image : s.image)
      if (image != kNoImage) texture.images[image].shown = true;
    texture.of_patch[s.patch].depth = kNoTexturePage;
    texture.of_patch[s.patch].shown_depth = s.depth;
  }
}

// A patch on both of whose halves triangles lie whose images can be shown, or that have colours of vertices. depth:
// that of images which are no palettes; nothing: none of them can be.
std::optional<ShowingPatch> showingPatch(const BakeContext& context, const BakeTexture& texture, uint32_t patch,
                                         std::optional<int> depth) {
  constexpr double kMostPlaces = kMostShownPlace / 512;  // texels, from an image's corner
  if (context.own_triangles.empty()) return std::nullopt;
  std::array<uint16_t, 2> images{};
  for (size_t half = 0; half < 2; ++half) {
    const uint32_t triangle = context.own_triangles[patch][half];
    if (triangle == SurfacePoint::kNone) return std::nullopt;
    const BakeTexture::Image* image = texture.imageOf(*context.mesh, triangle);
    const bool shown = image ? depth || image->palette : !context.mesh->colours.empty();
    if (!shown) return std::nullopt;
    images[half] = image ? static_cast<uint16_t>(image - texture.images.data()) : kNoImage;
  }
  const ImagesOnPatch on = imagesOnPatch(context, texture, patch);
  for (size_t half = 0; half < 2; ++half)
    for (const glm::dvec2& uv : on.uv[half]) {
      if (images[half] == kNoImage) break;
      const glm::dvec2 place = glm::abs(uv * glm::dvec2(texture.images[images[half]].places));
      if (!(place.x <= kMostPlaces && place.y <= kMostPlaces)) return std::nullopt;
    }
  return ShowingPatch{patch, static_cast<int8_t>(depth.value_or(halvesDiffer(on) ? 0 : kNoTexturePage)), images};
}

// No finer than that all patches together have so many texels.
int deepestOf(const std::vector<PatchResolution>& of_patch, uint64_t most_texels) {
  int depth = 0;
  for (const PatchResolution& r : of_patch) depth = std::max(depth, r.depth);
  for (; depth > 0; --depth) {
    uint64_t texels = 0;
    for (const PatchResolution& r : of_patch) {
      const uint64_t side = texelsASide(std::min(r.depth, depth));
      texels += side * side;
    }
    if (texels <= most_texels) break;
  }
  return depth;
}

// Of a triangle's vertices, 0 to 255; of a scan without any 0.
std::array<glm::dvec3, 3> coloursOf(const TriMesh& mesh, uint32_t triangle) {
  std::array<glm::dvec3, 3> out{};
  for (size_t k = 0; k < 3 && !mesh.colours.empty(); ++k)
    out[k] = glm::dvec3(mesh.colours[mesh.triangles[triangle][k]]);
  return out;
}

}  // namespace

ImagesOnPatch imagesOnPatch(const BakeContext& context, const BakeTexture& texture, uint32_t patch) {
  ImagesOnPatch on;
  for (size_t half = 0; half < 2; ++half) {
    const uint32_t triangle = context.own_triangles[patch][half];
    const BakeTexture::Image* image = texture.imageOf(*context.mesh, triangle);
    on.image[half] = image ? static_cast<uint16_t>(image - texture.images.data()) : kNoImage;
    const TriangleCorners t = cornersOf(*context.mesh, triangle);
    const auto uv = image ? texture.coordinates(*context.mesh, triangle) : std::array<glm::vec2, 3>{};
    const auto colours = coloursOf(*context.mesh, triangle);
    const std::array<glm::vec3, 3> normals = shadingNormals(*context.mesh, *context.normals, triangle);
    const glm::dvec3 e = t.b - t.a, g = t.c - t.a;
    const double ee = glm::dot(e, e), eg = glm::dot(e, g), gg = glm::dot(g, g), det = ee * gg - eg * eg;
    const std::array<glm::dvec3, 3> corners = context.cornersOfHalf(patch, half);
    for (size_t k = 0; k < 3; ++k) {
      const glm::dvec3 p = corners[k] - t.a;  // within a rounding of the triangle's plane
      const double b = det > 0 ? (glm::dot(p, e) * gg - glm::dot(p, g) * eg) / det : 0,
                   c = det > 0 ? (glm::dot(p, g) * ee - glm::dot(p, e) * eg) / det : 0;
      on.uv[half][k] = glm::dvec2(uv[0]) + b * glm::dvec2(uv[1] - uv[0]) + c * glm::dvec2(uv[2] - uv[0]);
      if (!image) on.colour[half][k] = glm::vec3((1 - b - c) * colours[0] + b * colours[1] + c * colours[2]);
      const glm::dvec3 normal =
          (1 - b - c) * glm::dvec3(normals[0]) + b * glm::dvec3(normals[1]) + c * glm::dvec3(normals[2]);
      const bool any = glm::length(normal) > 1e-3;
      on.normal[half][k] = glm::vec3(glm::normalize(any ? normal : glm::cross(e, g)));
    }
  }
  return on;
}

bool chooseTextureResolution(const BakeContext& context, const TextureResolutionOptions& options,
                             BakeTexture& texture) {
  const int requested_depth = options.requested_depth;
  const double vertices = static_cast<double>(context.mesh->positions_mm.size()),
               patches = static_cast<double>(context.layout.patches);
  const auto is_palette = [](const BakeTexture::Image& image) { return image.palette; };
  const bool has_palette = !texture.one_colour && std::any_of(texture.images.begin(), texture.images.end(), is_palette),
             has_image = !std::all_of(texture.images.begin(), texture.images.end(), is_palette);
  // Vertex colours are linear over the scan's triangles, so that a grid somewhat finer than these captures them. If it
  // is hardly finer, creases show; half a million samples take a quarter of a second.
  const double grid_points = std::max(2 * vertices, std::min(16 * vertices, 524'288.0));
  auto gridOf = [&](double points) {
    int log2 = 1;
    while (log2 < kPageCellsLog2 + kMostDepth && std::ldexp(patches, 2 * log2) < points) ++log2;
    return log2;
  };
  // Of a palette no cell's corners show a triangle that lies between them.
  const int plain_grid_log2 = gridOf(grid_points), grid_log2 = has_palette ? gridOf(4 * grid_points) : plain_grid_log2;
  int depth = std::max(requested_depth, 0);
  if (requested_depth < 0) {
    // Texels are twice as dense along u and v as what they are sampled from.
    auto texels = [&](int of_depth) { return std::ldexp(patches, 2 * (kPageCellsLog2 + of_depth)); };
    while (texels(depth) < 4 * vertices && texels(depth + 1) < static_cast<double>(kMostTexels)) ++depth;
  }
  texture.of_patch.assign(context.layout.patches, {depth, grid_log2, has_palette && !has_image});
  texture.depth = depth;
  // Normals are sampled no more densely there than tails have texels.
  const bool tails = options.tails && !texture.planes && requested_depth < 0, shows = tails && options.show_images;
  const bool plain_tails = tails && depth == 0 && plain_grid_log2 <= kTailCellsLog2;
  auto makeTail = [&](uint32_t p) {
    if (plain_tails && isPlain(context, texture, p)) texture.of_patch[p].depth = kNoTexturePage;
  };
  auto showImages = [&] {
    std::vector<ShowingPatch> showing;
    for (uint32_t p = 0; p < texture.of_patch.size(); ++p) {
      const std::optional<int> depth_of_images = std::exchange(texture.of_patch[p].shown_depth, std::nullopt);
      if (const auto patch = showingPatch(context, texture, p, depth_of_images)) showing.push_back(*patch);
    }
    chooseShownImages(showing, texture);
  };
  if (has_image) {
    const bool whole = parallelFor(context.layout.patches, context.workers, context.interrupted, [&](size_t p) {
      const TexelsAcross across = imageTexelsAcross(context, texture, static_cast<uint32_t>(p));
      PatchResolution& r = texture.of_patch[p];
      r.plain = has_palette && !across.shown;
      const bool small = tails && grid_log2 <= kTailCellsLog2;
      if (requested_depth < 0 && across.shown) r.depth = depthFor(across, small, kMostDepth);
      if (shows && across.shown) r.shown_depth = depthFor(across, small, kMostShownDepth);
      if (!across.shown) makeTail(static_cast<uint32_t>(p));
      r.sample_grid_log2 = std::max(grid_log2, log2Above(across.densest));
    });
    if (!whole) return false;
    if (shows) showImages();
    if (requested_depth < 0) texture.depth = deepestOf(texture.of_patch, kMostImageTexels);
  } else {
    if (shows) showImages();
    const bool whole = parallelFor(context.layout.patches, context.workers, context.interrupted, [&](size_t p) {
      if (!texture.of_patch[p].shown_depth) makeTail(static_cast<uint32_t>(p));
    });
    if (!whole) return false;
  }
  int shown_depth = 0;
  for (PatchResolution& r : texture.of_patch) {
    r.depth = std::min(r.depth, texture.depth);
    r.sample_grid_log2 = std::min(r.sample_grid_log2, std::countr_zero(texelsASide(r.depth)));
    shown_depth = std::max(shown_depth, r.shown_depth.value_or(0));
  }
  texture.depth = std::max(texture.depth, shown_depth);
  return true;
}

}  // namespace relievo
