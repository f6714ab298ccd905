#include "tools/accuracy/accuracy_run.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "tools/accuracy/accuracy_front.h"
#include "tools/accuracy/accuracy_measure.h"

namespace relievo {
namespace {

constexpr int kMoments = 96;         // of each flight, from which views are drawn
constexpr size_t kControlEvery = 8;  // settings between two measurements of the base

struct AccuracyTask {
  std::string knob, label;
  AccuracySetting setting;
};

class AccuracyRunner {
 public:
  AccuracyRunner(const AccuracyPlan& plan, const gl::ContextInfo& context) : plan_(plan), context_(context) {}

  Result<AccuracyResult> run() {
    result_.renderer = context_.renderer;
    result_.version = context_.version;
    if (auto done = findTruth(); !done) return done.error();
    SettingMeasure measure(plan_, path_, truths_, *truth_, context_.api);
    measure_ = &measure;
    tasks_ = knobTasks();
    const auto rounds = static_cast<size_t>(plan_.passes), combinations = static_cast<size_t>(plan_.combinations);
    expected_ = rounds * (tasks_.size() + combinations);
    if (auto done = runTasks(); !done) return done.error();
    tasks_ = combinationTasks();
    expected_ = done_ + rounds * tasks_.size();
    if (auto done = runTasks(); !done) return done.error();
    finishControls();
    return std::move(result_);
  }

 private:
  void tell(const std::string& what) const {
    const double part = static_cast<double>(done_) / static_cast<double>(std::max<size_t>(1, expected_));
    if (plan_.progress) plan_.progress(truths_.size() < path_.size() ? 0 : part, what);
  }

  Result<void> findTruth() {
    auto path = accuracyPath(plan_);
    if (!path) return path.error();
    path_ = std::move(*path);
    TruthOptions options;
    options.package = plan_.package;
    options.scene.light = plan_.light;
    options.width_px = plan_.width_px;
    options.height_px = plan_.height_px;
    options.one_of = plan_.one_of;
    options.seed = plan_.seed;
    options.memory_bytes = plan_.memory_bytes;
    options.reference_triangles = plan_.reference_triangles;
    options.interrupted = plan_.interrupted;
    auto truth = AccuracyTruth::create(options, context_.api);
    if (!truth) return truth.error();
    truth_ = std::move(*truth);
    for (const CompareCamera& c : path_) {
      tell("the truth of view " + std::to_string(truths_.size() + 1) + " of " + std::to_string(path_.size()));
      auto view = truth_->of(c.now);
      if (!view) return view.error();
      result_.cameras.push_back(c.now);
      result_.truth_pixels += view->pixels.size();
      result_.covered_pixels += view->covered;
      result_.edge_pixels += view->edges;
      result_.unsolved_pixels += view->unsolved;
      result_.truth_whole = result_.truth_whole && view->whole;
      truths_.push_back(std::move(*view));
    }
    if (result_.truth_pixels == 0)
      return Error{ErrorKind::kRuntime,
                   "",
                   "no view of the path shows enough of the artwork to be measured",
                   "give another --seed or a larger --size",
                   {}};
    return {};
  }

  std::vector<AccuracyTask> knobTasks() const {
    std::vector<AccuracyTask> out{{"base", "base", knobBase(plan_.cache_mib)},
                                  {"base", "default", defaultSetting(plan_.cache_mib)}};
    for (const AccuracyKnob& k : plan_.knobs) {
      if (!k.why_not.empty()) continue;
      for (const KnobValue& v : k.values) out.push_back({k.name, v.label, v.setting});
    }
    return out;
  }

  const AccuracyRow* known(const AccuracySetting& setting) const {
    for (const AccuracyRow& row : result_.rows)
      if (row.setting == setting) return &row;
    return nullptr;
  }

