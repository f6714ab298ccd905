// mesh_read_off.cpp - OFF (Geomview): [ST][C][N]OFF, text and BINARY (big-endian; little-endian where only that fits
// the file; faces without their count of colours where only that fits, as the library pmp writes them). Vertex colours
// behind the coordinates are taken in files without the C, too. Faces' colours, up to their line's end, are read over.
// A text face may go on over several lines if it has no colours: a line that lacks corners could not be told from one
// that goes on where the next one's first numbers are corners, and its others colours.
#include <bit>
#include <cmath>
#include <cstring>

#include "geometry/scan/mesh_file.h"

namespace relievo::mesh_file {
namespace {

class OffReader {
 public:
  // Of a binary file: does a count of colours, and colours, follow the corners of each face?
  enum class FaceColours { kCounted, kNone };
  OffReader(const InputFile& file, const MeshReadOptions& options, FaceColours colours)
      : in_(file, options), cutter_(mesh_), face_colours_(colours) {}
  bool isBinary() const { return binary_; }

  Result<RawMesh> read() {
    readHeader();
    for (uint64_t i = 0; i < vertices_ && !in_.failed(); ++i) binary_ ? binaryVertex() : textVertex(i);
    for (uint64_t i = 0; i < faces_ && !in_.failed(); ++i) {
      binary_ ? binaryFace(i) : textFace(i);
      if (mesh_.triangles.size() > kMaxTriangles)
        in_.note("expected at most " + std::to_string(kMaxTriangles) + " triangles");
    }
    if (face_colours_ == FaceColours::kNone && in_.left() > 0) in_.note("expected the end of the file");
    if (in_.failed()) return in_.error();
    mesh_.vertices_read = vertices_;
    if (face_colours_ == FaceColours::kNone)
      mesh_.findings.push_back({"binary OFF without counts of colours", 1, {}, "read as such"});
    if (!mesh_.float_colours.empty()) mesh_.float_colours.resize(mesh_.positions.size(), glm::vec3(1));
    if (cutter_.dropped() > 0)
      mesh_.findings.push_back({"faces of fewer than three corners", cutter_.dropped(), {}, "dropped"});
    return std::move(mesh_);
  }

 private:
  // The next line that is not blank, without its comment. False: there is none.
  bool nextLine(std::string_view& text) {
    while (in_.line(text)) {
      const size_t comment = std::min(text.find('#'), text.size());
      if (mesh_.unit.empty() && comment < text.size()) mesh_.unit = unitOfComment(text.substr(comment + 1));
      text = text.substr(0, comment);
      std::string_view rest = text;
      if (!nextItem(rest).empty()) return true;
    }
    return false;
  }
  bool line(std::string_view& text, const char* what) {
    if (nextLine(text)) return true;
    in_.endOfFile(what);
    return false;
  }

  void readHeader() {
    std::string_view text;
    if (!line(text, "OFF")) return;
    std::string_view whole = text, key = nextItem(text), kind = key;
    auto prefix = [&](std::string_view p) {
      bool there = kind.starts_with(p);
      if (there) kind.remove_prefix(p.size());
      return there;
    };
    has_uv_ = prefix("ST");
    has_colours_ = prefix("C");
    has_normals_ = prefix("N");
    if (kind == "4OFF" || kind == "nOFF" || kind == "4nOFF")
      return in_.note("expected three coordinates a vertex, found " + inQuotes(key), "write it in three dimensions",
                      ErrorKind::kUnsupported);
    if (kind != "OFF")
      return in_.note("expected OFF as the first word, found " + inQuotes(whole), "this is no OFF file");
    std::string_view rest = text, next = nextItem(rest);
    if (next == "BINARY") {
      binary_ = true;
      readBinaryCounts();
    } else {
      if (next.empty() && !line(text, "the counts of vertices and faces")) return;
      whole = text;
      std::string_view v = nextItem(text), f = nextItem(text);
      if (!parseNumber(v, vertices_) || !parseNumber(f, faces_))
        return in_.note("expected the counts of vertices and faces, found " + inQuotes(whole));
    }
    if (in_.failed()) return;
    if (!fits(vertices_, faces_))
      return in_.note("expected " + std::to_string(vertices_) + " vertices and " + std::to_string(faces_) +
                          " faces, found " + std::to_string(in_.left()) + " bytes left in the file",
                      "it is truncated, or states more than it holds; get a whole copy");
    mesh_.positions.reserve(vertices_);
    mesh_.triangles.reserve(std::min(faces_, (in_.left() + 1) / 8));
  }

