#include "src/viewer/hud.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <numbers>
#include <utility>
#include <vector>

#include <imgui.h>

#include "src/render/overlay_pass.h"

namespace relievo {
namespace {

static_assert(sizeof(ImDrawVert) == sizeof(OverlayVertex) && offsetof(ImDrawVert, uv) == offsetof(OverlayVertex, u) &&
              offsetof(ImDrawVert, col) == offsetof(OverlayVertex, rgba) && sizeof(ImDrawIdx) == sizeof(uint16_t));

constexpr const char* kHelp[][2] = {{"Left drag", "turn about the point under the mouse"},
                                    {"Middle drag, Shift + left drag", "move"},
                                    {"Wheel", "zoom to the point under the mouse"},
                                    {"Right drag, L + move", "light"},
                                    {"O", "orthographic (one scale everywhere) or perspective"},
                                    {"Space", "play or pause a scene that moves"},
                                    {"R", "reset camera and light"},
                                    {"N", "next of several lights to move"},
                                    {"M", "show slope, curvature, depth, or the light again"},
                                    {"H, G", "shadows, gloss"},
                                    {"A", "ambient occlusion: joints and folds darker"},
                                    {"W", "wireframe"},
                                    {"P", "pages by texture level"},
                                    {"S", "snapshot (PNG)"},
                                    {"F1", "this help"},
                                    {"F2", "figures: pages by state, bytes, latency"},
                                    {"Esc", "quit"}};

constexpr ImGuiWindowFlags kPassive = ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoInputs |
                                      ImGuiWindowFlags_NoNav | ImGuiWindowFlags_NoSavedSettings |
                                      ImGuiWindowFlags_AlwaysAutoResize;

// The hemisphere of directions seen from above: the dot is the light.
void drawLightGauge(const std::array<double, 3>& light, const std::string& name, float scale) {
  const float radius = 34 * scale;
  const ImVec2 corner = ImGui::GetCursorScreenPos();
  const ImVec2 centre(corner.x + radius, corner.y + radius);
  ImDrawList* list = ImGui::GetWindowDrawList();
  list->AddCircle(centre, radius, IM_COL32(200, 200, 200, 160), 48, scale);
  list->AddCircle(centre, radius * 0.5f, IM_COL32(200, 200, 200, 60), 48, scale);
  const ImVec2 dot(centre.x + radius * static_cast<float>(light[0]), centre.y - radius * static_cast<float>(light[1]));
  list->AddLine(centre, dot, IM_COL32(255, 214, 120, 140), scale);
  list->AddCircleFilled(dot, 5 * scale, IM_COL32(255, 214, 120, 255), 24);
  ImGui::Dummy(ImVec2(2 * radius, 2 * radius));
  if (!name.empty()) ImGui::TextUnformatted(name.c_str());
  const double degrees = 180 / std::numbers::pi;
  ImGui::Text("light %.2f, %.2f, %.2f", light[0], light[1], light[2]);
  ImGui::Text("%.0f deg above the surface", std::asin(std::clamp(light[2], -1.0, 1.0)) * degrees);
}

// The first column stands left, numbers stand right.
void drawFigures(const HudFigures& figures, float gap) {
  std::vector<float> width;
  for (const auto& row : figures.planes) {
    width.resize(std::max(width.size(), row.size()));
    for (size_t i = 0; i < row.size(); ++i) width[i] = std::max(width[i], ImGui::CalcTextSize(row[i].c_str()).x);
  }
  const float left = ImGui::GetCursorPosX();
  for (const auto& row : figures.planes) {
    float x = left;
    for (size_t i = 0; i < row.size(); ++i) {
      if (i > 0) ImGui::SameLine(x + width[i] - ImGui::CalcTextSize(row[i].c_str()).x);
      ImGui::TextUnformatted(row[i].c_str());
      x += width[i] + 1.5f * gap;
    }
  }
  for (const std::string& line : figures.lines) ImGui::TextUnformatted(line.c_str());
}

}  // namespace

std::string hudLine(const HudState& s) {
  char text[200];
  std::snprintf(text, sizeof text, "%.0f fps  %.1f ms%s%s   pages %u of %u, %u missing   error at most %.2f px", s.fps,
                s.frame_ms, s.given_up.empty() ? "" : ", less ", s.given_up.c_str(), s.resident_pages, s.slots,
                s.missing_pages, s.predicted_error_px);
  std::string line = text;
  if (s.predicted_error_px > s.error_px) {
    std::snprintf(text, sizeof text, " %s (asked for %.1f)", s.missing_pages > 0 ? "so far" : "in places", s.error_px);
    line += text;
  }
  if (s.mm_per_px > 0) {
    std::snprintf(text, sizeof text, s.size_known ? "   %.4g mm a px" : "   %.4g px of the artwork a px", s.mm_per_px);
    line += text;
  }
  if (s.duration_s > 0) {
    std::snprintf(text, sizeof text, "   %.1f of %.1f s, %s", s.time_s, s.duration_s, s.playing ? "playing" : "paused");
    line += text;
  }
  std::string shown = !s.unlit ? "" : s.shading.empty() ? "unlit" : s.shading;
  for (const auto& [on, name] : {std::pair{s.shadows, "shadows"}, std::pair{s.ambient_occlusion, "ambient occlusion"},
                                 std::pair{s.gloss, "gloss"}})
    if (on) shown += (shown.empty() ? "" : ", ") + std::string(name);
  return shown.empty() ? line : line + "   " + shown;
}

struct Hud::Impl {
  ImGuiContext* context = nullptr;
  float scale = 1;
  OverlayPass pass;
  std::vector<OverlayVertex> vertices;
  std::vector<uint16_t> indices;
  std::vector<OverlayCommand> commands;

