#include "tools/build_run.h"

#include <algorithm>
#include <cstdio>

#include "src/base/progress.h"
#include "texturing/package/patch_package_builder.h"

namespace relievo {
namespace {

std::string duration(double seconds) {
  char text[32];
  if (seconds < 60) {
    std::snprintf(text, sizeof text, "%.0f s", seconds);
  } else {
    std::snprintf(text, sizeof text, "%d min %02d s", static_cast<int>(seconds / 60), static_cast<int>(seconds) % 60);
  }
  return text;
}

void watch(BuildOptions& options, ProgressLine& line) {
  options.tool_version = "relievo " RELIEVO_VERSION;
  options.interrupted = &interruptedFlag();
  options.note = [](const std::string& text) { std::fprintf(stderr, "relievo: note: %s\n", text.c_str()); };
  options.progress = [&line](const BuildProgress& p) {
    auto share = [](uint64_t done, uint64_t total) {
      return total > 0 ? static_cast<double>(done) / static_cast<double>(total) : 0;
    };
    // Over a base mesh all texels are made before the first page is written.
    const double fraction = 0.5 * (share(p.pages_done, p.pages_total) + share(p.texels_done, p.texels_total));
    char text[160];
    std::snprintf(text, sizeof text, "%llu of %llu pages, %.1f MPix/s, %s left",
                  static_cast<unsigned long long>(p.pages_done), static_cast<unsigned long long>(p.pages_total),
                  static_cast<double>(p.texels_done) / 1e6 / std::max(p.seconds, 1e-3),
                  fraction > 0 ? duration(p.seconds * (1 - fraction) / fraction).c_str() : "?");
    line.update(fraction, text);
  };
}

}  // namespace

Result<BuildReport> buildWithProgress(const TextureSource& texture, const HeightSource* relief, BuildOptions options) {
  ProgressLine line("package");
  watch(options, line);
  return buildPackage(texture, relief, options);
}

Result<BuildReport> buildPatchesWithProgress(const PatchSource& source, BuildOptions options) {
  ProgressLine line("package");
  watch(options, line);
  return buildPatchPackage(source, options);
}

std::string buildSummary(const TextureSource& texture, const BuildOptions& options, const BuildReport& report) {
  double pixels = static_cast<double>(texture.width()) * static_cast<double>(texture.height());
  char text[200];
  std::snprintf(text, sizeof text, "%lld x %lld px, %llu pages, %.1f MiB (%.2f bytes per pixel), %.1f s, %.1f MPix/s",
                static_cast<long long>(texture.width()), static_cast<long long>(texture.height()),
                static_cast<unsigned long long>(report.pages), static_cast<double>(report.package_bytes) / (1 << 20),
                static_cast<double>(report.package_bytes) / pixels, report.seconds,
                pixels / 1e6 / std::max(report.seconds, 1e-9));
  return options.output + ": " + text;
}

std::string alphaWarning(const std::string& image) {
  return image +
         ": its alpha channel is ignored; colours are taken as they are stored, those that are transparent, too";
}

}  // namespace relievo
