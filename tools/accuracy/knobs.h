// knobs.h - the settings that stand between accuracy and time, and the values of each that `relievo accuracy` measures.
// Pure.
#pragma once

#include <string>
#include <vector>

#include "src/engine/engine.h"
#include "texturing/codec/page_encoding.h"
#include "tools/scene/settings_file.h"

namespace relievo {

// One point of what is measured: a settings file with all its members set, and how the pages are stored.
struct AccuracySetting {
  DrawSettings draw;
  // Of the package built anew; the defaults are the package as it is.
  std::string encoding;      // of all texture planes, as build --encoding takes it; empty: as they are
  int coefficient_bits = 8;  // 4..8, of planes that hold no colour
  int relief_bits = 16;      // 1..16
  bool rebuilt() const { return !encoding.empty() || coefficient_bits < 8 || relief_bits < 16; }
  friend bool operator==(const AccuracySetting&, const AccuracySetting&) = default;
};

// What relievo render does without any option, for an artwork whose page cache is as large as this.
AccuracySetting defaultSetting(double cache_mib = EngineOptions{}.cache_mib);
// What the knobs are turned away from, one at a time: the default, with textures as sharp as the renderer has them, so
// that a blur does not hide what the other knobs do.
AccuracySetting knobBase(double cache_mib = EngineOptions{}.cache_mib);
// Into an engine's scene and options.
void applySetting(const AccuracySetting& setting, Scene& scene, EngineOptions& options);
// "error 1 px, cells 2, bias 0, anisotropic 8, ..."; one line.
std::string settingText(const AccuracySetting& setting);

struct KnobValue {
  std::string label;  // "0.5 px"
  AccuracySetting setting;
};
struct AccuracyKnob {
  std::string name, title, unit;  // "error-px" as --knobs takes it, "geometric error budget", "px"
  std::string meaning;            // one sentence
  std::vector<KnobValue> values;  // from the most accurate to the cheapest
  bool combined = false;          // its values change a settled picture's accuracy and are run in combinations, too
  std::string why_not;            // not empty: it is not measured, and this is why
};
// All knobs that there are, those that cannot be measured for this artwork with their reasons. quick: fewer values.
std::vector<AccuracyKnob> accuracyKnobs(const Manifest& manifest, bool quick);
// An artwork of many patches needs more than the default cache: all values get cache_mib, and of the cache's own those
// below least_mib are left out.
void giveCache(std::vector<AccuracyKnob>& knobs, double cache_mib, double least_mib);

}  // namespace relievo
