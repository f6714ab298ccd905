#include "src/gl/context.h"

#include <algorithm>
#include <atomic>
#include <cctype>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <set>
#include <span>
#include <utility>

#include <epoxy/egl.h>
#include <epoxy/gl.h>

namespace relievo::gl {
namespace {

// ---- counting errors ----

std::atomic<int> g_error_count{0};
std::atomic<int> g_callback_count{0};  // since the last debugErrorCount()

void recordError(const std::string& text) {
  static std::mutex mutex;
  static std::set<std::string> seen;
  std::lock_guard lock(mutex);
  if (seen.size() < 100 && seen.insert(text).second) std::fprintf(stderr, "GL error: %s\n", text.c_str());
}

void GLAPIENTRY debugCallback(GLenum source, GLenum type, GLuint, GLenum, GLsizei length, const GLchar* message,
                              const void*) {
  // What the shader compiler says comes back from Program::link().
  if (type != GL_DEBUG_TYPE_ERROR || source == GL_DEBUG_SOURCE_SHADER_COMPILER) return;
  ++g_callback_count;
  std::string text = length >= 0 ? std::string(message, static_cast<size_t>(length)) : std::string(message);
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back()))) text.pop_back();
  recordError(text);
}

// ---- EGL ----

std::string eglErrorName(EGLint code) {
  static constexpr std::pair<EGLint, const char*> kNames[] = {{EGL_SUCCESS, "EGL_SUCCESS"},
                                                              {EGL_NOT_INITIALIZED, "EGL_NOT_INITIALIZED"},
                                                              {EGL_BAD_ACCESS, "EGL_BAD_ACCESS"},
                                                              {EGL_BAD_ALLOC, "EGL_BAD_ALLOC"},
                                                              {EGL_BAD_ATTRIBUTE, "EGL_BAD_ATTRIBUTE"},
                                                              {EGL_BAD_CONFIG, "EGL_BAD_CONFIG"},
                                                              {EGL_BAD_CONTEXT, "EGL_BAD_CONTEXT"},
                                                              {EGL_BAD_DISPLAY, "EGL_BAD_DISPLAY"},
                                                              {EGL_BAD_MATCH, "EGL_BAD_MATCH"},
                                                              {EGL_BAD_PARAMETER, "EGL_BAD_PARAMETER"},
                                                              {EGL_BAD_SURFACE, "EGL_BAD_SURFACE"},
                                                              {EGL_CONTEXT_LOST, "EGL_CONTEXT_LOST"}};
  for (const auto& [value, name] : kNames)
    if (value == code) return name;
  return "EGL error " + std::to_string(code);
}

bool hasWord(const char* words, const char* word) {
  if (!words) return false;
  const std::string list = std::string(" ") + words + " ";
  return list.find(std::string(" ") + word + " ") != std::string::npos;
}

// The ways to a display that this EGL offers. A display is opened only when it is tried, since that loads its driver.
struct Platform {
  std::string name;
  EGLenum platform = 0;  // 0: eglGetDisplay(EGL_DEFAULT_DISPLAY)
  void* native = nullptr;
  bool hardware_device = false;  // names a GPU for certain

  EGLDisplay open() const {
    if (platform == 0) return eglGetDisplay(EGL_DEFAULT_DISPLAY);
    auto get = reinterpret_cast<PFNEGLGETPLATFORMDISPLAYEXTPROC>(eglGetProcAddress("eglGetPlatformDisplayEXT"));
    return get(platform, native, nullptr);
  }
};

std::vector<Platform> listPlatforms() {
  std::vector<Platform> list;
  const char* extensions = eglQueryString(EGL_NO_DISPLAY, EGL_EXTENSIONS);
  eglGetError();  // EGL 1.4 has no client extensions and calls the question an error
  if (hasWord(extensions, "EGL_EXT_platform_base")) {
    if (hasWord(extensions, "EGL_MESA_platform_surfaceless"))
      list.push_back({"surfaceless platform", EGL_PLATFORM_SURFACELESS_MESA, nullptr});
    auto query = reinterpret_cast<PFNEGLQUERYDEVICESEXTPROC>(eglGetProcAddress("eglQueryDevicesEXT"));
    auto query_string = reinterpret_cast<PFNEGLQUERYDEVICESTRINGEXTPROC>(eglGetProcAddress("eglQueryDeviceStringEXT"));
    EGLDeviceEXT devices[16];
    EGLint count = 0;
    if (query && query_string && hasWord(extensions, "EGL_EXT_platform_device") && query(16, devices, &count)) {
      for (EGLint i = 0; i < count; ++i)
        list.push_back({"device platform, device " + std::to_string(i), EGL_PLATFORM_DEVICE_EXT, devices[i],
                        !hasWord(query_string(devices[i], EGL_EXTENSIONS), "EGL_MESA_device_software")});
    }
  }
  list.push_back({"default platform"});
  return list;
}

