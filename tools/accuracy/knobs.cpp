#include "tools/accuracy/knobs.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace relievo {
namespace {

std::string numberText(double v, const char* unit = "") {
  char text[40];
  std::snprintf(text, sizeof text, "%g%s", v, unit);
  return text;
}

// Values of one member of the settings, the others as in the base.
template <class Value>
std::vector<KnobValue> valuesOf(std::optional<Value> DrawSettings::*member, const std::vector<Value>& values,
                                const char* unit) {
  std::vector<KnobValue> out;
  for (const Value& v : values) {
    KnobValue k{numberText(static_cast<double>(v), unit), knobBase()};
    k.setting.draw.*member = v;
    out.push_back(std::move(k));
  }
  return out;
}

AccuracyKnob errorKnob(bool quick) {
  AccuracyKnob k{
      "error-px", "geometric error budget", "px", "the error on screen that triangles are chosen for", {}, true, {}};
  k.values = valuesOf<double>(
      &DrawSettings::error_px,
      quick ? std::vector<double>{0.5, 1, 2, 4, 8} : std::vector<double>{0.25, 0.5, 1, 2, 4, 8, 16}, " px");
  return k;
}

AccuracyKnob leastCellKnob(bool quick) {
  AccuracyKnob k{
      "least-cell", "least cell width", "budgets", "no triangles narrower than this many error budgets", {}, true, {}};
  k.values = valuesOf<double>(&DrawSettings::least_cell,
                              quick ? std::vector<double>{0, 2, 6} : std::vector<double>{0, 1, 2, 4, 8}, "");
  return k;
}

AccuracyKnob detailBiasKnob(bool quick) {
  AccuracyKnob k{
      "detail-bias", "texture detail bias", "levels", "texture levels coarser than the pixels ask for", {}, true, {}};
  k.values =
      valuesOf<double>(&DrawSettings::detail_bias,
                       quick ? std::vector<double>{0, 1, 2} : std::vector<double>{0, 0.25, 0.5, 1, 1.5, 2, 3}, "");
  return k;
}

AccuracyKnob samplingKnob(bool quick) {
  AccuracyKnob k{"sampling", "sampling", "", "texels and levels that a pixel reads; the number is of taps at most",
                 {},         true,       {}};
  for (int taps : quick ? std::vector<int>{8, 2} : std::vector<int>{8, 32, 4, 2}) {
    KnobValue v{"anisotropic " + std::to_string(taps), knobBase()};
    v.setting.draw.sampling = "anisotropic";
    v.setting.draw.anisotropy = taps;
    k.values.push_back(std::move(v));
  }
  for (const char* name : {"trilinear", "bilinear", "nearest"}) {
    KnobValue v{name, knobBase()};
    v.setting.draw.sampling = name;
    k.values.push_back(std::move(v));
  }
  return k;
}

AccuracyKnob filterKnob() {
  AccuracyKnob k{"filter", "texture filter", "", "weights in full precision, or the texture unit's own", {}, true, {}};
  for (const char* name : {"exact", "fast"}) {
    KnobValue v{name, knobBase()};
    v.setting.draw.filter = name;
    k.values.push_back(std::move(v));
  }
  return k;
}

std::vector<AccuracyKnob> streamingKnobs(const Manifest& manifest, bool quick) {
  std::vector<AccuracyKnob> out;
  out.push_back({"feedback-scale",
                 "feedback scale",
                 "px a px",
                 "how many pixels of the picture, along each side, a pixel of the feedback pass stands for",
                 valuesOf<int>(&DrawSettings::feedback_scale,
                               quick ? std::vector<int>{4, 16} : std::vector<int>{1, 2, 4, 8, 16}, ""),
                 false,
                 {}});
  out.push_back({"feedback-interval",
                 "feedback interval",
                 "frames",
                 "frames from one feedback pass to the next",
                 valuesOf<int>(&DrawSettings::feedback_interval,
                               quick ? std::vector<int>{1, 8} : std::vector<int>{1, 2, 4, 8, 16}, ""),
                 false,
                 {}});
  AccuracyKnob prefetch{"prefetch", "prefetch", "", "reading what a moving camera is about to want", {}, false, {}};
  if (!manifest.domain.isFlat()) prefetch.why_not = "only flat artworks are read ahead of a moving camera";
  for (bool on : {true, false}) {
    KnobValue v{on ? "on" : "off", knobBase()};
    v.setting.draw.prefetch = on;
    prefetch.values.push_back(std::move(v));
  }
  out.push_back(std::move(prefetch));
  out.push_back(
      {"cache-mib",
       "page cache",
       "MiB",
       "memory for pages of all planes; what does not fit is drawn with less detail",
       valuesOf<double>(&DrawSettings::cache_mib,
                        quick ? std::vector<double>{256, 24} : std::vector<double>{256, 128, 64, 32, 16, 8}, " MiB"),
       false,
       {}});
  return out;
}

std::vector<AccuracyKnob> packageKnobs(const Manifest& manifest, bool quick) {
  std::vector<AccuracyKnob> out;
  AccuracyKnob encoding{"encoding", "page encoding", "", "how the pages of all texture planes are stored",
                        {},         false,           {}};
  for (const char* name : quick ? std::vector<const char*>{"", "jpeg90", "bc1"}
                                : std::vector<const char*>{"", "jpeg95", "jpeg90", "jpeg80", "bc7", "bc4", "bc1"}) {
    KnobValue v{*name ? name : "as it is", knobBase()};
    v.setting.encoding = name;
    encoding.values.push_back(std::move(v));
  }
  out.push_back(std::move(encoding));
  AccuracyKnob bits{
      "coefficient-bits", "bits of coefficients", "bits", "bits of each coefficient of light", {}, false, {}};
  int coefficient_planes = 0;
  for (int p = 0; p < manifest.texture.planes(); ++p) coefficient_planes += !isColourPlane(manifest.texture, p);
  if (coefficient_planes == 0) bits.why_not = "the artwork has a colour and no coefficients";
  for (int b : quick ? std::vector<int>{8, 5} : std::vector<int>{8, 7, 6, 5, 4}) {
    KnobValue v{std::to_string(b), knobBase()};
    v.setting.coefficient_bits = b;
    bits.values.push_back(std::move(v));
  }
  out.push_back(std::move(bits));
  AccuracyKnob relief{"relief-bits", "bits of relief", "bits", "bits of each height", {}, false, {}};
  for (int b : quick ? std::vector<int>{16, 9} : std::vector<int>{16, 14, 12, 10, 8}) {
    KnobValue v{std::to_string(b), knobBase()};
    v.setting.relief_bits = b;
    relief.values.push_back(std::move(v));
  }
  out.push_back(std::move(relief));
  out.push_back({"basis",
                 "basis of light and number of planes",
                 "",
                 "which functions of the light a texel's coefficients belong to",
                 {},
                 false,
                 "a package holds one basis, here " + std::string(basisName(manifest.texture.basis)) + " in " +
                     std::to_string(manifest.texture.planes()) +
                     (manifest.texture.planes() == 1 ? " plane" : " planes") +
                     "; another one follows from the photographs only"});
  out.push_back({"multisampling",
                 "multisampling",
                 "",
                 "samples of the outline a pixel",
                 {},
                 false,
                 "one sample a pixel is compared; render --samples averages several in settled pictures alone"});
  return out;
}

}  // namespace

