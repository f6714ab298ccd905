// nearest_depth.frag - a depth buffer into another one of the same size, whose depth test keeps what is nearer
// (src/render/nearest_depth.h).
uniform sampler2D u_depth;

void main() { gl_FragDepth = texelFetch(u_depth, ivec2(gl_FragCoord.xy), 0).r; }
