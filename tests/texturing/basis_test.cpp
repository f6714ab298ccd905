// The registry of bases and their descriptions, packages of bases beside the PTM's, and what of them a reader refuses.
#include <gtest/gtest.h>
#include <xxhash.h>

#include <fstream>
#include <memory>

#include "src/artwork/bases/ptm.h"
#include "tests/other_bases.h"
#include "tests/texturing/package_fixture.h"
#include "texturing/codec/neutral_page.h"
#include "texturing/package/package.h"
#include "texturing/package/package_builder.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace basis_test {

using namespace testing_support;
using test::otherBases;
using test::otherFormat;

// Noise, in the channels of another basis.
class OtherTexture final : public TextureSource {
 public:
  explicit OtherTexture(Basis basis) : noise_(kWidth, kHeight, Basis::kColour, 3), format_(otherFormat(basis)) {}
  int64_t width() const override { return kWidth; }
  int64_t height() const override { return kHeight; }
  TextureFormat format() const override { return format_; }
  Provenance provenance() const override { return {"noise", "", "test"}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    size_t i = 0;
    for (int c = 0; c < format_.channels(); ++c)
      for (int64_t y = r.y; y < r.y + r.height; ++y)
        for (int64_t x = r.x; x < r.x + r.width; ++x) out[i++] = noise_.at(c, x, y);
    return {};
  }

 private:
  static constexpr int64_t kWidth = 150, kHeight = 90;
  NoisyTexture noise_;
  TextureFormat format_;
};

TEST(Bases, NamesAndPlacesAreThoseOfPackages) {
  const std::array<std::pair<Basis, const char*>, 4> expected{{{Basis::kColour, "colour"},
                                                               {Basis::kPtmLrgb, "ptm-lrgb"},
                                                               {Basis::kPtmRgb, "ptm-rgb"},
                                                               {Basis::kAlbedoNormal, "albedo-normal"}}};
  for (const auto& [basis, name] : expected) {
    EXPECT_STREQ(basisName(basis), name);
    EXPECT_EQ(findBasis(name), basis);
  }
  EXPECT_FALSE(findBasis("ptm"));
  EXPECT_EQ(textureName(Basis::kPtmLrgb, 1), "a3-a5");
  EXPECT_EQ(textureName(Basis::kPtmLrgb, 2), "colour");
  EXPECT_EQ(textureName(Basis::kPtmRgb, 4), "rgb-a4");
}

// Those that the program is built with are held to what registerBasis() asks of others.
TEST(Bases, TheBuiltInOnesAreSound) {
  for (size_t i = 0; i < basisCount(); ++i) {
    const BasisDescription& d = describe(static_cast<Basis>(i));
    if (d.shading == Shading::kLuminance || d.shading == Shading::kColours) {
      EXPECT_EQ(problemOf(d), "") << d.name;
    }
  }
}

TEST(Bases, ADescriptionThatIsWrongIsRefused) {
  const auto refusal = [](auto&& change) {
    static std::vector<std::unique_ptr<BasisDescription>> kept;
    kept.push_back(std::make_unique<BasisDescription>(test::kHsh4Lrgb));
    kept.back()->name = "test-wrong";
    change(*kept.back());
    const auto made = registerBasis(*kept.back());
    return made ? std::string() : made.error().message;
  };
  EXPECT_NE(refusal([](BasisDescription& d) { d.name = "ptm-rgb"; }).find("of this name"), std::string::npos);
  EXPECT_NE(refusal([](BasisDescription& d) { d.name = "Test Wrong"; }), "");
  EXPECT_NE(refusal([](BasisDescription& d) { d.planes = kMaxTexturePlanes + 1; }), "");
  EXPECT_NE(refusal([](BasisDescription& d) { d.coefficients = 5; }).find("coefficient 4"), std::string::npos);
  EXPECT_NE(refusal([](BasisDescription& d) { d.coefficients = 3; }).find("channel 3"), std::string::npos);
  EXPECT_NE(refusal([](BasisDescription& d) { d.channels[1].coefficient = 0; }).find("coefficient 0"),
            std::string::npos);
  EXPECT_NE(refusal([](BasisDescription& d) { d.channels[8].of = 1; }).find("colour"), std::string::npos);
  EXPECT_NE(refusal([](BasisDescription& d) { d.channels[0].of = 0; }), "");
  EXPECT_NE(refusal([](BasisDescription& d) { d.functions = nullptr; }), "");
  EXPECT_NE(refusal([](BasisDescription& d) { d.shading = Shading::kAlbedoNormal; }), "");
  EXPECT_EQ(refusal([](BasisDescription&) {}), "") << "control: as it is";
}

// Directions spread evenly over the upper hemisphere (z > 0): even in z and in the angle around it.
template <class Visit>
void forEachUpperLight(Visit visit) {
  constexpr int kRings = 200, kAround = 200;
  for (int i = 0; i < kRings; ++i)
    for (int k = 0; k < kAround; ++k) {
      const double z = (i + 0.5) / kRings, angle = 2 * test::kPi * (k + 0.5) / kAround, side = std::sqrt(1 - z * z);
      visit(std::array{side * std::cos(angle), side * std::sin(angle), z}, 1.0 / (kRings * kAround));
    }
}