struct EglContext {
  EGLDisplay display = EGL_NO_DISPLAY;
  EGLContext context = EGL_NO_CONTEXT;
  EGLSurface surface = EGL_NO_SURFACE;  // a pbuffer, where the driver has no surfaceless contexts
  EGLenum egl_api = EGL_OPENGL_API;

  // The display stays initialised: others of this process may share it, and EGL does not count.
  void destroy() {
    if (display == EGL_NO_DISPLAY) return;
    if (context != EGL_NO_CONTEXT) {
      eglBindAPI(egl_api);
      if (eglGetCurrentContext() == context) eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
      eglDestroyContext(display, context);
    }
    if (surface != EGL_NO_SURFACE) eglDestroySurface(display, surface);
    *this = {};
  }
};

// Empty string: done; else what failed.
std::string createOn(const Platform& platform, Api api, EglContext& out) {
  EGLDisplay display = platform.open();
  if (display == EGL_NO_DISPLAY) return "no display: " + eglErrorName(eglGetError());
  EGLint major = 0, minor = 0;
  if (!eglInitialize(display, &major, &minor)) return "eglInitialize: " + eglErrorName(eglGetError());
  out.display = display;
  out.egl_api = api == Api::kGl33 ? EGL_OPENGL_API : EGL_OPENGL_ES_API;
  if (!eglBindAPI(out.egl_api)) return "eglBindAPI: " + eglErrorName(eglGetError());

  const char* extensions = eglQueryString(out.display, EGL_EXTENSIONS);
  const bool surfaceless = hasWord(extensions, "EGL_KHR_surfaceless_context");
  const EGLint config_attributes[] = {EGL_SURFACE_TYPE, surfaceless ? 0 : EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE,
                                      api == Api::kGl33 ? EGL_OPENGL_BIT : EGL_OPENGL_ES3_BIT, EGL_NONE};
  EGLConfig config = nullptr;
  EGLint count = 0;
  if (!eglChooseConfig(out.display, config_attributes, &config, 1, &count) || count < 1)
    return std::string("no EGL configuration for ") + apiName(api);

  const bool is_15 = major > 1 || (major == 1 && minor >= 5);
  // Some drivers answer with the version asked for and no more: the newest first, for what is used where it is there
  // (tessellation).
  static constexpr std::pair<EGLint, EGLint> kGlVersions[] = {{4, 6}, {4, 5}, {4, 3}, {4, 1}, {3, 3}},
                                             kEsVersions[] = {{3, 2}, {3, 1}, {3, 0}};
  const bool names_minor = is_15 || hasWord(extensions, "EGL_KHR_create_context");
  std::span<const std::pair<EGLint, EGLint>> versions = kEsVersions;
  if (api == Api::kGl33) versions = kGlVersions;
  if (!names_minor) versions = versions.last(1);  // 3, and what minor version the driver likes
  for (const auto& [context_major, context_minor] : versions) {
    std::vector<EGLint> attributes = {EGL_CONTEXT_MAJOR_VERSION, context_major};
    if (names_minor) {
      attributes.insert(attributes.end(), {EGL_CONTEXT_MINOR_VERSION, context_minor});
      if (api == Api::kGl33)
        attributes.insert(attributes.end(), {EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT});
      if (debugContextWanted() && is_15) attributes.insert(attributes.end(), {EGL_CONTEXT_OPENGL_DEBUG, EGL_TRUE});
    }
    attributes.push_back(EGL_NONE);
    out.context = eglCreateContext(out.display, config, EGL_NO_CONTEXT, attributes.data());
    if (out.context != EGL_NO_CONTEXT) break;
  }
  if (out.context == EGL_NO_CONTEXT) {
    std::string reason = "eglCreateContext: " + eglErrorName(eglGetError());
    out.destroy();
    return reason;
  }
  if (!surfaceless) {
    const EGLint surface_attributes[] = {EGL_WIDTH, 1, EGL_HEIGHT, 1, EGL_NONE};
    out.surface = eglCreatePbufferSurface(out.display, config, surface_attributes);
  }
  if (!eglMakeCurrent(out.display, out.surface, out.surface, out.context)) {
    std::string reason = "eglMakeCurrent: " + eglErrorName(eglGetError());
    out.destroy();
    return reason;
  }
  return {};
}

}  // namespace

const char* apiName(Api api) { return api == Api::kGl33 ? "OpenGL 3.3 core" : "OpenGL ES 3.0"; }

bool debugContextWanted() {
  const char* value = std::getenv("RELIEVO_GL_DEBUG");
  return value && *value && std::strcmp(value, "0") != 0;
}

