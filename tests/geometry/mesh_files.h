// mesh_files.h - meshes to test reading with, and writers of all formats, straight from the formats' descriptions.
#pragma once

#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <random>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"

namespace relievo::test {

// A folder of this process's own, removed at its end.
inline const std::filesystem::path& meshFolder() {
  struct Folder {
    std::filesystem::path path =
        std::filesystem::temp_directory_path() / ("relievo_mesh_test_" + std::to_string(::getpid()));
    Folder() { std::filesystem::create_directories(path); }
    ~Folder() { std::filesystem::remove_all(path); }
  };
  static const Folder folder;
  return folder.path;
}
inline std::string saveFile(const std::string& name, const std::string& bytes) {
  const std::string path = meshFolder() / name;
  std::filesystem::remove(path);  // file systems flush a file that is rewritten in place, which takes its time
  std::ofstream(path, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  return path;
}

// Of a mesh that was read: the path of an image, or nothing; its palette, or nothing.
inline std::string imagePath(const TriMesh& mesh, size_t image = 0) {
  return image < mesh.images.size() ? mesh.images[image].file.path : "";
}
inline std::vector<glm::u8vec3> paletteOf(const TriMesh& mesh) {
  return mesh.images.empty() ? std::vector<glm::u8vec3>() : mesh.images.back().palette;
}

// What a file holds: doubles, and attributes as bytes and floats.
struct Sample {
  std::vector<glm::dvec3> positions;
  std::vector<std::array<uint32_t, 3>> triangles;
  std::vector<glm::u8vec3> colours;                 // a vertex; or empty
  std::vector<std::array<glm::vec2, 3>> corner_uv;  // a triangle; or empty
  std::vector<glm::vec3> normals;                   // a vertex; or empty; in glTF files
  std::vector<glm::vec4> tangents;                  // a vertex; or empty; in glTF files
};

// A closed surface that faces outwards: a cube of n x n quads a side, blown up to a sphere. Coordinates are multiples
// of 2^-12, so that every format holds them exactly.
inline Sample scanOfCubeSphere(int n, double radius = 100, glm::dvec3 centre = {0, 0, 0}) {
  Sample s;
  std::map<std::array<int, 3>, uint32_t> named;
  auto vertex = [&](glm::ivec3 p) {
    auto [at, fresh] = named.try_emplace({p.x, p.y, p.z}, static_cast<uint32_t>(s.positions.size()));
    if (fresh) {
      glm::dvec3 d = glm::normalize(glm::dvec3(2 * p - n));
      s.positions.push_back(centre + glm::round(d * radius * 4096.0) / 4096.0);
    }
    return at->second;
  };
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side)
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) {
          auto at = [&](int di, int dj) {
            glm::ivec3 p(0);
            p[axis] = side * n;
            p[(axis + 1) % 3] = i + di;
            p[(axis + 2) % 3] = j + dj;
            return vertex(p);
          };
          uint32_t a = at(0, 0), b = at(1, 0), c = at(1, 1), d = at(0, 1);
          if (side == 0) std::swap(b, d);
          s.triangles.push_back({a, b, c});
          s.triangles.push_back({a, c, d});
        }
  return s;
}
// An open sheet of w x h quads of the given size, in z = 0, seen from +z.
inline Sample sheet(int w, int h, double size = 1) {
  Sample s;
  for (int y = 0; y <= h; ++y)
    for (int x = 0; x <= w; ++x) s.positions.emplace_back(x * size, y * size, 0);
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      auto a = static_cast<uint32_t>(y * (w + 1) + x), up = static_cast<uint32_t>(w + 1);
      s.triangles.push_back({a, a + 1, a + up + 1});
      s.triangles.push_back({a, a + up + 1, a + up});
    }
  return s;
}
inline void append(Sample& to, const Sample& more) {
  auto base = static_cast<uint32_t>(to.positions.size());
  to.positions.insert(to.positions.end(), more.positions.begin(), more.positions.end());
  for (auto t : more.triangles) to.triangles.push_back({t[0] + base, t[1] + base, t[2] + base});
}
inline void decorate(Sample& s, uint32_t seed) {
  std::mt19937 random(seed);
  for (size_t i = 0; i < s.positions.size(); ++i)
    s.colours.emplace_back(static_cast<uint8_t>(random()), static_cast<uint8_t>(random()),
                           static_cast<uint8_t>(random()));
  for (size_t t = 0; t < s.triangles.size(); ++t) {
    std::array<glm::vec2, 3> uv;
    for (auto& at : uv) at = {static_cast<float>(random() % 4096) / 4096, static_cast<float>(random() % 4096) / 4096};
    s.corner_uv.push_back(uv);
  }
}
inline TriMesh toMesh(const Sample& s, glm::dvec3 origin = {0, 0, 0}) {
  TriMesh m;
  m.origin_mm = origin;
  for (const glm::dvec3& p : s.positions) m.positions_mm.emplace_back(p - origin);
  m.triangles = s.triangles;
  m.colours = s.colours;
  m.corner_uv = s.corner_uv;
  return m;
}

