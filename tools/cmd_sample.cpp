// relievo sample: procedural artworks with known truth, as files or straight into a package.
#include <cstdio>
#include <memory>
#include <optional>
#include <sstream>

#include <CLI/CLI.hpp>

#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "tools/build_run.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/sample/sample_artwork.h"
#include "tools/sample/sample_writer.h"

namespace relievo {
namespace {

constexpr int64_t kMaxSidePx = int64_t{1} << 20;
constexpr int64_t kEverythingPx = int64_t{4096} * 4096;

struct Options {
  std::string kind, folder, size = "2048x2048", package, basis = "lrgb";
  uint64_t seed = 1;
  std::optional<std::string> write;
  int lights = 49, workers = 0;
};

Result<void> chooseFiles(const std::optional<std::string>& list, int64_t pixels, SampleWriteOptions& out) {
  if (!list) {
    out.height = out.ptm_lrgb = true;
    if (pixels <= kEverythingPx) out.albedo = out.normals = out.ptm_rgb = out.photos = out.mesh = true;
    return {};
  }
  if (list->empty()) return usageError("--write: the list is empty", "leave -o out to build a package only");
  std::stringstream items(*list);
  for (std::string item; std::getline(items, item, ',');) {
    bool* flag = item == "height"     ? &out.height
                 : item == "albedo"   ? &out.albedo
                 : item == "normals"  ? &out.normals
                 : item == "ptm-lrgb" ? &out.ptm_lrgb
                 : item == "ptm-rgb"  ? &out.ptm_rgb
                 : item == "photos"   ? &out.photos
                 : item == "mesh"     ? &out.mesh
                 : item == "mesh-uv"  ? &out.mesh_uv
                                      : nullptr;
    if (!flag)
      return usageError("--write: nothing called '" + item + "' can be written",
                        "height,albedo,normals,ptm-lrgb,ptm-rgb,photos,mesh,mesh-uv");
    *flag = true;
    out.mesh |= out.mesh_uv;
  }
  return {};
}

Result<void> makeSample(const Options& o) {
  auto kind = parseSampleKind(o.kind);
  if (!kind) return kind.error();
  auto size = parseSize(o.size);
  if (!size) return size.error();
  if (size->first > kMaxSidePx || size->second > kMaxSidePx)
    return usageError("--size: expected at most 1048576 px a side, found " + o.size);
  if (o.lights < 6 || o.lights > kMaxSampleLights)
    return usageError(
        "--lights: expected 6 to " + std::to_string(kMaxSampleLights) + ", found " + std::to_string(o.lights),
        "a PTM needs six");
  if (o.workers < 0)
    return usageError("--workers: expected 0 or more, found " + std::to_string(o.workers), "0: one per core");
  if (o.basis != "lrgb" && o.basis != "rgb" && o.basis != "colour")
    return usageError("--basis: expected lrgb, rgb or colour, found '" + o.basis + "'");
  if (o.folder.empty() && o.package.empty())
    return usageError("nothing to write", "-o DIR for files, --package FILE for a package, or both");
  SampleWriteOptions files{.folder = o.folder, .lights = o.lights, .interrupted = &interruptedFlag()};
  if (auto chosen = chooseFiles(o.write, size->first * size->second, files); !chosen) return chosen;
  if (o.write && o.folder.empty()) return usageError("--write needs a folder", "-o DIR");

  if (auto good = checkFolder("-o", o.folder); !good) return good;
  // The folder may be made with the files; what lies in it then is checked before the package is begun.
  if (o.folder.empty())
    if (auto good = checkOutputs({{"--package", o.package, Content::kPackage}}, {}); !good) return good;
  SampleArtwork artwork({.kind = *kind, .width = size->first, .height = size->second, .seed = o.seed});
  printOutf("%s, %s px, seed %llu: %.9g mm per px\n", sampleKindName(*kind), o.size.c_str(),
            static_cast<unsigned long long>(o.seed), artwork.mmPerPx());
  if (!o.folder.empty()) {
    auto written = writeSample(artwork, files);
    if (!written) return written.error();
    for (const std::string& name : *written)
      if (auto good = checkApart({{"-o", o.folder + "/" + name}, {"--package", o.package}}, {}); !good) return good;
    for (const std::string& name : *written)
      if (name.rfind("photos/light_", 0) != 0) printOutf("%s/%s\n", o.folder.c_str(), name.c_str());
    if (files.photos) printOutf("%s/photos: %d photographs\n", o.folder.c_str(), o.lights);
    if (files.height) printOutf("height_16.tif spans --relief-mm %.9g:%.9g\n", artwork.minMm(), artwork.maxMm());
  }
  if (!o.package.empty()) {
    auto texture = artwork.ptmSource(o.basis == "rgb"    ? Basis::kPtmRgb
                                     : o.basis == "lrgb" ? Basis::kPtmLrgb
                                                         : Basis::kColour);
    auto relief = artwork.heightSource();
    BuildOptions build;
    build.output = o.package;
    build.mm_per_px = artwork.mmPerPx();
    build.workers = o.workers;
    auto report = buildWithProgress(*texture, relief.get(), build);
    if (!report) return report.error();
    printOutf("%s\n", buildSummary(*texture, build, *report).c_str());
  }
  return {};
}

}  // namespace

void addSampleCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<Options>();
  CLI::App* sub =
      app.add_subcommand("sample",
                         "Makes a relief artwork out of nothing, with known truth, at any size.\n"
                         "  inscription  Roman capitals cut into limestone, 600 mm on the shorter side\n"
                         "  coin         an owl in gold (odd seeds) or silver, 24 mm, on cloth of 31 mm\n"
                         "  painting     a landscape in thick paint with craquelure, 400 mm\n"
                         "A larger size shows finer detail. The same kind, size and seed give the same bytes.");
  sub->add_option("kind", o->kind, "inscription, coin or painting")->required()->type_name("KIND");
  sub->add_option("-o,--output", o->folder, "folder for the files; truth.json says what they are")->type_name("DIR");
  sub->add_option("--size", o->size, "width and height in px, up to 1048576 each (default 2048x2048)")
      ->type_name("WxH");
  sub->add_option("--seed", o->seed, "another seed is another artwork of its kind (default 1)")->type_name("N");
  sub->add_option("--write", o->write,
                  "files to write, of height,albedo,normals,ptm-lrgb,ptm-rgb,photos,mesh,mesh-uv\n"
                  "(mesh-uv: the mesh with texture coordinates for the PTMs)\n"
                  "(default: all up to 4096x4096 px, above that height,ptm-lrgb)")
      ->type_name("LIST");
  sub->add_option("--lights", o->lights, "photographs, each under one light of a dome (default 49; 6 to 999)")
      ->type_name("N");
  sub->add_option("--package", o->package, "build a package straight from the generator, without files between")
      ->type_name("FILE");
  sub->add_option("--basis", o->basis, "the package's texture: lrgb, rgb (PTM) or colour (default lrgb)")
      ->type_name("BASIS");
  sub->add_option("--workers", o->workers, "threads that build the package; 0: one per core (default 0)")
      ->type_name("N");
  sub->footer(
      "Examples:\n  relievo sample coin --size 4096x4096 --package coin.relievo\n"
      "  relievo sample inscription --size 2048x2048 --write height,ptm-lrgb -o stone");
  sub->callback([o, &context] {
    if (auto done = makeSample(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
