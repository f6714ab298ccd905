// gradient.glsl - when a texture gradient can be trusted.
// A gradient of zero, infinity or NaN asks for the coarsest level, never for the finest. squared: in texels of the
// finest level.
bool soundGradient(float squared) { return squared > 1e-12 && squared < 1e24; }
