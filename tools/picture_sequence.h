// picture_sequence.h - the pictures of a scene that moves: their moments, and their files by number.
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace relievo {

// "frame-%04d.png": one number, from 0 on, with at least so many digits; "%d": with as many as it has.
class NumberedName {
 public:
  // Nothing: the text names one file.
  static std::optional<NumberedName> parse(const std::string& text);
  std::string at(int number) const;
  // Is the file the one of a number below count?
  bool takesPlaceOf(const std::string& file, int count) const;

 private:
  std::string before_, after_;
  int digits_ = 1;
};

inline constexpr int kMaxPictures = 100000;
// frames pictures from the beginning to the end, both included; or, if fps is above 0, one each 1 / fps seconds.
std::vector<double> momentsOf(double duration_s, int frames, double fps);

}  // namespace relievo
