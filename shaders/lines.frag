// lines.frag - the wireframe.
out vec4 o_colour;
void main() { o_colour = vec4(0.05, 0.9, 0.55, 1.0); }
