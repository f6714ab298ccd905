// feedback.frag - which node of the texture each pixel wants (texturing/stream/feedback.h).
#include "texture_lookup.glsl"

#ifdef ANISOTROPY
uniform int u_tap_phase;  // 0..6; over seven of them each pixel asks for every node that its taps can touch
#endif

uniform ivec4 u_sample;  // pixel (i, j) of the pass is pixel (i, j) * x + (y, z) of the picture

uniform sampler2D u_depth;  // of the surface buffer
uniform vec2 u_seen;         // something is seen where depth lies between these two

out uvec4 o_request;

void main() {
  o_request = uvec4(0u);
  ivec2 pixel = ivec2(gl_FragCoord.xy) * u_sample.x + u_sample.yz;
  float depth = texelFetch(u_depth, pixel, 0).r;
  if (depth <= u_seen.x || depth >= u_seen.y) return;
  loadSurface(pixel);
#ifdef ANISOTROPY
  Footprint footprint;
  float lod = virtualTextureLod(footprint);
#else
  float lod = virtualTextureLod();
#endif
#ifdef TAILS
  float beyond = lod - float(u_artwork.x);
#ifdef TRILINEAR
  if (beyond >= u_tail_reach) return;
#else
  if (tailShare(beyond) >= 0.5) return;
#endif
  lod = min(lod, float(u_artwork.x));
#endif
#ifdef TRILINEAR
  int level = u_artwork.x - int(floor(lod));
#else
  int level = u_artwork.x - int(floor(lod + 0.5));
#endif
#ifdef ANISOTROPY
  // The segment of taps is shorter than a page, so its nodes are among those at the corners of the two rectangles
  // between the fragment and either end. Neighbouring pixels ask for different ones.
  int which = (int(gl_FragCoord.x) + 3 * int(gl_FragCoord.y) + u_tap_phase) % 7;
  float sign_of_end = which > 3 ? -1.0 : 1.0;
  int corner = which > 3 ? which - 3 : which;
  float end = tapAt(0, tapCount(footprint.ratio), footprint.ratio).x * sign_of_end;
  vec2 uv = tapPlace(end, footprint);
  if (corner == 0 || corner == 2) uv.x = v_uv.x;
  if (corner == 0 || corner == 3) uv.y = v_uv.y;
  Place place = placeAtLevel(level);
  toNodeAt(uv, place);
  uvec4 node = place.node;
#else
  vec2 local;
  uvec4 node = nodeAtLevel(level, local);
#endif
  o_request = uvec4(1u | (node.y << 8u), node.x, node.z, node.w);
}
