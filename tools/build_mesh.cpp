#include "tools/build_mesh.h"

#include <malloc.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numeric>
#include <optional>
#include <utility>

#include "geometry/bake/corner_normals.h"
#include "geometry/bake/fidelity.h"
#include "geometry/bake/first_base.h"
#include "geometry/bake/line_rasteriser.h"
#include "geometry/bake/mesh_bake.h"
#include "geometry/bake/mesh_distance.h"
#include "geometry/bake/repeated_images.h"
#include "geometry/bake/simplified_rounds.h"
#include "geometry/bake/step_choice.h"
#include "geometry/bake/vertex_detail.h"
#include "geometry/mesh/mesh_order.h"
#include "geometry/remesh/base_domain.h"
#include "geometry/scan/mesh_read.h"
#include "src/artwork/patch_domain.h"
#include "src/artwork/shown_images.h"
#include "src/base/file.h"
#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "src/base/worker_threads.h"
#include "texturing/package/file_provenance.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"
#include "tools/baked_patches.h"
#include "tools/build_run.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/report/mesh_report.h"
#include "tools/surface_image.h"

namespace relievo {
namespace {

// The resident size, and its largest since the last call of restart(); Linux.
struct Memory {
  static void restart() {
    if (FILE* f = std::fopen("/proc/self/clear_refs", "w")) {
      std::fputs("5", f);
      std::fclose(f);
    }
  }
  static uint64_t peak() { return field("VmHWM: %llu kB"); }
  static uint64_t now() { return field("VmRSS: %llu kB"); }

 private:
  static uint64_t field(const char* pattern) {
    uint64_t kib = 0;
    if (FILE* f = std::fopen("/proc/self/status", "r")) {
      char line[256];
      unsigned long long value = 0;
      while (std::fgets(line, sizeof line, f))
        if (std::sscanf(line, pattern, &value) == 1) kib = value;
      std::fclose(f);
    }
    return kib << 10;
  }
};

// What a build takes beside a scan, however little memory is left: for looking up where lines meet the scan, and for
// pages.
constexpr uint64_t kLeastRayBytes = uint64_t{256} << 20, kLeastPackageBytes = uint64_t{64} << 20;

// Runs a stage with its line of progress, and notes what it cost.
class Stages {
 public:
  template <class F>
  auto run(const char* name, F&& stage) {
    const auto start = std::chrono::steady_clock::now();
    Memory::restart();
    auto result = stage();
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const auto before =
        std::find_if(costs.begin(), costs.end(), [&](const StageCost& cost) { return cost.name == name; });
    if (before == costs.end()) {
      costs.push_back({name, seconds, Memory::peak()});
    } else {  // it runs again
      before->seconds += seconds;
      before->peak_bytes = std::max(before->peak_bytes, Memory::peak());
    }
    malloc_trim(0);  // what the stage gave back is not the next one's
    return result;
  }
  template <class Options, class F>
  auto run(const char* name, Options& options, F&& stage) {
    ProgressLine line(name);
    options.interrupted = &interruptedFlag();
    options.progress = [&line](double done) { line.update(done, ""); };
    return run(name, std::forward<F>(stage));
  }
  std::vector<StageCost> costs;
};

Error interrupted(const MeshBuildArguments& a) {
  return {ErrorKind::kInterrupted, a.package.output, "interrupted", "nothing was written", {}};
}

std::string millimetres(double mm) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g mm", mm);
  return text;
}

// Of a measurement in the file's units; without the places that miss the target.
Fidelity inMm(Fidelity f, const glm::dvec3& origin, double mm_per_unit) {
  f.diagonal_mm *= mm_per_unit;
  for (double* length : {&f.target.rms_mm, &f.target.p99_9_mm, &f.target.max_mm}) *length *= mm_per_unit;
  for (OneSidedFidelity* way : {&f.to_drawn, &f.to_scan}) {
    for (double* length : {&way->rms_mm, &way->p99_9_mm, &way->max_mm}) *length *= mm_per_unit;
    way->max_at_mm = (origin + way->max_at_mm) * mm_per_unit;
  }
  f.violations.clear();
  return f;
}

// What was asked for, in the file's units; 0: nothing.
double toleranceOf(const MeshBuildArguments& a, double diagonal) {
  return a.tolerance_share > 0 ? a.tolerance_share * diagonal : a.tolerance_mm / mmPerUnit(a.unit);
}

// A scan's way into a package, stage by stage; each begins with what those before it left.
class MeshBuild {
 public:
  explicit MeshBuild(const MeshBuildArguments& a) : a_(a), mesh_file_(a.mesh, true) {}

  Result<void> run() {
    if (auto done = read(); !done) return done;
    if (auto done = checkArguments(); !done) return done;
    auto textured = readSurfaceImage(a_, loaded_.mesh);
    if (!textured) return textured.error();
    textured_ = std::move(*textured);
    if (interruptedFlag()) return interrupted(a_);
    if (auto done = makeBase(); !done) return done;
    if (auto done = bakeUntilKept(); !done) return done;
    if (auto done = pack(); !done) return done;
    if (measured())
      if (auto done = measure(); !done) return done;
    result_.stages = stages_.costs;
    return writeReports();
  }
  void printSummary() const;
  Result<void> verdict() const {
    // Whoever says how many patches there are has what so many show, and is told how far off it is.
    if (fidelity_.kept() || a_.patches > 0) return {};
    return missed(a_.package.output + " was written");
  }