Result<std::vector<Api>> apisToTry(Api api) {
  const char* forced = std::getenv("RELIEVO_GL");
  if (!forced || !*forced) return std::vector<Api>{api, api == Api::kGl33 ? Api::kEs30 : Api::kGl33};
  if (std::strcmp(forced, "gl") == 0) return std::vector<Api>{Api::kGl33};
  if (std::strcmp(forced, "es") == 0) return std::vector<Api>{Api::kEs30};
  return Error{.kind = ErrorKind::kUsage,
               .message = std::string("the environment variable RELIEVO_GL is \"") + forced + "\"",
               .hint = "set it to gl (OpenGL 3.3 core) or es (OpenGL ES 3.0), or unset it"};
}

struct HeadlessContext::Impl {
  EglContext egl;
  ContextInfo info;
};

HeadlessContext::HeadlessContext() : impl_(std::make_unique<Impl>()) {}

HeadlessContext::~HeadlessContext() { impl_->egl.destroy(); }

Result<std::unique_ptr<HeadlessContext>> HeadlessContext::create(Api api) {
  Result<std::vector<Api>> apis = apisToTry(api);
  if (!apis) return apis.error();

  const std::vector<Platform> platforms = listPlatforms();
  const bool gpu_listed =
      std::any_of(platforms.begin(), platforms.end(), [](const Platform& p) { return p.hardware_device; });
  std::string failures;
  for (Api wanted : *apis) {
    EglContext best;
    for (const Platform& platform : platforms) {
      const bool have_software = best.context != EGL_NO_CONTEXT;
      if (have_software && !platform.hardware_device) continue;
      EglContext egl;
      std::string failure = createOn(platform, wanted, egl);
      if (!failure.empty()) {
        failures += std::string(failures.empty() ? "" : "; ") + apiName(wanted) + ", " + platform.name + ": " + failure;
        continue;
      }
      const bool software = currentContextInfo().software;
      if (have_software && software) {
        egl.destroy();
        continue;
      }
      best.destroy();
      best = egl;
      if (!software || !gpu_listed) break;
    }
    if (best.context == EGL_NO_CONTEXT) continue;
    std::unique_ptr<HeadlessContext> context(new HeadlessContext());
    context->impl_->egl = best;
    Result<void> current = context->makeCurrent();
    if (!current) return current.error();
    context->impl_->info = currentContextInfo();
    installDebugCallback();
    return context;
  }
  return Error{
      .kind = ErrorKind::kRuntime,
      .message = "no GL context without a window: " + failures,
      .hint = "install a driver: on Debian and Ubuntu the packages libegl1 and libgl1-mesa-dri; tools/setup does"};
}

const ContextInfo& HeadlessContext::info() const { return impl_->info; }

Result<void> HeadlessContext::makeCurrent() {
  const EglContext& egl = impl_->egl;
  eglBindAPI(egl.egl_api);
  if (eglMakeCurrent(egl.display, egl.surface, egl.surface, egl.context)) return {};
  return Error{.kind = ErrorKind::kRuntime,
               .message = "the GL context cannot be made current: " + eglErrorName(eglGetError()),
               .hint = "is it current on another thread?"};
}

ContextInfo currentContextInfo() {
  auto text = [](GLenum name) {
    const GLubyte* s = glGetString(name);
    return s ? std::string(reinterpret_cast<const char*>(s)) : std::string();
  };
  ContextInfo info;
  info.api = epoxy_is_desktop_gl() ? Api::kGl33 : Api::kEs30;
  info.renderer = text(GL_RENDERER);
  info.version = text(GL_VERSION);
  std::string lower = info.renderer;
  std::transform(lower.begin(), lower.end(), lower.begin(), [](unsigned char c) { return std::tolower(c); });
  for (const char* name : {"llvmpipe", "softpipe", "swrast", "swiftshader", "software rasterizer"})
    info.software = info.software || lower.find(name) != std::string::npos;
  return info;
}

void installDebugCallback() {
  if (!epoxy_has_gl_extension("GL_KHR_debug")) return;
  glEnable(GL_DEBUG_OUTPUT);
  glEnable(GL_DEBUG_OUTPUT_SYNCHRONOUS);
  glDebugMessageCallback(debugCallback, nullptr);
}

int debugErrorCount() {
  int flags = 0;
  // A lost context returns errors for ever: bounded.
  for (GLenum e = glGetError(); e != GL_NO_ERROR && flags < 16; e = glGetError()) {
    ++flags;
    if (g_callback_count == 0) {
      char text[32];
      std::snprintf(text, sizeof text, "glGetError 0x%04X", e);
      recordError(text);
    }
  }
  // The callback and the flag tell of the same error.
  g_error_count += std::max(flags, g_callback_count.exchange(0));
  return g_error_count;
}

}  // namespace relievo::gl
