// image_io_module.h - what the module around OpenImageIO hands to image_io.cpp. OpenImageIO pulls in some 260 shared objects, which
// cost a program 60 ms to start; so only a program that reads or writes an image loads them.
#pragma once

#include "texturing/image_io.h"

namespace relievo {

// Exported as relievo_image_io; the functions are those of image_io.h.
struct ImageIoModule {
  decltype(&openColourImage) open_colour;
  decltype(&openHeightImage) open_height;
  decltype(&writePng) write_png;
  decltype(&readImage8) read_image8;
  decltype(&ImageWriter::create) create_writer;
};

extern "C" __attribute__((visibility("default"))) const ImageIoModule relievo_image_io;  // image_io_oiio.cpp

}  // namespace relievo
