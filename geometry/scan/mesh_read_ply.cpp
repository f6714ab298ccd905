// mesh_read_ply.cpp - PLY (Turk 1994): ASCII and binary of both byte orders. Elements: vertex (x y z, colours, texture
// coordinates), face (vertex_indices or vertex_index, texcoord by corner, colours), tristrips (Stanford's; -1 ends a
// strip). All else is read over.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "geometry/scan/mesh_file.h"
#include "geometry/scan/mesh_materials.h"

namespace relievo::mesh_file {
namespace {

constexpr uint64_t kMaxHeaderBytes = uint64_t{1} << 20;

enum class Type : uint8_t { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };
constexpr size_t kTypeBytes[] = {1, 1, 2, 2, 4, 4, 4, 8};
bool isInteger(Type t) { return t < Type::kFloat; }

bool parseType(std::string_view name, Type& type) {
  static constexpr std::pair<std::string_view, Type> kNames[] = {
      {"char", Type::kInt8},   {"int8", Type::kInt8},     {"uchar", Type::kUint8},   {"uint8", Type::kUint8},
      {"short", Type::kInt16}, {"int16", Type::kInt16},   {"ushort", Type::kUint16}, {"uint16", Type::kUint16},
      {"int", Type::kInt32},   {"int32", Type::kInt32},   {"uint", Type::kUint32},   {"uint32", Type::kUint32},
      {"float", Type::kFloat}, {"float32", Type::kFloat}, {"double", Type::kDouble}, {"float64", Type::kDouble}};
  for (auto& [known, t] : kNames)
    if (known == name) {
      type = t;
      return true;
    }
  return false;
}

enum class Use : uint8_t {
  kNone,
  kX,
  kY,
  kZ,
  kRed,
  kGreen,
  kBlue,
  kU,
  kV,
  kIndices,
  kCornerUv,
  kFaceRed,
  kFaceGreen,
  kFaceBlue,
  kImage
};

struct Property {
  std::string name;
  Type type = Type::kFloat, count_type = Type::kUint8;
  bool list = false;
  Use use = Use::kNone;
};
enum class Kind { kOther, kVertex, kFace, kStrips };
struct Element {
  std::string name;
  Kind kind = Kind::kOther;
  uint64_t count = 0;
  std::vector<Property> properties;
  const Property* used(Use use) const {
    for (const Property& p : properties)
      if (p.use == use) return &p;
    return nullptr;
  }
};

Use useOf(const Element& element, const Property& p) {
  std::string name = lowerCase(p.name);
  auto is = [&](std::initializer_list<const char*> names) {
    for (const char* n : names)
      if (name == n) return true;
    return false;
  };
  if (element.kind == Kind::kVertex && !p.list) {
    if (name == "x") return Use::kX;
    if (name == "y") return Use::kY;
    if (name == "z") return Use::kZ;
    if (is({"red", "r", "diffuse_red"})) return Use::kRed;
    if (is({"green", "g", "diffuse_green"})) return Use::kGreen;
    if (is({"blue", "b", "diffuse_blue"})) return Use::kBlue;
    if (is({"s", "u", "texture_u", "texcoord_u", "s0"})) return Use::kU;
    if (is({"t", "v", "texture_v", "texcoord_v", "t0"})) return Use::kV;
  }
  if ((element.kind == Kind::kFace || element.kind == Kind::kStrips) && p.list) {
    if (is({"vertex_indices", "vertex_index"})) return Use::kIndices;
    if (element.kind == Kind::kFace && name == "texcoord") return Use::kCornerUv;
  }
  if (element.kind == Kind::kFace && !p.list) {
    if (is({"red", "r", "diffuse_red"})) return Use::kFaceRed;
    if (is({"green", "g", "diffuse_green"})) return Use::kFaceGreen;
    if (is({"blue", "b", "diffuse_blue"})) return Use::kFaceBlue;
    if (is({"texnumber", "texture_index", "texid"})) return Use::kImage;
  }
  return Use::kNone;
}

class PlyReader {
 public:
  PlyReader(const InputFile& file, const MeshReadOptions& options)
      : options_(options), in_(file, options), cutter_(mesh_) {}

