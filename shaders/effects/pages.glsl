// pages.glsl - the texture level of every pixel as a tint, its page's edges black, or red where a finer page is wanted.
vec3 effect_pages(vec3 colour, Shaded at) {
  int level = max(at.found, 0);
  vec2 local;
  nodeAtLevel(level, local);
  vec2 from_edge = min(local, 1.0 - local) / pixelIn(level, v_lod);
  colour = mix(colour, levelTint(at.found), 0.3);
  if (min(from_edge.x, from_edge.y) < 1.0) colour = at.found < at.wanted ? vec3(1.0, 0.1, 0.1) : vec3(0.0);
  return colour;
}
