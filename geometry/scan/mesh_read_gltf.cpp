// mesh_read_gltf.cpp - glTF 2.0 (Khronos 2021), .gltf and .glb: the triangles, strips and fans of all meshes that the
// scene's nodes place, in metres, with the images and colours of their materials, or the vertices' colours. Skins,
// morphs, animations and cameras are read over, and normals that no map of normals counts from.
//
// Memory follows the file: nodes that repeat a mesh may add vertices and triangles only up to one for every two bytes
// of the file and its buffers.
#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "geometry/scan/gltf_buffers.h"
#include "geometry/scan/gltf_document.h"
#include "geometry/scan/mesh_file.h"
#include "geometry/scan/mesh_materials.h"
#include "src/base/srgb.h"

namespace relievo::mesh_file {
namespace {

constexpr uint64_t kBytesOfTriangle = 2, kAlwaysTriangles = 1024;

std::array<uint8_t, 3> bytesOf(const glm::dvec3& linear) {
  std::array<uint8_t, 3> out{};
  for (glm::length_t c = 0; c < 3; ++c)
    out[static_cast<size_t>(c)] = byteOf(255 * srgbFromLinear(std::max(linear[c], 0.0)) + 0.5);
  return out;
}

class GltfReader {
 public:
  GltfReader(const InputFile& file, const MeshReadOptions& options, const GltfDocument& document,
             const GltfParts& parts)
      : file_(file), options_(options), doc_(document), buffers_(file, document, parts, options) {}

  Result<RawMesh> read() {
    mesh_.unit = "m";
    mesh_.named_files = buffers_.namedFiles();
    if (auto done = walk(); !done) return done.error();
    if (auto done = checkSize(); !done) return done.error();
    for (const Placed& placed : placed_)
      for (const GltfPrimitive& p : doc_.meshes[placed.mesh].primitives)
        if (auto done = add(p, placed); !done) return done.error();
    mesh_.vertices_read = mesh_.positions.size();
    if (!mesh_.corner_uv.empty()) mesh_.corner_uv.resize(mesh_.triangles.size());
    if (auto done = takeMaterials(); !done) return done.error();
    noteLeftOut();
    return std::move(mesh_);
  }

 private:
  struct Placed {
    uint32_t mesh;
    glm::dmat4 mesh_to_scene;
  };
  // What vertices follow from: primitives of a mesh often have the same, which are read once a node.
  struct Shared {
    const Placed* placed = nullptr;
    uint32_t positions = kNoIndex, colours = kNoIndex, code = kNoIndex;
    glm::dvec3 tint{1};
    bool operator==(const Shared&) const = default;
  };
  // The view of its compressed code, if it has one.
  static uint32_t codeOf(const GltfPrimitive& p) { return p.draco ? p.draco->view : kNoIndex; }
  Shared sharedOf(const GltfPrimitive& p, const Placed& placed) const {
    return {&placed, p.positions, p.colours, codeOf(p), any_colours_ ? colourOf(p.material) : glm::dvec3(1)};
  }
  Error invalid(std::string message) const {
    return {ErrorKind::kInvalidData,
            file_.path(),
            std::move(message),
            "the file is damaged; get a whole copy, or write it anew",
            {}};
  }

  // The meshes that the scene's trees of nodes place. No node is reached twice.
  Result<void> walk() {
    struct Step {
      uint32_t node;
      glm::dmat4 parent;
    };
    std::vector<bool> seen(doc_.nodes.size());
    std::vector<Step> left;
    for (auto at = doc_.roots.rbegin(); at != doc_.roots.rend(); ++at) left.push_back({*at, glm::dmat4(1)});
    while (!left.empty()) {
      const Step step = left.back();
      left.pop_back();
      const GltfNode& node = doc_.nodes[step.node];
      if (seen[step.node])
        return invalid("expected each node to have one parent, found nodes[" + std::to_string(step.node) + "] twice");
      seen[step.node] = true;
      const glm::dmat4 matrix = node.matrix == kNoIndex ? step.parent : step.parent * doc_.matrices[node.matrix];
      skinned_ += node.skinned && node.mesh != kNoIndex;
      if (node.mesh != kNoIndex) placed_.push_back({node.mesh, matrix});
      for (auto child = node.children.rbegin(); child != node.children.rend(); ++child)
        left.push_back({*child, matrix});
    }
    return {};
  }