  Result<RawMesh> read() {
    readHeader();
    for (const Element& e : elements_) {
      if (in_.failed()) break;
      if (e.kind == Kind::kVertex) readVertices(e);
      else if (e.kind == Kind::kFace || e.kind == Kind::kStrips) readFaces(e);
      else readOver(e);
    }
    if (in_.failed()) return in_.error();
    if (cutter_.dropped() > 0)
      mesh_.findings.push_back({"faces of fewer than three corners", cutter_.dropped(), {}, "dropped"});
    chooseFaceColours();
    useImages();
    leaveOutBlack();
    return std::move(mesh_);
  }

 private:
  // Some programs write black where there is no colour.
  void leaveOutBlack() {
    const auto black = [](const auto& c) { return c.x == 0 && c.y == 0 && c.z == 0; };
    const size_t colours = std::max(mesh_.colours.size(), mesh_.float_colours.size());
    if (colours == 0 || !std::all_of(mesh_.colours.begin(), mesh_.colours.end(), black) ||
        !std::all_of(mesh_.float_colours.begin(), mesh_.float_colours.end(), black))
      return;
    mesh_.findings.push_back({"black vertices, as all are", colours, {}, "taken to have no colours"});
    mesh_.colours.clear();
    mesh_.float_colours.clear();
  }
  // Of several images faces say which they show. Without such numbers all show the first.
  void useImages() {
    mesh_.named_files = images_;
    if (images_.empty() || mesh_.triangles.empty()) return;
    for (const std::string& path : images_) addImage(mesh_, {.file = {.path = path, .bytes = {}}});
    for (MaterialRun& run : runs_)
      if (run.image >= mesh_.images.size()) run.image = kNoImage;
    if (!numbered_) runs_ = {{.image = 0}};
    if (images_.size() > 1 && !numbered_)
      mesh_.findings.push_back(
          {"further images, without numbers that say which faces show them (one is used: " + images_[0] + ")",
           images_.size() - 1,
           {},
           "not used"});
    useMaterials(mesh_, runs_, options_);
  }

  // They count where nothing else has colours: an image and vertices say more.
  void chooseFaceColours() {
    const bool vertices = !mesh_.colours.empty() || !mesh_.float_colours.empty(), image = !mesh_.corner_uv.empty();
    if (!coloured_faces_ || (!vertices && !image)) return;
    std::vector<glm::u8vec3>().swap(mesh_.face_colours);
    mesh_.findings.push_back({"faces with a colour of their own",
                              coloured_faces_,
                              {},
                              image ? "not used: texture coordinates are" : "not used: colours of vertices are"});
  }

