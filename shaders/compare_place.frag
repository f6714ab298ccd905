// compare_place.frag - which place of the artwork is seen at a pixel, for measuring strategies
// (src/render/strategy_pass.h).
in vec2 v_uv;              // place in the instance's node, 0..1
flat in uvec2 v_instance;  // index in the list of instances, + 1, in the low 28 bits

layout(location = 0) out uvec4 o_place;  // v_uv; index + 1; how far v_uv goes from this pixel to the next one

void main() {
  vec2 dx = abs(dFdx(v_uv)), dy = abs(dFdy(v_uv));
  float step_uv = max(max(dx.x, dx.y), max(dy.x, dy.y));
  o_place = uvec4(floatBitsToUint(v_uv), v_instance.x & 0x0FFFFFFFu, floatBitsToUint(step_uv));
}