// The means of products f_j f_k over the upper hemisphere.
std::vector<std::vector<double>> meanProducts(const BasisDescription& d) {
  const auto n = static_cast<size_t>(d.coefficients);
  std::vector<std::vector<double>> products(n, std::vector<double>(n));
  std::vector<double> f(n);
  forEachUpperLight([&](const std::array<double, 3>& light, double share) {
    d.functions(light, f);
    for (size_t j = 0; j < n; ++j)
      for (size_t k = 0; k < n; ++k) products[j][k] += share * f[j] * f[k];
  });
  return products;
}

// The least share of a function that is not a combination of those before it (Gram's matrix, by Cholesky's method): 0
// where one is.
double leastOwnShare(std::vector<std::vector<double>> a) {
  double least = 1;
  for (size_t j = 0; j < a.size(); ++j) {
    const double whole = a[j][j];
    for (size_t k = 0; k < j; ++k) a[j][j] -= a[j][k] * a[j][k];
    least = std::min(least, a[j][j] / whole);
    if (!(a[j][j] > 1e-12 * whole)) return 0;
    for (size_t i = j + 1; i < a.size(); ++i) {
      for (size_t k = 0; k < j; ++k) a[i][j] -= a[i][k] * a[j][k];
      a[i][j] /= std::sqrt(a[j][j]);
    }
  }
  return least;
}

std::vector<Basis> linearBases() {
  std::vector<Basis> all = otherBases();
  all.insert(all.end(), {Basis::kPtmLrgb, Basis::kPtmRgb});
  return all;
}

// A function that repeats another one, as by a slip of the pen, wastes its coefficients. (Which functions a basis ought
// to have no test can know.)
TEST(Bases, FunctionsAreIndependent) {
  for (Basis basis : linearBases()) EXPECT_GT(leastOwnShare(meanProducts(describe(basis))), 1e-6) << basisName(basis);
  BasisDescription repeated = test::kHsh4Lrgb;
  repeated.functions = [](const std::array<double, 3>& light, std::span<double> out) {
    test::harmonics(light, out);
    out[3] = out[1];
  };
  EXPECT_LT(leastOwnShare(meanProducts(repeated)), 1e-9) << "control";
}

TEST(Bases, DiffuseIsTheMeanOverTheUpperHemisphere) {
  const auto largestError = [](const BasisDescription& d) {
    const auto n = static_cast<size_t>(d.coefficients);
    std::vector<double> f(n), mean(n);
    forEachUpperLight([&](const std::array<double, 3>& light, double share) {
      d.functions(light, f);
      for (size_t k = 0; k < n; ++k) mean[k] += share * f[k];
    });
    double largest = 0;
    for (size_t k = 0; k < n; ++k) largest = std::max(largest, std::abs(mean[k] - d.diffuse[k]));
    return largest;
  };
  for (Basis basis : linearBases()) {
    const BasisDescription& d = describe(basis);
    if (d.shading != Shading::kLuminance) continue;  // nothing asks for it
    EXPECT_LT(largestError(d), 1e-4) << d.name;
    BasisDescription wrong = d;
    wrong.diffuse[0] += 0.01;
    EXPECT_GT(largestError(wrong), 1e-3) << "control";
  }
}

TEST(Bases, WhatIsMissingIsGreyUnderEveryLight) {
  for (Basis basis : linearBases()) {
    const TextureFormat f = isPtm(basis) ? sampleFormat(basis) : otherFormat(basis);
    std::vector<std::vector<uint8_t>> slots(static_cast<size_t>(f.planes()), std::vector<uint8_t>(kSlotBytes));
    std::vector<double> raw;
    for (int k = 0; k < f.planes(); ++k) {
      auto& slot = slots[static_cast<size_t>(k)];
      neutralPage(texturePlane(k), f, PageCodec::kLossless, slot.data());
      raw.insert(raw.end(), slot.begin(), slot.begin() + 3);
    }
    for (const std::array<double, 3>& light : {std::array{0.0, 0.0, 1.0}, {0.6, 0.0, 0.8}, {-0.48, 0.64, 0.6}})
      for (double grey : evaluatePixel(f, raw.data(), light)) EXPECT_NEAR(grey, 128, 12) << basisName(basis);
  }
}

class OtherPackage : public ::testing::TestWithParam<size_t> {
 protected:
  void SetUp() override {
    basis_ = otherBases()[GetParam()];
    OtherTexture texture(basis_);
    BuildOptions options;
    options.output = path_;
    options.tool_version = "test";
    auto built = buildPackage(texture, nullptr, options);
    ASSERT_TRUE(built.ok()) << built.error().text();
    std::ifstream in(path_, std::ios::binary);
    head_.resize(kHeaderBytes);
    in.read(reinterpret_cast<char*>(head_.data()), kHeaderBytes);
  }
  // Of the header with other bytes there; empty: it is taken.
  template <class T>
  std::optional<Error> refusal(size_t offset, T value) const {
    std::vector<uint8_t> head = head_;
    std::memcpy(head.data() + offset, &value, sizeof value);
    const uint64_t hash = XXH3_64bits(head.data(), kHeaderBytes - 8);
    std::memcpy(head.data() + kHeaderBytes - 8, &hash, sizeof hash);
    auto decoded = decodeHeader(head, "p");
    if (decoded) return std::nullopt;
    return decoded.error();
  }
  ScratchFolder folder_;
  std::string path_ = folder_.file("other.relievo");
  Basis basis_{};
  std::vector<uint8_t> head_;
};

