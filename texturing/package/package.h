// package.h - reading a .relievo package. Layout: texturing/PACKAGE.md.
// Safe for untrusted files: nothing is allocated or read from a size that was not checked against the file's length
// first. Opening costs at most a few reads, whatever the package's size: index blocks are read (and checked) when first
// asked for. A damaged package opens as far as it is sound; what is not answers with an Error that names the place.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "src/artwork/basis.h"
#include "src/artwork/patch_domain.h"
#include "src/base/result.h"
#include "texturing/codec/page_encoding.h"
#include "texturing/package/kept_tails.h"
#include "texturing/package/page_failures.h"
#include "texturing/package/page_source.h"
#include "texturing/package/patch_source.h"
#include "texturing/package/raster_source.h"

namespace relievo {

struct Manifest {
  PatchDomain domain;
  TextureFormat texture;
  // Of the texture's planes; relief is lossless. Lossless planes over a base mesh may have pages in fewer texels
  // (texturing/codec/coarse_page.h).
  PlaneEncodings encodings;
  bool size_known = true;  // false: everything in mm counts the artwork's pixels (mm_per_px is 1)
  std::vector<Provenance> sources;
  std::string tool_version;
  uint64_t page_count = 0;
  // Of an artwork over a base mesh (null: the domain is flat). Its patches are the domain's; errors are distances in
  // space (patch_source.h). coarse_errors: a patch's grids of 2^k cells a side, k = 0..6; those of 128
  // and more have pages.
  std::shared_ptr<const BaseMesh> base;
  std::vector<CoarseErrors> coarse_errors;
  std::vector<CoarseBlocks> coarse_blocks;  // empty, as coarse_shapes, where no patch has an error
  std::vector<CoarseShapes> coarse_shapes;  // empty: not known
  std::vector<HeightSlopes> height_slopes;  // empty in older packages
  bool tail_edges = false;                  // colours of tails end at edges (crease_gutter.h)
  double error_unit_mm = 0;  // what a relief page's errors are counted in (a flat artwork's: relief_scale_mm)
};

// Heights of a relief page's square in mm, and how far its own samples (interpolated over triangles or bilinearly) can
// lie from the finest relief: an upper bound, monotone (a child's is never larger).
struct ReliefBounds {
  float min_mm = 0, max_mm = 0, error_mm = 0;
};

// xxh3-64 of a page's encoded bytes, or as many of its lowest bits as the index has.
struct PageChecksum {
  uint64_t value = 0, mask = ~uint64_t{0};
  bool matches(uint64_t xxh3) const { return (xxh3 & mask) == value; }
};
struct PageRecord {
  uint64_t offset = 0;
  uint32_t size = 0;      // encoded bytes; 0: the page is absent
  PageChecksum checksum;  // of the encoded bytes
  ReliefBounds relief;    // relief pages only
};

struct PackageHeader;  // package_layout.h

// What the tails take in the file, their directory included; heights: of version 6 alone, where they lie by themselves.
struct TailBytes {
  uint64_t all = 0;
  std::optional<uint64_t> heights;
};

class Package final : public PageSource {
 public:
  static Result<std::shared_ptr<Package>> open(const std::string& path);
  ~Package() override;

