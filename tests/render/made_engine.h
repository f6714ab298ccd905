// made_engine.h - an engine for a test, its settled pictures, and the shader that it shades with: what keeps either
// from being made is the test's failure.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "src/engine/engine.h"
#include "src/gl/context.h"
#include "src/gl/program.h"

namespace relievo::test {

// Null where there is none.
inline std::unique_ptr<Engine> makeEngine(const Artwork& artwork, const Scene& scene, const EngineOptions& options,
                                          int width_px, int height_px) {
  auto engine = Engine::create(artwork, scene, options);
  EXPECT_TRUE(engine.ok()) << (engine.ok() ? "" : engine.error().text());
  if (!engine.ok()) return nullptr;
  (*engine)->resize(width_px, height_px);
  return std::move(*engine);
}

// The settled picture of the scene, from where the camera is.
inline std::vector<uint8_t> pictureOf(Engine& engine, const Scene& scene) {
  auto set = engine.setScene(scene);
  EXPECT_TRUE(set.ok()) << (set.ok() ? "" : set.error().text());
  auto settled = engine.settle(60);
  EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
  return engine.readPixels();
}

// All of the shader that shades this scene, as it is compiled; empty where there is none.
inline std::string shadingSource(const Scene& scene, const Manifest& manifest) {
  const auto text =
      gl::assembleShader(gl::currentContextInfo().api, "shade.frag", planEffects(scene, manifest).defines(), true);
  EXPECT_TRUE(text.ok());
  return text.ok() ? *text : std::string();
}

}  // namespace relievo::test