// Six times the volume, its sign positive if the triangles face outwards.
inline double signedVolume(const TriMesh& m) {
  double sum = 0;
  for (const auto& t : m.triangles)
    sum += glm::dot(glm::dvec3(m.positions_mm[t[0]]),
                    glm::cross(glm::dvec3(m.positions_mm[t[1]]), glm::dvec3(m.positions_mm[t[2]])));
  return sum;
}
inline double area(const TriMesh& m) {
  double sum = 0;
  for (const auto& t : m.triangles) {
    glm::dvec3 a(m.positions_mm[t[0]]);
    sum += 0.5 * glm::length(glm::cross(glm::dvec3(m.positions_mm[t[1]]) - a, glm::dvec3(m.positions_mm[t[2]]) - a));
  }
  return sum;
}

template <class T>
void put(std::string& out, T value, bool big_endian = false) {
  char bytes[sizeof(T)];
  std::memcpy(bytes, &value, sizeof(T));
  if (big_endian) std::reverse(bytes, bytes + sizeof(T));
  out.append(bytes, sizeof(T));
}
inline std::string number(double v) {
  char text[40];
  std::snprintf(text, sizeof text, "%.17g", v);
  return text;
}

enum class Encoding { kAscii, kLittle, kBig };
struct PlyLayout {
  Encoding encoding = Encoding::kLittle;
  std::string coordinate = "float";  // any scalar type
  std::string colour = "uchar";      // uchar, ushort, float; none: no colours
  std::string index = "int";
  std::string count = "uchar";
  bool vertex_uv = false;  // s, t of the vertex instead of texcoord by corner (of the vertex's first corner)
  bool clutter = false;    // further properties and elements around what is wanted
  const char* line_end = "\n";
};
inline void putScalar(std::string& out, const std::string& type, double v, Encoding e) {
  bool big = e == Encoding::kBig;
  if (e == Encoding::kAscii) out += number(v) + " ";
  else if (type == "char" || type == "int8") put(out, static_cast<int8_t>(v));
  else if (type == "uchar" || type == "uint8") put(out, static_cast<uint8_t>(v));
  else if (type == "short" || type == "int16") put(out, static_cast<int16_t>(v), big);
  else if (type == "ushort" || type == "uint16") put(out, static_cast<uint16_t>(v), big);
  else if (type == "int" || type == "int32") put(out, static_cast<int32_t>(v), big);
  else if (type == "uint" || type == "uint32") put(out, static_cast<uint32_t>(v), big);
  else if (type == "float" || type == "float32") put(out, static_cast<float>(v), big);
  else put(out, v, big);
}
inline std::string plyFile(const Sample& s, const PlyLayout& l) {
  const bool colours = !s.colours.empty() && l.colour != "none", uv = !s.corner_uv.empty();
  std::vector<glm::vec2> vertex_uv(s.positions.size());
  for (size_t t = s.corner_uv.size(); t-- > 0;)
    for (size_t k = 0; k < 3; ++k) vertex_uv[s.triangles[t][k]] = s.corner_uv[t][k];
  std::string e = l.line_end, out = "ply" + e + "format ";
  out += (l.encoding == Encoding::kAscii    ? "ascii"
          : l.encoding == Encoding::kLittle ? "binary_little_endian"
                                            : "binary_big_endian");
  out += " 1.0" + e + "comment made for a test" + e;
  if (uv) out += "comment TextureFile image of a test.png" + e;
  if (l.clutter)
    out += "obj_info none" + e + "element camera 2" + e + "property double focus" + e +
           "property list ushort short rows" + e;
  out += "element vertex " + std::to_string(s.positions.size()) + e;
  if (l.clutter) out += "property short quality" + e;
  for (const char* axis : {"x", "y", "z"}) out += "property " + l.coordinate + " " + axis + e;
  if (l.clutter) out += "property list uchar int neighbours" + e;
  if (colours)
    for (const char* c : {"red", "green", "blue"}) out += "property " + l.colour + " " + c + e;
  if (uv && l.vertex_uv) out += "property float s" + e + "property float t" + e;
  out += "element face " + std::to_string(s.triangles.size()) + e;
  if (l.clutter) out += "property float weight" + e;
  out += "property list " + l.count + " " + l.index + " vertex_indices" + e;
  if (uv && !l.vertex_uv) out += "property list uchar float texcoord" + e;
  if (l.clutter) out += "property uchar flags" + e + "element edge 1" + e + "property int vertex1" + e;
  out += "end_header" + e;
  auto scalar = [&](const std::string& type, double v) { putScalar(out, type, v, l.encoding); };
  auto end = [&] {
    if (l.encoding == Encoding::kAscii) out += e;
  };
  if (l.clutter)
    for (int k = 0; k < 2; ++k) {
      scalar("double", 0.5);
      scalar("ushort", 2);
      scalar("short", -3);
      scalar("short", 4);
      end();
    }
  for (size_t i = 0; i < s.positions.size(); ++i) {
    if (l.clutter) scalar("short", -7);
    for (int c = 0; c < 3; ++c) scalar(l.coordinate, s.positions[i][c]);
    if (l.clutter) {
      scalar("uchar", 3);
      for (int k = 0; k < 3; ++k) scalar("int", 1000 + k);
    }
    if (colours)
      for (int c = 0; c < 3; ++c) {
        double v = s.colours[i][c];
        scalar(l.colour, l.colour == "ushort" ? v * 257 : l.colour == "float" ? v / 255 : v);
      }
    if (uv && l.vertex_uv)
      for (int c = 0; c < 2; ++c) scalar("float", vertex_uv[i][c]);
    end();
  }
  for (size_t t = 0; t < s.triangles.size(); ++t) {
    if (l.clutter) scalar("float", 1.5);
    scalar(l.count, 3);
    for (uint32_t v : s.triangles[t]) scalar(l.index, v);
    if (uv && !l.vertex_uv) {
      scalar("uchar", 6);
      for (const glm::vec2& at : s.corner_uv[t])
        for (int c = 0; c < 2; ++c) scalar("float", at[c]);
    }
    if (l.clutter) scalar("uchar", 255);
    end();
  }
  if (l.clutter) {
    scalar("int", 1);
    end();
  }
  return out;
}

