// mesh_read.cpp - which reader a file takes, and from its coordinates to floats beside an origin.
#include "geometry/scan/mesh_read.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "geometry/scan/mesh_file.h"
#include "geometry/scan/mesh_materials.h"
#include "geometry/scan/mesh_repair.h"
#include "src/artwork/axis_rotation.h"

namespace relievo {
namespace {

using namespace mesh_file;

// Beyond this, coordinates are no measures of things that anybody scans: a wrong unit, or damage. Products of three
// lengths stay within floats.
constexpr double kMaxCoordinateMm = 1e12;
// Beyond the image by more than what programs round when they write: half a texel of 5,000.
constexpr float kOutsideImage = 1e-4f;

// About the box's centre, on a grid as coarse as the box: subtracting it from a float is exact in double, a mesh around
// the coordinates' origin keeps its very floats, and what is left is at most twice the half diagonal: exact to 2^-23 of
// it.
glm::dvec3 originOf(const glm::dvec3& low, const glm::dvec3& high) {
  double half = 0.5 * glm::length(high - low);
  if (!(half > 0)) return low;
  double grid = std::exp2(std::ceil(std::log2(half)));
  glm::dvec3 centre = 0.5 * (low + high);
  return {grid * std::round(centre.x / grid), grid * std::round(centre.y / grid), grid * std::round(centre.z / grid)};
}

Error invalid(const std::string& name, std::string message, std::string hint = "") {
  return {ErrorKind::kInvalidData, name, std::move(message), std::move(hint), {}};
}

bool areNumbers(const glm::dvec3& p) { return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z); }

std::string finiteProblem(const glm::dvec3& p, uint64_t vertex, double mm_per_unit) {
  for (int c = 0; c < 3; ++c)
    if (!std::isfinite(p[c]) || std::abs(p[c] * mm_per_unit) > kMaxCoordinateMm)
      return "vertex " + std::to_string(vertex) + " (from 0): expected " + "xyz"[c] + " to be " +
             (std::isfinite(p[c]) ? "within 10^12 mm of 0" : "a finite number") + ", found " + numberText(p[c]);
  return {};
}

Error badVertices(const std::vector<glm::dvec3>& positions, size_t first, const std::string& name, double mm_per_unit) {
  std::string message = finiteProblem(positions[first], first, mm_per_unit);
  uint64_t more = 0;
  bool finite = true;
  for (size_t i = first; i < positions.size(); ++i) {
    const glm::dvec3& p = positions[i];
    finite = finite && areNumbers(p);
    if (i > first && !finiteProblem(p, i, mm_per_unit).empty()) ++more;
  }
  if (more > 0)
    message += "; " + std::to_string(more) + " more " + (more == 1 ? "vertex is" : "vertices are") + " like that";
  return invalid(
      name, std::move(message),
      finite ? "remove such vertices and their faces, or set --unit" : "remove such vertices and their faces");
}

// Some programs that mesh points write a few vertices that are no numbers. More of them than one in a hundred are
// damage.
bool mayBeDropped(uint64_t no_numbers, uint64_t vertices) { return no_numbers * 100 <= vertices; }
// Drops the triangles of vertices that are no numbers, `count` of them.
void dropNoNumbers(RawMesh& raw, uint64_t count) {
  size_t kept = 0;
  for (size_t t = 0; t < raw.triangles.size(); ++t) {
    const auto& of = raw.triangles[t];
    if (!std::all_of(of.begin(), of.end(), [&](uint32_t v) { return areNumbers(raw.positions[v]); })) continue;
    raw.triangles[kept] = of;
    if (t < raw.corner_uv.size()) raw.corner_uv[kept] = raw.corner_uv[t];
    if (t < raw.corner_normals.size()) raw.corner_normals[kept] = raw.corner_normals[t];
    if (t < raw.image_of.size()) raw.image_of[kept] = raw.image_of[t];
    ++kept;
  }
  const size_t dropped = raw.triangles.size() - kept;
  raw.triangles.resize(kept);
  if (raw.corner_uv.size() > kept) raw.corner_uv.resize(kept);
  if (raw.corner_normals.size() > kept) raw.corner_normals.resize(kept);
  if (raw.image_of.size() > kept) raw.image_of.resize(kept);
  for (glm::dvec3& p : raw.positions)
    if (!areNumbers(p)) p = glm::dvec3(0);  // of no triangle
  raw.findings.push_back({"vertices whose coordinates are no numbers",
                          count,
                          {},
                          "dropped with their " + std::to_string(dropped) + " triangles"});
}

// Floats as colours: 0..1, or 0..255 if any says so.
std::vector<glm::u8vec3> bytesOf(const std::vector<glm::vec3>& colours) {
  float most = 0;
  for (const glm::vec3& c : colours) most = std::max({most, c.x, c.y, c.z});
  float scale = most > 1 ? 1 : 255;
  std::vector<glm::u8vec3> out(colours.size());
  for (size_t i = 0; i < out.size(); ++i)
    for (int c = 0; c < 3; ++c) out[i][c] = byteOf(colours[i][c] * scale + 0.5f);
  return out;
}

glm::vec3 unitOrNone(const glm::dvec3& normal) {
  const double length = glm::length(normal);
  return length > 0 && std::isfinite(length) ? glm::vec3(normal / length) : glm::vec3(0);
}

// Only those that lean outwards, as its triangles are in the end.
void dropInwardNormals(TriMesh& mesh) {
  for (size_t t = 0; t < mesh.corner_normals.size(); ++t) {
    const auto& [a, b, c] = mesh.triangles[t];
    const glm::vec3& p = mesh.positions_mm[a];
    const glm::vec3 outwards = glm::cross(mesh.positions_mm[b] - p, mesh.positions_mm[c] - p);
    for (glm::vec3& n : mesh.corner_normals[t])
      if (!(glm::dot(n, outwards) > 0)) n = glm::vec3(0);
  }
}

Result<LoadedMesh> finish(RawMesh raw, const std::string& name, const MeshReadOptions& options) {
  LoadedMesh out;
  out.named_files = std::move(raw.named_files);
  out.diagnosis.vertices_read = raw.vertices_read;
  out.diagnosis.triangles_read = raw.triangles.size();
  const double unit = *options.mm_per_unit;
  out.mm_per_unit = unit;
  if (!raw.unit.empty()) out.unit = raw.unit;
  if (options.turn != glm::dmat3(1))
    for (glm::dvec3& p : raw.positions) p = options.turn * p;
  for (auto& of_triangle : raw.corner_normals)
    for (glm::vec3& n : of_triangle) n = unitOrNone(options.turn * glm::dvec3(n));
  if (!raw.face_colours.empty()) paintFaces(raw);
  const Error interrupted{ErrorKind::kInterrupted, name, "interrupted", "", {}};
  uint64_t no_numbers = 0;
  for (const glm::dvec3& p : raw.positions) no_numbers += !areNumbers(p);
  if (no_numbers > 0 && mayBeDropped(no_numbers, raw.positions.size())) dropNoNumbers(raw, no_numbers);
  out.diagnosis.findings = std::move(raw.findings);
  for (size_t i = 0; i < raw.positions.size(); ++i) {
    if (stopAt(i, options.interrupted)) return interrupted;
    const glm::dvec3& p = raw.positions[i];
    if (!(std::abs(p.x * unit) <= kMaxCoordinateMm && std::abs(p.y * unit) <= kMaxCoordinateMm &&
          std::abs(p.z * unit) <= kMaxCoordinateMm))
      return badVertices(raw.positions, i, name, unit);
  }
  if (raw.triangles.empty())
    return invalid(name, "expected a surface, found no triangle", "points must be meshed first");
  glm::dvec3 low(raw.positions[raw.triangles[0][0]]),
      high(low);  // of what is used: a stray point must not cost precision
  for (size_t i = 0; i < raw.triangles.size(); ++i) {
    if (stopAt(i, options.interrupted)) return interrupted;
    for (uint32_t v : raw.triangles[i]) {
      low = glm::min(low, raw.positions[v]);
      high = glm::max(high, raw.positions[v]);
    }
  }
  TriMesh& mesh = out.mesh;
  const double scale = options.keep_units ? 1.0 : unit;
  mesh.origin_mm = originOf(low * scale, high * scale);
  mesh.positions_mm.resize(raw.positions.size());
  for (size_t i = 0; i < raw.positions.size(); ++i)
    mesh.positions_mm[i] = glm::vec3(raw.positions[i] * scale - mesh.origin_mm);
  std::vector<glm::dvec3>().swap(raw.positions);  // half of all memory so far
  mesh.triangles = std::move(raw.triangles);
  mesh.colours = raw.float_colours.empty() ? std::move(raw.colours) : bytesOf(raw.float_colours);
  std::vector<glm::vec3>().swap(raw.float_colours);
  mesh.corner_uv = std::move(raw.corner_uv);
  if (!mesh.corner_uv.empty()) mesh.corner_uv.resize(mesh.triangles.size());
  mesh.corner_normals = std::move(raw.corner_normals);
  if (!mesh.corner_normals.empty()) mesh.corner_normals.resize(mesh.triangles.size());
  mesh.images = std::move(raw.images);
  mesh.image_of = std::move(raw.image_of);
  mesh.texture_repeats = raw.texture_repeats;
  std::array<MeshFinding, 2> outside;  // of images that do not repeat, and of those that do
  for (size_t repeats = 0; repeats < 2; ++repeats)
    outside[repeats] = {"triangles with texture coordinates outside the image",
                        0,
                        {},
                        repeats ? "the image is repeated" : "the image's border goes on"};
  const auto repeats = [&](size_t t) {
    if (mesh.images.empty() || options.other_image) return mesh.texture_repeats;
    return mesh.images[mesh.image_of.empty() ? 0 : mesh.image_of[t]].repeats;
  };
  for (size_t t = 0; t < mesh.corner_uv.size(); ++t) {
    bool out_of = false;
    for (const glm::vec2& uv : mesh.corner_uv[t]) {
      if (!std::isfinite(uv.x) || !std::isfinite(uv.y))
        return invalid(name, "triangle " + std::to_string(t) +
                                 " (from 0): expected finite texture coordinates, found " + numberText(uv.x) + " " +
                                 numberText(uv.y));
      out_of = out_of || std::abs(uv.x - 0.5f) > 0.5f + kOutsideImage || std::abs(uv.y - 0.5f) > 0.5f + kOutsideImage;
    }
    if (!out_of || (!mesh.image_of.empty() && mesh.image_of[t] == kNoImage)) continue;
    if (MeshFinding& finding = outside[repeats(t)]; ++finding.count <= kMaxPlaces)
      finding.places_mm.push_back(mesh.origin_mm + glm::dvec3(mesh.positions_mm[mesh.triangles[t][0]]));
  }
  for (MeshFinding& finding : outside)
    if (finding.count > 0) out.diagnosis.findings.push_back(std::move(finding));
  auto progress = [&](double done) {
    if (options.progress) options.progress(0.6 + 0.4 * done);
  };
  if (auto repaired = repairTriangles(mesh, out.diagnosis, name, progress, options.interrupted, options.workers,
                                      options.all_pieces_up_to);
      !repaired)
    return repaired.error();
  dropInwardNormals(mesh);
  if (options.keep_units) {
    out.diagnosis.min_mm *= unit;
    out.diagnosis.max_mm *= unit;
    for (MeshFinding& finding : out.diagnosis.findings)
      for (glm::dvec3& place : finding.places_mm) place *= unit;
  }
  return out;
}

}  // namespace

