// displacement_table - which representation of a scan's surface is worth its bits? --help says more.
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "geometry/bake/fidelity.h"
#include "geometry/bake/first_base.h"
#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/mesh_order.h"
#include "geometry/remesh/base_domain.h"
#include "geometry/scan/mesh_read.h"
#include "src/base/file.h"
#include "src/base/standard_output.h"
#include "tools/bench/displacement_kinds.h"
#include "tools/bench/displacement_planes.h"

using namespace relievo;
namespace fs = std::filesystem;

namespace {

constexpr const char* kHelp =
    R"(displacement_table - fidelity and bits of scalar and of vector displacement of the same scans.

  displacement_table [--build FOLDER] [--finer N] [--markdown FILE] [SCAN...]

    --build FOLDER    where relievo and tests/write_scan_shapes were built [build]
    --finer N         how many times as many cells a side the ten shapes of tests/geometry/scan_shapes.h get as tests
                      have; 0: only the scans named are measured [2]
    --markdown FILE   tables replace what stands in it between the lines <!-- tables --> and <!-- end --> [standard
                      output]

Example: displacement_table --markdown geometry/bake/UNDERCUTS.md
Exit codes: 0 ok; 1 usage; 2 input or output; 4 a program is missing or failed.
)";

[[noreturn]] void fail(int code, const std::string& what) {
  std::fprintf(stderr, "displacement_table: error: %s\n", what.c_str());
  std::exit(code);
}
template <class T>
T must(Result<T> result) {
  if (!result) fail(4, result.error().text());
  return std::move(*result);
}

struct Options {
  fs::path build = "build";
  int finer = 2;
  std::string markdown;
  std::vector<std::string> scans;
};

// In the order of the table's rows.
enum Representation : size_t {
  kEven,
  kProgram,
  kNearest,
  kNearestMissed,
  kFittedMissed,
  kDirections,
  kBorder,
  kRefined,
  kRefinedFitted,
  kRepresentationCount
};
constexpr std::array<const char*, kRepresentationCount> kRepresentations{"even patches",
                                                                         "the program",
                                                                         "vectors everywhere",
                                                                         "vectors where missed",
                                                                         "fitted vectors where missed",
                                                                         "fitted directions",
                                                                         "border offset",
                                                                         "refined once",
                                                                         "refined once, fitted vectors where missed"};
constexpr double kCoarseDb = 84;  // a second target, which more representations reach

struct Row {
  std::string scan;
  Representation kind = kEven;
  size_t patches = 0, vector_patches = 0;
  uint64_t samples = 0;
  double db = 0, beyond = 0, bits = 0;
  double coarse_bits = 0;  // for kCoarseDb; 0: not reached
  bool kept = false, front = false;
};

std::string inQuotes(const fs::path& path) { return "'" + path.string() + "'"; }
void runProgram(const std::string& command) {
  const int status = std::system(command.c_str());
  constexpr int kMissed = 7;  // relievo's exit code where the target is missed
  if (status != 0 && !(WIFEXITED(status) && WEXITSTATUS(status) == kMissed)) fail(4, command + " failed");
}

class ScanRows {
 public:
  ScanRows(const Options& options, std::string name, std::string file, fs::path folder)
      : options_(options), name_(std::move(name)), file_(std::move(file)), folder_(std::move(folder)) {}