  // The rows of tasks that are not known yet are measured in rounds: all of them once, then all once more, so that what
  // else the machine does in the meantime falls on all alike.
  Result<void> runTasks() {
    std::vector<AccuracyRow> fresh;
    for (const AccuracyTask& task : tasks_) {
      const bool twice =
          std::any_of(fresh.begin(), fresh.end(), [&](const AccuracyRow& row) { return row.setting == task.setting; });
      if (!twice && !known(task.setting)) fresh.push_back({task.knob, task.label, task.setting, {}, {}});
    }
    std::vector<SettingSamples> samples(fresh.size());
    for (int round = 0; round < plan_.passes; ++round)
      for (size_t i = 0; i < fresh.size(); ++i) {
        if (!fresh[i].problem.empty()) continue;
        tell(settingText(fresh[i].setting));
        if (auto done = measureInto(fresh[i], samples[i]); !done) return done;
        ++done_;
      }
    for (size_t i = 0; i < fresh.size(); ++i) fresh[i].figures = figuresOf(samples[i]);
    for (const AccuracyTask& task : tasks_) {
      const AccuracyRow* same = known(task.setting);
      for (const AccuracyRow& row : fresh)
        if (!same && row.setting == task.setting) same = &row;
      AccuracyRow row = *same;
      row.knob = task.knob;
      row.label = task.label;
      result_.rows.push_back(std::move(row));
    }
    return {};
  }

  // What does not settle, such as a cache too small for a view, is a finding; the base has to.
  Result<void> measureInto(AccuracyRow& row, SettingSamples& samples) {
    if (auto done = measure_->round(row.setting, samples); !done) {
      const bool ends = row.knob == "base" || (plan_.interrupted && *plan_.interrupted);
      if (ends || done.error().kind != ErrorKind::kRuntime) return done;
      row.problem = done.error().message;
    }
    return ++measured_ % kControlEvery == 0 ? measureControl() : Result<void>{};
  }

  Result<void> measureControl() {
    SettingSamples samples;
    if (auto done = measure_->round(knobBase(plan_.cache_mib), samples); !done) return done;
    controls_.push_back(figuresOf(samples));
    return {};
  }

  std::vector<AccuracyTask> combinationTasks() const {
    std::vector<MeasuredKnob> measured;
    std::vector<const AccuracyKnob*> knobs;
    const AccuracyFigures& base = known(knobBase(plan_.cache_mib))->figures;
    for (const AccuracyKnob& k : plan_.knobs) {
      if (!k.combined || !k.why_not.empty()) continue;
      MeasuredKnob& m = measured.emplace_back();
      knobs.push_back(&k);
      m.base = {base.moving_ms.median, base.psnr_db};
      for (const KnobValue& v : k.values) {
        const AccuracyRow& row = *known(v.setting);
        const double none = std::nan("");
        m.values.push_back(row.problem.empty() ? CostAndGain{row.figures.moving_ms.median, row.figures.psnr_db}
                                               : CostAndGain{none, none});
      }
    }
    std::vector<AccuracyTask> out;
    if (knobs.size() < 2 || plan_.combinations == 0) return out;
    auto combined = [&](std::span<const size_t> choice) {
      AccuracySetting setting = knobBase(plan_.cache_mib);
      for (size_t k = 0; k < knobs.size(); ++k)
        turn(knobs[k]->name, knobs[k]->values[choice[k]].setting.draw, setting.draw);
      return setting;
    };
    auto isKnown = [&](std::span<const size_t> choice) { return known(combined(choice)) != nullptr; };
    for (const auto& choice : promisingCombinations(measured, static_cast<size_t>(plan_.combinations), isKnown))
      out.push_back({"combination", std::to_string(out.size() + 1), combined(choice)});
    return out;
  }

  static void turn(const std::string& knob, const DrawSettings& from, DrawSettings& to) {
    if (knob == "error-px") to.error_px = from.error_px;
    if (knob == "least-cell") to.least_cell = from.least_cell;
    if (knob == "detail-bias") to.detail_bias = from.detail_bias;
    if (knob == "filter") to.filter = from.filter;
    if (knob == "sampling") to.sampling = from.sampling, to.anisotropy = from.anisotropy;
  }

