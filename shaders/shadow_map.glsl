// shadow_map.glsl - the share of the light from one direction that reaches a pixel of the surface, from a map of the
// surface's depths as the light sees it (src/render/shadow_pass.h).
uniform sampler2D u_depth;  // of the surface buffer
uniform vec2 u_seen;        // something is seen where depth lies between these two
uniform sampler2D u_shadow_map;
uniform mat4 u_map_from_pixel;  // from a pixel's place and depth, 0..1, to texels of the map and its depth
uniform vec4 u_shadow;  // texels a side of the map; 1 where a larger depth is nearer to the light, else -1; bias; -

bool placeAt(ivec2 pixel, out vec3 place) {
  ivec2 size = textureSize(u_depth, 0);
  if (pixel.x < 0 || pixel.y < 0 || pixel.x >= size.x || pixel.y >= size.y) return false;
  float depth = texelFetch(u_depth, pixel, 0).r;
  if (depth <= u_seen.x || depth >= u_seen.y) return false;
  vec4 p = u_map_from_pixel * vec4((vec2(pixel) + 0.5) / vec2(size), depth, 1.0);
  place = p.xyz / p.w;
  return true;
}

// From a pixel to its neighbour on the same surface: of the two, the one whose depth differs less.
vec3 along(ivec2 pixel, ivec2 axis, vec3 here) {
  vec3 a, b;
  bool has_a = placeAt(pixel + axis, a), has_b = placeAt(pixel - axis, b);
  if (has_a && (!has_b || abs(a.z - here.z) <= abs(b.z - here.z))) return a - here;
  return has_b ? here - b : vec3(0.0);
}

// Where the pixel lies on the map, and from it to its neighbours on the same surface to the right and above; false: no
// surface is seen.
bool placesAt(ivec2 pixel, out vec3 here, out vec3 dx, out vec3 dy) {
  if (!placeAt(pixel, here)) return false;
  dx = along(pixel, ivec2(1, 0), here);
  dy = along(pixel, ivec2(0, 1), here);
  return true;
}

float lightAt(vec3 here, vec3 dx, vec3 dy) {
  // The plane of the surface at the pixel, as depth over the map: each of the map's texels is compared with that.
  float area = dx.x * dy.y - dx.y * dy.x;
  vec2 slope = vec2(0.0);
  if (abs(area) > 1e-6) slope = vec2(dx.z * dy.y - dy.z * dx.y, dy.z * dx.x - dx.z * dy.x) / area;
  // A plane that is steeper than this many biases a texel is seen edge on by the light.
  slope = clamp(slope, vec2(-8.0 * u_shadow.z), vec2(8.0 * u_shadow.z));
  vec2 corner = floor(here.xy - 0.5);
  vec2 f = here.xy - 0.5 - corner;
  ivec2 last = ivec2(int(u_shadow.x) - 1);
  float light = 0.0;
  for (int k = 0; k < 4; ++k) {
    ivec2 step = ivec2(k & 1, k >> 1);
    ivec2 texel = clamp(ivec2(corner) + step, ivec2(0), last);
    float plane = here.z + dot(slope, vec2(texel) + 0.5 - here.xy);
    float nearer = (texelFetch(u_shadow_map, texel, 0).r - plane) * u_shadow.y;
    vec2 weight = mix(1.0 - f, f, vec2(step));
    if (nearer <= u_shadow.z) light += weight.x * weight.y;
  }
  return light;
}
