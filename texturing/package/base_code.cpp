#include "texturing/package/base_code.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <optional>
#include <type_traits>

#include <glm/glm.hpp>

#include "src/base/angle_of.h"
#include "src/base/parallel_for.h"
#include "texturing/codec/range_coder.h"
#include "texturing/codec/relief_levels.h"
#include "texturing/package/base_quads.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace base_code {
namespace {

using relief_levels::DecodingCoder;
using relief_levels::EncodingCoder;

// Numbers of which small ones are frequent: how many bits they have, then these.
struct NumberModels {
  std::array<BitModel, 64> width;
  std::array<std::array<BitModel, 2>, 33> top;
};

// Numbers in single precision whose low half and `spare` bits above it are 0, as bounds are stored: in the order of
// their values, as signed integers.
struct Order {
  int spare = 0;
  int32_t most() const { return 0x7FFF >> spare; }
  int32_t of(uint32_t bits) const {
    const auto high = static_cast<int32_t>(bits >> 16);
    return high < 0x8000 ? high >> spare : -((high - 0x8000) >> spare);
  }
  uint32_t bits(int32_t order) const {
    return static_cast<uint32_t>(order >= 0 ? order << spare : 0x8000 + (-order << spare)) << 16;
  }
};

template <class Coder>
class BaseCode {
  static constexpr bool kEncodes = std::is_same_v<Coder, EncodingCoder>;

 public:
  // section: read by an encoder, and written by both. With all corners and patches, and what patches have, but for
  // blocks and shapes, which a decoder makes.
  BaseCode(Coder& coder, BaseSection& section, BaseCodeKind kind, bool cut)
      : coder_(coder),
        section_(section),
        corner_(section.mesh.corners.data()),
        patch_(section.mesh.patches.data()),
        corners_(static_cast<uint32_t>(section.mesh.corners.size())),
        patches_(static_cast<uint32_t>(section.mesh.patches.size())),
        by_sides_(kind != BaseCodeKind::kByCorners),
        by_border_(kind == BaseCodeKind::kByBorder),
        cut_(cut),
        quads_(coder, section.mesh.patches, corners_, kind) {}

  // step: of the lattice of positions; an encoder's. False: damaged.
  bool run(double step) {
    for (int axis = 0; axis < 3; ++axis) plainDouble(section_.mesh.origin_mm[axis]);
    plainDouble(section_.error_unit_mm);
    if (!quads()) return false;
    positions(step);
    normals();
    if (by_sides_) errorsByTwist();
    else errors();
    if constexpr (!kEncodes) makeShares();
    blocks();
    slopes();
    shapes();
    for (int8_t& depth : section_.texture_depths)
      depth = static_cast<int8_t>(symbol<8>(depth_, static_cast<uint8_t>(depth + 1)) - 1);
    if constexpr (!kEncodes) dropShares();
    return !damaged_;
  }

 private:
  // ---- numbers ----
  template <class F>
  void word(float& at, F&& code) {
    at = std::bit_cast<float>(static_cast<uint32_t>(code(std::bit_cast<uint32_t>(at))));
  }
  void plainDouble(double& at) {
    auto bits = std::bit_cast<uint64_t>(at);
    uint64_t coded = 0;
    for (int i = 0; i < 64; i += 8) coded |= uint64_t{coder_.plain(static_cast<uint32_t>(bits >> i & 0xFF), 8)} << i;
    at = std::bit_cast<double>(coded);
  }
  // Of what patches have, or all of them alike.
  template <class T>
  static T& of(std::vector<T>& kept, uint32_t patch) {
    return kept[kept.size() == 1 ? 0 : patch];
  }
  template <int kBits, size_t kSize>
  uint32_t symbol(std::array<BitModel, kSize>& models, uint32_t v) {
    static_assert(kSize == 1 << kBits);
    return relief_levels::codeSymbol<kBits>(coder_, models, v);
  }
  uint32_t number(NumberModels& m, uint32_t v) {
    const auto width = static_cast<int>(symbol<6>(m.width, static_cast<uint32_t>(std::bit_width(v))));
    if (width > 32) return damaged_ = true, 0;
    if (width == 0) return 0;
    uint32_t value = 1;
    int left = width - 1;
    for (size_t k = 0; k < 2 && left > 0; ++k) {
      --left;
      value = value << 1 | static_cast<uint32_t>(coder_.bit(m.top[static_cast<size_t>(width)][k], v >> left & 1));
    }
    if (left > 0) value = value << left | coder_.plain(v & ((1u << left) - 1), left);
    return value;
  }
  int32_t signedNumber(NumberModels& m, int32_t v) {
    const uint32_t folded = number(m, v < 0 ? ~(static_cast<uint32_t>(v) << 1) : static_cast<uint32_t>(v) << 1);
    return static_cast<int32_t>(folded & 1 ? ~(folded >> 1) : folded >> 1);
  }
  bool flag(bool v) { return coder_.plain(v, 1) != 0; }

