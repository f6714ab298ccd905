#include "tools/export/mesh_format.h"

#include <algorithm>
#include <bit>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstring>

#include "src/base/printable.h"
#include "tools/export/mesh_format_glb.h"

namespace relievo {
namespace {

void putText(ByteBuffer& out, std::string_view text) { out.insert(out.end(), text.begin(), text.end()); }
ByteBuffer textBytes(std::string_view text) { return {text.begin(), text.end()}; }

void putNumber(ByteBuffer& out, double value, int decimals) {
  char text[400];  // a double has at most 309 digits before its point
  const auto [end, bad] = std::to_chars(text, text + sizeof text, value, std::chars_format::fixed, decimals);
  if (bad == std::errc()) putText(out, {text, static_cast<size_t>(end - text)});
}
void putCount(ByteBuffer& out, uint64_t value) { putText(out, std::to_string(value)); }
std::string exactText(double value) {
  char text[40];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}
std::string pointText(const glm::dvec3& p) { return exactText(p.x) + " " + exactText(p.y) + " " + exactText(p.z); }

glm::dvec3 shown(const MeshFacts& f, const glm::dvec3& p) { return countsFromOrigin(f) ? p : p + f.origin; }
std::string unitText(const MeshFacts& f) { return f.size_known ? "mm" : "pixels (the artwork's size is not known)"; }
std::string originText(const MeshFacts& f) {
  return "origin " + pointText(f.origin) + ": add it to the positions for the scan's own coordinates";
}
// Decimals that keep 2^-27 of the mesh's extent, somewhat more than a float does.
int decimalsOf(const MeshFacts& f) {
  return std::clamp(static_cast<int>(std::ceil(-std::log10(f.extent * 7.5e-9))), 0, 12);
}

class PlyFormat final : public MeshFormat {
 public:
  bool quads() const override { return true; }
  ByteBuffer head(const MeshFacts& f) const override {
    std::string text =
        "ply\nformat binary_little_endian 1.0\ncomment " + f.about + "\ncomment unit " + unitText(f) + "\n";
    if (countsFromOrigin(f)) text += "comment " + originText(f) + "\n";
    text += "element vertex " + std::to_string(f.vertices) + "\n";
    for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) text += std::string("property float ") + name + "\n";
    if (f.colours)
      for (const char* name : {"red", "green", "blue"}) text += std::string("property uchar ") + name + "\n";
    return textBytes(text + "element face " + std::to_string(f.faces) +
                     "\nproperty list uchar int vertex_indices\nend_header\n");
  }
  void vertex(const MeshFacts& f, const ExportVertex& v, ByteBuffer& out) const override {
    put(out, glm::vec3(shown(f, v.position)));
    put(out, v.normal);
    if (f.colours) put(out, v.colour);
  }
  void face(const std::array<uint32_t, 4>& corners, int count, ByteBuffer& out) const override {
    out.push_back(static_cast<uint8_t>(count));
    for (int k = 0; k < count; ++k) put(out, corners[static_cast<size_t>(k)]);
  }
};

// Colours behind the coordinates, 0 to 1, as MeshLab and Blender read them.
class ObjFormat final : public MeshFormat {
 public:
  bool quads() const override { return true; }
  ByteBuffer head(const MeshFacts& f) const override {
    return textBytes("# " + f.about + "\n# unit " + unitText(f) + "\n");
  }
  void vertex(const MeshFacts& f, const ExportVertex& v, ByteBuffer& out) const override {
    const glm::dvec3 p = v.position + f.origin;
    putText(out, "v");
    auto numbers = [&](const auto& values, int decimals) {
      for (glm::length_t c = 0; c < 3; ++c) out.push_back(' '), putNumber(out, values[c], decimals);
    };
    numbers(p, decimalsOf(f));
    if (f.colours) numbers(glm::dvec3(v.colour) / 255.0, 4);
    putText(out, "\nvn");
    numbers(v.normal, 5);
    out.push_back('\n');
  }
  void face(const std::array<uint32_t, 4>& corners, int count, ByteBuffer& out) const override {
    out.push_back('f');
    for (int k = 0; k < count; ++k) {
      const uint64_t index = uint64_t{corners[static_cast<size_t>(k)]} + 1;
      out.push_back(' ');
      putCount(out, index);
      putText(out, "//");
      putCount(out, index);
    }
    out.push_back('\n');
  }
};

class OffFormat final : public MeshFormat {
 public:
  bool quads() const override { return true; }
  ByteBuffer head(const MeshFacts& f) const override {
    return textBytes(std::string(f.colours ? "COFF" : "OFF") + "\n# " + f.about + "\n# unit " + unitText(f) + "\n" +
                     std::to_string(f.vertices) + " " + std::to_string(f.faces) + " 0\n");
  }
  void vertex(const MeshFacts& f, const ExportVertex& v, ByteBuffer& out) const override {
    const glm::dvec3 p = v.position + f.origin;
    for (glm::length_t c = 0; c < 3; ++c) {
      if (c > 0) out.push_back(' ');
      putNumber(out, p[c], decimalsOf(f));
    }
    if (f.colours) {
      for (glm::length_t c = 0; c < 3; ++c) out.push_back(' '), putCount(out, v.colour[c]);
      putText(out, " 255");
    }
    out.push_back('\n');
  }
  void face(const std::array<uint32_t, 4>& corners, int count, ByteBuffer& out) const override {
    putCount(out, static_cast<uint64_t>(count));
    for (int k = 0; k < count; ++k) out.push_back(' '), putCount(out, corners[static_cast<size_t>(k)]);
    out.push_back('\n');
  }
};

class StlFormat final : public MeshFormat {
 public:
  bool quads() const override { return false; }
  bool soup() const override { return true; }
  ByteBuffer head(const MeshFacts& f) const override {
    // 80 bytes: what does not fit is cut, so the origin comes first.
    std::string text = countsFromOrigin(f) ? "origin " + pointText(f.origin) + " " : "";
    text += f.size_known ? "mm " : "px ";
    text += f.about;
    ByteBuffer out = textBytes(text);
    out.resize(80, 0);
    put(out, static_cast<uint32_t>(f.faces));
    return out;
  }
  void triangle(const MeshFacts& f, const std::array<glm::dvec3, 3>& corners, ByteBuffer& out) const override {
    const glm::dvec3 cross = glm::cross(corners[1] - corners[0], corners[2] - corners[0]);
    const double length = glm::length(cross);
    put(out, length > 0 ? glm::vec3(cross / length) : glm::vec3(0));
    for (const glm::dvec3& p : corners) put(out, glm::vec3(shown(f, p)));
    put(out, uint16_t{0});
  }
};

}  // namespace

