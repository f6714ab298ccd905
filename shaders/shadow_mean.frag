// shadow_mean.frag - the share of the light that reaches each pixel, from the sums of shadow_sum.frag.
uniform highp usampler2D u_sums;

out vec4 o_light;

void main() {
  uvec2 sums = texelFetch(u_sums, ivec2(gl_FragCoord.xy), 0).xy;
  o_light = vec4(sums.y > 0u ? float(sums.x) / float(sums.y) : 1.0);
}
