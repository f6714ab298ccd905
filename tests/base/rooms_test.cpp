// Which folder may include which (README.md of each): a later one the earlier ones, never the other way round, and
// geometry and texturing never each other. A circle between files, too, would show here as one between folders.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

namespace rooms_test {

namespace fs = std::filesystem;

// Earlier ones may be included by later ones.
constexpr std::array<std::string_view, 28> kOrder{"src/base",
                                                  "src/artwork",
                                                  "src/artwork/bases",
                                                  "geometry/mesh",
                                                  "geometry/scan",
                                                  "geometry/remesh",
                                                  "geometry/bake",
                                                  "geometry/lod",
                                                  "geometry/strategies",
                                                  "texturing/codec",
                                                  "texturing/package",
                                                  "texturing/import",
                                                  "texturing/stream",
                                                  "shaders",
                                                  "src/gl",
                                                  "src/render",
                                                  "src/engine/effects",
                                                  "src/engine",
                                                  "src/viewer",
                                                  "tools/report",
                                                  "tools/sample",
                                                  "tools/export",
                                                  "tools/bench",
                                                  "tools/scene",
                                                  "tools/compare",
                                                  "tools/accuracy",
                                                  "tools/stability",
                                                  "tools"};
// Pairs whose order above means nothing: neither includes the other.
constexpr std::array<std::array<std::string_view, 2>, 4> kStrangers{{{"geometry/", "texturing/"},
                                                                     {"texturing/import", "texturing/stream"},
                                                                     {"geometry/bake", "geometry/lod"},
                                                                     {"geometry/scan", "geometry/lod"}}};

std::string roomOf(const std::string& path) { return path.substr(0, path.rfind('/')); }

// Empty: it may. from, to: files, from the project's root.
std::string whyNot(const std::string& from, const std::string& to) {
  const std::string a = roomOf(from), b = roomOf(to);
  if (a == b) return {};
  // shaders/*.h are compiled by C++ and GLSL alike: anybody may include them.
  if (b == "shaders") return {};
  const auto place_a = std::find(kOrder.begin(), kOrder.end(), a), place_b = std::find(kOrder.begin(), kOrder.end(), b);
  if (place_a == kOrder.end()) return a + " has no place in the order of folders";
  if (place_b == kOrder.end()) return b + " has no place in the order of folders";
  if (place_b > place_a) return a + " comes before " + b;
  for (const auto& [x, y] : kStrangers)
    if ((a.starts_with(x) && b.starts_with(y)) || (a.starts_with(y) && b.starts_with(x)))
      return a + " and " + b + " are independent";
  return {};
}

std::vector<std::string> wrongIncludes(const fs::path& root, size_t& includes) {
  std::vector<std::string> wrong;
  for (const char* folder : {"src", "geometry", "texturing", "tools"})
    for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".h" && extension != ".cpp") continue;
      const std::string from = fs::relative(entry.path(), root).generic_string();
      std::ifstream file(entry.path());
      constexpr std::string_view kInclude = "#include \"";
      for (std::string line; std::getline(file, line);) {
        if (!line.starts_with(kInclude)) continue;
        const std::string to = line.substr(kInclude.size(), line.find('"', kInclude.size()) - kInclude.size());
        ++includes;
        if (!fs::is_regular_file(root / to))
          wrong.push_back(from + " includes " + to + ", which is not named from the project's root");
        else if (const std::string why = whyNot(from, to); !why.empty())
          wrong.push_back(from + " includes " + to + ": " + why);
      }
    }
  return wrong;
}

TEST(Rooms, IncludeOnlyWhatComesBeforeThem) {
  size_t includes = 0;
  const auto wrong = wrongIncludes(RELIEVO_SOURCE_DIR, includes);
  std::ostringstream all;
  for (const std::string& w : wrong) all << w << "\n";
  EXPECT_TRUE(wrong.empty()) << all.str();
  EXPECT_GT(includes, 800u) << "the files were not found";
}

// The files below a root that include a library, by the beginning of its headers' names.
std::vector<std::string> includersOf(const fs::path& root, std::string_view library) {
  std::vector<std::string> found;
  for (const char* folder : {"src", "geometry", "texturing", "tools"})
    for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
      std::ifstream file(entry.path());
      for (std::string line; std::getline(file, line);)
        if (line.starts_with("#include <" + std::string(library))) {
          found.push_back(fs::relative(entry.path(), root).generic_string());
          break;
        }
    }
  return found;
}