bool countsFromOrigin(const MeshFacts& f) {
  return std::max({std::abs(f.origin.x), std::abs(f.origin.y), std::abs(f.origin.z)}) > 15 * f.extent;
}

// Indices of 31 bits: readers of PLY take them as signed.
Result<void> MeshFormat::check(const std::string& path, const MeshFacts& facts) const {
  constexpr uint64_t kMost = (uint64_t{1} << 31) - 1;
  if (facts.vertices <= kMost && facts.faces <= kMost) return {};
  return Error{ErrorKind::kUsage,
               path,
               "expected at most 2^31 - 1 vertices and faces, found " + std::to_string(facts.vertices) + " and " +
                   std::to_string(facts.faces),
               "choose a coarser --level, or allow an --error-mm",
               {}};
}

Result<std::unique_ptr<MeshFormat>> meshFormatOf(const std::string& path) {
  const size_t dot = path.find_last_of("./");
  std::string suffix = dot == std::string::npos || path[dot] != '.' ? "" : path.substr(dot);
  for (char& c : suffix) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  std::unique_ptr<MeshFormat> format;
  if (suffix == ".ply") format = std::make_unique<PlyFormat>();
  if (suffix == ".obj") format = std::make_unique<ObjFormat>();
  if (suffix == ".stl") format = std::make_unique<StlFormat>();
  if (suffix == ".off") format = std::make_unique<OffFormat>();
  if (suffix == ".glb") format = makeGlbFormat();
  if (format) return format;
  return Error{ErrorKind::kUsage,
               path,
               "expected a mesh's name that ends in .ply, .obj, .stl, .off or .glb, found " +
                   (suffix.empty() ? "none of these" : suffix),
               "the name says which format is written",
               {}};
}

}  // namespace relievo
