// must_read.h - a mesh's file read by a test that expects it to be sound.
#pragma once

#include <gtest/gtest.h>

#include <string>
#include <utility>

#include "geometry/scan/mesh_read.h"

namespace relievo::test {

inline LoadedMesh mustRead(const std::string& path, const MeshReadOptions& options = {}) {
  auto read = readMesh(path, options);
  EXPECT_TRUE(read.ok()) << read.error().text();
  if (!read) return {};
  EXPECT_EQ(triMeshProblem(read->mesh), "");
  return std::move(*read);
}

}  // namespace relievo::test
