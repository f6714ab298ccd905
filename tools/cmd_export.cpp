// relievo export: the surface of a package as a mesh, or a flat one's maps as images, for other programs.
#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>
#include <vector>

#include "src/base/file.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "texturing/import/image_io.h"
#include "texturing/package/package.h"
#include "tools/commands.h"
#include "tools/export/line_file.h"
#include "tools/export/map_export.h"
#include "tools/export/mesh_export.h"
#include "tools/export/mesh_format.h"
#include "tools/export/patch_maps.h"
#include "tools/export/surface_lines.h"
#include "tools/output_files.h"
#include "tools/scene/scene_file.h"

namespace relievo {
namespace {

struct ExportArguments {
  std::string file, output;
  std::optional<int> level;
  std::optional<double> error_mm;
  int draco_bits = 0, maps_px = 0;
  bool base = false;
  std::string map, normal_y = "up", light = "0,0,1";
  std::optional<double> contours;
  std::string section, plane;
  bool lines() const { return contours || !section.empty() || !plane.empty(); }
  uint64_t memory_mib = 768;
  int workers = 0;
};

// OpenImageIO with all that it loads, as measured; and what a few rows need.
constexpr uint64_t kImageLibraryMib = 140, kLeastMapMib = 24;

std::string cellsText(const MeshExportReport& r) {
  const std::string cells = std::to_string(uint64_t{1} << r.level) + " cells a patch side";
  if (r.least_level == r.level) return "level " + std::to_string(r.level) + ", " + cells;
  return "levels " + std::to_string(r.least_level) + " to " + std::to_string(r.level) + ", " +
         std::to_string(uint64_t{1} << r.least_level) + " to " + cells;
}

void printReport(const ExportArguments& o, const MeshExportReport& r, bool size_known, double seconds) {
  const char* unit = size_known ? "mm" : "px";
  std::string vertices = r.vertices ? std::to_string(r.vertices) + " vertices, " : "";
  printOutf("%s: %s%llu %s, %s", printable(o.output).c_str(), vertices.c_str(),
            static_cast<unsigned long long>(r.faces), r.quads ? "quads" : "triangles",
            o.base ? "base mesh" : cellsText(r).c_str());
  if (!o.base && r.error_mm && *r.error_mm == 0) printOutf(", full detail");
  else if (!o.base && r.error_mm) printOutf(", within %.3g %s of full detail", *r.error_mm, unit);
  else if (!o.base) printOutf(", no bound of its error is known");
  printOutf(", %.1f MiB, %.1f s\n", static_cast<double>(r.file_bytes) / (1 << 20), seconds);
  if (r.maps_px) printOutf("  colours and normals in images of %d x %d px\n", (*r.maps_px)[0], (*r.maps_px)[1]);
  if (r.draco_step) printOutf("  compressed by Draco: positions in steps of %.3g %s\n", *r.draco_step, unit);
  if (!o.base && r.coarser_error_mm && !o.error_mm && r.least_level == r.level)
    printOutf("  level %d has a quarter of the triangles, within %.3g %s of full detail\n", r.level - 1,
              *r.coarser_error_mm, unit);
  if (r.from_origin)
    printOutf("  positions count from (%.17g, %.17g, %.17g) %s of the scan's coordinates\n", r.origin_mm.x,
              r.origin_mm.y, r.origin_mm.z, unit);
}

double secondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Runs an export of maps with its line of progress.
template <class Export>
auto exportMaps(const ExportArguments& o, ExportMap map, Export&& run) {
  ProgressLine line("export");
  MapExportOptions options;
  options.output = o.output;
  options.map = map;
  options.level = o.level;
  options.normal_y_down = o.normal_y == "down";
  const std::vector<double> light = *numbersOf(o.light, 3);
  options.light = {light[0], light[1], light[2]};
  options.memory_bytes = std::max(o.memory_mib, kImageLibraryMib + kLeastMapMib) << 20;
  options.library_bytes = kImageLibraryMib << 20;
  options.progress = [&](double share) { line.update(share, o.output); };
  options.interrupted = &interruptedFlag();
  return run(options);
}

Result<void> exportPatches(const ExportArguments& o, ExportMap map, const std::shared_ptr<const Package>& package) {
  const auto start = std::chrono::steady_clock::now();
  const std::string json = patchMapJson(o.output), obj = patchMapObj(o.output);
  if (auto good = checkOutputs(
          {{"-o", o.output, Content::kPicture}, {"the map's description", json}, {"the map's base mesh", obj}},
          {{"FILE", o.file}});
      !good)
    return good;
  for (const std::string& path : {o.output, json, obj})
    if (auto kind = OutputFile::check(path); kind && *kind != OutputKind::kFile)
      return Error{ErrorKind::kUsage, path, "a scan's map is three files, and this can hold none", "name a file", {}};
  auto report = exportMaps(o, map, [&](const MapExportOptions& options) { return exportPatchMaps(package, options); });
  if (!report) return report.error();
  printOutf("%s: %s map, %lld x %lld px, level %d, %u patches of %llu x %llu samples, %.1f s\n",
            printable(o.output).c_str(), o.map.c_str(), static_cast<long long>(report->width),
            static_cast<long long>(report->height), report->level, report->patches,
            static_cast<unsigned long long>((uint64_t{1} << report->level) + 1),
            static_cast<unsigned long long>((uint64_t{1} << report->level) + 1), secondsSince(start));
  printOutf("  %s says how to put the surface together, %s has the base quads\n", printable(json).c_str(),
            printable(obj).c_str());
  return {};
}

Result<void> exportAsMap(const ExportArguments& o, const std::shared_ptr<const Package>& package) {
  const auto start = std::chrono::steady_clock::now();
  auto map = exportMapOf(o.map);
  if (!map) return map.error();
  if (!package->manifest().domain.isFlat()) return exportPatches(o, *map, package);
  auto report = exportMaps(o, *map, [&](const MapExportOptions& options) { return exportMap(package, options); });
  if (!report) return report.error();
  const char* unit = package->manifest().size_known ? "mm" : "px";
  printOutf("%s: %s map, %lld x %lld px, level %d", printable(o.output).c_str(), o.map.c_str(),
            static_cast<long long>(report->width), static_cast<long long>(report->height), report->level);
  if (report->mm_per_px > 0) printOutf(", %.6g mm per px", report->mm_per_px);
  if (report->scaled) printOutf(", 0 to 65535 for %.9g to %.9g %s", report->low_mm, report->high_mm, unit);
  printOutf(", %.1f s\n", secondsSince(start));
  return {};
}

Result<void> exportAsLines(const ExportArguments& o, const std::shared_ptr<const Package>& package) {
  const auto start = std::chrono::steady_clock::now();
  const Manifest& m = package->manifest();
  LineDrawing drawing;
  drawing.unit = m.size_known ? "mm" : "px";
  const std::string name = o.file.substr(o.file.rfind('/') + 1);
  Result<SurfaceLines> lines = SurfaceLines{};
  {
    ProgressLine line("export");
    SurfaceLineOptions options;
    options.level = o.level;
    options.memory_bytes = o.memory_mib << 20;
    options.progress = [&](double share) { line.update(share, o.output); };
    options.interrupted = &interruptedFlag();
    if (o.contours) {
      drawing.kind = LineDrawing::Kind::kContours;
      char step[40];
      std::snprintf(step, sizeof step, "%.6g", *o.contours);
      drawing.title = name + ", contours every " + step + " " + drawing.unit;
      if (m.domain.isFlat()) {
        const FlatDomain d = m.domain.flat();
        drawing.width = static_cast<double>(d.width_px) * d.mm_per_px;
        drawing.height = static_cast<double>(d.height_px) * d.mm_per_px;
      }
      lines = contoursOf(package, *o.contours, options);
    } else if (!o.section.empty()) {
      const std::vector<double> v = *numbersOf(o.section, 4);
      const glm::dvec2 from(v[0], v[1]), to(v[2], v[3]);
      drawing.kind = LineDrawing::Kind::kSection;
      drawing.title = name + ", section " + o.section + " " + drawing.unit;
      drawing.from = {from, 0};
      drawing.along = {(to - from) / std::max(glm::length(to - from), 1e-300), 0};
      lines = sectionOf(package, from, to, options);
    } else {
      const std::vector<double> v = *numbersOf(o.plane, 4);
      drawing.kind = LineDrawing::Kind::kPlane;
      drawing.title = name + ", plane " + o.plane + " mm";
      drawing.normal = {v[0], v[1], v[2]};
      if (m.domain.isFlat())
        return Error{ErrorKind::kUsage, o.file, "is a flat artwork, which --section cuts", "leave --plane out", {}};
      lines = planeCutOf(package, drawing.normal, v[3], options);
    }
  }
  if (!lines) return lines.error();
  if (lines->lines.empty())
    return Error{ErrorKind::kUsage,
                 o.file,
                 "has no line there: its surface does not reach it",
                 "relievo info states the artwork's size",
                 {}};
  if (auto written = writeLines(o.output, drawing, *lines); !written) return written;
  size_t closed = 0, points = 0;
  for (const SurfaceLine& line : lines->lines) closed += line.closed, points += line.points.size();
  printOutf("%s: %zu lines, %zu of them closed, %zu points, level %d, %.1f s\n", printable(o.output).c_str(),
            lines->lines.size(), closed, points, lines->level, secondsSince(start));
  return {};
}

Result<void> exportAsMesh(const ExportArguments& o, const std::shared_ptr<const Package>& package) {
  const auto start = std::chrono::steady_clock::now();
  Result<MeshExportReport> report = MeshExportReport{};
  {
    ProgressLine line("export");
    MeshExportOptions options;
    options.output = o.output;
    options.level = o.level;
    options.error_mm = o.error_mm;
    options.base = o.base;
    options.draco_bits = o.draco_bits;
    options.maps_px = o.maps_px;
    options.memory_bytes = o.memory_mib << 20;
    options.workers = o.workers;
    options.progress = [&](double share) { line.update(share, o.output); };
    options.interrupted = &interruptedFlag();
    report = exportMesh(package, options);
  }
  if (!report) return report.error();
  printReport(o, *report, package->manifest().size_known, secondsSince(start));
  return {};
}

Result<void> exportArtwork(const ExportArguments& o) {
  if (o.map != "lit" && o.light != "0,0,1")
    return usageError("--light needs --map lit", "other maps do not depend on a light");
  // Names are looked at before anything is read.
  if (o.lines()) {
    if (auto good = checkLineFile(o.output); !good) return good;
  } else if (o.map.empty()) {
    if (auto format = meshFormatOf(o.output); !format) {
      Error error = format.error();
      if (checkLineFile(o.output)) error.hint = "--contours, --section or --plane say which lines are drawn";
      else if (o.output != "-" && imageFormatOf(o.output)) error.hint = "--map says which image is written";
      return error;
    }
  } else {
    if (auto format = imageFormatOf(o.output); !format) return format.error();
  }
  if (auto good = checkOutputs({{"-o", o.output, Content::kPicture}}, {{"FILE", o.file}}); !good) return good;
  auto package = Package::open(o.file);
  if (!package) return package.error();
  for (const std::string& warning : (*package)->warnings()) warn(o.file + ": " + warning);
  if (o.lines()) return exportAsLines(o, *package);
  return o.map.empty() ? exportAsMesh(o, *package) : exportAsMap(o, *package);
}

std::string threeNumbers(const std::string& text) {
  return numbersOf(text, 3) ? "" : "expected three numbers X,Y,Z, found " + text;
}

constexpr const char* kExportFooter =
    "Example:\n"
    "  relievo export statue.relievo -o statue.ply\n"
    "  relievo export statue.relievo -o web.glb --error-mm 0.2 --draco 16\n"
    "  relievo export statue.relievo -o blender.glb --error-mm 0.5 --maps 4096\n"
    "  relievo export tablet.relievo -o heights.tif --map height\n"
    "  relievo export tablet.relievo -o raking.tif --map lit --light -1,0,0.3\n"
    "  relievo export statue.relievo -o relief.exr --map displacement --level 6\n"
    "  relievo export tablet.relievo -o contours.svg --contours 0.5\n"
    "  relievo export statue.relievo -o waist.svg --plane 0,1,0,350\n\n"
    "Vertices are welded, and patches meet without gaps: what is closed stays closed. Colours (sRGB; none in .stl) are "
    "the albedo, or\n"
    "the picture under light from the front; normals are the mesh's own. With --maps both are images, as dense as "
    "these "
    "may be large, and\n"
    "a mesh of few triangles looks as the scan does; patches then have vertices of their own along their borders.\n"
    "Lengths are mm in the scan's own coordinates (px where no size is known); a flat artwork lies around its centre, "
    "x right, y up.\n"
    ".ply and .stl hold floats. Where these would lose detail because the scan lies far from its zero, positions count "
    "from an origin,\n"
    "which the file's comment or header names and which is printed. .glb always does so: its node scales mm to metres "
    "and adds the\n"
    "origin. Text formats keep the scan's coordinates.\n\n"
    "Maps of flat artworks: a pixel is a cell of the level. height: mm, 32-bit float. depth: mm below the relief's "
    "highest place.\n"
    "A .png has both in 16 bits over the relief's range, which is printed: build takes it again as --relief-mm. "
    "normal: (n + 1)/2 in\n"
    "16 bits, in .exr float. albedo: sRGB, in .exr linear light. lit: the same under --light, as `relievo render` "
    "shows it from above.\n"
    "The pixel's size is stated as the resolution.\n"
    "Maps of scans: an atlas with a tile a patch, its heights along the base mesh's directions, normals of the scan's "
    "axes, or colours, at\n"
    "the vertices that a mesh of the same level has. NAME.map.json and NAME.map.obj beside it say how the surface is "
    "put together\n"
    "(tools/export/PATCH_MAPS.md).\n\n"
    "Lines (--contours, --section, --plane) lie on the triangles of a mesh of that level, joined, and closed where "
    "they close. An .svg is in\n"
    "mm, 1:1, with a bar; a .csv has a line for each point. A plane is drawn as seen from the side to which A,B,C "
    "points.";

// Lines, which are neither a map nor the mesh at an error or its base.
void addLineOptions(CLI::App& c, ExportArguments& o, const std::vector<CLI::Option*>& others) {
  const auto exclude = [](CLI::Option* option, const std::vector<CLI::Option*>& options) {
    for (CLI::Option* other : options) option->excludes(other);
  };
  auto* contours = c.add_option("--contours", o.contours,
                                "Of a flat artwork, lines of equal height, this many mm apart (px where no size is "
                                "known), as .svg or .csv")
                       ->check(CLI::PositiveNumber);
  const auto fourNumbers = [](const std::string& text) {
    return numbersOf(text, 4) ? std::string() : "expected four numbers with commas between them, found " + text;
  };
  auto* section = c.add_option("--section", o.section,
                               "X0,Y0,X1,Y1: of a flat artwork, its profile from one place to another, mm from its "
                               "centre, as .svg or .csv")
                      ->check(fourNumbers);
  auto* plane = c.add_option("--plane", o.plane,
                             "A,B,C,D: of a scan, where the plane A x + B y + C z = D (mm) cuts it, as .svg or .csv")
                    ->check(fourNumbers);
  exclude(contours, others);
  exclude(section, others);
  exclude(section, {contours});
  exclude(plane, others);
  exclude(plane, {contours, section});
}

}  // namespace

void addExportCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<ExportArguments>();
  auto* c = app.add_subcommand(
      "export",
      "Write a package's surface as a mesh (.ply, .obj, .stl, .off, .glb), or its heights, normals or "
      "colours as an image (.tif, .exr, .png)");
  c->footer(kExportFooter);
  c->add_option("FILE", o->file, "Package to read, or a scene of it")->required();
  c->add_option("-o,--output", o->output, "Mesh or, with --map, image to write; its suffix says the format")
      ->required();
  auto* level = c->add_option("--level", o->level,
                              "Cells a patch side: 2^LEVEL, 0 to 24, of a flat artwork's maps from 7 [full detail]")
                    ->check(CLI::Range(0, 24));
  auto* error = c->add_option("--error-mm", o->error_mm,
                              "Coarsest mesh within this distance of full detail, mm (px where no size is known): "
                              "over a base mesh each patch has a level of its own")
                    ->check(CLI::NonNegativeNumber)
                    ->excludes(level);
  auto* base = c->add_flag("--base", o->base,
                           "The base mesh alone: quads; two triangles each in .stl and .glb, and where patches are cut")
                   ->excludes(level)
                   ->excludes(error);
  auto* map = c->add_option("--map", o->map,
                            "An image: height (or displacement), normal or albedo; of a flat artwork also depth or lit")
                  ->check(CLI::IsMember({"height", "displacement", "depth", "normal", "albedo", "lit"}))
                  ->excludes(error)
                  ->excludes(base);
  c->add_option("--normal-y", o->normal_y, "Direction of green in a normal map: up (OpenGL) or down (DirectX)")
      ->check(CLI::IsMember({"up", "down"}))
      ->needs(map)
      ->capture_default_str();
  c->add_option(
       "--draco", o->draco_bits,
       "Compress a .glb by Draco (KHR_draco_mesh_compression), positions in so many bits a coordinate: 16 keep "
       "what a scan's package promises [not compressed]")
      ->check(CLI::Range(8, 24))
      ->excludes(map);
  c->add_option(
       "--maps", o->maps_px,
       "Of a scan's .glb: colours and normals in images of at most so many px a side, in the place of vertices' "
       "colours [none]")
      ->check(CLI::Range(64, 16384))
      ->excludes(map)
      ->excludes(base)
      ->excludes("--draco");
  addLineOptions(*c, *o, {error, base, map});
  c->add_option("--light", o->light, "X,Y,Z towards the light of --map lit: right, up, to the viewer")
      ->check(threeNumbers)
      ->needs(map)
      ->capture_default_str();
  c->add_option("--memory-mib", o->memory_mib, "Memory to stay within, MiB (of maps at least 164)")
      ->check(CLI::Range(64, 1 << 20))
      ->capture_default_str();
  c->add_option("--workers", o->workers, "Threads; 0: one per core")->check(CLI::Range(0, 1024))->capture_default_str();
  c->callback([o, &context] {
    if (auto named = takeArtwork(o->file); !named) return context.fail(named.error());
    if (auto done = exportArtwork(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
