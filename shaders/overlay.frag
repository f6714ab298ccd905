// overlay.frag - colour times the glyph texture's coverage.
in vec2 v_uv;
in vec4 v_colour;
uniform sampler2D u_glyphs;
layout(location = 0) out vec4 o_colour;

void main() { o_colour = vec4(v_colour.rgb, v_colour.a * texture(u_glyphs, v_uv).r); }
