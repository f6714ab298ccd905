// fuzz_seeds FOLDER: writes the inputs that fuzzing begins with, FOLDER/TARGET/NAME, by the writers of the project and
// of its tests. Nothing binary is kept in the repository, and formats that change bring their seeds along.
#include <OpenImageIO/imageio.h>
#include <array>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "src/base/file.h"
#include "tests/fuzz/fuzz_packages.h"
#include "tests/geometry/mapped_sheet.h"
#include "tests/geometry/mesh_files.h"
#include "texturing/codec/page_codec.h"
#include "texturing/import/image_io.h"
#include "texturing/import/ptm.h"

namespace {

namespace fs = std::filesystem;
using namespace relievo;

fs::path out;
void put(const std::string& target, const std::string& name, const std::string& bytes) {
  fs::create_directories(out / target);
  std::ofstream(out / target / name, std::ios::binary) << bytes;
}
std::string load(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void meshes() {
  using namespace relievo::test;
  Sample plain = scanOfCubeSphere(1), full = sheet(2, 2);
  decorate(full, 3);
  for (Encoding e : {Encoding::kAscii, Encoding::kLittle, Encoding::kBig}) {
    const std::string name = std::to_string(static_cast<int>(e));
    put("ply", "plain" + name, plyFile(plain, {.encoding = e}));
    put("ply", "full" + name,
        plyFile(full, {.encoding = e, .coordinate = "double", .colour = "ushort", .count = "uint", .clutter = true}));
    put("ply", "uv" + name, plyFile(full, {.encoding = e, .colour = "float", .index = "ushort", .vertex_uv = true}));
  }
  put("ply", "strips",
      "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 4\nproperty float x\nproperty float "
      "y\nproperty float z\nelement tristrips 1\n"
      "property list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n6 0 1 2 -1 1 2\n");
  put("obj", "plain", objFile(plain));
  put("obj", "negative", objFile(full, true));
  put("obj", "materials",
      "mtllib scan.mtl\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nv 1 1 0 1 1 1\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl "
      "skin\nf 1/1 2/2 3/3\nusemtl cloth\nf 2//1 4//1 3//1\n"
      "f 1/1/1 2/2/1 \\\n 3/3/1\n#materials\nnewmtl skin\nKd 0.5 0.25 1\nmap_Kd -clamp on -s 1 1 1 my skin.png\nnewmtl "
      "cloth\nKd 1 0 0\n");
  put("obj", "mapped",
      "mtllib scan.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 2\nvn 1 0 1\nusemtl skin\nf 1/1/1 "
      "2/2/-1 3/3/1\n#materials\nnewmtl skin\nmap_Bump -bm 2 my skin.png\nnorm -clamp on b.png\n");
  for (bool binary : {false, true}) {
    put("off", binary ? "binary" : "text", offFile(plain, binary));
    put("off", binary ? "colour binary" : "colour text",
        offFile(
            [&] {
              Sample s = full;
              s.corner_uv.clear();
              return s;
            }(),
            binary));
    put("stl", binary ? "binary" : "text", stlFile(plain, binary));
  }
  const std::string images =
      ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}}],\"textures\":[{\"source\":0}],"
      "\"images\":[{\"bufferView\":1}]";
  const std::string nodes = "\"children\":[1]},{\"mesh\":0,\"rotation\":[0,0,1,0]";
  put("glb", "plain", glbFile(plain));
  put("glb", "full", glbFile(full, images, nodes));
  MappedSheet mapped = mappedSheet(2, 1);
  mapped.sample.tangents.assign(mapped.sample.positions.size(), {1, 0, 0, -1});
  const std::string normals =
      ",\"materials\":[{\"normalTexture\":{\"index\":0,\"scale\":2}}],\"textures\":[{\"source\":0}],\"images\":[{"
      "\"bufferView\":1}]";
  put("glb", "mapped", glbFile(mapped.sample, normals, nodes));
  put("gltf", "plain", gltfFile(plain));
  put("gltf", "full", gltfFile(full, images, nodes));
  const GltfText beside = gltfOf(sheet(1, 1), "scan.mtl");
  put("gltf", "beside", beside.json + "#materials\n" + beside.binary);
  put("off", "polygons", "OFF\n# a comment\n5 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 2 2\n5 0 1 2 3 4 255 0 0\n3 0 1 2\n");
  put("off", "lines", "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 \n1 \n2 3\n\n3\n0 1 2\n");
}

