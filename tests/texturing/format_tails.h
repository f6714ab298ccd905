// format_tails.h - heights of tails, and what they share with texels, as PACKAGE.md says them: a reader in its words
// that shares nothing with texturing/codec/ but the lattice's rule.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <map>
#include <span>
#include <tuple>

#include "src/artwork/relief_lattice.h"
#include "tests/texturing/format_coder.h"

namespace relievo::format_tails {

using format_coder::Coder;
using format_coder::Model;

// Models by a name and numbers; they begin as `begin` says of these.
class ModelBook {
 public:
  using Key = std::tuple<char, int, int, int>;
  Model& at(char name, int a = 0, int b = 0, int c = 0) {
    auto [it, made] = models_.try_emplace({name, a, b, c});
    if (made)
      if (const int zero = begin(name, a, b, c); zero >= 0) it->second = {zero * 256, 6};
    return it->second;
  }
  bool of_heights = false, of_texels = false;  // of texels: signs and lower bits begin with nothing known

 private:
  int begin(char name, int a, int b, int) const {
    if (!of_heights && !of_texels) return -1;
    static const int open[] = {60, 30, 30, 20, 8, 8, 8, 8},
                     zero[] = {252, 247, 237, 226, 211, 193, 171, 147, 126, 104, 86, 66,
                               52,  40,  28,  18,  14,  12,  10,  8,   8,   8,   8,  8},
                     alone[] = {191, 60, 70, 95, 126, 157, 213},
                     larger[] = {235, 238, 240, 232, 225, 215, 205, 188, 170, 146, 122,
                                 100, 78,  62,  48,  40,  33,  26,  20,  16,  12};
    if (name == 'o') return open[b];
    if (name == 'z') return zero[b];
    if (name == 'l') return a == 0 ? alone[std::min(b, 7) - 1] : larger[std::clamp(a - 2 * b + 3, 0, 20)];
    if (of_texels && (name == 's' || name == 'm')) return -1;
    if (name == 's') return (const int[]){62, 128, 194}[a];
    if (name == 'm') return b == 0 ? 180 : 155;
    return -1;
  }
  std::map<Key, Model> models_;
};

inline int symbol(Coder& coder, ModelBook& book, char name, int of, int bits) {
  int node = 1;
  for (int i = 0; i < bits; ++i) node = 2 * node + coder.bit(book.at(name, of, node));
  return node - (1 << bits);
}

inline int bucket(int sum) {
  if (sum < 4) return sum;
  const int k = std::bit_width(static_cast<unsigned>(sum));
  return std::min(23, 2 * k - 2 + (sum >> (k - 2) & 1));
}

// kind, or level and middle, choose the models of "is it 0".
inline int readE(Coder& coder, ModelBook& book, int zero_model, int sign_kind, int kind, int b, int sign, int most) {
  if (!coder.bit(book.at('z', zero_model, b))) return 0;
  const int negative = coder.bit(book.at('s', sign, sign_kind));
  int c = 1;
  while (c < most && coder.bit(book.at('l', b, c, kind))) ++c;
  int value = 1;
  for (int k = 0; k < c - 1; ++k) value = 2 * value + (k < 2 ? coder.bit(book.at('m', c, k, kind)) : coder.plain(1));
  return negative ? -value : value;
}

struct HeightsReader {
  Coder& coder;
  ModelBook book;
  int step = 1;
  int h[17][17], e[17][17];
  std::array<int, 289> given;  // of tails by grids, corners among them; -1: not given
  bool by_grids = false;

