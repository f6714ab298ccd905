// compare_place.frag - which place of the artwork is seen at a pixel, for measuring strategies (src/render/strategy_pass.h).
in vec2 v_uv;              // place in the instance's node, 0..1
flat in uvec2 v_instance;  // index in the list of instances, + 1, in the low 28 bits

layout(location = 0) out uvec4 o_place;  // v_uv; index + 1; depth

void main() { o_place = uvec4(floatBitsToUint(v_uv), v_instance.x & 0x0FFFFFFFu, floatBitsToUint(gl_FragCoord.z)); }