  bool fits(uint64_t vertices, uint64_t faces) const {
    // "0 0 0" and "3 0 1 2" with their line ends, the last of which may lack; "0" for a face that is none.
    const uint64_t vertex_bytes = binary_ ? 12 : 6, face_bytes = binary_ ? 8 : 2, left = in_.left() + 1;
    return vertices <= left / vertex_bytes && faces <= (left - vertices * vertex_bytes) / face_bytes &&
           vertices <= kMaxVertices;
  }

  // The format's numbers are big-endian; some programs write their own machine's. Counts tell which, as swapped ones
  // are far too large.
  void readBinaryCounts() {
    uint32_t counts[3];
    for (uint32_t& count : counts) count = static_cast<uint32_t>(word("the counts"));
    vertices_ = counts[0];
    faces_ = counts[1];
    const uint32_t vertices = __builtin_bswap32(counts[0]), faces = __builtin_bswap32(counts[1]);
    if (in_.failed() || fits(vertices_, faces_) || !fits(vertices, faces)) return;
    little_endian_ = true;
    vertices_ = vertices;
    faces_ = faces;
    mesh_.findings.push_back({"binary OFF in little-endian order", 1, {}, "read as such"});
  }

  int32_t word(const char* what) {
    const uint8_t* p = in_.take(4, what);
    if (!p) return 0;
    if (little_endian_)
      return static_cast<int32_t>(static_cast<uint32_t>(p[3]) << 24 | static_cast<uint32_t>(p[2]) << 16 |
                                  static_cast<uint32_t>(p[1]) << 8 | p[0]);
    return static_cast<int32_t>(static_cast<uint32_t>(p[0]) << 24 | static_cast<uint32_t>(p[1]) << 16 |
                                static_cast<uint32_t>(p[2]) << 8 | p[3]);
  }
  float number(const char* what) { return std::bit_cast<float>(word(what)); }

  void binaryVertex() {
    glm::dvec3 p(0);
    for (int c = 0; c < 3; ++c) p[c] = number("more vertices");
    mesh_.positions.push_back(p);
    for (int c = 0; c < 3 && has_normals_; ++c) number("more normals");
    if (has_colours_) {
      glm::vec3 colour(0);
      for (int c = 0; c < 3; ++c) colour[c] = number("more colours");
      number("more colours");
      mesh_.float_colours.push_back(colour);
    }
    if (has_uv_) {
      glm::vec2 uv(0);
      for (int c = 0; c < 2; ++c) uv[c] = number("more texture coordinates");
      uv_.push_back(uv);
    }
  }

  bool corner(int64_t v, uint64_t face) {
    if (v < 0 || v >= static_cast<int64_t>(mesh_.positions.size())) {
      in_.note("face " + std::to_string(face) + " names vertex " + std::to_string(v) + ", there are " +
               std::to_string(mesh_.positions.size()) + " (from 0)");
      return false;
    }
    corners_.push_back(static_cast<uint32_t>(v));
    if (has_uv_) corner_uv_.push_back(uv_[static_cast<size_t>(v)]);
    return true;
  }

  void binaryFace(uint64_t face) {
    corners_.clear();
    corner_uv_.clear();
    auto n = static_cast<uint32_t>(word("more faces"));
    if (n > in_.left() / 4)
      return in_.note("face " + std::to_string(face) + " states " + std::to_string(n) + " corners, " +
                      std::to_string(in_.left()) + " bytes are left in the file");
    for (uint32_t k = 0; k < n; ++k)
      if (int32_t v = word("more corners"); in_.failed() || !corner(v, face)) return;
    auto colours = face_colours_ == FaceColours::kCounted ? static_cast<uint32_t>(word("more faces")) : 0;
    if (colours > in_.left() / 4)
      return in_.note("face " + std::to_string(face) + " states " + std::to_string(colours) + " colour values, " +
                      std::to_string(in_.left()) + " bytes are left in the file");
    for (uint32_t k = 0; k < colours; ++k) word("more colours");
    if (!in_.failed()) cutter_.add(corners_, corner_uv_);
  }

