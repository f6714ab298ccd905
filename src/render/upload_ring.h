// upload_ring.h - a ring of staging memory for texture uploads: a persistently mapped pixel unpack buffer. A texture in
// use by draws takes a page from such a buffer in 0.01 to 0.03 ms, and from the program's own memory in 0.2 ms (NVIDIA
// H100). Software OpenGL is faster without a ring, and uses none.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "src/gl/objects.h"

namespace relievo {

class UploadRing {
 public:
  static constexpr size_t kSegmentBytes = size_t{2} << 20;  // one is filled while the others are read
  static constexpr size_t kSegments = 4;
  static bool available();  // the context has GL_ARB_buffer_storage or GL_EXT_buffer_storage
  static bool pays();       // available, and faster than uploads from the program's memory

  explicit UploadRing(bool wanted);  // not wanted, or not available: stage() returns the texels themselves
  ~UploadRing();
  UploadRing(const UploadRing&) = delete;
  UploadRing& operator=(const UploadRing&) = delete;

  // Between bind() and unbind(), pass stage()'s result as the `pixels` argument of glTexSubImage3D and the like.
  // texels: at most kSegmentBytes.
  void bind() const;
  const void* stage(std::span<const uint8_t> texels);
  void unbind() const;

 private:
  void enter(size_t segment);

  gl::Buffer buffer_;
  uint8_t* mapped_ = nullptr;
  size_t segment_ = 0, used_ = 0;         // of the segment
  std::array<GLsync, kSegments> read_{};  // signalled once all uploads from the segment are done
};

}  // namespace relievo
