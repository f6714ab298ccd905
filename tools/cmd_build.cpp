// relievo build: raster files, or a scanned mesh, into a package.
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>

#include "src/base/file.h"
#include "src/base/standard_output.h"
#include "texturing/import/image_io.h"
#include "texturing/import/ptm.h"
#include "texturing/package/package_builder.h"
#include "tools/build_mesh.h"
#include "tools/build_run.h"
#include "tools/commands.h"
#include "tools/output_files.h"

namespace relievo {
namespace {

struct BuildArguments {
  std::string output, ptm, image, relief, relief_mm, relief_px, mm_per_px, json_file;
  std::string mesh, texture, unit, up = "y", rotate, report;
  uint32_t patches = 0;
  std::string tolerance;
  bool strict = false;
  double texture_tolerance = kTextureTolerance;
  std::string encoding = "lossless", coefficients, colour;
  int quality = 90;
  bool stretch_relief = false, allow_outside = false;
  uint64_t max_tile_mib = 0, max_image_mib = 0, max_packing = ImageReadOptions().max_packing;
  int workers = 0, zstd_level = 1;
  uint64_t memory_mib = 768;
  bool resume = false;
  double checkpoint_s = kCheckpointSeconds;
};

Result<std::optional<std::pair<double, double>>> parseRange(const std::string& text, const std::string& option,
                                                            const std::string& unit) {
  if (text.empty()) return std::optional<std::pair<double, double>>();
  double low = 0, high = 0;
  int end = 0;
  if (std::sscanf(text.c_str(), "%lf:%lf%n", &low, &high, &end) != 2 || end != static_cast<int>(text.size()) ||
      !std::isfinite(low) || !std::isfinite(high) || high < low) {
    return usageError("expected " + option + " MIN:MAX in " + unit + " with MIN <= MAX, found '" + text + "'",
                      "for example -1.5:2.5");
  }
  return std::optional(std::pair(low, high));
}

std::string notNegative(const std::string& text) {
  char* end = nullptr;
  const double v = std::strtod(text.c_str(), &end);
  return end != text.c_str() && *end == 0 && v >= 0 && std::isfinite(v)
             ? ""
             : "expected a finite number from 0, found " + text;
}
std::string positive(const std::string& text) {
  return notNegative(text).empty() && std::strtod(text.c_str(), nullptr) > 0
             ? ""
             : "expected a finite number above 0, found " + text;
}

// A tolerance's number, where it is in that unit ("mm", or "%" of the diagonal); plain numbers are mm. Else 0.
double toleranceIn(const std::string& text, const std::string& unit) {
  char* end = nullptr;
  const double v = std::strtod(text.c_str(), &end);
  const std::string rest = end;
  return rest == unit || (rest.empty() && unit == "mm") ? v : 0;
}
std::string tolerance(const std::string& text) {
  const std::string number = text.substr(0, text.find_first_of("m%"));
  if (std::string problem = notNegative(number); !problem.empty())
    return "expected a finite number from 0, found " + text;
  const std::string unit = text.substr(number.size());
  return unit.empty() || unit == "mm" || unit == "%" ? "" : "expected mm, or % of the diagonal, found " + text;
}

std::string threeAngles(const std::string& text) {
  return numbersOf(text, 3) ? "" : "expected three angles X,Y,Z in degrees, found " + text;
}

std::string positiveOrTag(const std::string& text) {
  return text == "tag" || positive(text).empty() ? "" : "expected a finite number above 0, or tag, found " + text;
}

std::string formatted(const char* format, double value) {
  char text[40];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

// How large a pixel of the texture is. A file's resolution tag is offered, never taken unasked: a scanner's is the
// object's size, a camera's 72 dpi are nobody's.
Result<void> takeSize(const BuildArguments& o, const ImageReadOptions& limits, BuildOptions& options,
                      std::vector<std::string>& warnings) {
  const bool given = !o.mm_per_px.empty() && o.mm_per_px != "tag";
  if (given) options.mm_per_px = std::strtod(o.mm_per_px.c_str(), nullptr);
  options.size_known = given;
  ImageFacts facts;
  if (!o.image.empty()) {
    auto read = readImageFacts(o.image, limits);
    if (!read) return read.error();
    facts = std::move(*read);
    if (facts.alpha) warnings.push_back(alphaWarning(o.image));
  }
  if (given) return {};
  if (o.mm_per_px == "tag") {
    if (!(facts.tag_mm_per_px > 0)) {
      return Error{ErrorKind::kUsage,
                   o.image.empty() ? o.ptm : o.image,
                   "expected a resolution tag for --mm-per-pixel tag, found none",
                   "give the size of a pixel in mm",
                   {}};
    }
    options.mm_per_px = facts.tag_mm_per_px;
    options.size_known = true;
    return {};
  }
  if (facts.tag_mm_per_px > 0) {
    warnings.push_back(o.image + ": no size is known, lengths count px; its resolution tag says " + facts.tag +
                       ": add --mm-per-pixel " + formatted("%.4g", facts.tag_mm_per_px) +
                       " (or tag) if that is the size of the object");
  } else {
    warnings.push_back((o.image.empty() ? o.ptm : o.image) +
                       ": no size is known, lengths count px; --mm-per-pixel gives it");
  }
  return {};
}

// Heights in mm beside pixels of no known size would be a scale that lies.
Result<std::optional<std::pair<double, double>>> reliefRange(const BuildArguments& o, const BuildOptions& options) {
  if (!o.relief_px.empty() && !o.relief_mm.empty())
    return usageError("--relief-mm and --relief-px both say how high the relief is", "leave out one of them");
  auto range =
      o.relief_px.empty() ? parseRange(o.relief_mm, "--relief-mm", "mm") : parseRange(o.relief_px, "--relief-px", "px");
  if (!range) return range;
  if (!o.relief.empty() && o.relief_px.empty() && !options.size_known) {
    return usageError("heights in mm need the size of a pixel in mm, too",
                      "add --mm-per-pixel, or give the heights in px with --relief-px MIN:MAX");
  }
  if (*range && !o.relief_px.empty()) (*range)->first *= options.mm_per_px, (*range)->second *= options.mm_per_px;
  return range;
}

Result<void> build(const BuildArguments& o) {
  if (o.mesh.empty() ? o.ptm.empty() == o.image.empty() : !o.image.empty()) {
    return usageError("expected one of --ptm FILE, --image FILE and --mesh FILE (with --ptm FILE, or without)",
                      o.relief.empty() ? "see relievo build --help"
                                       : "a height map lies under a texture; a plain one is an image of its size");
  }
  if (!o.ptm.empty() && !o.texture.empty() && o.texture != "none") {
    return usageError("expected --ptm FILE or --texture IMAGE for the mesh, found both");
  }
  if (o.resume && !o.mesh.empty()) {
    return usageError(
        "--resume goes on with builds from --ptm or --image; a mesh's is computed in memory and leaves nothing to go "
        "on from",
        "leave --resume out");
  }
  if (o.relief.empty() && !(o.relief_mm.empty() && o.relief_px.empty()))
    return usageError("--relief-mm and --relief-px need --relief HEIGHTMAP");
  auto coefficients = parseEncoding(o.coefficients.empty() ? o.encoding : o.coefficients, o.quality);
  if (!coefficients) return coefficients.error();
  auto colour = parseEncoding(o.colour.empty() ? o.encoding : o.colour, o.quality);
  if (!colour) return colour.error();
  const std::vector<NamedFile> inputs{
      {"--mesh", o.mesh}, {"--texture", o.texture}, {"--ptm", o.ptm}, {"--image", o.image}, {"--relief", o.relief}};
  if (auto good =
          checkOutputs({{"-o", o.output, Content::kPackage}, {"--report", o.report}, {"--json", o.json_file}}, inputs);
      !good)
    return good;
  const uint64_t budget = o.memory_mib << 20;
  BuildOptions options;
  options.output = o.output;
  options.stretch_relief = o.stretch_relief;
  options.workers = o.workers;
  options.zstd_level = o.zstd_level;
  options.coefficients = *coefficients;
  options.colour = *colour;
  options.memory_budget_bytes = budget;
  const ImageReadOptions limits{.memory_budget_bytes = budget,
                                .max_tile_bytes = o.max_tile_mib << 20,
                                .max_decoded_bytes = o.max_image_mib << 20,
                                .max_packing = o.max_packing};
  if (!o.mesh.empty()) {
    const std::vector<double> turn = numbersOf(o.rotate, 3).value_or(std::vector<double>(3));
    return buildFromMesh({o.mesh, o.texture, o.ptm, o.unit, o.patches, toleranceIn(o.tolerance, "mm"),
                          toleranceIn(o.tolerance, "%") / 100, o.strict, o.report, o.json_file, o.allow_outside, limits,
                          options, o.up[0], glm::dvec3(turn[0], turn[1], turn[2]), o.texture_tolerance});
  }
  options.resume = o.resume;
  options.checkpoint_s = o.checkpoint_s;
  std::vector<std::string> warnings;  // said once all inputs are open: a failure is one line
  if (auto taken = takeSize(o, limits, options, warnings); !taken) return taken;
  auto range = reliefRange(o, options);
  if (!range) return range.error();
  auto texture = o.ptm.empty() ? openColourImage(o.image, limits) : openPtm(o.ptm, {.memory_budget_bytes = budget});
  if (!texture) return texture.error();
  std::unique_ptr<HeightSource> relief;
  if (!o.relief.empty()) {
    auto opened = openHeightImage(o.relief, *range, limits);
    if (!opened) return opened.error();
    relief = std::move(*opened);
  }

  for (const std::string& warning : warnings) warn(warning);
  auto built = buildWithProgress(**texture, relief.get(), options);
  if (!built) return built.error();

  if (!o.json_file.empty()) {
    const double pixels = static_cast<double>((*texture)->width()) * static_cast<double>((*texture)->height());
    auto json = nlohmann::ordered_json::object();
    json["package"] = o.output;
    json["width_px"] = (*texture)->width();
    json["height_px"] = (*texture)->height();
    json["mm_per_px"] = options.size_known ? nlohmann::ordered_json(options.mm_per_px) : nlohmann::ordered_json();
    json["pages"] = built->pages;
    json["package_bytes"] = built->package_bytes;
    json["bytes_per_px"] = static_cast<double>(built->package_bytes) / pixels;
    json["seconds"] = built->seconds;
    json["mpix_per_s"] = pixels / 1e6 / std::max(built->seconds, 1e-9);
    std::string text = json.dump(2) + "\n";
    auto written = writeFile(o.json_file, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
    if (!written || o.json_file == "-") return written;
  }
  printOutf("%s\n", buildSummary(**texture, options, *built).c_str());
  return {};
}

constexpr const char* kFooter =
    "Example:\n  relievo build -o tablet.relievo --ptm tablet.ptm --mm-per-pixel 0.05 \\\n"
    "      --relief heights.tif --relief-mm -1.5:2.5\n"
    "  relievo build -o bust.relievo --mesh bust.ply --unit m --tolerance 0.05 --report bust.html\n"
    "  relievo build -o coin.relievo --mesh coin.obj --ptm coin.ptm\n\n"
    "A mesh is diagnosed first (what is repaired is said, and kept: `relievo info`; what cannot be is an error that "
    "names places),\n"
    "then laid over quadrilateral patches: heights along their normals, colours and normals on them. Where that takes "
    "fewer bytes,\n"
    "patches are pairs of its own triangles, without heights.\n"
    "With --ptm its texture coordinates say which pixel of the PTM lies where, and the PTM's coefficients lie on the "
    "patches. The mesh's\n"
    "axes must be those of the photographs: x right, y up, z to the camera; light is turned into them however the "
    "object is seen, and\n"
    "light from behind is taken as grazing light from its side.\n\n"
    "Encodings of texture pages (relief is always exact):\n"
    "  lossless  exact, of scans within --texture-tolerance; q8 is another name for it\n"
    "  q7 ... q4 values rounded to 2^7 ... 2^4 levels: an error of at most 1, 2, 4 or 8 of 255, no seams\n"
    "  jpeg      smallest; --quality chooses. Slow to decode\n"
    "  bc1 bc4 bc5 bc7  blocks that a GPU can sample: 0.5, 1.5, 1.5 and 1 byte per texel and plane of three "
    "channels\n"
    "What each costs is measured in texturing/ENCODINGS.md, and for your artwork by `relievo bench FILE --only "
    "encodings`.\n\n"
    "The package is written beside and renamed when whole; an interrupted build leaves nothing behind. One that is "
    "killed leaves files\n"
    "named OUTPUT.part-...: the next build of that output removes them, or goes on from them with --resume (every 10 "
    "s there is a\n"
    "checkpoint; if inputs, options or program differ, or the files are damaged, it starts anew). No output takes "
    "the place of an\n"
    "input, of a file that the mesh names, or of another output.\n"
    "The same inputs give the same bytes, with any number of workers.";

// Each group of options in the order in which --help lists them. Answers --mesh, which others need or exclude.
CLI::Option* addInputOptions(CLI::App& c, BuildArguments& o) {
  c.add_option("-o,--output", o.output, "Package to write")->required();
  c.add_option("--ptm", o.ptm,
               "Texture: a .ptm file (RGB, LRGB, LUM, JPEG_RGB, JPEG_LRGB); of a mesh with texture coordinates, too");
  c.add_option("--image", o.image, "Texture: a plain sRGB colour image (TIFF, PNG, JPEG, ...)");
  auto* mesh =
      c.add_option("--mesh", o.mesh, "A scan: .ply, .obj, .stl, .off, .glb or .gltf; it is relief and texture");
  c.add_option("--texture", o.texture, "Image for the mesh's texture coordinates, or none [what the mesh names]")
      ->needs(mesh);
  c.add_option("--unit", o.unit,
               "Of the mesh's coordinates: mm, cm, m or in [what the file states (glTF: m; a comment \"unit mm\"), "
               "else mm]")
      ->check(CLI::IsMember({"mm", "cm", "m", "in"}))
      ->needs(mesh);
  c.add_option("--up", o.up, "The mesh's axis that points up: x, y or z; it becomes y")
      ->check(CLI::IsMember({"x", "y", "z"}))
      ->needs(mesh)
      ->capture_default_str();
  c.add_option("--rotate", o.rotate, "Then turn it by X,Y,Z degrees about x, y and z, one after the other [0,0,0]")
      ->check(threeAngles)
      ->needs(mesh);
  c.add_option("--patches", o.patches,
               "About how many patches, at most half of the triangles (or 1024); 0: as the shape asks for. How many "
               "there are is said")
      ->check(CLI::Range(0u, 1u << 20))
      ->needs(mesh)
      ->capture_default_str();
  c.add_option(
       "--tolerance", o.tolerance,
       "Distance that 99.9 % of the scan and of what is drawn keep from each other: 0.05 or 0.05mm, or 0.03% of "
       "the diagonal. Their RMS is to be a tenth, and nothing to speak of beyond 3.3 times that. Missed, and no "
       "--patches given: exit code 7 [0.03%]")
      ->check(tolerance)
      ->needs(mesh);
  c.add_option(
       "--texture-tolerance", o.texture_tolerance,
       "Leave out texture pages whose texels all lie within so many steps of 1/255 of what a coarser page, or the "
       "patch's 16x16 texels that are always resident, shows there, the root mean square within half as many; and "
       "store others in fewer bytes that show them as well. Single normals may be off by four times as much: 1.8 "
       "degrees a step. -1: keep all, exactly")
      ->check(CLI::Range(-1.0, 255.0))
      ->needs(mesh)
      ->capture_default_str();
  c.add_flag("--strict", o.strict, "Write nothing where the tolerance is missed, and exit with 7")->needs(mesh);
  c.add_option("--report", o.report, "Write this HTML file: diagnosis, distances with a picture, time and memory")
      ->needs(mesh);
  return mesh;
}

void addReliefOptions(CLI::App& c, BuildArguments& o, CLI::Option* mesh) {
  c.add_option("--relief", o.relief,
               "Height map, one channel, of the texture's proportions: 8 or 16 bit (with --relief-mm), or float in mm")
      ->excludes(mesh);
  c.add_option("--relief-mm", o.relief_mm,
               "MIN:MAX, the heights of the map's 0 and its largest value (of floats: of 0 and 1), mm");
  c.add_option("--relief-px", o.relief_px,
               "MIN:MAX, the same in pixels of the texture, where its size in mm is not known");
  c.add_flag("--stretch-relief", o.stretch_relief,
             "Stretch a height map of other proportions than the texture's over it");
  c.add_option(
       "--mm-per-pixel", o.mm_per_px,
       "Size of a texture pixel, mm; tag: what the image's resolution tag says [not known: the package counts px]")
      ->check(positiveOrTag)
      ->excludes(mesh);
}

void addPackageOptions(CLI::App& c, BuildArguments& o) {
  c.add_option("--workers", o.workers, "Threads; 0: one per core")->check(CLI::Range(0, 1024))->capture_default_str();
  c.add_option("--zstd-level", o.zstd_level, "Compression, -7 (fast) to 19 (small)")
      ->check(CLI::Range(-7, 19))
      ->capture_default_str();
  c.add_option("--encoding", o.encoding, "Of texture pages: lossless, q8 to q4, jpeg, bc1, bc4, bc5, bc7 (see below)")
      ->capture_default_str();
  c.add_option("--encoding-coefficients", o.coefficients, "Of coefficient planes alone [as --encoding]");
  c.add_option("--encoding-colour", o.colour, "Of colour planes alone [as --encoding]");
  c.add_option("--quality", o.quality, "Of jpeg, 1 to 100")->check(CLI::Range(1, 100))->capture_default_str();
  c.add_option("--memory-mib", o.memory_mib,
               "Memory to stay within, MiB (a mesh may take more: 36 bytes a triangle as it is read; less than 90 "
               "makes it slower)")
      ->check(CLI::Range(64, 1 << 20))
      ->capture_default_str();
  c.add_flag("--resume", o.resume,
             "Go on from the last checkpoint of the same build that was killed or interrupted, or start anew; and "
             "keep one where this build stops. Not with --mesh");
  c.add_option("--checkpoint-every", o.checkpoint_s, "Seconds; 0: after each part; negative: none")
      ->group("")
      ->capture_default_str();
}

void addLimitOptions(CLI::App& c, BuildArguments& o, CLI::Option* mesh) {
  const char* limits = "Limits";
  c.add_flag("--allow-outside", o.allow_outside,
             "Open material files and images that the mesh names outside its folder, too")
      ->needs(mesh)
      ->group(limits);
  c.add_option("--max-tile-mib", o.max_tile_mib, "Largest tile of an image, decoded, MiB [an eighth of --memory-mib]")
      ->check(CLI::Range(0, 1 << 20))
      ->group(limits);
  c.add_option(
       "--max-image-mib", o.max_image_mib,
       "Largest image that is decoded as a whole (interlaced, progressive, a mesh's), MiB [a third of --memory-mib]")
      ->check(CLI::Range(0, 1 << 20))
      ->group(limits);
  c.add_option("--max-packing", o.max_packing,
               "An image that claims more bytes of pixels than this times its file's is taken for damaged")
      ->check(CLI::Range(1, 1 << 30))
      ->capture_default_str()
      ->group(limits);
}

}  // namespace

void addBuildCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<BuildArguments>();
  auto* c = app.add_subcommand(
      "build", "Make a streamable package from a PTM or an image, and a height map; or from a scanned mesh");
  c->footer(kFooter);
  CLI::Option* mesh = addInputOptions(*c, *o);
  addReliefOptions(*c, *o, mesh);
  addPackageOptions(*c, *o);
  addLimitOptions(*c, *o, mesh);
  c->add_option("--json", o->json_file,
                "Write a report to this JSON file; - for standard output. Of a mesh: with distances");
  c->callback([o, &context] {
    if (auto done = build(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
