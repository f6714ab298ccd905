#include "tools/export/line_file.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <functional>

#include "src/base/file.h"

namespace relievo {
namespace {

bool endsIn(const std::string& path, const char* end) {
  std::string lower = path;
  for (char& c : lower) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return lower.ends_with(end);
}

// Appends text piece by piece; the first error stays.
class TextFile {
 public:
  static Result<TextFile> create(const std::string& path) {
    auto file = OutputFile::create(path);
    if (!file) return file.error();
    return TextFile(std::move(*file));
  }
  void put(const std::string& text) {
    if (!done_) return;
    done_ = file_.append({reinterpret_cast<const uint8_t*>(text.data()), text.size()});
  }
  Result<void> commit() {
    if (!done_) return done_;
    return file_.commit();
  }

 private:
  explicit TextFile(OutputFile file) : file_(std::move(file)) {}
  OutputFile file_;
  Result<void> done_;
};

// To 10^-9 mm: what is less comes of rounding.
std::string number(double value, const char* format = "%.10g") {
  char text[40];
  value = std::round(value * 1e9) / 1e9;
  std::snprintf(text, sizeof text, format, value == 0 ? 0.0 : value);
  return text;
}
std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '&') out += "&amp;";
    else if (c == '<') out += "&lt;";
    else if (c == '>') out += "&gt;";
    else if (static_cast<unsigned char>(c) >= 0x20) out += c;
  }
  return out;
}

// A round length of at most a quarter of the width.
double barLength(double width) {
  const double ten = std::pow(10, std::floor(std::log10(width / 4)));
  for (const double step : {5.0, 2.0})
    if (step * ten <= width / 4) return step * ten;
  return ten;
}

using Place = std::function<glm::dvec2(const glm::dvec3&)>;
// A point's place in the drawing: to the right and up.
Place placeIn(const LineDrawing& d) {
  if (d.kind == LineDrawing::Kind::kContours) return [](const glm::dvec3& p) { return glm::dvec2(p); };
  if (d.kind == LineDrawing::Kind::kSection)
    return [from = d.from, along = d.along](const glm::dvec3& p) { return glm::dvec2(glm::dot(p - from, along), p.z); };
  const auto [right, up] = planeAxes(d.normal);
  return [right = right, up = up](const glm::dvec3& p) { return glm::dvec2(glm::dot(p, right), glm::dot(p, up)); };
}

void putCsv(TextFile& file, const LineDrawing& d, const SurfaceLines& all) {
  const std::string unit = std::string("_") + d.unit;
  const auto head = [&](std::initializer_list<const char*> names) {
    std::string text = "line,closed";
    for (const char* name : names) text += std::string(",") + name + unit;
    return text + "\n";
  };
  const bool contours = d.kind == LineDrawing::Kind::kContours, plane = d.kind == LineDrawing::Kind::kPlane;
  file.put(contours ? head({"height", "x", "y"})
           : plane  ? head({"right", "up", "x", "y", "z"})
                    : head({"distance", "x", "y", "z"}));
  const Place place = placeIn(d);
  for (size_t i = 0; i < all.lines.size(); ++i) {
    const SurfaceLine& line = all.lines[i];
    std::string text;
    for (const glm::dvec3& p : line.points) {
      const glm::dvec2 at = place(p);
      text += std::to_string(i + 1) + (line.closed ? ",1," : ",0,");
      if (contours) text += number(line.level) + "," + number(p.x) + "," + number(p.y);
      else
        text += number(at.x) + "," + (plane ? number(at.y) + "," : "") + number(p.x) + "," + number(p.y) + "," +
                number(p.z);
      text += "\n";
    }
    file.put(text);
  }
}

