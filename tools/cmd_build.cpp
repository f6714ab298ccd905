// relievo build: raster files, or a scanned mesh, into a package.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <optional>

#include "src/base/file.h"
#include "texturing/image_io.h"
#include "texturing/package_builder.h"
#include "texturing/ptm.h"
#include "tools/build_mesh.h"
#include "tools/build_run.h"
#include "tools/commands.h"
#include "tools/output_files.h"

namespace relievo {
namespace {

struct BuildArguments {
  std::string output, ptm, image, relief, relief_mm, json_file;
  std::string mesh, texture, unit = "mm", report;
  uint32_t patches = 0;
  double tolerance_mm = 0;
  std::string encoding = "lossless", coefficients, colour;
  int quality = 90;
  double mm_per_px = 1.0;
  int workers = 0, zstd_level = 1;
  uint64_t memory_mib = 768;
};

Result<std::optional<std::pair<double, double>>> parseRange(const std::string& text) {
  if (text.empty()) return std::optional<std::pair<double, double>>();
  double low = 0, high = 0;
  int end = 0;
  if (std::sscanf(text.c_str(), "%lf:%lf%n", &low, &high, &end) != 2 || end != static_cast<int>(text.size()) || !std::isfinite(low) ||
      !std::isfinite(high) || high < low) {
    return usageError("expected --relief-mm MIN:MAX in mm with MIN <= MAX, found '" + text + "'", "for example -1.5:2.5");
  }
  return std::optional(std::pair(low, high));
}

std::string notNegative(const std::string& text) {
  char* end = nullptr;
  const double v = std::strtod(text.c_str(), &end);
  return end != text.c_str() && *end == 0 && v >= 0 && std::isfinite(v) ? "" : "expected a finite number from 0, found " + text;
}
std::string positive(const std::string& text) {
  return notNegative(text).empty() && std::strtod(text.c_str(), nullptr) > 0 ? "" : "expected a finite number above 0, found " + text;
}

Result<void> build(const BuildArguments& o) {
  if (o.mesh.empty() ? o.ptm.empty() == o.image.empty() : !o.image.empty()) {
    return usageError("expected one of --ptm FILE, --image FILE and --mesh FILE (with --ptm FILE, or without)", "see relievo build --help");
  }
  if (!o.ptm.empty() && !o.texture.empty() && o.texture != "none") {
    return usageError("expected --ptm FILE or --texture IMAGE for the mesh, found both");
  }
  if (o.relief.empty() && !o.relief_mm.empty()) return usageError("--relief-mm needs --relief HEIGHTMAP");
  auto range = parseRange(o.relief_mm);
  if (!range) return range.error();
  auto coefficients = parseEncoding(o.coefficients.empty() ? o.encoding : o.coefficients, o.quality);
  if (!coefficients) return coefficients.error();
  auto colour = parseEncoding(o.colour.empty() ? o.encoding : o.colour, o.quality);
  if (!colour) return colour.error();
  const std::vector<NamedFile> inputs{{"--mesh", o.mesh}, {"--texture", o.texture}, {"--ptm", o.ptm}, {"--image", o.image}, {"--relief", o.relief}};
  if (auto good = checkOutputs({{"-o", o.output}, {"--report", o.report}, {"--json", o.json_file}}, inputs); !good) return good;
  const uint64_t budget = o.memory_mib << 20;
  BuildOptions options;
  options.output = o.output;
  options.mm_per_px = o.mm_per_px;
  options.workers = o.workers;
  options.zstd_level = o.zstd_level;
  options.coefficients = *coefficients;
  options.colour = *colour;
  options.memory_budget_bytes = budget;
  if (!o.mesh.empty()) return buildFromMesh({o.mesh, o.texture, o.ptm, o.unit, o.patches, o.tolerance_mm, o.report, o.json_file, options});
  auto texture = o.ptm.empty() ? openColourImage(o.image) : openPtm(o.ptm, {.memory_budget_bytes = budget});
  if (!texture) return texture.error();
  std::unique_ptr<HeightSource> relief;
  if (!o.relief.empty()) {
    auto opened = openHeightImage(o.relief, *range);
    if (!opened) return opened.error();
    relief = std::move(*opened);
  }

  auto built = buildWithProgress(**texture, relief.get(), options);
  if (!built) return built.error();

  if (!o.json_file.empty()) {
    const double pixels = static_cast<double>((*texture)->width()) * static_cast<double>((*texture)->height());
    nlohmann::ordered_json json;
    json["package"] = o.output;
    json["width_px"] = (*texture)->width();
    json["height_px"] = (*texture)->height();
    json["pages"] = built->pages;
    json["package_bytes"] = built->package_bytes;
    json["bytes_per_px"] = static_cast<double>(built->package_bytes) / pixels;
    json["seconds"] = built->seconds;
    json["mpix_per_s"] = pixels / 1e6 / std::max(built->seconds, 1e-9);
    std::string text = json.dump(2) + "\n";
    if (o.json_file == "-") {
      std::fputs(text.c_str(), stdout);
      return {};
    }
    if (auto written = writeFile(o.json_file, {reinterpret_cast<const uint8_t*>(text.data()), text.size()}); !written) return written;
  }
  std::printf("%s\n", buildSummary(**texture, options, *built).c_str());
  return {};
}

}  // namespace

void addBuildCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<BuildArguments>();
  auto* c = app.add_subcommand("build", "Make a streamable package from a PTM or an image, and a height map; or from a scanned mesh");
  c->footer(
      "Example:\n  relievo build -o tablet.relievo --ptm tablet.ptm --mm-per-pixel 0.05 \\\n"
      "      --relief heights.tif --relief-mm -1.5:2.5\n"
      "  relievo build -o bust.relievo --mesh bust.ply --unit m --tolerance 0.05 --report bust.html\n"
      "  relievo build -o coin.relievo --mesh coin.obj --ptm coin.ptm\n\n"
      "A mesh is diagnosed first (what is repaired is said, and kept: `relievo info`; what cannot be is an error that names places),\n"
      "then laid over quadrilateral patches: heights along their normals, colours and normals on them.\n"
      "With --ptm its texture coordinates say which pixel of the PTM lies where, and the PTM's coefficients lie on the patches. The mesh's\n"
      "axes must be those of the photographs: x right, y up, z to the camera; light is turned into them however the object is seen, and\n"
      "light from behind is taken as grazing light from its side.\n\n"
      "Encodings of texture pages (relief is always exact):\n"
      "  lossless  exact; q8 is another name for it\n"
      "  q7 ... q4 values rounded to 2^7 ... 2^4 levels: an error of at most 1, 2, 4 or 8 of 255, no seams\n"
      "  jpeg      smallest; --quality chooses. Slow to decode\n"
      "  bc1 bc4 bc5 bc7  blocks that a GPU can sample: 0.5, 1.5, 1.5 and 1 byte per texel and plane of three channels\n"
      "What each costs is measured in texturing/ENCODINGS.md, and for your artwork by `relievo bench FILE --only encodings`.\n\n"
      "The package is written beside and renamed when whole; an interrupted build leaves nothing behind. No output takes the place of an\n"
      "input, of a file that the mesh names, or of another output.\n"
      "The same inputs give the same bytes, with any number of workers.");
  c->add_option("-o,--output", o->output, "Package to write")->required();
  c->add_option("--ptm", o->ptm, "Texture: a .ptm file (RGB, LRGB, LUM, JPEG_RGB, JPEG_LRGB); of a mesh with texture coordinates, too");
  c->add_option("--image", o->image, "Texture: a plain sRGB colour image (TIFF, PNG, JPEG, ...)");
  auto* mesh = c->add_option("--mesh", o->mesh, "A scan: .ply, .obj, .stl or .off; it is relief and texture");
  c->add_option("--texture", o->texture, "Image for the mesh's texture coordinates, or none [what the mesh names]")->needs(mesh);
  c->add_option("--unit", o->unit, "Of the mesh's coordinates: mm, cm, m or in")->check(CLI::IsMember({"mm", "cm", "m", "in"}))->needs(mesh)->capture_default_str();
  c->add_option("--patches", o->patches, "About how many patches, at most half of the triangles (or 1024); 0: as the shape asks for. How many there are is said")->check(CLI::Range(0u, 1u << 20))->needs(mesh)->capture_default_str();
  c->add_option("--tolerance", o->tolerance_mm, "Distance from the scan to aim at, mm; 0: 1e-4 of its diagonal. If it is not reached, that is said, and why")->check(notNegative)->needs(mesh)->capture_default_str();
  c->add_option("--report", o->report, "Write this HTML file: diagnosis, distances with a picture, time and memory")->needs(mesh);
  c->add_option("--relief", o->relief, "Height map, one channel: 8 or 16 bit (with --relief-mm), or float in mm")->excludes(mesh);
  c->add_option("--relief-mm", o->relief_mm, "MIN:MAX, the heights of the map's 0 and its largest value, mm");
  c->add_option("--mm-per-pixel", o->mm_per_px, "Size of a texture pixel, mm")->check(positive)->excludes(mesh)->capture_default_str();
  c->add_option("--workers", o->workers, "Threads; 0: one per core")->check(CLI::Range(0, 1024))->capture_default_str();
  c->add_option("--zstd-level", o->zstd_level, "Compression, -7 (fast) to 19 (small)")->check(CLI::Range(-7, 19))->capture_default_str();
  c->add_option("--encoding", o->encoding, "Of texture pages: lossless, q8 to q4, jpeg, bc1, bc4, bc5, bc7 (see below)")->capture_default_str();
  c->add_option("--encoding-coefficients", o->coefficients, "Of coefficient planes alone [as --encoding]");
  c->add_option("--encoding-colour", o->colour, "Of colour planes alone [as --encoding]");
  c->add_option("--quality", o->quality, "Of jpeg, 1 to 100")->check(CLI::Range(1, 100))->capture_default_str();
  c->add_option("--memory-mib", o->memory_mib, "Memory to stay within, MiB (a mesh may take more: 36 bytes a triangle as it is read; less than 90 makes it slower)")->check(CLI::Range(64, 1 << 20))->capture_default_str();
  c->add_option("--json", o->json_file, "Write a report to this JSON file; - for standard output. Of a mesh: with distances");
  c->callback([o, &context] {
    if (auto done = build(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
