// exposure.glsl - exposure and tone (src/engine/effects/exposure.cpp). u_exposure.x: stops; y: the light that becomes
// white.
uniform vec4 u_exposure;

vec3 effect_exposure(vec3 colour, Shaded at) {
  colour = max(colour, 0.0);
  vec3 light = mix(pow((colour + 0.055) / 1.055, vec3(2.4)), colour / 12.92, lessThanEqual(colour, vec3(0.04045)));
  light *= exp2(u_exposure.x);
  light = light * (1.0 + light / (u_exposure.y * u_exposure.y)) / (1.0 + light);
  return mix(1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, light * 12.92, lessThanEqual(light, vec3(0.0031308)));
}
