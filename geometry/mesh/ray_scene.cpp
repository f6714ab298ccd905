#include "geometry/mesh/ray_scene.h"

#include <embree3/rtcore.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include "geometry/mesh/box_tree.h"
#include "geometry/mesh/triangle_point.h"
#include "src/base/worker_threads.h"

namespace relievo {
namespace {

constexpr size_t kPacket = 8;  // AVX2

// Triangles a region, some 25 MB each; of scans that may not have all regions at a time below 1 MB, so that little is
// built for what lies beside what is asked for.
constexpr size_t kRegionTriangles = size_t{1} << 19, kLargeRegionTriangles = size_t{1} << 14, kLarge = size_t{4} << 20;

// What the lanes of a packet met so far. Surfaces that are equally near: the first triangle, whichever hierarchy is
// asked first.
struct PacketContext {
  RTCIntersectContext embree;  // the first member: Embree hands its address to the filter
  // Rays go through to their ends, and the hit closest to their middle counts; else each ends at its nearest hit, but
  // of equally near ones that may be any: Embree compares before it divides.
  bool through = false;
  uint32_t first_triangle = 0;       // of the region
  std::array<float, kPacket> far{};  // where the rays end
  std::array<float, kPacket> middle{}, nearest{}, t{}, u{}, v{};
  std::array<uint32_t, kPacket> triangle{};
};

// What a ray's id asks of the surfaces it meets, and in its lowest bits its lane. Up: along the line's direction.
enum RayKind : unsigned { kRayAny = 0, kRayUp = 1, kRayDown = 2 };
constexpr unsigned kLaneBits = 3;
static_assert(1u << kLaneBits == kPacket);

// Traces the rays of the lanes in the mask, up to context.far. Where there are no eight lanes (no AVX; arm64), Embree
// passes the mask over and takes every ray that begins before it ends, two packets of four: the rays of other lanes,
// whatever is in them, end nowhere.
void traceLanes(RTCScene scene, const std::array<int, kPacket>& mask, PacketContext& context, RTCRayHit8& rays) {
  constexpr float nowhere = std::numeric_limits<float>::quiet_NaN();
  for (size_t i = 0; i < kPacket; ++i) rays.ray.tfar[i] = mask[i] ? context.far[i] : nowhere;
  rtcIntersect8(mask.data(), scene, &context.embree, &rays);
  for (size_t i = 0; i < kPacket; ++i)
    if (mask[i]) context.far[i] = rays.ray.tfar[i];
}

void lineFilter(const RTCFilterFunctionNArguments* args) {
  auto& context = *reinterpret_cast<PacketContext*>(args->context);
  for (unsigned i = 0; i < args->N; ++i) {
    if (args->valid[i] != -1) continue;
    args->valid[i] = 0;
    const unsigned id = RTCRayN_id(args->ray, args->N, i), kind = id >> kLaneBits, lane = id & (kPacket - 1);
    if (kind != kRayAny) {
      const float facing = RTCRayN_dir_x(args->ray, args->N, i) * RTCHitN_Ng_x(args->hit, args->N, i) +
                           RTCRayN_dir_y(args->ray, args->N, i) * RTCHitN_Ng_y(args->hit, args->N, i) +
                           RTCRayN_dir_z(args->ray, args->N, i) * RTCHitN_Ng_z(args->hit, args->N, i);
      if (kind == kRayUp ? !(facing > 0) : !(facing < 0)) continue;
    }
    const float t = RTCRayN_tfar(args->ray, args->N, i),
                distance = context.through ? std::abs(t - context.middle[lane]) : t;
    const uint32_t triangle = context.first_triangle + RTCHitN_primID(args->hit, args->N, i);
    if (distance > context.nearest[lane] || (distance == context.nearest[lane] && triangle >= context.triangle[lane]))
      continue;
    context.nearest[lane] = distance;
    context.triangle[lane] = triangle;
    context.t[lane] = t;
    context.u[lane] = RTCHitN_u(args->hit, args->N, i);
    context.v[lane] = RTCHitN_v(args->hit, args->N, i);
    if (!context.through) args->valid[i] = -1;  // the ray ends here
  }
}

SurfacePoint closestOnTriangle(const TriMesh& mesh, uint32_t triangle, const glm::dvec3& place) {
  const TrianglePoint at = closestOnTriangle(cornersOf(mesh, triangle), place);
  return {triangle, at.b1, at.b2, at.distance};
}

struct ClosestQuery {
  const TriMesh* mesh;
  uint32_t first_triangle;  // of the region
  glm::dvec3 place;
  SurfacePoint best;
  double within;
  double slack;  // the place is rounded to float for Embree: as much further does it have to look
};

bool closestCallback(RTCPointQueryFunctionArguments* args) {
  auto& query = *static_cast<ClosestQuery*>(args->userPtr);
  const uint32_t triangle = query.first_triangle + args->primID;
  const SurfacePoint here = closestOnTriangle(*query.mesh, triangle, query.place);
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

// The plane of the triangle and the line, in double; a grazing hit, which that would throw far off, stays where Embree
// saw it.
SurfacePoint refined(const TriMesh& mesh, const Line& line, uint32_t triangle, double along, double b1, double b2) {
  SurfacePoint hit{triangle, b1, b2, along};
  const TriangleCorners t = cornersOf(mesh, triangle);
  const glm::dvec3 ab = t.b - t.a, ac = t.c - t.a, normal = glm::cross(ab, ac);
  const double steep = glm::dot(normal, line.direction);
  const double exact = glm::dot(normal, t.a - line.at) / steep;
  const glm::dvec3 bc = t.c - t.b;
  const double size_squared = std::max({glm::dot(ab, ab), glm::dot(ac, ac), glm::dot(bc, bc)}), off = exact - along;
  if (!(off * off * glm::dot(line.direction, line.direction) <= 1e-4 * size_squared) &&
      !(std::abs(off) * glm::length(line.direction) <= 1e-2 * std::sqrt(size_squared) + 1e-6 * glm::length(line.at)))
    return hit;
  hit.along = exact;
  const glm::dvec3 ap = line.at + exact * line.direction - t.a;
  const double area = glm::dot(normal, normal);
  hit.b1 = std::clamp(glm::dot(glm::cross(ap, ac), normal) / area, 0.0, 1.0);
  hit.b2 = std::clamp(glm::dot(glm::cross(ab, ap), normal) / area, 0.0, 1.0 - hit.b1);
  return hit;
}

// Embree's task scheduler, TBB, ends the process where a thread that it counts on cannot be started: it counts on those
// that the system gives at the first scene. The limit stays to the end, as TBB starts the threads that are missing when
// it is lifted.
void limitScheduler() {
  alignas(tbb::global_control) static unsigned char limit[sizeof(tbb::global_control)];  // never destroyed
  [[maybe_unused]] static const bool limited = [] {
    const auto others = static_cast<size_t>(workerCount(0) - 1), given = threadsToBeHad(others);
    if (given < others) new (limit) tbb::global_control(tbb::global_control::max_allowed_parallelism, 1 + given);
    return given < others;
  }();
}

struct Hierarchy {
  RTCScene scene = nullptr;
  uint64_t bytes = 0;
  Hierarchy() = default;
  Hierarchy(const Hierarchy&) = delete;
  Hierarchy& operator=(const Hierarchy&) = delete;
  ~Hierarchy() {
    if (scene) rtcReleaseScene(scene);
  }
};

struct Region {
  uint32_t first = 0, count = 0;         // triangles
  std::shared_ptr<Hierarchy> hierarchy;  // all three guarded by Impl::mutex
  bool building = false;
  uint64_t used = 0;
};

// Does the segment of `half` to either side of `middle` meet a box? By separating axes (Ericson, 5.3.3): long segments
// past small boxes. What rounding loses is far less than what boxes are grown by.
bool meetsSegment(const Box& box, const glm::vec3& middle, const glm::vec3& half) {
  const glm::vec3 m = middle - 0.5f * (box.low + box.high), e = 0.5f * (box.high - box.low), d = glm::abs(half);
  const bool apart = (std::abs(m.x) > e.x + d.x) | (std::abs(m.y) > e.y + d.y) | (std::abs(m.z) > e.z + d.z) |
                     (std::abs(m.y * half.z - m.z * half.y) > e.y * d.z + e.z * d.y) |
                     (std::abs(m.z * half.x - m.x * half.z) > e.z * d.x + e.x * d.z) |
                     (std::abs(m.x * half.y - m.y * half.x) > e.x * d.y + e.y * d.x);
  return !apart;
}

}  // namespace

struct RayScene::Impl {
  const TriMesh* mesh = nullptr;
  RaySceneOptions options;
  std::vector<glm::vec3> copy;  // where the mesh's array may not be read 4 bytes beyond its end
  const glm::vec3* positions = nullptr;
  RTCDevice device = nullptr;
  std::atomic<int64_t> device_bytes{0};
  float size = 0;  // the largest coordinate
  std::vector<Region> regions;
  BoxTree parts;  // of the regions' triangles, kPartsARegion each, grown by far more than floats lose; where there are
                  // several
  bool all_built = false;  // and so they stay: no lock is needed
  std::mutex mutex;
  std::condition_variable built;
  uint64_t clock = 0, builds = 0, held_bytes = 0;
  std::string failure;
  std::string device_error;  // what the device said last; guarded by mutex

