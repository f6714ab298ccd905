#include "geometry/ray_scene.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace relievo {
namespace {

constexpr size_t kPacket = 8;  // AVX2
// Two ways to build: by Morton codes, 0.08 s of one core a million triangles and 56 bytes each at its peak; by surface areas, 0.3 s and
// 37 bytes. Lines take the same time in both (0.08 us beside one another).
constexpr size_t kQuickUpTo = size_t{16} << 20;

// What a ray's id asks of the surfaces it meets.
enum RayKind : unsigned { kRayAny = 0, kRayUp = 1, kRayDown = 2 };  // up: along the line's direction

void facingFilter(const RTCFilterFunctionNArguments* args) {
  for (unsigned i = 0; i < args->N; ++i) {
    if (args->valid[i] != -1) continue;
    const unsigned kind = RTCRayN_id(args->ray, args->N, i);
    if (kind == kRayAny) continue;
    const float facing = RTCRayN_dir_x(args->ray, args->N, i) * RTCHitN_Ng_x(args->hit, args->N, i) +
                         RTCRayN_dir_y(args->ray, args->N, i) * RTCHitN_Ng_y(args->hit, args->N, i) +
                         RTCRayN_dir_z(args->ray, args->N, i) * RTCHitN_Ng_z(args->hit, args->N, i);
    if (kind == kRayUp ? !(facing > 0) : !(facing < 0)) args->valid[i] = 0;
  }
}

struct Corners {
  glm::dvec3 a, b, c;
};
Corners cornersOf(const TriMesh& mesh, uint32_t triangle) {
  const auto& t = mesh.triangles[triangle];
  return {mesh.positions_mm[t[0]], mesh.positions_mm[t[1]], mesh.positions_mm[t[2]]};
}

// Ericson, Real-Time Collision Detection, 5.1.5: the closest point by the Voronoi regions of the triangle's features.
SurfacePoint closestOnTriangle(const Corners& t, const glm::dvec3& p) {
  SurfacePoint out;
  const glm::dvec3 ab = t.b - t.a, ac = t.c - t.a, ap = p - t.a;
  const double d1 = glm::dot(ab, ap), d2 = glm::dot(ac, ap);
  const glm::dvec3 bp = p - t.b;
  const double d3 = glm::dot(ab, bp), d4 = glm::dot(ac, bp);
  const glm::dvec3 cp = p - t.c;
  const double d5 = glm::dot(ab, cp), d6 = glm::dot(ac, cp);
  const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  if (d1 <= 0 && d2 <= 0) {
  } else if (d3 >= 0 && d4 <= d3) {
    out.b1 = 1;
  } else if (d6 >= 0 && d5 <= d6) {
    out.b2 = 1;
  } else if (vc <= 0 && d1 >= 0 && d3 <= 0) {
    out.b1 = d1 / (d1 - d3);
  } else if (vb <= 0 && d2 >= 0 && d6 <= 0) {
    out.b2 = d2 / (d2 - d6);
  } else if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    out.b2 = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    out.b1 = 1 - out.b2;
  } else {
    const double sum = va + vb + vc;
    out.b1 = vb / sum;
    out.b2 = vc / sum;
  }
  out.along = glm::length(ap - out.b1 * ab - out.b2 * ac);
  return out;
}

struct ClosestQuery {
  const TriMesh* mesh;
  glm::dvec3 place;
  SurfacePoint best;
  double within;
  double slack;  // the place is rounded to float for Embree: as much further does it have to look
};

bool closestCallback(RTCPointQueryFunctionArguments* args) {
  auto& query = *static_cast<ClosestQuery*>(args->userPtr);
  SurfacePoint here = closestOnTriangle(cornersOf(*query.mesh, args->primID), query.place);
  here.triangle = args->primID;
  if (!(here.along <= query.within)) return false;
  if (here.along == query.within && query.best && query.best.triangle < here.triangle) return false;
  query.best = here;
  query.within = here.along;
  // Never so small that rounding hides a triangle that is just as near. Only ever shrinks.
  const float radius = static_cast<float>(here.along * (1 + 1e-6) + query.slack);
  if (radius >= args->query->radius) return false;
  args->query->radius = radius;
  return true;
}

