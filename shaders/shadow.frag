// shadow.frag - the share of the light that reaches each pixel of the surface (src/render/shadow_pass.h).
#include "shadow_map.glsl"

out vec4 o_light;

void main() {
  o_light = vec4(1.0);
  vec3 here, dx, dy;
  if (placesAt(ivec2(gl_FragCoord.xy), here, dx, dy)) o_light = vec4(lightAt(here, dx, dy));
}
