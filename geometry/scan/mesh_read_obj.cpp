// mesh_read_obj.cpp - Wavefront OBJ: v (with colours behind the coordinates, as MeshLab and ZBrush write them), vt, f
// (negative indices count back from the line), mtllib and usemtl for the images that map_Kd names and the maps of
// normals of norm and map_Bump, with the vn that these count from; and Kd of materials without an image. Groups and
// free-form surfaces are read over.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <set>

#include "geometry/scan/mesh_file.h"
#include "geometry/scan/mesh_materials.h"
#include "src/base/srgb.h"

namespace relievo::mesh_file {
namespace {

constexpr uint64_t kMaxMaterialBytes = uint64_t{16} << 20;
constexpr size_t kMaxLibraries = 64;  // more, and the same one again, are read over

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && isBlank(text.front())) text.remove_prefix(1);
  while (!text.empty() && isBlank(text.back())) text.remove_suffix(1);
  return text;
}

// A map's file, behind its options; its name may hold blanks.
struct MapLine {
  std::string path;
  bool clamped = false;  // the image does not repeat
  double bumps = 1;      // by which what it says of bumps is multiplied
};
MapLine mapOf(std::string_view text) {
  MapLine map;
  for (;;) {
    std::string_view rest = text, option = nextItem(rest);
    int arguments = -1;
    for (auto [name, n] : {std::pair{"-blendu", 1},
                           {"-blendv", 1},
                           {"-boost", 1},
                           {"-bm", 1},
                           {"-cc", 1},
                           {"-clamp", 1},
                           {"-imfchan", 1},
                           {"-mm", 2},
                           {"-texres", 1},
                           {"-type", 1},
                           {"-o", 3},
                           {"-s", 3},
                           {"-t", 3}})
      if (option == name) arguments = n;
    if (arguments < 0) break;
    for (int k = 0; k < arguments; ++k) {
      std::string_view before = rest, argument = nextItem(rest);
      if (option == "-clamp") map.clamped = argument == "on";
      double number = 0;
      if (option == "-bm" && parseNumber(argument, number) && std::isfinite(number)) map.bumps = number;
      if (arguments == 3 && k > 0 && !parseNumber(argument, number)) {  // -o, -s and -t may have fewer than three
        rest = before;
        break;
      }
    }
    text = rest;
  }
  // Some programs write it behind the name.
  constexpr std::string_view kBehind = " -bm ";
  double bumps = 0;
  if (const size_t at = text.rfind(kBehind);
      at < text.size() && parseNumber(trimmed(text.substr(at + kBehind.size())), bumps) && std::isfinite(bumps)) {
    map.bumps = bumps;
    text = text.substr(0, at);
  }
  map.path = trimmed(text);
  std::replace(map.path.begin(), map.path.end(), '\\', '/');
  return map;
}

class ObjReader {
 public:
  ObjReader(const InputFile& file, const MeshReadOptions& options)
      : options_(options), in_(file, options), cutter_(mesh_) {}

  Result<RawMesh> read() {
    std::string_view text;
    while (in_.line(text)) {
      if (text.size() > 0 && text.back() == '\r') text.remove_suffix(1);
      if (text.size() > 0 && text.back() == '\\') text = joined(text);
      std::string_view key = nextItem(text);
      if (key.starts_with('#')) comment(key, text);
      if (key == "v") vertex(text);
      else if (key == "vt") textureVertex(text);
      else if (key == "vn") vertexNormal(text);
      else if (key == "f" || key == "fo") face(text);
      else if (key == "mtllib") materialFile(trimmed(text));
      else if (key == "usemtl") useMaterial(trimmed(text));
      if (in_.failed()) break;
    }
    if (in_.failed()) return in_.error();
    mesh_.vertices_read = mesh_.positions.size();
    if (mesh_.vertices_read == 0)
      return Error{ErrorKind::kInvalidData,
                   in_.file().path(),
                   "expected vertices (lines \"v x y z\"), found none",
                   "this is no OBJ file",
                   {}};
    if (highest_ >= mesh_.positions.size()) {
      Error e{ErrorKind::kInvalidData,
              in_.file().path(),
              "",
              "the file is damaged; get a whole copy, or write it anew",
              {}};
      e.message = "face " + std::to_string(highest_face_) + " names vertex " + std::to_string(highest_ + 1) +
                  ", there are " + std::to_string(mesh_.positions.size()) + " (from 1)";
      return e;
    }
    if (!mesh_.float_colours.empty()) mesh_.float_colours.resize(mesh_.positions.size(), glm::vec3(1));
    if (cutter_.dropped() > 0)
      mesh_.findings.push_back({"faces of fewer than three corners", cutter_.dropped(), {}, "dropped"});
    // Some programs leave out all texture coordinates, but not what names them.
    if (corners_without_uv_ > 0)
      mesh_.findings.push_back({"corners that name texture coordinates, of which the file has none",
                                corners_without_uv_,
                                {},
                                "read without"});
    takeMaterials();
    noteColoursLost();
    return std::move(mesh_);
  }

