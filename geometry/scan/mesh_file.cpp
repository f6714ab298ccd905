// mesh_file.cpp - files in pieces, polygons into triangles.
#include "geometry/scan/mesh_file.h"

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
  note(std::string("expected ") + what + ", found the end of the file",
       "it is truncated, or states more than it holds; get a whole copy");
  return nullptr;
}

void FileReader::note(std::string message, std::string hint, ErrorKind kind) {
  if (failed_) return;
  failed_ = true;
  error_ = Error{kind, file_.path(), std::move(message), std::move(hint), offset()};
}

void FileReader::fail(Error error) {
  if (failed_) return;
  failed_ = true;
  error_ = std::move(error);
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

std::string_view unitOfComment(std::string_view comment) {
  std::string key = lowerCase(nextItem(comment));
  const bool joined = key.ends_with(':') || key.ends_with('=');
  if (joined) key.pop_back();
  if (key != "unit" && key != "units") return {};
  std::string name = lowerCase(nextItem(comment));
  if (!joined && (name == ":" || name == "=")) name = lowerCase(nextItem(comment));
  constexpr std::pair<std::string_view, std::string_view> kNames[] = {
      {"mm", "mm"}, {"millimetre", "mm"}, {"millimetres", "mm"}, {"millimeter", "mm"}, {"millimeters", "mm"},
      {"cm", "cm"}, {"centimetre", "cm"}, {"centimetres", "cm"}, {"centimeter", "cm"}, {"centimeters", "cm"},
      {"m", "m"},   {"metre", "m"},       {"metres", "m"},       {"meter", "m"},       {"meters", "m"},
      {"in", "in"}, {"inch", "in"},       {"inches", "in"}};
  // Whoever writes more behind it may mean another thing.
  if (!nextItem(comment).empty()) return {};
  for (const auto& [known, unit] : kNames)
    if (name == known) return unit;
  return {};
}

void FaceCutter::emit(size_t a, size_t b, size_t c) {
  mesh_.triangles.push_back({corners_[a], corners_[b], corners_[c]});
  // Faces before this one may have had none.
  const auto put = [&](auto& of_mesh, const auto& of_corners) {
    if (of_corners.empty()) return;
    of_mesh.resize(mesh_.triangles.size() - 1);
    of_mesh.push_back({of_corners[a], of_corners[b], of_corners[c]});
  };
  put(mesh_.corner_uv, uv_);
  put(mesh_.corner_normals, normals_);
}

void FaceCutter::add(std::span<const uint32_t> corners, std::span<const glm::vec2> uv,
                     std::span<const glm::vec3> normals) {
  corners_ = corners;
  uv_ = uv;
  normals_ = normals;
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
  // Ears by the polygon's mean normal (Newell): of few corners the ear of the largest least angle, of many the next
  // one.
  auto at = [&](size_t k) { return mesh_.positions[corners[k]] - mesh_.positions[corners[0]]; };
  glm::dvec3 normal(0);
  for (size_t k = 0; k < n; ++k) normal += glm::cross(at(k), at((k + 1) % n));
  left_.resize(n);
  for (size_t k = 0; k < n; ++k) left_[k] = static_cast<uint32_t>(k);
  // Above 0: an ear, the better the nearer to 1; below 0: what it would cut off is not the polygon's own.
  auto quality = [&](size_t k) {
    const size_t m = left_.size(), before = (k + m - 1) % m, after = (k + 1) % m;
    glm::dvec3 a = at(left_[before]), b = at(left_[k]), c = at(left_[after]);
    double longest = std::max({glm::dot(b - a, b - a), glm::dot(c - b, c - b), glm::dot(a - c, a - c)});
    double scale = longest * glm::length(normal), turn = glm::dot(glm::cross(b - a, c - a), normal);
    double ear = scale > 0 ? turn / scale : 0;
    for (size_t j = 0; j < m && ear > 0; ++j) {
      if (j == k || j == before || j == after) continue;
      glm::dvec3 p = at(left_[j]);
      if (glm::dot(glm::cross(b - a, p - a), normal) >= 0 && glm::dot(glm::cross(c - b, p - b), normal) >= 0 &&
          glm::dot(glm::cross(a - c, p - c), normal) >= 0 && p != a && p != b && p != c)
        ear = -1 - ear;
    }
    return ear;
  };
  constexpr size_t kFew = 8;
  for (size_t next = 0; left_.size() > 3;) {
    const size_t m = left_.size();
    size_t ear = m;
    if (m > kFew) {
      for (size_t i = 0; i < m && ear == m; ++i)
        if (quality((next + i) % m) > 0) ear = (next + i) % m;
      if (ear == m) {  // no polygon: it cuts itself
        for (size_t k = 1; k + 1 < m; ++k) emit(left_[0], left_[k], left_[k + 1]);
        return;
      }
    } else {
      double best = -3;
      for (size_t k = 0; k < m; ++k)
        if (double q = quality(k); q > best) {
          best = q;
          ear = k;
        }
    }
    if (ear == m) ear = 0;
    emit(left_[(ear + m - 1) % m], left_[ear], left_[(ear + 1) % m]);
    left_.erase(left_.begin() + static_cast<std::ptrdiff_t>(ear));
    next = ear + 1;
  }
  emit(left_[0], left_[1], left_[2]);
}

}  // namespace relievo::mesh_file
