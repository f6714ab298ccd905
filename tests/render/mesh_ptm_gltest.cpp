// A PTM baked onto a mesh, through the program as its users run it: over a flat mesh whose texture coordinates cover
// it, it looks like the flat artwork under the same light, from the front and aside. Controls: coefficients in another
// order, and a light in another frame.
#include <fstream>
#include <random>
#include <sstream>

#include "tests/tools/cli_fixture.h"
#include "texturing/import/image_io.h"
#include "texturing/import/ptm.h"

namespace mesh_ptm_gltest {

using namespace relievo;
using namespace relievo::testing_support;

constexpr int kWidth = 256, kHeight = 192;

// Smooth coefficients, all of them of weight: what a light in another frame, or another order, shows is another
// picture.
class WavyPtm final : public TextureSource {
 public:
  WavyPtm(Basis basis, bool swapped) : swapped_(swapped) {
    format_ = {.basis = basis, .scale = {1, 1, 1, 1, 1, 1}, .bias = {128, 128, 128, 128, 128, 0}};
  }
  int64_t width() const override { return kWidth; }
  int64_t height() const override { return kHeight; }
  TextureFormat format() const override { return format_; }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    for (int c = 0; c < format_.channels(); ++c) {
      const bool lrgb = format_.basis == Basis::kPtmLrgb;
      int k = lrgb ? c : c / 3;  // the coefficient; of LRGB 6 to 8: colour
      if (swapped_ && (k == 3 || k == 4)) k = 7 - k;
      for (int64_t y = 0; y < r.height; ++y) {
        for (int64_t x = 0; x < r.width; ++x) {
          const double px = static_cast<double>(r.x + x) / 40, py = static_cast<double>(r.y + y) / 30;
          const double wave = std::sin(px * (1 + 0.3 * k) + c) * std::cos(py * (1.5 - 0.2 * k));
          const double value = k >= 5 ? 170 + 50 * wave : 128 + (k == 3 ? 60 : 25) * wave + (k == 4 ? 30 : 0);
          out[static_cast<size_t>((c * r.height + y) * r.width + x)] = static_cast<uint8_t>(std::lround(value));
        }
      }
    }
    return {};
  }

 private:
  TextureFormat format_;
  bool swapped_;
};

class MeshPtm : public Cli {
 protected:
  // As large as the flat artwork of 0.5 mm a pixel, in the frame of its photographs.
  void writePlane(const std::string& name, bool uv = true) const {
    std::ostringstream out;
    constexpr int kCells = 24;
    for (int y = 0; y <= kCells; ++y)
      for (int x = 0; x <= kCells; ++x) {
        out << "v " << 0.5 * kWidth * x / kCells << " " << 0.5 * kHeight * y / kCells << " 0\n";
        if (uv) out << "vt " << static_cast<double>(x) / kCells << " " << static_cast<double>(y) / kCells << "\n";
      }
    for (int y = 0; y < kCells; ++y) {
      for (int x = 0; x < kCells; ++x) {
        auto at = [&](int i, int j) {
          const std::string k = std::to_string((y + j) * (kCells + 1) + x + i + 1);
          return uv ? k + "/" + k : k;
        };
        out << "f " << at(0, 0) << " " << at(1, 0) << " " << at(1, 1) << "\nf " << at(0, 0) << " " << at(1, 1) << " "
            << at(0, 1) << "\n";
      }
    }
    write(name, out.str());
  }
  Image8 picture(const std::string& package, const std::string& light, const std::string& camera) const {
    const Outcome drawn = relievo("render " + file(package) + " -o " + file("picture.png") +
                                  " --size 320x240 --settle --distance 300 --light " + light + " " + camera);
    EXPECT_EQ(drawn.exit_code, 0) << drawn.output;
    auto read = readImage8(file("picture.png"));
    EXPECT_TRUE(read);
    return read ? std::move(*read) : Image8{};
  }
};

struct Difference {
  int most = 0;
  double mean = 0;
};
// Inside the artwork: its outline is the mesh's own.
Difference difference(const Image8& a, const Image8& b) {
  Difference out;
  size_t count = 0;
  EXPECT_TRUE(a.width == b.width && a.height == b.height && a.channels == b.channels && a.width == 320);
  if (a.pixels.size() != b.pixels.size() || a.width != 320) return out;
  for (int y = 80; y < 160; ++y) {
    for (int x = 110; x < 210; ++x) {
      for (int c = 0; c < 3; ++c, ++count) {
        const size_t i = static_cast<size_t>((y * a.width + x) * a.channels + c);
        const int d = std::abs(a.pixels[i] - b.pixels[i]);
        out.most = std::max(out.most, d);
        out.mean += d;
      }
    }
  }
  out.mean /= static_cast<double>(count);
  return out;
}