  std::vector<Row> rows() {
    MeshReadOptions read;
    read.keep_units = true;
    TriMesh mesh = must(readMesh(file_, read)).mesh;
    if (needsOrder(mesh)) orderTriangles(mesh, 0, nullptr);
    const double diagonal = diagonalOf(mesh);
    target_ = FidelityTarget::of(diagonal);
    tolerance_ = kGridTolerance * diagonal;
    vertices_ = static_cast<double>(mesh.positions_mm.size());
    fidelity_scan_ = std::make_unique<FidelityScan>(mesh, 0);
    const BakeScene scene = must(makeBakeScene(mesh, {}));
    const std::unique_ptr<BaseDomain> domain = must(BaseDomain::create(mesh));
    base_step_ = baseStepFor(target_.rms_mm, diagonalOf(mesh));
    const BaseMesh base = onLattice(must(domain->make()), base_step_);
    auto bake = must(MeshBake::create(mesh, {}, base, {}, scene));
    const DisplacedSamples samples(mesh, *bake);
    const std::vector<glm::dvec3> heights = samples.heights(*bake);
    samples_ = bake->report().samples;

    MeasuredPlaces places;
    std::vector<uint32_t> patch_of;
    const Fidelity exact = measure(DisplacementPlanes(samples, heights, 0), &places, &patch_of);
    const Fidelity control = must(measureFidelity(*fidelity_scan_, *bake, target_));
    std::fprintf(stderr, "%s: %.2f dB here, %.2f dB by measureFidelity()\n", name_.c_str(), exact.psnr_db(),
                 control.psnr_db());
    const std::vector<uint8_t> all(base.patches.size(), 1), missed = missedPatches(places, patch_of, base);

    add(kEven, samples, heights, *bake);
    addProgram();
    const ClosestSearch& search = fidelity_scan_->search();
    add(kNearest, samples, nearestComponents(samples, heights, samplesOn(samples, all), search), *bake);
    const std::vector<uint8_t> on_missed = samplesOn(samples, missed);
    constexpr uint64_t kFitPlaces = 100'000;
    const FidelityScan many(mesh, 0, kFitPlaces);
    if (std::ranges::count(missed, uint8_t{1}) > 0) {
      add(kNearestMissed, samples, nearestComponents(samples, heights, on_missed, search), *bake);
      add(kFittedMissed, samples, fittedComponents(samples, heights, on_missed, many), *bake);
    }
    addBake(kDirections, mesh, onLattice(withFittedDirections(base, mesh), base_step_), {}, scene, nullptr);
    size_t moved = 0;
    samples_ = bake->report().samples;
    const std::vector<glm::dvec3> bordered = borderComponents(samples, heights, moved);
    if (moved > 0) add(kBorder, samples, bordered, *bake);
    if (!control.kept()) {
      std::vector<RefineRequest> requests;
      for (const FidelityViolation& v : control.violations) requests.push_back({v.position_mm});
      constexpr uint32_t kMostPatches = 4096;
      if (auto refined = domain->refine(requests, kMostPatches); refined.ok())
        addBake(kRefined, mesh, onLattice(*refined, base_step_), {.touching = Touching::kFacing}, scene, &many);
    }
    return std::move(rows_);
  }

 private:
  // Within which the surface is made coarse for measuring, in diagonals: as fidelity.cpp has it.
  static constexpr double kGridTolerance = 4e-5;

  Fidelity measure(const DisplacementPlanes& planes, MeasuredPlaces* places = nullptr,
                   std::vector<uint32_t>* patches = nullptr) const {
    std::vector<uint32_t> patch_of;
    const TriMesh surface = planes.surface(tolerance_, patch_of);
    Fidelity out = fidelityOf(*fidelity_scan_, surface, target_, places);
    if (patches) *patches = std::move(patch_of);
    return out;
  }

  // Where the RMS of the distances of a patch's places, both ways, is beyond the target's.
  std::vector<uint8_t> missedPatches(const MeasuredPlaces& places, const std::vector<uint32_t>& patch_of,
                                     const BaseMesh& base) const {
    std::vector<double> squares(base.patches.size()), count(base.patches.size());
    for (size_t i = 0; i < places.distances_mm.size(); ++i) {
      const uint32_t patch = patch_of[places.triangles[i]];
      squares[patch] += double{places.distances_mm[i]} * places.distances_mm[i];
      ++count[patch];
    }
    std::vector<uint8_t> out(base.patches.size());
    for (size_t p = 0; p < out.size(); ++p) out[p] = squares[p] > count[p] * target_.rms_mm * target_.rms_mm;
    return out;
  }

  // A bake over another base, and if `places` are given with vectors, too.
  void addBake(Representation kind, const TriMesh& mesh, const BaseMesh& base, const BakeOptions& options,
               const BakeScene& scene, const FidelityScan* places) {
    auto bake = must(MeshBake::create(mesh, {}, base, options, scene));
    const DisplacedSamples samples(mesh, *bake);
    const std::vector<glm::dvec3> heights = samples.heights(*bake);
    samples_ = bake->report().samples;
    add(kind, samples, heights, *bake);
    if (!places) return;
    MeasuredPlaces measured;
    std::vector<uint32_t> patch_of;
    measure(DisplacementPlanes(samples, heights, 0), &measured, &patch_of);
    const auto chosen = samplesOn(samples, missedPatches(measured, patch_of, bake->base()));
    add(kRefinedFitted, samples, fittedComponents(samples, heights, chosen, *places), *bake);
  }

