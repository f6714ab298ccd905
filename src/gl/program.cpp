#include "src/gl/program.h"

#include <algorithm>
#include <charconv>
#include <optional>
#include <set>
#include <string_view>

#include "shaders/embedded.h"
#include "src/gl/objects.h"

namespace relievo::gl {
namespace {

using Shader = Object<Kind::kShader>;

constexpr const char* kPrologueGl = "#version 330 core\n#define TEXEL_BUFFERS 1\n";
// Everything is highp: positions, texel counts and hashes need their bits.
constexpr const char* kPrologueEs =
    "#version 300 es\n"
    "precision highp float;\nprecision highp int;\n"
    "precision highp sampler2D;\nprecision highp sampler2DArray;\n"
    "precision highp usampler2D;\nprecision highp usampler2DArray;\n"
    "precision highp isampler2D;\nprecision highp isampler2DArray;\n";

struct Assembled {
  std::string text;
  std::vector<ShaderText> files;  // index: the source string number in #line
};

std::vector<std::string_view> linesOf(std::string_view text) {
  std::vector<std::string_view> lines;
  while (!text.empty()) {
    const size_t end = text.find('\n');
    lines.push_back(text.substr(0, end));
    text = end == std::string_view::npos ? std::string_view() : text.substr(end + 1);
  }
  return lines;
}

// What follows `#include` on the line, if it is one; blanks anywhere a preprocessor allows them.
std::optional<std::string_view> includeArgument(std::string_view line) {
  auto skipBlanks = [&] { line.remove_prefix(std::min(line.find_first_not_of(" \t"), line.size())); };
  skipBlanks();
  if (!line.starts_with('#')) return std::nullopt;
  line.remove_prefix(1);
  skipBlanks();
  if (!line.starts_with("include")) return std::nullopt;
  line.remove_prefix(7);
  skipBlanks();
  return line;
}

// The names of an #include: "NAME" is one; an identifier in capitals stands for the quoted names of the define of that
// name, of which there may be none. Nothing: it is neither.
std::optional<std::vector<std::string>> includedNames(std::string_view argument, const Defines& defines) {
  const std::string_view identifier = argument.substr(0, argument.find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ_"));
  if (!identifier.empty()) {
    const auto define =
        std::find_if(defines.begin(), defines.end(), [&](const auto& d) { return d.first == identifier; });
    argument = define == defines.end() ? std::string_view() : std::string_view(define->second);
  } else if (!argument.starts_with('"')) {
    return std::nullopt;
  }
  std::vector<std::string> names;
  while (argument.starts_with('"')) {
    const size_t end = argument.find('"', 1);
    if (end == std::string_view::npos) return std::nullopt;
    names.emplace_back(argument.substr(1, end - 1));
    argument.remove_prefix(end + 1);
    if (identifier.empty()) break;
  }
  return names;
}

Result<void> appendFile(const ShaderText& file, const Defines& defines, Assembled& out) {
  const size_t number = out.files.size();
  out.files.push_back(file);
  auto mark = [&](size_t line) { out.text += "#line " + std::to_string(line) + " " + std::to_string(number) + "\n"; };
  mark(1);
  size_t line_number = 0;
  for (std::string_view line : linesOf(file.text)) {
    ++line_number;
    std::optional<std::string_view> argument = includeArgument(line);
    if (!argument) {
      out.text.append(line);
      out.text += '\n';
      continue;
    }
    if (argument->starts_with('<')) {  // C++ only
      out.text += '\n';
      continue;
    }
    const std::optional<std::vector<std::string>> names = includedNames(*argument, defines);
    if (!names)
      return Error{.kind = ErrorKind::kRuntime,
                   .file = file.name,
                   .message = "line " + std::to_string(line_number) +
                              ": expected #include \"NAME\", found: " + std::string(line)};
    if (names->empty()) out.text += '\n';
    for (std::string name : *names) {
      // C++ names shared headers from the project's root.
      if (name.starts_with("shaders/")) name.erase(0, 8);
      const bool seen =
          std::any_of(out.files.begin(), out.files.end(), [&](const ShaderText& f) { return f.name == name; });
      if (seen) {
        out.text += '\n';
        continue;
      }
      std::string_view text = shaderSource(name);
      if (text.empty())
        return Error{.kind = ErrorKind::kRuntime,
                     .file = file.name,
                     .message = "line " + std::to_string(line_number) + ": there is no shader file \"" + name + "\"",
                     .hint = "add it to RELIEVO_SHADERS in shaders/CMakeLists.txt"};
      Result<void> included = appendFile({name, std::string(text)}, defines, out);
      if (!included) return included;
      mark(line_number + 1);
    }
  }
  return {};
}

Result<Assembled> assemble(Api api, const ShaderText& file, const Defines& defines, bool fragment) {
  Assembled out;
  out.text = api == Api::kGl33 ? kPrologueGl : kPrologueEs;
  out.text += fragment ? "#define RELIEVO_FRAGMENT 1\n" : "#define RELIEVO_VERTEX 1\n";
  // GLSL has no strings: names of files are for #include alone.
  for (const auto& [name, value] : defines)
    out.text += "#define " + name + " " + (value.starts_with('"') ? "1" : value) + "\n";
  Result<void> appended = appendFile(file, defines, out);
  if (!appended) return appended.error();
  return out;
}

Result<ShaderText> embedded(const std::string& name) {
  std::string_view text = shaderSource(name);
  if (!text.empty()) return ShaderText{name, std::string(text)};
  return Error{.kind = ErrorKind::kRuntime,
               .file = name,
               .message = "there is no shader file of this name in the program (or it is empty)",
               .hint = "add it to RELIEVO_SHADERS in shaders/CMakeLists.txt"};
}

// Where a line of a driver's log points to. Drivers write "0:12(5): error" (Mesa), "0(12) : error" (NVIDIA) or
// "ERROR: 0:12: " (ANGLE, Apple); the first number is that of the source string.
struct LogPlace {
  size_t file = 0, line = 0;
  std::string_view before, after;
};
std::optional<LogPlace> logPlace(std::string_view text) {
  LogPlace place;
  size_t at = 0;
  for (std::string_view prefix : {"ERROR: ", "WARNING: "})
    if (text.starts_with(prefix)) at = prefix.size();
  place.before = text.substr(0, at);
  auto number = [&](size_t& value) {
    auto [end, bad] = std::from_chars(text.data() + at, text.data() + text.size(), value);
    at = static_cast<size_t>(end - text.data());
    return bad == std::errc();
  };
  if (!number(place.file) || at >= text.size() || (text[at] != ':' && text[at] != '(')) return std::nullopt;
  const bool bracketed = text[at++] == '(';
  if (!number(place.line)) return std::nullopt;
  if (bracketed && (at >= text.size() || text[at++] != ')')) return std::nullopt;
  if (!bracketed && at < text.size() && text[at] == '(') {  // the column
    const size_t close = text.find(')', at);
    if (close == std::string_view::npos) return std::nullopt;
    at = close + 1;
  }
  place.after = text.substr(at);
  return place;
}

// With file names for the numbers of source strings, and the lines spoken of after the log, two around each.
std::string readableLog(const std::string& log, const std::vector<ShaderText>& files) {
  std::string out;
  std::set<std::pair<size_t, size_t>> shown;
  for (std::string_view line : linesOf(log)) {
    out += "\n  ";
    const std::optional<LogPlace> place = logPlace(line);
    if (!place || place->file >= files.size()) {
      out += line;
      continue;
    }
    const ShaderText& file = files[place->file];
    out.append(place->before).append(file.name + ":" + std::to_string(place->line)).append(place->after);
    const size_t count = linesOf(file.text).size();
    const size_t first = place->line > 2 ? place->line - 2 : 1;
    for (size_t i = first; i <= count && i <= place->line + 2; ++i) shown.insert({place->file, i});
  }
  for (const auto& [file, i] : shown) {
    std::string number = std::to_string(i);
    number.insert(0, number.size() < 4 ? 4 - number.size() : 0, ' ');
    out += "\n  " + files[file].name + " " + number + " | " + std::string(linesOf(files[file].text)[i - 1]);
  }
  return out;
}

template <class GetLength, class GetLog>
std::string infoLog(GLuint id, GetLength getLength, GetLog getLog) {
  GLint length = 0;
  getLength(id, GL_INFO_LOG_LENGTH, &length);
  if (length <= 1) return "(the driver's log is empty)";
  std::string log(static_cast<size_t>(length), '\0');
  GLsizei written = 0;
  getLog(id, length, &written, log.data());
  log.resize(static_cast<size_t>(std::max(written, 0)));
  return log;
}

Result<Shader> compile(GLenum stage, const Assembled& assembled) {
  Shader shader(glCreateShader(stage));
  const char* text = assembled.text.c_str();
  glShaderSource(shader.id(), 1, &text, nullptr);
  glCompileShader(shader.id());
  label(GL_SHADER, shader.id(), assembled.files[0].name.c_str());
  GLint compiled = 0;
  glGetShaderiv(shader.id(), GL_COMPILE_STATUS, &compiled);
  if (compiled) return shader;
  const std::string log = infoLog(shader.id(), glGetShaderiv, glGetShaderInfoLog);
  return Error{.kind = ErrorKind::kRuntime,
               .file = assembled.files[0].name,
               .message = std::string("the ") + (stage == GL_VERTEX_SHADER ? "vertex" : "fragment") +
                          " shader does not compile:" + readableLog(log, assembled.files)};
}

}  // namespace

Program::Program(Program&& other) noexcept : id_(std::exchange(other.id_, 0)) {}

Program& Program::operator=(Program&& other) noexcept {
  if (this != &other) {
    if (id_) glDeleteProgram(id_);
    id_ = std::exchange(other.id_, 0);
  }
  return *this;
}

Program::~Program() {
  if (id_) glDeleteProgram(id_);
}

Result<Program> Program::link(Api api, const Source& source) {
  Result<ShaderText> vertex = embedded(source.vertex);
  if (!vertex) return vertex.error();
  // ES links no program without a fragment shader.
  if (source.fragment.empty()) return linkTexts(api, *vertex, {"(empty)", "void main() {}\n"}, source);
  Result<ShaderText> fragment = embedded(source.fragment);
  if (!fragment) return fragment.error();
  return linkTexts(api, *vertex, *fragment, source);
}

Result<Program> Program::linkTexts(Api api, const ShaderText& vertex, const ShaderText& fragment,
                                   const Source& source) {
  Result<Assembled> vertex_text = assemble(api, vertex, source.defines, false);
  if (!vertex_text) return vertex_text.error();
  Result<Assembled> fragment_text = assemble(api, fragment, source.defines, true);
  if (!fragment_text) return fragment_text.error();
  Result<Shader> vertex_shader = compile(GL_VERTEX_SHADER, *vertex_text);
  if (!vertex_shader) return vertex_shader.error();
  Result<Shader> fragment_shader = compile(GL_FRAGMENT_SHADER, *fragment_text);
  if (!fragment_shader) return fragment_shader.error();

  Program program;
  program.id_ = glCreateProgram();
  glAttachShader(program.id_, vertex_shader->id());
  glAttachShader(program.id_, fragment_shader->id());
  for (size_t i = 0; i < source.attributes.size(); ++i)
    glBindAttribLocation(program.id_, static_cast<GLuint>(i), source.attributes[i].c_str());
  if (!source.feedback_varyings.empty())
    glTransformFeedbackVaryings(program.id_, static_cast<GLsizei>(source.feedback_varyings.size()),
                                source.feedback_varyings.data(), GL_INTERLEAVED_ATTRIBS);
  glLinkProgram(program.id_);
  const std::string name = vertex.name + " + " + fragment.name;
  label(GL_PROGRAM, program.id_, name.c_str());
  GLint linked = 0;
  glGetProgramiv(program.id_, GL_LINK_STATUS, &linked);
  if (!linked)
    return Error{.kind = ErrorKind::kRuntime,
                 .file = name,
                 .message = "the program does not link:" +
                            readableLog(infoLog(program.id_, glGetProgramiv, glGetProgramInfoLog), {})};
  glDetachShader(program.id_, vertex_shader->id());
  glDetachShader(program.id_, fragment_shader->id());
  return program;
}

GLint Program::uniform(const char* name) const { return glGetUniformLocation(id_, name); }

Result<std::string> assembleShader(Api api, const std::string& file, const Defines& defines, bool fragment) {
  Result<ShaderText> text = embedded(file);
  if (!text) return text.error();
  Result<Assembled> assembled = assemble(api, *text, defines, fragment);
  if (!assembled) return assembled.error();
  return std::move(assembled->text);
}

}  // namespace relievo::gl