  static bool isSurface(const GltfPrimitive& p) {
    return p.mode == GltfPrimitive::Mode::kTriangles || p.mode == GltfPrimitive::Mode::kStrip ||
           p.mode == GltfPrimitive::Mode::kFan;
  }
  uint64_t cornersOf(const GltfPrimitive& p) const {
    return doc_.accessors[p.indices == kNoIndex ? p.positions : p.indices].count;
  }
  uint64_t trianglesOf(const GltfPrimitive& p) const {
    const uint64_t n = cornersOf(p);
    return p.mode == GltfPrimitive::Mode::kTriangles ? n / 3 : n < 3 ? 0 : n - 2;
  }

  // Everything that is read is checked before anything is allocated for it: where it lies, what it is, how much it is
  // when all nodes have placed their meshes.
  Result<void> checkSize() {
    std::vector<bool> checked(doc_.meshes.size());
    uint64_t triangles = 0, vertices = 0;
    for (const GltfMesh& mesh : doc_.meshes)
      for (const GltfPrimitive& p : mesh.primitives) any_colours_ = any_colours_ || p.colours != kNoIndex;
    Shared last;
    for (const Placed& placed : placed_) {
      const std::vector<GltfPrimitive>& primitives = doc_.meshes[placed.mesh].primitives;
      for (size_t k = 0; k < primitives.size(); ++k) {
        const GltfPrimitive& p = primitives[k];
        if (!checked[placed.mesh])
          if (auto done = check(p, "meshes[" + std::to_string(placed.mesh) + "].primitives[" + std::to_string(k) + "]");
              !done)
            return done;
        const bool read = isSurface(p) && p.positions != kNoIndex;
        triangles += read ? std::max<uint64_t>(trianglesOf(p), 1) : 1;
        if (read && sharedOf(p, placed) != last) {
          last = sharedOf(p, placed);
          vertices += doc_.accessors[p.positions].count;
        }
        const uint64_t most = buffers_.bytes() / kBytesOfTriangle + kAlwaysTriangles;
        if (triangles > most || vertices > most || triangles > kMaxTriangles || vertices > kMaxVertices)
          return Error{ErrorKind::kUnsupported,
                       file_.path(),
                       "its nodes repeat meshes into more than " +
                           std::to_string(std::min<uint64_t>(most, kMaxTriangles)) + " triangles or vertices",
                       "write it with the repeated meshes joined, or with fewer of them",
                       {}};
      }
      checked[placed.mesh] = true;
    }
    return {};
  }

  Result<void> check(const GltfPrimitive& p, const std::string& where) {
    if (!isSurface(p) || p.positions == kNoIndex) return {};
    const auto one = [&](uint32_t accessor, const char* name, int least, int most, bool whole) -> Result<void> {
      if (accessor == kNoIndex) return {};
      const GltfAccessor& a = doc_.accessors[accessor];
      const bool integers =
          !a.normalized && (a.component == GltfComponent::kUint8 || a.component == GltfComponent::kUint16 ||
                            a.component == GltfComponent::kUint32);
      if (a.components < least || a.components > most || (whole && !integers))
        return invalid("expected " + where + "." + name + " to be of " +
                       (whole ? "whole numbers" : std::to_string(least) + " numbers each") + ", found another type");
      return buffers_.check(accessor, std::string(name) + " of " + where);
    };
    if (p.draco)
      if (auto done = buffers_.decodeDraco(p, where); !done) return done;
    buffers_.select(p);
    for (auto done : {one(p.positions, "POSITION", 3, 3, false), one(p.colours, "COLOR_0", 3, 4, false),
                      one(p.uv, "TEXCOORD", 2, 2, false), one(p.normals, "NORMAL", 3, 3, false),
                      one(p.tangents, "TANGENT", 4, 4, false), one(p.indices, "indices", 1, 1, true)})
      if (!done) return done;
    const uint64_t vertices = doc_.accessors[p.positions].count;
    for (const uint32_t other : {p.colours, p.uv, p.normals, p.tangents})
      if (other != kNoIndex && doc_.accessors[other].count != vertices)
        return invalid("expected " + where +
                       " to have as many colours, texture coordinates, normals and tangents as its " +
                       std::to_string(vertices) + " positions, found " + std::to_string(doc_.accessors[other].count));
    if (p.mode == GltfPrimitive::Mode::kTriangles && cornersOf(p) % 3 != 0)
      return invalid("expected " + where + " to have three corners a triangle, found " + std::to_string(cornersOf(p)) +
                     " corners");
    return {};
  }

  glm::dvec3 colourOf(uint32_t material) const {
    return material == kNoIndex ? glm::dvec3(1) : doc_.materials[material].colour;
  }