  // ---- which corners patches have ----
  bool quads() {
    const bool sound = quads_.run();
    if (sound) listUses();
    return sound;
  }
  uint32_t cornerOf(uint32_t use) const { return patch_[use / 4][use % 4]; }
  void listUses() {
    first_.assign(size_t{corners_} + 1, 0);
    uses_.resize(size_t{4} * patches_);
    for (uint32_t u = 0; u < uses_.size(); ++u) ++first_[cornerOf(u) + 1];
    for (size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
    std::vector<uint32_t> next(first_.begin(), first_.end() - 1);
    for (uint32_t u = 0; u < uses_.size(); ++u) uses_[next[cornerOf(u)]++] = u;
  }

  // ---- corners ----
  // What values of earlier corners say of corner c: the mean of parallelograms, else of neighbours, else the one
  // before.
  int32_t predicted(const std::vector<int32_t>& values, uint32_t c) const {
    int64_t sum[2]{0, 0}, count[2]{0, 0};
    for (uint32_t i = first_[c]; i < first_[c + 1]; ++i) {
      const uint32_t use = uses_[i], quad = use & ~3u, k = use & 3u;
      const uint32_t a = cornerOf(quad + (k ^ 1)), b = cornerOf(quad + (k ^ 2)), across = cornerOf(quad + (k ^ 3));
      if (a < c && b < c && across < c) sum[0] += int64_t{values[a]} + values[b] - values[across], ++count[0];
      for (uint32_t n : {a, b})
        if (n < c) sum[1] += values[n], ++count[1];
    }
    for (int k = 0; k < 2; ++k)
      if (count[k] > 0) return static_cast<int32_t>(std::clamp<int64_t>(sum[k] / count[k], -kMostSteps, kMostSteps));
    return c > 0 ? values[c - 1] : 0;
  }
  static std::optional<int32_t> onStep(float v, double step) {
    const double k = std::nearbyint(double{v} / step);
    if (!(std::abs(k) <= kMostSteps)) return std::nullopt;
    return std::bit_cast<uint32_t>(static_cast<float>(k * step)) == std::bit_cast<uint32_t>(v)
               ? std::optional(static_cast<int32_t>(k))
               : std::nullopt;
  }
  // Of its position along x, y and z, then of its normal.
  float& cornerAt(uint32_t c, int axis) const {
    return axis < 3 ? corner_[c].position_mm[axis] : corner_[c].normal[axis - 3];
  }
  bool allOnStep(int first_axis, double step) const {
    if (!(step > 0) || !std::isfinite(step)) return false;
    for (uint32_t c = 0; c < corners_; ++c)
      for (int axis = first_axis; axis < first_axis + 3; ++axis)
        if (!onStep(cornerAt(c, axis), step)) return false;
    return true;
  }
  void plainCorners(int first_axis) {
    for (uint32_t c = 0; c < corners_; ++c)
      for (int axis = first_axis; axis < first_axis + 3; ++axis)
        word(cornerAt(c, axis), [&](uint32_t v) { return coder_.plain(v, 32); });
  }

  void positions(double step) {
    if (!flag(kEncodes && allOnStep(0, step))) return plainCorners(0);
    auto bits = std::bit_cast<uint64_t>(step);
    const uint64_t high = coder_.plain(static_cast<uint32_t>(bits >> 32), 32);
    bits = high << 32 | coder_.plain(static_cast<uint32_t>(bits), 32);
    step = step_ = std::bit_cast<double>(bits);
    // What a corner is off along the axes before tells how much it may be off along this one: in bits. Along x it is
    // what the corner before is off.
    std::vector<uint8_t> off_by(corners_, 0);
    for (int axis = 0; axis < 3; ++axis) {
      std::vector<int32_t>& values = positions_[static_cast<size_t>(axis)];
      values.resize(corners_);
      for (uint32_t c = 0; c < corners_; ++c) {
        const int32_t from = predicted(values, c);
        const int32_t k = kEncodes ? *onStep(cornerAt(c, axis), step) : 0;
        const size_t expected = !by_border_ ? 0 : axis > 0 ? off_by[c] : c > 0 ? off_by[c - 1] : 0;
        const int32_t off = clamped(signedNumber(position_[static_cast<size_t>(axis)][expected], k - from));
        off_by[c] = std::max(off_by[c], static_cast<uint8_t>(std::bit_width(static_cast<uint32_t>(std::abs(off)))));
        values[c] = clamped(from + off);
        cornerAt(c, axis) = static_cast<float>(values[c] * step);
      }
    }
  }
  static int32_t clamped(int32_t k) { return std::clamp(k, -2 * kMostSteps, 2 * kMostSteps); }

  // How a corner's normal is predicted: from those of corners around it, or from the triangles around it, whose normals
  // it has, or their opposites.
  enum class NormalsBy : uint32_t { kCorners, kTriangles, kOpposites };
  using Steps = std::array<int32_t, 3>;
  void normals() {
    if (!flag(kEncodes && allOnStep(3, 1 / kNormalSteps))) return plainCorners(3);
    std::array<std::vector<int32_t>, 3> values;
    for (auto& v : values) v.resize(corners_);
    NormalsBy by = NormalsBy::kCorners;
    if (by_border_ && !positions_[0].empty()) {
      if constexpr (kEncodes) findNormalsOfTriangles(), by = nearestNormals();
      by = static_cast<NormalsBy>(coder_.plain(static_cast<uint32_t>(by), 2));
      if (!kEncodes && by != NormalsBy::kCorners) findNormalsOfTriangles();
    }
    for (uint32_t c = 0; c < corners_; ++c) {
      const Steps from = predictedNormal(values, c, by);
      int largest = 0;
      for (size_t axis = 1; axis < 3; ++axis)
        if (std::abs(from[axis]) > std::abs(from[static_cast<size_t>(largest)])) largest = static_cast<int>(axis);
      // The largest component, as predicted, follows from the other two, but for its sign and rounding.
      double left = kNormalSteps * kNormalSteps;
      for (int i = 1; i <= 3; ++i) {
        const int axis = (largest + i) % 3;
        int32_t& v = values[static_cast<size_t>(axis)][c];
        const int32_t k = kEncodes ? *onStep(cornerAt(c, 3 + axis), 1 / kNormalSteps) : 0;
        int32_t p = from[static_cast<size_t>(axis)];
        if (i == 3) {
          const auto length = static_cast<int32_t>(std::sqrt(std::max(0.0, left)) + 0.5);
          p = p < 0 ? -length : length;
        }
        v = clamped(p + clamped(signedNumber(normal_[i == 3], k - p)));
        left -= static_cast<double>(v) * v;
        cornerAt(c, 3 + axis) = static_cast<float>(v / kNormalSteps);
      }
    }
  }
  Steps predictedNormal(const std::array<std::vector<int32_t>, 3>& values, uint32_t c, NormalsBy by) const {
    if (by != NormalsBy::kCorners) {
      const glm::dvec3& sum = of_triangles_[c];
      if (const double length = glm::length(sum); length > 0) {
        const double steps = (by == NormalsBy::kTriangles ? kNormalSteps : -kNormalSteps) / length;
        return {nearest(steps * sum.x), nearest(steps * sum.y), nearest(steps * sum.z)};
      }
    }
    return {predicted(values[0], c), predicted(values[1], c), predicted(values[2], c)};
  }
  void findNormalsOfTriangles() {
    constexpr size_t kCornersAJob = 4096;
    of_triangles_.resize(corners_);
    parallelFor((corners_ + kCornersAJob - 1) / kCornersAJob, 0, nullptr, [&](size_t job) {
      const auto end = static_cast<uint32_t>(std::min<size_t>(corners_, (job + 1) * kCornersAJob));
      for (auto c = static_cast<uint32_t>(job * kCornersAJob); c < end; ++c) of_triangles_[c] = normalOfTriangles(c);
    });
  }
  static int32_t nearest(double v) { return static_cast<int32_t>(std::floor(v + 0.5)); }
  // The sum of their normals, weighted by their angles at the corner. A patch that is cut has two triangles, and else
  // one at each corner.
  glm::dvec3 normalOfTriangles(uint32_t c) const {
    glm::dvec3 sum(0);
    auto add = [&](const std::array<uint32_t, 4>& quad, size_t at, size_t next, size_t last) {
      const glm::dvec3 p = pointOf(quad[at]), a = pointOf(quad[next]) - p, b = pointOf(quad[last]) - p,
                       n = glm::cross(a, b);
      const double area = glm::length(n);
      if (area > 0) sum += n * (double{angleOf(static_cast<float>(area), static_cast<float>(glm::dot(a, b)))} / area);
    };
    for (uint32_t i = first_[c]; i < first_[c + 1]; ++i) {
      const auto& quad = patch_[uses_[i] / 4];
      const size_t k = uses_[i] % 4, next = kAfter[k], last = kAfter[3 - k];
      const bool on_diagonal = k == 0 || k == 3;
      if (!cut_ || !on_diagonal) {
        add(quad, k, next, last);
      } else {
        add(quad, k, next, 3 - k);
        add(quad, k, 3 - k, last);
      }
    }
    return sum;
  }
  static constexpr std::array<size_t, 4> kAfter{1, 3, 0, 2};  // in a patch's loop
  glm::dvec3 pointOf(uint32_t c) const { return {positions_[0][c], positions_[1][c], positions_[2][c]}; }
  // That which leaves the fewest bits.
  NormalsBy nearestNormals() const {
    std::array<std::vector<int32_t>, 3> values;
    for (size_t axis = 0; axis < 3; ++axis)
      for (uint32_t c = 0; c < corners_; ++c)
        values[axis].push_back(*onStep(cornerAt(c, 3 + static_cast<int>(axis)), 1 / kNormalSteps));
    NormalsBy best = NormalsBy::kCorners;
    uint64_t fewest = std::numeric_limits<uint64_t>::max();
    for (const NormalsBy by : {NormalsBy::kCorners, NormalsBy::kTriangles, NormalsBy::kOpposites}) {
      uint64_t bits = 0;
      for (uint32_t c = 0; c < corners_; ++c) {
        const Steps from = predictedNormal(values, c, by);
        for (size_t axis = 0; axis < 3; ++axis)
          bits += static_cast<uint64_t>(std::bit_width(static_cast<uint32_t>(std::abs(values[axis][c] - from[axis]))));
      }
      if (bits < fewest) best = by, fewest = bits;
    }
    return best;
  }

  // ---- bounds ----
  static constexpr int kPlainOrder = 15;
  // Of words that have one: how many bits are spare. words(record): those of a patch, or of all.
  template <class T, class Words>
  static int spareBits(const std::vector<T>& kept, Words&& words) {
    int spare = 7;
    for (const T& record : kept) {
      for (const float* word : words(record)) {
        const auto v = std::bit_cast<uint32_t>(*word);
        if ((v & 0xFFFF) || v == 0x80000000u) return kPlainOrder;
        if (v != 0) spare = std::min(spare, std::countr_zero(v) - 16);
      }
    }
    return spare;
  }
  // Nothing: they were coded plain.
  template <class T, class Words>
  std::optional<Order> orderOf(std::vector<T>& kept, Words&& words) {
    const auto spare = static_cast<int>(coder_.plain(kEncodes ? static_cast<uint32_t>(spareBits(kept, words)) : 0, 4));
    if (spare <= 7) return Order{spare};
    for (uint32_t p = 0; p < patches_; ++p)
      for (float* at : words(of(kept, p))) word(*at, [&](uint32_t v) { return coder_.plain(v, 32); });
    return std::nullopt;
  }
  static constexpr size_t kErrors = std::tuple_size_v<CoarseErrors>;
  std::optional<Order> orderOfErrors() {
    return orderOf(section_.coarse_errors, [](auto& errors) {
      std::array<decltype(errors.data()), kErrors> at;
      for (size_t k = 0; k < kErrors; ++k) at[k] = &errors[k];
      return at;
    });
  }
  void errors() {
    const auto order = orderOfErrors();
    if (!order) return;
    for (uint32_t p = 0; p < patches_; ++p) {
      int32_t finer = 0;
      size_t size = 0;  // of the step before
      for (size_t k = kErrors; k-- > 0;) {
        word(of(section_.coarse_errors, p)[k], [&](uint32_t v) {
          const int32_t step = limited(signedNumber(error_[k][size], order->of(v) - finer));
          finer = std::clamp(finer + step, -order->most(), order->most());
          const int bits = static_cast<int>(std::bit_width(static_cast<uint32_t>(std::abs(step)))) + order->spare;
          size = finer == 0 ? 0 : static_cast<size_t>(1 + std::clamp(bits - 5, 0, 3));
          return order->bits(finer);
        });
      }
    }
  }
  // A patch without heights is off a grid of 2^k cells by a quarter of its corners' twist, over 4^k, and by what the
  // finest grid itself is off.
  void errorsByTwist() {
    const auto order = orderOfErrors();
    if (!order) return;
    size_t last = 0;
    for (uint32_t p = 0; p < patches_; ++p) {
      const double twist = twistOf(p);
      int32_t finer = 0, finest = 0;
      size_t near = last;  // how near the one before was to what was expected
      bool ends = false;   // the finest grid itself is off
      for (size_t k = kErrors; k-- > 0;) {
        const double own = std::ldexp(twist, -2 * static_cast<int>(k)),
                     least = std::bit_cast<float>(order->bits(finest));
        const bool first = k == kErrors - 1;
        const int32_t expected = orderOf(*order, !ends         ? own
                                                 : own > least ? own + least
                                                               : least),
                      from = near >= kFar && !first ? finer : expected;
        word(of(section_.coarse_errors, p)[k], [&](uint32_t v) {
          const int32_t step = limited(signedNumber(error_by_twist_[k][ends][near], order->of(v) - from));
          finer = std::clamp(from + step, -order->most(), order->most());
          return order->bits(finer);
        });
        const int32_t off = std::abs(finer - expected);
        const int size = std::bit_width(static_cast<uint32_t>(off)) + order->spare;
        if (first) finest = finer, ends = finer > orderOf(*order, own) + 1;
        near = first && ends ? 0 : off <= 1 ? 0 : size <= 3 ? 1 : size <= 5 ? 2 : size <= 7 ? kFar : kFar + 1;
      }
      last = near;
    }
  }
  static constexpr size_t kFar = 3;
  static int32_t orderOf(const Order& order, double v) {
    return std::min(order.of(std::bit_cast<uint32_t>(static_cast<float>(v))), order.most());
  }
  // A quarter of it; 0 where positions are not on steps. Exact but for the root and the step.
  double twistOf(uint32_t p) const {
    if (positions_[0].empty() || (by_border_ && cut_)) return 0;
    int64_t squares = 0;
    const auto& quad = patch_[p];
    for (const auto& along : positions_) {
      const int64_t t = int64_t{along[quad[0]]} - along[quad[1]] - along[quad[2]] + along[quad[3]];
      squares += t * t;
    }
    return std::sqrt(static_cast<double>(squares)) * (step_ / 4);
  }

  // The least and the largest are often of one size, along u and v, too.
  void slopes() {
    auto words = [](auto& s) { return std::array{&s.min_u, &s.max_u, &s.min_v, &s.max_v}; };
    const auto order = orderOf(section_.slopes, words);
    if (!order) return;
    std::array<int32_t, 4> slope{};
    for (uint32_t p = 0; p < patches_; ++p) {
      for (size_t k = 0; k < 4; ++k) {
        word(*words(of(section_.slopes, p))[k], [&](uint32_t v) {
          const int32_t from = k == 0 ? slope[0] : k == 2 ? slope[0] : -slope[k - 1];
          slope[k] =
              std::clamp(from + limited(signedNumber(slope_[k], order->of(v) - from)), -order->most(), order->most());
          return order->bits(slope[k]);
        });
      }
    }
  }
  static int32_t limited(int32_t step) { return std::clamp(step, -0x10000, 0x10000); }

  // Shares in n-ths, rounded up, as bytes.
  static uint32_t shareOf(uint32_t i, uint32_t n) { return (255 * i + n - 1) / n; }
  static uint32_t stepOf(uint32_t byte, uint32_t n) { return byte * n / 255; }
  template <class T>
  static bool allShares(const std::vector<T>& kept, uint32_t n) {
    return std::all_of(kept.begin(), kept.end(), [&](const T& record) {
      const auto bytes = bytesOf(record);
      return std::all_of(bytes.begin(), bytes.end(), [&](uint8_t v) { return shareOf(stepOf(v, n), n) == v; });
    });
  }
  template <class T>
  void plainBytes(std::vector<T>& kept) {
    for (uint32_t p = 0; p < patches_; ++p)
      for (uint8_t& v : bytesOf(of(kept, p))) v = static_cast<uint8_t>(coder_.plain(v, 8));
  }
  static std::span<uint8_t> bytesOf(CoarseBlocks& blocks) { return blocks; }
  static std::span<const uint8_t> bytesOf(const CoarseBlocks& blocks) { return blocks; }
  static std::span<uint8_t> bytesOf(CoarseShapes& shapes) {
    return {reinterpret_cast<uint8_t*>(shapes.data()), sizeof shapes};
  }
  static std::span<const uint8_t> bytesOf(const CoarseShapes& shapes) {
    return {reinterpret_cast<const uint8_t*>(shapes.data()), sizeof shapes};
  }

  // Where no patch has an error, blocks and shapes say nothing, but are coded: one patch after the other takes the same
  // place.
  void makeShares() {
    const auto& errors = section_.coarse_errors;
    any_error_ = std::any_of(errors.begin(), errors.end(), [](const CoarseErrors& e) {
      return std::any_of(e.begin(), e.end(), [](float v) { return std::bit_cast<uint32_t>(v) != 0; });
    });
    section_.coarse_blocks.resize(any_error_ ? patches_ : 1);
    section_.shapes.resize(section_.coarse_blocks.size());
  }
  void dropShares() {
    if (any_error_) return;
    section_.coarse_blocks.clear();
    section_.shapes.clear();
  }

  bool sameAll(const uint8_t* from, size_t n) const {
    return std::all_of(from, from + n, [&](uint8_t v) { return v == from[0]; });
  }
  void blocks() {
    constexpr uint32_t kSteps = 15;
    if (!flag(kEncodes && allShares(section_.coarse_blocks, kSteps))) return plainBytes(section_.coarse_blocks);
    for (uint32_t p = 0; p < patches_; ++p) {
      for (size_t grid = 0; grid < kBlockedGrids; ++grid) {
        uint8_t* b = of(section_.coarse_blocks, p).data() + kFirstCoarseBlock[grid];
        const size_t side = size_t{2} << grid;
        const bool same = coder_.bit(same_[grid], sameAll(b, side * side));
        if (same) {
          const auto share = static_cast<uint8_t>(shareOf(symbol<4>(same_share_[grid], stepOf(b[0], kSteps)), kSteps));
          std::fill_n(b, side * side, share);
          continue;
        }
        for (size_t y = 0; y < side; ++y) {
          for (size_t x = 0; x < side; ++x) {
            const uint32_t left = x > 0 ? stepOf(b[y * side + x - 1], kSteps) : kSteps + 1,
                           above = y > 0 ? stepOf(b[(y - 1) * side + x], kSteps) : kSteps + 1;
            const uint32_t around = left > kSteps ? above : above > kSteps ? left : (left + above + 1) / 2;
            uint8_t& v = b[y * side + x];
            v = static_cast<uint8_t>(shareOf(symbol<4>(share_[grid][around], stepOf(v, kSteps)), kSteps));
          }
        }
      }
    }
  }

  // What a shape's part depends on: the same part of the shape before, and the part before of the same shape.
  void shapes() {
    constexpr uint32_t kSteps = 7;
    if (!flag(kEncodes && allShares(section_.shapes, kSteps))) return plainBytes(section_.shapes);
    auto isUnknown = [](const uint8_t* s) { return std::all_of(s, s + 5, [](uint8_t v) { return v == 255; }); };
    for (uint32_t p = 0; p < patches_; ++p) {
      for (size_t grid = 0; grid < kFirstShapedBlock + kBlockedGrids; ++grid) {
        const bool blocked = grid >= kFirstShapedBlock;
        const size_t first = blocked ? kFirstShapedBlock + kFirstCoarseBlock[grid - kFirstShapedBlock] : grid;
        const size_t side = blocked ? size_t{2} << (grid - kFirstShapedBlock) : 1;
        uint8_t* s = bytesOf(of(section_.shapes, p)).data() + 5 * first;
        bool all_unknown = true;
        if constexpr (kEncodes)
          for (size_t i = 0; i < side * side; ++i) all_unknown = all_unknown && isUnknown(s + 5 * i);
        if (coder_.bit(all_unknown_[grid][was_unknown_], all_unknown)) {
          std::fill_n(s, 5 * side * side, uint8_t{255});
          was_unknown_ = true;
          continue;
        }
        was_unknown_ = false;
        for (size_t i = 0; i < side * side; ++i) {
          const uint8_t* left = i % side > 0 ? s + 5 * (i - 1) : i >= side ? s + 5 * (i - side) : nullptr;
          uint8_t* own = s + 5 * i;
          const size_t was = left ? isUnknown(left) : 2;
          const bool unknown = coder_.bit(unknown_[was], isUnknown(own));
          if (unknown) {
            std::fill_n(own, 5, uint8_t{255});
            continue;
          }
          const uint8_t* coarser = by_sides_ && was != 0 ? coarserShape(s - 5 * first, grid, i) : nullptr;
          if (coarser && isUnknown(coarser)) coarser = nullptr;
          auto& models = coarser ? part_by_coarser_ : part_;
          for (size_t k = 0; k < 5; ++k) {
            const size_t beside = coarser            ? stepOf(coarser[k], kSteps)
                                  : left && was != 1 ? stepOf(left[k], kSteps)
                                                     : 8,
                         before = k > 0 ? stepOf(own[k - 1], kSteps) : 0;
            own[k] =
                static_cast<uint8_t>(shareOf(symbol<3>(models[k][before][beside], stepOf(own[k], kSteps)), kSteps));
          }
        }
      }
    }
  }

  // What the patch's coarser grid has where block i of a grid lies.
  static const uint8_t* coarserShape(const uint8_t* of_patch, size_t grid, size_t i) {
    if (grid == 0) return nullptr;
    if (grid <= kFirstShapedBlock) return of_patch + 5 * (grid - 1);
    const size_t side = size_t{2} << (grid - kFirstShapedBlock), x = i % side, y = i / side;
    return of_patch +
           5 * (kFirstShapedBlock + kFirstCoarseBlock[grid - 1 - kFirstShapedBlock] + y / 2 * (side / 2) + x / 2);
  }

  static constexpr int32_t kMostSteps = kMostPositionSteps;
  Coder& coder_;
  BaseSection& section_;
  BaseCorner* const corner_;
  const std::array<uint32_t, 4>* const patch_;
  const uint32_t corners_, patches_;
  const bool by_sides_, by_border_, cut_;
  bool damaged_ = false, any_error_ = true;
  QuadCode<Coder> quads_;
  double step_ = 0;
  std::array<std::vector<int32_t>, 3> positions_;  // in steps
  std::vector<uint32_t> first_, uses_;             // uses_[first_[c]] .. : the places, four a patch, that name corner c
  std::vector<glm::dvec3> of_triangles_;           // normalOfTriangles(), of each corner
  static constexpr size_t kOffBy = std::bit_width(2u * kMostSteps) + 1;
  std::array<std::array<NumberModels, kOffBy>, 3> position_;
  std::array<NumberModels, 2> normal_;
  std::array<std::array<NumberModels, 5>, kErrors> error_;
  std::array<std::array<std::array<NumberModels, kFar + 2>, 2>, kErrors> error_by_twist_;
  std::array<NumberModels, 4> slope_;
  std::array<BitModel, kBlockedGrids> same_;
  std::array<std::array<BitModel, 16>, kBlockedGrids> same_share_;
  std::array<std::array<std::array<BitModel, 16>, 17>, kBlockedGrids> share_;
  std::array<std::array<BitModel, 2>, kFirstShapedBlock + kBlockedGrids> all_unknown_;
  size_t was_unknown_ = 0;
  std::array<BitModel, 3> unknown_;
  std::array<std::array<std::array<std::array<BitModel, 8>, 9>, 8>, 5> part_, part_by_coarser_;
  std::array<BitModel, 256> depth_;
};

}  // namespace
}  // namespace base_code

