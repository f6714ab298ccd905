// Contexts, objects and programs, on a real driver. What the dialect must promise to the rest: exact clears, exact
// integer fetches, and the same page hashes as C++.
#include <array>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <optional>
#include <random>
#include <sstream>
#include <vector>

#include <gtest/gtest.h>

#include "shaders/embedded.h"
#include "shaders/page_table.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/gl/window.h"
#include "tests/render/gl_fixture.h"

namespace relievo::gl {
namespace gl_gltest {

struct ScopedEnv {
  ScopedEnv(const char* name, const char* value) : name_(name) {
    if (const char* old = std::getenv(name)) old_ = old;
    if (value) setenv(name, value, 1);
    else unsetenv(name);
  }
  ~ScopedEnv() {
    if (old_) setenv(name_, old_->c_str(), 1);
    else unsetenv(name_);
  }
  const char* name_;
  std::optional<std::string> old_;
};

// A framebuffer with one colour texture of the format, bound, with its viewport.
struct Target {
  Texture colour;
  Framebuffer framebuffer;
};
Target makeTarget(GLenum internal_format, GLenum format, GLenum type, int width, int height) {
  Target t{createTexture(GL_TEXTURE_2D, "target"), Framebuffer::create("target")};
  glBindTexture(GL_TEXTURE_2D, t.colour.id());
  glTexImage2D(GL_TEXTURE_2D, 0, internal_format, width, height, 0, format, type, nullptr);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  glBindFramebuffer(GL_FRAMEBUFFER, t.framebuffer.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, t.colour.id(), 0);
  EXPECT_EQ(glCheckFramebufferStatus(GL_FRAMEBUFFER), GLenum{GL_FRAMEBUFFER_COMPLETE});
  glViewport(0, 0, width, height);
  return t;
}

// Covers the target with one triangle.
const ShaderText kFullScreen = {"full_screen.vert",
                                "void main() {\n"
                                "  vec2 p = vec2(float((gl_VertexID & 1) << 2), float((gl_VertexID & 2) << 1)) - 1.0;\n"
                                "  gl_Position = vec4(p, 0.0, 1.0);\n"
                                "}\n"};

Program mustLink(const ShaderText& vertex, const ShaderText& fragment, const Program::Source& source = {}) {
  Result<Program> program = Program::linkTexts(gltest::api(), vertex, fragment, source);
  if (!program) {
    ADD_FAILURE() << program.error().text();
    return {};
  }
  return std::move(*program);
}

void drawFullScreen() {
  VertexArray vertex_array = VertexArray::create("empty");
  glBindVertexArray(vertex_array.id());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glBindVertexArray(0);
}

TEST(Context, IsTheApiThatWasForced) {
  const char* forced = std::getenv("RELIEVO_GL");
  if (!forced) GTEST_SKIP() << "RELIEVO_GL is not set";
  EXPECT_EQ(gltest::api(), std::string(forced) == "es" ? Api::kEs30 : Api::kGl33);
  EXPECT_EQ(currentContextInfo().api, gltest::api());
  EXPECT_FALSE(gltest::context().info().renderer.empty());
  GLint major = 0;
  glGetIntegerv(GL_MAJOR_VERSION, &major);
  EXPECT_GE(major, 3);
}

TEST(Context, BothApisCanBeMadeAndSwitchedBetween) {
  ScopedEnv unforced("RELIEVO_GL", nullptr);
  for (Api api : {Api::kGl33, Api::kEs30}) {
    Result<std::unique_ptr<HeadlessContext>> other = HeadlessContext::create(api);
    ASSERT_TRUE(other.ok()) << other.error().text();
    EXPECT_EQ((*other)->info().api, api);
    EXPECT_EQ(currentContextInfo().api, api);
    ASSERT_TRUE(gltest::context().makeCurrent().ok());
    EXPECT_EQ(currentContextInfo().api, gltest::api());
    ASSERT_TRUE((*other)->makeCurrent().ok());
    EXPECT_EQ(currentContextInfo().api, api);
  }
  ASSERT_TRUE(gltest::context().makeCurrent().ok());
  EXPECT_EQ(currentContextInfo().api, gltest::api());
}

TEST(Context, AnUnknownApiInTheEnvironmentIsAUsageError) {
  ScopedEnv wrong("RELIEVO_GL", "vulkan");
  Result<std::unique_ptr<HeadlessContext>> made = HeadlessContext::create();
  ASSERT_FALSE(made.ok());
  EXPECT_EQ(made.error().kind, ErrorKind::kUsage);
  EXPECT_NE(made.error().text().find("vulkan"), std::string::npos);
  EXPECT_NE(made.error().text().find("gl (OpenGL 3.3 core) or es"), std::string::npos);
}

TEST(Context, GlErrorsAreCounted) {
  EXPECT_EQ(gltest::takeGlErrors(), 0);
  glEnable(0xFFFF);
  EXPECT_EQ(gltest::takeGlErrors(), 1);
  glEnable(0xFFFF);
  glBindTexture(0xFFFF, 0);
  EXPECT_GE(gltest::takeGlErrors(), 1);  // without KHR_debug the two may fall into one flag
  EXPECT_EQ(gltest::takeGlErrors(), 0);
}

TEST(Window, WithoutADisplayNamesTheRenderCommand) {
  ScopedEnv no_x11("DISPLAY", nullptr), no_wayland("WAYLAND_DISPLAY", nullptr);
  Result<std::unique_ptr<Window>> window = Window::create("test", 64, 64);
  ASSERT_FALSE(window.ok());
  EXPECT_EQ(window.error().kind, ErrorKind::kRuntime);
  EXPECT_NE(window.error().text().find("relievo render"), std::string::npos);
  EXPECT_NE(window.error().text().find("DISPLAY"), std::string::npos);
}

TEST(Window, ADisplayThatIsNotThereNamesTheRenderCommand) {
  ScopedEnv no_wayland("WAYLAND_DISPLAY", nullptr), wrong("DISPLAY", ":4711");
  Result<std::unique_ptr<Window>> window = Window::create("test", 64, 64);
  ASSERT_FALSE(window.ok());
  EXPECT_EQ(window.error().kind, ErrorKind::kRuntime);
  EXPECT_NE(window.error().text().find("relievo render"), std::string::npos);
  EXPECT_NE(window.error().text().find(":4711"), std::string::npos) << window.error().text();
}

TEST(Objects, MoveLeavesTheSourceEmptyAndDestroysOnce) {
  Buffer a = Buffer::create("a");
  const GLuint id = a.id();
  ASSERT_NE(id, 0u);
  EXPECT_EQ(glIsBuffer(id), GL_TRUE);  // labelled, so bound once
  Buffer b = std::move(a);
  EXPECT_FALSE(a);
  EXPECT_EQ(b.id(), id);
  Buffer c = Buffer::create("c");
  const GLuint replaced = c.id();
  c = std::move(b);
  EXPECT_EQ(c.id(), id);
  EXPECT_EQ(glIsBuffer(replaced), GL_FALSE);
  EXPECT_EQ(glIsBuffer(id), GL_TRUE);
  c = Buffer();
  EXPECT_EQ(glIsBuffer(id), GL_FALSE);
}

TEST(Objects, EveryKindIsMadeAndDestroyedAndLeavesBindingsAlone) {
  GLint before = 0, after = 0;
  Buffer bound = Buffer::create();
  glBindBuffer(GL_COPY_WRITE_BUFFER, bound.id());
  glGetIntegerv(GL_COPY_WRITE_BUFFER_BINDING, &before);
  GLuint ids[4];
  {
    Buffer buffer = Buffer::create("buffer");
    VertexArray vertex_array = VertexArray::create("vertex array");
    Framebuffer framebuffer = Framebuffer::create("framebuffer");
    Texture texture = createTexture(GL_TEXTURE_2D_ARRAY, "texture");
    Query query = Query::create();
    EXPECT_TRUE(query);
    ids[0] = buffer.id(), ids[1] = vertex_array.id(), ids[2] = framebuffer.id(), ids[3] = texture.id();
    EXPECT_TRUE(glIsBuffer(ids[0]) && glIsVertexArray(ids[1]) && glIsFramebuffer(ids[2]) && glIsTexture(ids[3]));
    if (epoxy_has_gl_extension("GL_KHR_debug")) {
      char text[32] = {};
      glGetObjectLabel(GL_TEXTURE, texture.id(), sizeof text, nullptr, text);
      EXPECT_STREQ(text, "texture");
      glGetObjectLabel(GL_FRAMEBUFFER, framebuffer.id(), sizeof text, nullptr, text);
      EXPECT_STREQ(text, "framebuffer");
    }
  }
  EXPECT_FALSE(glIsBuffer(ids[0]) || glIsVertexArray(ids[1]) || glIsFramebuffer(ids[2]) || glIsTexture(ids[3]));
  glGetIntegerv(GL_COPY_WRITE_BUFFER_BINDING, &after);
  EXPECT_EQ(before, after);
}

TEST(Framebuffers, AClearReadsBackByteForByte) {
  Target target = makeTarget(GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE, 8, 4);
  for (int v : {0, 1, 2, 127, 128, 254, 255}) {
    glClearColor(float(v) / 255.0f, float(255 - v) / 255.0f, float(v) / 255.0f, 1.0f);
    glClear(GL_COLOR_BUFFER_BIT);
    std::array<uint8_t, 8 * 4 * 4> bytes{};
    glReadPixels(0, 0, 8, 4, GL_RGBA, GL_UNSIGNED_BYTE, bytes.data());
    for (size_t i = 0; i < bytes.size(); i += 4) {
      ASSERT_EQ(bytes[i], v);
      ASSERT_EQ(bytes[i + 1], 255 - v);
      ASSERT_EQ(bytes[i + 2], v);
      ASSERT_EQ(bytes[i + 3], 255);
    }
  }
}

// Copies an integer texture with texelFetch; returns what arrived.
std::vector<uint32_t> fetchCopy(const std::vector<uint32_t>& texels, int size, bool complete) {
  Texture source = createTexture(GL_TEXTURE_2D, "source");
  Target target = makeTarget(GL_RGBA32UI, GL_RGBA_INTEGER, GL_UNSIGNED_INT, size, size);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, source.id());
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32UI, size, size, 0, GL_RGBA_INTEGER, GL_UNSIGNED_INT, texels.data());
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, complete ? GL_NEAREST : GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, complete ? GL_NEAREST : GL_LINEAR);
  Program program = mustLink(kFullScreen, {"copy.frag",
                                           "uniform usampler2D u_source;\nlayout(location = 0) out uvec4 o;\n"
                                           "void main() { o = texelFetch(u_source, ivec2(gl_FragCoord.xy), 0); }\n"});
  program.use();
  glUniform1i(program.uniform("u_source"), 0);
  drawFullScreen();
  std::vector<uint32_t> out(texels.size());
  glReadPixels(0, 0, size, size, GL_RGBA_INTEGER, GL_UNSIGNED_INT, out.data());
  return out;
}