  int wrapped(int v) const { return v & 0xFFFF; }
  void patch(uint16_t* out) {
    static const int kTimes[] = {1, 2, 3, 4, 6, 8, 12, 16};
    if (coder.bit(book.at('S'))) step = coder.plain(16);
    const int levels = std::min(4, symbol(coder, book, 'L', 0, 3)), g = !by_grids && coder.bit(book.at('g'));
    int how[4], d[4] = {step * kTimes[0], step, step, step};
    for (int l = 0; l < levels; ++l) {
      how[l] = symbol(coder, book, 'h', l, 2);
      d[l] = step * kTimes[symbol(coder, book, 't', l, 3)];
    }
    std::fill(&e[0][0], &e[0][0] + 17 * 17, 0);
    for (int k = 0; k < 4 && by_grids; ++k)
      h[k / 2 * 16][k % 2 * 16] = given[static_cast<size_t>(k / 2 * 272 + k % 2 * 16)];
    if (!by_grids) h[0][0] = coder.plain(16);
    const int corner = g ? d[0] : 1;
    for (int k = 1; k < 4 && !by_grids; ++k) {
      const int width = coder.plain(5);
      const int folded = width == 0 ? 0 : (1 << (width - 1)) + coder.plain(width - 1);
      h[k / 2 * 16][k % 2 * 16] = wrapped(h[0][0] + corner * (folded & 1 ? -(folded / 2) - 1 : folded / 2));
    }
    int parent = 1;
    for (int l = 0; l < 4; ++l) {
      const int s = 8 >> l, n = 2 << l;  // samples of the grid lie s apart
      bool open = false;
      if (l < levels) open = coder.bit(book.at('o', l, 4 * parent));
      if (l < levels) parent = open;
      for (bool middle : {true, false})
        for (int y = 0; y <= n; ++y)
          for (int x = 0; x <= n; ++x)
            if (middle ? (x & y & 1) : ((x ^ y) & 1)) sample(x, y, s, n, l, l < levels, open, how, d, middle);
    }
    for (int y = 0; y < 17; ++y)
      for (int x = 0; x < 17; ++x) *out++ = static_cast<uint16_t>(h[y][x]);
  }
  void sample(int x, int y, int s, int n, int l, bool coded, bool open, const int* how, const int* d, bool middle) {
    auto at = [&](int dx, int dy) { return h[(y + dy) * s][(x + dx) * s]; };
    const bool along_x = x & 1;
    auto turned = [&](int u, int v) { return along_x ? at(u, v) : at(v, u); };  // u along the line, v across
    const int line = middle ? midHeight(at(-1, -1), at(1, 1)) : midHeight(turned(-1, 0), turned(1, 0));
    int& to = h[y * s][x * s];
    const int known = by_grids ? given[static_cast<size_t>(17 * y * s + x * s)] : -1;
    if (!coded) {
      to = known >= 0 ? known : line;
      return;
    }
    int p = line;
    const int u = along_x ? x : y, v = along_x ? y : x;
    if (middle) {
      if (how[l] > 0) {
        const int f = at(-1, -1) + at(1, -1) + at(-1, 1) + at(1, 1);
        p = (f + 2) >> 2;
        if (how[l] > 1 && x >= 3 && y >= 3 && x <= n - 3 && y <= n - 3) {
          int sum = 0;
          for (int a : {-3, 3})
            for (int b : {-1, 1}) sum += at(a, b) + at(b, a);
          p = (10 * f - sum + 16) >> 5;
        }
      }
    } else if (how[l] == 3 || (how[l] > 0 && (v == 0 || v == n))) {
      if (u >= 3 && u <= n - 3) p = (9 * (turned(-1, 0) + turned(1, 0)) - turned(-3, 0) - turned(3, 0) + 8) >> 4;
    } else if (how[l] > 0) {
      const int f = turned(-1, 0) + turned(1, 0) + turned(0, -1) + turned(0, 1);
      p = (f + 2) >> 2;
      if (how[l] == 2 && u >= 2 && v >= 2 && u <= n - 2 && v <= n - 2) {
        int sum = 0;
        for (int a : {-2, 2})
          for (int b : {-1, 1}) sum += at(a, b) + at(b, a);
        p = (10 * f - sum + 16) >> 5;
      }
    }
    int w = p - line, f = 0;
    if (d[l] != 1) {
      const int t = 8 * (p - line) / d[l];
      w = (t + 4) >> 3;
      f = t - 8 * w;
    }
    int found = known >= 0 ? (known - line) / d[l] - w : 0;
    if (open && known < 0) {
      auto size = [&](int dx, int dy) {
        const int a = x + dx, b = y + dy;
        return a < 0 || b < 0 || a > n || b > n ? 0 : std::min(std::abs(e[b * s][a * s]), 2047);
      };
      int sum = 0;
      if (middle)
        sum = 2 * (size(-2, 0) + size(0, -2)) + size(-2, -2) + size(2, -2) + size(-1, -1) + size(1, -1) + size(-1, 1) +
              size(1, 1);
      else
        sum = 2 * (size(-2, 0) + size(!along_x, along_x) + size(-!along_x, -along_x)) + size(-1, -1) + size(1, -1) +
              size(along_x, !along_x) + size(-along_x, -!along_x);
      found = readE(coder, book, 2 * std::min(3 - l, 2) + middle, 0, 0, bucket(sum), f < -1 ? 0 : f > 1 ? 2 : 1, 17);
    }
    e[y * s][x * s] = found;
    to = known >= 0 ? known : wrapped(line + (w + found) * d[l]);
  }
};

// The next stream of a chunk, which `at` is moved behind.
inline std::span<const uint8_t> nextStream(std::span<const uint8_t> chunk, size_t& at) {
  uint32_t length = 0;
  for (size_t k = 0; k < 4; ++k) length |= uint32_t{chunk[at + k]} << 8 * k;
  at += 4 + length;
  return chunk.subspan(at - length, length);
}

}  // namespace relievo::format_tails
