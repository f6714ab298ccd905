// average.frag - the average of a picture's samples (src/render/sample_stack.h): colour in linear light over the
// samples that show the artwork, alpha the share of them. CPU reference: multisampling_gltest.cpp.
#include "srgb.glsl"

uniform sampler2DArray u_samples;  // sRGB, not multiplied by alpha, which is the share that shows the artwork
uniform ivec2 u_layers;            // the first, and the one after the last
uniform vec2 u_scale;              // pixels of a sample for one of the target
uniform vec4 u_behind;             // alpha 1: what shows where the artwork is not, in linear light; 0: alpha is kept

out vec4 o_colour;

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy * u_scale);
  vec3 light = vec3(0.0);
  float covered = 0.0;
  for (int i = u_layers.x; i < u_layers.y; ++i) {
    vec4 one = texelFetch(u_samples, ivec3(pixel, i), 0);
    light += linearFromSrgb(one.rgb) * one.a;
    covered += one.a;
  }
  float share = covered / float(u_layers.y - u_layers.x);
  vec3 mean = covered > 0.0 ? light / covered : vec3(0.0);
  o_colour = u_behind.a > 0.0 ? vec4(srgbFromLinear(mix(u_behind.rgb, mean, share)), 1.0)
                              : vec4(srgbFromLinear(mean), share);
}
