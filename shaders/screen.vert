// screen.vert - one triangle that covers the screen, on the far plane: a depth test of GREATER leaves out where nothing is seen.
in vec2 a_corner;  // -1 or 3
void main() { gl_Position = vec4(a_corner, 1.0, 1.0); }