  static constexpr size_t kPartsARegion = 4;

  ~Impl() {
    regions.clear();
    if (device) rtcReleaseDevice(device);
  }
  bool stopped() const { return options.interrupted && options.interrupted->load(std::memory_order_relaxed); }

  // Null: interrupted, or out of memory (failure).
  std::shared_ptr<Hierarchy> build(const Region& region) {
    auto made = std::make_shared<Hierarchy>();
    made->scene = rtcNewScene(device);
    rtcSetSceneFlags(made->scene, RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_COMPACT);
    // By Morton codes: 0.08 s of one core a million triangles. By surface areas: 0.3 s, and lines take the same time
    // (0.08 us beside one another).
    rtcSetSceneBuildQuality(made->scene, RTC_BUILD_QUALITY_LOW);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetGeometryBuildQuality(geometry, RTC_BUILD_QUALITY_LOW);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, positions, 0, sizeof(glm::vec3),
                               mesh->positions_mm.size());
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               mesh->triangles.data() + region.first, 0, 3 * sizeof(uint32_t), region.count);
    rtcSetGeometryIntersectFilterFunction(geometry, lineFilter);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(made->scene, geometry);
    rtcReleaseGeometry(geometry);
    if (options.interrupted) {
      rtcSetSceneProgressMonitorFunction(
          made->scene, [](void* flag, double) { return !static_cast<const std::atomic<bool>*>(flag)->load(); },
          const_cast<std::atomic<bool>*>(options.interrupted));
    }
    rtcCommitScene(made->scene);
    const RTCError code = rtcGetDeviceError(device);
    if (stopped()) return nullptr;
    if (code == RTC_ERROR_NONE) return made;
    // Whatever stopped it, such as a thread that the system refused, stopped it between its tasks: releasing the scene
    // would end the process. It stays, and with it what it took.
    static std::atomic<RTCScene> abandoned;
    abandoned = std::exchange(made->scene, nullptr);
    std::lock_guard lock(mutex);
    failure = std::string("ray tracing: the mesh's hierarchy cannot be built") +
              (code == RTC_ERROR_OUT_OF_MEMORY ? ": out of memory"
               : device_error.empty()          ? ""
                                               : ": " + device_error);
    return nullptr;
  }

