// depth_probe.frag - the depth of one pixel as the bits of a float: OpenGL ES reads no depth buffer back
// (src/render/depth_probe.h).
uniform sampler2D u_depth;
uniform ivec2 u_pixel;

out uvec4 o_bits;

void main() { o_bits = uvec4(floatBitsToUint(texelFetch(u_depth, u_pixel, 0).r), 0u, 0u, 0u); }
