// mesh_read_stl.cpp - STL, binary and text. It has corners, not vertices: they are welded while they are read.
//
// A binary triangle ends in 16 bits that some programs take for its colour, 5 bits a channel, in two ways:
// - VisCAM, SolidView: bit 15 says that there is a colour; red is in the bits from 10, blue in those from 0.
// - Materialise Magics: the header has "COLOR=" and the four bytes of the whole's colour; bit 15 says that this one is
//   meant, else red is in the bits from 0, blue in those from 10.
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "geometry/mesh/point_table.h"
#include "geometry/scan/mesh_file.h"

namespace relievo::mesh_file {
namespace {

constexpr uint64_t kHeaderBytes = 84, kTriangleBytes = 50;
constexpr uint64_t kMaxTrailingBytes = 16;  // line ends added on the way; a triangle more means that the count is wrong

class StlReader {
 public:
  StlReader(const InputFile& file, const MeshReadOptions& options) : file_(file), in_(file, options) {}

  Result<RawMesh> read() {
    // Binary headers may start with "solid", too: a length that fits decides.
    std::array<uint8_t, kHeaderBytes> head{};
    uint64_t stated = 0;
    if (file_.size() >= kHeaderBytes) {
      if (auto got = file_.read(0, head); !got) return got.error();
      stated = head[80] | head[81] << 8 | head[82] << 16 | static_cast<uint64_t>(head[83]) << 24;
    }
    uint64_t needed = kHeaderBytes + stated * kTriangleBytes;
    bool fits = file_.size() >= needed && file_.size() <= needed + kMaxTrailingBytes && file_.size() >= kHeaderBytes;
    if (fits) {
      readBinary(stated, head);
    } else if (file_.size() >= 6 && looksLikeText()) {
      readText();
    } else {
      Error e{ErrorKind::kInvalidData,
              file_.path(),
              "",
              "the file is damaged or no STL file; get a whole copy, or write it anew",
              {}};
      e.message = file_.size() < kHeaderBytes
                      ? "expected \"solid\" or a header of 84 bytes, found " + std::to_string(file_.size()) + " bytes"
                      : "expected " + std::to_string(needed) + " bytes for the " + std::to_string(stated) +
                            " triangles stated, found " + std::to_string(file_.size());
      return e;
    }
    if (in_.failed()) return in_.error();
    mesh_.vertices_read = 3 * mesh_.triangles.size();
    return std::move(mesh_);
  }

 private:
  bool looksLikeText() {
    if (!in_.fill(std::min<uint64_t>(file_.size(), 1024)) && in_.failed()) return false;
    std::string_view text(reinterpret_cast<const char*>(in_.peek()), std::min<size_t>(in_.buffered(), 1024));
    std::string_view first = text.substr(0, text.find('\n'));
    return nextItem(first) == "solid" && text.find('\0') == std::string_view::npos;
  }

  void add(const std::array<glm::dvec3, 3>& corners) {
    const uint64_t number = mesh_.triangles.size();
    std::array<uint32_t, 3> t{};
    for (int k = 0; k < 3; ++k) {
      const glm::dvec3& p = corners[static_cast<size_t>(k)];
      if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z))
        return in_.note("triangle " + std::to_string(number) + " (from 0), vertex " +
                            std::to_string(3 * number + static_cast<uint64_t>(k)) +
                            ": expected finite coordinates, found " + numberText(p.x) + " " + numberText(p.y) + " " +
                            numberText(p.z),
                        "remove the triangle");
      t[static_cast<size_t>(k)] = table_.findOrAppend(mesh_.positions, p);
    }
    mesh_.triangles.push_back(t);
  }

  // What the 16 bits say, beside the convention of the file's header.
  class FaceColours {
   public:
    explicit FaceColours(const std::array<uint8_t, kHeaderBytes>& head) {
      constexpr std::string_view kKey = "COLOR=";
      const std::string_view text(reinterpret_cast<const char*>(head.data()), 80);
      const size_t at = text.find(kKey);
      if (at == text.npos || at + kKey.size() + 4 > text.size()) return;
      whole_ = true;
      const uint8_t* c = head.data() + at + kKey.size();
      plain_ = {c[0], c[1], c[2]};
    }
    void add(uint16_t bits, std::vector<glm::u8vec3>& colours) {
      const bool own = (bits >> 15 != 0) != whole_;
      any_ = any_ || (own && (!whole_ || bits != 0));
      const glm::u8vec3 low_first(channel(bits), channel(bits >> 5), channel(bits >> 10));
      colours.push_back(!own ? plain_ : whole_ ? low_first : glm::u8vec3(low_first.b, low_first.g, low_first.r));
    }
    // Of a header with a colour whose triangles all have 0, the writer left theirs out. Without any colour: none.
    void finish(std::vector<glm::u8vec3>& colours) const {
      if (whole_ && !any_) std::fill(colours.begin(), colours.end(), plain_);
      else if (!any_) std::vector<glm::u8vec3>().swap(colours);
    }