// The plane of the triangle and the line, in double; a grazing hit, which that would throw far off, stays where Embree saw it.
SurfacePoint refined(const TriMesh& mesh, const Line& line, uint32_t triangle, double along, double b1, double b2) {
  SurfacePoint hit{triangle, b1, b2, along};
  const Corners t = cornersOf(mesh, triangle);
  const glm::dvec3 ab = t.b - t.a, ac = t.c - t.a, normal = glm::cross(ab, ac);
  const double steep = glm::dot(normal, line.direction);
  const double exact = glm::dot(normal, t.a - line.at) / steep;
  const double size = std::max({glm::length(ab), glm::length(ac), glm::length(t.c - t.b)});
  if (!(std::abs(exact - along) * glm::length(line.direction) <= 1e-2 * size + 1e-6 * glm::length(line.at))) return hit;
  hit.along = exact;
  const glm::dvec3 ap = line.at + exact * line.direction - t.a;
  const double area = glm::dot(normal, normal);
  hit.b1 = std::clamp(glm::dot(glm::cross(ap, ac), normal) / area, 0.0, 1.0);
  hit.b2 = std::clamp(glm::dot(glm::cross(ab, ap), normal) / area, 0.0, 1.0 - hit.b1);
  return hit;
}

}  // namespace

struct RayScene::Impl {
  const TriMesh* mesh = nullptr;
  std::vector<glm::vec3> positions;  // a copy, where the mesh's array may not be read 4 bytes beyond its end
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
  std::atomic<int64_t> bytes{0};
  float size = 0;  // the largest coordinate

  ~Impl() {
    if (scene) rtcReleaseScene(scene);
    if (device) rtcReleaseDevice(device);
  }
};

RayScene::RayScene(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RayScene::~RayScene() = default;
uint64_t RayScene::bytes() const {
  return static_cast<uint64_t>(std::max<int64_t>(impl_->bytes.load(), 0)) + impl_->positions.size() * sizeof(glm::vec3);
}

Result<std::unique_ptr<RayScene>> RayScene::create(const TriMesh& mesh, const std::atomic<bool>* interrupted) {
  static_assert(sizeof(glm::vec3) == 12);
  auto impl = std::make_unique<Impl>();
  impl->mesh = &mesh;
  for (const glm::vec3& p : mesh.positions_mm) impl->size = std::max({impl->size, std::abs(p.x), std::abs(p.y), std::abs(p.z)});
  auto failed = [&](const char* what) {
    const RTCError code = rtcGetDeviceError(impl->device);
    return Error{ErrorKind::kRuntime, "", std::string("ray tracing: ") + what + (code == RTC_ERROR_OUT_OF_MEMORY ? ": out of memory" : ""), ""};
  };
  impl->device = rtcNewDevice(nullptr);
  if (!impl->device) return failed("no device");
  rtcSetDeviceMemoryMonitorFunction(
      impl->device,
      [](void* user, ssize_t bytes, bool) {
        static_cast<Impl*>(user)->bytes += bytes;
        return true;
      },
      impl.get());
  impl->scene = rtcNewScene(impl->device);
  rtcSetSceneFlags(impl->scene, RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_COMPACT);
  const RTCBuildQuality quality = mesh.triangles.size() <= kQuickUpTo ? RTC_BUILD_QUALITY_LOW : RTC_BUILD_QUALITY_MEDIUM;
  rtcSetSceneBuildQuality(impl->scene, quality);
  RTCGeometry geometry = rtcNewGeometry(impl->device, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetGeometryBuildQuality(geometry, quality);
  // Embree reads 16 bytes at a vertex. Behind the last one that stays in the same memory page unless the array ends with a page.
  const glm::vec3* positions = mesh.positions_mm.data();
  if (reinterpret_cast<uintptr_t>(positions + mesh.positions_mm.size()) % 4096 == 0) {
    impl->positions.reserve(mesh.positions_mm.size() + 1);
    impl->positions = mesh.positions_mm;
    impl->positions.push_back(glm::vec3(0));
    positions = impl->positions.data();
  }
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, positions, 0, sizeof(glm::vec3), mesh.positions_mm.size());
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, mesh.triangles.data(), 0, 3 * sizeof(uint32_t), mesh.triangles.size());
  rtcSetGeometryIntersectFilterFunction(geometry, facingFilter);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(impl->scene, geometry);
  rtcReleaseGeometry(geometry);
  if (interrupted) {
    rtcSetSceneProgressMonitorFunction(
        impl->scene, [](void* flag, double) { return !static_cast<const std::atomic<bool>*>(flag)->load(); },
        const_cast<std::atomic<bool>*>(interrupted));
  }
  rtcCommitScene(impl->scene);
  if (interrupted && interrupted->load()) return Error{ErrorKind::kInterrupted, "", "interrupted", ""};
  if (rtcGetDeviceError(impl->device) != RTC_ERROR_NONE) return failed("the mesh's hierarchy cannot be built");
  return std::unique_ptr<RayScene>(new RayScene(std::move(impl)));
}