TEST(Textures, IntegerTexelFetchIsExact) {
  const int size = 32;
  std::mt19937 random(20261121);
  std::vector<uint32_t> texels(size * size * 4);
  for (uint32_t& t : texels) t = random();
  texels[0] = 0xFFFFFFFFu, texels[1] = 0x80000000u, texels[2] = 0x00FFFFFFu, texels[3] = 0x01000001u;
  EXPECT_EQ(fetchCopy(texels, size, true), texels);
  // Negative controls: one bit is seen; and with linear filters an integer texture is incomplete, so that zeros (and
  // alpha 1) arrive, where the driver keeps to that (NVIDIA's fetches the texels all the same).
  std::vector<uint32_t> other = texels;
  other[4321 % other.size()] ^= 1;
  EXPECT_NE(fetchCopy(other, size, true), texels);
  if (currentContextInfo().software) {
    EXPECT_NE(fetchCopy(texels, size, false), texels);
  }
}

TEST(Programs, SixteenBitUploadIsExact) {
  // A relief sample travels as high byte in R and low byte in G of RGBA8, and must come back as the same integer.
  const int size = 256;
  std::vector<uint8_t> texels(size * size * 4);
  for (uint32_t q = 0; q < 65536; ++q) texels[q * 4] = uint8_t(q >> 8), texels[q * 4 + 1] = uint8_t(q & 255);
  Texture source = createTexture(GL_TEXTURE_2D, "source");
  Target target = makeTarget(GL_RGBA32UI, GL_RGBA_INTEGER, GL_UNSIGNED_INT, size, size);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, source.id());
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, size, size, 0, GL_RGBA, GL_UNSIGNED_BYTE, texels.data());
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  Program program = mustLink(kFullScreen, {"relief.frag",
                                           "uniform sampler2D u_source;\nlayout(location = 0) out uvec4 o;\n"
                                           "void main() {\n"
                                           "  vec4 t = texelFetch(u_source, ivec2(gl_FragCoord.xy), 0);\n"
                                           "  o = uvec4(uint(t.r * 255.0 + 0.5) * 256u + uint(t.g * 255.0 + 0.5));\n"
                                           "}\n"});
  program.use();
  glUniform1i(program.uniform("u_source"), 0);
  drawFullScreen();
  std::vector<uint32_t> out(size * size * 4);
  glReadPixels(0, 0, size, size, GL_RGBA_INTEGER, GL_UNSIGNED_INT, out.data());
  for (uint32_t q = 0; q < 65536; ++q) ASSERT_EQ(out[q * 4], q);
}