  // What Embree says of the memory that it holds includes what other builds use at the same time: some 64 bytes a
  // triangle, if in doubt.
  static constexpr uint64_t kBytesATriangle = 64;

  std::shared_ptr<Hierarchy> hierarchy(size_t index) {
    Region& region = regions[index];
    std::unique_lock lock(mutex);
    for (;;) {
      region.used = ++clock;
      if (region.hierarchy) return region.hierarchy;
      if (!failure.empty() || stopped()) return nullptr;
      if (!region.building) break;
      built.wait(lock);
    }
    region.building = true;
    // Room first: those longest unused go, and are gone when nobody uses them any more.
    const uint64_t bytes = region.count * kBytesATriangle;
    while (held_bytes + bytes > options.budget_bytes) {
      Region* oldest = nullptr;
      for (Region& r : regions)
        if (r.hierarchy && (!oldest || r.used < oldest->used)) oldest = &r;
      if (!oldest) break;
      held_bytes -= oldest->hierarchy->bytes;
      oldest->hierarchy.reset();
    }
    held_bytes += bytes;
    ++builds;
    lock.unlock();
    auto made = build(region);
    lock.lock();
    if (made) made->bytes = bytes;
    else held_bytes -= bytes;
    region.hierarchy = made;
    region.building = false;
    built.notify_all();
    return made;
  }