AccuracySetting defaultSetting(double cache_mib) {
  const Scene scene;
  const EngineOptions options;
  AccuracySetting s;
  s.draw = {.error_px = scene.error_px,
            .least_cell = scene.least_cell,
            .detail_bias = scene.detail_bias,
            .sampling = "trilinear",
            .filter = "exact",
            .anisotropy = kUsualAnisotropy,
            .feedback_scale = options.feedback_scale,
            .feedback_interval = options.feedback_interval,
            .prefetch = options.prefetch,
            .cache_mib = cache_mib};
  return s;
}

AccuracySetting knobBase(double cache_mib) {
  AccuracySetting s = defaultSetting(cache_mib);
  s.draw.sampling = "anisotropic";
  return s;
}

void giveCache(std::vector<AccuracyKnob>& knobs, double cache_mib, double least_mib) {
  for (AccuracyKnob& knob : knobs) {
    if (knob.name == "cache-mib") {
      std::erase_if(knob.values, [&](const KnobValue& v) { return *v.setting.draw.cache_mib < least_mib; });
      const bool has_base = std::any_of(knob.values.begin(), knob.values.end(),
                                        [&](const KnobValue& v) { return v.setting.draw.cache_mib == cache_mib; });
      if (!has_base) knob.values.insert(knob.values.begin(), {numberText(cache_mib, " MiB"), knobBase(cache_mib)});
      if (knob.values.size() < 2 && knob.why_not.empty())
        knob.why_not = "this artwork needs " + numberText(std::ceil(least_mib), " MiB") + " at least";
      continue;
    }
    for (KnobValue& v : knob.values) v.setting.draw.cache_mib = cache_mib;
  }
}