  void readHeader() {
    std::string_view text;
    if (!in_.line(text) || nextItem(text) != "ply")
      return in_.note("expected \"ply\" as the first line", "this is no PLY file");
    bool format = false;
    uint64_t stray_lines = 0;
    std::string stray;  // the first of them
    for (;;) {
      if (!in_.line(text)) {
        in_.endOfFile("end_header");
        return;
      }
      if (in_.offset() > kMaxHeaderBytes) return in_.note("expected end_header within the first MiB");
      std::string_view whole = text, key = nextItem(text);
      if (key == "end_header") break;
      if (key == "format") {
        std::string_view name = nextItem(text);
        if (name == "ascii") ascii_ = true;
        else if (name == "binary_little_endian") swap_ = std::endian::native != std::endian::little;
        else if (name == "binary_big_endian") swap_ = std::endian::native != std::endian::big;
        else
          return in_.note("expected the format ascii, binary_little_endian or binary_big_endian, found " +
                          inQuotes(name));
        if (nextItem(text) != "1.0") return in_.note("expected version 1.0 of the format, found " + inQuotes(whole));
        format = true;
      } else if (key == "element") {
        Element e;
        e.name = nextItem(text);
        std::string_view count = nextItem(text);
        if (e.name.empty() || !parseNumber(count, e.count))
          return in_.note("expected an element's name and count, found " + inQuotes(whole));
        if (e.name == "vertex") e.kind = Kind::kVertex;
        if (e.name == "face") e.kind = Kind::kFace;
        if (e.name == "tristrips") e.kind = Kind::kStrips;
        elements_.push_back(std::move(e));
      } else if (key == "property") {
        if (elements_.empty()) return in_.note("expected an element before its properties, found " + inQuotes(whole));
        Property p;
        std::string_view type = nextItem(text);
        if (type == "list") {
          p.list = true;
          if (!parseType(nextItem(text), p.count_type) || !isInteger(p.count_type))
            return in_.note("expected an integer type of the list's count, found " + inQuotes(whole));
          type = nextItem(text);
        }
        p.name = nextItem(text);
        if (!parseType(type, p.type) || p.name.empty())
          return in_.note("expected a property's type and name, found " + inQuotes(whole));
        p.use = useOf(elements_.back(), p);
        if (p.use == Use::kIndices && !isInteger(p.type))
          return in_.note("expected an integer type of the corners' indices, found " + inQuotes(whole));
        elements_.back().properties.push_back(std::move(p));
      } else if (key == "comment" || key == "obj_info") {
        std::string_view rest = text;
        if (mesh_.unit.empty()) mesh_.unit = unitOfComment(text);
        if (lowerCase(nextItem(rest)) == "texturefile") {
          while (!rest.empty() && isBlank(rest.front())) rest.remove_prefix(1);
          while (!rest.empty() && isBlank(rest.back())) rest.remove_suffix(1);
          images_.emplace_back(rest);
        }
      } else if (!key.empty() && format && elements_.empty()) {
        // Blender 2.4 wrote who made the file without saying that this is a comment.
        if (++stray_lines == 1) stray = inQuotes(whole);
      } else if (!key.empty()) {
        return in_.note("expected a line of a PLY header, found " + inQuotes(whole));
      }
    }
    if (stray_lines > 0)
      mesh_.findings.push_back({"header lines that are no part of it (" + stray + ")", stray_lines, {}, "ignored"});
    if (!format) return in_.note("expected the line \"format ...\" before end_header");
    checkElements();
  }

  // What is claimed must fit the file, before anything is allocated.
  void checkElements() {
    uint64_t least = 0;
    bool vertices = false, faces = false;
    for (const Element& e : elements_) {
      uint64_t bytes = 0;  // of one, at least; in text a digit and a blank each
      for (const Property& p : e.properties)
        bytes += ascii_ ? 2 : kTypeBytes[static_cast<size_t>(p.list ? p.count_type : p.type)];
      uint64_t left = in_.left() + (ascii_ ? 1 : 0) - least;  // a text's last line may lack its end
      if (bytes > 0 && e.count > left / bytes)
        return in_.note("expected " + std::to_string(e.count) + " elements \"" + e.name + "\" of at least " +
                            std::to_string(bytes) + " bytes, found " + std::to_string(left) + " bytes left in the file",
                        "it is truncated, or states more than it holds; get a whole copy");
      least += bytes * e.count;
      if (e.kind == Kind::kVertex) {
        if (vertices) return in_.note("expected one element \"vertex\", found two");
        vertices = true;
        for (Use use : {Use::kX, Use::kY, Use::kZ})
          if (!e.used(use)) return in_.note("expected the vertices' properties x, y and z, not all are there");
        for (const Property& p : e.properties)
          if (p.use != Use::kNone && e.used(p.use) != &p)
            return in_.note("expected every property once, found " + inQuotes(p.name) + " twice");
        if (e.count > kMaxVertices)
          return in_.note("expected at most " + std::to_string(kMaxVertices) + " vertices, found " +
                          std::to_string(e.count));
      } else if (e.kind == Kind::kFace || e.kind == Kind::kStrips) {
        faces = true;
        if (!vertices)
          return in_.note("expected the vertices before the faces", "write the file anew, vertices first",
                          ErrorKind::kUnsupported);
        if (!e.used(Use::kIndices))
          return in_.note("expected the property vertex_indices of element " + inQuotes(e.name) + ", it is not there");
      }
    }
    if (!vertices) return in_.note("expected an element \"vertex\", found none");
    if (!faces)
      return in_.note("expected an element \"face\", found none: points without a surface", "mesh the points first");
  }

