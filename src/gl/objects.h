// objects.h - GL objects as move-only values with labels. A default-constructed object is empty (id 0).
#pragma once

#include <cstdint>
#include <utility>

#include <epoxy/gl.h>

namespace relievo::gl {

enum class Kind { kTexture, kBuffer, kVertexArray, kFramebuffer, kRenderbuffer, kQuery, kShader, kProgram };

template <Kind K>
class Object {
 public:
  Object() = default;
  explicit Object(GLuint id) : id_(id) {}
  Object(Object&& other) noexcept : id_(std::exchange(other.id_, 0)) {}
  Object& operator=(Object&& other) noexcept {
    if (this != &other) {
      destroy();
      id_ = std::exchange(other.id_, 0);
    }
    return *this;
  }
  ~Object() { destroy(); }
  static Object create(const char* label = nullptr);
  GLuint id() const { return id_; }
  explicit operator bool() const { return id_ != 0; }

 private:
  void destroy();
  GLuint id_ = 0;
};

using Texture = Object<Kind::kTexture>;
using Buffer = Object<Kind::kBuffer>;
using VertexArray = Object<Kind::kVertexArray>;
using Framebuffer = Object<Kind::kFramebuffer>;
using Renderbuffer = Object<Kind::kRenderbuffer>;
using Query = Object<Kind::kQuery>;

// A label needs the object to have been bound once; does nothing without KHR_debug.
void label(GLenum identifier, GLuint id, const char* text);

}  // namespace relievo::gl