void applySetting(const AccuracySetting& setting, Scene& scene, EngineOptions& options) {
  const DrawSettings& d = setting.draw;
  scene.error_px = *d.error_px;
  scene.least_cell = *d.least_cell;
  scene.detail_bias = *d.detail_bias;
  scene.sampling = *d.sampling == "nearest"       ? Sampling::kNearest
                   : *d.sampling == "bilinear"    ? Sampling::kBilinear
                   : *d.sampling == "anisotropic" ? Sampling::kAnisotropic
                                                  : Sampling::kTrilinear;
  scene.anisotropy = *d.anisotropy;
  scene.filter = *d.filter == "fast" ? Filter::kFast : Filter::kExact;
  options.feedback_scale = *d.feedback_scale;
  options.feedback_interval = *d.feedback_interval;
  options.prefetch = *d.prefetch;
  options.cache_mib = *d.cache_mib;
}

std::string settingText(const AccuracySetting& s) {
  const DrawSettings& d = s.draw;
  std::string out = "error " + numberText(*d.error_px, " px") + ", least cell " + numberText(*d.least_cell) +
                    ", detail bias " + numberText(*d.detail_bias) + ", " + *d.sampling;
  if (*d.sampling == "anisotropic") out += " " + std::to_string(*d.anisotropy);
  out += ", filter " + *d.filter;
  const DrawSettings usual = defaultSetting().draw;
  if (d.feedback_scale != usual.feedback_scale) out += ", feedback scale " + std::to_string(*d.feedback_scale);
  if (d.feedback_interval != usual.feedback_interval)
    out += ", feedback every " + std::to_string(*d.feedback_interval) + " frames";
  if (d.prefetch != usual.prefetch) out += *d.prefetch ? ", prefetch" : ", no prefetch";
  if (d.cache_mib != usual.cache_mib) out += ", cache " + numberText(*d.cache_mib, " MiB");
  if (!s.encoding.empty()) out += ", pages " + s.encoding;
  if (s.coefficient_bits < 8) out += ", coefficients of " + std::to_string(s.coefficient_bits) + " bits";
  if (s.relief_bits < 16) out += ", relief of " + std::to_string(s.relief_bits) + " bits";
  return out;
}

std::vector<AccuracyKnob> accuracyKnobs(const Manifest& manifest, bool quick) {
  std::vector<AccuracyKnob> out{errorKnob(quick), leastCellKnob(quick), detailBiasKnob(quick), samplingKnob(quick),
                                filterKnob()};
  for (AccuracyKnob& k : streamingKnobs(manifest, quick)) out.push_back(std::move(k));
  for (AccuracyKnob& k : packageKnobs(manifest, quick)) out.push_back(std::move(k));
  return out;
}

}  // namespace relievo
