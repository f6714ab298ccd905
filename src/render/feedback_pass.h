// feedback_pass.h - a small picture of which texture node each pixel wants, read back without waiting.
// A ring of targets: a target is read once its fence has passed, through a pixel buffer on hardware; on software GL a finished target is
// read directly (there a read into a pixel buffer waits for everything queued before it).
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "src/gl/objects.h"

namespace relievo {

class FeedbackPass {
 public:
  explicit FeedbackPass(bool software);
  ~FeedbackPass();
  // Width and height of the target; reallocates when changed (results under way are dropped).
  void resize(int width_px, int height_px);
  int width() const { return width_; }
  int height() const { return height_; }

  // Draws with `draw` into the next free target; false (nothing drawn) while all are under way.
  bool issue(const std::function<void()>& draw);
  // The newest finished result, rows bottom first; empty when there is none. Never waits.
  std::span<const std::array<uint32_t, 4>> poll();
  // Waits for the newest issued result (settling).
  std::span<const std::array<uint32_t, 4>> wait();

 private:
  struct Target {
    gl::Texture wants;
    gl::Renderbuffer depth;
    gl::Framebuffer framebuffer;
    gl::Buffer pixels;
    GLsync fence = nullptr;
    uint64_t serial = 0;
  };
  void read(Target& target);
  void drop(Target& target);

  bool software_ = false;
  int width_ = 0, height_ = 0;
  uint64_t serial_ = 0;
  std::array<Target, 3> ring_;
  std::vector<std::array<uint32_t, 4>> result_;
};

}  // namespace relievo
