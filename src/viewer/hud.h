// hud.h - the head-up display: a line of figures, a message, a panel of more figures, the light's direction, and the
// help. Dear ImGui lays it out, behind hud.cpp alone; OverlayPass draws it, since ImGui's own back end raises GL errors
// under ES.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>

#include "src/base/result.h"
#include "src/gl/context.h"
#include "src/viewer/hud_figures.h"

namespace relievo {

struct HudState {
  double fps = 0, frame_ms = 0;
  uint32_t resident_pages = 0, slots = 0, missing_pages = 0;
  double error_px = 1;            // asked for
  double predicted_error_px = 0;  // of what is drawn
  double mm_per_px = 0;           // of an orthographic picture; else 0
  std::string given_up;           // for the frame time, in a word; empty: nothing
  bool unlit = false;             // no light changes the picture: the line says so, and no gauge shows a light
  std::string shading;            // what of the relief is shown, where nothing is lit for that; empty: nothing
  bool shadows = false, ambient_occlusion = false, gloss = false;  // in the picture
  std::string held_light;  // of several lights the one that the mouse moves: "light 2 of 3, near"; empty: there is one
  bool size_known = true;  // false: mm_per_px counts the artwork's pixels
  double duration_s = 0, time_s = 0;  // of what moves by itself; 0: nothing does
  bool playing = false;
  std::array<double, 3> light{0, 0, 1};
  bool show_light = false;
  bool help = false;
  std::string message;                // empty: none
  std::optional<HudFigures> figures;  // the panel
};

// "31 fps  32.0 ms   pages 312 of 3628, 4 missing   error at most 0.84 px". Where the error exceeds error_px, the line
// says "error at most 8.60 px in places (asked for 1.0)" or, while pages are missing, "... so far (asked for 1.0)". An
// orthographic view adds "   0.042 mm a px", what moves by itself "   1.3 of 4.0 s, playing" (or paused), an unlit one
// "   unlit" or "   slope", accuracy given up for time ", less geometry" after the time. What else is in the picture
// follows: ", shadows, ambient occlusion, gloss".
std::string hudLine(const HudState& state);

class Hud {
 public:
  // One at a time: ImGui has one current context. scale: of text, 1 or 2.
  static Result<std::unique_ptr<Hud>> create(gl::Api api, double scale);
  ~Hud();
  // Into the framebuffer that is bound, over what is there.
  void draw(const HudState& state, int width_px, int height_px);

 private:
  struct Impl;
  explicit Hud(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