  void textVertex(uint64_t index) {
    std::string_view text;
    if (!line(text, "more vertices")) return;
    double v[16];
    size_t n = 0;
    for (std::string_view item = nextItem(text); !item.empty() && n < 16; item = nextItem(text))
      if (!parseNumber(item, v[n++]))
        return in_.note("expected a number of vertex " + std::to_string(index) + ", found " + inQuotes(item) +
                        " in line " + std::to_string(in_.lineNumber()));
    size_t uv = has_uv_ ? 2 : 0, before = 3u + (has_normals_ ? 3u : 0u);
    if (n < before + uv + (has_colours_ ? 3 : 0))
      return in_.note("vertex " + std::to_string(index) + " has " + std::to_string(n) + " numbers in line " +
                      std::to_string(in_.lineNumber()) + ", too few");
    mesh_.positions.emplace_back(v[0], v[1], v[2]);
    if (n >= before + uv + 3) {
      mesh_.float_colours.resize(mesh_.positions.size() - 1, glm::vec3(1));
      mesh_.float_colours.emplace_back(v[before], v[before + 1], v[before + 2]);
    }
    if (has_uv_) uv_.emplace_back(v[n - 2], v[n - 1]);
  }

  void textFace(uint64_t face) {
    std::string_view text;
    if (!line(text, "more faces")) return;
    corners_.clear();
    corner_uv_.clear();
    uint64_t n = 0;
    std::string_view count = nextItem(text);
    if (!parseNumber(count, n))
      return in_.note("expected face " + std::to_string(face) + "'s count of corners, found " + inQuotes(count) +
                      " in line " + std::to_string(in_.lineNumber()));
    const auto expected = [&] {
      return "expected " + std::to_string(n) + " corners of face " + std::to_string(face) + ", found ";
    };
    const auto inLine = [&] { return " in line " + std::to_string(in_.lineNumber()); };
    // A corner and what ends it take two bytes, but for the file's last one.
    if (n > (text.size() + in_.left() + 1) / 2)
      return in_.note(expected() + std::to_string(text.size() + in_.left()) +
                      " bytes left in the file behind their count" + inLine());
    const uint64_t first_line = in_.lineNumber();
    for (uint64_t k = 0; k < n; ++k) {
      int64_t v = 0;
      std::string_view item = nextItem(text);
      if (item.empty()) {
        if (!nextLine(text))
          return in_.note(expected() + "the end of the file behind " + std::to_string(k) + ", the first in line " +
                              std::to_string(first_line),
                          "it is truncated, or states more than it holds; get a whole copy");
        item = nextItem(text);
      }
      if (!parseNumber(item, v)) return in_.note(expected() + inQuotes(item) + inLine());
      if (!corner(v, face)) return;
    }
    if (in_.lineNumber() != first_line)
      if (const std::string_view item = nextItem(text); !item.empty())
        return in_.note(expected() + inQuotes(item) + " behind them" + inLine() + ", the first in line " +
                            std::to_string(first_line),
                        "a line before it lacks a corner; or write each face that has a colour in one line");
    cutter_.add(corners_, corner_uv_);
  }

  FileReader in_;
  RawMesh mesh_;
  FaceCutter cutter_;
  std::vector<glm::vec2> uv_, corner_uv_;
  std::vector<uint32_t> corners_;
  FaceColours face_colours_;
  uint64_t vertices_ = 0, faces_ = 0;
  bool binary_ = false, little_endian_ = false, has_uv_ = false, has_colours_ = false, has_normals_ = false;
};

}  // namespace

Result<RawMesh> readOff(const InputFile& file, const MeshReadOptions& options) {
  OffReader reader(file, options, OffReader::FaceColours::kCounted);
  Result<RawMesh> mesh = reader.read();
  if (mesh || !reader.isBinary() || mesh.error().kind == ErrorKind::kInterrupted) return mesh;
  // Without the counts a face takes fewer bytes: a file that has none ends early for one that reads them.
  Result<RawMesh> without = OffReader(file, options, OffReader::FaceColours::kNone).read();
  return without ? std::move(without) : std::move(mesh);
}

}  // namespace relievo::mesh_file