void putSvg(TextFile& file, const LineDrawing& d, const SurfaceLines& all) {
  const Place place = placeIn(d);
  glm::dvec2 low(-d.width / 2, -d.height / 2), high = -low;
  if (d.kind != LineDrawing::Kind::kContours) {
    low = glm::dvec2(1e300), high = glm::dvec2(-1e300);
    for (const SurfaceLine& line : all.lines)
      for (const glm::dvec3& p : line.points) low = glm::min(low, place(p)), high = glm::max(high, place(p));
  }
  const double size = std::max(high.x - low.x, high.y - low.y), margin = 0.03 * size, foot = 0.06 * size;
  const double left = low.x - margin, top = -high.y - margin, width = high.x - low.x + 2 * margin,
               height = high.y - low.y + 2 * margin + foot;
  const std::string unit = d.unit;
  file.put("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"" +
           number(width, "%.7g") + unit + "\" height=\"" + number(height, "%.7g") + unit + "\" viewBox=\"" +
           number(left) + " " + number(top) + " " + number(width) + " " + number(height) + "\">\n<title>" +
           escaped(d.title) + "</title>\n<desc>One user unit is one " + unit + "; scale 1:1.</desc>\n" +
           "<g fill=\"none\" stroke=\"black\" stroke-width=\"" + number(size / 2000, "%.3g") +
           "\" stroke-linejoin=\"round\">\n");
  std::vector<const SurfaceLine*> order;
  for (const SurfaceLine& line : all.lines) order.push_back(&line);
  std::stable_sort(order.begin(), order.end(),
                   [](const SurfaceLine* a, const SurfaceLine* b) { return a->level < b->level; });
  const bool groups = d.kind == LineDrawing::Kind::kContours;
  for (size_t i = 0; i < order.size(); ++i) {
    const SurfaceLine& line = *order[i];
    if (groups && (i == 0 || order[i - 1]->level != line.level))
      file.put("<g data-height=\"" + number(line.level) + "\">\n");
    std::string path = "<path d=\"";
    for (size_t k = 0; k < line.points.size(); ++k) {
      const glm::dvec2 at = place(line.points[k]);
      path += (k == 0 ? "M" : k == 1 ? "L" : " ") + number(at.x, "%.9g") + " " + number(-at.y, "%.9g");
    }
    file.put(path + (line.closed ? "Z" : "") + "\"/>\n");
    if (groups && (i + 1 == order.size() || order[i + 1]->level != line.level)) file.put("</g>\n");
  }
  const double bar = barLength(size), y = -low.y + margin + foot / 3;
  file.put("</g>\n<g stroke=\"black\" stroke-width=\"" + number(size / 400, "%.3g") + "\"><path d=\"M" + number(low.x) +
           " " + number(y) + "h" + number(bar) + "\"/></g>\n<text x=\"" + number(low.x) + "\" y=\"" +
           number(y + foot / 2) + "\" font-family=\"sans-serif\" font-size=\"" + number(0.025 * size, "%.3g") + "\">" +
           number(bar) + " " + unit + "</text>\n</svg>\n");
}

}  // namespace

std::pair<glm::dvec3, glm::dvec3> planeAxes(const glm::dvec3& normal) {
  const glm::dvec3 n = glm::normalize(normal), up = std::abs(n.y) > 0.9 ? glm::dvec3(0, 0, -1) : glm::dvec3(0, 1, 0);
  const glm::dvec3 right = glm::normalize(glm::cross(up, n));
  return {right, glm::cross(n, right)};
}

Result<void> checkLineFile(const std::string& path) {
  if (endsIn(path, ".svg") || endsIn(path, ".csv")) return {};
  return Error{ErrorKind::kUsage, path, "expected a name that ends in .svg or .csv for lines", "", {}};
}

Result<void> writeLines(const std::string& path, const LineDrawing& drawing, const SurfaceLines& lines) {
  if (auto good = checkLineFile(path); !good) return good;
  auto file = TextFile::create(path);
  if (!file) return file.error();
  if (endsIn(path, ".csv")) putCsv(*file, drawing, lines);
  else putSvg(*file, drawing, lines);
  return file->commit();
}

}  // namespace relievo
