// Fitted heights: the cost has its minimum there, found by brute force; what theory says a fit wins; what is shared
// stays.
#include "geometry/bake/height_fit.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace relievo {
namespace height_fit_test {

struct Data {
  std::vector<float> heights;
  std::vector<uint8_t> weights;
  operator HeightData() const { return {heights, weights}; }
};

double onLine(std::span<const float> nodes, size_t i, size_t ratio) {
  const size_t cell = std::min(i / ratio, nodes.size() - 2);
  const double t = static_cast<double>(i - cell * ratio) / static_cast<double>(ratio);
  return nodes[cell] * (1 - t) + nodes[cell + 1] * t;
}
// Barycentric weights of the triangle, found from its corners.
double onGrid(std::span<const float> nodes, size_t row, size_t x, size_t y, size_t ratio) {
  const size_t cx = std::min(x / ratio, row - 2), cy = std::min(y / ratio, row - 2);
  const double fx = static_cast<double>(x - cx * ratio) / static_cast<double>(ratio),
               fy = static_cast<double>(y - cy * ratio) / static_cast<double>(ratio);
  auto node = [&](size_t i, size_t j) { return static_cast<double>(nodes[(cy + j) * row + cx + i]); };
  if (fx >= fy) return node(0, 0) * (1 - fx) + node(1, 0) * (fx - fy) + node(1, 1) * fy;
  return node(0, 0) * (1 - fy) + node(0, 1) * (fy - fx) + node(1, 1) * fx;
}

// A node that the range of the data around it holds may go one way only.
bool atBound(float node, float by, std::span<const float> around) {
  const auto [low, high] = std::minmax_element(around.begin(), around.end());
  return by < 0 ? node <= *low : node >= *high;
}

TEST(HeightFit, aLineHasTheLeastCost) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> noise(-1, 1);
  constexpr size_t kCells = 16, kRatio = 4;
  Data data;
  for (size_t i = 0; i <= kCells * kRatio; ++i) {
    data.heights.push_back(std::sin(0.2f * static_cast<float>(i)) + 0.3f * noise(random));
    data.weights.push_back(static_cast<uint8_t>(20 + random() % 236));
  }
  for (Ends ends : {Ends::kFree, Ends::kFixed}) {
    std::vector<float> nodes(kCells + 1), samples;
    for (size_t i = 0; i <= kCells; ++i) nodes[i] = data.heights[i * kRatio];
    samples = nodes;
    fitLine(data, ends, nodes);
    auto cost = [&](std::span<const float> at) {
      double sum = 0;
      for (size_t i = 0; i < data.heights.size(); ++i)
        sum += data.weights[i] * std::pow(onLine(at, i, kRatio) - data.heights[i], 2);
      return sum;
    };
    size_t lowered = 0;
    for (size_t i = 0; i <= kCells; ++i) {
      const bool fixed = ends == Ends::kFixed && (i == 0 || i == kCells);
      if (fixed) {
        EXPECT_EQ(nodes[i], samples[i]);
        continue;
      }
      const size_t low = i > 0 ? (i - 1) * kRatio : 0, high = std::min((i + 1) * kRatio, data.heights.size() - 1);
      for (float by : {-0.01f, 0.01f}) {
        auto moved = nodes;
        moved[i] += by;
        if (!atBound(nodes[i], by, std::span(data.heights).subspan(low, high - low + 1))) {
          EXPECT_GT(cost(moved), cost(nodes)) << i;
        }
        moved = samples;
        moved[i] += by;
        lowered += cost(moved) < cost(samples);
      }
    }
    EXPECT_GT(lowered, kCells / 2);  // control: from the samples themselves there is a way down
    EXPECT_LT(cost(nodes), 0.8 * cost(samples));
  }
}

TEST(HeightFit, aGridHasTheLeastCostAndItsBorderStays) {
  std::mt19937 random(2);
  std::uniform_real_distribution<float> noise(-1, 1);
  for (size_t ratio : {2u, 4u, 8u}) {
    constexpr size_t kCells = 8, kRow = kCells + 1;
    const size_t data_row = kCells * ratio + 1;
    Data data;
    for (size_t y = 0; y < data_row; ++y) {
      for (size_t x = 0; x < data_row; ++x) {
        data.heights.push_back(std::sin(0.3f * static_cast<float>(x)) * std::cos(0.2f * static_cast<float>(y)) +
                               0.2f * noise(random));
        data.weights.push_back(static_cast<uint8_t>(60 + random() % 196));
      }
    }
    std::vector<float> nodes(kRow * kRow);
    for (size_t y = 0; y < kRow; ++y)
      for (size_t x = 0; x < kRow; ++x) nodes[y * kRow + x] = data.heights[(y * data_row + x) * ratio];
    const auto samples = nodes;
    fitGrid(data, data_row, nodes, kRow);
    auto cost = [&](std::span<const float> at) {
      double sum = 0;
      for (size_t y = 0; y < data_row; ++y)
        for (size_t x = 0; x < data_row; ++x)
          sum += data.weights[y * data_row + x] *
                 std::pow(onGrid(at, kRow, x, y, ratio) - data.heights[y * data_row + x], 2);
      return sum;
    };
    size_t lowered = 0;
    for (size_t y = 0; y < kRow; ++y) {
      for (size_t x = 0; x < kRow; ++x) {
        const size_t i = y * kRow + x;
        if (x == 0 || y == 0 || x == kCells || y == kCells) {
          ASSERT_EQ(nodes[i], samples[i]);
          continue;
        }
        std::vector<float> around;
        for (size_t j = (y - 1) * ratio; j <= (y + 1) * ratio; ++j)
          for (size_t k = (x - 1) * ratio; k <= (x + 1) * ratio; ++k) around.push_back(data.heights[j * data_row + k]);
        for (float by : {-0.01f, 0.01f}) {
          auto moved = nodes;
          moved[i] += by;
          if (!atBound(nodes[i], by, around)) {
            EXPECT_GT(cost(moved), cost(nodes)) << ratio << " " << x << " " << y;
          }
          moved = samples;
          moved[i] += by;
          lowered += cost(moved) < cost(samples);
        }
      }
    }
    EXPECT_GT(lowered, kCells * kCells / 2);
    EXPECT_LT(cost(nodes), 0.9 * cost(samples));
  }
}

