// Damaged mesh files: truncated, bits flipped, counts and indices that lie, text where binary is due. Each gives one
// clear Error or a mesh that keeps its promises, in memory bounded by the file's length.
#include <gtest/gtest.h>
#include <malloc.h>

#include <atomic>
#include <cstdlib>
#include <iostream>
#include <new>

#include "geometry/scan/mesh_read.h"
#include "tests/geometry/mapped_sheet.h"
#include "tests/geometry/mesh_files.h"
#include "tests/view_share.h"

// What is allocated, at most, since it was last set to what was allocated then. (g++ 12 sees one half of the pair
// inlined and warns.)
#pragma GCC diagnostic ignored "-Wmismatched-new-delete"
static std::atomic<size_t> allocated{0}, most_allocated{0};
void* operator new(size_t bytes) {
  void* p = std::malloc(bytes);
  if (!p) throw std::bad_alloc();
  size_t now = allocated += malloc_usable_size(p), seen = most_allocated.load();
  while (now > seen && !most_allocated.compare_exchange_weak(seen, now)) {
  }
  return p;
}
void* operator new(size_t bytes, const std::nothrow_t&) noexcept { return operator new(bytes); }
void operator delete(void* p) noexcept {
  if (p) allocated -= malloc_usable_size(p);
  std::free(p);
}
void operator delete(void* p, size_t) noexcept { operator delete(p); }

namespace relievo::test {
namespace mesh_fuzz_test {

constexpr uint32_t kSeed = 20120301;
constexpr int kShare = kSanitized ? 4 : 1;  // damaged files are what sanitizers are for

struct Subject {
  std::string name;  // its extension decides the reader
  std::string bytes;
};

const std::vector<Subject>& subjects() {
  static const std::vector<Subject> all = [] {
    Sample plain = scanOfCubeSphere(4), full = plain;
    decorate(full, kSeed);
    std::vector<Subject> out;
    for (Encoding e : {Encoding::kAscii, Encoding::kLittle, Encoding::kBig}) {
      out.push_back({"plain.ply", plyFile(plain, {.encoding = e})});
      out.push_back(
          {"full.ply",
           plyFile(full,
                   {.encoding = e, .coordinate = "double", .colour = "ushort", .count = "uint", .clutter = true})});
      out.push_back(
          {"vertex_uv.ply", plyFile(full, {.encoding = e, .colour = "float", .index = "ushort", .vertex_uv = true})});
    }
    std::string strips =
        "ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\nelement "
        "tristrips 1\nproperty list int int vertex_indices\nend_header\n";
    for (int i = 0; i < 9; ++i) strips += std::to_string(i % 3) + " " + std::to_string(i / 3) + " 0\n";
    out.push_back({"strips.ply", strips + "13 0 3 1 4 2 5 -1 3 6 4 7 5 8\n"});
    out.push_back({"plain.obj", objFile(plain)});
    out.push_back({"full.obj", objFile(full, true)});
    std::string polygons = "# polygons\n";
    for (int i = 0; i < 40; ++i)
      polygons += "v " + std::to_string(i % 7) + " " + std::to_string(i / 7) + " " + std::to_string(i * i % 5) + "\n";
    for (int i = 0; i < 20; ++i) {
      polygons += "f";
      for (int k = 0; k < 3 + i; ++k) polygons += " " + std::to_string((i * 5 + k * 3) % 40 + 1);
      polygons += i % 3 ? "\n" : " \\\n 2\n";
    }
    out.push_back({"polygons.obj", polygons});
    const std::string images =
        ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}}],\"textures\":[{\"source\":0}]"
        ","
        "\"images\":[{\"bufferView\":1}]";
    out.push_back({"plain.glb", glbFile(plain)});
    out.push_back(
        {"full.glb", glbFile(full, images, "\"children\":[1,2]},{\"mesh\":0,\"scale\":[1,-1,2]},{\"mesh\":0")});
    out.push_back({"plain.gltf", gltfFile(scanOfCubeSphere(2))});
    MappedSheet mapped = mappedSheet(2, 1);
    mapped.sample.tangents.assign(mapped.sample.positions.size(), {1, 0, 0, -1});
    out.push_back({"mapped.glb", glbFile(mapped.sample,
                                         ",\"materials\":[{\"normalTexture\":{\"index\":0,\"scale\":2}}],"
                                         "\"textures\":[{\"source\":0}],\"images\":[{\"bufferView\":1}]",
                                         "\"children\":[1,2]},{\"mesh\":0,\"scale\":[1,-1,2]},{\"mesh\":0")});
    full.corner_uv.clear();
    for (bool binary : {false, true}) {
      out.push_back({"plain.off", offFile(plain, binary)});
      out.push_back({"full.off", offFile(full, binary)});
      out.push_back({"plain.stl", stlFile(plain, binary)});
    }
    return out;
  }();
  return all;
}

