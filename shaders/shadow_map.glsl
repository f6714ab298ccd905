// shadow_map.glsl - the share of the light from one direction that reaches a place of the surface, from a map of the
// surface's depths as the light sees it (src/render/shadow_pass.h).
uniform sampler2D u_depth;  // of the surface buffer
uniform vec2 u_seen;        // something is seen where depth lies between these two
uniform sampler2D u_shadow_map;

// The window's depth of a pixel; false: there is none, or nothing is seen.
bool depthAt(ivec2 pixel, out float depth) {
  ivec2 size = textureSize(u_depth, 0);
  if (pixel.x < 0 || pixel.y < 0 || pixel.x >= size.x || pixel.y >= size.y) return false;
  depth = texelFetch(u_depth, pixel, 0).r;
  return depth > u_seen.x && depth < u_seen.y;
}

// here: in texels of the map, and its depth. dx, dy: from it to the neighbouring pixels of the same surface. low, high:
// the map's first and last texel. nearer: 1 where a larger depth is nearer to the light, else -1.
float lightAt(vec3 here, vec3 dx, vec3 dy, ivec2 low, ivec2 high, float nearer, float bias) {
  // The plane of the surface at the pixel, as depth over the map: each of the map's texels is compared with that.
  float area = dx.x * dy.y - dx.y * dy.x;
  vec2 slope = vec2(0.0);
  if (abs(area) > 1e-6) slope = vec2(dx.z * dy.y - dy.z * dx.y, dy.z * dx.x - dx.z * dy.x) / area;
  // A plane that is steeper than this many biases a texel is seen edge on by the light.
  slope = clamp(slope, vec2(-8.0 * bias), vec2(8.0 * bias));
  vec2 corner = floor(here.xy - 0.5);
  vec2 f = here.xy - 0.5 - corner;
  float light = 0.0;
  for (int k = 0; k < 4; ++k) {
    ivec2 step = ivec2(k & 1, k >> 1);
    ivec2 texel = clamp(ivec2(corner) + step, low, high);
    float plane = here.z + dot(slope, vec2(texel) + 0.5 - here.xy);
    float above = (texelFetch(u_shadow_map, texel, 0).r - plane) * nearer;
    vec2 weight = mix(1.0 - f, f, vec2(step));
    if (above <= bias) light += weight.x * weight.y;
  }
  return light;
}