TEST(Programs, AssemblePutsVersionPrecisionDefinesAndIncludesOnce) {
  Result<std::string> gl = assembleShader(Api::kGl33, "page_table.h", {{"ANSWER", "42"}}, true);
  ASSERT_TRUE(gl.ok()) << gl.error().text();
  EXPECT_TRUE(gl->starts_with("#version 330 core\n"));
  EXPECT_NE(gl->find("#define ANSWER 42\n"), std::string::npos);
  EXPECT_NE(gl->find("#define RELIEVO_FRAGMENT 1\n"), std::string::npos);
  EXPECT_EQ(gl->find("#include"), std::string::npos) << "the includes of C++ stay out";
  Result<std::string> es = assembleShader(Api::kEs30, "page_table.h", {}, false);
  ASSERT_TRUE(es.ok());
  EXPECT_TRUE(es->starts_with("#version 300 es\n"));
  for (const char* type : {"float", "int", "sampler2D", "usampler2D", "sampler2DArray", "usampler2DArray"})
    EXPECT_NE(es->find(std::string("precision highp ") + type + ";\n"), std::string::npos) << type;
  EXPECT_NE(es->find("#define RELIEVO_VERTEX 1\n"), std::string::npos);

  Result<std::string> missing = assembleShader(Api::kGl33, "no_such.frag", {}, true);
  ASSERT_FALSE(missing.ok());
  EXPECT_NE(missing.error().text().find("no_such.frag"), std::string::npos);
}

