// embedded.h - the text of a file in shaders/, embedded at build time; empty when there is none of that name.
#pragma once

#include <string_view>
#include <vector>

namespace relievo {
std::string_view shaderSource(std::string_view name);
std::vector<std::string_view> shaderNames();
}  // namespace relievo
