// hud_figures.h - the text of the viewer's panel of figures (F2): how many pages of each plane are in each state, and
// how long they take. hud.cpp lays it out.
#pragma once

#include <string>
#include <vector>

#include "src/engine/stage.h"

namespace relievo {

struct HudFigures {
  std::vector<std::vector<std::string>> planes;  // a heading, then a row a plane
  std::vector<std::string> lines;
};

HudFigures hudFigures(const EngineStats& stats, const Manifest& manifest);
// stats: of the stage. Planes are those of each of its artworks, with the artwork's number where there are several.
HudFigures hudFigures(const EngineStats& stats, const Stage& stage);
// "812 B", "12.3 kB", "4.06 GB": decimal units, at least three digits.
std::string bytesText(uint64_t bytes);

}  // namespace relievo