  void layOut(const HudState& state) const {
    const ImVec2 display = ImGui::GetIO().DisplaySize;
    const float edge = 8 * scale;

    ImGui::SetNextWindowPos(ImVec2(edge, edge));
    ImGui::SetNextWindowBgAlpha(0.55f);
    ImGui::Begin("figures", nullptr, kPassive);
    ImGui::TextUnformatted(hudLine(state).c_str());
    if (!state.message.empty()) ImGui::TextUnformatted(state.message.c_str());
    const float line_bottom = ImGui::GetWindowPos().y + ImGui::GetWindowSize().y;
    ImGui::End();

    if (state.figures) {
      ImGui::SetNextWindowPos(ImVec2(edge, line_bottom + edge));
      ImGui::SetNextWindowBgAlpha(0.7f);
      ImGui::Begin("pages", nullptr, kPassive);
      drawFigures(*state.figures, edge);
      ImGui::End();
    }

    if (state.show_light && !state.unlit) {
      ImGui::SetNextWindowPos(ImVec2(edge, display.y - edge), ImGuiCond_Always, ImVec2(0, 1));
      ImGui::SetNextWindowBgAlpha(0.55f);
      ImGui::Begin("light", nullptr, kPassive);
      drawLightGauge(state.light, state.held_light, scale);
      ImGui::End();
    }
    if (state.help) {
      ImGui::SetNextWindowPos(ImVec2(display.x / 2, display.y / 2), ImGuiCond_Always, ImVec2(0.5f, 0.5f));
      ImGui::SetNextWindowBgAlpha(0.85f);
      ImGui::Begin("help", nullptr, kPassive);
      float widest = 0;
      for (const auto& row : kHelp) widest = std::max(widest, ImGui::CalcTextSize(row[0]).x);
      for (const auto& row : kHelp) {
        ImGui::TextUnformatted(row[0]);
        ImGui::SameLine(widest + 4 * edge);
        ImGui::TextUnformatted(row[1]);
      }
      ImGui::End();
    }
  }
  Impl(ImGuiContext* c, float s, OverlayPass&& p) : context(c), scale(s), pass(std::move(p)) {}
  ~Impl() { ImGui::DestroyContext(context); }
};

Hud::Hud(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Hud::~Hud() = default;

Result<std::unique_ptr<Hud>> Hud::create(gl::Api api, double scale) {
  ImGuiContext* context = ImGui::CreateContext();
  ImGuiIO& io = ImGui::GetIO();
  io.IniFilename = nullptr;  // nothing is kept between runs, and no file is left behind
  io.LogFilename = nullptr;
  // The built-in font is drawn for 13 px: whole multiples stay sharp.
  const float text_scale = static_cast<float>(std::max(1.0, std::round(scale)));
  ImFontConfig font;
  font.SizePixels = 13 * text_scale;
  io.Fonts->AddFontDefault(&font);
  unsigned char* alpha = nullptr;
  int width = 0, height = 0;
  io.Fonts->GetTexDataAsAlpha8(&alpha, &width, &height);
  Result<OverlayPass> pass =
      OverlayPass::create(api, width, height, {alpha, static_cast<size_t>(width) * static_cast<size_t>(height)});
  if (!pass) {
    ImGui::DestroyContext(context);
    return pass.error();
  }
  ImGui::StyleColorsDark();
  ImGui::GetStyle().WindowRounding = 4;
  ImGui::GetStyle().WindowBorderSize = 0;
  ImGui::GetStyle().ScaleAllSizes(text_scale);
  return std::unique_ptr<Hud>(new Hud(std::make_unique<Impl>(context, text_scale, std::move(*pass))));
}

void Hud::draw(const HudState& state, int width_px, int height_px) {
  Impl& self = *impl_;
  ImGui::SetCurrentContext(self.context);
  ImGuiIO& io = ImGui::GetIO();
  io.DisplaySize = ImVec2(static_cast<float>(width_px), static_cast<float>(height_px));
  io.DeltaTime = 1.0f / 60;  // nothing here is animated
  // ImGui fits a window to its content one frame late; nothing may come after this frame, so it is laid out twice.
  ImGui::NewFrame();
  self.layOut(state);
  ImGui::EndFrame();
  ImGui::NewFrame();
  self.layOut(state);
  ImGui::Render();

  const ImDrawData* data = ImGui::GetDrawData();
  self.vertices.clear();
  self.indices.clear();
  self.commands.clear();
  for (int i = 0; i < data->CmdListsCount; ++i) {
    const ImDrawList& list = *data->CmdLists[i];
    const uint32_t first_vertex = static_cast<uint32_t>(self.vertices.size());
    const uint32_t first_index = static_cast<uint32_t>(self.indices.size());
    for (const ImDrawVert& v : list.VtxBuffer)
      self.vertices.push_back({.x = v.pos.x, .y = v.pos.y, .u = v.uv.x, .v = v.uv.y, .rgba = v.col});
    self.indices.insert(self.indices.end(), list.IdxBuffer.begin(), list.IdxBuffer.end());
    for (const ImDrawCmd& c : list.CmdBuffer) {
      OverlayCommand command;
      const float clip[4] = {c.ClipRect.x, c.ClipRect.y, c.ClipRect.z, c.ClipRect.w};
      for (int k = 0; k < 4; ++k)
        command.clip[k] = static_cast<int32_t>(k < 2 ? std::floor(clip[k]) : std::ceil(clip[k]));
      command.first_index = first_index + c.IdxOffset;
      command.indices = c.ElemCount;
      command.first_vertex = first_vertex + c.VtxOffset;
      self.commands.push_back(command);
    }
  }
  self.pass.draw(self.vertices, self.indices, self.commands, width_px, height_px);
}

}  // namespace relievo