TEST_P(OtherPackage, ComesBackAsItWas) {
  auto package = Package::open(path_);
  ASSERT_TRUE(package.ok()) << package.error().text();
  EXPECT_TRUE((*package)->warnings().empty());
  const Manifest& m = (*package)->manifest();
  const OtherTexture texture(basis_);
  EXPECT_EQ(head_[8], 3) << "the version";
  EXPECT_EQ(m.texture.basis, basis_);
  EXPECT_EQ(m.texture.scale, texture.format().scale);
  EXPECT_EQ(m.texture.bias, texture.format().bias);
  EXPECT_NE((*package)->manifestJson().find(basisName(basis_)), std::string::npos);
  auto verified = verifyPackage(**package, 2, nullptr);
  ASSERT_TRUE(verified.ok());
  EXPECT_TRUE(verified->damaged.empty() && verified->other.empty());

  const FlatDomain d = m.domain.flat();
  PageDecoder decoder;
  std::vector<uint8_t> channels(kTexturePageBytes);
  size_t different = 0, shifted = 0;
  for (int plane = 0; plane < m.texture.planes(); ++plane) {
    auto page = (*package)->read(PageId(texturePlane(plane), {0, static_cast<uint32_t>(d.texture_depth), 0, 0}));
    ASSERT_TRUE(page.ok()) << page.error().text();
    ASSERT_TRUE(decoder.decodeTexture(page->bytes, channels).ok());
    std::vector<uint8_t> finest(static_cast<size_t>(m.texture.channels()) * 64 * 64);
    ASSERT_TRUE(texture.read({0, 0, 64, 64}, finest).ok());
    for (size_t c = 0; c < 3; ++c)
      for (size_t y = 0; y < 64; ++y)
        for (size_t x = 0; x < 64; ++x) {
          const size_t at = (c * kPageFullPx + y + kPageBorderPx) * kPageFullPx + x + kPageBorderPx;
          const uint8_t expected = finest[((static_cast<size_t>(3 * plane) + c) * 64 + y) * 64 + x];
          different += channels[at] != expected;
          shifted += channels[at - 1] != expected;
        }
  }
  EXPECT_EQ(different, 0u);
  EXPECT_GT(shifted, 1000u) << "control: a texel to the side";
}

TEST_P(OtherPackage, WhatAReaderDoesNotKnowIsUnsupported) {
  std::string name = basisName(basis_);
  EXPECT_FALSE(refusal(320, name[0])) << "control: a field set to what it is";
  name[0] = name[0] == 'x' ? 'y' : 'x';
  auto unknown = refusal(320, name[0]);
  ASSERT_TRUE(unknown);
  EXPECT_EQ(unknown->kind, ErrorKind::kUnsupported);
  EXPECT_NE(unknown->message.find("basis '" + name), std::string::npos) << unknown->message;
  for (size_t field : {352, 356, 360, 364}) {  // shading, planes, coefficients, numbers of scales and biases
    auto other = refusal(field, uint32_t{77});
    ASSERT_TRUE(other) << field;
    EXPECT_EQ(other->kind, ErrorKind::kUnsupported);
    EXPECT_NE(other->message.find("found 77"), std::string::npos) << other->message;
  }
  auto encoding = refusal(368 + 2, uint8_t{200});
  ASSERT_TRUE(encoding);
  EXPECT_EQ(encoding->kind, ErrorKind::kUnsupported);
  EXPECT_NE(encoding->message.find("plane 1"), std::string::npos) << encoding->message;
}

TEST_P(OtherPackage, HostileFieldsAreRefused) {
  EXPECT_EQ(refusal(136, uint32_t{1})->kind, ErrorKind::kInvalidData) << "a number in the place of a name";
  EXPECT_EQ(refusal(432, double{NAN})->kind, ErrorKind::kInvalidData);
  EXPECT_EQ(refusal(432 + 8 * static_cast<size_t>(describe(basis_).coefficients), double{INFINITY})->kind,
            ErrorKind::kInvalidData);
  std::array<char, 32> name{};
  name.fill('a');  // without an end
  EXPECT_EQ(refusal(320, name)->kind, ErrorKind::kUnsupported);
  name = {"ptm-rgb"};
  EXPECT_EQ(refusal(320, name)->kind, ErrorKind::kInvalidData) << "it is written in version 1";
}

INSTANTIATE_TEST_SUITE_P(Bases, OtherPackage, ::testing::Range(size_t{0}, otherBases().size()));

}  // namespace basis_test
}  // namespace relievo