inline std::string objFile(const Sample& s, bool negative_indices = false) {
  std::string out = "# a test\nmtllib test.mtl\no thing\n";
  for (size_t i = 0; i < s.positions.size(); ++i) {
    out += "v";
    for (int c = 0; c < 3; ++c) out += " " + number(s.positions[i][c]);
    if (!s.colours.empty())
      for (int c = 0; c < 3; ++c) out += " " + number(s.colours[i][c] / 255.0);
    out += "\n";
  }
  for (const auto& t : s.corner_uv)
    for (const glm::vec2& uv : t) out += "vt " + number(uv.x) + " " + number(uv.y) + "\n";
  out += "vn 0 0 1\nusemtl surface\ns off\n";
  auto n = static_cast<int64_t>(s.positions.size()), m = static_cast<int64_t>(3 * s.corner_uv.size());
  for (size_t t = 0; t < s.triangles.size(); ++t) {
    out += "f";
    for (size_t k = 0; k < 3; ++k) {
      int64_t v = s.triangles[t][k] + int64_t{1}, vt = static_cast<int64_t>(3 * t + k + 1);
      if (negative_indices) v -= n + 1, vt -= m + 1;
      out += " " + std::to_string(v) + (s.corner_uv.empty() ? "//1" : "/" + std::to_string(vt) + "/1");
    }
    out += "\n";
  }
  return out;
}

