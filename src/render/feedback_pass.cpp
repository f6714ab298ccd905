#include "src/render/feedback_pass.h"

#include <algorithm>
#include <cstring>

namespace relievo {
namespace {

constexpr GLuint64 kTenSeconds = GLuint64{10} * 1000 * 1000 * 1000;

}  // namespace

FeedbackGrid feedbackGrid(int view_width_px, int view_height_px, int scale, uint64_t turn) {
  FeedbackGrid grid;
  grid.view_width_px = std::max(1, view_width_px);
  grid.view_height_px = std::max(1, view_height_px);
  grid.scale = std::clamp(scale, 1, std::min({kMaxFeedbackScale, grid.view_width_px, grid.view_height_px}));
  grid.offset = feedbackOffset(grid.scale, turn);
  return grid;
}

FeedbackPass::FeedbackPass(bool software) : software_(software) {}

FeedbackPass::~FeedbackPass() {
  for (Target& t : ring_) drop(t);
}

void FeedbackPass::drop(Target& target) {
  if (target.fence) glDeleteSync(target.fence);
  target.fence = nullptr;
}

void FeedbackPass::resize(int width_px, int height_px) {
  if (width_px == width_ && height_px == height_) return;
  width_ = width_px;
  height_ = height_px;
  for (Target& t : ring_) drop(t);
  result_.assign(static_cast<size_t>(width_) * static_cast<size_t>(height_), {});
}

void FeedbackPass::fit(Target& t) {
  if (t.width == width_ && t.height == height_) return;
  t.width = width_;
  t.height = height_;
  t.requests = gl::Texture::create();
  glBindTexture(GL_TEXTURE_2D, t.requests.id());
  gl::label(GL_TEXTURE, t.requests.id(), "feedback");
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32UI, width_, height_, 0, GL_RGBA_INTEGER, GL_UNSIGNED_INT, nullptr);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  t.framebuffer = gl::Framebuffer::create();
  glBindFramebuffer(GL_FRAMEBUFFER, t.framebuffer.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, t.requests.id(), 0);
  t.pixels = gl::Buffer::create();
  if (software_) return;
  glBindBuffer(GL_PIXEL_PACK_BUFFER, t.pixels.id());
  glBufferData(GL_PIXEL_PACK_BUFFER, static_cast<GLsizeiptr>(width_) * height_ * 16, nullptr, GL_STREAM_READ);
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
}

bool FeedbackPass::issue(const FeedbackGrid& grid, uint64_t tag, const std::function<void()>& draw) {
  resize(grid.width(), grid.height());
  for (Target& t : ring_) {
    if (t.fence) continue;
    fit(t);
    glBindFramebuffer(GL_FRAMEBUFFER, t.framebuffer.id());
    glViewport(0, 0, width_, height_);
    const GLuint nothing[4] = {0, 0, 0, 0};
    glClearBufferuiv(GL_COLOR, 0, nothing);
    glEnable(GL_SCISSOR_TEST);
    glScissor(0, 0, grid.columns(), grid.rows());
    draw();
    glDisable(GL_SCISSOR_TEST);
    if (!software_) {
      glBindBuffer(GL_PIXEL_PACK_BUFFER, t.pixels.id());
      glReadPixels(0, 0, width_, height_, GL_RGBA_INTEGER, GL_UNSIGNED_INT, nullptr);
      glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
    }
    t.fence = glFenceSync(GL_SYNC_GPU_COMMANDS_COMPLETE, 0);
    t.serial = ++serial_;
    t.tag = tag;
    return true;
  }
  return false;
}

void FeedbackPass::read(Target& target) {
  tag_ = target.tag;
  if (software_) {
    glBindFramebuffer(GL_FRAMEBUFFER, target.framebuffer.id());
    glReadPixels(0, 0, width_, height_, GL_RGBA_INTEGER, GL_UNSIGNED_INT, result_.data());
    return;
  }
  glBindBuffer(GL_PIXEL_PACK_BUFFER, target.pixels.id());
  auto bytes = static_cast<GLsizeiptr>(result_.size() * sizeof(result_[0]));
  if (const void* mapped = glMapBufferRange(GL_PIXEL_PACK_BUFFER, 0, bytes, GL_MAP_READ_BIT)) {
    std::memcpy(result_.data(), mapped, static_cast<size_t>(bytes));
    glUnmapBuffer(GL_PIXEL_PACK_BUFFER);
  }
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
}

std::span<const std::array<uint32_t, 4>> FeedbackPass::poll() {
  Target* const next = oldest();
  if (!next) return {};
  GLenum state = glClientWaitSync(next->fence, 0, 0);  // targets finish in the order of issue
  if (state != GL_ALREADY_SIGNALED && state != GL_CONDITION_SATISFIED) return {};
  read(*next);
  drop(*next);
  return result_;
}

FeedbackPass::Target* FeedbackPass::oldest() {
  Target* oldest = nullptr;
  for (Target& t : ring_) {
    if (t.fence && (!oldest || t.serial < oldest->serial)) oldest = &t;
  }
  return oldest;
}

std::span<const std::array<uint32_t, 4>> FeedbackPass::waitForNext() {
  Target* const next = oldest();
  if (!next) return {};
  glClientWaitSync(next->fence, GL_SYNC_FLUSH_COMMANDS_BIT, kTenSeconds);
  read(*next);
  drop(*next);
  return result_;
}

std::span<const std::array<uint32_t, 4>> FeedbackPass::wait() {
  Target* newest = nullptr;
  for (Target& t : ring_) {
    if (t.fence && (!newest || t.serial > newest->serial)) newest = &t;
  }
  if (!newest) return {};
  glClientWaitSync(newest->fence, GL_SYNC_FLUSH_COMMANDS_BIT, kTenSeconds);
  read(*newest);
  for (Target& t : ring_) drop(t);
  return result_;
}

}  // namespace relievo
