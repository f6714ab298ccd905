// feedback_pass.h - a small picture of which texture node each pixel wants, read back without waiting.
// A ring of targets: a target is read once its fence has passed, through a pixel buffer on hardware; on software GL a
// finished target is read directly (there a read into a pixel buffer waits for everything queued before it).
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "src/gl/objects.h"
#include "texturing/stream/feedback.h"

namespace relievo {

// Which pixels of the full picture a feedback picture consists of: its pixel (i, j) is (i * scale + offset.x, j * scale
// + offset.y), counted from the bottom left corner, as GL does.
struct FeedbackGrid {
  int view_width_px = 1, view_height_px = 1;
  int scale = 1;
  FeedbackOffset offset;
  // width() and height(): the size of the target, the same for all offsets. columns() and rows(): the part of it that
  // lies inside the picture.
  int width() const { return (view_width_px + scale - 1) / scale; }
  int height() const { return (view_height_px + scale - 1) / scale; }
  int columns() const { return (view_width_px - offset.x + scale - 1) / scale; }
  int rows() const { return (view_height_px - offset.y + scale - 1) / scale; }
};
// scale is lowered where an offset would leave no pixel in one direction.
FeedbackGrid feedbackGrid(int view_width_px, int view_height_px, int scale, uint64_t turn);

class FeedbackPass {
 public:
  explicit FeedbackPass(bool software);
  ~FeedbackPass();
  int width() const { return width_; }
  int height() const { return height_; }

  // Draws with `draw` into the next free target; false (nothing drawn) while all are under way. Nothing is drawn
  // outside of the first columns and rows. tag: comes back with the result.
  bool issue(const FeedbackGrid& grid, uint64_t tag, const std::function<void()>& draw);
  // The oldest finished result that was not returned yet, rows bottom first; empty when there is none. Never waits.
  // Valid until the next call of poll, wait or issue.
  std::span<const std::array<uint32_t, 4>> poll();
  // Waits for the newest issued result and drops all others (settling).
  std::span<const std::array<uint32_t, 4>> wait();
  // Waits for the oldest issued result that was not returned yet; empty when there is none (settling).
  std::span<const std::array<uint32_t, 4>> waitForNext();
  uint64_t tag() const { return tag_; }  // of the result returned last

 private:
  struct Target {
    int width = 0, height = 0;
    gl::Texture requests;
    gl::Framebuffer framebuffer;
    gl::Buffer pixels;
    GLsync fence = nullptr;
    uint64_t serial = 0, tag = 0;
  };
  void resize(int width_px, int height_px);  // results under way are dropped when it changes
  void fit(Target& target);                  // to the size wanted: memory is taken when a target is first drawn
  void read(Target& target);
  void drop(Target& target);
  Target* oldest();  // null: none is under way

  bool software_ = false;
  int width_ = 0, height_ = 0;
  uint64_t serial_ = 0, tag_ = 0;
  std::array<Target, 3> ring_;
  std::vector<std::array<uint32_t, 4>> result_;
};

}  // namespace relievo
