// screen.vert - one triangle that covers the screen, on the far plane: a depth test for what is farther leaves out
// where nothing is seen.
in vec3 a_corner;  // -1 or 3; the far plane's depth
void main() { gl_Position = vec4(a_corner, 1.0); }
