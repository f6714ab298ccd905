// encodings_plot.h - the figures of the page encodings as a picture (SVG) and as a table (Markdown).
#pragma once

#include <string>
#include <vector>

namespace relievo {

struct EncodingFigures {
  std::string name;
  bool exact = false;       // no pixel differs: psnr_db means nothing
  double psnr_db = 0;       // of relit pictures
  int max_error = 0;        // of 255
  double seam = 0;          // of 255
  double bytes_per_px = 0;  // of texture in the package, mip levels included
  double decode_us = 0;     // a page, CPU time
  double encode_cpu_s = 0;  // of all threads
  // As the pages lie on the GPU. CPU times are those of all threads.
  struct Shown {
    double resident = 0;  // bytes per texel, all planes
    double frame_ms = 0, frame_cpu_ms = 0, settle_ms = 0, settle_cpu_ms = 0;
  };
  Shown rgba8, blocks;
  bool as_blocks = false;  // false: the planes have no one block codec, or this context does not sample it
  int blocks_differ = 0;   // largest difference of the pictures of the two, of 255
};

// PSNR over bytes per pixel and over the time to decode a page; what is exact is a line at its place.
std::string encodingsPlot(const std::vector<EncodingFigures>& figures);
std::string encodingsTable(const std::vector<EncodingFigures>& figures);

}  // namespace relievo
