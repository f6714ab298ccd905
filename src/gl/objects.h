// objects.h - GL objects as move-only values with labels. A default-constructed object is empty (id 0).
// Needs the context current that the object was made in, for create() and for the destructor.
#pragma once

#include <cstdint>
#include <utility>

#include <epoxy/gl.h>

namespace relievo::gl {

enum class Kind { kTexture, kBuffer, kVertexArray, kFramebuffer, kQuery, kShader, kProgram };

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
  // Textures and queries get their kind from their first binding, so they cannot bear the label yet: use
  // createTexture(), or label() after the first binding. There is no create() for shaders, which need their stage.
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
using Query = Object<Kind::kQuery>;

// Target: 2D, 2D array, 3D or cube map. Leaves the bindings as they were.
Texture createTexture(GLenum target, const char* label);
// One layer without levels, its texels read as they are: a pass draws into it and another one reads it. Leaves it
// bound.
Texture createNearest(const char* label, int width_px, int height_px, GLenum stored, GLenum format, GLenum type);
// A label needs the object to have been bound once; does nothing without KHR_debug.
void label(GLenum identifier, GLuint id, const char* text);

template <>
Texture Texture::create(const char*);
template <>
void Texture::destroy();
template <>
Buffer Buffer::create(const char*);
template <>
void Buffer::destroy();
template <>
VertexArray VertexArray::create(const char*);
template <>
void VertexArray::destroy();
template <>
Framebuffer Framebuffer::create(const char*);
template <>
void Framebuffer::destroy();
template <>
Query Query::create(const char*);
template <>
void Query::destroy();
template <>
Object<Kind::kProgram> Object<Kind::kProgram>::create(const char*);
template <>
void Object<Kind::kProgram>::destroy();
template <>
void Object<Kind::kShader>::destroy();

}  // namespace relievo::gl