  // One value, binary or text.
  template <class T>
  T load(const uint8_t* p) const {
    uint8_t bytes[sizeof(T)];
    std::memcpy(bytes, p, sizeof(T));
    if (swap_) std::reverse(bytes, bytes + sizeof(T));
    return std::bit_cast<T>(bytes);
  }
  double decode(const uint8_t* p, Type type) const {
    switch (type) {
      case Type::kInt8:
        return static_cast<int8_t>(*p);
      case Type::kUint8:
        return *p;
      case Type::kInt16:
        return load<int16_t>(p);
      case Type::kUint16:
        return load<uint16_t>(p);
      case Type::kInt32:
        return load<int32_t>(p);
      case Type::kUint32:
        return load<uint32_t>(p);
      case Type::kFloat:
        return load<float>(p);
      case Type::kDouble:
        return load<double>(p);
    }
    return 0;
  }
  std::string_view item() {
    for (;;) {
      if (std::string_view found = nextItem(line_); !found.empty()) return found;
      if (!in_.line(line_)) {
        in_.endOfFile("more values");
        return {};
      }
    }
  }
  double value(Type type, const char* what, uint64_t index) {
    if (in_.failed()) return 0;
    if (!ascii_) {
      const uint8_t* p = in_.take(kTypeBytes[static_cast<size_t>(type)], what);
      return p ? decode(p, type) : 0;
    }
    std::string_view text = item();
    double v = 0;
    if (!in_.failed() && !parseNumber(text, v))
      in_.note("expected a number, " + std::string(what) + " " + std::to_string(index) + ", found " + inQuotes(text) +
               " in line " + std::to_string(in_.lineNumber()));
    return v;
  }
  // A list's count, checked against what is left of the file.
  size_t count(const Property& p, const char* what, uint64_t index) {
    double n = value(p.count_type, what, index);
    uint64_t least = ascii_ ? 2 : kTypeBytes[static_cast<size_t>(p.type)];
    uint64_t left = in_.left() + line_.size() + 1;
    if (!in_.failed() && !(n >= 0 && n == std::floor(n) && n <= static_cast<double>(left / least)))
      in_.note(std::string(what) + " " + std::to_string(index) + " states a list of " + numberText(n) + " values, " +
               std::to_string(in_.left()) + " bytes are left in the file");
    return in_.failed() ? 0 : static_cast<size_t>(n);
  }
  void readOverList(const Property& p, const char* what, uint64_t index) {
    for (size_t n = count(p, what, index); n > 0 && !in_.failed(); --n) value(p.type, what, index);
  }

  void readOver(const Element& e) {
    if (e.properties.empty()) return;
    for (uint64_t i = 0; i < e.count && !in_.failed(); ++i)
      for (const Property& p : e.properties) {
        if (p.list) readOverList(p, "element", i);
        else value(p.type, "element", i);
      }
  }

