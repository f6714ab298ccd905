// ptm.glsl - the functions of a PTM under the unit vector towards a light (CPU reference: ptmBasis() of
// src/artwork/bases/ptm.h, which says what becomes of light from behind).
void basisFunctions(vec3 light, out float functions[COEFFICIENTS]) {
  vec2 at = light.xy;
  float sideways = length(at);
  if (light.z < 0.0 && sideways > 0.0) at /= sideways;
  functions[0] = at.x * at.x;
  functions[1] = at.y * at.y;
  functions[2] = at.x * at.y;
  functions[3] = at.x;
  functions[4] = at.y;
  functions[5] = 1.0;
  if (light.z < 0.0 && sideways < kBehind) {
    float share = sideways / kBehind;
    functions[0] = mix(0.5, functions[0], share);
    functions[1] = mix(0.5, functions[1], share);
    for (int k = 2; k < 5; ++k) functions[k] *= share;
  }
}