// Of a parabola, segments through its points are off by h^2 f'' / sqrt(120) in the root mean square, the best ones by
// h^2 f'' / sqrt(720).
TEST(HeightFit, aParabolaIsSqrt6TimesCloser) {
  constexpr size_t kCells = 64, kRatio = 32;
  Data data;
  for (size_t i = 0; i <= kCells * kRatio; ++i) {
    const double x = static_cast<double>(i) / kRatio;
    data.heights.push_back(static_cast<float>(x * x));
    data.weights.push_back(255);
  }
  std::vector<float> nodes(kCells + 1), samples;
  for (size_t i = 0; i <= kCells; ++i) nodes[i] = data.heights[i * kRatio];
  samples = nodes;
  fitLine(data, Ends::kFree, nodes);
  auto rms = [&](std::span<const float> at) {
    double sum = 0;
    for (size_t i = 0; i < data.heights.size(); ++i) sum += std::pow(onLine(at, i, kRatio) - data.heights[i], 2);
    return std::sqrt(sum / static_cast<double>(data.heights.size()));
  };
  EXPECT_NEAR(rms(samples), 2 / std::sqrt(120.0), 0.003);
  EXPECT_NEAR(rms(nodes), 2 / std::sqrt(720.0), 0.003);
}

TEST(HeightFit, whatIsLinearStaysAsItIs) {
  constexpr size_t kCells = 8, kRatio = 2, kRow = kCells + 1, kDataRow = kCells * kRatio + 1;
  std::mt19937 random(4);
  std::vector<float> truth(kRow * kRow);
  for (float& h : truth) h = static_cast<float>(random() % 1000) / 1000;
  Data data;
  for (size_t y = 0; y < kDataRow; ++y) {
    for (size_t x = 0; x < kDataRow; ++x) {
      data.heights.push_back(static_cast<float>(onGrid(truth, kRow, x, y, kRatio)));
      data.weights.push_back(static_cast<uint8_t>(1 + random() % 255));
    }
  }
  auto nodes = truth;
  fitGrid(data, kDataRow, nodes, kRow);
  for (size_t i = 0; i < nodes.size(); ++i) EXPECT_NEAR(nodes[i], truth[i], 1e-5);
}

TEST(HeightFit, dataWithoutWeightHardlyCount) {
  constexpr size_t kCells = 8, kRatio = 2, kRow = kCells + 1, kDataRow = kCells * kRatio + 1;
  Data data{std::vector<float>(kDataRow * kDataRow, 1.0f), std::vector<uint8_t>(kDataRow * kDataRow, 255)};
  data.heights[8 * kDataRow + 7] = 100;  // a place between two samples that no line has met
  std::vector<float> nodes(kRow * kRow, 1.0f);
  auto most = [&] {
    fitGrid(data, kDataRow, nodes, kRow);
    return *std::max_element(nodes.begin(), nodes.end());
  };
  EXPECT_GT(most(), 10.0f);  // control: with a weight it does
  data.weights[8 * kDataRow + 7] = 0;
  std::fill(nodes.begin(), nodes.end(), 1.0f);
  EXPECT_LT(most(), 1.1f);
}

// A wall between two levels: the best fit without ranges rises above the upper and falls below the lower one.
TEST(HeightFit, noNodeOvershoots) {
  constexpr size_t kCells = 16, kRatio = 4, kRow = kCells + 1, kDataRow = kCells * kRatio + 1;
  Data line, grid;
  for (size_t i = 0; i < kDataRow; ++i) {
    line.heights.push_back(i < 30 ? 0.0f : 1.0f);
    line.weights.push_back(255);
  }
  for (size_t y = 0; y < kDataRow; ++y)
    grid.heights.insert(grid.heights.end(), line.heights.begin(), line.heights.end());
  grid.weights.assign(grid.heights.size(), 255);
  std::vector<float> nodes(kRow), square(kRow * kRow);
  for (size_t i = 0; i < kRow; ++i) nodes[i] = line.heights[i * kRatio];
  for (size_t i = 0; i < square.size(); ++i) square[i] = nodes[i % kRow];
  fitLine(line, Ends::kFree, nodes);
  fitGrid(grid, kDataRow, square, kRow);
  for (auto* all : {&nodes, &square}) {
    EXPECT_EQ(*std::min_element(all->begin(), all->end()), 0.0f);
    EXPECT_EQ(*std::max_element(all->begin(), all->end()), 1.0f);
  }
  // Control: one node above the upper level, and the cost is less.
  auto cost = [&](std::span<const float> at) {
    double sum = 0;
    for (size_t i = 0; i < kDataRow; ++i) sum += std::pow(onLine(at, i, kRatio) - line.heights[i], 2);
    return sum;
  };
  const double least = cost(nodes);
  nodes[8] += 0.05f;
  EXPECT_LT(cost(nodes), least);
}

}  // namespace height_fit_test
}  // namespace relievo