TEST(Programs, ADefineChoosesTheVariant) {
  Target target = makeTarget(GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE, 1, 1);
  const ShaderText fragment = {"define.frag",
                               "layout(location = 0) out vec4 o;\nvoid main() {\n#ifdef RED\n  o = vec4(float(RED), "
                               "0.0, 0.0, 1.0);\n#else\n  o = vec4(0.0, 1.0, 0.0, 1.0);\n#endif\n}\n"};
  for (bool red : {true, false}) {
    Program::Source source;
    if (red) source.defines = {{"RED", "1"}};
    Program program = mustLink(kFullScreen, fragment, source);
    program.use();
    drawFullScreen();
    uint8_t px[4] = {};
    glReadPixels(0, 0, 1, 1, GL_RGBA, GL_UNSIGNED_BYTE, px);
    EXPECT_EQ(px[0], red ? 255 : 0);
    EXPECT_EQ(px[1], red ? 0 : 255);
  }
}

TEST(Programs, ACompileErrorNamesFileAndLine) {
  // The error stands on line 4, after an include whose lines must not count.
  const ShaderText broken = {"broken.frag",
                             "#include \"page_table.h\"\n"
                             "layout(location = 0) out vec4 o;\n"
                             "void main() {\n"
                             "  o = no_such_function(1.0);\n"
                             "}\n"};
  Result<Program> program =
      Program::linkTexts(gltest::api(), kFullScreen, broken, {.defines = {{"A", "1"}, {"B", "2"}}});
  ASSERT_FALSE(program.ok());
  const std::string text = program.error().text();
  EXPECT_EQ(program.error().kind, ErrorKind::kRuntime);
  EXPECT_NE(text.find("fragment shader does not compile"), std::string::npos) << text;
  EXPECT_NE(text.find("broken.frag:4"), std::string::npos) << text;
  EXPECT_NE(text.find("   4 |   o = no_such_function(1.0);"), std::string::npos) << text;

  const ShaderText no_include = {"lost.frag", "// one\n#include \"nowhere.glsl\"\nvoid main() {}\n"};
  program = Program::linkTexts(gltest::api(), kFullScreen, no_include, {});
  ASSERT_FALSE(program.ok());
  EXPECT_NE(program.error().text().find("lost.frag: line 2"), std::string::npos) << program.error().text();
  EXPECT_NE(program.error().text().find("nowhere.glsl"), std::string::npos);
}

