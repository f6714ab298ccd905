// relievo info: what a package holds.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>

#include "src/base/json_parse.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "src/engine/effect_plan.h"
#include "src/engine/upload_choice.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"
#include "texturing/stream/cache_budget.h"
#include "tools/commands.h"
#include "tools/report/mesh_report.h"
#include "tools/scene/scene_file.h"

namespace relievo {
namespace {

struct PlaneLine {
  std::string name, encoding;
  PlaneUsage usage;
};

Result<std::vector<PlaneLine>> planeLines(const Package& package) {
  const Manifest& m = package.manifest();
  std::vector<PlaneLine> lines;
  for (int k = 0; k < m.texture.planes(); ++k) {
    const Plane plane = texturePlane(k);
    auto usage = planeUsage(package, plane, &interruptedFlag());
    if (!usage) return usage.error();
    lines.push_back({planeName(plane, m.texture.basis), encodingName(m.encodings[static_cast<size_t>(k)]), *usage});
  }
  if (m.domain.relief_depth >= 0) {
    auto usage = planeUsage(package, Plane::kRelief, &interruptedFlag());
    if (!usage) return usage.error();
    lines.push_back({"relief", "lossless", *usage});
  }
  return lines;
}

// On a GPU, all texture planes, a page's border included.
double residentBytesPerTexel(const Manifest& m, PageCodec upload) {
  return static_cast<double>(slotBytes(upload, texturePlane(0))) * m.texture.planes() / (kPagePx * kPagePx);
}

// Of the corners, in the scan's coordinates.
std::pair<glm::dvec3, glm::dvec3> extentMm(const BaseMesh& base) {
  glm::dvec3 low(1e300), high(-1e300);
  for (const BaseCorner& c : base.corners)
    low = glm::min(low, glm::dvec3(c.position_mm)), high = glm::max(high, glm::dvec3(c.position_mm));
  return {low + base.origin_mm, high + base.origin_mm};
}

// What the package keeps of the scan that it was made from; null if nothing.
nlohmann::ordered_json meshOf(const Package& package) {
  auto manifest = parseJson(package.manifestJson(), package.path());
  if (!manifest || !manifest->is_object()) return {};
  auto found = manifest->find("mesh");
  return found != manifest->end() ? *found : nlohmann::ordered_json();
}

uint64_t patchesWithoutTexture(const PatchDomain& d) { return d.nodeCount(0) - d.texturedNodeCount(0); }

struct InfoArguments {
  std::string file;
  bool json = false;
};

// What is told of a package, in either form.
struct Contents {
  const std::string& file;
  const Package& package;
  std::vector<PlaneLine> planes;
  std::optional<TailBytes> tails;  // nothing: damage hides it
  double pixels() const { return package.manifest().domain.texelCount(); }
  double bytesPerPx() const { return static_cast<double>(package.fileBytes()) / pixels(); }
  const char* unit() const { return package.manifest().size_known ? "mm" : "px"; }
};

void addSize(nlohmann::ordered_json& json, const Contents& c) {
  const Manifest& m = c.package.manifest();
  const PatchDomain& d = m.domain;
  json["file"] = c.file;
  json["file_bytes"] = c.package.fileBytes();
  if (d.isFlat()) {
    json["width_px"] = d.flat().width_px;
    json["height_px"] = d.flat().height_px;
  }
  if (m.size_known) json["mm_per_px"] = d.mm_per_px;
  else json["mm_per_px"] = nullptr;
  if (!d.isFlat()) {
    const auto [low, high] = extentMm(*m.base);
    json["base"] = {{"corners", m.base->corners.size()},
                    {"patches", m.base->patches.size()},
                    {"min_mm", {low.x, low.y, low.z}},
                    {"max_mm", {high.x, high.y, high.z}},
                    {"error_unit_mm", m.error_unit_mm}};
    if (auto mesh = meshOf(c.package); !mesh.is_null()) json["mesh"] = mesh;
  } else if (m.size_known) {
    json["width_mm"] = static_cast<double>(d.flat().width_px) * d.mm_per_px;
    json["height_mm"] = static_cast<double>(d.flat().height_px) * d.mm_per_px;
  }
}

void addMeaning(nlohmann::ordered_json& json, const Contents& c) {
  const Manifest& m = c.package.manifest();
  const PatchDomain& d = m.domain;
  json["basis"] = basisName(m.texture.basis);
  json["texture_planes"] = m.texture.planes();
  json["texture_levels"] = d.texture_depth + 1;
  json["relief_levels"] = d.relief_depth + 1;
  json["patches"] = d.patchCount();
  if (m.texture.coefficients() > 0) {
    const auto scales = m.texture.scales(), biases = m.texture.biases();
    json["scale"] = std::vector(scales.begin(), scales.end());
    json["bias"] = std::vector(biases.begin(), biases.end());
  }
  if (d.relief_depth >= 0) {
    json[std::string("relief_min_") + c.unit()] = d.relief_offset_mm;
    json[std::string("relief_max_") + c.unit()] = d.relief_offset_mm + 65535 * d.relief_scale_mm;
    json[std::string("relief_step_") + c.unit()] = d.relief_scale_mm;
  }
}

nlohmann::ordered_json jsonOf(const Contents& c) {
  const Manifest& m = c.package.manifest();
  auto json = nlohmann::ordered_json::object();
  addSize(json, c);
  addMeaning(json, c);
  json["planes"] = nlohmann::ordered_json::array();
  for (const PlaneLine& p : c.planes) {
    json["planes"].push_back({{"name", p.name},
                              {"encoding", p.encoding},
                              {"pages", p.usage.pages},
                              {"bytes", p.usage.bytes},
                              {"bytes_per_px", static_cast<double>(p.usage.bytes) / c.pixels()},
                              {"unknown_pages", p.usage.unknown_pages}});
  }
  nlohmann::ordered_json resident = {{"rgba8", residentBytesPerTexel(m, PageCodec::kLossless)}};
  if (auto codec = commonBlockCodec(m)) resident["blocks"] = residentBytesPerTexel(m, *codec);
  json["resident_bytes_per_texel"] = std::move(resident);
  json["pages"] = m.page_count;
  // What is there twice counts once; the rest of the file is copies and padding.
  const PackageHeader& h = c.package.header();
  json["sections"] = {{"header_bytes", kHeaderBytes},
                      {"manifest_bytes", h.manifest_bytes},
                      {"base_mesh_bytes", h.base_bytes},
                      {"index_bytes", h.index_bytes},
                      {"pages_bytes", h.pages_bytes}};
  if (c.tails) json["sections"]["tails_bytes"] = c.tails->all;
  if (c.tails && c.tails->heights) json["sections"]["tails_heights_bytes"] = *c.tails->heights;
  if (const uint64_t left_out = m.domain.untexturedNodeCount(); left_out > 0) {
    json["texture_nodes_left_out"] = left_out;
    json["patches_without_texture_pages"] = patchesWithoutTexture(m.domain);
  }
  if (!m.domain.isFlat()) json["tails"] = c.package.hasTails();
  if (const auto shown = c.package.shownImages(); shown.bytes > 0)
    json["shown_images"] = {{"images", shown.images},
                            {"normal_maps", shown.normal_maps},
                            {"patches", shown.patches},
                            {"corner_colours", shown.corner_colours},
                            {"bytes", shown.bytes}};
  json["bytes_per_px"] = c.bytesPerPx();
  json["tool_version"] = m.tool_version;
  json["sources"] = nlohmann::ordered_json::array();
  for (const Provenance& p : m.sources)
    json["sources"].push_back({{"name", p.name}, {"xxh3", p.xxh3}, {"generator", p.generator}});
  json["warnings"] = c.package.warnings();
  return json;
}

void printSize(const Contents& c) {
  const Manifest& m = c.package.manifest();
  printOutf("%s\n", printable(c.file).c_str());
  if (!m.domain.isFlat()) {
    const auto [low, high] = extentMm(*m.base);
    printOutf(
        "  size      %.6g x %.6g x %.6g mm between its corners, %.6g mm per px of the finest texture in the mean\n",
        high.x - low.x, high.y - low.y, high.z - low.z, m.domain.mm_per_px);
    printOutf("%s", meshText(meshOf(c.package)).c_str());
    return;
  }
  const FlatDomain d = m.domain.flat();
  if (!m.size_known) {
    printOutf("  size      %llu x %llu px, not known in mm\n", static_cast<unsigned long long>(d.width_px),
              static_cast<unsigned long long>(d.height_px));
  } else {
    printOutf("  size      %llu x %llu px, %.6g x %.6g mm (%.6g mm per px)\n",
              static_cast<unsigned long long>(d.width_px), static_cast<unsigned long long>(d.height_px),
              static_cast<double>(d.width_px) * d.mm_per_px, static_cast<double>(d.height_px) * d.mm_per_px,
              d.mm_per_px);
  }
}

void printMeaning(const Contents& c) {
  const Manifest& m = c.package.manifest();
  const PatchDomain& d = m.domain;
  printOutf("  texture   %s, %d plane%s of 3 channels, %d level%s\n", basisName(m.texture.basis), m.texture.planes(),
            m.texture.planes() == 1 ? "" : "s", d.texture_depth + 1, d.texture_depth == 0 ? "" : "s");
  if (m.texture.coefficients() > 0) {
    printOutf("  scale    ");
    for (double v : m.texture.scales()) printOutf(" %.6g", v);
    printOutf("\n  bias     ");
    for (double v : m.texture.biases()) printOutf(" %.6g", v);
    printOutf("\n");
  }
  if (d.relief_depth >= 0) {
    printOutf("  relief    %.6g to %.6g %s in steps of %.3g %s, %d level%s, a vertex every %.6g px\n",
              d.relief_offset_mm, d.relief_offset_mm + 65535 * d.relief_scale_mm, c.unit(), d.relief_scale_mm, c.unit(),
              d.relief_depth + 1, d.relief_depth == 0 ? "" : "s",
              static_cast<double>(d.patchPx()) / (128.0 * static_cast<double>(uint64_t{1} << d.relief_depth)));
  } else {
    printOutf("  relief    none\n");
  }
}

void printPages(const Contents& c) {
  const Manifest& m = c.package.manifest();
  const PatchDomain& d = m.domain;
  printOutf("  patches   %u, of %s%llu px of texture a side\n", d.patchCount(), d.textureDepths() ? "up to " : "",
            static_cast<unsigned long long>(d.patchPx()));
  printOutf("  pages     %llu in %.1f MiB (%.2f bytes per pixel)\n", static_cast<unsigned long long>(m.page_count),
            static_cast<double>(c.package.fileBytes()) / (1 << 20), c.bytesPerPx());
  for (const PlaneLine& p : c.planes) {
    printOutf("    %-12s %-11s %8.1f MiB (%.3f bytes per pixel)", p.name.c_str(), p.encoding.c_str(),
              static_cast<double>(p.usage.bytes) / (1 << 20), static_cast<double>(p.usage.bytes) / c.pixels());
    if (p.usage.unknown_pages)
      printOutf(", without %llu pages whose index entries are damaged",
                static_cast<unsigned long long>(p.usage.unknown_pages));
    printOutf("\n");
  }
  if (const uint64_t left_out = d.untexturedNodeCount(); left_out > 0)
    printOutf("    left out  %llu nodes of texture that nothing needs; %llu patches have none at all, their tails do\n",
              static_cast<unsigned long long>(left_out), static_cast<unsigned long long>(patchesWithoutTexture(d)));
  if (const auto shown = c.package.shownImages(); shown.bytes > 0) {
    const double shown_kib = static_cast<double>(shown.bytes) / 1024;
    if (shown.one_colour || (shown.corner_colours && shown.images == 0))
      printOutf("    normals      %8.1f KiB: of the triangles that make %u patches, and %s\n", shown_kib, shown.patches,
                shown.one_colour ? "one colour" : "their corners' colours");
    else
      printOutf("    images       %8.1f KiB: %zu%s that %u patches show, whose pages are made when they are read\n",
                shown_kib, shown.images,
                shown.normal_maps > 0 ? (" and " + std::to_string(shown.normal_maps) +
                                         (shown.normal_maps > 1 ? " maps" : " map") + " of normals")
                                            .c_str()
                                      : "",
                shown.patches);
  }
  const PackageHeader& h = c.package.header();
  if (h.coded_tails)
    printOutf("    (lossless texture pages may be stored within the --texture-tolerance of the build)\n");
  auto kib = [](uint64_t bytes) { return static_cast<double>(bytes) / 1024; };
  printOutf("    besides   index %.1f KiB", kib(h.index_bytes));
  if (h.base_bytes > 0)
    printOutf(", base mesh %.1f KiB (%s)", kib(h.base_bytes), h.base_parity ? "and its parity" : "twice");
  if (c.package.hasTails() && c.tails) printOutf(", tails %.1f KiB", kib(c.tails->all));
  printOutf("\n");
  if (c.package.hasTails()) {
    printOutf("  tails     resident whatever is seen, if patches are many or have no texture pages: at most %.1f MiB\n",
              static_cast<double>(tailGpuBytes(d.patchCount(), static_cast<uint64_t>(m.texture.planes()))) / (1 << 20));
  }
  printOutf("  resident  %.3g bytes per texel on a GPU as rgba8", residentBytesPerTexel(m, PageCodec::kLossless));
  if (auto codec = commonBlockCodec(m))
    printOutf(", %.3g as %s (--upload)", residentBytesPerTexel(m, *codec), uploadFormatName(*codec).c_str());
  printOutf("\n");
}

void printText(const Contents& c) {
  printSize(c);
  printMeaning(c);
  printPages(c);
  const Manifest& m = c.package.manifest();
  if (!m.tool_version.empty()) printOutf("  made by   %s\n", printable(m.tool_version).c_str());
  for (const Provenance& p : m.sources) {
    printOutf("  source    %s%s%s%s%s\n", printable(p.name).c_str(), p.xxh3.empty() ? "" : "  xxh3 ",
              printable(p.xxh3).c_str(), p.generator.empty() ? "" : "  generator ", printable(p.generator).c_str());
  }
}

Result<void> info(const InfoArguments& o) {
  auto opened = Package::open(o.file);
  if (!opened) return opened.error();
  const Package& package = **opened;
  // Damage is told of in what follows. What the disk does not give is no property of the package.
  if (const auto& problem = package.manifestProblem(); problem && problem->kind == ErrorKind::kIo) return *problem;
  for (const std::string& warning : package.warnings()) warn(o.file + ": " + warning);
  auto planes = planeLines(package);
  if (!planes) return planes.error();
  auto tails = package.tailBytes();
  if (!tails && tails.error().kind == ErrorKind::kIo) return tails.error();
  const Contents contents{o.file, package, std::move(*planes), tails ? std::optional(*tails) : std::nullopt};
  if (o.json) {
    const auto json = jsonOf(contents);
    printOutf("%s\n",
              json.dump(2, ' ', /*ensure_ascii=*/true, nlohmann::ordered_json::error_handler_t::replace).c_str());
  } else {
    printText(contents);
  }
  return {};
}

}  // namespace

void addInfoCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<InfoArguments>();
  auto* c = app.add_subcommand(
      "info", "Tell what a package holds: sizes in px and mm, planes, levels, pages, where it came from");
  c->footer("Example:\n  relievo info tablet.relievo\n  relievo info tablet.relievo --json");
  c->add_option("FILE", o->file, "Package to read, or a scene of it")->required();
  c->add_flag("--json", o->json, "Print JSON");
  c->callback([o, &context] {
    if (auto named = takeArtwork(o->file); !named) return context.fail(named.error());
    if (auto done = info(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
