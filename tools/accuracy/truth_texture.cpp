#include "tools/accuracy/truth_texture.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "texturing/codec/page_codec.h"

namespace relievo {
namespace {

constexpr int kCoarserLevels = 7;  // of 64 .. 1 texels a side

}  // namespace

TruthTexture::TruthTexture(std::shared_ptr<const Package> package, const EffectPlan& plan, double exaggerate,
                           uint64_t budget_bytes)
    : package_(std::move(package)),
      pages_(package_),
      domain_(package_->manifest().domain),
      format_(plan.format(package_->manifest())),
      stored_planes_(package_->manifest().texture.planes()),
      mip_(package_->manifest().texture) {
  if (plan.normals_exaggerate != 0)
    normals_ = std::make_unique<ReliefNormals>(ReliefSurface{domain_.flat(), exaggerate});
  most_nodes_ = std::max<size_t>(16, budget_bytes / (kSlotBytes * static_cast<size_t>(format_.planes())));
}

Result<void> TruthTexture::problem() const {
  std::lock_guard lock(mutex_);
  if (problem_) return *problem_;
  return {};
}

std::shared_ptr<const TruthTexture::Node> TruthTexture::node(const NodeId& id) const {
  {
    std::lock_guard lock(mutex_);
    if (auto found = nodes_.find(id); found != nodes_.end()) return found->second;
  }
  auto loaded = load(id);
  std::lock_guard lock(mutex_);
  if (nodes_.size() >= most_nodes_) nodes_.clear();  // who uses some still holds them
  return nodes_.emplace(id, std::move(loaded)).first->second;
}

std::shared_ptr<const TruthTexture::Node> TruthTexture::load(const NodeId& id) const {
  auto out = std::make_shared<Node>();
  out->texels.resize(kSlotBytes * static_cast<size_t>(format_.planes()));
  PageDecoder decoder;
  auto note = [&](const Error& error) {
    std::lock_guard lock(mutex_);
    if (!problem_) problem_ = error;
  };
  auto slot = [&](int plane) {
    return std::span(out->texels).subspan(kSlotBytes * static_cast<size_t>(plane), kSlotBytes);
  };
  for (int p = 0; p < stored_planes_; ++p) {
    if (auto done = pages_.read(PageId(texturePlane(p), id), decoder, slot(p)); !done) note(done.error());
  }
  if (normals_) {
    auto read = [&](const NodeId& relief, std::span<uint16_t> samples) {
      auto page = package_->read(PageId(Plane::kRelief, relief));
      if (!page) note(page.error());
      return page.ok() && decoder.decodeRelief(page->bytes, samples).ok();
    };
    normals_->make(id, read, slot(format_.planes() - 1).data());
  }
  if (id.level == 0 && !domain_.isFlat()) addCoarser(*out);
  return out;
}

// Patches of a base mesh are often smaller on screen than a root page: the levels go on down to one texel.
void TruthTexture::addCoarser(Node& node) const {
  const int channels = format_.channels();
  int side = kPagePx;
  std::vector<uint16_t> level(static_cast<size_t>(channels) * kPagePx * kPagePx);
  for (int c = 0; c < channels; ++c)
    for (int y = 0; y < kPagePx; ++y)
      for (int x = 0; x < kPagePx; ++x) {
        const size_t from = kSlotBytes * static_cast<size_t>(c / 3) +
                            4 * static_cast<size_t>((y + kPageBorderPx) * kPageFullPx + x + kPageBorderPx);
        level[static_cast<size_t>((c * kPagePx + y) * kPagePx + x)] =
            static_cast<uint16_t>(node.texels[from + static_cast<size_t>(c % 3)] << 8);
      }
  for (int k = 0; k < kCoarserLevels; ++k) {
    std::vector<uint16_t> next(level.size() / 4);
    mip_.downsample(level.data(), side, side, next.data());
    level = std::move(next);
    side /= 2;
    std::vector<double>& values = node.coarser.emplace_back(level.size());
    for (size_t i = 0; i < level.size(); ++i) values[i] = level[i] / 256.0;
  }
}

// texel: of the finest level.
void TruthTexture::bilinear(uint32_t patch, int level, glm::dvec2 texel, double weight, std::span<double> sum) const {
  glm::dvec2 p = texel * std::ldexp(1.0, level - domain_.texture_depth);
  NodeId id{patch, static_cast<uint32_t>(level), 0, 0};
  double nodes_x = std::ldexp(1.0, level), nodes_y = nodes_x;
  if (domain_.isFlat()) {
    const FlatDomain flat = domain_.flat();
    p = glm::clamp(p, glm::dvec2(0.5), glm::dvec2(flat.levelWidth(level), flat.levelHeight(level)) - 0.5);
    const NodeGrid grid = flat.nodeGrid(level);
    nodes_x = static_cast<double>(grid.columns), nodes_y = static_cast<double>(grid.rows);
  } else {
    p = glm::clamp(p, glm::dvec2(0), glm::dvec2(kPagePx * nodes_x));
  }
  const double column = std::clamp(std::floor(p.x / kPagePx), 0.0, nodes_x - 1),
               row = std::clamp(std::floor(p.y / kPagePx), 0.0, nodes_y - 1);
  if (domain_.isFlat()) {
    id = domain_.flat().nodeAt(level, static_cast<uint64_t>(column), static_cast<uint64_t>(row));
  } else {
    id.x = static_cast<uint32_t>(column), id.y = static_cast<uint32_t>(row);
  }
  const double px = p.x - column * kPagePx + kPageBorderPx - 0.5, py = p.y - row * kPagePx + kPageBorderPx - 0.5;
  const int x0 = static_cast<int>(std::floor(px)), y0 = static_cast<int>(std::floor(py));
  const double fx = px - x0, fy = py - y0;
  const std::array<double, 4> weights{(1 - fx) * (1 - fy) * weight, fx * (1 - fy) * weight, (1 - fx) * fy * weight,
                                      fx * fy * weight};
  const auto page = node(id);
  for (int plane = 0; plane < format_.planes(); ++plane) {
    const uint8_t* at =
        page->texels.data() + kSlotBytes * static_cast<size_t>(plane) + 4 * static_cast<size_t>(y0 * kPageFullPx + x0);
    for (int c = 0; c < 3; ++c)
      sum[static_cast<size_t>(3 * plane + c)] += weights[0] * at[c] + weights[1] * at[4 + c] +
                                                 weights[2] * at[4 * kPageFullPx + c] +
                                                 weights[3] * at[4 * kPageFullPx + 4 + c];
  }
}

void TruthTexture::bilinearCoarser(uint32_t patch, int below_root, glm::dvec2 texel, double weight,
                                   std::span<double> sum) const {
  const auto root = node({patch, 0, 0, 0});
  const std::vector<double>& level = root->coarser[static_cast<size_t>(below_root - 1)];
  const int side = kPagePx >> below_root;
  const glm::dvec2 p = glm::clamp(texel * std::ldexp(1.0, -below_root - domain_.texture_depth), glm::dvec2(0.5),
                                  glm::dvec2(side - 0.5)) -
                       0.5;
  const int x0 = static_cast<int>(p.x), y0 = static_cast<int>(p.y), x1 = std::min(x0 + 1, side - 1),
            y1 = std::min(y0 + 1, side - 1);
  const double fx = p.x - x0, fy = p.y - y0;
  for (size_t c = 0; c < sum.size(); ++c) {
    auto v = [&](int x, int y) {
      return level[(c * static_cast<size_t>(side) + static_cast<size_t>(y)) * static_cast<size_t>(side) +
                   static_cast<size_t>(x)];
    };
    sum[c] +=
        weight * ((1 - fy) * ((1 - fx) * v(x0, y0) + fx * v(x1, y0)) + fy * ((1 - fx) * v(x0, y1) + fx * v(x1, y1)));
  }
}

void TruthTexture::filter(const TexelFootprint& at, std::span<double> channels) const {
  std::fill(channels.begin(), channels.end(), 0.0);
  // Half the angle of the double-angle vector of J J^T is the direction of the ellipse's major axis; the extents along
  // it and across it are the singular values.
  const double xx = at.dx.x * at.dx.x + at.dy.x * at.dy.x, yy = at.dx.y * at.dx.y + at.dy.y * at.dy.y,
               xy = at.dx.x * at.dx.y + at.dy.x * at.dy.y;
  const double angle = 0.5 * std::atan2(2 * xy, xx - yy);
  const glm::dvec2 along{std::cos(angle), std::sin(angle)}, across{-along.y, along.x};
  const double major = std::hypot(glm::dot(at.dx, along), glm::dot(at.dy, along)),
               minor = std::hypot(glm::dot(at.dx, across), glm::dot(at.dy, across));
  const double size = std::max({minor, major / kTruthTaps, 1.0});
  const double ratio = std::clamp(major / size, 1.0, static_cast<double>(kTruthTaps));
  const int below = domain_.isFlat() ? 0 : kCoarserLevels;
  const double lambda = std::clamp(std::log2(size), 0.0, static_cast<double>(domain_.texture_depth + below));
  const int finer = static_cast<int>(lambda);
  const double blend = lambda - finer;
  auto tap = [&](double place, double weight) {
    const glm::dvec2 texel = at.texel + along * (place * size);
    auto take = [&](int coarser, double share) {
      const int level = domain_.texture_depth - coarser;
      if (share <= 0) return;
      if (level >= 0) bilinear(at.patch, level, texel, weight * share, channels);
      else bilinearCoarser(at.patch, -level, texel, weight * share, channels);
    };
    take(finer, 1 - blend);
    take(finer + 1, blend);
  };
  if (ratio <= 2) {
    tap(-0.5 * (ratio - 1), 0.5);
    tap(0.5 * (ratio - 1), 0.5);
    return;
  }
  const int reach = static_cast<int>(std::ceil(0.5 * ratio));
  for (double place = -reach + 0.5; place < reach; ++place) {
    const double low = std::max(place - 0.5, -0.5 * ratio), high = std::min(place + 0.5, 0.5 * ratio);
    if (high > low) tap(place, (high - low) / ratio);
  }
}

}  // namespace relievo
