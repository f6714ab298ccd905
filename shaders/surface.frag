// surface.frag - the surface buffer: what is seen at each pixel, before any texture is read
// (src/render/surface_target.h). Shading waits for a pass over the pixels: so its cost follows the pixels, not the
// triangles (a driver shades whole blocks of pixels for each of them), and a feedback pass needs no geometry of its
// own.
#include "common.glsl"
#include "gradient.glsl"

uniform ivec4 u_artwork;  // finest texture level; - ; -; -

in vec2 v_uv;
flat in uvec2 v_instance;  // index in the list of instances, + 1, grid level << 28; the node's level

// v_uv; v_instance.x; square of the texture's gradient, texels of the finest level a pixel. TWO_SIDED: below zero
// where triangles are seen from behind.
layout(location = 0) out uvec4 o_surface;
#ifdef ANISOTROPY
layout(location = 1) out uvec4 o_gradient;  // d(uv)/dx, d(uv)/dy in texels of the finest level
#endif

void main() {
  // From the exact derivatives of the perspective mapping: v_uv / w and 1 / w are linear on screen, so their
  // differences do not depend on the step, and d(uv)/dx = (d(uv/w)/dx - uv d(1/w)/dx) / (1/w). Taken of the virtual
  // coordinate, before any fract().
  float iw = gl_FragCoord.w;
  vec2 q = v_uv * iw;
  // texels of the finest level over the node
  float scale = float(kPagePx) * powerOfTwo(u_artwork.x - int(v_instance.y)) / iw;
  vec2 dx = (dFdx(q) - v_uv * dFdx(iw)) * scale;
  vec2 dy = (dFdy(q) - v_uv * dFdy(iw)) * scale;
  float rho2 = max(dot(dx, dx), dot(dy, dy));
  o_surface = uvec4(floatBitsToUint(v_uv), v_instance.x, floatBitsToUint(rho2));
#ifdef TWO_SIDED
  if (!gl_FrontFacing) o_surface.w |= kSignBit;
#endif
#ifdef ANISOTROPY
  o_gradient = floatBitsToUint(vec4(dx, dy));
#endif
}
