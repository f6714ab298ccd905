// lod.glsl - the level of the drawn patch as a tint, darker the finer its grid is, and the patch's edges black.
vec3 effect_lod(vec3 colour, Shaded at) {
  colour = mix(colour, levelTint(int(v_node.y)), 0.25 + 0.07 * float(v_grid_level));
  vec2 edge = min(v_uv, 1.0 - v_uv) / pixelIn(int(v_node.y), v_lod);
  if (min(edge.x, edge.y) < 1.0) colour = vec3(0.0);
  return colour;
}