TEST_F(MeshPtm, overAPlaneItIsTheFlatArtworksPicture) {
  writePlane("plane.obj");
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb}) {
    ASSERT_TRUE(writePtm(file("right.ptm"), WavyPtm(basis, false)));
    ASSERT_TRUE(writePtm(file("swapped.ptm"), WavyPtm(basis, true)));
    Outcome built = relievo("build --ptm " + file("right.ptm") + " --mm-per-pixel 0.5 -o " + file("flat.relievo"));
    ASSERT_EQ(built.exit_code, 0) << built.output;
    for (const char* name : {"right", "swapped"}) {
      built = relievo("build --mesh " + file("plane.obj") + " --ptm " + file(std::string(name) + ".ptm") + " -o " +
                      file(std::string(name) + ".relievo"));
      ASSERT_EQ(built.exit_code, 0) << built.output;
    }
    const std::string info = relievo("info " + file("right.relievo")).output;
    EXPECT_NE(info.find(basisName(basis)), std::string::npos) << info;
    for (const char* light : {"0,0,1", "0.6,0.1,0.5", "-0.2,-0.7,0.4"}) {
      const Image8 flat = picture("flat.relievo", light, ""), mesh = picture("right.relievo", light, "");
      const Difference same = difference(flat, mesh);
      // The planes are sampled once more on their way: bilinear between pixels of slow waves.
      EXPECT_LE(same.most, 6) << basisName(basis) << " " << light;
      EXPECT_LE(same.mean, 1.0) << basisName(basis) << " " << light;
      if (light[0] == '0' && light[2] == '0') continue;
      EXPECT_GT(difference(flat, picture("swapped.relievo", light, "")).mean, 5) << light;
      EXPECT_GT(difference(flat, picture("right.relievo", light[0] == '-' ? "-0.2,0.7,0.4" : "-0.6,0.1,0.5", "")).mean,
                5)
          << light;
    }
    // The camera 40 degrees to the right: a light from it is one from there in the frame of the photographs.
    const Image8 flat = picture("flat.relievo", "0.64278761,0,0.76604444", "--azimuth 40"),
                 mesh = picture("right.relievo", "0,0,1", "--azimuth 40");
    EXPECT_LE(difference(flat, mesh).most, 6);
    EXPECT_GT(difference(flat, picture("right.relievo", "0.64278761,0,0.76604444", "--azimuth 40")).mean, 3);
  }
}

TEST_F(MeshPtm, whatDoesNotFitIsOneError) {
  writePlane("plane.obj");
  writePlane("bare.obj", false);
  ASSERT_TRUE(writePtm(file("a.ptm"), WavyPtm(Basis::kPtmLrgb, false)));
  Outcome r = relievo("build --mesh " + file("bare.obj") + " --ptm " + file("a.ptm") + " -o " + file("o.relievo"));
  EXPECT_EQ(r.exit_code, 1);
  EXPECT_NE(r.output.find("texture coordinates"), std::string::npos) << r.output;
  r = relievo("build --mesh " + file("plane.obj") + " --ptm " + file("a.ptm") + " --texture " + file("a.png") + " -o " +
              file("o.relievo"));
  EXPECT_EQ(r.exit_code, 1);
  EXPECT_NE(r.output.find("found both"), std::string::npos) << r.output;
  // The mesh names an image of other proportions: a square for its 4 : 3.
  ASSERT_TRUE(writeImage(file("square.png"), 64, 64, 3, std::vector<uint8_t>(64 * 64 * 3, 90)));
  std::ifstream in(file("plane.obj"));
  std::stringstream plane;
  plane << in.rdbuf();
  write("named.obj", "mtllib named.mtl\nusemtl m\n" + plane.str());
  write("named.mtl", "newmtl m\nmap_Kd square.png\n");
  r = relievo("build --mesh " + file("named.obj") + " --ptm " + file("a.ptm") + " -o " + file("o.relievo"));
  EXPECT_EQ(r.exit_code, 3);
  EXPECT_NE(r.output.find("64 x 64"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("256 x 192"), std::string::npos) << r.output;
  EXPECT_EQ(filesNamed(".relievo"), 0);
  EXPECT_EQ(relievo("build --mesh " + file("named.obj") + " --texture none --ptm " + file("a.ptm") + " -o " +
                    file("o.relievo"))
                .exit_code,
            0);
  EXPECT_EQ(
      relievo("build --mesh " + file("plane.obj") + " --ptm " + file("no.ptm") + " -o " + file("p.relievo")).exit_code,
      2);
}

}  // namespace mesh_ptm_gltest