// A grey JPEG, as image files have it and as JPEG variants of .ptm hold one a plane.
std::string greyJpeg(int side) {
  const std::string path = fuzz::folder().file("plane.jpg");
  std::vector<uint8_t> pixels(static_cast<size_t>(side * side));
  for (size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<uint8_t>(37 * i);
  auto writer = ImageWriter::create(path, side, side, 1, SampleType::kUint8);
  fuzz::require(writer && (*writer)->appendRows(side, pixels.data()) && (*writer)->commit(),
                "a seed image could not be written");
  return load(path);
}

void ptms() {
  for (const Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb}) {
    const testing_support::NoisyTexture texture(5, 3, basis, 2);
    const std::string path = fuzz::folder().file("seed.ptm");
    fuzz::require(static_cast<bool>(writePtm(path, texture)), "a seed .ptm could not be written");
    std::string bytes = load(path);
    put("ptm", basis == Basis::kPtmRgb ? "rgb" : "lrgb", bytes);
    if (basis == Basis::kPtmRgb) continue;
    bytes[6] = '1';  // PTM_1.1
    put("ptm", "lrgb11", bytes);
  }
  const std::string numbers = "4\n3\n2 1.5 0.0625 2 1 1.25\n160 161 128 127 3 0\n";
  put("ptm", "lum",
      "PTM_1.2\nPTM_FORMAT_LUM\n" + numbers + "1.402 1 0 0 -0.71414 1 -0.34414 0 0 1 1.772 0 0 0 0 1\n" +
          std::string(4 * 3 * 8, 'x'));
  const std::string jpeg = greyJpeg(8);
  for (const int planes : {9, 18}) {
    std::string text = std::string("PTM_1.2\nPTM_FORMAT_JPEG_") + (planes == 9 ? "LRGB" : "RGB") +
                       "\n8\n8\n2 1.5 0.0625 2 1 1.25\n160 161 128 127 3 0\n95\n",
                data;
    auto line = [&](const std::function<int(int)>& number) {
      for (int k = 0; k < planes; ++k) text += (k ? " " : "") + std::to_string(number(k));
      text += "\n";
    };
    line([](int k) { return k % 3; });           // transform
    line([](int k) { return k == 2 ? 1 : 0; });  // motion
    line([](int k) { return k == 2 ? -1 : 0; });
    line([](int k) { return k; });                        // order
    line([](int k) { return k % 3 == 0 ? -1 : k - 1; });  // reference
    line([&](int) { return static_cast<int>(jpeg.size()); });
    line([](int k) { return k == 4 ? 3 : 0; });  // side information
    for (int k = 0; k < planes; ++k) data += jpeg + (k == 4 ? std::string("\0\0\1", 3) : "");
    put("ptm", planes == 9 ? "jpeg lrgb" : "jpeg rgb", text + data);
  }
}

