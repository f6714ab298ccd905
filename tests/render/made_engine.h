// made_engine.h - an engine for a test: what keeps it from being made is the test's failure.
#pragma once

#include <gtest/gtest.h>

#include <memory>

#include "src/engine/engine.h"

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

}  // namespace relievo::test
