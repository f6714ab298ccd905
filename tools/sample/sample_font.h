// sample_font.h - Roman capitals as tapered strokes, after the proportions of imperial inscriptions.
// Units: cap height 1, baseline y = 0, y up. J, U, W become I, V, VV; '.' is the interpunct; anything else a space.
#pragma once

#include <string>
#include <vector>

#include "tools/sample/sample_noise.h"

namespace relievo::sample {

// Appends a glyph's segments at x and returns its advance. arc_steps: segments in a full circle.
double appendGlyph(char c, double x, int arc_steps, std::vector<Segment>& out);
double lineWidth(const std::string& text, double letter_space);

}  // namespace relievo::sample
