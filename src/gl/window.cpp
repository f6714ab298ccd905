#include "src/gl/window.h"

#include <cctype>
#include <cstdlib>
#include <set>
#include <utility>

#include <epoxy/gl.h>
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

namespace relievo::gl {
namespace {

constexpr const char* kNoWindowHint =
    "without a display, `relievo render FILE -o PICTURE.png` makes a picture of the same view; "
    "over ssh, try ssh -X, or start the viewer with xvfb-run";

std::string g_glfw_error;  // GLFW is used on the main thread only

bool isSet(const char* name) {
  const char* value = std::getenv(name);
  return value && *value;
}

std::string keyName(int key, int scancode) {
  // Letters by what is printed on the key, so that a French W is where the user sees it.
  if (const char* printed = glfwGetKeyName(key, scancode))
    if (std::isalpha(static_cast<unsigned char>(printed[0])) && printed[1] == '\0')
      return std::string(1, static_cast<char>(std::toupper(static_cast<unsigned char>(printed[0]))));
  if (key >= GLFW_KEY_A && key <= GLFW_KEY_Z) return std::string(1, static_cast<char>('A' + key - GLFW_KEY_A));
  if (key >= GLFW_KEY_0 && key <= GLFW_KEY_9) return std::string(1, static_cast<char>('0' + key - GLFW_KEY_0));
  if (key >= GLFW_KEY_F1 && key <= GLFW_KEY_F25) return "F" + std::to_string(key - GLFW_KEY_F1 + 1);
  switch (key) {
    case GLFW_KEY_ESCAPE:
      return "Escape";
    case GLFW_KEY_SPACE:
      return "Space";
    case GLFW_KEY_ENTER:
    case GLFW_KEY_KP_ENTER:
      return "Enter";
    case GLFW_KEY_TAB:
      return "Tab";
    case GLFW_KEY_BACKSPACE:
      return "Backspace";
    case GLFW_KEY_DELETE:
      return "Delete";
    case GLFW_KEY_LEFT:
      return "Left";
    case GLFW_KEY_RIGHT:
      return "Right";
    case GLFW_KEY_UP:
      return "Up";
    case GLFW_KEY_DOWN:
      return "Down";
    case GLFW_KEY_HOME:
      return "Home";
    case GLFW_KEY_END:
      return "End";
    case GLFW_KEY_PAGE_UP:
      return "PageUp";
    case GLFW_KEY_PAGE_DOWN:
      return "PageDown";
    case GLFW_KEY_EQUAL:
    case GLFW_KEY_KP_ADD:
      return "Plus";
    case GLFW_KEY_MINUS:
    case GLFW_KEY_KP_SUBTRACT:
      return "Minus";
    case GLFW_KEY_LEFT_SHIFT:
    case GLFW_KEY_RIGHT_SHIFT:
      return "Shift";
    case GLFW_KEY_LEFT_CONTROL:
    case GLFW_KEY_RIGHT_CONTROL:
      return "Control";
    default:
      return {};
  }
}

}  // namespace

struct Window::Impl {
  GLFWwindow* window = nullptr;
  bool initialised = false;
  int width = 0, height = 0;        // framebuffer pixels
  double mouse_x = 0, mouse_y = 0;  // screen coordinates, of the last move
  std::set<std::string> keys_down;
  std::vector<Event> events;

  static Impl& of(GLFWwindow* window) { return *static_cast<Impl*>(glfwGetWindowUserPointer(window)); }

  Event at(EventKind kind, double x, double y, int mods) const {
    Event e{.kind = kind, .x = x, .y = y};
    e.shift = (mods & GLFW_MOD_SHIFT) != 0;
    e.control = (mods & GLFW_MOD_CONTROL) != 0;
    return e;
  }
  // GLFW's screen coordinates are not pixels on a HiDPI display.
  Event atMouse(EventKind kind, double x, double y, int mods) const {
    int window_width = 1, window_height = 1;
    glfwGetWindowSize(window, &window_width, &window_height);
    const double scale_x = window_width > 0 ? double(width) / window_width : 1.0;
    const double scale_y = window_height > 0 ? double(height) / window_height : 1.0;
    return at(kind, x * scale_x, y * scale_y, mods);
  }
  int heldMods() const {
    return (keys_down.contains("Shift") ? GLFW_MOD_SHIFT : 0) | (keys_down.contains("Control") ? GLFW_MOD_CONTROL : 0);
  }

