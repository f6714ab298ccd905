// report_file.h - a file of a report, before it is written.
#pragma once

#include <string>

namespace relievo {

struct ReportFile {
  std::string name, text;
};

}  // namespace relievo