  void readVertices(const Element& e) {
    auto n = static_cast<size_t>(e.count);
    mesh_.vertices_read = e.count;
    mesh_.positions.resize(n);
    const Property* red = e.used(Use::kRed);
    bool colours = red && e.used(Use::kGreen) && e.used(Use::kBlue), float_colours = false;
    double colour_scale = 1;
    if (colours) {
      float_colours = !isInteger(red->type);
      if (red->type == Type::kUint16) colour_scale = 1 / 257.0;
      if (float_colours) mesh_.float_colours.resize(n);
      else mesh_.colours.resize(n);
    }
    if (e.used(Use::kU) && e.used(Use::kV)) vertex_uv_.resize(n);

    auto store = [&](size_t i, Use use, double v) {
      switch (use) {
        case Use::kX:
        case Use::kY:
        case Use::kZ:
          mesh_.positions[i][static_cast<int>(use) - static_cast<int>(Use::kX)] = v;
          break;
        case Use::kRed:
        case Use::kGreen:
        case Use::kBlue: {
          int c = static_cast<int>(use) - static_cast<int>(Use::kRed);
          if (float_colours) mesh_.float_colours[i][c] = static_cast<float>(v);
          else if (colours) mesh_.colours[i][c] = byteOf(v * colour_scale + 0.5);
          break;
        }
        case Use::kU:
        case Use::kV:
          if (!vertex_uv_.empty())
            vertex_uv_[i][static_cast<int>(use) - static_cast<int>(Use::kU)] = static_cast<float>(v);
          break;
        default:
          break;
      }
    };
    bool fixed = !ascii_;
    size_t stride = 0;
    for (const Property& p : e.properties) {
      fixed = fixed && !p.list;
      stride += kTypeBytes[static_cast<size_t>(p.type)];
    }
    if (fixed && stride <= 65536) {
      struct Field {
        size_t offset;
        Type type;
        Use use;
      };
      std::vector<Field> fields;
      size_t offset = 0;
      for (const Property& p : e.properties) {
        if (p.use != Use::kNone) fields.push_back({offset, p.type, p.use});
        offset += kTypeBytes[static_cast<size_t>(p.type)];
      }
      for (size_t i = 0; i < n; ++i) {
        const uint8_t* record = in_.take(stride, "more vertices");
        if (!record) return;
        for (const Field& f : fields) store(i, f.use, decode(record + f.offset, f.type));
      }
      return;
    }
    for (size_t i = 0; i < n && !in_.failed(); ++i)
      for (const Property& p : e.properties) {
        if (p.list) readOverList(p, "vertex", i);
        else store(i, p.use, value(p.type, "vertex", i));
      }
  }

  bool corner(double v, uint64_t face, uint32_t& index) {
    if (in_.failed()) return false;
    if (!(v >= 0 && v < static_cast<double>(mesh_.positions.size()) && v == std::floor(v))) {
      in_.note("face " + std::to_string(face) + " names vertex " + numberText(v) + ", there are " +
               std::to_string(mesh_.positions.size()) + " (from 0)");
      return false;
    }
    index = static_cast<uint32_t>(v);
    return true;
  }