  const std::string& path() const;
  uint64_t fileBytes() const;
  const Manifest& manifest() const;
  const PackageHeader& header() const;                  // the copy in use
  const std::string& manifestJson() const;              // as stored; empty when damaged
  const std::optional<Error>& manifestProblem() const;  // nothing: it is sound
  // What was found damaged on opening, the manifest included; the package works without it.
  const std::vector<std::string>& warnings() const;
  // Images that patches show (patch_images.h): read() makes the texture pages of those patches, and the manifest's
  // domain has their levels, which the index does not.
  struct ShownImages {
    size_t images = 0, normal_maps = 0;
    uint32_t patches = 0;
    uint64_t bytes = 0;           // in the file
    bool one_colour = false;      // one image of one texel, and nothing else
    bool corner_colours = false;  // of halves of patches
  };
  ShownImages shownImages() const;
  // Calls problem(error) for each damaged part of them, as it is found, until *stop is set.
  void checkImages(const std::function<void(const Error&)>& problem, const std::atomic<bool>* stop = nullptr) const;
  // Bytes of the file as they are.
  Result<void> readBytes(uint64_t offset, std::span<uint8_t> out) const;
  Result<PageRecord> record(PageId id) const;  // thread-safe
  // How far a relief page's surface can lie from the finest relief, mm, by 16 x 16 blocks of 8 x 8 cells, rows top
  // first: upper bounds, none above the page's own (but for their rounding up). False: the package does not say (an
  // older one, or damaged).
  bool reliefErrors(const NodeId& node, std::span<float> error_mm /* 256 */) const;
  // Which way they lie; shares of what reliefErrors() says. False: the package does not say.
  bool reliefShapes(const NodeId& node, std::span<DeviationShape> shapes /* 256 */) const;
  // The tails of its patches (patch_tails.h), as far as they are sound; the others are made of the root pages (heights
  // up to version 8), and problems (which may be null) names them; from version 16 on those that show images are made
  // of these, which are read for it. False: the package has none (an older one, or a flat artwork).
  bool hasTails() const;
  // Ends soon after *stop is set (it may be null); what it answers then is not to be used.
  // tolerance: KeptTailTolerance::of_255.
  KeptTails tails(int workers, std::vector<std::string>* problems, const std::atomic<bool>* stop = nullptr,
                  int tolerance = kTailTolerance) const;
  // The same with all levels, patch by patch.
  PatchTails wholeTails(int workers, std::vector<std::string>* problems, const std::atomic<bool>* stop = nullptr) const;
  // Calls problem(error) for each damaged part of the tails, as it is found, until *stop is set. Does nothing where the
  // package has no tails.
  void checkTails(const std::function<void(const Error&)>& problem, const std::atomic<bool>* stop = nullptr) const;
  std::vector<std::string> tailProblems() const;  // as texts
  Result<TailBytes> tailBytes() const;
  Result<void> checkReliefDetail(const NodeId& node) const;  // is the block of reliefErrors() and shapes sound?
  // Is the index block that holds the page's entry sound?
  Result<void> checkIndex(PageId id) const;
  Result<EncodedPage> read(PageId id) const override;
  PageFailures readFailures() const;  // of read(), since the package was opened: a page that fails twice counts twice

 private:
  struct Impl;
  explicit Package(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// What a plane takes in the file, by the index (which is read as a whole: 0.1 % of a package). Index blocks that are
// damaged count as unknown pages; one that cannot be read is an error, since it says nothing of the package.
// kInterrupted soon after *stop is set (it may be null).
struct PlaneUsage {
  uint64_t pages = 0, bytes = 0, unknown_pages = 0;
};
Result<PlaneUsage> planeUsage(const Package& package, Plane plane, const std::atomic<bool>* stop = nullptr);
// What the relief of patches takes: its pages, the base mesh, and the heights of tails where root pages are not whole
// without them.
Result<uint64_t> reliefBytes(const Package& package);

struct DamagedPage {
  PageId id;
  std::string what;
};
struct VerifyProblem {
  std::optional<PageId> page;  // or it lies outside the pages: header, base mesh, index, padding
  std::string what;
  bool unreadable = false;  // an input/output error, which says nothing of the package
  bool repairable = false;  // by repairPackage
};
struct VerifyReport {
  uint64_t pages = 0, bytes = 0;
  std::vector<DamagedPage> damaged;
  std::vector<std::string> other;       // damage outside pages
  std::vector<std::string> unreadable;  // input/output errors
};
struct VerifyOptions {
  int workers = 0;  // 0: one per core
  std::function<void(uint64_t done, uint64_t total)> progress;
  // Takes each problem as it is found, in the place of the report's lists, so that memory stays bounded however many
  // there are.
  std::function<void(const VerifyProblem&)> problem;
  const std::atomic<bool>* interrupted = nullptr;  // once set: kInterrupted soon
  const PageSource* pages = nullptr;  // pages are read from here instead of from the package; for fault injection
};
// Reads, checks and decodes every page, both copies of what is there twice, and what lies between the sections. The
// problems come in the file's order, those of pages in the index's, whatever the workers.
Result<VerifyReport> verifyPackage(const Package& package, const VerifyOptions& options);
inline Result<VerifyReport> verifyPackage(const Package& package, int workers,
                                          void (*progress)(uint64_t done, uint64_t total),
                                          const std::atomic<bool>* interrupted = nullptr) {
  return verifyPackage(
      package, VerifyOptions{.workers = workers, .progress = progress, .problem = {}, .interrupted = interrupted});
}

// Writes a damaged copy of the header or the base mesh anew from the sound one, and zeros into padding: in place, those
// bytes only. A copy of the whole file would need its space again and could lose what a file has besides its bytes
// (owner, links). The bytes that are written are damaged, and nothing reads them while the other copy is sound: an
// interruption leaves the package as good as it was. The sound copy is checked once more on the way. Answers what was
// repaired.
Result<std::vector<std::string>> repairPackage(const std::string& path, const std::atomic<bool>* interrupted = nullptr);

}  // namespace relievo
