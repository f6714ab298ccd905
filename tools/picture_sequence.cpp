#include "tools/picture_sequence.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "tools/output_files.h"

namespace relievo {

std::optional<NumberedName> NumberedName::parse(const std::string& text) {
  std::optional<NumberedName> found;
  for (size_t at = text.find('%'); at != std::string::npos; at = text.find('%', at + 1)) {
    size_t end = at + 1;
    int digits = 1;
    if (end + 1 < text.size() && text[end] == '0' && text[end + 1] >= '1' && text[end + 1] <= '9') {
      digits = text[end + 1] - '0';
      end += 2;
    }
    if (end >= text.size() || text[end] != 'd') continue;
    if (found) return std::nullopt;
    found.emplace();
    found->before_ = text.substr(0, at);
    found->after_ = text.substr(end + 1);
    found->digits_ = digits;
  }
  return found;
}

std::string NumberedName::at(int number) const {
  std::string digits = std::to_string(number);
  digits.insert(0, static_cast<size_t>(std::max(0, digits_ - static_cast<int>(digits.size()))), '0');
  return before_ + digits + after_;
}

bool NumberedName::takesPlaceOf(const std::string& file, int count) const {
  // The number is where the file's name ends as this one does.
  const std::string name = std::filesystem::path(file).filename().string();
  const std::string after = std::filesystem::path("x" + after_).filename().string().substr(1);
  if (name.size() <= after.size()) return false;
  size_t end = name.size() - after.size(), begin = end;
  while (begin > 0 && end - begin < 9 && name[begin - 1] >= '0' && name[begin - 1] <= '9') --begin;
  for (; begin < end; ++begin) {  // digits before the number may be the name's own
    const int number = std::stoi(name.substr(begin, end - begin));
    if (number < count && sameFile(at(number), file)) return true;
  }
  return false;
}

std::vector<double> momentsOf(double duration_s, int frames, double fps) {
  std::vector<double> moments;
  if (fps > 0) frames = static_cast<int>(std::min<double>(std::floor(duration_s * fps + 1e-9) + 1, kMaxPictures));
  for (int i = 0; i < frames; ++i)
    moments.push_back(std::min(duration_s, fps > 0 ? i / fps : frames > 1 ? duration_s * i / (frames - 1) : 0));
  return moments;
}

}  // namespace relievo
