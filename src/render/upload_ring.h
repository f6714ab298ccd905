// upload_ring.h - texels on their way into textures: a pixel unpack buffer that stays mapped, filled in turn. A texture
// that draws sample takes texels from such a buffer in 0.01 to 0.03 ms a page, from the program's own memory in 0.2 ms
// (NVIDIA H100). Software GL is faster without, and has none.
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
  // Whether this context has what it takes (GL_ARB_buffer_storage or GL_EXT_buffer_storage), and gains by it.
  static bool available();
  static bool pays();

  explicit UploadRing(bool wanted);  // not wanted, or not available: texels go as they are
  ~UploadRing();
  UploadRing(const UploadRing&) = delete;
  UploadRing& operator=(const UploadRing&) = delete;

  // Between these two, what stage() gives is what glTexSubImage and its kin take. texels: at most kSegmentBytes.
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
