#include "texturing/image_io.h"

#include <dlfcn.h>

#include <filesystem>

#include "texturing/image_io_module.h"

namespace relievo {
namespace {

#ifdef RELIEVO_IMAGE_LINKED
Result<const ImageIoModule*> load() { return &relievo_image_io; }
#else
// Beside the program, or where the build left it.
Result<const ImageIoModule*> load() {
  static const Result<const ImageIoModule*> loaded = []() -> Result<const ImageIoModule*> {
    std::error_code ignored;
    auto beside = std::filesystem::read_symlink("/proc/self/exe", ignored).parent_path() / RELIEVO_IMAGE_MODULE_NAME;
    std::string why;
    for (const std::string& path : {beside.string(), std::string(RELIEVO_IMAGE_MODULE)}) {
      void* library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
      if (library) {
        if (const void* symbol = dlsym(library, "relievo_image_io")) return static_cast<const ImageIoModule*>(symbol);
      }
      const char* reason = dlerror();
      why += (why.empty() ? "" : "; ") + std::string(reason ? reason : "no reason given");
    }
    return Error{ErrorKind::kRuntime, RELIEVO_IMAGE_MODULE_NAME, "cannot load the module that reads and writes images: " + why,
                 "it belongs beside the program; install OpenImageIO (libopenimageio2.4)", {}};
  }();
  return loaded;
}
#endif

}  // namespace

Result<std::unique_ptr<TextureSource>> openColourImage(const std::string& path, const ImageReadOptions& options) {
  auto module = load();
  if (!module) return module.error();
  return (*module)->open_colour(path, options);
}

Result<std::unique_ptr<HeightSource>> openHeightImage(const std::string& path, std::optional<std::pair<double, double>> range_mm,
                                                      const ImageReadOptions& options) {
  auto module = load();
  if (!module) return module.error();
  return (*module)->open_height(path, range_mm, options);
}

Result<void> writePng(const std::string& path, int width, int height, int channels, std::span<const uint8_t> pixels, double mm_per_px) {
  auto module = load();
  if (!module) return module.error();
  return (*module)->write_png(path, width, height, channels, pixels, mm_per_px);
}

Result<Image8> readImage8(const std::string& path) {
  auto module = load();
  if (!module) return module.error();
  return (*module)->read_image8(path);
}

Result<std::unique_ptr<ImageWriter>> ImageWriter::create(const std::string& path, int64_t width, int64_t height, int channels,
                                                         SampleType type) {
  auto module = load();
  if (!module) return module.error();
  return (*module)->create_writer(path, width, height, channels, type);
}

}  // namespace relievo
