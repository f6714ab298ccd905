// fault_driver - runs the program's commands once for every call of a kind that can fail, with that call failing
// (fault_library.cpp), and looks at what is left.
//
// After each run: the program ended by itself with a documented exit code and in time; with 0 its outputs are byte for
// byte those of an undisturbed run, else each output is still the old file (or the new one, whole) and exactly one line
// on standard error begins with "relievo: error:"; inputs are untouched, and nothing else lies in the folder.
// --kills: the program is killed (SIGKILL) while it writes; after each, the output is the old file or the new one, and
// the next build gives the right bytes and leaves nothing else. --resume: that build goes on from a checkpoint, with
// another number of workers. Prints a table and every violation; exits with 0 if there is none, else with 7.
#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <mutex>
#include <random>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "tests/faults/fault_report.h"

namespace {

namespace fs = std::filesystem;
using namespace relievo::testing_support;

struct Arguments {
  std::string program, library, only, only_kind;
  uint64_t tries = 0;   // of each row of the table; 0: every call
  uint64_t from = 1;    // the first call to try
  uint64_t kills = 0;   // moments; 0: the table of faults instead
  bool resume = false;  // after a kill the build goes on
  int jobs = 2;
};

std::string readAll(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream out;
  out << in.rdbuf();
  return out.str();
}
void writeAll(const fs::path& path, const std::string& bytes) { std::ofstream(path, std::ios::binary) << bytes; }

struct Output {
  std::string name;
  std::string ends_with;  // if not empty: its figures differ from run to run, and it is whole if it ends with this
};

// A command of the program. Paths are relative to the folder it runs in: in/ holds what it reads, out/ what it writes,
// cache/ what view and render keep.
struct Operation {
  std::string name;
  std::vector<std::string> arguments;
  std::vector<Output> outputs;
  bool says = false;     // standard output is the same in each run, and is compared
  bool foreign = false;  // with OpenImageIO or GL, which use the standard library as well and end the process where it
                         // has no memory
};

// What fails, and which exit codes say so. 0 is always allowed: with the right output the fault did no harm.
struct Fault {
  const char* kinds;
  const char* action;
  bool all;  // this call and all after it
  std::set<int> codes;
};

struct Run {
  int exit_code = -1, signal = 0;
  bool hung = false;
  std::string out, err;
  uint64_t bytes = 0, hit = 0;
  std::array<uint64_t, kFaultKinds> calls_of{};
  double seconds = 0;

  uint64_t callsOf(const char* list) const {
    uint64_t sum = 0;
    for (int k = 0; k < kFaultKinds; ++k)
      if (faultKindsOf(list) & 1u << k) sum += calls_of[k];
    return sum;
  }
};

// In memory where there is such a folder: thousands of runs would wait for the disk, whose failures are injected
// anyway.
fs::path scratchFolder() {
  return access("/dev/shm", W_OK | X_OK) == 0 ? fs::path("/dev/shm") : fs::temp_directory_path();
}

class Workshop {
 public:
  Workshop(const Arguments& arguments, const std::string& name)
      : arguments_(arguments), root_(scratchFolder() / ("relievo-faults-" + std::to_string(getpid()) + "-" + name)) {
    fs::create_directories(work() / "in");
    fs::create_directories(work() / "out");
    fs::create_directories(work() / "cache");
  }
  ~Workshop() { fs::remove_all(root_); }
  fs::path work() const { return root_ / "work"; }
  fs::path out(const std::string& name) const { return work() / "out" / name; }