Result<void> checkBesideMesh(const std::string& mesh, const std::string& path, const char* what) {
  namespace fs = std::filesystem;
  std::error_code unknown, ignored;
  const fs::path beside = fs::path(mesh).parent_path();
  const fs::path folder = fs::canonical(beside.empty() ? fs::path(".") : beside, unknown);
  // Made absolute first: of a relative path of which nothing exists the library leaves all as it is.
  const fs::path file = fs::weakly_canonical(fs::absolute(path, ignored), ignored);
  // What is not there at all, within the folder or not, is not opened: the reader says so.
  if (!unknown && std::mismatch(folder.begin(), folder.end(), file.begin(), file.end()).first == folder.end())
    return {};
  constexpr size_t kPrinted = 300;
  const std::string named = path.size() > kPrinted ? inQuotes(path) : "\"" + path + "\"";
  return Error{ErrorKind::kInvalidData,
               mesh,
               std::string("it names ") + what + " " + named + ", which lies outside its folder",
               "put it beside the mesh, or give --allow-outside",
               {}};
}

Result<LoadedMesh> readMesh(const std::string& path, const MeshReadOptions& options) {
  std::string extension = lowerCase(std::filesystem::path(path).extension().string());
  auto reader = extension == ".ply"                           ? readPly
                : extension == ".obj"                         ? readObj
                : extension == ".stl"                         ? readStl
                : extension == ".off"                         ? readOff
                : extension == ".glb" || extension == ".gltf" ? readGltf
                                                              : nullptr;
  if (!reader)
    return Error{
        ErrorKind::kUnsupported,
        path,
        "expected a mesh file (.ply, .obj, .stl, .off, .glb or .gltf), found the extension " + inQuotes(extension),
        "convert it to one of them",
        {}};
  if (options.mm_per_unit && (!(*options.mm_per_unit > 0) || !std::isfinite(*options.mm_per_unit)))
    return Error{ErrorKind::kUsage, path, "expected a unit of more than 0 mm", "", {}};
  auto file = InputFile::open(path);
  if (!file) return file.error();
  auto raw = reader(*file, options);
  if (!raw) return raw.error();
  auto beside = [&](std::string& named) {
    if (!named.empty() && std::filesystem::path(named).is_relative())
      named = (std::filesystem::path(path).parent_path() / named).string();
  };
  for (MeshImage& image : raw->images) {
    beside(image.file.path);
    beside(image.normals.file.path);
  }
  for (std::string& named : raw->named_files) beside(named);
  MeshReadOptions finishing = options;
  if (!finishing.mm_per_unit) finishing.mm_per_unit = raw->unit.empty() ? 1.0 : mmPerUnit(raw->unit);
  return finish(std::move(*raw), path, finishing);
}