 private:
  struct Material {
    MapLine image;
    glm::u8vec3 colour = kPlainColour;  // Kd
    MapLine normals;
    bool may_be_bumps = false;  // they came as a map of bumps, as which some programs write them
  };
  struct Run {
    size_t first = 0;  // triangle
    const std::string* material = nullptr;
    bool has_uv = false;
  };

  void bad(const char* expected, std::string_view found) {
    in_.note(std::string("expected ") + expected + ", found " + inQuotes(found) + " in line " +
             std::to_string(in_.lineNumber()));
  }
  // The first one that states a unit counts.
  void comment(std::string_view key, std::string_view text) {
    if (!mesh_.unit.empty()) return;
    key.remove_prefix(1);
    const std::string whole = std::string(key) + " " + std::string(text.substr(0, 40));
    mesh_.unit = unitOfComment(whole);
  }
  // A line that ends in a backslash goes on in the next.
  std::string_view joined(std::string_view text) {
    constexpr size_t kMaxJoinedBytes = size_t{64} << 20;
    joined_.assign(text);
    while (!joined_.empty() && joined_.back() == '\\' && joined_.size() <= kMaxJoinedBytes) {
      joined_.back() = ' ';
      std::string_view more;
      if (!in_.line(more)) break;
      if (!more.empty() && more.back() == '\r') more.remove_suffix(1);
      joined_ += more;
    }
    return joined_;
  }

  void vertex(std::string_view text) {
    double v[8];
    size_t n = 0;
    std::string_view whole = text;
    for (; n < 8; ++n) {
      std::string_view item = nextItem(text);
      if (item.empty() || item.front() == '#') break;
      if (!parseNumber(item, v[n])) return bad("a vertex's coordinate", item);
    }
    if (n < 3) return bad("three coordinates of a vertex", whole);
    if (mesh_.positions.size() >= kMaxVertices)
      return in_.note("expected at most " + std::to_string(kMaxVertices) + " vertices");
    mesh_.positions.emplace_back(v[0], v[1], v[2]);
    if (n >= 6) {
      mesh_.float_colours.resize(mesh_.positions.size() - 1, glm::vec3(1));
      mesh_.float_colours.emplace_back(v[3], v[4], v[5]);
    }
  }

  std::string noSuchTextureVertex(int64_t index) const {
    return "face " + std::to_string(faces_) + " (line " + std::to_string(in_.lineNumber()) +
           ") names texture coordinates " + std::to_string(index) + ", there are " + std::to_string(uv_.size()) +
           " before it (from 1)";
  }
  void textureVertex(std::string_view text) {
    if (!first_without_uv_.empty()) return in_.note(first_without_uv_);
    std::string_view u = nextItem(text), v = nextItem(text);
    double x = 0, y = 0;
    if (!parseNumber(u, x) || (!v.empty() && v.front() != '#' && !parseNumber(v, y)))
      return bad("texture coordinates", u);
    uv_.emplace_back(x, y);
  }

  // Of use where a material has a map of normals, and stands before them all.
  void vertexNormal(std::string_view text) {
    glm::vec3 n(0);
    for (int axis = 0; axis < 3 && normals_are_needed_; ++axis)
      if (double v = 0; parseNumber(nextItem(text), v)) n[axis] = static_cast<float>(v);
    if (normals_are_needed_) normals_.push_back(n);
    else normals_are_lost_ = true;
  }

  // An index of the file (from 1, or back from the end: -1) among n, from 0; false: none of them.
  static bool resolve(int64_t index, size_t n, uint64_t& out) {
    if (index < 0) index += static_cast<int64_t>(n) + 1;
    out = static_cast<uint64_t>(index - 1);
    return index > 0;
  }