  // kill_after_s: SIGKILL from outside, after that time.
  Run run(const std::vector<std::string>& arguments, const std::map<std::string, std::string>& faults,
          double kill_after_s = -1) const {
    const std::string report_path = (root_ / "report").string(), out_path = (root_ / "stdout").string(),
                      err_path = (root_ / "stderr").string();
    writeAll(report_path, std::string(sizeof(FaultReport), '\0'));
    std::vector<std::string> words{arguments_.program};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    for (std::string& w : words) argv.push_back(w.data());
    argv.push_back(nullptr);
    std::vector<std::string> settings;
    for (char** e = environ; *e; ++e) settings.emplace_back(*e);
    if (!faults.empty()) {
      settings.push_back("LD_PRELOAD=" + arguments_.library);
      settings.push_back("RELIEVO_FAULT_FOLDER=" + work().string());
      settings.push_back("RELIEVO_FAULT_REPORT=" + report_path);
      for (const auto& [key, value] : faults) settings.push_back("RELIEVO_FAULT_" + key + "=" + value);
    }
    std::vector<char*> environment;
    for (std::string& s : settings) environment.push_back(s.data());
    environment.push_back(nullptr);
    const std::string folder = work().string();

    Run r;
    const auto start = std::chrono::steady_clock::now();
    const pid_t pid = fork();
    if (pid == 0) {
      const int null = open("/dev/null", O_RDONLY), o = open(out_path.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600),
                e = open(err_path.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
      dup2(null, 0), dup2(o, 1), dup2(e, 2);
      if (chdir(folder.c_str()) != 0) _exit(127);
      execve(argv[0], argv.data(), environment.data());
      _exit(127);
    }
    int status = 0;
    auto elapsed = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
    bool killed = false;
    while (waitpid(pid, &status, WNOHANG) == 0) {
      if (kill_after_s >= 0 && elapsed() >= kill_after_s && !killed) kill(pid, SIGKILL), killed = true;
      if (elapsed() > 120) {
        kill(pid, SIGKILL);
        waitpid(pid, &status, 0);
        r.hung = true;
        break;
      }
      usleep(1000);
    }
    r.seconds = elapsed();
    if (WIFSIGNALED(status)) r.signal = WTERMSIG(status);
    else r.exit_code = WEXITSTATUS(status);
    r.out = readAll(out_path), r.err = readAll(err_path);
    FaultReport report;
    const std::string counted = readAll(report_path);
    if (counted.size() >= sizeof report) std::memcpy(static_cast<void*>(&report), counted.data(), sizeof report);
    r.bytes = report.bytes, r.hit = report.hit;
    std::copy(std::begin(report.calls_of), std::end(report.calls_of), r.calls_of.begin());
    return r;
  }

  std::map<std::string, std::string> filesIn(const char* folder) const {
    std::map<std::string, std::string> out;
    for (const auto& e : fs::directory_iterator(work() / folder))
      out[e.path().filename().string()] = e.is_regular_file() ? readAll(e.path()) : "";
    return out;
  }
  // out/ with these files only.
  void reset(const std::map<std::string, std::string>& files) const {
    fs::remove_all(work() / "out");
    fs::create_directories(work() / "out");
    fs::remove_all(work() / "cache");
    fs::create_directories(work() / "cache");
    for (const auto& [name, bytes] : files) writeAll(out(name), bytes);
  }

 private:
  const Arguments& arguments_;
  fs::path root_;
};

// ---- inputs ----
std::string noise(size_t n, uint32_t seed) {
  std::mt19937 random(seed);
  std::string out(n, '\0');
  for (char& c : out) c = static_cast<char>(random());
  return out;
}
void makeInputs(const Workshop& shop, int big) {
  const int w = 300, h = 200;
  auto image = [&](const char* name, int width, int height, bool rough) {
    std::string pixels = rough ? noise(static_cast<size_t>(width) * height * 3, 1) : std::string();
    if (!rough)
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
          for (int c = 0; c < 3; ++c) pixels.push_back(static_cast<char>((x * (c + 1) + y * 2 + (x * y) % 7) & 255));
    writeAll(shop.work() / "in" / name,
             "P6\n" + std::to_string(width) + " " + std::to_string(height) + "\n255\n" + pixels);
  };
  image("image.ppm", w, h, false);
  if (big > 0) image("big.ppm", big, big * 2 / 3, true);  // noise does not compress: many bytes are written
  std::string heights = "P5\n300 200\n65535\n";
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const int v = static_cast<int>(20000 + 15000 * std::sin(x * 0.05) * std::cos(y * 0.07));
      heights += {static_cast<char>(v >> 8), static_cast<char>(v & 255)};
    }
  writeAll(shop.work() / "in" / "heights.pgm", heights);
  std::string ptm = "PTM_1.2\nPTM_FORMAT_LRGB\n" + std::to_string(w) + "\n" + std::to_string(h) +
                    "\n1 1 1 1 1 1\n128 128 128 128 128 0\n";
  for (int i = 0; i < w * h; ++i)
    for (int k = 0; k < 6; ++k) ptm.push_back(static_cast<char>(128 + (i * (k + 3) / 50) % 40));
  for (int i = 0; i < w * h; ++i)
    for (int k = 0; k < 3; ++k) ptm.push_back(static_cast<char>((i * (k + 1) / 100) & 255));
  writeAll(shop.work() / "in" / "tablet.ptm", ptm);
  // A closed surface with creases that a base of a few patches shows as it is: a build takes half a second.
  const std::string ply =
      "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
      "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
      "0 0 0\n9 0 0\n0 9 0\n0 0 9\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n";
  writeAll(shop.work() / "in" / "scan.ply", ply);
  // A scan whose colours another file says.
  writeAll(shop.work() / "in" / "coloured.obj",
           "mtllib coloured.mtl\nv 0 0 0\nv 9 0 0\nv 9 9 1\nv 0 9 0\nusemtl a\nf 1 2 3\nf 1 3 4\n");
  writeAll(shop.work() / "in" / "coloured.mtl", "newmtl a\nKd 0.9 0.1 0.1\n");
}

const std::string kPackage = "in/package.relievo";
bool readsPackage(const Operation& op) {
  return std::find(op.arguments.begin(), op.arguments.end(), kPackage) != op.arguments.end();
}
std::vector<Operation> operations() {
  const std::string& p = kPackage;
  return {
      {"build image",
       {"build", "-o", "out/o.relievo", "--image", "in/image.ppm", "--relief", "in/heights.pgm", "--relief-px", "0:30",
        "--workers", "2", "--json", "out/o.json"},
       {{"o.relievo", ""}, {"o.json", "}\n"}},
       false,
       true},
      {"build ptm", {"build", "-o", "out/o.relievo", "--ptm", "in/tablet.ptm", "--workers", "2"}, {{"o.relievo", ""}}},
      {"build mesh",
       {"build", "-o", "out/o.relievo", "--mesh", "in/scan.ply", "--workers", "2", "--patches", "6", "--report",
        "out/o.html"},
       {{"o.relievo", ""}, {"o.html", "</html>\n"}}},
      {"checkpoints",
       {"build", "-o", "out/o.relievo", "--ptm", "in/tablet.ptm", "--workers", "2", "--checkpoint-every", "0"},
       {{"o.relievo", ""}}},
      {"verify", {"verify", p}, {}, true},
      {"info", {"info", p}, {}, true},
      {"render", {"render", p, "-o", "out/o.png", "--size", "48x32"}, {{"o.png", ""}}, false, true},
      {"render scan",
       {"render", "in/coloured.obj", "-o", "out/o.png", "--size", "48x32", "--cache-dir", "cache"},
       {{"o.png", ""}},
       false,
       true},
      {"export", {"export", p, "-o", "out/o.ply", "--level", "4"}, {{"o.ply", ""}}},
      {"export map", {"export", p, "-o", "out/o.tif", "--map", "height"}, {{"o.tif", ""}}, false, true},
  };
}

std::vector<Fault> faults() {
  return {
      {"open", "EMFILE", false, {2}},   {"read", "EIO", false, {2}},
      {"read", "SHORT", false, {}},     {"write", "ENOSPC", false, {2}},
      {"write", "EIO", false, {2}},     {"write", "ENOSPC", true, {2}},
      {"write", "SHORT", false, {}},    {"read,write", "EINTR", false, {}},
      {"sync", "EIO", false, {2}},      {"rename", "EIO", false, {2}},
      {"close", "EIO", false, {2}},     {"truncate,map,lock", "EIO", false, {2}},
      {"alloc", "ENOMEM", false, {4}},  {"alloc", "ENOMEM", true, {4}},
      {"string", "ENOMEM", false, {4}}, {"thread", "EAGAIN", false, {4}},
      {"thread", "EAGAIN", true, {4}},  {"read,write,sync,rename,open", "INT", false, {130}},
  };
}

struct Counts {
  uint64_t calls = 0, tried = 0, right = 0, refused = 0, missed = 0, violations = 0;
};

class Judge {
 public:
  void violation(const std::string& where, const std::string& what, const Run& r) {
    std::lock_guard lock(mutex_);
    ++count_;
    std::string said = r.err.substr(0, 300);
    while (!said.empty() && said.back() == '\n') said.pop_back();
    if (count_ <= 400)
      std::printf("VIOLATION %s: %s [exit %d, signal %d] %s\n", where.c_str(), what.c_str(), r.exit_code, r.signal,
                  said.c_str());
    std::fflush(stdout);
  }
  uint64_t count() const { return count_; }

