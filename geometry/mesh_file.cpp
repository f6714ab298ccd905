// mesh_file.cpp - files in pieces, polygons into triangles.
#include "geometry/mesh_file.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>

namespace relievo::mesh_file {

namespace {
constexpr size_t kPieceBytes = size_t{1} << 20;
constexpr size_t kMaxLineBytes = size_t{64} << 20;  // a polygon of some million corners
constexpr size_t kMaxEarCorners = 64;
}  // namespace

bool FileReader::fill(size_t n) {
  if (failed_) return false;
  if (buffered() >= n) return true;
  if (options_.interrupted && *options_.interrupted) {
    note("interrupted", "", ErrorKind::kInterrupted);
    return false;
  }
  if (at_ > 0) std::memmove(buffer_.data(), buffer_.data() + at_, buffered());
  end_ -= at_;
  at_ = 0;
  uint64_t more = std::min<uint64_t>(std::max(n, kPieceBytes) - end_, file_.size() - file_at_);
  if (buffer_.size() < end_ + more) buffer_.resize(end_ + more);
  if (more > 0) {
    if (auto read = file_.read(file_at_, {buffer_.data() + end_, static_cast<size_t>(more)}); !read) {
      failed_ = true;
      error_ = read.error();
      return false;
    }
    end_ += more;
    file_at_ += more;
    if (options_.progress) options_.progress(0.6 * static_cast<double>(file_at_) / static_cast<double>(file_.size()));
  }
  return buffered() >= n;
}

bool FileReader::line(std::string_view& text) {
  size_t searched = 0;
  for (;;) {
    const uint8_t* begin = buffer_.data() + at_;
    size_t n = buffered();
    if (n > searched)
      if (const void* end = std::memchr(begin + searched, '\n', n - searched)) {
        auto length = static_cast<size_t>(static_cast<const uint8_t*>(end) - begin);
        text = {reinterpret_cast<const char*>(begin), length};
        at_ += length + 1;
        ++lines_;
        return true;
      }
    searched = n;
    if (n > kMaxLineBytes) {
      note("expected a line's end, found more than " + std::to_string(kMaxLineBytes >> 20) + " MiB without one");
      return false;
    }
    if (!fill(std::max(2 * n, n + 1))) {
      if (failed_ || buffered() == 0) return false;
      if (buffered() > n) continue;
      text = {reinterpret_cast<const char*>(buffer_.data() + at_), buffered()};  // the last line may lack its end
      at_ = end_;
      ++lines_;
      return true;
    }
  }
}

const uint8_t* FileReader::endOfFile(const char* what) {
  note(std::string("expected ") + what + ", found the end of the file", "it is truncated, or states more than it holds; get a whole copy");
  return nullptr;
}

void FileReader::note(std::string message, std::string hint, ErrorKind kind) {
  if (failed_) return;
  failed_ = true;
  error_ = Error{kind, file_.path(), std::move(message), std::move(hint), offset()};
}

std::string inQuotes(std::string_view text) {
  std::string out = "\"";
  for (char c : text.substr(0, 40)) out += c >= 0x20 && c < 0x7f ? c : '?';
  if (text.size() > 40) out += "...";
  return out + "\"";
}

std::string numberText(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.15g", value);
  return text;
}

std::string lowerCase(std::string_view text) {
  std::string out(text);
  for (char& c : out)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return out;
}

void FaceCutter::emit(size_t a, size_t b, size_t c) {
  mesh_.triangles.push_back({corners_[a], corners_[b], corners_[c]});
  if (uv_.empty()) return;
  mesh_.corner_uv.resize(mesh_.triangles.size() - 1);  // faces before this one may have had none
  mesh_.corner_uv.push_back({uv_[a], uv_[b], uv_[c]});
}

void FaceCutter::add(std::span<const uint32_t> corners, std::span<const glm::vec2> uv) {
  corners_ = corners;
  uv_ = uv;
  size_t n = corners.size();
  if (n < 3) {
    ++dropped_;
    return;
  }
  if (n == 3) return emit(0, 1, 2);
  bool known = std::all_of(corners.begin(), corners.end(), [&](uint32_t i) { return i < mesh_.positions.size(); });
  if (n > kMaxEarCorners || !known) {
    for (size_t k = 1; k + 1 < n; ++k) emit(0, k, k + 1);
    return;
  }
  // Ears by the polygon's mean normal (Newell). Of those that cut nothing off wrongly, the one of the largest least angle goes first.
  auto at = [&](size_t k) { return mesh_.positions[corners[k]] - mesh_.positions[corners[0]]; };
  glm::dvec3 normal(0);
  for (size_t k = 0; k < n; ++k) normal += glm::cross(at(k), at((k + 1) % n));
  left_.resize(n);
  for (size_t k = 0; k < n; ++k) left_[k] = static_cast<uint32_t>(k);
  while (left_.size() > 3) {
    size_t m = left_.size(), best = 0;
    double best_quality = -3;
    for (size_t k = 0; k < m; ++k) {
      glm::dvec3 a = at(left_[(k + m - 1) % m]), b = at(left_[k]), c = at(left_[(k + 1) % m]);
      double turn = glm::dot(glm::cross(b - a, c - a), normal);
      double longest = std::max({glm::dot(b - a, b - a), glm::dot(c - b, c - b), glm::dot(a - c, a - c)});
      double scale = longest * glm::length(normal);
      double quality = scale > 0 ? turn / scale : 0;
      if (turn > 0)
        for (size_t j = 0; j < m && quality > 0; ++j) {
          if (j == k || j == (k + 1) % m || j == (k + m - 1) % m) continue;
          glm::dvec3 p = at(left_[j]);
          bool inside = glm::dot(glm::cross(b - a, p - a), normal) >= 0 && glm::dot(glm::cross(c - b, p - b), normal) >= 0 &&
                        glm::dot(glm::cross(a - c, p - c), normal) >= 0 && p != a && p != b && p != c;
          if (inside) quality = -1 - quality;
        }
      if (quality > best_quality) {
        best_quality = quality;
        best = k;
      }
    }
    emit(left_[(best + m - 1) % m], left_[best], left_[(best + 1) % m]);
    left_.erase(left_.begin() + static_cast<std::ptrdiff_t>(best));
  }
  emit(left_[0], left_[1], left_[2]);
}

}  // namespace relievo::mesh_file