  void face(std::string_view text) {
    ++faces_;
    corners_.clear();
    corner_uv_.clear();
    corner_normals_.clear();
    bool has_uv = false;
    for (std::string_view item = nextItem(text); !item.empty() && item.front() != '#'; item = nextItem(text)) {
      std::string_view rest = item;
      auto part = [&] {
        size_t slash = rest.find('/');
        std::string_view p = rest.substr(0, slash);
        rest.remove_prefix(slash == std::string_view::npos ? rest.size() : slash + 1);
        return p;
      };
      int64_t index = 0;
      uint64_t v = 0, vt = 0;
      if (!parseNumber(part(), index)) return bad("a corner of a face", item);
      if (!resolve(index, mesh_.positions.size(), v) || v >= kMaxVertices)
        return in_.note("face " + std::to_string(faces_) + " (line " + std::to_string(in_.lineNumber()) +
                        ") names vertex " + std::to_string(index) + ", there are " +
                        std::to_string(mesh_.positions.size()) + " before it (from 1)");
      if (v >= mesh_.positions.size() && v >= highest_) {  // may still come
        highest_ = v;
        highest_face_ = faces_;
      }
      corners_.push_back(static_cast<uint32_t>(v));
      glm::vec2 uv(0);
      if (std::string_view t = part(); !t.empty()) {
        if (!parseNumber(t, index)) return bad("a corner of a face", item);
        const bool possible = resolve(index, uv_.size(), vt);
        if (possible && uv_.empty()) {
          if (first_without_uv_.empty()) first_without_uv_ = noSuchTextureVertex(index);
          ++corners_without_uv_;
        } else if (!possible || vt >= uv_.size()) {
          return in_.note(noSuchTextureVertex(index));
        } else {
          uv = uv_[vt];
          has_uv = true;
        }
      }
      corner_uv_.push_back(uv);
      if (takes_normals_) {
        uint64_t vn = 0;
        const bool known = parseNumber(part(), index) && resolve(index, normals_.size(), vn) && vn < normals_.size();
        corner_normals_.push_back(known ? normals_[vn] : glm::vec3(0));
      }
    }
    size_t before = mesh_.triangles.size();
    cutter_.add(corners_, has_uv ? std::span<const glm::vec2>(corner_uv_) : std::span<const glm::vec2>(),
                corner_normals_);
    if (mesh_.triangles.size() > kMaxTriangles)
      return in_.note("expected at most " + std::to_string(kMaxTriangles) + " triangles");
    if (runs_.empty() || runs_.back().has_uv != has_uv || runs_.back().material != material_)
      runs_.push_back({before, material_, has_uv});
  }

  void materialFile(std::string_view name) {
    // Beside the OBJ; a file that is not there costs the image alone.
    if (libraries_.size() == kMaxLibraries || !libraries_.insert(std::string(name)).second) return;
    auto path = std::filesystem::path(in_.file().path()).parent_path() / std::string(name);
    mesh_.named_files.emplace_back(name);
    if (!options_.allow_outside) {
      if (auto beside = checkBesideMesh(in_.file().path(), path.string(), "the material file"); !beside)
        return in_.note(beside.error().message, beside.error().hint);
    }
    auto text = readTextFile(path.string(), kMaxMaterialBytes);
    if (!text) {
      // What is there and cannot be read is not like what is missing: the next try may well give another mesh.
      std::error_code unknown;
      if (text.error().kind == ErrorKind::kIo && std::filesystem::is_regular_file(path, unknown))
        return in_.fail(text.error());
      if (++unread_libraries_ == 1) unread_library_ = name.substr(0, 100);
      return;
    }
    std::string name_of;
    for (std::string_view rest = *text; !rest.empty();) {
      size_t end = rest.find('\n');
      std::string_view line = rest.substr(0, end);
      rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
      std::string_view key = nextItem(line);
      if (key == "newmtl") {
        name_of = trimmed(line);
      } else if (lowerCase(key) == "map_kd") {
        nameFile((materials_[name_of].image = mapOf(trimmed(line))).path);
      } else if (const std::string map = lowerCase(key); map == "norm" || map == "bump" || map == "map_bump") {
        Material& m = materials_[name_of];
        if (map != "norm" && !m.normals.path.empty() && !m.may_be_bumps) continue;
        m.may_be_bumps = map != "norm";
        nameFile((m.normals = mapOf(trimmed(line))).path);
        normals_are_needed_ = !normals_are_lost_;
      } else if (lowerCase(key) == "kd") {
        glm::dvec3 c(0);
        if (parseNumber(nextItem(line), c.x) && parseNumber(nextItem(line), c.y) && parseNumber(nextItem(line), c.z) &&
            std::isfinite(c.x + c.y + c.z))
          materials_[name_of].colour = glm::u8vec3(glm::round(255.0 * glm::clamp(c, 0.0, 1.0)));
      }
    }
  }

  void nameFile(const std::string& path) {
    if (images_.insert(path).second) mesh_.named_files.push_back(path);
  }

  void useMaterial(std::string_view name) {
    material_ = &*material_names_.emplace(name).first;
    const auto found = materials_.find(*material_);
    takes_normals_ = normals_are_needed_ && found != materials_.end() && !found->second.normals.path.empty();
  }