  Result<void> add(const GltfPrimitive& p, const Placed& placed) {
    if (!isSurface(p)) {
      ++no_surfaces_;
      return {};
    }
    if (p.positions == kNoIndex) return {};
    morphs_ += p.morphs;
    buffers_.select(p);
    const auto first = addVertices(p, placed);
    if (!first) return first.error();
    if (auto done = readTextureCoordinates(p); !done) return done;
    if (auto done = readNormals(p, placed); !done) return done;
    const size_t before = mesh_.triangles.size();
    const bool mirrored = glm::determinant(glm::dmat3(placed.mesh_to_scene)) < 0;
    if (auto done = addTriangles(p, *first, mirrored); !done) return done;
    if (auto done = countHands(p, *first, before, mirrored); !done) return done;
    runs_.push_back({before, p.material, p.uv != kNoIndex});
    if (options_.progress)
      options_.progress(0.6 * static_cast<double>(&placed - placed_.data() + 1) / static_cast<double>(placed_.size()));
    return {};
  }

  // Answers the index of the first.
  Result<uint32_t> addVertices(const GltfPrimitive& p, const Placed& placed) {
    if (sharedOf(p, placed) == shared_) return shared_first_;
    const size_t first = mesh_.positions.size();
    shared_ = sharedOf(p, placed);
    shared_first_ = static_cast<uint32_t>(first);
    if (first == 0) mesh_.positions.reserve(static_cast<size_t>(doc_.accessors[p.positions].count));
    auto done = buffers_.forEach(p.positions, [&](uint64_t, const std::array<double, 4>& v) -> Result<void> {
      mesh_.positions.emplace_back(glm::dvec3(placed.mesh_to_scene * glm::dvec4(v[0], v[1], v[2], 1)));
      return {};
    });
    if (!done) return done.error();
    if (!any_colours_) return shared_first_;
    const auto [r, g, b] = bytesOf(shared_.tint);
    mesh_.colours.resize(mesh_.positions.size(), glm::u8vec3(r, g, b));
    if (p.colours == kNoIndex) return shared_first_;
    done = buffers_.forEach(p.colours, [&](uint64_t i, const std::array<double, 4>& v) -> Result<void> {
      const auto [red, green, blue] = bytesOf(shared_.tint * glm::dvec3(v[0], v[1], v[2]));
      mesh_.colours[first + i] = {red, green, blue};
      return {};
    });
    if (!done) return done.error();
    return shared_first_;
  }

  // As TriMesh has them, from the lower left corner. Those of the primitive before are kept where they are the same.
  Result<void> readTextureCoordinates(const GltfPrimitive& p) {
    const GltfPlacement plain, &m = p.material == kNoIndex ? plain : doc_.materials[p.material].placement();
    const UvOf key{p.uv, codeOf(p), m};
    if (key == uv_of_) return {};
    uv_of_ = key;
    uv_.clear();
    if (p.uv == kNoIndex) return {};
    const double c = std::cos(m.turn), s = std::sin(m.turn);
    uv_.reserve(static_cast<size_t>(doc_.accessors[p.uv].count));
    return buffers_.forEach(p.uv, [&](uint64_t, const std::array<double, 4>& v) -> Result<void> {
      const double x = v[0] * m.scale.x, y = v[1] * m.scale.y;
      uv_.emplace_back(m.offset.x + c * x + s * y, 1 - (m.offset.y - s * x + c * y));
      return {};
    });
  }

  Result<void> readNormals(const GltfPrimitive& p, const Placed& placed) {
    normals_.clear();
    if (p.normals == kNoIndex) return {};
    const glm::dmat3 turn = glm::transpose(glm::inverse(glm::dmat3(placed.mesh_to_scene)));
    normals_.reserve(static_cast<size_t>(doc_.accessors[p.normals].count));
    return buffers_.forEach(p.normals, [&](uint64_t, const std::array<double, 4>& v) -> Result<void> {
      normals_.emplace_back(turn * glm::dvec3(v[0], v[1], v[2]));
      return {};
    });
  }

  // Tangents say by their fourth number which way the map's y points: of the triangles from `begin` on.
  Result<void> countHands(const GltfPrimitive& p, uint32_t first, size_t begin, bool mirrored) {
    if (p.tangents == kNoIndex || uv_.empty()) return {};
    std::vector<int8_t> hands;
    auto done = buffers_.forEach(p.tangents, [&](uint64_t, const std::array<double, 4>& v) -> Result<void> {
      hands.push_back(v[3] > 0 ? 1 : v[3] < 0 ? -1 : 0);
      return {};
    });
    if (!done) return done;
    int64_t& upwards = upwards_[p.material];
    for (size_t t = begin; t < mesh_.triangles.size(); ++t) {
      const auto& [a, b, c] = mesh_.corner_uv[t];
      const float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
      const int hand = hands[mesh_.triangles[t][0] - first];
      upwards += area == 0 ? 0 : (area > 0) != mirrored ? hand : -hand;
    }
    return {};
  }