   private:
    static uint8_t channel(int bits) { return static_cast<uint8_t>(((bits & 31) * 255 + 15) / 31); }
    glm::u8vec3 plain_ = kPlainColour;
    bool whole_ = false, any_ = false;
  };

  void readBinary(uint64_t count, const std::array<uint8_t, kHeaderBytes>& head) {
    if (count > kMaxTriangles)
      return in_.note("expected at most " + std::to_string(kMaxTriangles) + " triangles, found " +
                      std::to_string(count));
    in_.take(kHeaderBytes, "a header");
    mesh_.triangles.reserve(count);
    FaceColours colours(head);
    std::array<uint16_t, 16> bits{};
    // Some triangles are decoded, and their places in the table fetched, before they are looked up there.
    std::array<std::array<glm::dvec3, 3>, 16> decoded;
    for (uint64_t first = 0; first < count && !in_.failed(); first += decoded.size()) {
      const size_t n = std::min<uint64_t>(decoded.size(), count - first);
      for (size_t i = 0; i < n; ++i) {
        const uint8_t* record = in_.take(kTriangleBytes, "more triangles");
        if (!record) return;
        for (size_t k = 0; k < 3; ++k) {
          for (int c = 0; c < 3; ++c) {
            const uint8_t* p = record + 12 + 12 * k + 4 * static_cast<size_t>(c);
            decoded[i][k][c] =
                std::bit_cast<float>(p[0] | static_cast<uint32_t>(p[1]) << 8 | static_cast<uint32_t>(p[2]) << 16 |
                                     static_cast<uint32_t>(p[3]) << 24);
          }
          table_.prefetch(decoded[i][k] + 0.0);
        }
        bits[i] = static_cast<uint16_t>(record[48] | record[49] << 8);
      }
      for (size_t i = 0; i < n && !in_.failed(); ++i) {
        add(decoded[i]);
        colours.add(bits[i], mesh_.face_colours);
      }
    }
    colours.finish(mesh_.face_colours);
  }

  void readText() {
    std::array<glm::dvec3, 3> corners;
    size_t n = 0;
    bool in_solid = false, in_facet = false;
    std::string_view text;
    auto unexpected = [&](const char* expected) {
      in_.note(std::string("expected ") + expected + " in line " + std::to_string(in_.lineNumber()));
    };
    while (!in_.failed() && in_.line(text)) {
      for (std::string key = lowerCase(nextItem(text)); !key.empty() && !in_.failed();
           key = lowerCase(nextItem(text))) {
        if (key == "solid" || key == "endsolid") {
          if (in_facet) return unexpected("endfacet before the next word");
          in_solid = key == "solid";
          break;  // a name follows
        }
        if (!in_solid) return unexpected("solid");
        if (key == "facet") {
          if (in_facet) return unexpected("endfacet before the next facet");
          in_facet = true;
          n = 0;
          break;  // its normal follows
        }
        if (key == "vertex") {
          if (!in_facet || n == 3) return unexpected("three vertices in each facet");
          for (int c = 0; c < 3; ++c)
            if (std::string_view item = nextItem(text); !parseNumber(item, corners[n][c]))
              return in_.note("expected a vertex's coordinate, found " + inQuotes(item) + " in line " +
                              std::to_string(in_.lineNumber()));
          ++n;
        } else if (key == "endfacet") {
          if (!in_facet || n != 3) return unexpected("three vertices in each facet");
          in_facet = false;
          add(corners);
          if (mesh_.triangles.size() > kMaxTriangles)
            return in_.note("expected at most " + std::to_string(kMaxTriangles) + " triangles");
        } else if (key != "outer" && key != "loop" && key != "endloop") {
          return in_.note("expected a word of an STL file, found " + inQuotes(key) + " in line " +
                          std::to_string(in_.lineNumber()));
        }
      }
    }
    if (!in_.failed() && (in_facet || in_solid)) in_.endOfFile("endsolid");
  }

  const InputFile& file_;
  FileReader in_;
  RawMesh mesh_;
  PointTable<glm::dvec3> table_;
};

}  // namespace

Result<RawMesh> readStl(const InputFile& file, const MeshReadOptions& options) {
  return StlReader(file, options).read();
}

}  // namespace relievo::mesh_file