 private:
  // By which function of BaseDomain's a base mesh was made: make(), grow() or refine(); faces(); simplifiedFaces().
  enum class BaseKind : uint8_t { kEven, kFaces, kSimplified };
  Result<void> read();
  // What only the scan itself tells to be impossible.
  Result<void> checkArguments() const;
  // Beside it begins what the bake looks up.
  Result<void> makeBase();
  // Bakes, measures, and makes patches smaller where the scan is missed, until the target is kept or more hardly help.
  Result<void> bakeUntilKept();
  // After steps were chosen: what is told of the bake, and the errors of its coarser grids.
  Result<void> finishBake();
  // A scan of few triangles is its own base (mostFacesAtOnce()), or one that repeats its images; false: it is not.
  Result<bool> useFewFacesAtOnce();
  // How many times the default one the tolerance is.
  double toleranceOverDefault() const {
    return target().p99_9_mm / FidelityTarget::of(diagonalOf(loaded_.mesh)).p99_9_mm;
  }
  // Another kind of base takes the place of a first one that is hopeless (first_base.h), if there is any.
  Result<void> replaceHopelessBase();
  // Makes more patches everywhere, as long as there is such a base and a few lines over the last one show that it
  // cannot be enough.
  Result<void> growUntilInReach();
  Result<bool> grow(BaseDomain::Growth growth = BaseDomain::Growth::kToLoseLess);
  // The base mesh is BaseDomain::make()'s or grow()'s.
  bool isFirstBase() const { return base_kind_ == BaseKind::kEven && !refined_; }
  // Bakes a first base once more, with more patches, where its samples are many more than the scan's vertices and take
  // several relief pages a patch: a page and its errors by block are then larger than a patch.
  Result<void> bakeInSmallerPatches();
  // The next bake's base; false: there is none of this kind.
  Result<bool> use(BaseKind kind, Result<BaseMesh> base);
  Result<bool> useFaces(uint32_t max_patches);
  double samplesPerVertex() const {
    return static_cast<double>(bake_->report().samples) / static_cast<double>(loaded_.mesh.positions_mm.size());
  }
  double creased();  // the share of the scan's triangles beside a crease
  FaceTexels faceTexels() const;
  // The scan's own triangles, where they take few bytes (mostLightFaces()); false: they do not.
  Result<bool> useLightFaces();
  // Own triangles may show its images instead of having their texels.
  bool showsImages() const { return a_.texture_tolerance >= 0 && a_.package.colour.codec == PageCodec::kLossless; }
  std::vector<double> imageTexels() const;                   // of each image; of a palette 0
  bool repeatsImages(std::span<const double> texels) const;  // so much that they should
  uint32_t mostFacesFirst() { return relievo::mostFacesFirst(creased(), toleranceOverDefault(), faceTexels()); }
  Result<bool> useSimplified(std::span<const RefineRequest> requests);
  // What is left after all of these (moreOf()).
  Result<bool> useMorePatches();
  // Chooses the base of the next bake, after one that missed; false: what there is is kept.
  Result<bool> nextBase(const Fidelity& now, const BakeReport& baked, bool better);
  // Rounds heights to steps as large as the target allows. fidelity_ is then measured at all places. False: to none.
  Result<bool> chooseStep();
  // cells_log2: BakeOptions::cells_log2, without a fit; -1: all that the target needs.
  Result<void> bake(int cells_log2 = -1);
  FidelityTarget target(double tolerance = 0) const;
  double baseStep() const;  // of the lattice of the base's corners (first_base.h), in the scan's units
  // tolerance: in the scan's units; 0 is what was asked for.
  // kRound: at all places, on the fewest blocks (FidelityOptions::soon).
  enum class Places : uint8_t { kAll, kFew, kRound };
  Result<Fidelity> measureBake(const MeshBake& bake, double tolerance = 0, Places places = Places::kAll);
  // At few places where these leave no doubt that what was baked is kept: sets at_few_places_.
  Result<Fidelity> measureRound();
  // After a miss at the program's own choice of patches: sets kept_tolerance_mm_.
  Result<void> findKeptTolerance();
  Error missed(const std::string& what_was_done) const;
  // Lengths from the file's units, which all is computed in: no unit changes what comes out.
  double mm(double units) const { return units * mmPerUnit(a_.unit); }
  Result<void> pack();
  void countImages();  // that patches show, but for plain colours
  bool measured() const { return !a_.report.empty() || !a_.json_file.empty(); }
  Result<void> measure();
  Result<void> writeReports() const;
  // What measuring may take beside what is in use, at least so much. An eighth of the budget is left for what
  // hierarchies of rays hold while they are made, and the allocator after they are gone.
  uint64_t memoryLeft(uint64_t least) const;

  static constexpr int kRounds = 5, kInVain = 2;  // of one kind of base
  static constexpr double kEnough = 0.9;        // of the target: another choice of samples finds a little more or less
  static constexpr uint64_t kFewPlaces = 8000;  // eight of them may lie beyond the 99.9th percentile