  Result<void> addTriangles(const GltfPrimitive& p, uint32_t first, bool mirrored) {
    const uint64_t vertices = doc_.accessors[p.positions].count;
    // Those before may have had none.
    if (!uv_.empty()) mesh_.corner_uv.resize(mesh_.triangles.size());
    if (!normals_.empty()) mesh_.corner_normals.resize(mesh_.triangles.size());
    std::array<uint32_t, 3> t{};
    const auto emit = [&](bool turned) {
      std::array<uint32_t, 3> corners = t;
      if (turned != mirrored) std::swap(corners[1], corners[2]);
      mesh_.triangles.push_back({first + corners[0], first + corners[1], first + corners[2]});
      const auto of = [&](const auto& vertex) {
        return std::array{vertex[corners[0]], vertex[corners[1]], vertex[corners[2]]};
      };
      if (!uv_.empty()) mesh_.corner_uv.push_back(of(uv_));
      if (!normals_.empty()) mesh_.corner_normals.push_back(of(normals_));
    };
    const auto corner = [&](uint64_t i, uint64_t vertex) -> Result<void> {
      if (vertex >= vertices)
        return invalid("corner " + std::to_string(i) + " of a primitive names vertex " + std::to_string(vertex) +
                       ", there are " + std::to_string(vertices) + " (from 0)");
      const auto v = static_cast<uint32_t>(vertex);
      if (p.mode == GltfPrimitive::Mode::kTriangles) {
        t[i % 3] = v;
        if (i % 3 == 2) emit(false);
        return {};
      }
      const bool fan = p.mode == GltfPrimitive::Mode::kFan;
      if (i < 3) {
        t[i] = v;
      } else {
        if (!fan) t[0] = t[1];
        t[1] = t[2];
        t[2] = v;
      }
      // The ends of strips are stitched by triangles without an area.
      if (i >= 2 && t[0] != t[1] && t[1] != t[2] && t[2] != t[0]) emit(!fan && i % 2 == 1);
      return {};
    };
    if (p.indices == kNoIndex) {
      for (uint64_t i = 0; i < vertices; ++i)
        if (auto done = corner(i, i); !done) return done;
      return {};
    }
    return buffers_.forEach(
        p.indices, [&](uint64_t i, const std::array<double, 4>& v) { return corner(i, static_cast<uint64_t>(v[0])); });
  }

  // The image of a texture, which is read once; without one no file.
  Result<ImageFile> imageOf(uint32_t texture) {
    const uint32_t index = texture == kNoIndex ? kNoIndex : doc_.textures[texture].image;
    if (index == kNoIndex) return ImageFile{};
    if (const auto known = images_.find(index); known != images_.end()) return known->second;
    auto image = readImage(index);
    if (image) images_.emplace(index, *image);
    return image;
  }
  Result<ImageFile> readImage(uint32_t index) {
    const GltfImage& image = doc_.images[index];
    ImageFile out;
    const auto inside = [&](Result<std::vector<uint8_t>> bytes) -> Result<ImageFile> {
      if (!bytes) return bytes.error();
      out.bytes = std::make_shared<const std::vector<uint8_t>>(std::move(*bytes));
      return out;
    };
    if (image.uri.starts_with("data:")) return inside(decodeDataUri(image.uri, file_.path()));
    if (!image.uri.empty()) {
      auto name = fileOfUri(image.uri, file_.path());
      if (!name) return name.error();
      out.path = *name;
      return out;
    }
    if (image.view != kNoIndex) return inside(buffers_.bytesOf(image.view));
    return invalid("expected images[" + std::to_string(index) + "] to have a uri or a bufferView, found neither");
  }