TEST(Rooms, LibrariesStayBehindTheirFile) {
  EXPECT_EQ(includersOf(RELIEVO_SOURCE_DIR, "OpenMesh/"), std::vector<std::string>{"geometry/remesh/coarse_mesh.h"});
  EXPECT_EQ(includersOf(RELIEVO_SOURCE_DIR, "imgui"), std::vector<std::string>{"src/viewer/hud.cpp"});
  // Control: one that is used in many places is found in many.
  EXPECT_GT(includersOf(RELIEVO_SOURCE_DIR, "glm/").size(), 20u);
}

// The functions below a root that are dispatched by the machine's instructions and may throw
// (src/base/simd_dispatch.h).
std::vector<std::string> dispatchedThatMayThrow(const fs::path& root, size_t& dispatched) {
  std::vector<std::string> found;
  for (const char* folder : {"src", "geometry", "texturing", "tools"})
    for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
      std::ifstream file(entry.path());
      std::ostringstream content;
      content << file.rdbuf();
      const std::string text = content.str();
      constexpr std::string_view kMark = "RELIEVO_SIMD_CLONES ";
      for (size_t at = text.find(kMark); at != std::string::npos; at = text.find(kMark, at + 1)) {
        if (text.substr(0, at).ends_with("#define ")) continue;
        const std::string head = text.substr(at, text.find('{', at) - at);
        ++dispatched;
        if (head.find(" noexcept") == std::string::npos)
          found.push_back(fs::relative(entry.path(), root).generic_string() + ": " + head);
      }
    }
  return found;
}

TEST(Rooms, DispatchedFunctionsDoNotThrow) {
  size_t dispatched = 0;
  EXPECT_EQ(dispatchedThatMayThrow(RELIEVO_SOURCE_DIR, dispatched), std::vector<std::string>{});
  EXPECT_GT(dispatched, 15u) << "the functions were not found";

  const fs::path root = fs::path(testing::TempDir()) / "dispatched";
  for (const char* folder : {"src", "geometry", "texturing", "tools"}) fs::create_directories(root / folder);
  std::ofstream(root / "src/a.cpp") << "RELIEVO_SIMD_CLONES void a(int x) {\n}\nvoid b() noexcept {}\n";
  EXPECT_EQ(dispatchedThatMayThrow(root, dispatched).size(), 1u);
  fs::remove_all(root);
}

// Lines below a root that declare a JSON value that is null, to which members are added. Where the library finds no
// memory for the object that it makes of it then, its destructor crashes: such values begin as object() or array().
std::vector<std::string> jsonFromNull(const fs::path& root) {
  static const std::regex kDeclared(R"(^\s+(nlohmann::(ordered_)?json|Json) \w+(, \w+)*;$)");
  std::vector<std::string> found;
  for (const char* folder : {"src", "geometry", "texturing", "tools"})
    for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
      if (entry.path().extension() != ".cpp") continue;
      std::ifstream file(entry.path());
      for (std::string line; std::getline(file, line);)
        if (std::regex_match(line, kDeclared))
          found.push_back(fs::relative(entry.path(), root).generic_string() + ":" + line);
    }
  return found;
}

TEST(Rooms, JsonObjectsBeginAsObjects) {
  EXPECT_EQ(jsonFromNull(RELIEVO_SOURCE_DIR), std::vector<std::string>{});

  const fs::path root = fs::path(testing::TempDir()) / "null-json";
  for (const char* folder : {"src", "geometry", "texturing", "tools"}) fs::create_directories(root / folder);
  std::ofstream(root / "src/a.cpp") << "  nlohmann::ordered_json json;\n  Json a, b;\n"
                                       "  auto x = nlohmann::ordered_json::object();\n";
  EXPECT_EQ(jsonFromNull(root).size(), 2u);
  fs::remove_all(root);
}

// Lines of tests that ask for exit code 4 themselves: it stands for more than a missing GL, and a test that skips then
// would skip on a fault. noGl() tells them apart.
std::vector<std::string> ownAskersForGl(const fs::path& tests) {
  static const std::regex kAsked(R"(.*exit_code\s*[!=]=\s*4\b.*)");
  std::vector<std::string> found;
  for (const auto& entry : fs::recursive_directory_iterator(tests)) {
    const std::string extension = entry.path().extension().string(), name = entry.path().filename().string();
    if ((extension != ".h" && extension != ".cpp") || name == "cli_fixture.h") continue;
    std::ifstream file(entry.path());
    for (std::string line; std::getline(file, line);)
      if (std::regex_match(line, kAsked)) found.push_back(name + ":" + line);
  }
  return found;
}

