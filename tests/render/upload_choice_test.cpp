#include "src/engine/upload_choice.h"

#include <gtest/gtest.h>

#include <array>

namespace relievo {
namespace upload_choice_test {

const auto kHasAll = [](PageCodec) { return std::optional<std::string>(); };
const auto kHasNone = [](PageCodec) { return std::optional<std::string>("GL_a_certain_extension"); };

Manifest manifestOf(std::array<PageCodec, 3> codecs) {
  Manifest m;
  m.texture.basis = Basis::kPtmLrgb;
  for (size_t k = 0; k < 3; ++k) m.encodings[k].codec = codecs[k];
  return m;
}

TEST(UploadChoice, Names) {
  for (Upload u : {Upload::kAuto, Upload::kRgba8, Upload::kBlocks}) EXPECT_EQ(uploadFromName(uploadName(u)), u);
  EXPECT_FALSE(uploadFromName("bc7"));
  EXPECT_EQ(uploadFormatName(PageCodec::kBc7), "bc7 blocks");
  EXPECT_EQ(uploadFormatName(PageCodec::kJpeg), "rgba8");
}

TEST(UploadChoice, BlocksNeedOneBlockCodecInAllPlanes) {
  using C = PageCodec;
  for (C codec : {C::kBc1, C::kBc4, C::kBc5, C::kBc7})
    EXPECT_EQ(commonBlockCodec(manifestOf({codec, codec, codec})), codec);
  for (auto codecs : {std::array{C::kBc4, C::kBc4, C::kBc1},
                      {C::kLossless, C::kLossless, C::kLossless},
                      {C::kBc7, C::kLossless, C::kBc7},
                      {C::kJpeg, C::kJpeg, C::kJpeg}}) {
    EXPECT_FALSE(commonBlockCodec(manifestOf(codecs)));
    for (Upload wanted : {Upload::kAuto, Upload::kBlocks}) {
      auto choice = chooseUpload(wanted, manifestOf(codecs), false, kHasAll);
      ASSERT_TRUE(choice.ok());
      EXPECT_FALSE(isBlockCodec(choice->codec));
      EXPECT_NE(choice->why_not_blocks, "");
    }
  }
  Manifest colour = manifestOf({C::kBc1, C::kLossless, C::kLossless});
  colour.texture.basis = Basis::kColour;
  EXPECT_EQ(commonBlockCodec(colour), C::kBc1) << "planes that it does not have do not count";
}

TEST(UploadChoice, AutoTakesBlocksWhereTheyAreSampledInHardware) {
  const Manifest m = manifestOf({PageCodec::kBc7, PageCodec::kBc7, PageCodec::kBc7});
  EXPECT_EQ(chooseUpload(Upload::kAuto, m, false, kHasAll)->codec, PageCodec::kBc7);
  EXPECT_EQ(chooseUpload(Upload::kAuto, m, true, kHasAll)->codec, PageCodec::kLossless);
  EXPECT_NE(chooseUpload(Upload::kAuto, m, true, kHasAll)->why_not_blocks, "");
  EXPECT_EQ(chooseUpload(Upload::kAuto, m, false, kHasNone)->codec, PageCodec::kLossless);
  EXPECT_NE(chooseUpload(Upload::kAuto, m, false, kHasNone)->why_not_blocks.find("GL_a_certain_extension"),
            std::string::npos);
  EXPECT_EQ(chooseUpload(Upload::kRgba8, m, false, kHasAll)->codec, PageCodec::kLossless);
  EXPECT_EQ(chooseUpload(Upload::kBlocks, m, true, kHasAll)->codec, PageCodec::kBc7) << "asked for";
  auto refused = chooseUpload(Upload::kBlocks, m, false, kHasNone);
  ASSERT_FALSE(refused.ok());
  EXPECT_EQ(refused.error().kind, ErrorKind::kUnsupported);
  EXPECT_NE(refused.error().text().find("GL_a_certain_extension"), std::string::npos);
}

}  // namespace upload_choice_test
}  // namespace relievo