void pages() {
  auto asText = [](int kind, std::span<const uint8_t> page) {
    return std::string(1, static_cast<char>(kind)) +
           std::string(reinterpret_cast<const char*>(page.data()), page.size());
  };
  std::vector<uint8_t> flat(kTexturePageBytes, 90), ramp(kTexturePageBytes);
  for (size_t i = 0; i < ramp.size(); ++i) ramp[i] = static_cast<uint8_t>(i % kPageFullPx);
  PageEncoder encoder(1);
  for (const char* name : {"lossless", "q5", "jpeg30", "jpeg80-ycc", "bc1", "bc4", "bc5", "bc7"}) {
    auto encoding = parseEncoding(name, 90);
    fuzz::require(static_cast<bool>(encoding), name);
    put("page", name, asText(0, encoder.encodeTexture(ramp, *encoding)));
    put("page", std::string("flat ") + name, asText(0, encoder.encodeTexture(flat, *encoding)));
  }
  // Uncompressed ones, whose bytes every change reaches.
  for (const char kind : {0, 1}) {
    std::string raw(1, kind);
    raw += std::string(1, '\0') + (kind ? std::string(1, '\3') : std::string("\1\2\5"));
    raw += std::string(kind ? 2 * kReliefPageSamples : 2 * size_t{kPageFullPx} * kPageFullPx + 1, '\0');
    put("page", kind ? "raw relief" : "raw texture", raw);
  }
  std::vector<uint8_t> smooth(kTexturePageBytes);
  for (size_t i = 0; i < smooth.size(); ++i)
    smooth[i] = static_cast<uint8_t>(i % kPageFullPx / 2 + i / kPageFullPx % 100);
  constexpr ChannelTolerance kTolerance{8, 4};
  put("page", "texture in fewer texels",
      asText(0, encoder.encodeTextureWithin(smooth, std::array{kTolerance, kTolerance, kTolerance}, false)));
  put("page", "hierarchical texture",
      asText(0, encoder.encodeTextureWithin(smooth, std::array{kTolerance, kTolerance, kTolerance}, true)));
  std::vector<uint16_t> heights(kReliefPageSamples);
  for (size_t i = 0; i < heights.size(); ++i)
    heights[i] = static_cast<uint16_t>(3 * (i % kReliefSamples) + 5 * (i / kReliefSamples));
  put("page", "relief", asText(1, encoder.encodeRelief(heights)));
  put("page", "hierarchical relief", asText(1, encoder.encodeRelief(heights, ReliefEncoding::kHierarchical)));
  std::vector<uint8_t> over_tail;
  for (uint8_t byte : encoder.encodeRelief(heights, ReliefEncoding::kOverTail)) over_tail.push_back(byte);
  addTailHeights(std::vector<uint16_t>(kTailHeightsBytes / 2, 900), over_tail);
  put("page", "relief over its tail", asText(1, over_tail));
  heights.assign(heights.size(), 77);
  put("page", "flat relief", asText(1, encoder.encodeRelief(heights)));
  put("page", "flat hierarchical relief", asText(1, encoder.encodeRelief(heights, ReliefEncoding::kHierarchical)));
}

void packages() {
  const char count = static_cast<char>(fuzz::samplePackages().size());
  for (char k = 0; k < count; ++k) {
    const std::string package(1, k);
    put("package", "whole " + std::to_string(k), package);
    auto change = [&](const char* name, char region, uint16_t offset, const std::string& bytes) {
      const std::string at{region, static_cast<char>(offset & 255), static_cast<char>(offset >> 8),
                           static_cast<char>(bytes.size())};
      put("package", name + std::string(" ") + std::to_string(k), package + at + bytes);
    };
    change("width", 0, 88, std::string("\1\0\0\0\1\0\0\0", 8));
    change("depths", 0, 128, std::string("\1\0\0\0\2\0\0\0", 8));
    change("basis", 0, 136, std::string("\2\0\0\0", 4));
    change("index", 3, 0, std::string(12, '\1'));
    change("manifest", 1, 0, "{\"sources\": [{\"name\": [1]}, 3], \"tool_version\": 1}");
    change("page", 4, 0, std::string("\7\21", 2));
    change("base", 2, 0, std::string("\7\0\0\0\2\0\0\0", 8));
    change("base corners", 2, 184, std::string("\1\0\0\0\0\0\0\0", 8));
    change("tails", 5, 0, std::string("\2\0\0\0\20\0\0\0", 8));
    change("tails chunk", 6, 300, std::string(40, '\5'));
    change("images", 7, 9, std::string(8, '\7'));
    change("tiles", 8, 0, std::string("\7\21", 2));
    put("package", "cut " + std::to_string(k), package + std::string("\xF1\x40\x01\0", 4));
    put("package", "copy " + std::to_string(k), package + std::string("\xF2\0\0\0\0\0\0\1x", 9));
  }
}