TEST(Programs, ALinkErrorNamesBothFiles) {
  const ShaderText gives = {"gives.vert",
                            "out vec2 v_mismatch;\nvoid main() { v_mismatch = vec2(1.0); gl_Position = vec4(0.0); }\n"};
  const ShaderText requests = {"wants.frag",
                               "in vec3 v_mismatch;\nlayout(location = 0) out vec4 o;\n"
                               "void main() { o = vec4(v_mismatch, 1.0); }\n"};
  Result<Program> program = Program::linkTexts(gltest::api(), gives, requests, {});
  ASSERT_FALSE(program.ok());
  EXPECT_NE(program.error().text().find("gives.vert + wants.frag"), std::string::npos) << program.error().text();
  EXPECT_NE(program.error().text().find("v_mismatch"), std::string::npos) << program.error().text();
}

TEST(Programs, AttributesGetTheirPlaceByOrder) {
  const ShaderText vertex = {"attributes.vert",
                             "in vec4 a_second;\nin vec4 a_first;\nout vec4 v_out;\n"
                             "void main() { v_out = a_first + 2.0 * a_second; gl_Position = vec4(0.0); }\n"};
  const ShaderText fragment = {"none.frag", "void main() {}\n"};
  Program program = mustLink(vertex, fragment, {.attributes = {"a_first", "a_second"}, .feedback_varyings = {"v_out"}});
  EXPECT_EQ(glGetAttribLocation(program.id(), "a_first"), 0);
  EXPECT_EQ(glGetAttribLocation(program.id(), "a_second"), 1);
  EXPECT_EQ(program.uniform("u_absent"), -1);
}

TEST(Programs, MoveLeavesTheSourceEmpty) {
  Program a = mustLink(kFullScreen, {"none.frag", "void main() {}\n"});
  const GLuint id = a.id();
  Program b = std::move(a);
  EXPECT_EQ(a.id(), 0u);
  EXPECT_EQ(b.id(), id);
  b = Program();
  EXPECT_EQ(glIsProgram(id), GL_FALSE);
}