struct Tally {
  uint64_t files = 0, read = 0, refused = 0;
  size_t most_over = 0;  // allocated beyond the bound
};

// Beside buffers, a file of n bytes may take 64 n: a polygon's corner of two bytes is a triangle with its half-edges,
// texture coordinates and what finds its edges. All of the mesh is counted here, not one allocation.
constexpr size_t kBufferBytes = size_t{1} << 18, kBytesAByte = 64;

void check(const Subject& s, const std::string& bytes, Tally& tally) {
  const std::string path = saveFile(s.name, bytes);
  const size_t before = allocated;
  most_allocated = before;
  auto read = readMesh(path);
  const size_t taken = most_allocated - before;
  ++tally.files;
  EXPECT_LE(taken, kBufferBytes + kBytesAByte * bytes.size()) << s.name << ", " << bytes.size() << " bytes";
  if (read) {
    ++tally.read;
    EXPECT_EQ(triMeshProblem(read->mesh), "");
    EXPECT_EQ(read->diagnosis.triangles, read->mesh.triangles.size());
    return;
  }
  ++tally.refused;
  const Error& e = read.error();
  EXPECT_TRUE(e.kind == ErrorKind::kInvalidData || e.kind == ErrorKind::kUnsupported) << e.text();
  EXPECT_EQ(e.file, path);
  EXPECT_FALSE(e.message.empty());
  for (char c : e.message)
    ASSERT_TRUE(c >= 0x20 && c < 0x7f) << "a character " << static_cast<int>(c) << " in: " << e.message;
}

void tell(const char* what, const Tally& t) {
  std::cout << "[ figures  ] " << what << ": " << t.files << " files, " << t.read << " meshes, " << t.refused
            << " errors\n";
}

TEST(MeshFuzz, WholeFilesAreRead) {
  Tally tally;
  for (const Subject& s : subjects()) check(s, s.bytes, tally);
  EXPECT_EQ(tally.read, subjects().size());
}

// Negative control: what the bound is there to catch, a header that is believed.
TEST(MeshFuzz, TheBoundOnMemoryIsFelt) {
  const size_t file_bytes = 300, before = allocated;
  most_allocated = before;
  { std::vector<glm::dvec3> stated(1000000); }
  EXPECT_GT(most_allocated - before, kBufferBytes + kBytesAByte * file_bytes);
  EXPECT_EQ(allocated, before);
}

TEST(MeshFuzz, Truncated) {
  Tally tally, refused;
  for (const Subject& s : subjects()) {
    SCOPED_TRACE(s.name);
    // All lengths of the header and of the end, every 97th between.
    for (size_t n = 0; n < s.bytes.size(); n += (n < 300 || s.bytes.size() - n < 60 ? 1 : 97) * kShare)
      check(s, s.bytes.substr(0, n), tally);
    // A binary file says how long it is: nothing shorter is read. (Text may lose its last line end, or digits of its
    // last number.)
    bool binary = s.bytes.find("binary_") != std::string::npos || s.bytes.find("BINARY") != std::string::npos ||
                  s.bytes.find('\0') != std::string::npos;
    if (!binary) continue;
    for (size_t n : {size_t{1}, size_t{2}, s.bytes.size() / 2, s.bytes.size() - 100}) {
      uint64_t before = refused.refused;
      check(s, s.bytes.substr(0, s.bytes.size() - n), refused);
      EXPECT_EQ(refused.refused, before + 1) << n << " bytes missing";
    }
  }
  tell("truncated", tally);
  EXPECT_GT(tally.refused, 1000u / kShare);
}

