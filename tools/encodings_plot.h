// encodings_plot.h - the figures of the page encodings as a picture (SVG) and as a table (Markdown).
#pragma once

#include <string>
#include <vector>

namespace relievo {

struct EncodingFigures {
  std::string name;
  bool exact = false;         // no pixel differs: psnr_db means nothing
  double psnr_db = 0;         // of relit pictures
  int max_error = 0;          // of 255
  double seam = 0;            // of 255
  double bytes_per_px = 0;    // of texture in the package, mip levels included
  double decode_us = 0;       // a page, CPU time
  double resident_rgba8 = 0;  // bytes per texel, all planes
  double resident_blocks = 0; // if the planes that hold blocks were uploaded as such
  double frame_ms = 0, settle_ms = 0;
  double frame_cpu_ms = 0, settle_cpu_ms = 0, encode_cpu_s = 0;  // of all threads
};

// PSNR over bytes per pixel and over the time to decode a page; what is exact is a line at its place.
std::string encodingsPlot(const std::vector<EncodingFigures>& figures);
std::string encodingsTable(const std::vector<EncodingFigures>& figures);

}  // namespace relievo
