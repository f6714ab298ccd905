#include "src/render/upload_ring.h"

#include <cassert>
#include <cstring>

#include "src/gl/context.h"

namespace relievo {

bool UploadRing::available() {
  return epoxy_is_desktop_gl() ? epoxy_gl_version() >= 44 || epoxy_has_gl_extension("GL_ARB_buffer_storage")
                               : epoxy_has_gl_extension("GL_EXT_buffer_storage");
}

bool UploadRing::pays() { return available() && !gl::currentContextInfo().software; }

UploadRing::UploadRing(bool wanted) {
  if (!wanted || !available()) return;
  constexpr GLbitfield kAccess = GL_MAP_WRITE_BIT | GL_MAP_PERSISTENT_BIT | GL_MAP_COHERENT_BIT;
  constexpr auto kBytes = static_cast<GLsizeiptr>(kSegments * kSegmentBytes);
  buffer_ = gl::Buffer::create();
  glBindBuffer(GL_PIXEL_UNPACK_BUFFER, buffer_.id());
  gl::label(GL_BUFFER, buffer_.id(), "upload ring");
  if (epoxy_is_desktop_gl()) glBufferStorage(GL_PIXEL_UNPACK_BUFFER, kBytes, nullptr, kAccess);
  else glBufferStorageEXT(GL_PIXEL_UNPACK_BUFFER, kBytes, nullptr, kAccess);
  mapped_ = static_cast<uint8_t*>(glMapBufferRange(GL_PIXEL_UNPACK_BUFFER, 0, kBytes, kAccess));
  glBindBuffer(GL_PIXEL_UNPACK_BUFFER, 0);
  if (!mapped_) buffer_ = {};  // no memory for it: texels go as they are
}

UploadRing::~UploadRing() {
  for (GLsync fence : read_) glDeleteSync(fence);  // of 0: nothing
}

void UploadRing::bind() const {
  if (mapped_) glBindBuffer(GL_PIXEL_UNPACK_BUFFER, buffer_.id());
}

void UploadRing::unbind() const {
  if (mapped_) glBindBuffer(GL_PIXEL_UNPACK_BUFFER, 0);
}

// What was there before has been read, or is waited for.
void UploadRing::enter(size_t segment) {
  GLsync& fence = read_[segment];
  if (!fence) return;
  constexpr GLuint64 kSecond = 1'000'000'000;
  while (glClientWaitSync(fence, GL_SYNC_FLUSH_COMMANDS_BIT, kSecond) == GL_TIMEOUT_EXPIRED) {
  }
  glDeleteSync(fence);
  fence = nullptr;
}

const void* UploadRing::stage(std::span<const uint8_t> texels) {
  if (!mapped_) return texels.data();
  assert(texels.size() <= kSegmentBytes);
  if (used_ + texels.size() > kSegmentBytes) {
    read_[segment_] = glFenceSync(GL_SYNC_GPU_COMMANDS_COMPLETE, 0);
    segment_ = (segment_ + 1) % kSegments;
    used_ = 0;
    enter(segment_);
  }
  const size_t place = segment_ * kSegmentBytes + used_;
  std::memcpy(mapped_ + place, texels.data(), texels.size());
  used_ += (texels.size() + 15) / 16 * 16;
  return reinterpret_cast<const void*>(place);
}

}  // namespace relievo
