// eye.glsl - each pixel's place, and the way from there to the viewer: in mm from the eye, along the artwork's axes.
uniform vec4 u_eye_from_pixel[4];  // columns: from a pixel's place and depth, 0..1, to mm from the eye
uniform vec4 u_viewer;  // w 0: the unit vector towards the viewer of an orthographic picture; 1: the viewer is the eye

// at: the pixel's place in the picture, 0..1.
vec3 placeAtDepth(vec2 at, float depth) {
  mat4 eye_from_pixel = mat4(u_eye_from_pixel[0], u_eye_from_pixel[1], u_eye_from_pixel[2], u_eye_from_pixel[3]);
  vec4 place = eye_from_pixel * vec4(at, depth, 1.0);
  return place.xyz / place.w;
}
vec3 wayToViewer(vec3 place) { return u_viewer.w > 0.0 ? -place : u_viewer.xyz; }
