// shared_data.h - files that lie beside the checkout, in shared/data; tests that need them skip where they are missing.
#pragma once

#include <filesystem>
#include <string>

namespace relievo {

// Looked for from where the test runs upwards, too: __FILE__ may be relative to where it was compiled (ccache). Empty:
// not there.
inline std::filesystem::path sharedData(const std::string& name) {
  namespace fs = std::filesystem;
  const fs::path beside = fs::path(__FILE__).parent_path() / "../../../shared/data" / name;
  if (fs::exists(beside)) return beside;
  for (fs::path at = fs::current_path();; at = at.parent_path()) {
    if (fs::exists(at / "shared/data" / name)) return at / "shared/data" / name;
    if (at == at.parent_path()) return {};
  }
}

}  // namespace relievo