  // The hierarchies of a query, so that each is asked for once: the last few of them.
  struct Held {
    static constexpr size_t kMost = 16;
    std::array<std::shared_ptr<Hierarchy>, kMost> hierarchy;
    std::array<size_t, kMost> region{};
    size_t next = 0;
  };
  // use(scene) with the region's hierarchy.
  template <class Use>
  void with(size_t index, Held& held, Use use) {
    if (all_built) return use(regions[index].hierarchy->scene);
    for (size_t i = 0; i < Held::kMost; ++i)
      if (held.hierarchy[i] && held.region[i] == index) return use(held.hierarchy[i]->scene);
    const size_t i = held.next++ % Held::kMost;
    held.hierarchy[i].reset();  // before another is built
    held.region[i] = index;
    held.hierarchy[i] = hierarchy(index);
    if (held.hierarchy[i]) use(held.hierarchy[i]->scene);
  }

  // Lines that are asked for together, and the parts that they can meet: near their points, and as far as they reach.
  struct Query {
    std::span<const Line> lines;
    std::vector<uint32_t> likely, reached;
    bool knows_reached = false;
    Held held;
  };
  void listParts(std::span<const Line> lines, bool likely, std::vector<uint32_t>& out) const;
  void trace(const std::vector<uint32_t>& near, Held& held, PacketContext& context, RTCRayHit8& rays,
             std::array<int, kPacket>& valid);
  void nearest(Query& query, std::span<const Line> lines, Facing facing, SurfacePoint* hits);
};