  void installCallbacks() {
    glfwSetWindowUserPointer(window, this);
    glfwSetFramebufferSizeCallback(window, [](GLFWwindow* w, int width_px, int height_px) {
      Impl& self = of(w);
      self.width = width_px;
      self.height = height_px;
      self.events.push_back(self.at(EventKind::kResize, width_px, height_px, 0));
    });
    // Uncovered, or otherwise in need of a new picture.
    glfwSetWindowRefreshCallback(window, [](GLFWwindow* w) {
      Impl& self = of(w);
      self.events.push_back(self.at(EventKind::kResize, self.width, self.height, 0));
    });
    glfwSetWindowCloseCallback(window,
                               [](GLFWwindow* w) { of(w).events.push_back(of(w).at(EventKind::kClose, 0, 0, 0)); });
    glfwSetCursorPosCallback(window, [](GLFWwindow* w, double x, double y) {
      Impl& self = of(w);
      self.mouse_x = x;
      self.mouse_y = y;
      self.events.push_back(self.atMouse(EventKind::kMouseMove, x, y, self.heldMods()));
    });
    glfwSetMouseButtonCallback(window, [](GLFWwindow* w, int button, int action, int mods) {
      if (button > GLFW_MOUSE_BUTTON_MIDDLE) return;
      Impl& self = of(w);
      // Not glfwGetCursorPos: that is where the mouse is now, not where it was when the button went down a slow frame
      // ago.
      Event e = self.atMouse(action == GLFW_PRESS ? EventKind::kMouseDown : EventKind::kMouseUp, self.mouse_x,
                             self.mouse_y, mods);
      e.button = button == GLFW_MOUSE_BUTTON_LEFT    ? MouseButton::kLeft
                 : button == GLFW_MOUSE_BUTTON_RIGHT ? MouseButton::kRight
                                                     : MouseButton::kMiddle;
      self.events.push_back(e);
    });
    glfwSetScrollCallback(window, [](GLFWwindow* w, double dx, double dy) {
      Impl& self = of(w);
      self.events.push_back(self.at(EventKind::kScroll, dx, dy, self.heldMods()));
    });
    glfwSetKeyCallback(window, [](GLFWwindow* w, int key, int scancode, int action, int mods) {
      Impl& self = of(w);
      const std::string name = keyName(key, scancode);
      if (name.empty() || action == GLFW_REPEAT) return;  // a toggle must not flicker while its key is held
      if (action == GLFW_PRESS) self.keys_down.insert(name);
      else self.keys_down.erase(name);
      Event e = self.at(action == GLFW_PRESS ? EventKind::kKeyDown : EventKind::kKeyUp, 0, 0, mods);
      e.key = name;
      self.events.push_back(e);
    });
    // Without the focus no key-up arrives.
    glfwSetWindowFocusCallback(window, [](GLFWwindow* w, int focused) {
      if (!focused) of(w).keys_down.clear();
    });
  }

  ~Impl() {
    if (window) glfwDestroyWindow(window);
    if (initialised) glfwTerminate();
  }
};

Window::Window() : impl_(std::make_unique<Impl>()) {}
Window::~Window() = default;

Result<std::unique_ptr<Window>> Window::create(const std::string& title, int width, int height, Api api) {
  Result<std::vector<Api>> apis = apisToTry(api);
  if (!apis) return apis.error();
#ifdef __linux__
  if (!isSet("DISPLAY") && !isSet("WAYLAND_DISPLAY"))
    return Error{.kind = ErrorKind::kRuntime,
                 .message = "no window can be opened: neither DISPLAY nor WAYLAND_DISPLAY is set",
                 .hint = kNoWindowHint};
#endif
  glfwSetErrorCallback([](int, const char* text) { g_glfw_error = text; });
  std::unique_ptr<Window> self(new Window());
  if (!glfwInit())
    return Error{
        .kind = ErrorKind::kRuntime, .message = "no window can be opened: " + g_glfw_error, .hint = kNoWindowHint};
  self->impl_->initialised = true;

  std::string failures;
  for (Api wanted : *apis) {
    glfwDefaultWindowHints();
    glfwWindowHint(GLFW_CONTEXT_CREATION_API, GLFW_EGL_CONTEXT_API);
    glfwWindowHint(GLFW_CLIENT_API, wanted == Api::kGl33 ? GLFW_OPENGL_API : GLFW_OPENGL_ES_API);
    glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
    glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, wanted == Api::kGl33 ? 3 : 0);
    if (wanted == Api::kGl33) glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
    if (debugContextWanted()) glfwWindowHint(GLFW_OPENGL_DEBUG_CONTEXT, GLFW_TRUE);
    glfwWindowHint(GLFW_SCALE_TO_MONITOR, GLFW_TRUE);
    // The engine draws into its own framebuffer and copies: the window needs no depth and no samples.
    glfwWindowHint(GLFW_DEPTH_BITS, 0);
    glfwWindowHint(GLFW_STENCIL_BITS, 0);
    g_glfw_error.clear();
    self->impl_->window = glfwCreateWindow(width, height, title.c_str(), nullptr, nullptr);
    if (self->impl_->window) break;
    failures += std::string(failures.empty() ? "" : "; ") + apiName(wanted) + ": " + g_glfw_error;
  }
  if (!self->impl_->window)
    return Error{.kind = ErrorKind::kRuntime,
                 .message = "no window with a GL context can be opened: " + failures,
                 .hint = kNoWindowHint};

  GLFWwindow* window = self->impl_->window;
  glfwMakeContextCurrent(window);
  glfwSwapInterval(1);
  installDebugCallback();
  glfwGetFramebufferSize(window, &self->impl_->width, &self->impl_->height);
  glfwGetCursorPos(window, &self->impl_->mouse_x, &self->impl_->mouse_y);
  self->impl_->installCallbacks();
  return self;
}

int Window::width() const { return impl_->width; }
int Window::height() const { return impl_->height; }
bool Window::keyIsDown(const std::string& key) const { return impl_->keys_down.contains(key); }
void Window::setTitle(const std::string& title) { glfwSetWindowTitle(impl_->window, title.c_str()); }

std::vector<Event> Window::pollEvents() {
  glfwPollEvents();
  return std::exchange(impl_->events, {});
}

std::vector<Event> Window::waitEvents(double timeout_s) {
  glfwWaitEventsTimeout(timeout_s);
  return std::exchange(impl_->events, {});
}

double Window::contentScale() const {
  float x = 1, y = 1;
  glfwGetWindowContentScale(impl_->window, &x, &y);
  return x > 0 ? x : 1;
}

void Window::swap() { glfwSwapBuffers(impl_->window); }
void* Window::nativeHandle() const { return impl_->window; }

}  // namespace relievo::gl
