#include "texturing/codec/page_jpeg_codec.h"

#include <algorithm>

#include "src/artwork/patch_domain.h"
#include "texturing/codec/jpeg_errors.h"

namespace relievo {
namespace {

using jpeg::jumpingErrors;
using jpeg::JumpingErrors;
using jpeg::leave;

constexpr int kBasicStep = 20;  // at quality 50: about the mean of JPEG's example tables

void nothing(j_compress_ptr) {}
boolean noMoreRoom(j_compress_ptr info) { leave(reinterpret_cast<j_common_ptr>(info)); }

}  // namespace

int jpegStep(int quality) {
  const int percent = quality < 50 ? 5000 / quality : 200 - 2 * quality;  // as libjpeg scales its tables
  return std::clamp((kBasicStep * percent + 50) / 100, 1, 255);
}

struct JpegPageEncoder::Impl {
  jpeg_compress_struct info;
  JumpingErrors errors;
  jpeg_destination_mgr destination;
};

JpegPageEncoder::JpegPageEncoder() : impl_(new Impl) {
  impl_->info.err = jumpingErrors(&impl_->errors);
  jpeg_create_compress(&impl_->info);
  impl_->destination.init_destination = nothing;
  impl_->destination.empty_output_buffer = noMoreRoom;
  impl_->destination.term_destination = nothing;
  impl_->info.dest = &impl_->destination;
}

JpegPageEncoder::~JpegPageEncoder() {
  jpeg_destroy_compress(&impl_->info);
  delete impl_;
}

size_t JpegPageEncoder::encode(const uint8_t* texels, int quality, bool ycc, std::span<uint8_t> out) {
  jpeg_compress_struct& c = impl_->info;
  impl_->destination.next_output_byte = out.data();
  impl_->destination.free_in_buffer = out.size();
  if (setjmp(impl_->errors.jump)) {
    jpeg_abort_compress(&c);
    return 0;
  }
  c.image_width = c.image_height = kPageFullPx;
  c.input_components = 4;
  c.in_color_space = JCS_EXT_RGBX;
  jpeg_set_defaults(&c);
  jpeg_set_colorspace(&c, ycc ? JCS_YCbCr : JCS_RGB);
  unsigned steps[DCTSIZE2];
  for (unsigned& s : steps) s = static_cast<unsigned>(jpegStep(quality));
  jpeg_add_quant_table(&c, 0, steps, 100, TRUE);
  for (int k = 0; k < 3; ++k) {
    c.comp_info[k].h_samp_factor = c.comp_info[k].v_samp_factor = 1;
    c.comp_info[k].quant_tbl_no = 0;
  }
  c.optimize_coding = TRUE;
  c.dct_method = JDCT_ISLOW;  // the same bits with and without SIMD
  jpeg_start_compress(&c, TRUE);
  while (c.next_scanline < c.image_height) {
    JSAMPROW row = const_cast<JSAMPROW>(texels + size_t{4} * kPageFullPx * c.next_scanline);
    jpeg_write_scanlines(&c, &row, 1);
  }
  jpeg_finish_compress(&c);
  return out.size() - impl_->destination.free_in_buffer;
}

struct JpegPageDecoder::Impl {
  jpeg_decompress_struct info;
  JumpingErrors errors;
  jpeg_source_mgr source;

  // Null, or what is wrong.
  const char* decode(const uint8_t* jpeg, size_t size, uint8_t* texels) {
    source.next_input_byte = jpeg;
    source.bytes_in_buffer = size;
    if (setjmp(errors.jump)) {
      jpeg_abort_decompress(&info);
      return "an encoded page holds a damaged JPEG";
    }
    jpeg_read_header(&info, TRUE);
    bool ours = info.image_width == kPageFullPx && info.image_height == kPageFullPx && info.num_components == 3 &&
                info.data_precision == 8 && !info.progressive_mode && !info.arith_code &&
                !jpeg_has_multiple_scans(&info) &&
                (info.jpeg_color_space == JCS_RGB || info.jpeg_color_space == JCS_YCbCr);
    for (int k = 0; ours && k < 3; ++k)
      ours = info.comp_info[k].h_samp_factor == 1 && info.comp_info[k].v_samp_factor == 1;
    if (!ours) {
      jpeg_abort_decompress(&info);
      return "an encoded page holds a JPEG of another size or kind";
    }
    info.out_color_space = JCS_EXT_RGBA;
    info.dct_method = JDCT_ISLOW;
    jpeg_start_decompress(&info);
    while (info.output_scanline < info.output_height) {
      JSAMPROW rows[8];
      for (unsigned i = 0; i < 8; ++i)
        rows[i] = texels + size_t{4} * kPageFullPx * std::min<unsigned>(info.output_scanline + i, kPageFullPx - 1);
      jpeg_read_scanlines(&info, rows, std::min<unsigned>(8, info.output_height - info.output_scanline));
    }
    jpeg_finish_decompress(&info);
    return source.bytes_in_buffer == 0 ? nullptr : "an encoded page goes on behind its JPEG";
  }
};

JpegPageDecoder::JpegPageDecoder() : impl_(new Impl) {
  impl_->info.err = jumpingErrors(&impl_->errors);
  jpeg_create_decompress(&impl_->info);
  jpeg::readFromMemory(impl_->info, impl_->source);
}

JpegPageDecoder::~JpegPageDecoder() {
  jpeg_destroy_decompress(&impl_->info);
  delete impl_;
}

Result<void> JpegPageDecoder::decode(std::span<const uint8_t> jpeg, uint8_t* texels) {
  if (const char* wrong = impl_->decode(jpeg.data(), jpeg.size(), texels))
    return Error{ErrorKind::kInvalidData, "", wrong, "rebuild the package, or get a whole copy", {}};
  return {};
}

}  // namespace relievo
