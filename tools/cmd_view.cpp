// relievo view: a package in a window.
#include <array>
#include <filesystem>
#include <memory>

#include <CLI/CLI.hpp>

#include "src/viewer.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/scene_options.h"
#include "tools/source_options.h"

namespace relievo {
namespace {

struct ViewOptions {
  std::string file, size = "1280x800";
  SceneOptions scene;
  SourceOptions source;
  ViewerOptions viewer;
};

Result<void> view(ViewOptions& o) {
  auto size = parseSize(o.size);
  if (!size) return size.error();
  if (size->first > 16384 || size->second > 16384) return usageError("expected a --size of at most 16384x16384 px, found " + o.size);
  auto scene = o.scene.scene();
  if (!scene) return scene.error();
  if (auto good = checkOutputs({{"--snapshot", o.viewer.snapshot_file}}, {{"FILE", o.file}, {"--state", o.scene.state_file}}); !good) return good;
  auto package = Package::open(o.file);
  if (!package) return package.error();
  const std::filesystem::path path(o.file);
  o.viewer.title = path.filename().string() + " - Relievo";
  o.viewer.snapshot_stem = path.stem().string();
  o.viewer.width_px = static_cast<int>(size->first);
  o.viewer.height_px = static_cast<int>(size->second);
  o.viewer.scene = *scene;
  o.viewer.engine = o.scene.engineOptions();
  o.viewer.camera = [&](const Extent& extent, int width_px, int height_px) {
    return o.scene.camera(extent, width_px, height_px);
  };
  return runViewer(o.source.artwork(*package), o.viewer);
}

}  // namespace

void addViewCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<ViewOptions>();
  auto* c = app.add_subcommand("view", "Show a package in a window");
  c->footer(
      "Left drag turns, middle drag (or Shift + left drag) moves, the wheel zooms to the point under the mouse, right drag\n"
      "(or L held) moves the light. O goes over to an orthographic view and back. R resets, W wireframe, P pages, S writes a\n"
      "snapshot into the current folder, F1 help, F2 figures, Esc quits. Without a display, use relievo render.\n\n"
      "Example:\n  relievo view inscription.relievo --light -0.8,0.3,0.4");
  c->add_option("FILE", o->file, "Package to show")->required();
  c->add_option("--size", o->size, "Window, WIDTHxHEIGHT in px")->capture_default_str();
  o->scene.geomorph = "on";
  o->scene.hysteresis_percent = 10;
  o->scene.addTo(*c);
  o->source.addTo(*c);
  c->add_flag("--print-view", o->viewer.print_view, "On leaving, print camera and light as JSON, for --state");
  // For tests.
  c->add_option("--frames", o->viewer.frames, "")->group("");
  c->add_option("--snapshot", o->viewer.snapshot_file, "")->group("");
  c->callback([o, &context] {
    if (auto done = view(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
