#include <algorithm>
#include <array>
#include <numbers>
#include <random>
#include <vector>

#include "src/artwork/basis.h"
#include "src/base/srgb.h"
#include "src/engine/effects/lights.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/resolve.h"
#include "tools/stability/stability.h"

namespace relievo {
namespace {

// (u, v) on the unit circle and beyond it, where a mouse drags the light out of the disc.
StabilityErrors lightAtTheHorizon() {
  StabilityErrors out;
  for (const double radius : {1 - 1e-16, 1.0, 1 + 1e-15, 1.001, 2.0})
    for (int k = 0; k < 64; ++k) {
      const double angle = 2 * std::numbers::pi * k / 64, u = radius * std::cos(angle), v = radius * std::sin(angle);
      const auto light = frontLight(u, v);
      out.add(std::hypot(light[0], light[1], light[2]) - 1, std::hypot(u, v, std::sqrt(1 - u * u - v * v)) - 1);
    }
  return out;
}

TextureFormat ptmOf(double scale, double bias) {
  TextureFormat format;
  format.basis = Basis::kPtmRgb;
  for (int k = 0; k < format.coefficients(); ++k) {
    format.scale[static_cast<size_t>(k)] = scale;
    format.bias[static_cast<size_t>(k)] = bias;
  }
  return format;
}

// A saddle, a (u^2 - v^2): a PTM's first two coefficients of opposite signs, at the ends of their bytes.
StabilityErrors saddleUnderEveryLight() {
  const TextureFormat format = ptmOf(4, 128);
  StabilityErrors out;
  for (int k = 0; k < 360; ++k) {
    const double angle = std::numbers::pi * k / 180;
    std::array<double, 18> raw;
    for (size_t c = 0; c < raw.size(); ++c) raw[c] = c < 3 ? 255 : c < 6 ? 0 : 128;
    const std::array<double, 3> light = frontLight(std::cos(angle), std::sin(angle));
    const double truth = std::clamp(4 * (127 * light[0] * light[0] - 128 * light[1] * light[1]), 0.0, 255.0);
    const double unclamped = 4 * (127 * light[0] * light[0] - 128 * light[1] * light[1]);
    const auto wrapped = static_cast<uint8_t>(static_cast<int>(unclamped));
    out.add(evaluatePixel(format, raw.data(), light)[0] - truth, wrapped - truth);
  }
  return out;
}

// Bytes at their ends, scales as wide and as narrow as files have them: single precision beside double.
StabilityErrors coefficientsAtTheirEnds() {
  StabilityErrors out;
  std::mt19937 random(1);
  for (const double scale : {1.0 / 256, 1.0, 16.0}) {
    const TextureFormat format = ptmOf(scale, 127);
    const auto planes = static_cast<size_t>(format.planes());
    std::vector<std::vector<uint8_t>> slots(planes, std::vector<uint8_t>(kSlotBytes));
    for (auto& slot : slots)
      for (uint8_t& b : slot) b = std::array<uint8_t, 4>{0, 255, 127, static_cast<uint8_t>(random())}[random() % 4];
    std::vector<const uint8_t*> pointers;
    for (const auto& slot : slots) pointers.push_back(slot.data());
    std::vector<uint8_t> resolved(kSlotBytes);
    for (const double u : {0.0, 0.6, -0.999}) {
      const auto light = frontLight(u, 0.04);
      resolvePage(format, light, pointers, resolved.data());
      for (size_t texel = 0; texel < 4096; ++texel) {
        std::array<double, 18> raw;
        for (size_t c = 0; c < raw.size(); ++c) raw[c] = slots[c / 3][4 * texel + c % 3];
        const double truth = evaluatePixel(format, raw.data(), light)[0];
        // The integer arithmetic of early viewers: light and its products in eight bits, coefficients cut to whole
        // ones.
        const int lu = static_cast<int>(light[0] * 256), lv = static_cast<int>(light[1] * 256);
        const std::array<int, 6> products{lu * lu >> 8, lv * lv >> 8, lu * lv >> 8, lu, lv, 256};
        int sum = 0;
        for (size_t k = 0; k < 6; ++k) sum += static_cast<int>((raw[3 * k] - 127) * scale) * products[k] >> 8;
        out.add(resolved[4 * texel] - truth, std::clamp(sum, 0, 255) - truth);
      }
    }
  }
  return out;
}

// Opposite normals that a filter averages to nothing: what is left is the ambient share.
StabilityErrors normalsThatCancel() {
  TextureFormat format;
  format.basis = Basis::kAlbedoNormal;
  StabilityErrors out;
  for (const double albedo : {1.0, 128.0, 255.0})
    for (const auto& light : {std::array<double, 3>{0, 0, 1}, {1, 0, 0}, {0, 0, -1}}) {
      const std::array<double, 6> raw{albedo, albedo, albedo, 127.5, 127.5, 127.5};
      const double truth = albedo * std::pow(0.04, 1 / 2.2);
      const std::array<double, 3> n{raw[3] / 127.5 - 1, raw[4] / 127.5 - 1, raw[5] / 127.5 - 1};
      const double length = std::hypot(n[0], n[1], n[2]);
      const double cosine = (n[0] * light[0] + n[1] * light[1] + n[2] * light[2]) / length;
      out.add(evaluatePixel(format, raw.data(), light)[0] - truth,
              albedo * std::pow(0.04 + 0.96 * (cosine < 0 ? 0 : cosine), 1 / 2.2) - truth);
    }
  return out;
}

// Lights of 10^-3 to 10^3 times the usual intensity, on a PTM that is as bright under each of them.
StabilityErrors lightsOfAllIntensities() {
  const TextureFormat format = ptmOf(1, 0);
  std::array<double, 18> raw{};
  StabilityErrors out;
  std::array<double, 4> intensities{1e-3, 0.1, 10, 1e3};
  for (double level : {0.5, 20.0, 128.0, 255.0}) {
    for (size_t c = 15; c < 18; ++c) raw[c] = level;  // the coefficient without a direction
    std::sort(intensities.begin(), intensities.end());
    do {
      std::vector<PlacedLight> lights;
      long double sum = 0;
      double encoded = 0;
      for (const double intensity : intensities) {
        lights.push_back({.place = {0, 0, 1}, .color = glm::dvec3(intensity)});
        sum += intensity;
        encoded += srgbFromLinear(intensity * linearFromSrgb(level / 255));
      }
      const double truth = srgbFromLinear(static_cast<double>(sum) * linearFromSrgb(level / 255));
      out.add(255 * (litColour(format, raw.data(), lights, {})[0] - truth), 255 * (encoded - truth));
    } while (std::next_permutation(intensities.begin(), intensities.end()));
  }
  return out;
}

// From a kilometre away until it lies on the surface, which is then as near as a thousandth of its reference distance.
StabilityErrors nearLightOnTheSurface() {
  const TextureFormat format = ptmOf(1, 0);
  std::array<double, 18> raw{};
  for (size_t c = 15; c < 18; ++c) raw[c] = 100;
  constexpr double kReference = 500;
  StabilityErrors out;
  for (const double distance : {1e6, 500.0, 1.0, 0.5, 1e-3, 1e-160, 0.0}) {
    const PlacedLight light{
        .near = true, .place = {0, 0, distance}, .color = glm::dvec3(1), .reference_mm = kReference};
    const double nearest = std::max(distance, kReference / 1000);
    const double truth = srgbFromLinear(kReference / nearest * (kReference / nearest) * linearFromSrgb(100 / 255.0));
    const double naive = srgbFromLinear(kReference * kReference / (distance * distance) * linearFromSrgb(100 / 255.0));
    out.add(litColour(format, raw.data(), {&light, 1}, {})[0] / truth - 1, naive / truth - 1);
  }
  return out;
}

constexpr StabilityCase kLightCases[] = {
    {"a light on the horizon and dragged below it", "the direction has length 1", "z = sqrt(1 - u^2 - v^2)", "", 1e-12,
     lightAtTheHorizon},
    {"a saddle PTM with its coefficients at their ends", "clamped to 0..255", "the sum taken as a byte", "of 255", 1e-9,
     saddleUnderEveryLight},
    {"coefficients at the ends of their bytes, scales 1/256 to 16", "the sum in double precision, rounded",
     "integers with eight bits of the light", "of 255", 0.51, coefficientsAtTheirEnds},
    {"normals that cancel when they are averaged", "the ambient share of the albedo", "normals made unit length",
     "of 255", 1e-9, normalsThatCancel},
    {"four lights of 10^-3 to 10^3, in every order", "their sum in linear light",
     "their colours added as they are shown", "of 255", 1e-9, lightsOfAllIntensities},
    {"a light from 1 km away to on the surface", "the square of the distance, no less than a thousandth",
     "the square of the distance", "of it", 1e-12, nearLightOnTheSurface},
};

}  // namespace

std::span<const StabilityCase> lightStability() { return kLightCases; }

}  // namespace relievo
