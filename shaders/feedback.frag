// feedback.frag - which node of the texture each pixel wants (texturing/feedback.h).
#include "texture_lookup.glsl"

out uvec4 o_want;

void main() {
  float lod = virtualTextureLod();
#ifdef TRILINEAR
  int level = u_depth.x - int(floor(lod));
#else
  int level = u_depth.x - int(floor(lod + 0.5));
#endif
  vec2 local;
  uvec4 node = nodeAtLevel(level, local);
  o_want = uvec4(1u | (node.y << 8u), node.x, node.z, node.w);
}
