// package.h - reading a .relievo package. Layout: texturing/PACKAGE.md.
// Safe for untrusted files: nothing is allocated or read from a size that was not checked against the file's length first.
// Opening costs at most a few reads, whatever the package's size: index blocks are read (and checked) when first asked for.
// A damaged package opens as far as it is sound; what is not answers with an Error that names the place.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "src/base/base_mesh.h"
#include "src/base/planar_domain.h"
#include "src/base/result.h"
#include "texturing/basis.h"
#include "texturing/page_encoding.h"
#include "texturing/page_source.h"
#include "texturing/patch_source.h"
#include "texturing/patch_tails.h"
#include "texturing/raster_source.h"

namespace relievo {

struct Manifest {
  PlanarDomain domain;
  TextureFormat texture;
  PlaneEncodings encodings;  // of the texture's planes; relief is lossless
  std::vector<Provenance> sources;
  std::string tool_version;
  uint64_t page_count = 0;
  // Of an artwork over a base mesh (null: flat). Its patches are the domain's, a strip of whole ones along x; errors are distances in
  // space (patch_source.h). coarse_errors: a patch's grids of 2^k cells a side, k = 0..6; those of 128 and more have pages.
  std::shared_ptr<const BaseMesh> base;
  std::vector<CoarseErrors> coarse_errors;
  std::vector<CoarseBlocks> coarse_blocks;
  std::vector<CoarseShapes> coarse_shapes;  // empty: not known
  std::vector<HeightSlopes> height_slopes;  // empty in packages from before there were any
  double error_unit_mm = 0;  // what a relief page's errors are counted in (a flat artwork's: relief_scale_mm)
};

// Heights of a relief page's square in mm, and how far its own samples (interpolated over triangles or bilinearly) can lie
// from the finest relief: an upper bound, monotone (a child's is never larger).
struct ReliefBounds {
  float min_mm = 0, max_mm = 0, error_mm = 0;
};

struct PageRecord {
  uint64_t offset = 0;
  uint32_t size = 0;      // encoded bytes; 0: the page is absent
  uint64_t checksum = 0;  // xxh3-64 of the encoded bytes
  ReliefBounds relief;    // relief pages only
};

class Package final : public PageSource {
 public:
  static Result<std::shared_ptr<Package>> open(const std::string& path);
  ~Package() override;

  const std::string& path() const;
  uint64_t fileBytes() const;
  const Manifest& manifest() const;
  const std::string& manifestJson() const;  // as stored; empty when damaged
  // What was found damaged on opening; the package works without it.
  const std::vector<std::string>& warnings() const;
  Result<PageRecord> record(PageId id) const;  // thread-safe
  // How far a relief page's surface can lie from the finest relief, mm, by 16 x 16 blocks of 8 x 8 cells, rows top first: upper
  // bounds, none above the page's own (but for their rounding up). False: the package does not say (an older one, or damaged).
  bool reliefErrors(const NodeId& node, std::span<float> error_mm /* 256 */) const;
  // Which way they lie; shares of what reliefErrors() says. False: the package does not say.
  bool reliefShapes(const NodeId& node, std::span<DeviationShape> shapes /* 256 */) const;
  // The tails of its patches (patch_tails.h), as far as they are sound; the others are made of the root pages, and problems (which may be null)
  // names them. False: the package has none (an older one, or a flat artwork).
  bool hasTails() const;
  PatchTails tails(int workers, std::vector<std::string>* problems) const;
  std::vector<std::string> tailProblems() const;  // what of them is damaged; nothing where there are none
  Result<void> checkReliefDetail(const NodeId& node) const;  // is the block of these sound?
  // Is the index block that holds the page's entry sound?
  Result<void> checkIndex(PageId id) const;
  Result<EncodedPage> read(PageId id) const override;

 private:
  struct Impl;
  explicit Package(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// What a plane takes in the file, by the index (which is read as a whole: 0.1 % of a package). Index blocks that are damaged
// count as unknown pages.
struct PlaneUsage {
  uint64_t pages = 0, bytes = 0, unknown_pages = 0;
};
PlaneUsage planeUsage(const Package& package, Plane plane);

struct DamagedPage {
  PageId id;
  std::string what;
};
struct VerifyReport {
  uint64_t pages = 0, bytes = 0;
  std::vector<DamagedPage> damaged;
  std::vector<std::string> other;  // damage outside pages (index blocks, header)
};
// Reads, checks and decodes every page. The damage is listed in the index's order, whatever the workers. progress(done, total) may be null.
// (kInterrupted when the flag is set, which may be null.)
Result<VerifyReport> verifyPackage(const Package& package, int workers, void (*progress)(uint64_t done, uint64_t total),
                                   const std::atomic<bool>* interrupted = nullptr);

}  // namespace relievo