RayScene::RayScene(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RayScene::~RayScene() = default;
size_t RayScene::regions() const { return impl_->regions.size(); }
uint64_t RayScene::bytes() const {
  return static_cast<uint64_t>(std::max<int64_t>(impl_->device_bytes.load(), 0)) +
         impl_->copy.size() * sizeof(glm::vec3);
}
uint64_t RayScene::builds() const {
  std::lock_guard lock(impl_->mutex);
  return impl_->builds;
}
Result<void> RayScene::status() const {
  std::lock_guard lock(impl_->mutex);
  if (!impl_->failure.empty()) {
    const bool threads = impl_->failure.find("thread") != std::string::npos ||
                         impl_->failure.find("temporarily unavailable") != std::string::npos;
    return Error{ErrorKind::kRuntime, "", impl_->failure, threads ? ThreadStartFailure::kHint : ""};
  }
  return {};
}

Result<std::unique_ptr<RayScene>> RayScene::create(const TriMesh& mesh, const RaySceneOptions& options) {
  static_assert(sizeof(glm::vec3) == 12);
  auto impl = std::make_unique<Impl>();
  impl->mesh = &mesh;
  impl->options = options;
  for (const glm::vec3& p : mesh.positions_mm)
    impl->size = std::max({impl->size, std::abs(p.x), std::abs(p.y), std::abs(p.z)});
  limitScheduler();
  impl->device = rtcNewDevice(options.device);
  if (!impl->device) return Error{ErrorKind::kRuntime, "", "ray tracing: no device", ""};
  rtcSetDeviceErrorFunction(
      impl->device,
      [](void* user, RTCError, const char* text) {
        Impl& i = *static_cast<Impl*>(user);
        std::lock_guard lock(i.mutex);
        i.device_error = text ? text : "";
      },
      impl.get());
  rtcSetDeviceMemoryMonitorFunction(
      impl->device,
      [](void* user, ssize_t bytes, bool) {
        static_cast<Impl*>(user)->device_bytes += bytes;
        return true;
      },
      impl.get());
  // Embree reads 16 bytes at a vertex. Behind the last one that stays in the same memory page unless the array ends
  // with a page.
  impl->positions = mesh.positions_mm.data();
  if (mesh.positions_mm.capacity() == mesh.positions_mm.size() &&
      reinterpret_cast<uintptr_t>(impl->positions + mesh.positions_mm.size()) % 4096 == 0) {
    impl->copy.reserve(mesh.positions_mm.size() + 1);
    impl->copy = mesh.positions_mm;
    impl->copy.push_back(glm::vec3(0));
    impl->positions = impl->copy.data();
  }
  const size_t triangles = mesh.triangles.size();
  const size_t run = options.region_triangles ? options.region_triangles
                     : triangles < kLarge     ? kRegionTriangles
                                              : kLargeRegionTriangles;
  const glm::vec3 grow(1e-5f * impl->size);
  std::vector<Box> parts;
  for (size_t first = 0; first < triangles; first += run) {
    if (impl->stopped()) break;
    Region region{.first = static_cast<uint32_t>(first),
                  .count = static_cast<uint32_t>(std::min(run, triangles - first))};
    for (size_t part = 0; part < Impl::kPartsARegion && triangles > run; ++part) {
      Box box;
      for (size_t t = first + region.count * part / Impl::kPartsARegion;
           t < first + region.count * (part + 1) / Impl::kPartsARegion; ++t)
        for (uint32_t v : mesh.triangles[t]) box.add(mesh.positions_mm[v]);
      box.low -= grow;
      box.high += grow;
      parts.push_back(box);
    }
    impl->regions.push_back(std::move(region));
  }
  if (!parts.empty()) impl->parts = BoxTree(parts);
  if (options.at_once && triangles * Impl::kBytesATriangle <= options.budget_bytes) {
    for (size_t r = 0; r < impl->regions.size(); ++r) impl->hierarchy(r);
    impl->all_built = impl->failure.empty() && !impl->stopped();
  }
  if (impl->stopped()) return Error{ErrorKind::kInterrupted, "", "interrupted", ""};
  std::unique_ptr<RayScene> scene(new RayScene(std::move(impl)));
  if (auto sound = scene->status(); !sound) return sound.error();
  return scene;
}

// Of each valid ray the nearest hit, into the context; first where the rays begin, so that they seldom need to go on.
void RayScene::Impl::trace(const std::vector<uint32_t>& near, Held& held, PacketContext& context, RTCRayHit8& rays,
                           std::array<int, kPacket>& valid) {
  if (regions.size() == 1) {
    context.first_triangle = 0;
    with(0, held, [&](RTCScene scene) { traceLanes(scene, valid, context, rays); });
    return;
  }
  auto from = [&](size_t i) { return glm::vec3(rays.ray.org_x[i], rays.ray.org_y[i], rays.ray.org_z[i]); };
  auto along = [&](size_t i) { return glm::vec3(rays.ray.dir_x[i], rays.ray.dir_y[i], rays.ray.dir_z[i]); };
  std::array<glm::vec3, kPacket> middle, half;
  // Of the regions in turn those that rays begin in, then those that they only come to; or, where all of a ray counts,
  // all at once.
  const int rounds = context.through ? 1 : 2;
  for (int round = 0; round < rounds; ++round) {
    Box packet;
    for (size_t i = 0; i < kPacket; ++i) {
      if (!valid[i]) continue;
      half[i] = 0.5f * context.far[i] * along(i);
      middle[i] = from(i) + half[i];
      packet.add(from(i));
      packet.add(from(i) + context.far[i] * along(i));
    }
    for (size_t at = 0; at < near.size();) {
      const size_t r = near[at] / kPartsARegion;
      alignas(32) std::array<int, kPacket> meets{}, begins{};
      bool any = false;
      for (; at < near.size() && near[at] / kPartsARegion == r; ++at) {
        const Box box = parts.part(near[at]);
        if (!box.meets(packet)) continue;
        for (size_t i = 0; i < kPacket; ++i) {
          if (!valid[i] || !meetsSegment(box, middle[i], half[i])) continue;
          meets[i] = -1;
          if (!context.through && box.meets({from(i), from(i)})) begins[i] = -1;
        }
      }
      for (size_t i = 0; i < kPacket; ++i) {
        if (!context.through && (begins[i] != 0) != (round == 0)) meets[i] = 0;
        any = any || meets[i] != 0;
      }
      if (!any) continue;
      context.first_triangle = regions[r].first;
      with(r, held, [&](RTCScene scene) { traceLanes(scene, meets, context, rays); });
    }
  }
}

void RayScene::Impl::listParts(std::span<const Line> lines, bool likely, std::vector<uint32_t>& out) const {
  Box box;
  for (const Line& line : lines) {
    const double reach = likely ? std::min(line.likely, line.reach) : line.reach;
    if (!(reach > 0)) continue;
    box.add(glm::vec3(line.at - reach * line.direction));
    box.add(glm::vec3(line.at + reach * line.direction));
  }
  parts.forEach([&](const Box& b) { return b.meets(box); }, [&](size_t i) { out.push_back(static_cast<uint32_t>(i)); });
}

// Up to a packet of lines.
void RayScene::Impl::nearest(Query& query, std::span<const Line> lines, Facing facing, SurfacePoint* hits) {
  PacketContext context;
  rtcInitIntersectContext(&context.embree);
  context.embree.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  RTCRayHit8 rays;
  alignas(32) std::array<int, kPacket> valid{};
  std::array<double, kPacket> length{}, start{};
  for (size_t i = 0; i < lines.size(); ++i) length[i] = glm::length(lines[i].direction);
  // From `start` before the line's point on.
  auto aim = [&](size_t i, const glm::dvec3& direction, double far, unsigned kind, float middle) {
    const glm::dvec3 at = lines[i].at - start[i] * direction;
    rays.ray.org_x[i] = static_cast<float>(at.x);
    rays.ray.org_y[i] = static_cast<float>(at.y);
    rays.ray.org_z[i] = static_cast<float>(at.z);
    rays.ray.dir_x[i] = static_cast<float>(direction.x);
    rays.ray.dir_y[i] = static_cast<float>(direction.y);
    rays.ray.dir_z[i] = static_cast<float>(direction.z);
    rays.ray.tnear[i] = 0;
    rays.ray.time[i] = 0;
    rays.ray.mask[i] = ~0u;
    rays.ray.id[i] = kind << kLaneBits | static_cast<unsigned>(i);
    rays.ray.flags[i] = 0;
    rays.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
    rays.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
    context.far[i] = static_cast<float>(far);
    context.middle[i] = middle;
    context.nearest[i] = std::numeric_limits<float>::infinity();
    context.triangle[i] = SurfacePoint::kNone;
    valid[i] = -1;
  };

  // Where the hit is likely: one short ray through the line's point.
  context.through = true;
  bool any = false;
  for (size_t i = 0; i < lines.size(); ++i) {
    hits[i] = {};
    const double window = std::min(lines[i].likely, lines[i].reach);
    if (!(window > 0) || !(length[i] > 0) || !(window * length[i] > 1e-5 * size)) continue;
    any = true;
    start[i] = window;
    aim(i, lines[i].direction, 2 * window, facing == Facing::kAny ? kRayAny : kRayUp, static_cast<float>(window));
  }
  if (any) {
    trace(query.likely, query.held, context, rays, valid);
    for (size_t i = 0; i < lines.size(); ++i)
      if (valid[i] && context.triangle[i] != SurfacePoint::kNone)
        hits[i] = refined(*mesh, lines[i], context.triangle[i], static_cast<double>(context.t[i]) - start[i],
                          context.u[i], context.v[i]);
  }

  // Upwards, then downwards no further than what was found. Both start a little behind the line's point: it may lie on
  // the surface. Then through what is as near as what was found.
  std::array<bool, kPacket> known{};
  for (size_t i = 0; i < lines.size(); ++i) known[i] = static_cast<bool>(hits[i]) || !(length[i] > 0);
  for (bool up : {true, false}) {
    valid = {};
    any = false;
    context.through = false;
    for (size_t i = 0; i < lines.size(); ++i) {
      if (known[i]) continue;
      any = true;
      start[i] = std::min(lines[i].reach, 2e-6 * size / length[i]);
      const double reach = up || !hits[i] ? lines[i].reach : std::min(lines[i].reach, std::abs(hits[i].along));
      aim(i, up ? lines[i].direction : -lines[i].direction, reach + start[i],
          facing == Facing::kAny ? kRayAny
          : up                   ? kRayUp
                                 : kRayDown,
          0);
    }
    if (!any) return;
    if (!query.knows_reached && regions.size() > 1) listParts(query.lines, false, query.reached);
    query.knows_reached = true;
    trace(query.reached, query.held, context, rays, valid);
    any = false;
    for (size_t i = 0; i < lines.size(); ++i) {
      if (valid[i]) valid[i] = context.triangle[i] == SurfacePoint::kNone ? 0 : -1;
      if (!valid[i]) continue;
      any = true;
      rays.ray.tnear[i] = std::max(context.t[i] * (1 - 1e-5f) - 1e-6f * static_cast<float>(start[i]), 0.0f);
      context.far[i] = context.t[i] * (1 + 1e-5f) + 1e-6f * static_cast<float>(start[i]);
      context.nearest[i] = std::numeric_limits<float>::infinity();
    }
    if (!any) continue;
    context.through = true;
    trace(query.reached, query.held, context, rays, valid);
    for (size_t i = 0; i < lines.size(); ++i) {
      if (!valid[i] || context.triangle[i] == SurfacePoint::kNone) continue;
      const double t = static_cast<double>(context.t[i]) - start[i];
      const SurfacePoint hit = refined(*mesh, lines[i], context.triangle[i], up ? t : -t, context.u[i], context.v[i]);
      if (!hits[i] || std::abs(hit.along) < std::abs(hits[i].along)) hits[i] = hit;
    }
  }
}

void RayScene::nearestOnLines(std::span<const Line> lines, Facing facing, std::span<SurfacePoint> hits) const {
  Impl::Query query{.lines = lines, .likely = {}, .reached = {}, .held = {}};
  if (impl_->regions.size() > 1) impl_->listParts(lines, true, query.likely);
  for (size_t from = 0; from < lines.size(); from += kPacket)
    impl_->nearest(query, lines.subspan(from, std::min(kPacket, lines.size() - from)), facing, hits.data() + from);
}

SurfacePoint RayScene::nearestOnLine(const Line& line, Facing facing) const {
  SurfacePoint hit;
  nearestOnLines({&line, 1}, facing, {&hit, 1});
  return hit;
}

SurfacePoint RayScene::closestPoint(const glm::dvec3& place, double within) const {
  const double slack = 1e-6 * (std::abs(place.x) + std::abs(place.y) + std::abs(place.z));
  ClosestQuery query{impl_->mesh, 0, place, {}, within, slack};
  Impl::Held held;
  auto ask = [&](size_t r) {
    query.first_triangle = impl_->regions[r].first;
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    RTCPointQuery sphere;
    sphere.x = static_cast<float>(place.x);
    sphere.y = static_cast<float>(place.y);
    sphere.z = static_cast<float>(place.z);
    sphere.time = 0;
    sphere.radius = static_cast<float>(query.within * (1 + 1e-6) + slack);
    impl_->with(r, held, [&](RTCScene scene) { rtcPointQuery(scene, &sphere, &context, closestCallback, &query); });
  };
  // A part that could not be built, because the build was interrupted or has no memory (status()), holds no point. Who
  // asks without a limit counts on one: the first corner of all stands in.
  auto found = [&] {
    if (query.best || !std::isinf(within)) return query.best;
    SurfacePoint stand_in;
    stand_in.triangle = 0;
    stand_in.along = glm::length(glm::dvec3(impl_->mesh->positions_mm[impl_->mesh->triangles[0][0]]) - place);
    return stand_in;
  };
  if (impl_->regions.size() == 1) {
    ask(0);
    return found();
  }
  // The region of the nearest box first, then what may hold a point as near.
  const BoxTree& parts = impl_->parts;
  auto within_reach = [&](const Box& box) { return box.squaredDistance(place) <= query.within * query.within; };
  const size_t nearest = parts.nearest(place), first = nearest / Impl::kPartsARegion;
  if (!within_reach(parts.part(nearest))) return {};
  ask(first);
  size_t last = first;
  parts.forEach(within_reach, [&](size_t part) {
    const size_t r = part / Impl::kPartsARegion;
    if (r == first || r == last) return;
    ask(last = r);
  });
  return found();
}

SurfacePoint RayScene::closestPoint(const glm::dvec3& place, const SurfacePoint& guess) const {
  if (!guess) return closestPoint(place);
  const SurfacePoint known = closestOnTriangle(*impl_->mesh, guess.triangle, place);
  const SurfacePoint nearest = closestPoint(place, known.along);
  return nearest ? nearest : known;
}

}  // namespace relievo