  void finishControls() {
    const AccuracyFigures& base = known(knobBase(plan_.cache_mib))->figures;
    std::vector<double> moving{base.moving_ms.median}, still{base.still_ms.median}, cold{base.cold_ms.median};
    for (const AccuracyFigures& c : controls_) {
      moving.push_back(c.moving_ms.median);
      still.push_back(c.still_ms.median);
      cold.push_back(c.cold_ms.median);
      result_.control_psnr_db = std::max(result_.control_psnr_db, std::abs(c.psnr_db - base.psnr_db));
    }
    // Few of them: the whole range is told, not the quartiles.
    auto range = [](std::vector<double> v) {
      std::sort(v.begin(), v.end());
      return Spread{v[v.size() / 2], v.front(), v.back(), v.size()};
    };
    result_.control_moving_ms = range(moving);
    result_.control_still_ms = range(still);
    result_.control_cold_ms = range(cold);
  }

  const AccuracyPlan& plan_;
  gl::ContextInfo context_;
  AccuracyResult result_;
  std::vector<CompareCamera> path_;
  std::vector<ViewTruth> truths_;
  std::unique_ptr<AccuracyTruth> truth_;
  SettingMeasure* measure_ = nullptr;
  std::vector<AccuracyTask> tasks_;
  std::vector<AccuracyFigures> controls_;
  size_t expected_ = 0, done_ = 0, measured_ = 0;
};

}  // namespace

Spread spreadOf(std::vector<double> values) {
  if (values.empty()) return {};
  std::sort(values.begin(), values.end());
  auto at = [&](double q) {
    const double place = q * static_cast<double>(values.size() - 1);
    const auto below = static_cast<size_t>(place);
    const size_t above = std::min(below + 1, values.size() - 1);
    return values[below] + (place - static_cast<double>(below)) * (values[above] - values[below]);
  };
  return {at(0.5), at(0.25), at(0.75), values.size()};
}

Result<std::vector<CompareCamera>> accuracyPath(const AccuracyPlan& plan) {
  std::vector<std::vector<CompareCamera>> flights;
  if (!plan.cameras.empty()) {
    flights.push_back(plan.cameras);
  } else {
    for (const char* name : {"orbit", "flyover", "zoom"}) {
      auto flight = compareCameras(name, kMoments, plan.package->manifest(), plan.width_px, plan.height_px);
      if (!flight) return flight.error();
      flights.push_back(std::move(*flight));
    }
  }
  std::mt19937 random(plan.seed);
  std::vector<CompareCamera> out;
  const int ways = static_cast<int>(flights.size()), a_flight = (plan.views + ways - 1) / ways;
  for (int v = 0; v < plan.views; ++v) {
    // One of each of as many even parts of the flight as it has views.
    const auto& flight = flights[static_cast<size_t>(v % ways)];
    const size_t part = flight.size() / static_cast<size_t>(a_flight);
    out.push_back(flight[static_cast<size_t>(v / ways) * part + random() % part]);
  }
  return out;
}

Result<void> fitCache(AccuracyPlan& plan, std::vector<std::string>& notices) {
  Scene scene;
  EngineOptions options;
  options.workers = plan.workers;
  options.most_cache_mib = kMostCacheMib;
  applySetting(knobBase(), scene, options);
  auto need = Engine::cacheNeed(artworkFromPackage(plan.package), scene, options);
  if (!need) return need.error();
  auto cache_mib = cacheMibFor(need->least_bytes, options, false, notices);
  if (!cache_mib) return cache_mib.error();
  plan.cache_mib = *cache_mib;
  giveCache(plan.knobs, plan.cache_mib, static_cast<double>(need->least_bytes) / (1 << 20));
  return {};
}

Result<AccuracyResult> runAccuracy(const AccuracyPlan& plan, const gl::ContextInfo& context) {
  return AccuracyRunner(plan, context).run();
}

}  // namespace relievo