inline std::string offFile(const Sample& s, bool binary = false) {
  std::string out = s.colours.empty() ? "OFF" : "COFF";
  if (binary) {
    out += " BINARY\n";
    for (size_t n : {s.positions.size(), s.triangles.size(), size_t{0}}) put(out, static_cast<int32_t>(n), true);
    for (size_t i = 0; i < s.positions.size(); ++i) {
      for (int c = 0; c < 3; ++c) put(out, static_cast<float>(s.positions[i][c]), true);
      for (int c = 0; c < 4 && !s.colours.empty(); ++c)
        put(out, c == 3 ? 1.0f : static_cast<float>(s.colours[i][c] / 255.0), true);
    }
    for (const auto& t : s.triangles) {
      put(out, int32_t{3}, true);
      for (uint32_t v : t) put(out, static_cast<int32_t>(v), true);
      put(out, int32_t{0}, true);
    }
    return out;
  }
  out += "\n# a test\n" + std::to_string(s.positions.size()) + " " + std::to_string(s.triangles.size()) + " 0\n\n";
  for (size_t i = 0; i < s.positions.size(); ++i) {
    for (int c = 0; c < 3; ++c) out += number(s.positions[i][c]) + " ";
    for (int c = 0; c < 4 && !s.colours.empty(); ++c)
      out += std::to_string(c == 3 ? 255 : static_cast<int>(s.colours[i][c])) + " ";
    out += "\n";
  }
  for (const auto& t : s.triangles)
    out += "3 " + std::to_string(t[0]) + " " + std::to_string(t[1]) + " " + std::to_string(t[2]) + "\n";
  return out;
}

inline std::string stlFile(const Sample& s, bool binary, const std::string& header = "solid and yet binary") {
  std::string out;
  if (binary) {
    out = header;
    out.resize(80);
    put(out, static_cast<uint32_t>(s.triangles.size()));
    for (const auto& t : s.triangles) {
      for (int c = 0; c < 3; ++c) put(out, 0.0f);
      for (uint32_t v : t)
        for (int c = 0; c < 3; ++c) put(out, static_cast<float>(s.positions[v][c]));
      put(out, uint16_t{0});
    }
    return out;
  }
  out = "solid a test\n";
  for (const auto& t : s.triangles) {
    out += "  facet normal 0 0 0\n    outer loop\n";
    for (uint32_t v : t)
      out += "      vertex " + number(s.positions[v].x) + " " + number(s.positions[v].y) + " " +
             number(s.positions[v].z) + "\n";
    out += "    endloop\n  endfacet\n";
  }
  return out + "endsolid a test\n";
}

