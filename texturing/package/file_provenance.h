// file_provenance.h - name and digest of an input file, the digest taken beside the reading of it.
// A build reads gigabytes: the digest starts in a background thread with the first read (the page cache then serves one
// of the two) and provenance() waits for it. A source that is only opened is not digested; a destroyed one stops.
#pragma once

#include <atomic>
#include <mutex>
#include <optional>
#include <string>

#include "src/base/file.h"
#include "src/base/worker_threads.h"
#include "texturing/package/raster_source.h"

namespace relievo {

class FileProvenance {
 public:
  FileProvenance(std::string path, bool hash) : path_(std::move(path)), hash_(hash) {}
  FileProvenance(const FileProvenance&) = delete;
  FileProvenance& operator=(const FileProvenance&) = delete;
  ~FileProvenance() {
    stop_ = true;
    digest_.reset();  // waits
  }

  // Cheap after the first call; from any thread.
  void start() const {
    if (!hash_) return;
    std::call_once(started_, [this] { digest_.emplace("relievo-digest", [this] { return hashFile(path_, &stop_); }); });
  }
  Provenance get() const {
    Provenance provenance;
    provenance.name = path_.substr(path_.find_last_of('/') + 1);
    start();
    if (!hash_) return provenance;
    const Result<std::string>& digest = digest_->get();
    if (digest) provenance.xxh3 = *digest;
    else provenance.failure = digest.error();
    return provenance;
  }

 private:
  std::string path_;
  bool hash_;
  std::atomic<bool> stop_{false};
  mutable std::once_flag started_;
  mutable std::optional<BackgroundTask<Result<std::string>>> digest_;
};

}  // namespace relievo