  // What a material shows; without any file nothing.
  Result<MeshImage> imagesOf(uint32_t number) {
    const GltfMaterial& material = doc_.materials[number];
    MeshImage out;
    auto colours = imageOf(material.colours.texture);
    if (!colours) return colours.error();
    Result<ImageFile> normals = imageOf(material.normals.texture);
    if (!normals) normals = ImageFile{};  // the surface can be shown without
    const auto repeats = [&](const GltfMap& map) { return doc_.textures[map.texture].repeats; };
    out.file = std::move(*colours);
    out.tint = glm::vec3(material.colour);
    if (out.file.isThere()) out.repeats = repeats(material.colours);
    else if (normals->isThere()) out.repeats = repeats(material.normals);
    if (!normals->isThere() || !(out.file.isThere() || !any_colours_)) return out;
    if (material.normals.placement != material.placement() || out.repeats != repeats(material.normals)) return out;
    out.normals = {.file = std::move(*normals), .scale = static_cast<float>(material.normal_scale)};
    if (const auto found = upwards_.find(number); found != upwards_.end() && found->second != 0)
      out.normals.y = found->second > 0 ? NormalMap::Y::kUpwards : NormalMap::Y::kDownwards;
    return out;
  }

  // Materials that show the same images alike share them; others share their bytes.
  Result<void> takeMaterials() {
    for (const GltfImage& image : doc_.images)
      if (!image.uri.empty() && !image.uri.starts_with("data:"))
        if (auto name = fileOfUri(image.uri, file_.path()); name) mesh_.named_files.push_back(*name);
    std::map<uint32_t, uint16_t> numbers;  // of RawMesh::images, by material
    std::vector<MaterialRun> runs;
    for (const Run& run : runs_) {
      const auto [r, g, b] = bytesOf(colourOf(run.material));
      runs.push_back({run.first, kNoImage, glm::u8vec3(r, g, b)});
      if (run.material == kNoIndex || (!run.has_uv && !mesh_.corner_uv.empty())) continue;
      const auto [number, is_new] = numbers.try_emplace(run.material, kNoImage);
      if (is_new) {
        auto image = imagesOf(run.material);
        if (!image) return image.error();
        number->second = shareImage(mesh_, std::move(*image));
      }
      runs.back().image = number->second;
    }
    mesh_.texture_repeats = mesh_.images.empty() || mesh_.images[0].repeats;
    noteNormalMapsLeftOut(runs);
    useMaterials(mesh_, runs, options_);
    return {};
  }
  void noteNormalMapsLeftOut(const std::vector<MaterialRun>& runs) {
    std::set<uint32_t> left_out;  // materials
    for (size_t i = 0; i < runs_.size(); ++i) {
      if (runs_[i].material == kNoIndex || doc_.materials[runs_[i].material].normals.texture == kNoIndex) continue;
      const uint16_t image = runs[i].image;
      if (image == kNoImage || options_.other_image || mesh_.corner_uv.empty() ||
          !mesh_.images[image].normals.file.isThere())
        left_out.insert(runs_[i].material);
    }
    noteNormalMaps(mesh_, left_out.size());
  }

  void noteLeftOut() {
    const auto note = [&](const char* what, uint64_t count, const char* done) {
      if (count > 0) mesh_.findings.push_back({what, count, {}, done});
    };
    note("primitives of points or lines", no_surfaces_, "not used");
    note("meshes with a skin", skinned_, "read at rest, where their nodes place them");
    note("primitives with morph targets", morphs_, "read without them");
  }

  const InputFile& file_;
  const MeshReadOptions& options_;
  const GltfDocument& doc_;
  GltfBuffers buffers_;
  RawMesh mesh_;
  std::vector<Placed> placed_;
  struct Run {
    size_t first = 0;  // triangle
    uint32_t material = kNoIndex;
    bool has_uv = false;
  };
  std::vector<Run> runs_;
  Shared shared_;
  std::map<uint32_t, ImageFile> images_;  // those that were read
  // Of materials: triangles whose tangents let y point upwards in the image, less those that let it point downwards.
  std::map<uint32_t, int64_t> upwards_;
  struct UvOf {
    uint32_t accessor = kNoIndex, code = kNoIndex;
    GltfPlacement placement;
    bool operator==(const UvOf&) const = default;
  };
  UvOf uv_of_;
  std::vector<glm::vec2> uv_;
  std::vector<glm::vec3> normals_;
  uint32_t shared_first_ = 0;
  uint64_t skinned_ = 0, morphs_ = 0, no_surfaces_ = 0;
  bool any_colours_ = false;
};

}  // namespace

Result<RawMesh> readGltf(const InputFile& file, const MeshReadOptions& options) {
  auto parts = readGltfParts(file);
  if (!parts) return parts.error();
  auto document = parseGltf(parts->json, file.path());
  if (!document) return document.error();
  std::string().swap(parts->json);
  return GltfReader(file, options, *document, *parts).read();
}

}  // namespace relievo::mesh_file