inline std::string base64(const std::string& bytes) {
  constexpr const char* kLetters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (size_t i = 0; i < bytes.size(); i += 3) {
    uint32_t three = 0;
    const size_t n = std::min<size_t>(3, bytes.size() - i);
    for (size_t k = 0; k < 3; ++k) three = three << 8 | (k < n ? static_cast<uint8_t>(bytes[i + k]) : 0u);
    for (size_t k = 0; k < 4; ++k) out += k <= n ? kLetters[three >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}
inline std::string glbOf(std::string json, std::string binary) {
  json.resize((json.size() + 3) / 4 * 4, ' ');
  binary.resize((binary.size() + 3) / 4 * 4, '\0');
  std::string out = "glTF";
  put(out, uint32_t{2});
  put(out, static_cast<uint32_t>(12 + 8 + json.size() + (binary.empty() ? 0 : 8 + binary.size())));
  put(out, static_cast<uint32_t>(json.size()));
  out += "JSON" + json;
  if (binary.empty()) return out;
  put(out, static_cast<uint32_t>(binary.size()));
  return out + std::string("BIN\0", 4) + binary;
}
// A mesh of one primitive with indices: floats, 32-bit indices; colours as given bytes of linear light; texture
// coordinates of the vertex's first corner. `tail` goes behind the lists of the file ("" or ", ...").
struct GltfText {
  std::string json, binary;
};
inline GltfText gltfOf(const Sample& s, const std::string& buffer_uri, const std::string& tail = "",
                       const std::string& node = "\"mesh\":0") {
  GltfText out;
  std::string views, accessors;
  auto add = [&](const std::string& bytes, size_t count, int component, const char* type, const char* more) {
    if (!views.empty()) views += ",", accessors += ",";
    const auto view = static_cast<size_t>(std::count(views.begin(), views.end(), '{'));
    views += "{\"buffer\":0,\"byteOffset\":" + std::to_string(out.binary.size()) +
             ",\"byteLength\":" + std::to_string(bytes.size()) + "}";
    accessors += "{\"bufferView\":" + std::to_string(view) + ",\"componentType\":" + std::to_string(component) +
                 ",\"count\":" + std::to_string(count) + ",\"type\":\"" + type + "\"" + more + "}";
    out.binary += bytes;
    out.binary.resize((out.binary.size() + 3) / 4 * 4, '\0');
    return std::to_string(view);
  };
  std::string positions, indices, colours, uv;
  for (const glm::dvec3& p : s.positions)
    for (int c = 0; c < 3; ++c) put(positions, static_cast<float>(p[c]));
  for (const auto& t : s.triangles)
    for (const uint32_t v : t) put(indices, v);
  std::string attributes = "\"POSITION\":" + add(positions, s.positions.size(), 5126, "VEC3", "");
  const std::string index = add(indices, 3 * s.triangles.size(), 5125, "SCALAR", "");
  if (!s.colours.empty()) {
    for (const glm::u8vec3& c : s.colours) {
      for (int k = 0; k < 3; ++k) put(colours, c[k]);
      put(colours, uint8_t{255});
    }
    attributes += ",\"COLOR_0\":" + add(colours, s.colours.size(), 5121, "VEC4", ",\"normalized\":true");
  }
  if (!s.corner_uv.empty()) {
    std::vector<glm::vec2> of(s.positions.size());
    for (size_t t = s.triangles.size(); t-- > 0;)
      for (size_t k = 0; k < 3; ++k) of[s.triangles[t][k]] = s.corner_uv[t][k];
    for (const glm::vec2& at : of) put(uv, at.x), put(uv, 1 - at.y);
    attributes += ",\"TEXCOORD_0\":" + add(uv, of.size(), 5126, "VEC2", "");
  }
  std::string normals, tangents;
  for (const glm::vec3& n : s.normals)
    for (int c = 0; c < 3; ++c) put(normals, n[c]);
  if (!s.normals.empty()) attributes += ",\"NORMAL\":" + add(normals, s.normals.size(), 5126, "VEC3", "");
  for (const glm::vec4& t : s.tangents)
    for (int c = 0; c < 4; ++c) put(tangents, t[c]);
  if (!s.tangents.empty()) attributes += ",\"TANGENT\":" + add(tangents, s.tangents.size(), 5126, "VEC4", "");
  const bool material = tail.find("materials") != tail.npos;
  out.json = "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{" + node +
             "}],\"meshes\":[{\"primitives\":[{\"attributes\":{" + attributes + "},\"indices\":" + index +
             (material ? ",\"material\":0" : "") + "}]}],\"bufferViews\":[" + views + "],\"accessors\":[" + accessors +
             "],\"buffers\":[{" + (buffer_uri.empty() ? "" : "\"uri\":\"" + buffer_uri + "\",") +
             "\"byteLength\":" + std::to_string(out.binary.size()) + "}]" + tail + "}";
  return out;
}
inline std::string glbFile(const Sample& s, const std::string& tail = "", const std::string& node = "\"mesh\":0") {
  const GltfText text = gltfOf(s, "", tail, node);
  return glbOf(text.json, text.binary);
}
inline std::string gltfFile(const Sample& s, const std::string& tail = "", const std::string& node = "\"mesh\":0") {
  const std::string binary = gltfOf(s, "", tail, node).binary;
  return gltfOf(s, "data:application/octet-stream;base64," + base64(binary), tail, node).json;
}

}  // namespace relievo::test
