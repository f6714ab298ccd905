// window.h - a GLFW window with a current context (EGL), its input as plain events.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "src/gl/context.h"

namespace relievo::gl {

enum class EventKind { kMouseMove, kMouseDown, kMouseUp, kScroll, kKeyDown, kKeyUp, kResize, kClose };
enum class MouseButton { kLeft, kRight, kMiddle };

struct Event {
  EventKind kind;
  double x = 0, y = 0;  // mouse position in framebuffer pixels, origin top left; scroll steps; new size
  MouseButton button = MouseButton::kLeft;
  std::string key;  // "A".."Z", "F1", "Escape", "Left", ...
  bool shift = false, control = false;
};

class Window {
 public:
  // Without a display: kRuntime, with a message that names `relievo render`.
  static Result<std::unique_ptr<Window>> create(const std::string& title, int width, int height, Api api = Api::kGl33);
  ~Window();
  int width() const;  // framebuffer pixels
  int height() const;
  bool keyIsDown(const std::string& key) const;
  void setTitle(const std::string& title);
  std::vector<Event> pollEvents();
  std::vector<Event> waitEvents(double timeout_s);  // sleeps until there is one, or the time is over
  double contentScale() const;                      // of text and lines: 1, or 2 on a HiDPI display
  void swap();                                      // presents; waits for vertical sync where there is one
  void* nativeHandle() const;                       // GLFWwindow*, for the HUD's back end

 private:
  Window();
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo::gl