double mmPerUnit(const std::string& unit) {
  return unit == "mm" ? 1 : unit == "cm" ? 10 : unit == "m" ? 1000 : unit == "in" ? 25.4 : 0;
}

glm::dmat3 turnOf(char up, const glm::dvec3& degrees) {
  // Columns: where x, y and z go.
  glm::dmat3 turn(1);
  if (up == 'x') turn = glm::dmat3(0, 1, 0, -1, 0, 0, 0, 0, 1);
  if (up == 'z') turn = glm::dmat3(1, 0, 0, 0, 0, -1, 0, 1, 0);
  return axisRotation(degrees) * turn;
}

Result<LoadedMesh> repairMesh(TriMesh mesh, const std::string& name, int workers) {
  LoadedMesh out;
  out.mesh = std::move(mesh);
  const TriMesh& m = out.mesh;
  out.diagnosis.vertices_read = m.positions_mm.size();
  out.diagnosis.triangles_read = m.triangles.size();
  if (m.triangles.empty()) return invalid(name, "expected a surface, found no triangle");
  if (m.triangles.size() > kMaxTriangles || m.positions_mm.size() > kMaxVertices)
    return invalid(name, "expected at most " + std::to_string(kMaxTriangles) + " triangles, found " +
                             std::to_string(m.triangles.size()));
  if (!m.colours.empty() && m.colours.size() != m.positions_mm.size())
    return invalid(name, "expected a colour a vertex (" + std::to_string(m.positions_mm.size()) + "), found " +
                             std::to_string(m.colours.size()));
  if (!m.corner_uv.empty() && m.corner_uv.size() != m.triangles.size())
    return invalid(name, "expected texture coordinates of " + std::to_string(m.triangles.size()) +
                             " triangles, found " + std::to_string(m.corner_uv.size()));
  if (!m.image_of.empty() && m.image_of.size() != m.triangles.size())
    return invalid(name, "expected images of " + std::to_string(m.triangles.size()) + " triangles, found " +
                             std::to_string(m.image_of.size()));
  for (const uint16_t image : m.image_of)
    if (image != kNoImage && image >= m.images.size())
      return invalid(name, "a triangle names image " + std::to_string(image) + ", there are " +
                               std::to_string(m.images.size()) + " (from 0)");
  for (size_t i = 0; i < m.positions_mm.size(); ++i)
    if (std::string problem = finiteProblem(glm::dvec3(m.positions_mm[i]) + m.origin_mm, i, 1); !problem.empty())
      return invalid(name, problem);
  for (size_t t = 0; t < m.triangles.size(); ++t)
    for (uint32_t v : m.triangles[t])
      if (v >= m.positions_mm.size())
        return invalid(name, "triangle " + std::to_string(t) + " names vertex " + std::to_string(v) + ", there are " +
                                 std::to_string(m.positions_mm.size()) + " (from 0)");
  for (size_t t = 0; t < m.corner_uv.size(); ++t)
    for (const glm::vec2& uv : m.corner_uv[t])
      if (!std::isfinite(uv.x) || !std::isfinite(uv.y))
        return invalid(name, "triangle " + std::to_string(t) + ": expected finite texture coordinates");
  if (auto repaired = repairTriangles(out.mesh, out.diagnosis, name, {}, nullptr, workers, 0); !repaired)
    return repaired.error();
  return out;
}

}  // namespace relievo