  const Material& materialOf(const Run& run) const {
    static const Material plain;
    const auto found = materials_.find(*run.material);
    return found == materials_.end() ? plain : found->second;
  }
  uint64_t trianglesOf(size_t run) const {
    return (run + 1 < runs_.size() ? runs_[run + 1].first : mesh_.triangles.size()) - runs_[run].first;
  }

  // What a material shows; without any file nothing.
  MeshImage imagesOf(const Material& m) const {
    MeshImage out{.file = {m.image.path, {}}, .repeats = !(m.image.path.empty() ? m.normals : m.image).clamped};
    if (m.normals.path.empty() || m.normals.clamped == out.repeats) return out;
    if (m.image.path.empty()) {
      if (!mesh_.float_colours.empty()) return out;
      for (int c = 0; c < 3; ++c) out.tint[c] = static_cast<float>(linearFromSrgb(m.colour[c] / 255.0));
    }
    out.normals = {
        .file = {m.normals.path, {}}, .scale = static_cast<float>(m.normals.bumps), .may_be_bumps = m.may_be_bumps};
    return out;
  }

  void takeMaterials() {
    std::map<const std::string*, uint16_t> numbers;  // of images, by material
    std::vector<MaterialRun> runs;
    std::set<std::string> without_normals;
    for (const Run& run : runs_) {
      const Material& m = materialOf(run);
      uint16_t image = kNoImage;
      if (run.has_uv || uv_.empty()) {
        const auto [known, added] = numbers.try_emplace(run.material, kNoImage);
        if (added) known->second = shareImage(mesh_, imagesOf(m));
        image = known->second;
      }
      runs.push_back({run.first, image, m.colour});
      const bool normals = image != kNoImage && mesh_.images[image].normals.file.isThere() && run.has_uv;
      if (!m.normals.path.empty() && (!normals || options_.other_image)) without_normals.insert(*run.material);
    }
    noteNormalMaps(mesh_, without_normals.size());
    mesh_.texture_repeats = mesh_.images.empty() || mesh_.images[0].repeats;
    useMaterials(mesh_, runs, options_);
  }
  void noteColoursLost() {
    const bool image = !mesh_.images.empty(), vertices = !mesh_.float_colours.empty();
    std::map<std::string, uint64_t> lost;  // triangles of materials
    for (size_t i = 0; i < runs_.size(); ++i) {
      const Material& m = materialOf(runs_[i]);
      const bool grey = m.colour.r == m.colour.g && m.colour.g == m.colour.b;
      if (vertices && !grey && (m.image.path.empty() || !image)) lost[*runs_[i].material] += trianglesOf(i);
    }
    if (!lost.empty()) {
      uint64_t all = 0, most = 0;
      std::string material;
      for (const auto& [name, triangles] : lost) {
        all += triangles;
        if (triangles <= most) continue;
        most = triangles;
        material = name;
      }
      const std::string further = lost.size() > 1 ? " and " + std::to_string(lost.size() - 1) + " more" : "";
      mesh_.findings.push_back(
          {"triangles of materials with a colour alone (material " + inQuotes(material) + further + ")",
           all,
           {},
           "Kd is not used beside colours of vertices"});
    }
    if (unread_libraries_ > 0)
      mesh_.findings.push_back({"material files that cannot be read (" + unread_library_ + ")",
                                unread_libraries_,
                                {},
                                image      ? "their images are not used"
                                : vertices ? "colours of vertices are used"
                                : mesh_.corner_uv.empty()
                                    ? "the result has no colour"
                                    : "the result has no colour, unless --texture names the image"});
  }

  const MeshReadOptions& options_;
  FileReader in_;
  RawMesh mesh_;
  FaceCutter cutter_;
  std::vector<glm::vec2> uv_, corner_uv_;
  std::vector<glm::vec3> normals_, corner_normals_;
  bool normals_are_needed_ = false, normals_are_lost_ = false;  // of all materials; read over, before it was known
  bool takes_normals_ = false;                                  // the material that is used
  std::vector<uint32_t> corners_;
  std::set<std::string> libraries_;
  std::set<std::string> images_;  // that materials name
  std::map<std::string, Material> materials_;
  std::set<std::string> material_names_{""};  // that faces name
  const std::string* material_ = &*material_names_.begin();
  std::string unread_library_;
  std::vector<Run> runs_;
  uint64_t unread_libraries_ = 0;
  uint64_t faces_ = 0, highest_ = 0, highest_face_ = 0;
  uint64_t corners_without_uv_ = 0;  // that name some, before any
  std::string first_without_uv_;     // what is wrong with the first of them, if there are some after all
  std::string joined_;
};

}  // namespace

Result<RawMesh> readObj(const InputFile& file, const MeshReadOptions& options) {
  return ObjReader(file, options).read();
}

}  // namespace relievo::mesh_file
