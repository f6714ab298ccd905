#include "tools/artwork_cache.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <optional>
#include <string_view>
#include <system_error>
#include <utility>

#include <CLI/CLI.hpp>

#include "src/base/file.h"
#include "src/base/progress.h"
#include "texturing/import/image_io.h"
#include "texturing/import/ptm.h"
#include "tools/build_mesh.h"
#include "tools/build_run.h"
#include "tools/commands.h"

namespace relievo {
namespace {

namespace fs = std::filesystem;

constexpr const char* kPackageEnd = ".relievo";
constexpr const char* kNamesEnd = ".names";  // beside: the files that a scan names, a line each
constexpr uint64_t kMaxNamesBytes = 1 << 20;

enum class Source { kPackage, kPtm, kImage, kMesh };
Source sourceOf(const std::string& file) {
  std::string end = fs::path(file).extension().string();
  std::transform(end.begin(), end.end(), end.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (end == ".ptm") return Source::kPtm;
  for (const char* mesh : {".ply", ".obj", ".stl", ".off", ".glb", ".gltf"})
    if (end == mesh) return Source::kMesh;
  for (const char* image : {".tif", ".tiff", ".png", ".jpg", ".jpeg", ".exr", ".bmp", ".webp", ".tga", ".gif", ".ppm",
                            ".pgm", ".pnm", ".jp2", ".hdr"})
    if (end == image) return Source::kImage;
  return Source::kPackage;
}

std::string hexOf(const std::string& text) {
  char hex[17];
  std::snprintf(hex, sizeof hex, "%016llx", static_cast<unsigned long long>(XXH3_64bits(text.data(), text.size())));
  return hex;
}

// The program: another one may build other bytes.
std::string builder() {
  struct stat st {};
  std::string text = "relievo " RELIEVO_VERSION;
  if (::stat("/proc/self/exe", &st) == 0)
    text += " " + std::to_string(st.st_size) + " " + std::to_string(st.st_mtim.tv_sec) + "." +
            std::to_string(st.st_mtim.tv_nsec);
  return text;
}

// What openArtwork() names in the cache's folder, which may hold files of others: KEY-KEY.relievo, KEY-new-PID.relievo
// and KEY.names, where the first KEY has 32 hexadecimal digits, the second 16.
bool isCacheName(std::string_view name) {
  const auto take = [&](const char* of, size_t least, size_t most) {
    const size_t found = std::min(name.find_first_not_of(of), name.size());
    if (found < least || found > most) return false;
    name.remove_prefix(found);
    return true;
  };
  const auto starts = [&](std::string_view with) {
    if (name.substr(0, with.size()) != with) return false;
    name.remove_prefix(with.size());
    return true;
  };
  if (!take("0123456789abcdef", 32, 32)) return false;
  if (name == kNamesEnd) return true;
  const bool named = starts("-new-") ? take("0123456789", 1, 10) : starts("-") && take("0123456789abcdef", 16, 16);
  return named && name == kPackageEnd;
}

// Of the file alone, and of all that it names; files that are not there have a place of their own.
Result<std::string> ownKey(const std::string& file) {
  auto hash = hashFile(file, &interruptedFlag());
  if (!hash) return hash.error();
  return *hash + hexOf(builder() + " " + std::to_string(static_cast<int>(sourceOf(file))));
}
Result<std::string> wholeKey(const std::string& own, const std::vector<std::string>& named, const fs::path& beside) {
  std::string text = own;
  for (const std::string& path : named) {
    auto hash = hashFile(path, &interruptedFlag());
    // A file that is there and cannot be read has no place: its contents would be another key's.
    std::error_code unknown;
    if (!hash && (hash.error().kind == ErrorKind::kInterrupted || fs::is_regular_file(path, unknown)))
      return hash.error();
    text += "\n" + fs::path(path).lexically_relative(beside).string() + "\n" + (hash ? *hash : "none");
  }
  return own + "-" + hexOf(text);
}

Error cannotWrite(const std::string& file, const std::string& folder, const std::string& why) {
  return {ErrorKind::kIo,
          file,
          "it must be built into a package first, and the cache folder " + folder + " cannot be written: " + why,
          "name another folder with --cache-dir, or make a package with `relievo build`",
          {}};
}

Result<std::string> cacheFolder(const std::string& file, const ArtworkCache& cache) {
  std::string folder = cache.folder;
  if (folder.empty()) {
    const char* xdg = std::getenv("XDG_CACHE_HOME");
    const char* home = std::getenv("HOME");
    if (xdg && xdg[0] == '/') folder = std::string(xdg) + "/relievo";
    else if (home && home[0] == '/') folder = std::string(home) + "/.cache/relievo";
    else return cannotWrite(file, "of this user", "neither XDG_CACHE_HOME nor HOME names one");
  }
  std::error_code bad;
  const fs::path above = fs::path(folder + "/").parent_path().parent_path();
  if (!above.empty()) fs::create_directories(above, bad);
  // What others may not read is not for them in the cache, either.
  if (!bad && ::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) bad.assign(errno, std::generic_category());
  if (bad) return cannotWrite(file, folder, bad.message());
  if (!fs::is_directory(folder, bad)) return cannotWrite(file, folder, "it is no folder");
  return folder;
}

// Keeps a lock on the file for as long as it lives.
class InUse {
 public:
  explicit InUse(const std::string& path) {
    // Removed between opening and locking, it is no longer the cache's; but then another process may have put its own
    // there, which is as good.
    for (int tries = 0; tries < 16 && !held(); ++tries) {
      fd_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
      if (fd_ < 0) return;
      struct stat locked {
      }, named{};
      if (::flock(fd_, LOCK_SH) != 0 || ::fstat(fd_, &locked) != 0 || ::stat(path.c_str(), &named) != 0 ||
          locked.st_ino != named.st_ino || locked.st_dev != named.st_dev)
        close();
    }
  }
  InUse(const InUse&) = delete;
  InUse& operator=(const InUse&) = delete;
  ~InUse() { close(); }
  bool held() const { return fd_ >= 0; }

 private:
  void close() {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }
  int fd_ = -1;
};

// A package that has no name yet by which it is found: removed, unless it was renamed.
class Unnamed {
 public:
  explicit Unnamed(std::string path) : path_(std::move(path)) {}
  Unnamed(const Unnamed&) = delete;
  Unnamed& operator=(const Unnamed&) = delete;
  ~Unnamed() { ::unlink(path_.c_str()); }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

// A sound package of that name, marked as used now.
std::optional<OpenedArtwork> take(const std::string& path) {
  auto in_use = std::make_shared<InUse>(path);
  if (!in_use->held()) return std::nullopt;
  auto package = Package::open(path);
  if (!package || !(*package)->warnings().empty()) return std::nullopt;
  ::utimensat(AT_FDCWD, path.c_str(), nullptr, 0);
  return OpenedArtwork{*package, {}, in_use};
}

// The cache's packages in the folder beyond the limit, the least recently used first.
void removeOldest(const std::string& folder, uint64_t limit_bytes) {
  struct Kept {
    fs::file_time_type used;
    fs::path path;
    uint64_t bytes;
  };
  std::vector<Kept> all;
  uint64_t total = 0;
  std::error_code bad;
  for (fs::directory_iterator it(folder, bad), end; !bad && it != end; it.increment(bad)) {
    if (!isCacheName(it->path().filename().string()) || it->path().extension() != kPackageEnd) continue;
    std::error_code gone;
    Kept kept{it->last_write_time(gone), it->path(), it->file_size(gone)};
    if (gone) continue;
    total += kept.bytes;
    all.push_back(std::move(kept));
  }
  std::sort(all.begin(), all.end(),
            [](const Kept& a, const Kept& b) { return a.used != b.used ? a.used < b.used : a.path < b.path; });
  for (const Kept& kept : all) {
    if (total <= limit_bytes) return;
    const int fd = ::open(kept.path.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) continue;
    if (::flock(fd, LOCK_EX | LOCK_NB) == 0 && ::unlink(kept.path.c_str()) == 0) {
      total -= kept.bytes;
      fs::path names = kept.path;
      names.replace_filename(kept.path.stem().string().substr(0, 32) + kNamesEnd);
      fs::remove(names, bad);
    }
    ::close(fd);
  }
}

std::vector<std::string> readNames(const std::string& path, const fs::path& beside) {
  std::vector<std::string> names;
  auto text = readTextFile(path, kMaxNamesBytes);
  if (!text) return names;
  for (size_t at = 0, end = 0; at < text->size(); at = end + 1) {
    end = std::min(text->find('\n', at), text->size());
    if (end > at) names.push_back((beside / text->substr(at, end - at)).string());
  }
  return names;
}

Result<void> writeNames(const std::string& path, const std::vector<std::string>& named, const fs::path& beside) {
  std::string text;
  for (const std::string& name : named) text += fs::path(name).lexically_relative(beside).string() + "\n";
  return writeFile(path, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
}

Result<void> buildInto(const std::string& output, const std::string& file, std::vector<std::string>* named) {
  BuildOptions options;
  options.output = output;
  if (sourceOf(file) == Source::kMesh) {
    MeshBuildArguments mesh;
    mesh.mesh = file;
    mesh.package = options;
    mesh.quiet = true;
    mesh.named_files = named;
    auto built = buildFromMesh(mesh);
    // How far off it is is for those to ask who build it for good.
    if (!built && built.error().kind == ErrorKind::kDifference) return {};
    return built;
  }
  options.size_known = false;  // nobody said how large a pixel is
  auto texture = sourceOf(file) == Source::kPtm ? openPtm(file, {.memory_budget_bytes = options.memory_budget_bytes})
                                                : openColourImage(file);
  if (!texture) return texture.error();
  auto built = buildWithProgress(**texture, nullptr, options);
  if (!built) return built.error();
  return {};
}

// An error of the cache's package is told as the artwork's.
Error ofArtwork(Error error, const std::string& file, const std::string& output, const std::string& folder) {
  if (error.kind == ErrorKind::kInterrupted)
    return {ErrorKind::kInterrupted, file, "interrupted while it was built into a package", "nothing was kept", {}};
  if (error.file.compare(0, output.size(), output) != 0) return error;
  if (error.kind == ErrorKind::kIo) return cannotWrite(file, folder, error.message);
  error.file = file;
  return error;
}

}  // namespace

void ArtworkCache::addTo(CLI::App& c) {
  const char* group = "Artworks that are no package";
  c.add_option("--cache-dir", folder,
               "Folder for packages built of a .ptm, an image or a scan [$XDG_CACHE_HOME/relievo or ~/.cache/relievo]")
      ->group(group);
  c.add_option("--cache-dir-mib", limit_mib, "What they may take there, MiB; beyond it the least recently used go")
      ->check(CLI::Range(0, 1 << 24))
      ->capture_default_str()
      ->group(group);
}

namespace {

// The cached package of what is none.
Result<OpenedArtwork> openThroughCache(const std::string& file, const ArtworkCache& cache) {
  auto own = ownKey(file);
  if (!own) return own.error();
  auto folder = cacheFolder(file, cache);
  if (!folder) return folder.error();
  const fs::path beside = fs::path(file).parent_path();
  const std::string stem = *folder + "/" + *own, names_path = stem + kNamesEnd;
  auto pathOf = [&](const std::vector<std::string>& named) -> Result<std::string> {
    auto key = wholeKey(*own, named, beside);
    if (!key) return key.error();
    return *folder + "/" + *key + kPackageEnd;
  };
  std::vector<std::string> named = readNames(names_path, beside);
  auto path = pathOf(named);
  if (!path) return path.error();
  if (auto found = take(*path)) {
    found->named_files = named;
    return *found;
  }
  // What a scan names is known once it was read: only then has its package its name. Until then the name is this
  // process's own, so that what a killed one left is no later one's target.
  OutputFile::removeOrphans(*folder, isCacheName);
  named.clear();
  const Unnamed unnamed(stem + "-new-" + std::to_string(::getpid()) + kPackageEnd);
  const std::string& output = unnamed.path();
  if (auto built = buildInto(output, file, &named); !built) return ofArtwork(built.error(), file, output, *folder);
  auto after = ownKey(file);
  path = pathOf(named);
  if (!after) return after.error();
  if (!path) return path.error();
  if (*after != *own)
    return Error{ErrorKind::kIo, file, "it changed while it was read", "try again once it is whole", {}};
  if (auto written = writeNames(names_path, named, beside); !written)
    return ofArtwork(written.error(), file, names_path, *folder);
  if (auto renamed = renameFile(output, *path); !renamed) return cannotWrite(file, *folder, renamed.error().message);
  auto found = take(*path);
  if (!found)
    return Error{ErrorKind::kIo,
                 file,
                 "the package built of it is gone from " + *folder,
                 "try again, or name another folder with --cache-dir",
                 {}};
  removeOldest(*folder, cache.limit_mib << 20);
  found->named_files = named;
  return *found;
}

}  // namespace

Result<OpenedArtwork> openArtwork(const std::string& file, const ArtworkCache& cache) {
  if (sourceOf(file) == Source::kPackage) {
    auto package = Package::open(file);
    if (!package) return package.error();
    return OpenedArtwork{*package, {}, nullptr};
  }
  auto opened = openThroughCache(file, cache);
  if (!opened || sourceOf(file) != Source::kImage) return opened;
  auto facts = readImageFacts(file);
  if (facts && facts->alpha) warn(alphaWarning(file));
  return opened;
}

}  // namespace relievo