TEST(MeshFuzz, BitsFlipped) {
  Tally tally;
  std::mt19937 random(kSeed);
  std::cout << "seed " << kSeed << "\n";
  for (const Subject& s : subjects())
    for (int round = 0; round < 240 / kShare; ++round) {
      std::string bytes = s.bytes;
      for (uint32_t k = 1 + random() % (round % 4 == 0 ? 40 : 3); k > 0; --k) {
        size_t at = round % 2 ? random() % std::min<size_t>(bytes.size(), 400)
                              : random() % bytes.size();  // headers as often as all else
        bytes[at] = static_cast<char>(bytes[at] ^ 1 << random() % 8);
      }
      check(s, bytes, tally);
    }
  tell("bits flipped", tally);
  EXPECT_GT(tally.refused, 300u / kShare);
  EXPECT_GT(tally.read, 300u / kShare);
}

// Numbers in text, in headers above all, replaced by others.
TEST(MeshFuzz, CountsAndIndicesThatLie) {
  Tally tally;
  std::mt19937 random(kSeed + 1);
  const char* lies[] = {"1000000000",
                        "4294967295",
                        "4294967296",
                        "18446744073709551615",
                        "99999999999999999999999",
                        "-1",
                        "0",
                        "2",
                        "1e9",
                        "nan",
                        "inf",
                        "1e308",
                        "0x10",
                        "1.5",
                        "",
                        "-2147483648",
                        "three"};
  for (const Subject& s : subjects()) {
    std::vector<std::pair<size_t, size_t>> numbers;
    for (size_t i = 0; i < std::min<size_t>(s.bytes.size(), 30000); ++i)
      if (std::isdigit(static_cast<unsigned char>(s.bytes[i]))) {
        size_t n = 0;
        while (i + n < s.bytes.size() && std::isdigit(static_cast<unsigned char>(s.bytes[i + n]))) ++n;
        numbers.emplace_back(i, n);
        i += n;
      }
    for (int round = 0; round < 300 / kShare; ++round) {
      auto [at, n] = numbers[round % 2 ? random() % std::min<size_t>(numbers.size(), 12) : random() % numbers.size()];
      std::string bytes = s.bytes;
      bytes.replace(at, n, lies[random() % std::size(lies)]);
      check(s, bytes, tally);
    }
  }
  // The same in binary: any 4 bytes become any number.
  for (const Subject& s : subjects())
    for (int round = 0; round < 200 / kShare; ++round) {
      std::string bytes = s.bytes;
      size_t at = random() % (bytes.size() - 4);
      uint32_t lie = round % 3 == 0 ? 0xFFFFFFFF : round % 3 == 1 ? 1000000000 : static_cast<uint32_t>(random());
      std::memcpy(bytes.data() + at, &lie, 4);
      check(s, bytes, tally);
    }
  tell("lies", tally);
  EXPECT_GT(tally.refused, 1000u / kShare);
}

TEST(MeshFuzz, OneFormatInTheClothesOfAnother) {
  Tally tally;
  for (const Subject& a : subjects())
    for (const Subject& b : subjects()) {
      if (a.name.substr(a.name.size() - 3) != b.name.substr(b.name.size() - 3)) {
        check({b.name, ""}, a.bytes, tally);  // another extension
      } else if (a.name.ends_with(".ply")) {  // its header, another's body
        size_t head = a.bytes.find("end_header") + 11, body = b.bytes.find("end_header") + 11;
        check(a, a.bytes.substr(0, head) + b.bytes.substr(body), tally);
      } else {
        check(a, a.bytes.substr(0, a.bytes.size() / 2) + b.bytes.substr(b.bytes.size() / 2), tally);
      }
    }
  tell("mixed", tally);
  EXPECT_GT(tally.refused, subjects().size() * 5);
}

