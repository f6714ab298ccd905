// srgb.glsl - the transfer function of sRGB and its inverse (CPU reference: src/base/srgb.h), of values from 0 on.
vec3 linearFromSrgb(vec3 encoded) {
  return mix(pow((encoded + 0.055) / 1.055, vec3(2.4)), encoded / 12.92, lessThanEqual(encoded, vec3(0.04045)));
}
vec3 srgbFromLinear(vec3 light) {
  return mix(1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, light * 12.92, lessThanEqual(light, vec3(0.0031308)));
}
