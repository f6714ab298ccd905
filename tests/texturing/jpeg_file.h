// jpeg_file.h - JPEGs of many kinds, by libjpeg itself.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>  // jpeglib.h needs FILE and size_t
#include <cstdlib>
#include <string>
#include <vector>

#include <jpeglib.h>

namespace relievo::testing_support {

struct JpegKind {
  int components = 3, samples = 2;
  bool progressive = false, comment = false, scans = false;  // a comment and an application's bytes; a scan a component
  int quality = 75;
};

// pixels: rows from the top.
inline std::vector<uint8_t> jpegFile(int width, int height, std::vector<uint8_t> pixels, const JpegKind& kind) {
  jpeg_compress_struct info;
  jpeg_error_mgr errors;
  info.err = jpeg_std_error(&errors);
  jpeg_create_compress(&info);
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&info, &bytes, &size);
  info.image_width = static_cast<JDIMENSION>(width), info.image_height = static_cast<JDIMENSION>(height);
  info.input_components = kind.components;
  info.in_color_space = kind.components == 3 ? JCS_RGB : kind.components == 4 ? JCS_CMYK : JCS_GRAYSCALE;
  jpeg_set_defaults(&info);
  jpeg_set_quality(&info, kind.quality, TRUE);
  info.restart_interval = 3;
  info.comp_info[0].h_samp_factor = info.comp_info[0].v_samp_factor = kind.samples;
  if (kind.progressive) jpeg_simple_progression(&info);
  const jpeg_scan_info one_each[3] = {{1, {0}, 0, 63, 0, 0}, {1, {1}, 0, 63, 0, 0}, {1, {2}, 0, 63, 0, 0}};
  if (kind.scans) info.scan_info = one_each, info.num_scans = 3;
  jpeg_start_compress(&info, TRUE);
  const std::string said = "made by nobody" + std::string(1, '\0');  // readers take it for text
  if (kind.comment)
    for (const int marker : {JPEG_COM, JPEG_APP0 + 1})
      jpeg_write_marker(&info, marker, reinterpret_cast<const JOCTET*>(said.data()),
                        static_cast<unsigned>(said.size()));
  while (info.next_scanline < info.image_height) {
    JSAMPROW row =
        &pixels[size_t{info.next_scanline} * static_cast<size_t>(width) * static_cast<size_t>(kind.components)];
    jpeg_write_scanlines(&info, &row, 1);
  }
  jpeg_finish_compress(&info);
  std::vector<uint8_t> out(bytes, bytes + size);
  jpeg_destroy_compress(&info);
  std::free(bytes);
  return out;
}

}  // namespace relievo::testing_support