std::vector<uint8_t> encodeBaseCode(BaseSection section, double step_mm, BaseCodeKind kind, bool cut) {
  std::vector<uint8_t> out(4);
  storeLittle(out.data(), static_cast<uint32_t>(section.mesh.corners.size()));
  base_code::EncodingCoder coder{RangeEncoder(out)};
  const auto code = std::make_unique<base_code::BaseCode<base_code::EncodingCoder>>(coder, section, kind, cut);
  code->run(step_mm);
  coder.rc.finish();
  return out;
}

Result<BaseSection> decodeBaseCode(std::span<const uint8_t> code, uint32_t patches, BaseSectionEnd end,
                                   BaseCodeKind kind, bool cut) {
  assert(end >= BaseSectionEnd::kShapes);
  if (code.size() < kLeastCodedBaseBytes)
    return damagedBaseMesh("expected at least 8 bytes, found " + std::to_string(code.size()));
  const auto corners = loadLittle<uint32_t>(code.data());
  if (auto wrong = tooManyCorners(corners, patches)) return *wrong;
  BaseSection section;
  section.mesh.corners.resize(corners);
  section.mesh.patches.resize(patches);
  section.coarse_errors.resize(patches);
  section.slopes.resize(patches);
  if (end == BaseSectionEnd::kTextureDepths) section.texture_depths.resize(patches, -1);
  base_code::DecodingCoder coder{RangeDecoder(code.subspan(4))};
  const auto decoder = std::make_unique<base_code::BaseCode<base_code::DecodingCoder>>(coder, section, kind, cut);
  if (!decoder->run(0) || !coder.rc.whole()) return damagedBaseMesh("its code is not one of so many patches");
  return section;
}

Result<BaseSection> readBaseSection(const PackageHeader& header, std::span<const uint8_t> stored) {
  const uint32_t patches = header.domain.patchCount();
  if (!header.compact) return decodeBaseSection(stored, patches);
  const BaseSectionEnd end = header.texture_depths ? BaseSectionEnd::kTextureDepths : BaseSectionEnd::kShapes;
  if (header.coded_base) {
    auto section = decodeBaseCode(stored, patches, end, header.baseCodeKind(), header.cut_patches);
    if (!section) return section;
    if (auto fault = baseSectionFault(*section)) return damagedBaseMesh(fault->message);
    return section;
  }
  auto section = unpackBaseSection(stored, patches, end);
  if (!section) return section.error();
  auto decoded = decodeBaseSection(*section, patches);
  if (decoded) return decoded;
  Error error = decoded.error();
  error.offset = 0;  // it counts in what was unpacked
  return error;
}

}  // namespace relievo
