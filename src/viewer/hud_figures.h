// hud_figures.h - what the viewer's panel of figures says (F2): a page's way in numbers. Plain text, laid out by
// hud.cpp.
#pragma once

#include <string>
#include <vector>

#include "src/engine/engine.h"

namespace relievo {

struct HudFigures {
  std::vector<std::vector<std::string>> planes;  // a heading, then a row a plane
  std::vector<std::string> lines;
};

HudFigures hudFigures(const EngineStats& stats, const Manifest& manifest);
// "812 B", "12.3 kB", "4.06 GB": three digits or more, 10^3.
std::string bytesText(uint64_t bytes);

}  // namespace relievo