 private:
  std::mutex mutex_;
  uint64_t count_ = 0;
};

// What an undisturbed run gives.
struct Reference {
  Run run;
  std::map<std::string, std::string> outputs, inputs, cached;
};

bool isWhole(const Output& o, const std::string& bytes, const Reference& reference) {
  if (o.ends_with.empty()) return bytes == reference.outputs.at(o.name);
  return bytes.size() >= o.ends_with.size() && bytes.ends_with(o.ends_with);
}

std::map<std::string, std::string> oldFiles(const Operation& op) {
  std::map<std::string, std::string> out;
  for (const Output& o : op.outputs) out[o.name] = "the old file " + o.name;
  return out;
}

// Times and rates differ from run to run.
std::string withoutTimes(const std::string& text) {
  return std::regex_replace(text, std::regex("[0-9.]+ (s|[A-Za-z]+/s)"), "T");
}

// Empty: as it should be.
std::string wrongIn(const Workshop& shop, const Operation& op, const Reference& reference,
                    const std::map<std::string, std::string>& old, const Run& r, const std::set<int>& codes,
                    bool killed) {
  if (r.hung) return "it did not end";
  if (!killed && r.signal) return "it crashed";
  if (!killed && r.exit_code != 0 && !codes.contains(r.exit_code))
    return "exit code " + std::to_string(r.exit_code) + " is not the one of this fault";
  if (shop.filesIn("in") != reference.inputs) return "an input is changed";
  auto now = shop.filesIn("out");
  for (const Output& o : op.outputs) {
    const auto found = now.find(o.name);
    const bool is_old =
        old.contains(o.name) ? found != now.end() && found->second == old.at(o.name) : found == now.end();
    const bool is_new = found != now.end() && isWhole(o, found->second, reference);
    if (!killed && r.exit_code == 0 && !is_new) return "exit 0, but " + o.name + " is not what it should be";
    if (!is_old && !is_new) return o.name + " is neither the old file nor the new one";
    if (found != now.end()) now.erase(found);
  }
  if (killed) return "";
  if (!now.empty()) return "left behind: " + now.begin()->first;
  const auto cached = shop.filesIn("cache");
  for (const auto& [name, bytes] : cached)
    if (!reference.cached.contains(name) || reference.cached.at(name) != bytes) return "left in the cache: " + name;
  if (r.exit_code == 0 && op.says && withoutTimes(r.out) != withoutTimes(reference.run.out))
    return "exit 0, but standard output differs";
  int errors = 0;
  std::istringstream lines(r.err);
  for (std::string line; std::getline(lines, line);) errors += line.starts_with("relievo: error:");
  if (r.exit_code != 0 && errors != 1) return std::to_string(errors) + " error messages";
  if (r.exit_code == 0 && errors != 0) return "exit 0 with an error message";
  return "";
}

// Calls to try: all from the first on, or about `tries` spread evenly over all, first and last included.
std::vector<uint64_t> chosen(uint64_t calls, uint64_t first, uint64_t tries) {
  std::vector<uint64_t> out;
  if (tries == 0 || calls <= tries) {
    for (uint64_t n = first; n <= calls; ++n) out.push_back(n);
  } else {
    for (uint64_t i = 0; i < tries; ++i) out.push_back(tries == 1 ? 1 : 1 + i * (calls - 1) / (tries - 1));
  }
  return out;
}

Reference referenceOf(const Workshop& shop, const Operation& op) {
  shop.reset({});
  Reference out;
  out.run = shop.run(op.arguments, {});
  out.outputs = shop.filesIn("out"), out.inputs = shop.filesIn("in"), out.cached = shop.filesIn("cache");
  if (out.run.exit_code != 0) {
    std::fprintf(stderr, "fault_driver: %s fails without any fault: %s\n", op.name.c_str(), out.run.err.c_str());
    std::exit(4);
  }
  return out;
}

std::map<std::string, std::string> settingsOf(const Fault& f, uint64_t n) {
  return {{"KINDS", f.kinds}, {"ACTION", f.action}, {"ALL", f.all ? "1" : "0"}, {"NTH", std::to_string(n)}};
}

int faultTable(const Arguments& arguments) {
  std::vector<Operation> tried = operations();
  if (arguments.only == "control") tried = {{"control", {"build", "-o", "out/o.relievo"}, {{"o.relievo", ""}}}};
  std::erase_if(tried, [&](const Operation& op) { return !arguments.only.empty() && op.name != arguments.only; });
  std::vector<std::unique_ptr<Workshop>> shops;
  for (int j = 0; j < arguments.jobs; ++j) {
    shops.push_back(std::make_unique<Workshop>(arguments, std::to_string(j)));
    makeInputs(*shops.back(), 0);
  }
  if (std::any_of(tried.begin(), tried.end(), readsPackage)) {
    const Run made = shops[0]->run(
        {"build", "-o", kPackage, "--image", "in/image.ppm", "--relief", "in/heights.pgm", "--relief-px", "0:30"}, {});
    if (made.exit_code != 0)
      return std::fprintf(stderr, "fault_driver: cannot build the package to try: %s\n", made.err.c_str()), 4;
    for (const auto& shop : shops)
      if (shop != shops[0]) fs::copy_file(shops[0]->work() / kPackage, shop->work() / kPackage);
  }
  Judge judge;
  uint64_t runs = 0;
  std::vector<std::string> table;
  for (const Operation& op : tried) {
    const Reference reference = referenceOf(*shops[0], op);
    shops[0]->reset(oldFiles(op));
    const Run counted = shops[0]->run(op.arguments, {{"NTH", "0"}});
    for (const Fault& f : faults()) {
      if (!arguments.only_kind.empty() && arguments.only_kind != f.kinds) continue;
      if (op.foreign && std::strcmp(f.kinds, "string") == 0) continue;
      Counts counts;
      counts.calls = counted.callsOf(f.kinds);
      if (counts.calls == 0) continue;
      const std::vector<uint64_t> numbers = chosen(counts.calls, arguments.from, arguments.tries);
      std::atomic<size_t> next{0};
      std::mutex mutex;
      auto work = [&](Workshop& shop) {
        for (size_t i; (i = next++) < numbers.size();) {
          const auto old = i % 2 ? std::map<std::string, std::string>() : oldFiles(op);
          shop.reset(old);
          const Run r = shop.run(op.arguments, settingsOf(f, numbers[i]));
          const std::string wrong = wrongIn(shop, op, reference, old, r, f.codes, false);
          std::lock_guard lock(mutex);
          ++counts.tried;
          if (r.hit == 0) ++counts.missed;
          if (!wrong.empty()) {
            ++counts.violations;
            judge.violation(
                op.name + ", " + f.kinds + " " + f.action + (f.all ? " from " : " ") + std::to_string(numbers[i]),
                wrong, r);
          } else {
            ++(r.exit_code == 0 ? counts.right : counts.refused);
          }
        }
      };
      std::vector<std::thread> threads;
      for (size_t j = 1; j < shops.size(); ++j) threads.emplace_back(work, std::ref(*shops[j]));
      work(*shops[0]);
      for (std::thread& t : threads) t.join();
      runs += counts.tried;
      char line[200];
      std::snprintf(line, sizeof line, "%-12s %-28s %-7s %-4s %7llu %7llu %7llu %7llu %7llu %7llu", op.name.c_str(),
                    f.kinds, f.action, f.all ? "all" : "one", static_cast<unsigned long long>(counts.calls),
                    static_cast<unsigned long long>(counts.tried), static_cast<unsigned long long>(counts.right),
                    static_cast<unsigned long long>(counts.refused), static_cast<unsigned long long>(counts.missed),
                    static_cast<unsigned long long>(counts.violations));
      std::printf("%s\n", line);
      std::fflush(stdout);
      table.push_back(line);
    }
  }
  if (runs == 0)
    return std::fprintf(stderr,
                        "fault_driver: nothing was tried: expected --only, --kinds and --from to name an operation, "
                        "the calls of a row as the table has them, and one of its calls\n"),
           1;
  std::printf("\n%-12s %-28s %-7s %-4s %7s %7s %7s %7s %7s %7s\n", "operation", "calls", "fault", "", "calls", "tried",
              "right", "refused", "unhit", "WRONG");
  for (const std::string& line : table) std::printf("%s\n", line.c_str());
  std::printf("\n%llu violations\n", static_cast<unsigned long long>(judge.count()));
  return judge.count() ? 7 : 0;
}

// At the first calls that change files, at bytes spread evenly over all that are written, and at random times.
int killTable(const Arguments& arguments) {
  Workshop shop(arguments, "kills");
  makeInputs(shop, 1500);  // four tiles, of which the first is half of it: most kills come after a checkpoint
  auto command = [&](const char* workers) {
    std::vector<std::string> out{"build",      "-o",        "out/o.relievo",  "--image",
                                 "in/big.ppm", "--relief",  "in/heights.pgm", "--relief-px",
                                 "0:30",       "--workers", workers};
    if (arguments.resume) out.insert(out.end(), {"--resume", "--checkpoint-every", "0"});
    return out;
  };
  const Operation op{"build", command("2"), {{"o.relievo", ""}}};
  const Reference reference = referenceOf(shop, op);
  const std::string& whole = reference.outputs.at("o.relievo");
  // The old package is a good one, of other content.
  shop.reset({});
  shop.run({"build", "-o", "out/o.relievo", "--image", "in/image.ppm"}, {});
  const std::map<std::string, std::string> old = shop.filesIn("out");
  const std::string changes = "open,write,sync,rename,close,unlink,truncate";
  const Run counted = shop.run(op.arguments, {{"NTH", "0"}});
  const uint64_t calls = counted.callsOf(changes.c_str());
  std::mt19937 random(7);
  Judge judge;
  uint64_t at_bytes = 0, at_calls = 0, at_times = 0, old_left = 0, new_left = 0, ended = 0, went_on = 0;
  const uint64_t call_kills = std::min(calls, arguments.kills * 3 / 8);
  for (uint64_t i = 0; i < arguments.kills; ++i) {
    shop.reset(old);
    Run r;
    std::string moment;
    if (i < call_kills) {
      const uint64_t call = 1 + i * (calls - 1) / std::max<uint64_t>(1, call_kills - 1);
      moment = "call " + std::to_string(call);
      r = shop.run(op.arguments, {{"KINDS", changes}, {"ACTION", "KILL"}, {"NTH", std::to_string(call)}});
      ++at_calls;
    } else if (i % 4 != 3) {
      const uint64_t byte = counted.bytes * (i - call_kills) / (arguments.kills - call_kills);
      moment = "byte " + std::to_string(byte);
      r = shop.run(op.arguments, {{"KINDS", "write"}, {"ACTION", "KILL"}, {"BYTE", std::to_string(byte)}});
      ++at_bytes;
    } else {
      const double s = std::uniform_real_distribution(0.0, reference.run.seconds)(random);
      moment = "time " + std::to_string(s) + " s";
      r = shop.run(op.arguments, {}, s);
      ++at_times;
    }
    if (r.signal != SIGKILL) ++ended;
    std::string wrong = wrongIn(shop, op, reference, old, r, {}, true);
    if (r.signal != SIGKILL && r.exit_code != 0) wrong = "it failed";
    ++(readAll(shop.out("o.relievo")) == whole ? new_left : old_left);
    // What it left does not hinder the next build, which uses it or clears it away.
    const Run next = shop.run(command(i % 2 ? "1" : "3"), {});
    went_on += next.err.find("going on from a checkpoint") != std::string::npos;
    if (wrong.empty() && next.exit_code != 0) wrong = "the next build failed: " + next.err;
    const auto now = shop.filesIn("out");
    if (wrong.empty() && (!now.contains("o.relievo") || now.at("o.relievo") != whole))
      wrong = "the next build gave other bytes";
    if (wrong.empty() && now.size() != 1) {
      wrong = "after the next build there is still";
      for (const auto& [name, bytes] : now)
        if (name != "o.relievo") wrong += " " + name;
    }
    if (!wrong.empty()) judge.violation("kill at " + moment, wrong, r);
  }
  auto count = [](const char* what, uint64_t n) {
    std::printf("%-44s %8llu\n", what, static_cast<unsigned long long>(n));
  };
  count("kills", arguments.kills);
  count("  at a byte that was being written", at_bytes);
  count("  before a call that changes files", at_calls);
  count("  at a random time", at_times);
  count("builds that had ended before", ended);
  count("old package intact", old_left);
  count("new package whole", new_left);
  if (arguments.resume) count("next builds that went on from a checkpoint", went_on);
  count("bytes that a build writes", counted.bytes);
  count("calls of a build that change files", calls);
  std::printf("%llu violations\n", static_cast<unsigned long long>(judge.count()));
  // Builds that never go on would pass every comparison.
  if (arguments.resume && went_on == 0) return std::printf("no build went on from a checkpoint\n"), 7;
  return judge.count() ? 7 : 0;
}

}  // namespace