  // With the largest step that the target allows or, where it is missed, that hardly adds to the RMS.
  void add(Representation kind, const DisplacedSamples& samples, const std::vector<glm::dvec3>& components,
           MeshBake& bake) {
    constexpr double kHardly = 1.0116, kMargin = 0.95;  // 0.1 dB; what another choice of places may add
    constexpr double kNoise = 0.165;                    // of a step, added to the RMS (chooseStep() in build_mesh.cpp)
    constexpr double kSlight = 0.5;                     // of the target's RMS, as `relievo build` has it
    constexpr int kTries = 3, kMostTries = 12;
    if (auto done = bake.findErrors(); !done) fail(4, done.error().text());
    const Fidelity exact = measure(DisplacementPlanes(samples, components, 0));
    auto rmsOf = [](const Fidelity& f) { return std::max(f.to_drawn.rms_mm, f.to_scan.rms_mm); };
    struct Stepped {
      double step_mm = 0, bits = 0;
      Fidelity fidelity;
    };
    auto coarsest = [&](double rms_mm, bool keep) {
      const double own = rmsOf(exact), most = std::max(kMargin * rms_mm, kHardly * own);
      auto beside = [&](double rms) { return std::sqrt(std::max(0.0, rms * rms - own * own)); };
      constexpr double kLeastStep = 0.3, kMostStep = 16;  // times the target's RMS
      Stepped best{.step_mm = 0, .bits = 0, .fidelity = exact};
      double step = std::min(beside(most) / kNoise, kMostStep * rms_mm);
      const double least = kLeastStep * target_.rms_mm;
      for (int i = 0; i < (best.step_mm > 0 ? kTries : kMostTries) && step > least; ++i) {
        const Fidelity f = measure(DisplacementPlanes(samples, components, step));
        const bool good = rmsOf(f) <= most && (!keep || f.kept());
        if (good && step > best.step_mm) best = {step, 0, f};
        const double added = beside(rmsOf(f)), next = added > 0 ? 0.98 * step * beside(most) / added : 1.5 * step;
        if (good && (next < 1.07 * step || step >= kMostStep * rms_mm)) break;
        step = good ? std::min(next, 1.5 * step) : std::min(next, 0.85 * step);
      }
      const DisplacementPlanes planes(samples, components, best.step_mm);
      best.bits = static_cast<double>(must(
                      planes.bits(bake, kSlight * target_.rms_mm, base_step_, (folder_ / "plane.relievo").string()))) /
                  vertices_;
      return best;
    };
    const Stepped fine = coarsest(target_.rms_mm, exact.kept());
    Row row{.scan = name_, .kind = kind, .patches = samples.context.layout.patches, .samples = samples_};
    row.vector_patches = DisplacementPlanes(samples, components, fine.step_mm).patchesAside();
    row.bits = fine.bits;
    const double coarse_rms = exact.diagonal_mm * std::pow(10, -kCoarseDb / 20);
    if (rmsOf(exact) <= kMargin * coarse_rms) row.coarse_bits = coarsest(coarse_rms, false).bits;
    const Fidelity& f = fine.fidelity;
    row.db = f.psnr_db();
    row.beyond = std::max(f.to_drawn.area_beyond, f.to_scan.area_beyond);
    row.kept = f.kept();
    take(std::move(row));
  }
  void take(Row row) {
    std::fprintf(stderr, "  %s: %.2f dB, %.2f bits a vertex (%.2f), %zu of %zu patches with vectors%s\n",
                 kRepresentations[row.kind], row.db, row.bits, row.coarse_bits, row.vector_patches, row.patches,
                 row.kept ? "" : ", missed");
    rows_.push_back(std::move(row));
  }

  nlohmann::json build(const std::string& tolerance) const {
    const fs::path report = folder_ / "report.json", package = folder_ / "scan.relievo";
    runProgram(inQuotes(options_.build / "relievo") + " build --mesh " + inQuotes(file_) + " -o " + inQuotes(package) +
               " --json " + inQuotes(report) + tolerance + " > /dev/null 2>&1");
    return nlohmann::json::parse(std::ifstream(report));
  }
  void addProgram() {
    const nlohmann::json json = build("");
    const auto& fidelity = json["fidelity"];
    Row row{.scan = name_, .kind = kProgram};
    row.patches = json["mesh"]["patches"];
    row.samples = json["mesh"]["samples"];
    row.bits = json["relief_bits_per_vertex"];
    row.db = fidelity["psnr_db"];
    row.kept = fidelity["kept"];
    row.beyond = std::max(beyondOf(fidelity["missing"]), beyondOf(fidelity["too_much"]));
    // A target's RMS is a tenth of its tolerance (geometry/bake/fidelity.h).
    char tolerance[64];
    std::snprintf(tolerance, sizeof tolerance, " --tolerance %.6g%%", 1000 * std::pow(10, -kCoarseDb / 20));
    const nlohmann::json coarse = build(tolerance);
    if (coarse["fidelity"]["psnr_db"] >= kCoarseDb) row.coarse_bits = coarse["relief_bits_per_vertex"];
    take(std::move(row));
  }
  static double beyondOf(const nlohmann::json& way) { return way["area_beyond"]; }