  void readFaces(const Element& e) {
    mesh_.triangles.reserve(mesh_.triangles.size() + static_cast<size_t>(std::min(e.count, in_.left() / 6 + 1)));
    bool plain = !ascii_ && !swap_ && e.kind == Kind::kFace && e.properties.size() == 1 && vertex_uv_.empty() &&
                 kTypeBytes[static_cast<size_t>(e.properties[0].count_type)] == 1 &&
                 kTypeBytes[static_cast<size_t>(e.properties[0].type)] == 4;
    const Property* red = e.used(Use::kFaceRed);
    const bool colours = red && e.used(Use::kFaceGreen) && e.used(Use::kFaceBlue) && e.kind == Kind::kFace;
    // Of floats 1 is white.
    const double colour_scale = !colours ? 1 : !isInteger(red->type) ? 255 : red->type == Type::kUint16 ? 1 / 257.0 : 1;
    std::vector<uint32_t> corners;
    std::vector<glm::vec2> uv;
    auto vertices = static_cast<uint32_t>(mesh_.positions.size());
    for (uint64_t face = 0; face < e.count && !in_.failed(); ++face) {
      if (plain && (in_.buffered() >= 13 || in_.fill(13)) && *in_.peek() == 3) {  // triangles one after the other
        std::array<uint32_t, 3> t;
        std::memcpy(t.data(), in_.take(13, "") + 1, 12);
        if (t[0] < vertices && t[1] < vertices && t[2] < vertices) {
          mesh_.triangles.push_back(t);
          continue;
        }
        for (uint32_t index : t) {
          double v = e.properties[0].type == Type::kInt32 ? static_cast<double>(static_cast<int32_t>(index)) : index;
          if (!corner(v, face, index)) return;
        }
      }
      corners.clear();
      uv.clear();
      double image = -1;
      glm::u8vec3 colour(0);
      for (const Property& p : e.properties) {
        if (p.use == Use::kIndices && e.kind == Kind::kFace) {
          corners.resize(count(p, "face", face));
          for (uint32_t& index : corners)
            if (!corner(value(p.type, "face", face), face, index)) return;
        } else if (p.use == Use::kIndices) {
          readStrip(p, face);
        } else if (p.use == Use::kCornerUv) {
          size_t n = count(p, "texture coordinates of face", face);
          if (n % 2)
            return in_.note("face " + std::to_string(face) + " has " + std::to_string(n) +
                            " texture coordinates, not two a corner");
          uv.resize(n / 2);
          for (glm::vec2& at : uv) {
            at.x = static_cast<float>(value(p.type, "texture coordinates of face", face));
            at.y = static_cast<float>(value(p.type, "texture coordinates of face", face));
          }
        } else if (p.list) {
          readOverList(p, "face", face);
        } else if (p.use == Use::kImage) {
          image = value(p.type, "face", face);
        } else if (p.use == Use::kFaceRed || p.use == Use::kFaceGreen || p.use == Use::kFaceBlue) {
          colour[static_cast<int>(p.use) - static_cast<int>(Use::kFaceRed)] =
              byteOf(value(p.type, "face", face) * colour_scale + 0.5);
        } else {
          value(p.type, "face", face);
        }
        if (in_.failed()) return;
      }
      if (e.kind != Kind::kFace) continue;
      if (uv.size() != corners.size() && !uv.empty())
        return in_.note("face " + std::to_string(face) + " has " + std::to_string(corners.size()) +
                        " corners, but texture coordinates of " + std::to_string(uv.size()));
      if (uv.empty() && !vertex_uv_.empty())
        for (uint32_t index : corners) uv.push_back(vertex_uv_[index]);
      const size_t before = mesh_.triangles.size();
      cutter_.add(corners, uv);
      if (colours) {
        ++coloured_faces_;
        mesh_.face_colours.resize(before, kPlainColour);  // faces before this one may have had none
        mesh_.face_colours.resize(mesh_.triangles.size(), colour);
      }
      if (images_.size() > 1) {
        const bool known = image >= 0 && image < std::min<double>(static_cast<double>(images_.size()), kNoImage);
        const uint16_t shown = known ? static_cast<uint16_t>(image) : kNoImage;
        numbered_ = numbered_ || known;
        if (runs_.empty() || runs_.back().image != shown) runs_.push_back({before, shown});
      }
      if (mesh_.triangles.size() > kMaxTriangles)
        return in_.note("expected at most " + std::to_string(kMaxTriangles) + " triangles");
    }
  }

  void readStrip(const Property& p, uint64_t strip) {
    uint32_t a = 0, b = 0;
    size_t length = 0;
    for (size_t n = count(p, "strip", strip); n > 0 && !in_.failed(); --n) {
      double v = value(p.type, "strip", strip);
      if (v == -1) {
        length = 0;
        continue;
      }
      uint32_t c = 0;
      if (!corner(v, strip, c)) return;
      if (++length >= 3) {
        std::array<uint32_t, 3> t = length % 2 ? std::array<uint32_t, 3>{a, b, c} : std::array<uint32_t, 3>{b, a, c};
        if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) {
        } else if (vertex_uv_.empty()) {
          cutter_.add(t);
        } else {
          std::array<glm::vec2, 3> uv{vertex_uv_[t[0]], vertex_uv_[t[1]], vertex_uv_[t[2]]};
          cutter_.add(t, uv);
        }
      }
      a = b;
      b = c;
    }
  }

  const MeshReadOptions& options_;
  FileReader in_;
  RawMesh mesh_;
  FaceCutter cutter_;
  std::vector<Element> elements_;
  std::vector<glm::vec2> vertex_uv_;
  std::vector<std::string> images_;  // that comments name
  std::vector<MaterialRun> runs_;    // of which faces show which of several
  bool numbered_ = false;            // some face does
  uint64_t coloured_faces_ = 0;
  std::string_view line_;
  bool ascii_ = false, swap_ = false;
};

}  // namespace

Result<RawMesh> readPly(const InputFile& file, const MeshReadOptions& options) {
  return PlyReader(file, options).read();
}

}  // namespace relievo::mesh_file
