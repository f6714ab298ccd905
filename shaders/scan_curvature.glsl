// scan_curvature.glsl - a scan's mean curvature at a pixel, 1/mm, from the normals and places of the pixels around it
// (src/engine/effects/relief_shading.h states the fit; CPU reference: scanCurvature()).
uniform highp usampler2D u_normals;  // floats as bits (src/render/normals_target.h)
uniform vec4 u_pixel_from_eye[4];    // columns; the inverse of u_eye_from_pixel

const int kCurvatureTaps = 32;

vec3 normalAt(ivec2 pixel) { return normalize(uintBitsToFloat(texelFetch(u_normals, pixel, 0).xyz)); }

float scanCurvature() {
  ivec2 pixel = ivec2(gl_FragCoord.xy), size = textureSize(u_kept_depth, 0);
  float depth = texelFetch(u_kept_depth, pixel, 0).r;
  vec3 here = eyePlace(vec2(pixel) + 0.5, depth), normal = normalAt(pixel);
  float pixel_mm = length(eyePlace(vec2(pixel) + vec2(1.5, 0.5), depth) - here);
  float radius = max(u_shading.w, 1.5 * pixel_mm);
  vec3 side = normalize(cross(normal, abs(normal.z) < 0.7 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0)));
  vec3 other = cross(normal, side);
  mat4 pixel_from_eye = mat4(u_pixel_from_eye[0], u_pixel_from_eye[1], u_pixel_from_eye[2], u_pixel_from_eye[3]);
  // Sums over the places: of the differences of normal and of place in the tangent plane, and of their products.
  float count = 1.0;
  vec2 turned = vec2(0.0), moved = vec2(0.0);
  mat2 products = mat2(0.0), squares = mat2(0.0);
  for (int k = 0; k < kCurvatureTaps; ++k) {
    // Evenly over the disc: by the golden angle (Vogel 1979).
    float angle = 2.39996323 * float(k), away = radius * sqrt((float(k) + 0.5) / float(kCurvatureTaps));
    vec4 aim = pixel_from_eye * vec4(here + away * (cos(angle) * side + sin(angle) * other), 1.0);
    ivec2 at = ivec2(floor(aim.xy / aim.w * vec2(size)));
    if (at == pixel || min(at.x, at.y) < 0 || at.x >= size.x || at.y >= size.y) continue;
    float there = texelFetch(u_kept_depth, at, 0).r;
    if (there == u_shading.z) continue;
    vec3 way = eyePlace(vec2(at) + 0.5, there) - here, turn = normalAt(at) - normal;
    if (dot(way, way) > 2.25 * radius * radius) continue;  // another part of the surface
    vec2 d = vec2(dot(way, side), dot(way, other)), n = vec2(dot(turn, side), dot(turn, other));
    count += 1.0;
    moved += d;
    turned += n;
    products += outerProduct(n, d);
    squares += outerProduct(d, d);
  }
  products -= outerProduct(turned, moved) / count;
  squares -= outerProduct(moved, moved) / count;
  float trace = squares[0][0] + squares[1][1], area = squares[0][0] * squares[1][1] - squares[0][1] * squares[0][1];
  if (area <= 1e-4 * trace * trace) return 0.0;  // places in a line say nothing of the other way
  return 0.5 *
         (products[0][0] * squares[1][1] + products[1][1] * squares[0][0] -
          squares[0][1] * (products[0][1] + products[1][0])) /
         area;
}
