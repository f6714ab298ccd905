// svg_plot.h - plots of reports, as SVG: points on two axes, in series that colour and shape tell apart, joined by
// lines. Inline in a page they take the page's colours (kReportStyle), light or dark; standalone they bring their own.
// Texts are given as they are and escaped here. Pure; the same plot gives the same bytes.
#pragma once

#include <string>
#include <vector>

namespace relievo {

// Appends as printf formats, at most 4 KiB.
__attribute__((format(printf, 2, 3))) void appendf(std::string& out, const char* format, ...);
// For text and attributes of HTML and SVG.
std::string escapedHtml(const std::string& text);

struct PlotSeries {
  std::string title;
  bool dashed = false;
  bool joined = true;  // a line through its points, in their order
};
struct PlotPoint {
  size_t series = 0;
  double x = 0, y = 0;
  std::string text;    // shown where the mouse rests
  std::string label;   // beside the point, where there is room; may be empty
  bool front = false;  // no other point is better on both axes: ringed
};
struct PlotAxis {
  std::string title;        // with the unit
  bool logarithmic = true;  // then all values are above 0
  double margin = 1.4;      // beyond the values: a factor; of a linear axis a tenth of their range is added
};
struct Plot {
  std::string title;
  PlotAxis x, y;
  std::vector<PlotSeries> series;
  std::vector<PlotPoint> points;  // in the order of their series' lines; none: no plot
};

std::string plotSvg(const Plot& plot);
// A legend's key: a mark of that series.
std::string plotKey(size_t series);
// The plot as a file of its own, with its legend and its own colours.
std::string standaloneSvg(const Plot& plot);

extern const char* const kReportStyle;  // CSS of reports, in light and dark

}  // namespace relievo
