# Writes OUT: a C++ file with the text of every file in FILES.
set(body "#include \"shaders/embedded.h\"\n#include <array>\nnamespace relievo {\nnamespace {\nstruct File { std::string_view name, text; };\nconstexpr File kFiles[] = {\n")
foreach(file IN LISTS FILES)
  get_filename_component(name ${file} NAME)
  file(READ ${file} text)
  string(APPEND body "{\"${name}\", R\"__glsl__(${text})__glsl__\"},\n")
endforeach()
string(APPEND body "};\n}  // namespace\nstd::string_view shaderSource(std::string_view name) {\n  for (const File& f : kFiles)\n    if (f.name == name) return f.text;\n  return {};\n}\n}  // namespace relievo\n")
file(WRITE ${OUT} "${body}")