void images() {
  const std::vector<float> floats(6 * 5 * 3, 0.5f);
  const std::vector<uint16_t> shorts(6 * 5, 30000);
  const std::vector<uint8_t> bytes(6 * 5 * 3, 100);
  struct Kind {
    const char* name;
    int channels;
    SampleType type;
    const void* samples;
  };
  for (const Kind& k : {Kind{"0.png", 3, SampleType::kUint8, bytes.data()},
                        {"0.png", 1, SampleType::kUint16, shorts.data()},
                        {"1.tif", 3, SampleType::kUint8, bytes.data()},
                        {"1.tif", 1, SampleType::kUint16, shorts.data()},
                        {"1.tif", 1, SampleType::kFloat, floats.data()},
                        {"2.jpg", 3, SampleType::kUint8, bytes.data()},
                        {"2.jpg", 1, SampleType::kUint8, bytes.data()}}) {
    const std::string path = fuzz::folder().file(k.name);
    auto writer = ImageWriter::create(path, 6, 5, k.channels, k.type);
    fuzz::require(writer && (*writer)->appendRows(5, k.samples) && (*writer)->commit(),
                  "a seed image could not be written");
    put("image",
        std::string(k.name) + " " + std::to_string(k.channels) + " " + std::to_string(static_cast<int>(k.type)),
        std::string(1, static_cast<char>(k.name[0] - '0')) + load(path));
  }
}

// Formats that the project reads and does not write.
void otherImages() {
  const std::vector<float> pixels(6 * 5 * 3, 0.5f);
  for (const int channels : {1, 3})
    for (const char* compression : {"none", "zip"}) {
      const std::string path = fuzz::folder().file("image.exr");
      OIIO::ImageSpec spec(6, 5, channels, OIIO::TypeDesc::FLOAT);
      spec.attribute("DateTime", "");  // or it writes the time, and no two runs have the same inputs
      spec.attribute("compression", compression);
      auto output = OIIO::ImageOutput::create(path);
      fuzz::require(output && output->open(path, spec) && output->write_image(OIIO::TypeDesc::FLOAT, pixels.data()) &&
                        output->close(),
                    "a seed EXR could not be written");
      put("image", std::string("3.exr ") + compression + std::to_string(channels), std::string(1, 3) + load(path));
    }
}

void cameras() {
  put("state", "all",
      R"({"azimuth_deg": 20, "elevation_deg": -10.5, "distance_mm": 400, "fov_deg": 35, "orthographic": false, "target_mm": [1, 2, 3], "light": [0.1, 0, 1]})");
  put("state", "settings",
      R"({"format": "relievo-settings", "version": 1, "error_px": 2, "sampling": "bilinear", "prefetch": false})");
  put("state", "scene",
      R"({"format": "relievo-scene", "version": 1, "artwork": "a.relievo", "camera": {"azimuth_deg": 25, "fov_deg": 30},
"light": {"towards": [-0.8, 0.3, 0.4], "fixed": true}, "surface": {"exaggerate": 2}, "effects": {"exposure": 1, "show": "pages"},
"picture": {"size_px": [640, 360], "background": [0, 0, 0]}, "settings": {"error_px": 2, "sampling": "nearest"}})");
  put("state", "artworks", R"({"format": "relievo-scene", "version": 1, "artworks": [{"file": "a.relievo"},
{"file": "b.relievo", "pose": {"position_mm": [35, 0, 0], "rotate_deg": [0, 180, 0]}}]})");
  put("state", "empty", "{}");
  put("state", "parallel", R"({"orthographic": true, "distance_mm": 1e3})");
  put("path", "two",
      R"({"cameras": [{"azimuth_deg": 20, "elevation_deg": 10, "distance_mm": 400, "fov_deg": 35, "target_mm": [0, 0, 0]}, {"orthographic": true, "light": [0, 0, 1]}]})");
  put("path", "empty", R"({"cameras": []})");
  put("planted", "near", "RL?");
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: fuzz_seeds FOLDER\n");
    return 1;
  }
  out = argv[1];
  fs::remove_all(out);
  meshes();
  ptms();
  pages();
  packages();
  images();
  otherImages();
  cameras();
}