TEST(Rooms, TestsAskNoGlForAMissingContext) {
  EXPECT_EQ(ownAskersForGl(fs::path(RELIEVO_SOURCE_DIR) / "tests"), std::vector<std::string>{});

  const fs::path root = fs::path(testing::TempDir()) / "askers";
  fs::create_directories(root / "tools");
  std::ofstream(root / "tools/a.cpp") << "  if (r.exit_code "
                                      << "== 4) GTEST_SKIP();\n  EXPECT_EQ(r.exit_code, 4);\n"
                                      << "  return r.exit_code "
                                      << "!= 4;\n  if (r.exit_code == 42) x();\n";
  EXPECT_EQ(ownAskersForGl(root).size(), 2u);
  fs::remove_all(root);
}

// Types of one name in several headers below a root, those of other namespaces than the project's own left out: the
// linker takes one type's functions for the other's.
std::vector<std::string> typesOfOneName(const fs::path& root, size_t& types) {
  static const std::regex kDefined(R"(^(struct|class|enum class) (\w+)( final)?( : [^;]*| \{.*)$)");
  std::map<std::string, std::string> first;
  std::vector<std::string> found;
  for (const char* folder : {"src", "geometry", "texturing", "tools"})
    for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
      if (entry.path().extension() != ".h") continue;
      std::ifstream file(entry.path());
      bool own = false;
      const std::string name = fs::relative(entry.path(), root).generic_string();
      for (std::string line; std::getline(file, line);) {
        if (line.starts_with("namespace ")) own = line == "namespace relievo {";
        std::smatch match;
        if (!own || !std::regex_match(line, match, kDefined)) continue;
        ++types;
        const auto [at, added] = first.emplace(match[2], name);
        if (!added && at->second != name) found.push_back(match[2].str() + " in " + at->second + " and " + name);
      }
    }
  return found;
}

TEST(Rooms, NoTwoTypesHaveOneName) {
  size_t types = 0;
  EXPECT_EQ(typesOfOneName(RELIEVO_SOURCE_DIR, types), std::vector<std::string>{});
  EXPECT_GT(types, 200u) << "the types were not found";

  const fs::path root = fs::path(testing::TempDir()) / "types";
  for (const char* folder : {"src", "geometry", "texturing", "tools"}) fs::create_directories(root / folder);
  std::ofstream(root / "src/a.h") << "namespace relievo {\nstruct Grid {\n};\nstruct Other;\n}\n";
  std::ofstream(root / "tools/b.h")
      << "namespace relievo {\nclass Grid final : public Base {\n};\nstruct Other {\n};\n}\n";
  std::ofstream(root / "tools/c.h") << "namespace relievo::sample {\nstruct Grid {\n};\n}\n";
  EXPECT_EQ(typesOfOneName(root, types), std::vector<std::string>{"Grid in src/a.h and tools/b.h"});
  fs::remove_all(root);
}

TEST(Rooms, TheCheckSeesAnIncludeAgainstTheOrder) {
  EXPECT_NE(whyNot("src/base/file.h", "src/artwork/node_id.h"), "");
  EXPECT_NE(whyNot("texturing/stream/page_table.h", "geometry/lod/snap.h"), "");
  EXPECT_NE(whyNot("geometry/lod/snap.h", "texturing/codec/mip.h"), "");
  EXPECT_NE(whyNot("src/render/page_pool.h", "src/engine/engine.h"), "");
  EXPECT_NE(whyNot("src/viewer/hud.h", "tools/bench/bench.h"), "");
  EXPECT_NE(whyNot("src/new/a.h", "src/base/file.h"), "");
  EXPECT_EQ(whyNot("src/engine/engine.h", "src/render/page_pool.h"), "");
  EXPECT_EQ(whyNot("tools/cmd_bench.cpp", "tools/bench/bench.h"), "");

  const fs::path root = fs::path(testing::TempDir()) / "rooms";
  fs::remove_all(root);
  for (const char* folder : {"src/base", "src/engine", "geometry", "texturing", "tools"})
    fs::create_directories(root / folder);
  std::ofstream(root / "src/engine/engine.h") << "#include \"src/base/file.h\"\n";
  std::ofstream(root / "src/base/file.h") << "#include \"src/engine/engine.h\"\n#include \"file.h\"\n";
  size_t includes = 0;
  EXPECT_EQ(wrongIncludes(root, includes).size(), 2u);
  EXPECT_EQ(includes, 3u);
  fs::remove_all(root);
}

}  // namespace rooms_test