  MeshBuildArguments a_;
  Stages stages_;
  FileProvenance mesh_file_;
  LoadedMesh loaded_;
  SurfaceImage textured_;
  std::optional<BackgroundTask<Result<BakeScene>>> bake_scene_;
  std::unique_ptr<BaseDomain> domain_;
  BaseMesh base_;
  std::unique_ptr<MeshBake> bake_;
  std::optional<FidelityScan> fidelity_scan_, few_places_;  // while bakes are measured
  Fidelity fidelity_;
  bool at_few_places_ = false;    // fidelity_ was measured there
  bool many_places_ = false;      // from now on few places decide about no bake
  uint64_t ray_bytes_ = 0;        // that the hierarchies of the scan's rays may take
  double kept_tolerance_mm_ = 0;  // the least that is kept after a miss; 0: none was found
  bool best_is_known_ = false;    // what is baked is kept
  bool refined_ = false;          // some base mesh was BaseDomain::refine()'s
  BaseKind base_kind_ = BaseKind::kEven;
  int round_ = 0, in_vain_ = 0;  // bakes of this kind of base, and how many of the last ones were no better
  SimplifiedRounds simplified_rounds_;
  uint32_t most_simplified_ = kMostPatches;
  std::vector<FidelityViolation> missed_first_;  // by the first bake of simplified triangles
  bool more_samples_ = false;  // a bake that is told its tolerance may take 16 times as many (BakeOptions)
  MeshBuildResult result_;
};

Result<void> MeshBuild::read() {
  MeshReadOptions read_options;
  if (!a_.unit.empty()) read_options.mm_per_unit = mmPerUnit(a_.unit);
  read_options.turn = turnOf(a_.up, a_.rotate_deg);
  read_options.keep_units = true;
  read_options.workers = a_.package.workers;
  read_options.allow_outside = a_.allow_outside;
  // Each of its own triangles may be shown then.
  if (a_.patches == 0 && a_.ptm.empty()) read_options.all_pieces_up_to = 2 * size_t{kManyLightFaces};
  read_options.other_image = !a_.ptm.empty() || (!a_.texture.empty() && a_.texture != "none");
  auto loaded = stages_.run("read", read_options, [&] {
    auto mesh = readMesh(a_.mesh, read_options);
    if (mesh.ok()) mesh_file_.start();
    if (mesh.ok() && needsOrder(mesh->mesh)) orderTriangles(mesh->mesh, a_.package.workers, &interruptedFlag());
    return mesh;
  });
  if (!loaded) return loaded.error();
  loaded_ = std::move(*loaded);
  if (a_.unit.empty()) a_.unit = loaded_.unit;
  if (a_.named_files) *a_.named_files = loaded_.named_files;
  // Nothing of what follows can give the scan's own memory back.
  if (const uint64_t held = Memory::now(); held > a_.package.memory_budget_bytes) {
    warn(a_.mesh + ": the scan alone takes " + std::to_string(held >> 20) + " MiB of memory, --memory-mib allows " +
         std::to_string(a_.package.memory_budget_bytes >> 20) + ", about " +
         std::to_string((held + kLeastRayBytes + kLeastPackageBytes) >> 20) + " MiB are needed");
  }
  return {};
}

Result<void> MeshBuild::checkArguments() const {
  std::vector<NamedFile> named;
  for (const std::string& path : loaded_.named_files) named.push_back({path + ", which the mesh names", path});
  if (auto good = checkApart({{"-o", a_.package.output}, {"--report", a_.report}, {"--json", a_.json_file}}, named);
      !good)
    return good;
  // Each patch has cells of its own: more of them than the scan has detail for take minutes, and space, for nothing.
  constexpr size_t kAlwaysPatches = 1024;
  if (const size_t most = std::max(kAlwaysPatches, loaded_.mesh.triangles.size() / 2); a_.patches > most)
    return Error{ErrorKind::kUsage,
                 a_.mesh,
                 "--patches asks for " + std::to_string(a_.patches) + ", a scan of " +
                     std::to_string(loaded_.mesh.triangles.size()) + " triangles has at most " + std::to_string(most),
                 "ask for fewer, or leave --patches out",
                 {}};
  return {};
}

Result<void> MeshBuild::makeBase() {
  const TriMesh& scan = loaded_.mesh;
  BaseDomainOptions base_options;
  base_options.patches = a_.patches;
  base_options.mm_per_unit = mm(1);
  base_options.workers = a_.package.workers;
  // What the bake looks up is made while the base mesh needs one core only. Of the memory it may have what the package
  // does not need.
  constexpr uint64_t kPackageBytes = uint64_t{128} << 20;
  base_options.on_serial_phase = [&] {
    const uint64_t held = Memory::now() + scan.positions_mm.size() * sizeof(glm::vec3) + kPackageBytes;
    const uint64_t left = a_.package.memory_budget_bytes > held ? a_.package.memory_budget_bytes - held : 0;
    ray_bytes_ = std::max(left, kLeastRayBytes);
    BakeSceneOptions options{.ray_bytes = ray_bytes_, .workers = a_.package.workers, .interrupted = &interruptedFlag()};
    bake_scene_.emplace("relievo-scene", [&scan, options] { return makeBakeScene(scan, options); });
  };
  auto named = [&](Error error) {
    if (error.kind == ErrorKind::kInvalidData) error.file = a_.mesh;
    return error;
  };
  auto domain = stages_.run("base", base_options, [&] { return BaseDomain::create(scan, base_options); });
  if (!domain) return named(domain.error());
  domain_ = std::move(*domain);
  if (const auto own = useFewFacesAtOnce(); !own || *own) return own ? Result<void>() : own.error();
  auto base = stages_.run("base", base_options, [&] { return domain_->make(); });
  if (!base) return named(base.error());
  base_ = std::move(*base);
  return replaceHopelessBase();
}

double MeshBuild::baseStep() const {
  const double diagonal = diagonalOf(loaded_.mesh), target_rms = target().rms_mm;
  return base_kind_ == BaseKind::kFaces ? faceStepFor(target_rms, diagonal) : baseStepFor(target_rms, diagonal);
}

FidelityTarget MeshBuild::target(double tolerance) const {
  const double diagonal = diagonalOf(loaded_.mesh);
  if (tolerance == 0) tolerance = toleranceOf(a_, diagonal);
  return tolerance > 0 ? FidelityTarget::within(tolerance) : FidelityTarget::of(diagonal);
}

Result<void> MeshBuild::bake(int cells_log2) {
  const TriMesh& scan = loaded_.mesh;
  BakeOptions bake_options;
  const double diagonal = diagonalOf(scan), asked = toleranceOf(a_, diagonal);
  const double most = asked > 0 ? asked : target().p99_9_mm;
  if (asked > 0 || more_samples_) bake_options.tolerance_mm = most / 3;
  if (base_kind_ == BaseKind::kSimplified)
    bake_options.touching = simplified_rounds_.otherWay() ? Touching::kAlways : Touching::kSameSheet;
  else if (base_kind_ == BaseKind::kEven && refined_) bake_options.touching = Touching::kFacing;
  // Corners that are rounded to the lattice, and to single precision, lie so far from the scan's planes.
  constexpr double kRounding = 2e-7, kHalfOfCell = 0.87;
  if (base_kind_ == BaseKind::kFaces) bake_options.touch_mm = kHalfOfCell * baseStep() + kRounding * diagonal;
  bake_options.workers = a_.package.workers;
  bake_options.errors = false;
  bake_options.tail_textures = a_.texture_tolerance >= 0;
  bake_options.show_images = showsImages();
  bake_options.cells_log2 = cells_log2;
  bake_options.fit = cells_log2 < 0;
  // Far off, most of a bake would go to a fit that hardly helps: not where patches of the scan's own triangles come
  // next, whatever it misses. Were it the best in the end, it would get its fit.
  constexpr double kFarOff = 16;
  const bool faces_are_next = base_kind_ == BaseKind::kEven && scan.triangles.size() <= 2 * size_t{kMostPatches};
  if (faces_are_next && a_.patches == 0 && !best_is_known_) bake_options.fit_within = kFarOff;
  auto bake = stages_.run("bake", bake_options, [&]() -> Result<std::unique_ptr<MeshBake>> {
    Result<BakeScene>& scene = bake_scene_->get();
    if (!scene) return scene.error();
    return MeshBake::create(scan, textured_.images, onLattice(inSequence(base_), baseStep()), bake_options, *scene);
  });
  if (!bake) return bake.error();
  bake_ = std::move(*bake);
  return {};
}

uint64_t MeshBuild::memoryLeft(uint64_t least) const {
  const uint64_t budget = a_.package.memory_budget_bytes, in_use = Memory::now();
  return std::max(budget - budget / 8, in_use + least) - in_use;
}

Result<Fidelity> MeshBuild::measureBake(const MeshBake& bake, double tolerance, Places places) {
  const TriMesh& scan = loaded_.mesh;
  FidelityOptions run{.workers = a_.package.workers, .interrupted = &interruptedFlag()};
  run.memory_bytes = memoryLeft(uint64_t{32} << 20);
  run.soon = places != Places::kRound;
  if (!fidelity_scan_) {
    const Result<BakeScene>& scene = bake_scene_->get();
    fidelity_scan_.emplace(scan, a_.package.workers, 0,
                           scene && scene->rasteriser ? scene->rasteriser->runs() : nullptr);
  }
  if (places == Places::kFew && !few_places_)
    few_places_.emplace(FidelityScan::fewer(*fidelity_scan_, a_.package.workers, kFewPlaces));
  return measureFidelity(places == Places::kFew ? *few_places_ : *fidelity_scan_, bake, target(tolerance), run);
}

Result<Fidelity> MeshBuild::measureRound() {
  at_few_places_ = false;
  if (bake_->isFlat()) return measureBake(*bake_);
  // Where probes of the heights miss what was aimed at, few places are hardly enough.
  if (!many_places_ && a_.patches == 0 && bake_->report().limit == BakeLimit::kNone) {
    auto few = measureBake(*bake_, 0, Places::kFew);
    if (!few) return few.error();
    at_few_places_ = surelyWithin(*few, kEnough);
    if (at_few_places_) return few;
  }
  return measureBake(*bake_, 0, Places::kRound);
}

Result<void> MeshBuild::bakeUntilKept() {
  std::unique_ptr<MeshBake> best;
  BaseMesh best_base;
  BaseKind best_kind = base_kind_;
  for (;;) {
    if (auto done = growUntilInReach(); !done) return done;
    if (auto done = bake(); !done) return done;
    if (isFirstBase() && toleranceOverDefault() <= 1 && samplesPerVertex() > kFewSamples) {
      const Result<bool> light = useLightFaces();
      if (!light) return light.error();
      if (*light) continue;
    }
    if (auto done = bakeInSmallerPatches(); !done) return done;
    auto found = stages_.run("bake", [&] { return measureRound(); });
    if (!found) return found.error();
    if (at_few_places_) {
      Fidelity of_best = std::exchange(fidelity_, std::move(*found));
      if (auto done = chooseStep(); !done) return done.error();
      if (fidelity_.kept()) return finishBake();
      many_places_ = true;
      found = std::exchange(fidelity_, std::move(of_best));
    }
    const BakeReport baked = bake_->report();
    const Fidelity now = *found;
    const bool better = !best || now.excess() < fidelity_.excess();
    if (better) {
      best = std::move(bake_);
      best_base = base_;
      best_kind = base_kind_;
      fidelity_ = std::move(*found);
    }
    if (a_.patches > 0) break;
    if (now.excess() <= kEnough) {
      // Heights that cannot be rounded take several times the bytes: another base may have better ones.
      if (better) bake_ = std::move(best);
      Fidelity of_best = std::exchange(fidelity_, now);
      auto rounded = chooseStep();
      if (!rounded) return rounded.error();
      if (*rounded) return finishBake();
      if (better) best = std::move(bake_);
      fidelity_ = std::move(of_best);
    }
    auto next = nextBase(now, baked, better);
    if (!next) return next.error();
    if (!*next) break;
  }
  bake_ = std::move(best);
  base_ = std::move(best_base);
  base_kind_ = best_kind;
  if (bake_->report().far_off) {
    best_is_known_ = true;
    if (auto done = bake(); !done) return done;
    auto found = stages_.run("bake", [&] { return measureBake(*bake_); });
    if (!found) return found.error();
    fidelity_ = std::move(*found);
  }
  if (auto done = chooseStep(); !done) return done.error();
  return finishBake();
}

Result<void> MeshBuild::finishBake() {
  if (auto done = stages_.run("bake", [&] { return findKeptTolerance(); }); !done) return done;
  few_places_.reset();
  fidelity_scan_.reset();
  if (auto done = stages_.run("bake", [&] { return bake_->findErrors(); }); !done) return done;
  result_.fidelity = inMm(fidelity_, loaded_.mesh.origin_mm, mmPerUnit(a_.unit));
  if (a_.strict && !fidelity_.kept()) return missed("nothing was written, as --strict asks for");
  return {};
}

Result<bool> MeshBuild::use(BaseKind kind, Result<BaseMesh> base) {
  if (!base && base.error().kind == ErrorKind::kInterrupted) return interrupted(a_);
  if (!base) return false;
  if (kind != base_kind_) round_ = in_vain_ = 0;
  base_kind_ = kind;
  base_ = std::move(*base);
  return true;
}

Result<bool> MeshBuild::grow(BaseDomain::Growth growth) {
  return use(BaseKind::kEven, stages_.run("base", [&] { return domain_->grow(growth); }));
}

Result<void> MeshBuild::growUntilInReach() {
  // Of the target, with about two samples a vertex of the scan. Such heights miss by up to some three times what a
  // bake of the same base does in the end, which takes ten times as long.
  constexpr double kOutOfReach = 4, kSamplesPerVertex = 2, kMostSamples = 1 << 21;
  constexpr int kLeastCellsLog2 = 4;
  while (isFirstBase() && domain_->mayGrow()) {
    const double samples =
        std::min(kSamplesPerVertex * static_cast<double>(loaded_.mesh.positions_mm.size()), kMostSamples);
    const double per_patch = samples / static_cast<double>(base_.patches.size());
    if (auto done = bake(std::max(kLeastCellsLog2, static_cast<int>(std::ceil(std::log2(per_patch) / 2)))); !done)
      return done;
    auto found = stages_.run("bake", [&] { return measureBake(*bake_, 0, Places::kFew); });
    if (!found) return found.error();
    if (found->excess() <= kOutOfReach) break;
    auto grown = useLightFaces();
    if (grown && !*grown) grown = grow();
    if (!grown) return grown.error();
    if (!*grown) break;
  }
  return {};
}

Result<void> MeshBuild::bakeInSmallerPatches() {
  constexpr double kManySamples = 8;
  while (isFirstBase() && bake_->report().cells_log2 > kPageCellsLog2 && samplesPerVertex() > kManySamples) {
    auto grown = grow(BaseDomain::Growth::kToBeFiner);
    if (!grown) return grown.error();
    if (!*grown) break;
    if (auto done = bake(); !done) return done;
  }
  return {};
}

double MeshBuild::creased() {
  const Result<BakeScene>& scene = bake_scene_->get();
  if (!scene) return 0;
  return static_cast<double>(scene->normals->split.size()) / static_cast<double>(loaded_.mesh.triangles.size());
}

Result<bool> MeshBuild::useFaces(uint32_t max_patches) {
  return use(BaseKind::kFaces, stages_.run("base", [&] { return domain_->faces(max_patches); }));
}

Result<bool> MeshBuild::useSimplified(std::span<const RefineRequest> requests) {
  return use(BaseKind::kSimplified,
             stages_.run("base", [&] { return domain_->simplifiedFaces(requests, most_simplified_); }));
}

Result<bool> MeshBuild::useMorePatches() {
  simplified_rounds_ = {};
  return moreOf(
      most_simplified_, mostLightFacesAtLast(faceTexels(), toleranceOverDefault()),
      [&](uint32_t max_patches) { return useFaces(max_patches); }, [&](uint32_t) { return useSimplified({}); });
}

std::vector<double> MeshBuild::imageTexels() const {
  std::vector<double> texels;
  for (const MeshBake::Image& image : textured_.images)
    texels.push_back(image.palette ? 0 : static_cast<double>(image.placeWidth()) * image.placeHeight());
  return texels;
}

bool MeshBuild::repeatsImages(std::span<const double> texels) const {
  return showsImages() && repeatsMuch(timesShown(loaded_.mesh, texels.size()), texels);
}

Result<bool> MeshBuild::useFewFacesAtOnce() {
  // A coarse copy is asked for: patches that are larger than triangles take fewer bytes.
  const bool coarser = toleranceOverDefault() > 1;
  if (a_.patches > 0 || coarser) return false;
  // Before anything is asked of all triangles.
  const size_t triangles = loaded_.mesh.triangles.size();
  const uint32_t most_light = mostLightFacesAtLast(faceTexels(), 1);
  const size_t pieces = loaded_.diagnosis.pieces;
  const bool many_pieces = pieces > kManyPieces && triangles <= 2 * size_t{kManyLightFaces};
  if (most_light > 0 && (many_pieces || isHopeless(pieces, 0, 1)))  // with a patch each
    if (const Result<bool> own = useFaces(most_light); !own || *own) return own;
  if (triangles > 2 * size_t{kManyLightFaces}) return false;
  const std::vector<double> texels = imageTexels();
  const FaceTexels of_faces = faceTexels();
  const bool repeats = repeatsImages(texels);
  const double all = std::accumulate(texels.begin(), texels.end(), 0.0);
  const double of_images = of_faces == FaceTexels::kShown ? all / static_cast<double>(triangles) : 0;
  const uint32_t light = mostLightFaces(of_faces, 1);
  if (triangles <= 2 * size_t{light} && vertexDetail(loaded_.mesh) > kMuchDetail * target().rms_mm)
    return useFaces(light);
  const uint32_t most = of_faces != FaceTexels::kEach && repeats ? kManyFaces : mostFacesAtOnce(of_faces, of_images);
  return triangles <= 2 * size_t{most} ? useFaces(most) : false;
}

FaceTexels MeshBuild::faceTexels() const {
  if (textured_.format.basis != Basis::kAlbedoNormal) return FaceTexels::kEach;
  double all = 0;
  for (const MeshBake::Image& image : textured_.images) all += image.palette ? 0 : image.texelsWithNormals();
  if (!showsImages() || all > static_cast<double>(kMostShownTexels)) return FaceTexels::kSome;
  return all > 0 ? FaceTexels::kShown : FaceTexels::kNone;
}

Result<bool> MeshBuild::useLightFaces() {
  const uint32_t most = mostLightFaces(faceTexels(), toleranceOverDefault());
  if (a_.patches > 0 || most == 0) return false;
  // Before anything is asked of all triangles.
  if (loaded_.mesh.triangles.size() > 2 * size_t{most}) return false;
  return vertexDetail(loaded_.mesh) > kSomeDetail * target().rms_mm ? useFaces(most) : false;
}

Result<void> MeshBuild::replaceHopelessBase() {
  if (a_.patches > 0 || !isHopeless(base_.patches.size(), domain_->lostArea(), toleranceOverDefault())) return {};
  // Of very many pieces simplified triangles are not few either.
  const bool many = base_.patches.size() > 2 * size_t{kMostPatches};
  const uint32_t most_light = many ? mostLightFacesAtLast(faceTexels(), toleranceOverDefault()) : 0;
  const Result<bool> replaced = replaceFirstBase(
      std::max(most_light, mostFacesFirst()), [&](uint32_t max_patches) { return useFaces(max_patches); },
      [&] { return useSimplified({}); });
  if (!replaced) return replaced.error();
  if (*replaced) return {};
  const Result<bool> more = useMorePatches();
  return more ? Result<void>() : more.error();
}

Result<bool> MeshBuild::nextBase(const Fidelity& now, const BakeReport& baked, bool better) {
  constexpr double kLargeMiss = 8;  // of the target's largest: sides at a quarter there, not at a half
  // Beyond it patches of even size would have to be too many. Near the target they make smaller packages.
  constexpr double kHopeless = SimplifiedRounds::kHopeless, kFarOff = SimplifiedRounds::kFarOff;
  if (isFirstBase()) {
    auto done = useLightFaces();
    if (done && !*done && domain_->mayGrow()) done = grow();
    if (!done || *done) return done;
  }
  const bool first = round_++ == 0;
  if (base_kind_ == BaseKind::kFaces) return false;  // it is the scan
  if (first && base_kind_ == BaseKind::kEven) {
    // Few triangles may be patches themselves: these show the scan as it is.
    auto done = useFaces(mostFacesBeforeSmaller(creased()));
    if (!done || *done) return done;
  }
  std::vector<RefineRequest> requests;
  auto ask = [&](const std::vector<FidelityViolation>& missed) {
    for (const FidelityViolation& m : missed)
      requests.push_back({m.position_mm, m.distance_mm > kLargeMiss * now.target.max_mm ? 64.0f : 16.0f});
  };
  if (base_kind_ == BaseKind::kSimplified) {
    using OwnTriangles = SimplifiedRounds::OwnTriangles;
    const size_t triangles = loaded_.mesh.triangles.size();
    const auto own = triangles <= 2 * size_t{kFewFaces}    ? OwnTriangles::kFew
                     : triangles <= 2 * size_t{kManyFaces} ? OwnTriangles::kMany
                     : most_simplified_ == kMostSimplified ? OwnTriangles::kNone
                     : triangles > kLargeScan              ? OwnTriangles::kFarTooMany
                                                           : OwnTriangles::kTooMany;
    const auto next = simplified_rounds_.after({now.excess(), fidelity_.excess(), better, fidelity_.kept()}, own);
    if (next == SimplifiedRounds::Next::kEnd) return fidelity_.kept() ? false : useMorePatches();
    if (next == SimplifiedRounds::Next::kSameBase) {
      missed_first_ = now.violations;
      return true;
    }
    ask(simplified_rounds_.firstWasBetter() ? missed_first_ : now.violations);
    if (next == SimplifiedRounds::Next::kOwnTriangles) {
      // Thin parts and parts that touch: the scan's own triangles show them, at many times the bytes.
      auto done = useFaces(kManyFaces);
      if (!done || *done) return done;
      if (simplified_rounds_.over()) return fidelity_.kept() ? false : useMorePatches();
    }
  } else if (now.excess() <= kHopeless || !first) {
    // Where the samples ran out, those of the next bases are chosen by the tolerance.
    more_samples_ |= baked.limit == BakeLimit::kSamples;
    // Far off, a base that is finer may first be worse, before it finds the surface.
    in_vain_ = better || fidelity_.excess() > kFarOff ? 0 : in_vain_ + 1;
    // Near the target the next base is a small one: what is refined where it missed comes to keep it sooner or later.
    const int more = fidelity_.excess() < SimplifiedRounds::kNearly ? kInVain : 0;
    // Where they would be nearly as many as there may be, simplified triangles show more.
    constexpr uint32_t kMostEven = kMostPatches / 8 * 7;
    ask(now.violations);
    if (round_ <= kRounds + more && in_vain_ < kInVain + more && domain_->patchesToRefine(requests) <= kMostEven) {
      refined_ = true;
      const uint32_t least =
          leastRefined(loaded_.mesh.triangles.size(), base_.patches.size(), baked.samples, baked.cells_log2);
      auto done =
          use(BaseKind::kEven, stages_.run("base", [&] { return domain_->refine(requests, kMostPatches, least); }));
      if (!done || *done) return done;
    }
    requests.clear();  // of another base
  }
  auto done = base_kind_ == BaseKind::kEven ? useFaces(mostFacesFirst()) : Result<bool>(false);
  if (done && !*done) done = useSimplified(requests);
  if (done && !*done && fidelity_.excess() > kFarOff) done = useFaces(kManyFaces);
  if (!done || *done || fidelity_.kept()) return done;
  return useMorePatches();
}

Result<bool> MeshBuild::chooseStep() {
  if (bake_->isFlat()) return true;
  const int kTries = base_kind_ == BaseKind::kEven ? 4 : 3;  // bases that lie close to the scan have few heights
  double set = 0;
  auto change = [&](double step) -> Result<double> {
    set = step;
    if (auto done = bake_->setStep(step); !done) return done.error();
    return bake_->stepChangeMm();
  };
  return stages_.run("bake", [&]() -> Result<bool> {
    auto few = at_few_places_ ? Result<Fidelity>(fidelity_) : measureBake(*bake_, 0, Places::kFew);
    if (!few) return few.error();
    auto chosen = chooseStepFor(
        fidelity_, *few, kTries, change, [&] { return measureBake(*bake_, 0, Places::kFew); },
        [&] { return measureBake(*bake_); });
    if (!chosen) return chosen.error();
    if (set != chosen->step_mm)
      if (auto done = bake_->setStep(chosen->step_mm); !done) return done.error();
    if (chosen->measured) {
      fidelity_ = std::move(chosen->fidelity);
    } else if (at_few_places_) {
      auto found = measureBake(*bake_);
      if (!found) return found.error();
      fidelity_ = std::move(*found);
    }
    at_few_places_ = false;
    return chosen->step_mm > 0;
  });
}

Result<void> MeshBuild::findKeptTolerance() {
  if (fidelity_.kept() || a_.patches > 0) return {};
  constexpr double kLarger = 1.25;
  constexpr int kTries = 12;
  double next_mm = mm(fidelity_.target.p99_9_mm * fidelity_.excess());
  for (int i = 0; i < kTries; ++i, next_mm *= kLarger) {
    // As the sentence gives it: two digits, rounded up.
    const double digit = std::pow(10.0, std::floor(std::log10(next_mm)) - 1);
    const double tolerance_mm = std::ceil(next_mm / digit) * digit;
    auto found = measureBake(*bake_, tolerance_mm / mm(1));
    if (!found) return found.error();
    if (!found->kept()) continue;
    kept_tolerance_mm_ = tolerance_mm;
    return {};
  }
  return {};
}

// How far off, where, and what would help.
Error MeshBuild::missed(const std::string& what_was_done) const {
  char hint[200];
  if (a_.patches > 0) {
    std::snprintf(hint, sizeof hint, "%s; leave --patches out, or ask for more than %zu", what_was_done.c_str(),
                  base_.patches.size());
  } else if (kept_tolerance_mm_ > 0) {
    std::snprintf(hint, sizeof hint, "%s; --tolerance %.2g is kept", what_was_done.c_str(), kept_tolerance_mm_);
  } else {
    std::snprintf(hint, sizeof hint, "%s", what_was_done.c_str());
  }
  return {ErrorKind::kDifference, a_.mesh, missedTarget(result_.fidelity), hint, {}};
}

Result<void> MeshBuild::pack() {
  std::vector<Provenance> sources{mesh_file_.get()};
  sources.insert(sources.end(), textured_.sources.begin(), textured_.sources.end());
  result_.package = a_.package.output;
  BakeReport baked = bake_->report();
  baked.tolerance_mm =
      toleranceOf(a_, fidelity_.diagonal_mm) > 0 ? mm(toleranceOf(a_, fidelity_.diagonal_mm)) : mm(baked.tolerance_mm);
  baked.deviation_mm = mm(baked.deviation_mm);
  result_.mesh = meshJson(sources[0].name, a_.unit, loaded_.diagnosis, bake_->base(), baked, a_.patches);
  if (a_.up != 'y') result_.mesh["up"] = std::string(1, a_.up);
  if (a_.rotate_deg != glm::dvec3(0)) result_.mesh["rotate_deg"] = {a_.rotate_deg.x, a_.rotate_deg.y, a_.rotate_deg.z};
  BuildOptions package = a_.package;
  package.texture_tolerance = a_.texture_tolerance;
  package.manifest_extra =
      nlohmann::ordered_json{{"mesh", result_.mesh}}.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  // The scan and what it was baked into stay in memory beside; the rest of the budget, but for the least, is the
  // package's.
  constexpr double kSlight = 0.5;  // of the target's RMS
  constexpr uint64_t kKeptBytes = uint64_t{16} << 20;
  const uint64_t held = Memory::now();
  package.kept_bytes = kKeptBytes;
  package.memory_budget_bytes = std::max(package.memory_budget_bytes, held + kLeastPackageBytes) - held;
  auto built = stages_.run("package", [&] {
    return buildPatchesWithProgress(
        BakedPatches(*bake_, baseStep(), mm(1), mm(kSlight * fidelity_.target.rms_mm), sources, textured_.format,
                     textured_.images, textured_.jpegs, textured_.normal_jpegs),
        package);
  });
  if (!built) return built.error().kind == ErrorKind::kInterrupted ? interrupted(a_) : built.error();
  result_.pages = built->pages;
  result_.package_bytes = built->package_bytes;
  result_.triangles_read = loaded_.diagnosis.triangles_read;
  result_.vertices = loaded_.diagnosis.vertices;
  {
    auto opened = Package::open(a_.package.output);
    if (!opened) return opened.error();
    auto relief = reliefBytes(**opened);
    if (!relief) return relief.error();
    result_.relief_bytes = *relief;
    const PatchDomain& domain = (*opened)->manifest().domain;
    result_.texture_tolerance = a_.texture_tolerance;
    for (int level = 0; level <= domain.texture_depth; ++level) result_.texture_nodes += domain.nodeCount(level);
    result_.texture_nodes_left_out = domain.untexturedNodeCount();
    countImages();
  }
  return {};
}

void MeshBuild::countImages() {
  for (const MeshBake::Image& image : textured_.images) result_.normal_maps += !image.normals.empty();
  auto isImage = [&](size_t i) { return i < textured_.images.size() && !textured_.images[i].palette; };
  const std::vector<bool> shown = bake_->shownImages();
  for (size_t i = 0; i < shown.size(); ++i) result_.shown_images += shown[i] && isImage(i);
  if (result_.shown_images == 0) return;
  for (uint32_t p = 0; p < bake_->base().patches.size(); ++p) {
    const auto on = bake_->imagesOn(p);
    result_.patches_with_images += on && (isImage(on->image[0]) || isImage(on->image[1]));
  }
}

Result<void> MeshBuild::measure() {
  DistanceOptions distance_run;
  distance_run.workers = a_.package.workers;
  // Every sample is searched in the first part, however far away, and compared with all others: small parts of a large
  // surface take long. Parts that grow with the scan are few, and where the scan alone is beyond the budget they are
  // not that small either.
  constexpr uint64_t kPartBytes = uint64_t{128} << 20, kPartBytesPerTriangle = 64;
  const bool beyond = Memory::now() > a_.package.memory_budget_bytes;
  distance_run.memory_bytes = std::min(memoryLeft(uint64_t{beyond ? 64u : 16u} << 20),
                                       std::max(kPartBytes, kPartBytesPerTriangle * loaded_.mesh.triangles.size()));
  auto distance =
      stages_.run("distance", distance_run, [&] { return measureDistance(loaded_.mesh, *bake_, 3, distance_run); });
  if (!distance) {
    Error error = distance.error();
    if (error.kind == ErrorKind::kInterrupted)
      error.hint = a_.package.output + " is whole; its distances were not measured, no report was written";
    return error;
  }
  MeshDistance& d = result_.distance = std::move(*distance);
  for (DistanceStats* way : {&d.to_baked, &d.to_scan}) {
    way->max_mm = mm(way->max_mm);
    way->rms_mm = mm(way->rms_mm);
    for (double& p : way->percentiles_mm) p = mm(p);
  }
  d.diagonal_mm = mm(d.diagonal_mm);
  for (float& v : d.scan_vertex_mm) v = static_cast<float>(mm(v));
  return {};
}

Result<void> MeshBuild::writeReports() const {
  if (!a_.report.empty())
    if (auto written = writeMeshReport(a_.report, loaded_.mesh, result_); !written) return written;
  if (!a_.json_file.empty()) {
    const std::string text = reportJson(result_).dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
    if (auto written = writeFile(a_.json_file, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
        !written || a_.json_file == "-")
      return written;
  }
  return {};
}

void MeshBuild::printSummary() const {
  double seconds = 0;
  uint64_t peak = 0;
  std::string each;
  for (const StageCost& s : stages_.costs) {
    char text[64];
    std::snprintf(text, sizeof text, "%s%s %.1f s", each.empty() ? "" : ", ", s.name.c_str(), s.seconds);
    each += text;
    seconds += s.seconds;
    peak = std::max(peak, s.peak_bytes);
  }
  printOutf("%s: %llu pages, %.1f MiB, %.1f s (%s), in at most %.0f MiB of memory\n%s", a_.package.output.c_str(),
            static_cast<unsigned long long>(result_.pages), static_cast<double>(result_.package_bytes) / (1 << 20),
            seconds, each.c_str(), static_cast<double>(peak) / (1 << 20), meshText(result_.mesh).c_str());
  if (result_.shown_images > 0)
    printOutf("  images    %llu stored once and as they are; %llu patches show them\n",
              static_cast<unsigned long long>(result_.shown_images),
              static_cast<unsigned long long>(result_.patches_with_images));
  if (result_.normal_maps > 0)
    printOutf("  normals   of %llu %s are used\n", static_cast<unsigned long long>(result_.normal_maps),
              result_.normal_maps == 1 ? "map" : "maps");
  if (result_.texture_nodes_left_out > 0)
    printOutf(
        "  texture   %llu of %llu nodes have no pages: what is coarser shows them within %.3g steps of 255 "
        "(normals %.3g degrees, RMS %.2g)\n",
        static_cast<unsigned long long>(result_.texture_nodes_left_out),
        static_cast<unsigned long long>(result_.texture_nodes), result_.texture_tolerance,
        glm::degrees(kNormalTolerance * result_.texture_tolerance / 127.5),
        glm::degrees(kRmsTolerance * result_.texture_tolerance / 127.5));
  const Fidelity& f = result_.fidelity;
  auto way = [&](const char* name, const OneSidedFidelity& w) {
    printOutf("  %-9s RMS %s, 99.9 %% within %s, all within %s; %.4g %% of the area beyond %s\n", name,
              millimetres(w.rms_mm).c_str(), millimetres(w.p99_9_mm).c_str(), millimetres(w.max_mm).c_str(),
              100 * w.area_beyond, millimetres(f.target.max_mm).c_str());
  };
  printOutf("  fidelity  %.1f dB (diagonal %s, %llu places each way), %s\n", f.psnr_db(),
            millimetres(f.diagonal_mm).c_str(), static_cast<unsigned long long>(f.to_scan.samples),
            f.kept() ? "the target is kept" : "the target is missed");
  way("missing", f.to_drawn);
  way("too much", f.to_scan);
  if (measured()) {
    const MeshDistance& d = result_.distance;
    printOutf("  distance  at most %s from scan to patches, %s back; RMS %s and %s, %.1f dB\n",
              millimetres(d.to_baked.max_mm).c_str(), millimetres(d.to_scan.max_mm).c_str(),
              millimetres(d.to_baked.rms_mm).c_str(), millimetres(d.to_scan.rms_mm).c_str(), d.psnr_db);
  }
}

}  // namespace

Result<void> buildFromMesh(const MeshBuildArguments& a) {
  MeshBuild build(a);
  if (auto done = build.run(); !done) return done;
  if (!a.quiet && a.json_file != "-") build.printSummary();
  return build.verdict();
}

}  // namespace relievo
