#include "src/gl/objects.h"

#include <cassert>
#include <cstring>

namespace relievo::gl {
namespace {

GLenum textureBinding(GLenum target) {
  switch (target) {
    case GL_TEXTURE_2D:
      return GL_TEXTURE_BINDING_2D;
    case GL_TEXTURE_2D_ARRAY:
      return GL_TEXTURE_BINDING_2D_ARRAY;
    case GL_TEXTURE_3D:
      return GL_TEXTURE_BINDING_3D;
    case GL_TEXTURE_CUBE_MAP:
      return GL_TEXTURE_BINDING_CUBE_MAP;
    default:
      return 0;
  }
}

GLuint integerOf(GLenum name) {
  GLint value = 0;
  glGetIntegerv(name, &value);
  return static_cast<GLuint>(value);
}

}  // namespace

void label(GLenum identifier, GLuint id, const char* text) {
  if (!text || id == 0 || !epoxy_has_gl_extension("GL_KHR_debug")) return;
  glObjectLabel(identifier, id, static_cast<GLsizei>(std::strlen(text)), text);
}

Texture createNearest(const char* text, int width_px, int height_px, GLenum stored, GLenum format, GLenum type) {
  auto texture = Texture::create();
  glBindTexture(GL_TEXTURE_2D, texture.id());
  label(GL_TEXTURE, texture.id(), text);
  glTexImage2D(GL_TEXTURE_2D, 0, static_cast<GLint>(stored), width_px, height_px, 0, format, type, nullptr);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  return texture;
}

Texture createTexture(GLenum target, const char* text) {
  assert(textureBinding(target) != 0);
  const GLuint before = integerOf(textureBinding(target));
  Texture texture = Texture::create();
  glBindTexture(target, texture.id());
  label(GL_TEXTURE, texture.id(), text);
  glBindTexture(target, before);
  return texture;
}

// Where the first binding settles nothing about an object, create() binds it once so that it can bear its label, and
// restores the binding that was there.

template <>
Texture Texture::create(const char*) {
  GLuint id = 0;
  glGenTextures(1, &id);
  return Texture(id);
}
template <>
void Texture::destroy() {
  if (id_) glDeleteTextures(1, &id_);
  id_ = 0;
}

template <>
Buffer Buffer::create(const char* text) {
  GLuint id = 0;
  glGenBuffers(1, &id);
  if (text) {
    const GLuint before = integerOf(GL_COPY_WRITE_BUFFER_BINDING);
    glBindBuffer(GL_COPY_WRITE_BUFFER, id);
    label(GL_BUFFER, id, text);
    glBindBuffer(GL_COPY_WRITE_BUFFER, before);
  }
  return Buffer(id);
}
template <>
void Buffer::destroy() {
  if (id_) glDeleteBuffers(1, &id_);
  id_ = 0;
}

template <>
VertexArray VertexArray::create(const char* text) {
  GLuint id = 0;
  glGenVertexArrays(1, &id);
  if (text) {
    const GLuint before = integerOf(GL_VERTEX_ARRAY_BINDING);
    glBindVertexArray(id);
    label(GL_VERTEX_ARRAY, id, text);
    glBindVertexArray(before);
  }
  return VertexArray(id);
}
template <>
void VertexArray::destroy() {
  if (id_) glDeleteVertexArrays(1, &id_);
  id_ = 0;
}

template <>
Framebuffer Framebuffer::create(const char* text) {
  GLuint id = 0;
  glGenFramebuffers(1, &id);
  if (text) {
    const GLuint before = integerOf(GL_READ_FRAMEBUFFER_BINDING);
    glBindFramebuffer(GL_READ_FRAMEBUFFER, id);
    label(GL_FRAMEBUFFER, id, text);
    glBindFramebuffer(GL_READ_FRAMEBUFFER, before);
  }
  return Framebuffer(id);
}
template <>
void Framebuffer::destroy() {
  if (id_) glDeleteFramebuffers(1, &id_);
  id_ = 0;
}

template <>
Query Query::create(const char*) {
  GLuint id = 0;
  glGenQueries(1, &id);
  return Query(id);
}
template <>
void Query::destroy() {
  if (id_) glDeleteQueries(1, &id_);
  id_ = 0;
}

template <>
Object<Kind::kProgram> Object<Kind::kProgram>::create(const char* text) {
  Object program(glCreateProgram());
  label(GL_PROGRAM, program.id(), text);
  return program;
}
template <>
void Object<Kind::kProgram>::destroy() {
  if (id_) glDeleteProgram(id_);
  id_ = 0;
}

// A shader is made with its stage: Object<Kind::kShader>(glCreateShader(stage)).
template <>
void Object<Kind::kShader>::destroy() {
  if (id_) glDeleteShader(id_);
  id_ = 0;
}

}  // namespace relievo::gl
