// mesh_file.h - what the readers of mesh files share: a file read piece by piece, text cut into lines and numbers, and
// the mesh as the file has it, before origin, welding and repair. Internal to mesh_read.
//
// All formats are read here and none by OpenMesh 9, which was measured first, behind an importer that only collects.
// Its readers
// - lose detail: every coordinate passes through a float, in text and in doubles of PLY too (12345678.125: 12345678);
// - take longer, in CPU seconds a million triangles, OpenMesh / here: binary PLY 0.16 / 0.03, text PLY 0.35 / 0.14,
//   OFF 0.35 / 0.10, OBJ 0.87 / 0.10, binary STL 0.62 / 0.11, text STL 2.4 / 0.65;
// - trust: an OFF header of 10^9 vertices or a face of 10^9 corners ends the process in bad_alloc, a comment in an OFF
//   file is taken for its counts, a truncated STL is read without a word, faces of unknown vertices are dropped;
// - leave out, of PLY, list counts of 32 bits (refused), texture coordinates by corner, and strips.
// The tests read OpenMesh's files, and compare.
#pragma once

#include <array>
#include <atomic>
#include <charconv>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/mesh_edges.h"
#include "geometry/scan/mesh_read.h"
#include "src/base/file.h"
#include "src/base/result.h"

namespace relievo::mesh_file {

inline constexpr uint64_t kMaxVertices = 0xFFFFFFFE;

// A colour's byte: cut off at 0 and 255; what is no number is 0.
inline uint8_t byteOf(double value) {
  return value >= 255 ? 255 : value > 0 ? static_cast<uint8_t>(value) : uint8_t{0};
}

// sRGB, of faces and materials that state none.
inline constexpr glm::u8vec3 kPlainColour{204, 204, 204};

struct RawMesh {
  std::vector<glm::dvec3> positions;               // in the file's unit
  std::vector<std::array<uint32_t, 3>> triangles;  // every index below positions.size()
  std::vector<glm::u8vec3> colours;                // a position; or empty
  std::vector<glm::vec3> float_colours;  // instead, where the file's are not bytes: 0..1, or 0..255 if any is above 1
  std::vector<std::array<glm::vec2, 3>> corner_uv;  // a triangle; or empty
  // A triangle, of any length, or 0 where there are none; or empty. Of materials with a map of normals only.
  std::vector<std::array<glm::vec3, 3>> corner_normals;
  std::vector<glm::u8vec3> face_colours;  // a triangle; or empty: where there is no image, they become one
  std::vector<MeshImage> images;          // see tri_mesh.h
  std::vector<uint16_t> image_of;         // see tri_mesh.h
  bool texture_repeats = false;           // beyond 0..1, as the format has it, where no image says otherwise
  std::vector<std::string> named_files;   // images and material files, as the file names them
  uint64_t vertices_read = 0;             // as the file counts
  std::vector<MeshFinding> findings;
  std::string unit;  // that the file states: mm, cm, m or in; or empty
};

// The unit that a comment states, as "unit mm" or "Units: millimeters"; empty: none.
std::string_view unitOfComment(std::string_view comment);

// Appends a face of the file as triangles. A polygon of up to 64 corners loses ear after ear (it may be concave), a
// larger one is a fan from its first corner, so that time stays linear in the file. uv, normals: one a corner or none;
// faces of fewer than 3 corners are counted in dropped. Corners that are not known yet (an OBJ may name vertices before
// it gives them) make a fan, too.
class FaceCutter {
 public:
  explicit FaceCutter(RawMesh& mesh) : mesh_(mesh) {}
  void add(std::span<const uint32_t> corners, std::span<const glm::vec2> uv = {},
           std::span<const glm::vec3> normals = {});
  uint64_t dropped() const { return dropped_; }

 private:
  void emit(size_t a, size_t b, size_t c);
  RawMesh& mesh_;
  std::span<const uint32_t> corners_;
  std::span<const glm::vec2> uv_;
  std::span<const glm::vec3> normals_;
  std::vector<uint32_t> left_;
  uint64_t dropped_ = 0;
};

// A file from its beginning to its end through a small buffer. Every step does nothing once an error is noted.
class FileReader {
 public:
  FileReader(const InputFile& file, const MeshReadOptions& options) : file_(file), options_(options) {}

  // The next n bytes (n <= 64 KiB), or nullptr: noted as the end of the file.
  const uint8_t* take(size_t n, const char* what) {
    if (buffered() < n && !fill(n)) return endOfFile(what);
    const uint8_t* p = buffer_.data() + at_;
    at_ += n;
    return p;
  }
  const uint8_t* peek() const { return buffer_.data() + at_; }
  size_t buffered() const { return end_ - at_; }
  // At least n bytes buffered, if the file has as many. False: an error is noted, or the file ends before.
  bool fill(size_t n);
  // A line without its end; false at the end of the file or after an error. Valid until the next call.
  bool line(std::string_view& text);
  uint64_t lineNumber() const { return lines_; }

  const InputFile& file() const { return file_; }
  uint64_t offset() const { return file_at_ - (end_ - at_); }
  uint64_t left() const { return file_.size() - offset(); }
  const uint8_t* endOfFile(const char* what);
  void note(std::string message, std::string hint = "the file is damaged; get a whole copy, or write it anew",
            ErrorKind kind = ErrorKind::kInvalidData);
  void fail(Error error);  // of another file that this one names
  bool failed() const { return failed_; }
  const Error& error() const { return error_; }

 private:
  const InputFile& file_;
  const MeshReadOptions& options_;
  std::vector<uint8_t> buffer_;
  size_t at_ = 0, end_ = 0;
  uint64_t file_at_ = 0, lines_ = 0;
  bool failed_ = false;
  Error error_;
};

inline bool isBlank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\f' || c == '\v'; }
// The next item of a line, cut off it; empty: none left.
inline std::string_view nextItem(std::string_view& text) {
  size_t a = 0;
  while (a < text.size() && isBlank(text[a])) ++a;
  size_t b = a;
  while (b < text.size() && !isBlank(text[b])) ++b;
  std::string_view item = text.substr(a, b - a);
  text.remove_prefix(b);
  return item;
}
template <class T>
bool parseNumber(std::string_view item, T& value) {
  if (item.size() > 1 && item[0] == '+') item.remove_prefix(1);
  auto [end, status] = std::from_chars(item.data(), item.data() + item.size(), value);
  return status == std::errc() && end == item.data() + item.size();
}
// Text of a file in a message: short, printable.
std::string inQuotes(std::string_view text);
std::string numberText(double value);
std::string lowerCase(std::string_view text);

Result<RawMesh> readPly(const InputFile& file, const MeshReadOptions& options);
Result<RawMesh> readObj(const InputFile& file, const MeshReadOptions& options);
Result<RawMesh> readStl(const InputFile& file, const MeshReadOptions& options);
Result<RawMesh> readOff(const InputFile& file, const MeshReadOptions& options);
Result<RawMesh> readGltf(const InputFile& file, const MeshReadOptions& options);

}  // namespace relievo::mesh_file