// shaders/page_table.h on the GPU, by transform feedback: 10,000 random keys.
std::vector<std::array<uint32_t, 4>> hashesOnGpu(const std::vector<std::array<uint32_t, 4>>& keys, const char* body) {
  const ShaderText vertex = {"hash.vert", std::string("#include \"page_table.h\"\n"
                                                      "in uvec4 a_key;\nflat out uvec4 v_hash;\n"
                                                      "void main() {\n  gl_Position = vec4(0.0);\n") +
                                              body + "}\n"};
  const ShaderText fragment = {"none.frag", "void main() {}\n"};
  Program program = mustLink(vertex, fragment, {.attributes = {"a_key"}, .feedback_varyings = {"v_hash"}});
  // A framebuffer must be bound, also though nothing is rasterised: without one the feedback returns zeros.
  Target target = makeTarget(GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE, 1, 1);
  const GLsizeiptr bytes = static_cast<GLsizeiptr>(keys.size() * sizeof keys[0]);
  Buffer in = Buffer::create("keys"), out = Buffer::create("hashes");
  VertexArray vertex_array = VertexArray::create("keys");
  glBindVertexArray(vertex_array.id());
  glBindBuffer(GL_ARRAY_BUFFER, in.id());
  glBufferData(GL_ARRAY_BUFFER, bytes, keys.data(), GL_STATIC_DRAW);
  glEnableVertexAttribArray(0);
  glVertexAttribIPointer(0, 4, GL_UNSIGNED_INT, 0, nullptr);
  glBindBuffer(GL_TRANSFORM_FEEDBACK_BUFFER, out.id());
  glBufferData(GL_TRANSFORM_FEEDBACK_BUFFER, bytes, nullptr, GL_STATIC_READ);
  glBindBufferBase(GL_TRANSFORM_FEEDBACK_BUFFER, 0, out.id());
  program.use();
  glEnable(GL_RASTERIZER_DISCARD);
  glBeginTransformFeedback(GL_POINTS);
  glDrawArrays(GL_POINTS, 0, static_cast<GLsizei>(keys.size()));
  glEndTransformFeedback();
  glDisable(GL_RASTERIZER_DISCARD);
  std::vector<std::array<uint32_t, 4>> result(keys.size());
  const void* mapped = glMapBufferRange(GL_TRANSFORM_FEEDBACK_BUFFER, 0, bytes, GL_MAP_READ_BIT);
  EXPECT_NE(mapped, nullptr);
  if (mapped) std::memcpy(result.data(), mapped, static_cast<size_t>(bytes));
  glUnmapBuffer(GL_TRANSFORM_FEEDBACK_BUFFER);
  glBindBufferBase(GL_TRANSFORM_FEEDBACK_BUFFER, 0, 0);
  glBindVertexArray(0);
  return result;
}

TEST(Shaders, PageHashesAreTheSameInGlslAndCpp) {
  const uint32_t seed = 20261121;
  std::mt19937 engine(seed);
  auto random = [&] { return static_cast<uint32_t>(engine()); };
  std::vector<std::array<uint32_t, 4>> keys(10000), expected;
  for (auto& k : keys) k = {random(), random(), random(), (1u << (random() % 24)) - 1};
  keys[0] = {0, 0, 0, 0}, keys[1] = {~0u, ~0u, ~0u, ~0u};
  for (const auto& k : keys) {
    const uint32_t h = shader::pageHash(k[0], k[1], k[2]);
    expected.push_back({h, shader::pageProbe0(h, k[3]), shader::pageProbe1(h, k[3]), k[0]});
  }
  EXPECT_EQ(hashesOnGpu(keys,
                        "  uint h = pageHash(a_key.x, a_key.y, a_key.z);\n"
                        "  v_hash = uvec4(h, pageProbe0(h, a_key.w), pageProbe1(h, a_key.w), a_key.x);\n"),
            expected)
      << "seed " << seed;
  // Negative control: another seed must be seen.
  EXPECT_NE(hashesOnGpu(keys,
                        "  uint h = pageHash(a_key.x, a_key.y, a_key.z + 1u);\n"
                        "  v_hash = uvec4(h, pageProbe0(h, a_key.w), pageProbe1(h, a_key.w), a_key.x);\n"),
            expected);
}

TEST(Shaders, EmbeddedTextsAreTheFiles) {
  ASSERT_GE(shaderNames().size(), 5u);
  for (std::string_view name : shaderNames()) {
    std::ifstream file(std::string(RELIEVO_SHADER_DIR) + "/" + std::string(name), std::ios::binary);
    ASSERT_TRUE(file) << name;
    std::ostringstream text;
    text << file.rdbuf();
    EXPECT_TRUE(shaderSource(name) == text.str()) << name << " differs; was it edited after the last build?";
  }
  EXPECT_TRUE(shaderSource("no_such_file").empty());
}

}  // namespace gl_gltest
}  // namespace relievo::gl