int main(int argc, char** argv) {
  setvbuf(stdout, nullptr, _IOLBF, 0);
  Arguments arguments;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    auto value = [&] { return std::string(i + 1 < argc ? argv[++i] : ""); };
    if (word == "--program") arguments.program = fs::absolute(value());
    else if (word == "--library") arguments.library = fs::absolute(value());
    else if (word == "--only") arguments.only = value();
    else if (word == "--kinds") arguments.only_kind = value();
    else if (word == "--tries") arguments.tries = std::stoull(value());
    else if (word == "--from") arguments.from = std::max<uint64_t>(1, std::stoull(value()));
    else if (word == "--kills") arguments.kills = std::stoull(value());
    else if (word == "--resume") arguments.resume = true;
    else if (word == "--jobs") arguments.jobs = std::max(1, std::stoi(value()));
    else {
      std::printf(
          "fault_driver --program RELIEVO --library libfault.so [--tries N | --from N] [--only OPERATION] [--kinds "
          "CALLS] [--jobs N]\n"
          "fault_driver --program RELIEVO --library libfault.so --kills 200 [--resume]\n\n"
          "Runs the program with the Nth call failing, for every N (or --tries of them, spread evenly, for each row; "
          "--from: from that N on), "
          "and says what\n"
          "it makes of it; or kills it while it writes. Exit codes: 0 all as it should be, 7 violations (each "
          "printed), 1 usage.\n");
      return word == "--help" ? 0 : 1;
    }
  }
  if (arguments.program.empty() || arguments.library.empty())
    return std::fprintf(stderr, "fault_driver: --program and --library are needed\n"), 1;
  return arguments.kills ? killTable(arguments) : faultTable(arguments);
}
