#include "tools/report/mesh_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <span>

#include "src/artwork/patch_domain.h"
#include "src/base/file.h"
#include "texturing/import/image_io.h"

namespace relievo {
namespace {

using Json = nlohmann::ordered_json;

template <class... Values>
std::string format(const char* pattern, Values... values) {
  const int n = std::snprintf(nullptr, 0, pattern, values...);
  std::string out(static_cast<size_t>(std::max(n, 0)), '\0');
  std::snprintf(out.data(), out.size() + 1, pattern, values...);
  return out;
}

Json vectorJson(const glm::dvec3& v) { return {v.x, v.y, v.z}; }

// Members of JSON that may hold anything; text as it may be printed.
std::string textOf(const Json& object, const char* key) {
  auto it = object.is_object() ? object.find(key) : object.end();
  return object.is_object() && it != object.end() && it->is_string() ? printable(it->get<std::string>())
                                                                     : std::string();
}
double numberOf(const Json& object, const char* key) {
  auto it = object.is_object() ? object.find(key) : object.end();
  return object.is_object() && it != object.end() && it->is_number() ? it->get<double>() : 0;
}
const Json& memberOf(const Json& object, const char* key) {
  static const Json none = nullptr;
  auto it = object.is_object() ? object.find(key) : object.end();
  return object.is_object() && it != object.end() ? *it : none;
}
std::array<double, 3> tripleOf(const Json& v) {
  std::array<double, 3> out{};
  for (size_t k = 0; k < 3; ++k)
    if (v.is_array() && v.size() == 3 && v[k].is_number()) out[k] = v[k].get<double>();
  return out;
}
std::string count(double n, const char* what) {
  const size_t length = std::strlen(what);
  return format("%.0f %s%s", n, what, n == 1 ? "" : length > 1 && what[length - 1] == 'h' ? "es" : "s");
}
// "open borders" of one: "open border". what may be anything.
std::string headed(double n, std::string what) {
  if (n != 1) return what;
  for (const auto& [many, one] : {std::pair{"vertices", "vertex"},
                                  {"triangles", "triangle"},
                                  {"materials without", "a material without"},
                                  {"materials with", "a material with"},
                                  {"edges", "edge"},
                                  {"borders", "border"},
                                  {"pieces", "piece"},
                                  {"faces", "face"},
                                  {"images", "image"},
                                  {"maps of", "map of"},
                                  {"files", "file"},
                                  {"header lines", "header line"},
                                  {"corners that name", "corner that names"},
                                  {"that are", "that is"},
                                  {"that run", "that runs"},
                                  {"their", "its"}}) {
    const size_t at = what.find(many), aside = what.find('(');
    if (at == std::string::npos || at > aside) continue;
    what.replace(at, std::strlen(many), one);
  }
  return what;
}
std::string placesText(const Json& places, double n) {
  std::string out;
  if (!places.is_array()) return out;
  for (const Json& place : places) {
    auto p = tripleOf(place);
    out += format("%s(%.6g, %.6g, %.6g)", out.empty() ? "" : ", ", p[0], p[1], p[2]);
  }
  const double further = n - static_cast<double>(places.size());
  if (!out.empty() && further >= 1) out += format(" and %.0f more", further);
  return out;
}

// ---- the picture ----
// Anchors of viridis: it is even to the eye, and to eyes that tell no red from green.
constexpr std::array<std::array<double, 3>, 5> kRamp{
    {{68, 1, 84}, {59, 82, 139}, {33, 145, 140}, {94, 201, 98}, {253, 231, 37}}};
std::array<double, 3> rampColour(double t) {
  t = std::clamp(t, 0.0, 1.0) * (kRamp.size() - 1);
  const size_t i = std::min(static_cast<size_t>(t), kRamp.size() - 2);
  std::array<double, 3> out;
  for (size_t c = 0; c < 3; ++c) out[c] = kRamp[i][c] + (t - static_cast<double>(i)) * (kRamp[i + 1][c] - kRamp[i][c]);
  return out;
}

std::string base64(std::span<const uint8_t> bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (size_t i = 0; i < bytes.size(); i += 3) {
    uint32_t v = 0;
    for (size_t k = 0; k < 3; ++k) v = v << 8 | (i + k < bytes.size() ? static_cast<uint8_t>(bytes[i + k]) : 0u);
    for (size_t k = 0; k < 4; ++k) out += i + k > bytes.size() ? '=' : kDigits[v >> (18 - 6 * k) & 63];
  }
  return out;
}

Result<std::string> pngUri(const ErrorPicture& picture) {
  auto png = encodePng(picture.width, picture.height, 3, picture.rgb);
  if (!png) return png.error();
  return "data:image/png;base64," + base64(*png);
}

std::string escaped(const std::string& text) {
  std::string out;
  for (char c : text)
    out += c == '<' ? "&lt;" : c == '>' ? "&gt;" : c == '&' ? "&amp;" : c == '"' ? "&quot;" : std::string(1, c);
  return out;
}

std::string row(std::initializer_list<std::string> cells, const char* tag = "td") {
  std::string out = "<tr>";
  for (const std::string& cell : cells) out += std::string("<") + tag + ">" + cell + "</" + tag + ">";
  return out + "</tr>\n";
}

constexpr const char* kStyle =
    "body{font:15px/1.5 system-ui,sans-serif;max-width:1120px;margin:2em auto;padding:0 "
    "1em;color:#222}h1{font-size:1.5em}h2{font-size:1.15em;margin-top:1.6em}"
    "table{border-collapse:collapse}td,th{padding:.2em .9em .2em "
    "0;text-align:left;font-variant-numeric:tabular-nums;border-bottom:1px solid #ddd}"
    "img{width:100%}.ramp{height:1em;background:linear-gradient(to "
    "right,rgb(68,1,84),rgb(59,82,139),rgb(33,145,140),rgb(94,201,98),rgb(253,231,37))}"
    ".ends{display:flex;justify-content:space-between}";

// An expected and a found number, of so many digits, or of as many more as tell them apart.
std::array<std::string, 2> toldApart(double expected, double found, int digits = 3) {
  std::array<std::string, 2> out;
  do {
    out = {format("%.*g", digits, expected), format("%.*g", digits, found)};
  } while (expected != found && out[0] == out[1] && ++digits <= std::numeric_limits<double>::max_digits10);
  return out;
}

}  // namespace

std::string missedTarget(const Fidelity& f) {
  const OneSidedFidelity& way = f.to_drawn.excess(f.target) >= f.to_scan.excess(f.target) ? f.to_drawn : f.to_scan;
  const auto rms = toldApart(f.target.rms_mm, way.rms_mm), p99_9 = toldApart(f.target.p99_9_mm, way.p99_9_mm),
             area = toldApart(100 * (1 - FidelityTarget::kMaxAreaBeyond), 100 * (1 - way.area_beyond), 4);
  return "the target is missed: expected RMS within " + rms[0] + " mm, 99.9 % within " + p99_9[0] + " mm and " +
         area[0] + " % of the area within " + format("%.3g", f.target.max_mm) + " mm of the scan, found " + rms[1] +
         " mm, " + p99_9[1] + " mm and " + area[1] + " %, the largest distance " +
         format("%.3g mm at (%.6g, %.6g, %.6g)", way.max_mm, way.max_at_mm.x, way.max_at_mm.y, way.max_at_mm.z);
}

Json meshJson(const std::string& file, const std::string& unit, const MeshDiagnosis& d, const BaseMesh& base,
              const BakeReport& bake, uint32_t patches_asked) {
  Json json = Json::object();
  json["file"] = file;
  json["unit"] = unit;
  json["vertices_read"] = d.vertices_read;
  json["triangles_read"] = d.triangles_read;
  json["vertices"] = d.vertices;
  json["triangles"] = d.triangles;
  json["pieces"] = d.pieces;
  json["border_loops"] = d.border_loops;
  json["min_mm"] = vectorJson(d.min_mm);
  json["max_mm"] = vectorJson(d.max_mm);
  json["findings"] = Json::array();
  for (const MeshFinding& f : d.findings) {
    Json places = Json::array();
    for (const glm::dvec3& p : f.places_mm) places.push_back(vectorJson(p));
    json["findings"].push_back({{"what", f.what}, {"count", f.count}, {"done", f.done}, {"places_mm", places}});
  }
  json["patches"] = base.patches.size();
  if (patches_asked > 0) json["patches_asked"] = patches_asked;
  json["corners"] = base.corners.size();
  json["cells_a_side"] = 1 << bake.cells_log2;
  json["texels_a_side"] = kPagePx << bake.texture_depth;
  json["samples"] = bake.samples;
  json["samples_by_closest_point"] = bake.by_closest_point;
  json["tolerance_mm"] = bake.tolerance_mm;
  json["deviation_mm"] = bake.deviation_mm;
  switch (bake.limit) {
    case BakeLimit::kNone:
      break;
    case BakeLimit::kCells:
      json["tolerance_missed"] = "there are no more cells a patch; more patches have more";
      break;
    case BakeLimit::kSamples:
      json["tolerance_missed"] = "there are no more samples for a scan of so many vertices";
      break;
    case BakeLimit::kShape:
      json["tolerance_missed"] =
          "finer grids hardly come nearer, the scan has edges or undercuts that none follows; more patches may";
      break;
  }
  return json;
}

std::string meshText(const Json& m) {
  if (!m.is_object() || textOf(m, "file").empty()) return {};
  const auto low = tripleOf(memberOf(m, "min_mm")), high = tripleOf(memberOf(m, "max_mm"));
  std::string turned = textOf(m, "up").empty() ? "" : ", its " + textOf(m, "up") + " up";
  if (memberOf(m, "rotate_deg").is_array()) {
    const auto by = tripleOf(memberOf(m, "rotate_deg"));
    turned += format(", turned by %.6g, %.6g, %.6g degrees", by[0], by[1], by[2]);
  }
  std::string out = format(
      "  scan      %s (in %s%s): %s, %s, %s, %s, %.6g x %.6g x %.6g mm\n", textOf(m, "file").c_str(),
      textOf(m, "unit").c_str(), turned.c_str(), format("%.0f vertices", numberOf(m, "vertices")).c_str(),
      count(numberOf(m, "triangles"), "triangle").c_str(), count(numberOf(m, "pieces"), "piece").c_str(),
      count(numberOf(m, "border_loops"), "open border").c_str(), high[0] - low[0], high[1] - low[1], high[2] - low[2]);
  if (numberOf(m, "triangles_read") != numberOf(m, "triangles") ||
      numberOf(m, "vertices_read") != numberOf(m, "vertices"))
    out += format("    read    %.0f vertices, %.0f triangles\n", numberOf(m, "vertices_read"),
                  numberOf(m, "triangles_read"));
  if (const Json& findings = memberOf(m, "findings"); findings.is_array()) {
    for (const Json& f : findings) {
      const std::string done = textOf(f, "done"), places = placesText(memberOf(f, "places_mm"), numberOf(f, "count"));
      out += format("    found   %.0f %s: %s%s%s\n", numberOf(f, "count"),
                    headed(numberOf(f, "count"), textOf(f, "what")).c_str(),
                    done.empty() ? "left as it is" : done.c_str(), places.empty() ? "" : "; at ", places.c_str());
    }
  }
  if (const double asked = numberOf(m, "patches_asked"), made = numberOf(m, "patches");
      asked > 0 && std::abs(made - asked) > 0.05 * asked) {
    out +=
        format("    laid    over %s where %.0f %s asked for: %s\n", count(made, "patch").c_str(), asked,
               asked == 1 ? "was" : "were",
               made > 1.3 * asked ? "its pieces, borders and creases take so many" : "numbers are kept to about 30 %");
  }
  out += format("    baked   %.0f samples, %.0f x %.0f cells of heights a patch", numberOf(m, "samples"),
                numberOf(m, "cells_a_side"), numberOf(m, "cells_a_side"));
  if (double n = numberOf(m, "samples_by_closest_point"); n > 0)
    out += format(", %.0f of them by the closest point", n);
  out += format(
      "\n            99.9 %% of the surface within %.3g mm where lines along the normals meet the scan; %.3g mm were "
      "aimed at",
      numberOf(m, "deviation_mm"), numberOf(m, "tolerance_mm"));
  if (const std::string why = textOf(m, "tolerance_missed"); !why.empty()) out += ", and not reached: " + why;
  return out + "\n";
}

namespace {

Json fidelityJson(const Fidelity& f) {
  auto way = [](const OneSidedFidelity& w) {
    return Json{{"samples", w.samples},
                {"rms_mm", w.rms_mm},
                {"p99_9_mm", w.p99_9_mm},
                {"max_mm", w.max_mm},
                {"max_at_mm", {w.max_at_mm.x, w.max_at_mm.y, w.max_at_mm.z}},
                {"area_beyond", w.area_beyond}};
  };
  return {{"kept", f.kept()},
          {"psnr_db", f.psnr_db()},
          {"target",
           {{"rms_mm", f.target.rms_mm},
            {"p99_9_mm", f.target.p99_9_mm},
            {"beyond_mm", f.target.max_mm},
            {"area_beyond", FidelityTarget::kMaxAreaBeyond}}},
          {"missing", way(f.to_drawn)},
          {"too_much", way(f.to_scan)}};
}

std::string fidelityHtml(const Fidelity& f) {
  std::string html = format("<h2>Is it the scan?</h2>\n<p>The target is %s: %.1f dB.</p>\n<table>",
                            f.kept() ? "kept" : "missed", f.psnr_db());
  html += row({"", "target", "missing (scan to patches)", "too much (patches to scan)"}, "th");
  auto length = [&](const char* name, double target, double there, double back) {
    html += row({name, format("%.4g mm", target), format("%.4g mm", there), format("%.4g mm", back)});
  };
  const FidelityTarget& t = f.target;
  const OneSidedFidelity &there = f.to_drawn, &back = f.to_scan;
  length("RMS", t.rms_mm, there.rms_mm, back.rms_mm);
  length("99.9 %", t.p99_9_mm, there.p99_9_mm, back.p99_9_mm);
  html += row({format("area beyond %.4g mm", t.max_mm), format("%.4g %%", 100 * FidelityTarget::kMaxAreaBeyond),
               format("%.4g %%", 100 * there.area_beyond), format("%.4g %%", 100 * back.area_beyond)});
  html += row({"largest", "", format("%.4g mm", there.max_mm), format("%.4g mm", back.max_mm)});
  return html + "</table>\n";
}

}  // namespace

Json reportJson(const MeshBuildResult& r) {
  auto stats = [&](const DistanceStats& s) {
    Json json{{"samples", s.samples}, {"max_mm", s.max_mm}, {"rms_mm", s.rms_mm}};
    constexpr std::array<const char*, 5> kNames{"p50", "p90", "p95", "p99", "p99_9"};
    for (size_t i = 0; i < kNames.size(); ++i) json[std::string(kNames[i]) + "_mm"] = s.percentiles_mm[i];
    json["max_of_diagonal"] = s.max_mm / r.distance.diagonal_mm;
    json["rms_of_diagonal"] = s.rms_mm / r.distance.diagonal_mm;
    for (size_t i = 0; i < kNames.size(); ++i)
      json[std::string(kNames[i]) + "_of_diagonal"] = s.percentiles_mm[i] / r.distance.diagonal_mm;
    return json;
  };
  Json json = Json::object();
  json["package"] = r.package;
  json["pages"] = r.pages;
  json["package_bytes"] = r.package_bytes;
  json["relief_bytes"] = r.relief_bytes;
  json["texture_tolerance"] = r.texture_tolerance;
  json["texture_nodes"] = r.texture_nodes;
  json["texture_nodes_left_out"] = r.texture_nodes_left_out;
  if (r.normal_maps > 0) json["normal_maps"] = r.normal_maps;
  if (r.shown_images > 0) json["shown_images"] = {{"images", r.shown_images}, {"patches", r.patches_with_images}};
  const double vertices = static_cast<double>(std::max<uint64_t>(r.vertices, 1));
  json["relief_bits_per_vertex"] = 8.0 * static_cast<double>(r.relief_bytes) / vertices;
  json["package_bits_per_vertex"] = 8.0 * static_cast<double>(r.package_bytes) / vertices;
  json["samples_per_vertex"] = numberOf(r.mesh, "samples") / vertices;
  json["mesh"] = r.mesh;
  json["fidelity"] = fidelityJson(r.fidelity);
  json["distance"] = {{"diagonal_mm", r.distance.diagonal_mm},
                      {"psnr_db", r.distance.psnr_db},
                      {"scan_to_patches", stats(r.distance.to_baked)},
                      {"patches_to_scan", stats(r.distance.to_scan)}};
  // What building costs, without measuring.
  double seconds = 0;
  uint64_t peak = 0;
  json["stages"] = Json::array();
  for (const StageCost& s : r.stages) {
    json["stages"].push_back({{"name", s.name}, {"seconds", s.seconds}, {"peak_bytes", s.peak_bytes}});
    if (s.name == "distance") continue;
    seconds += s.seconds;
    peak = std::max(peak, s.peak_bytes);
  }
  json["build_peak_bytes"] = peak;
  json["build_peak_bytes_per_triangle"] =
      static_cast<double>(peak) / static_cast<double>(std::max<uint64_t>(r.triangles_read, 1));
  json["build_seconds"] = seconds;
  json["triangles_per_s"] = static_cast<double>(r.triangles_read) / std::max(seconds, 1e-9);
  return json;
}

ErrorPicture paintError(const TriMesh& scan, const std::vector<float>& vertex_mm, double low_mm, double high_mm,
                        int view_px) {
  constexpr int kViews = 4;
  glm::dvec3 low(1e300), high(-1e300);
  for (const glm::vec3& p : scan.positions_mm) low = glm::min(low, glm::dvec3(p)), high = glm::max(high, glm::dvec3(p));
  const glm::dvec3 centre = (low + high) * 0.5, half = (high - low) * 0.5;
  const double px_per_mm = 0.48 * view_px / std::max({half.x, half.y, half.z, 1e-9});
  ErrorPicture out{kViews * view_px, view_px, {}};
  out.rgb.assign(static_cast<size_t>(out.width) * static_cast<size_t>(out.height) * 3, 255);
  std::vector<float> depth(static_cast<size_t>(view_px) * static_cast<size_t>(view_px));
  for (int view = 0; view < kViews; ++view) {
    std::fill(depth.begin(), depth.end(), -1e30f);
    const double turn = view * 1.5707963267948966, c = std::cos(turn), s = std::sin(turn);
    struct Projected {
      double x, y, z;
    };
    auto project = [&](uint32_t v) {
      const glm::dvec3 p = glm::dvec3(scan.positions_mm[v]) - centre;
      return Projected{(c * p.x - s * p.z) * px_per_mm + 0.5 * view_px, 0.5 * view_px - p.y * px_per_mm,
                       (s * p.x + c * p.z) * px_per_mm};
    };
    for (const auto& t : scan.triangles) {
      const Projected p[3] = {project(t[0]), project(t[1]), project(t[2])};
      const double area = (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[2].x - p[0].x) * (p[1].y - p[0].y);
      if (area == 0) continue;
      const glm::dvec3 a(scan.positions_mm[t[0]]);
      const glm::dvec3 normal =
          glm::cross(glm::dvec3(scan.positions_mm[t[1]]) - a, glm::dvec3(scan.positions_mm[t[2]]) - a);
      const double facing = (s * normal.x + c * normal.z) / std::max(glm::length(normal), 1e-300),
                   light = 0.5 + 0.5 * std::abs(facing);
      auto inside = [&](double v) { return static_cast<int>(std::clamp(v, 0.0, static_cast<double>(view_px - 1))); };
      const int x0 = inside(std::floor(std::min({p[0].x, p[1].x, p[2].x}))),
                x1 = inside(std::ceil(std::max({p[0].x, p[1].x, p[2].x})));
      const int y0 = inside(std::floor(std::min({p[0].y, p[1].y, p[2].y}))),
                y1 = inside(std::ceil(std::max({p[0].y, p[1].y, p[2].y})));
      for (int y = y0; y <= y1; ++y) {
        for (int x = x0; x <= x1; ++x) {
          const double px = x + 0.5, py = y + 0.5;
          const double w1 = ((px - p[0].x) * (p[2].y - p[0].y) - (p[2].x - p[0].x) * (py - p[0].y)) / area;
          const double w2 = ((p[1].x - p[0].x) * (py - p[0].y) - (px - p[0].x) * (p[1].y - p[0].y)) / area,
                       w0 = 1 - w1 - w2;
          if (w0 < 0 || w1 < 0 || w2 < 0) continue;
          const float z = static_cast<float>(w0 * p[0].z + w1 * p[1].z + w2 * p[2].z);
          float& nearest = depth[static_cast<size_t>(y) * static_cast<size_t>(view_px) + static_cast<size_t>(x)];
          if (z <= nearest) continue;
          nearest = z;
          const double mm = w0 * vertex_mm[t[0]] + w1 * vertex_mm[t[1]] + w2 * vertex_mm[t[2]];
          const auto colour = rampColour(mm > low_mm ? std::log(mm / low_mm) / std::log(high_mm / low_mm) : 0);
          uint8_t* to = out.rgb.data() + 3 * (static_cast<size_t>(y) * static_cast<size_t>(out.width) +
                                              static_cast<size_t>(view * view_px + x));
          for (size_t k = 0; k < 3; ++k) to[k] = static_cast<uint8_t>(colour[k] * light + 0.5);
        }
      }
    }
  }
  return out;
}

Result<void> writeMeshReport(const std::string& path, const TriMesh& scan, const MeshBuildResult& r) {
  const MeshDistance& d = r.distance;
  // The same scale for every scan, so that reports compare.
  constexpr double kLow = 1e-6, kHigh = 1e-2;
  auto picture = pngUri(paintError(scan, d.scan_vertex_mm, kLow * d.diagonal_mm, kHigh * d.diagonal_mm, 480));
  if (!picture) return picture.error();
  const Json json = reportJson(r);
  std::string html = "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>" +
                     escaped(textOf(r.mesh, "file")) + "</title><style>" + kStyle + "</style>\n<h1>" +
                     escaped(textOf(r.mesh, "file")) + " as patches</h1>\n";
  html += format(
              "<p>%.0f triangles over %.0f patches, %.0f samples (%.2f a vertex), %.1f bits of relief a vertex; %llu "
              "pages, %.1f MiB: ",
              numberOf(r.mesh, "triangles"), numberOf(r.mesh, "patches"), numberOf(r.mesh, "samples"),
              numberOf(json, "samples_per_vertex"), numberOf(json, "relief_bits_per_vertex"),
              static_cast<unsigned long long>(r.pages), static_cast<double>(r.package_bytes) / (1 << 20)) +
          escaped(r.package) + ".</p>\n";
  html += fidelityHtml(r.fidelity);
  html +=
      "<h2>Distance from the scan to its patches</h2>\n<img alt=\"The distance painted on the scan, from four sides\" "
      "src=\"" +
      *picture + "\">\n";
  html += "<div class=\"ramp\"></div><div class=\"ends\">";
  for (double share = kLow; share < 2 * kHigh; share *= 10)
    html += format("<span>%.0e<br>%.3g mm</span>", share, share * d.diagonal_mm);
  html += "</div>\n<p>By decades, in fractions of the diagonal of the scan's bounding box.</p>\n";
  html += "<table>" + row({"", "scan to patches", "of the diagonal", "patches to scan", "of the diagonal"}, "th");
  auto distance = [&](const char* name, double there, double back) {
    html += row({name, format("%.4g mm", there), format("%.2e", there / d.diagonal_mm), format("%.4g mm", back),
                 format("%.2e", back / d.diagonal_mm)});
  };
  constexpr std::array<const char*, 5> kNames{"p50", "p90", "p95", "p99", "p99.9"};
  for (size_t i = 0; i < kNames.size(); ++i)
    distance(kNames[i], d.to_baked.percentiles_mm[i], d.to_scan.percentiles_mm[i]);
  distance("largest", d.to_baked.max_mm, d.to_scan.max_mm);
  distance("RMS", d.to_baked.rms_mm, d.to_scan.rms_mm);
  html += row({"samples", format("%llu", static_cast<unsigned long long>(d.to_baked.samples)), "",
               format("%llu", static_cast<unsigned long long>(d.to_scan.samples)), ""});
  html += format("</table>\n<p>Diagonal of the scan's bounding box %.6g mm; the larger RMS is %.1f dB below it.</p>\n",
                 d.diagonal_mm, d.psnr_db);
  html += "<h2>The scan</h2>\n<pre>" + escaped(meshText(r.mesh)) + "</pre>\n";
  html += "<h2>Time and memory</h2>\n<table>" + row({"stage", "seconds", "largest resident size"}, "th");
  for (const StageCost& s : r.stages)
    html += row({escaped(s.name), format("%.2f", s.seconds),
                 s.peak_bytes ? format("%.1f MiB", static_cast<double>(s.peak_bytes) / (1 << 20)) : "not known"});
  html += format(
      "</table>\n<p>Without measuring: %.3g triangles a second, %.0f bytes of memory a triangle of the "
      "file.</p>\n</html>\n",
      numberOf(json, "triangles_per_s"), numberOf(json, "build_peak_bytes_per_triangle"));
  return writeFile(path, {reinterpret_cast<const uint8_t*>(html.data()), html.size()});
}

}  // namespace relievo