void RayScene::nearestOnLines(std::span<const Line> lines, Facing facing, std::span<SurfacePoint> hits) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  for (size_t from = 0; from < lines.size(); from += kPacket) {
    const size_t count = std::min(kPacket, lines.size() - from);
    alignas(32) std::array<int, kPacket> valid{};
    std::array<SurfacePoint, kPacket> best{};
    // Upwards, then downwards no further than what was found. Both start a little behind the line's point: it may lie on the surface.
    for (bool up : {true, false}) {
      RTCRayHit8 rays;
      std::array<double, kPacket> behind{};
      for (size_t i = 0; i < kPacket; ++i) {
        const Line& line = lines[from + std::min(i, count - 1)];
        const double length = glm::length(line.direction);
        valid[i] = i < count && length > 0 ? -1 : 0;
        if (!valid[i]) continue;
        behind[i] = std::min(line.reach, 2e-6 * impl_->size / length);
        const glm::dvec3 direction = up ? line.direction : -line.direction;
        const glm::dvec3 at = line.at - behind[i] * direction;
        const double reach = (up || !best[i] ? line.reach : std::min(line.reach, std::abs(best[i].along))) + behind[i];
        rays.ray.org_x[i] = static_cast<float>(at.x);
        rays.ray.org_y[i] = static_cast<float>(at.y);
        rays.ray.org_z[i] = static_cast<float>(at.z);
        rays.ray.dir_x[i] = static_cast<float>(direction.x);
        rays.ray.dir_y[i] = static_cast<float>(direction.y);
        rays.ray.dir_z[i] = static_cast<float>(direction.z);
        rays.ray.tnear[i] = 0;
        rays.ray.tfar[i] = static_cast<float>(reach);
        rays.ray.time[i] = 0;
        rays.ray.mask[i] = ~0u;
        rays.ray.id[i] = facing == Facing::kAny ? kRayAny : up ? kRayUp : kRayDown;
        rays.ray.flags[i] = 0;
        rays.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
        rays.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
      }
      rtcIntersect8(valid.data(), impl_->scene, &context, &rays);
      for (size_t i = 0; i < count; ++i) {
        if (!valid[i] || rays.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) continue;
        const double t = static_cast<double>(rays.ray.tfar[i]) - behind[i];
        const SurfacePoint hit =
            refined(*impl_->mesh, lines[from + i], rays.hit.primID[i], up ? t : -t, rays.hit.u[i], rays.hit.v[i]);
        if (!best[i] || std::abs(hit.along) < std::abs(best[i].along)) best[i] = hit;
      }
    }
    std::copy_n(best.begin(), count, hits.begin() + static_cast<ptrdiff_t>(from));
  }
}

SurfacePoint RayScene::nearestOnLine(const Line& line, Facing facing) const {
  SurfacePoint hit;
  nearestOnLines({&line, 1}, facing, {&hit, 1});
  return hit;
}

SurfacePoint RayScene::closestPoint(const glm::dvec3& place, double within) const {
  const double slack = 1e-6 * (std::abs(place.x) + std::abs(place.y) + std::abs(place.z));
  ClosestQuery query{impl_->mesh, place, {}, within, slack};
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  RTCPointQuery sphere;
  sphere.x = static_cast<float>(place.x);
  sphere.y = static_cast<float>(place.y);
  sphere.z = static_cast<float>(place.z);
  sphere.time = 0;
  sphere.radius = static_cast<float>(within * (1 + 1e-6) + slack);
  rtcPointQuery(impl_->scene, &sphere, &context, closestCallback, &query);
  return query.best;
}

SurfacePoint RayScene::closestPoint(const glm::dvec3& place, const SurfacePoint& guess) const {
  if (!guess) return closestPoint(place);
  return closestPoint(place, closestOnTriangle(cornersOf(*impl_->mesh, guess.triangle), place).along);
}

}  // namespace relievo
