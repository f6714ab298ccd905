// overlay.vert - 2D triangles in pixels, origin top left (src/render/overlay_pass.h).
in vec2 a_px;
in vec2 a_uv;
in vec4 a_colour;
uniform vec2 u_size_px;
out vec2 v_uv;
out vec4 v_colour;

void main() {
  v_uv = a_uv;
  v_colour = a_colour;
  gl_Position = vec4(2.0 * a_px.x / u_size_px.x - 1.0, 1.0 - 2.0 * a_px.y / u_size_px.y, 0.0, 1.0);
}