  const Options& options_;
  std::string name_, file_;
  fs::path folder_;
  FidelityTarget target_;
  double tolerance_ = 0, vertices_ = 0, base_step_ = 0;  // base_step_: of the lattice of the base's corners
  uint64_t samples_ = 0;
  std::unique_ptr<FidelityScan> fidelity_scan_;
  std::vector<Row> rows_;
};

// Those that no other row of the same scan equals or exceeds in dB with as few bits or fewer.
void markFront(std::vector<Row>& rows) {
  for (Row& row : rows)
    row.front = std::ranges::none_of(rows, [&](const Row& other) {
      return other.scan == row.scan && other.db >= row.db && other.bits <= row.bits &&
             (other.db > row.db || other.bits < row.bits);
    });
}

std::string fixed(double v, int digits) {
  char text[32];
  std::snprintf(text, sizeof text, "%.*f", digits, v);
  return text;
}
std::string markdownTable(const std::vector<std::vector<std::string>>& rows) {
  std::string out;
  for (size_t i = 0; i < rows.size(); ++i) {
    out += "|";
    for (const std::string& cell : rows[i]) out += " " + cell + " |";
    out += "\n";
    if (i > 0) continue;
    for (size_t k = 0; k < rows[0].size(); ++k) out += k > 0 ? " --- |" : "| --- |";
    out += "\n";
  }
  return out;
}
double median(std::vector<double> v) {
  if (v.empty()) return 0;
  std::ranges::sort(v);
  return (v[(v.size() - 1) / 2] + v[v.size() / 2]) / 2;
}

std::string tablesOf(const std::vector<Row>& rows) {
  std::vector<std::string> scans;
  for (const Row& row : rows)
    if (std::ranges::find(scans, row.scan) == scans.end()) scans.push_back(row.scan);
  auto find = [&](const std::string& scan, size_t kind) -> const Row* {
    for (const Row& row : rows)
      if (row.scan == scan && row.kind == kind) return &row;
    return nullptr;
  };
  // Of a scan, the least of a figure that rows have above 0.
  auto least = [&](const std::string& scan, auto figure) {
    const Row* best = nullptr;
    for (const Row& row : rows)
      if (row.scan == scan && figure(row) > 0 && (!best || figure(row) < figure(*best))) best = &row;
    return best;
  };
  auto keptBits = [](const Row& row) { return row.kept ? row.bits : 0; };
  auto coarseBits = [](const Row& row) { return row.coarse_bits; };
  const std::string coarse = fixed(kCoarseDb, 0) + " dB";
  std::vector<std::vector<std::string>> summary{{"representation", "shapes", "target kept", coarse + " reached",
                                                 "keeps the target with at most 5 % more than the fewest bits",
                                                 coarse + " with at most 5 % more than the fewest bits", "on the front",
                                                 "median dB", "median bits a vertex"}};
  for (size_t kind = 0; kind < kRepresentations.size(); ++kind) {
    size_t count = 0, kept = 0, reached = 0, front = 0, fewest = 0, fewest_coarse = 0;
    std::vector<double> db, bits;
    for (const std::string& scan : scans) {
      const Row* row = find(scan, kind);
      if (!row) continue;
      ++count;
      kept += row->kept;
      reached += row->coarse_bits > 0;
      front += row->front;
      const Row *first = least(scan, keptBits), *coarse_first = least(scan, coarseBits);
      // Nobody sees a difference of so little, which the choice of steps makes, too.
      constexpr double kAlike = 1.05;
      fewest += row->kept && row->bits <= kAlike * first->bits;
      fewest_coarse += row->coarse_bits > 0 && row->coarse_bits <= kAlike * coarse_first->coarse_bits;
      db.push_back(row->db);
      bits.push_back(row->bits);
    }
    summary.push_back({kRepresentations[kind], std::to_string(count), std::to_string(kept), std::to_string(reached),
                       std::to_string(fewest), std::to_string(fewest_coarse), std::to_string(front),
                       fixed(median(db), 1), fixed(median(bits), 1)});
  }
  std::vector<std::vector<std::string>> fronts{{"shape", "front at the default target, from few bits to many",
                                                "fewest bits that keep the target", "fewest bits for " + coarse}};
  for (const std::string& scan : scans) {
    std::vector<const Row*> on;
    for (const Row& row : rows)
      if (row.scan == scan && row.front) on.push_back(&row);
    std::ranges::sort(on, {}, [](const Row* row) { return row->bits; });
    std::string text;
    for (const Row* row : on)
      text += std::string(text.empty() ? "" : "; ") + kRepresentations[row->kind] + " (" + fixed(row->db, 1) + " dB, " +
              fixed(row->bits, 1) + ")";
    auto named = [&](auto figure) {
      const Row* row = least(scan, figure);
      return row ? std::string(kRepresentations[row->kind]) + " (" + fixed(figure(*row), 1) + ")" : "none";
    };
    fronts.push_back({scan, text, named(keptBits), named(coarseBits)});
  }
  std::vector<std::vector<std::string>> all{{"shape", "representation", "patches", "with vectors", "samples",
                                             "fidelity, dB", "area beyond the target, %", "target kept",
                                             "bits a vertex", "bits a vertex for " + coarse}};
  for (const Row& row : rows)
    all.push_back({row.scan, kRepresentations[row.kind], std::to_string(row.patches),
                   std::to_string(row.vector_patches), std::to_string(row.samples), fixed(row.db, 1),
                   fixed(100 * row.beyond, 3), row.kept ? "yes" : "**no**", fixed(row.bits, 1),
                   row.coarse_bits > 0 ? fixed(row.coarse_bits, 1) : "-"});
  return markdownTable(summary) + "\n" + markdownTable(fronts) + "\n" + markdownTable(all);
}