// Meshes made to cost time or memory: what grows faster than the file would not end here.
TEST(MeshFuzz, HostileMeshes) {
  constexpr uint32_t kN = kSanitized ? 4000 : 60000;
  auto header = [](uint32_t vertices, uint32_t triangles) {
    return "OFF\n" + std::to_string(vertices) + " " + std::to_string(triangles) + " 0\n";
  };
  auto line = [](double x, double y, double z) { return number(x) + " " + number(y) + " " + number(z) + "\n"; };
  auto triangle = [](uint32_t a, uint32_t b, uint32_t c) {
    return "3 " + std::to_string(a) + " " + std::to_string(b) + " " + std::to_string(c) + "\n";
  };
  Tally tally;
  std::string file, faces;
  // All triangles at one edge; all around one vertex.
  for (uint32_t i = 0; i < kN; ++i) file += line(i % 250, i / 250, i % 3);
  for (uint32_t i = 2; i < kN; ++i) faces += triangle(0, 1, i);
  check({"edge.off", ""}, header(kN, kN - 2) + file + faces, tally);
  faces.clear();
  for (uint32_t i = 1; i + 1 < kN; ++i) faces += triangle(0, i, i + 1);
  check({"fan.off", ""}, header(kN, kN - 2) + file + faces, tally);
  // Long open edges, all with the same vertices on them.
  file = faces = "";
  for (uint32_t i = 0; i < kN / 2; ++i) file += line(i, 0, 0);
  for (uint32_t i = 0; i < kN / 2; ++i) file += line(i, 1 + i % 7, i);
  for (uint32_t i = 0; i < kN / 2; ++i)
    faces += triangle(i, kN / 2 - 1 - i % 100 == i ? 0 : kN / 2 - 1 - i % 100, kN / 2 + i);
  check({"long.off", ""}, header(kN, kN / 2) + file + faces, tally);
  // All vertices at one place, and all on a line.
  file = faces = "";
  for (uint32_t i = 0; i < kN; ++i) file += "1 1 1\n";
  for (uint32_t i = 0; i + 2 < kN; ++i) faces += triangle(i, i + 1, i + 2);
  check({"point.off", ""}, header(kN, kN - 2) + file + faces, tally);
  // One polygon of all vertices, in text and in binary.
  file = faces = "";
  for (uint32_t i = 0; i < kN; ++i) file += line(i % 250, i / 250, 0);
  for (uint32_t i = 0; i < kN; ++i) faces += " " + std::to_string(i);
  check({"polygon.off", ""}, header(kN, 1) + file + std::to_string(kN) + faces + "\n", tally);
  // Random triangles between few vertices: each edge and vertex is crowded.
  file = faces = "";
  std::mt19937 random(kSeed);
  for (uint32_t i = 0; i < 100; ++i) file += line(random() % 10, random() % 10, random() % 10);
  for (uint32_t i = 0; i < kN; ++i) faces += triangle(random() % 100, random() % 100, random() % 100);
  check({"crowd.off", ""}, header(100, kN) + file + faces, tally);
  // Open triangles all within the tolerance of one another, beside one that makes it large.
  file = line(0, 0, 0) + line(1e9, 0, 0) + line(0, 1e9, 0);
  faces = triangle(0, 1, 2);
  for (uint32_t i = 0; i < kN; ++i)
    file += line(static_cast<double>(random() % 1000000) * 1e-6, static_cast<double>(random() % 1000000) * 1e-6,
                 static_cast<double>(random() % 1000000) * 1e-6);
  for (uint32_t i = 0; i + 2 < kN; i += 3) faces += triangle(3 + i, 4 + i, 5 + i);
  check({"cluster.off", ""}, header(kN + 3, 1 + kN / 3) + file + faces, tally);
  // A material file that holds no text, one that is a folder.
  saveFile("bad.mtl", std::string(1000, '\xff') + "\nnewmtl\nmap_Kd\nmap_Kd -s\nmap_Kd -o 1 2 3 -s\n");
  check({"bad.obj", ""}, "mtllib bad.mtl\nmtllib .\nmtllib /dev/null\nusemtl \nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        tally);
  tell("hostile", tally);
}

}  // namespace mesh_fuzz_test
}  // namespace relievo::test
