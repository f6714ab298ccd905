// average.frag - the average of a picture's samples (src/render/sample_stack.h): colour in linear light over the samples
// that show the artwork, alpha the share of them. CPU reference: multisampling_gltest.cpp.
#include "srgb.glsl"

uniform sampler2DArray u_samples;  // sRGB; alpha 1: the artwork, 0: none of it
uniform int u_count;               // the samples so far, from layer 0 on
uniform vec2 u_scale;              // pixels of a sample for one of the target
uniform vec4 u_behind;             // alpha 1: what shows where the artwork is not, in linear light; 0: alpha is kept

out vec4 o_colour;

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy * u_scale);
  vec3 light = vec3(0.0);
  float covered = 0.0;
  for (int i = 0; i < u_count; ++i) {
    vec4 one = texelFetch(u_samples, ivec3(pixel, i), 0);
    light += linearFromSrgb(one.rgb) * one.a;
    covered += one.a;
  }
  float share = covered / float(u_count);
  vec3 mean = light / max(covered, 1.0);
  o_colour = u_behind.a > 0.0 ? vec4(srgbFromLinear(mix(u_behind.rgb, mean, share)), 1.0)
                              : vec4(srgbFromLinear(mean), share);
}