std::string linesOf(const fs::path& file) {
  std::ifstream in(file);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

void write(const std::string& markdown, const std::string& tables) {
  if (markdown.empty()) {
    if (auto printed = printOut(tables); !printed) fail(2, printed.error().text());
    return;
  }
  const std::string page = linesOf(markdown), begin = "<!-- tables -->\n", end = "<!-- end -->\n";
  const size_t from = page.find(begin), to = page.find(end);
  if (from == std::string::npos || to == std::string::npos || to < from)
    fail(2, markdown + ": expected the lines <!-- tables --> and <!-- end -->, found none");
  const std::string text = page.substr(0, from) + begin + "\n" + tables + "\n" + page.substr(to);
  if (auto written = writeFile(markdown, {reinterpret_cast<const uint8_t*>(text.data()), text.size()}); !written)
    fail(2, written.error().text());
}

Options parse(int argc, char** argv) {
  Options out;
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument == "--help") {
      (void)printOut(kHelp);  // the error stays: flushOut() returns it
      std::exit(flushOut().ok() ? 0 : 2);
    }
    auto value = [&] {
      if (++i == argc) fail(1, argument + ": expected a value, found none");
      return std::string(argv[i]);
    };
    if (argument == "--build") out.build = value();
    else if (argument == "--markdown") out.markdown = value();
    else if (argument == "--finer") out.finer = std::atoi(value().c_str());
    else if (argument.starts_with("-")) fail(1, argument + " is no option; --help lists them");
    else out.scans.push_back(argument);
  }
  if (out.finer < 0 || out.finer > 16) fail(1, "--finer: expected 0 to 16");
  return out;
}

}  // namespace

int main(int argc, char** argv) {
  const Options options = parse(argc, argv);
  std::string pattern = (fs::temp_directory_path() / "displacement-XXXXXX").string();
  if (!::mkdtemp(pattern.data())) fail(2, pattern + ": no such folder can be made");
  const fs::path folder = pattern;
  std::vector<std::array<std::string, 2>> scans;  // name, file
  if (options.finer > 0) {
    runProgram(inQuotes(options.build / "tests" / "write_scan_shapes") + " " + inQuotes(folder) + " " +
               std::to_string(options.finer) + " > " + inQuotes(folder / "shapes"));
    std::ifstream shapes(folder / "shapes");
    for (std::string line; std::getline(shapes, line);) scans.push_back({fs::path(line).stem(), line});
  }
  for (const std::string& scan : options.scans) scans.push_back({fs::path(scan).stem(), scan});
  std::vector<Row> rows;
  for (const auto& [name, file] : scans) {
    for (Row& row : ScanRows(options, name, file, folder).rows()) rows.push_back(std::move(row));
    markFront(rows);
    if (!options.markdown.empty()) write(options.markdown, tablesOf(rows));  // as far as it goes
  }
  fs::remove_all(folder);
  if (options.markdown.empty()) write("", tablesOf(rows));
  if (auto printed = flushOut(); !printed) fail(2, printed.error().text());
  return 0;
}
