#include "texturing/package/package_layout.h"

#include "texturing/package/base_code.h"
#include "texturing/package/crease_gutter.h"
#include "texturing/package/index_code.h"
#include "texturing/package/package_base.h"
#include "texturing/package/package_tails.h"

#include <xxhash.h>

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstdio>

namespace relievo {

static_assert(std::endian::native == std::endian::little, "package files are read and written in place, little-endian");

namespace {

uint64_t blocks(uint64_t nodes) { return (nodes + kIndexBlockNodes - 1) / kIndexBlockNodes; }

// How much of a patch, in both directions, there is: all of it over a base mesh.
std::array<uint64_t, 2> coveredPx(const PatchDomain& domain, uint32_t patch) {
  if (!domain.isFlat()) return {domain.patchPx(), domain.patchPx()};
  const FlatDomain d = domain.flat();
  return {std::min(d.patchPx(), d.width_px - d.patchOriginX(patch)),
          std::min(d.patchPx(), d.height_px - d.patchOriginY(patch))};
}

// The index entries of the finest levels alone. texture: do all patches have pages of the texture's finest level?
double leastIndexBytes(const PatchDomain& d, uint32_t detail_bytes, bool finest_detail, bool texture) {
  const FlatExtent size = statedExtent(d);
  auto nodes = [&](int level) {
    const double finer = std::exp2(level) / static_cast<double>(d.patchPx());
    return std::max(1.0, static_cast<double>(size.width_px) * finer) *
           std::max(1.0, static_cast<double>(size.height_px) * finer);
  };
  double bytes = texture ? nodes(d.texture_depth) * kTextureEntryBytes : 0;
  if (d.relief_depth >= 0) bytes += nodes(d.relief_depth) * (kReliefEntryBytes + (finest_detail ? detail_bytes : 0));
  return bytes;
}

// Each says what is wrong, or nothing.
std::string flatProblem(const FlatDomain& d) {
  constexpr uint64_t kMaxExtent = uint64_t{1} << 44;  // kMaxPatches patches of 2^24 texels
  if (d.width_px < 1 || d.height_px < 1) return "the artwork is empty";
  if (d.width_px > kMaxExtent || d.height_px > kMaxExtent) return "a side exceeds 2^44 texels";
  uint64_t shorter = std::min(d.width_px, d.height_px);
  if (shorter > (uint64_t{kPagePx} << kMaxNodeLevel)) return "the shorter side exceeds 2^24 texels";
  if (d.texture_depth != FlatDomain::depthFor(d.width_px, d.height_px))
    return "the texture depth does not fit the size";
  if (std::max(d.width_px, d.height_px) > d.patchPx() * kMaxPatches) return "the strip has more than 2^20 patches";
  return {};
}
std::string meshProblem(const PatchDomain& d) {
  if (d.patchCount() < 1) return "the artwork is empty";
  if (d.patchCount() > kMaxPatches) return "there are more than 2^20 patches";
  if (d.texture_depth < 0 || d.texture_depth > static_cast<int>(kMaxNodeLevel))
    return "the texture depth is out of range";
  if (d.relief_depth < 0) return "an artwork over a base mesh has a relief";
  return {};
}
std::string measuresProblem(const PatchMeasures& d) {
  if (d.relief_depth < -1 || d.relief_depth > static_cast<int>(kMaxNodeLevel))
    return "the relief depth is out of range";
  if (!std::isfinite(d.mm_per_px) || d.mm_per_px <= 0) return "the size of a pixel in mm is not a positive number";
  if (!std::isfinite(d.relief_offset_mm) || !std::isfinite(d.relief_scale_mm) || d.relief_scale_mm < 0)
    return "the relief's range is not a number";
  return {};
}

struct HeaderField {
  uint8_t* out;
  template <class T>
  void put(size_t offset, T v) {
    storeLittle(out + offset, v);
  }
};

// ---- the basis: by its number in versions 1 and 2, described behind all else in version 3 ----
constexpr int kOldPlanes = 8;
constexpr size_t kOldCoefficients = 6, kOldScales = 144, kOldBiases = 192, kOldCodecs = 240, kOldParameters = 248;
constexpr uint32_t kDescribedBasis = 0xFFFFFFFFu;  // instead of its number
// From version 4 on: how relief pages, the base mesh and the tree of errors by block are stored, 1 each; from version 7
// on the base mesh 2, from version 10 on 3, from version 12 on 4, from version 17 on 5.
constexpr std::array<size_t, 3> kCompactFields{2048, 2052, 2056};
constexpr size_t kBaseField = 2052;
uint32_t baseKind(const PackageHeader& h) {
  return h.base_parity ? 5 : h.base_by_border ? 4 : h.light_patches ? 3 : h.coded_base ? 2 : 1;
}
uint32_t imagesKind(const PackageHeader& h) {
  return h.richer_images ? 6 : h.corner_colours ? 5 : h.base_parity ? 4 : h.image_tails ? 3 : h.image_jpegs ? 2 : 1;
}
// Version 5: how texture levels that patches do not have are left out, 1. Version 4: 0; from version 6 on: either.
constexpr size_t kTextureDepthsField = 2060;
// From version 6 on: how tails are stored, 1, from version 10 on 2. Before: 0.
constexpr size_t kTailsField = 2064;
// From version 8 on: how texture pages may be stored beside what encodings say, 1. Before: 0.
constexpr size_t kTexelsField = 2068;
// From version 9 on: how the index is stored, 1, from version 10 on 2; from version 11 on 2, or 0 as in version 8.
// Before: 0.
constexpr size_t kIndexField = 2072;
// From version 11 on: how the base mesh is interpolated, 1: on halves; in version 12 also 0: not so. Before: 0.
constexpr size_t kCutField = 2076;
// From version 13 on: how images that patches show are stored, and where; in version 14 also 0: there are none;
// in version 15 2: some are JPEGs; in version 16 3: tails are made of them; in version 17 4: normals follow the base;
// in version 18 5: corners may have colours; in version 19 6: images may have maps of normals, and more texels.
constexpr size_t kImagesField = 2080, kImagesPlaceFields = 2088;
// From version 14 on: how colours of tails end, 1; from version 15 on also 0: not so.
constexpr size_t kTailEdgesField = 2084;
constexpr size_t kBasisName = 320, kBasisNameBytes = 32, kBasisCounts = 352, kBasisEncodings = 368, kBasisScales = 432;
static_assert(kBasisEncodings + 2 * kMaxTexturePlanes <= kBasisScales);
static_assert(kBasisScales + 16 * kMaxCoefficients <= kCompactFields[0]);

void putOldBasis(HeaderField f, const PackageHeader& h) {
  f.put(136, static_cast<uint32_t>(h.texture.basis));
  for (size_t k = 0; k < kOldCoefficients; ++k) {
    f.put(kOldScales + 8 * k, h.texture.scale[k]);
    f.put(kOldBiases + 8 * k, h.texture.bias[k]);
  }
  for (size_t k = 0; k < kOldPlanes; ++k) {
    f.put(kOldCodecs + k, static_cast<uint8_t>(h.encodings[k].codec));
    f.put(kOldParameters + k, h.encodings[k].parameter);
  }
}

void putBasis(HeaderField f, const PackageHeader& h) {
  const BasisDescription& basis = describe(h.texture.basis);
  const size_t n = static_cast<size_t>(basis.coefficients);
  f.put(136, kDescribedBasis);
  basis.name.copy(reinterpret_cast<char*>(f.out + kBasisName), kBasisNameBytes - 1);
  f.put(kBasisCounts, static_cast<uint32_t>(basis.shading));
  f.put(kBasisCounts + 4, static_cast<uint32_t>(basis.planes));
  f.put(kBasisCounts + 8, static_cast<uint32_t>(n));   // coefficients
  f.put(kBasisCounts + 12, static_cast<uint32_t>(n));  // scales and biases
  for (size_t k = 0; k < static_cast<size_t>(basis.planes); ++k) {
    f.put(kBasisEncodings + 2 * k, static_cast<uint8_t>(h.encodings[k].codec));
    f.put(kBasisEncodings + 2 * k + 1, h.encodings[k].parameter);
  }
  for (size_t k = 0; k < n; ++k) {
    f.put(kBasisScales + 8 * k, h.texture.scale[k]);
    f.put(kBasisScales + 8 * (n + k), h.texture.bias[k]);
  }
}

// What of a header cannot be read; the file's name is added by who knows it.
Error fieldError(ErrorKind kind, uint64_t offset, std::string message) {
  return {kind, "", std::move(message),
          kind == ErrorKind::kUnsupported ? "use a newer relievo, or rebuild the package"
                                          : "rebuild the package, or get a whole copy",
          offset};
}

Result<PageEncoding> readEncoding(const uint8_t* p, size_t codec, size_t parameter, size_t plane) {
  auto encoding = encodingFromBytes(p[codec], p[parameter]);
  if (encoding) return encoding;
  Error error = encoding.error();
  error.message = "plane " + std::to_string(plane) + ": " + error.message;
  error.offset = codec;
  return error;
}

Result<void> readNumbers(const uint8_t* p, size_t scales, size_t biases, size_t n, TextureFormat& texture) {
  for (size_t k = 0; k < n; ++k) {
    texture.scale[k] = loadLittle<double>(p + scales + 8 * k);
    texture.bias[k] = loadLittle<double>(p + biases + 8 * k);
    if (!std::isfinite(texture.scale[k]) || !std::isfinite(texture.bias[k]))
      return fieldError(ErrorKind::kInvalidData, scales + 8 * k, "a coefficient's scale or bias is not a number");
  }
  return {};
}

Result<void> readOldBasis(const uint8_t* p, uint32_t version, PackageHeader& h) {
  const uint32_t basis = loadLittle<uint32_t>(p + 136);
  if (basis > (version == 1 ? 2 : 3))
    return fieldError(
        ErrorKind::kInvalidData, 136,
        std::string("expected basis 0, 1 or 2") + (version == 1 ? "" : " or 3") + ", found " + std::to_string(basis));
  h.texture.basis = static_cast<Basis>(basis);
  if (auto read = readNumbers(p, kOldScales, kOldBiases, kOldCoefficients, h.texture); !read) return read;
  for (size_t k = 0; k < kOldPlanes; ++k) {
    auto encoding = readEncoding(p, kOldCodecs + k, kOldParameters + k, k);
    if (!encoding) return encoding.error();
    h.encodings[k] = *encoding;
  }
  return {};
}

Result<void> readBasis(const uint8_t* p, PackageHeader& h) {
  if (const uint32_t number = loadLittle<uint32_t>(p + 136); number != kDescribedBasis)
    return fieldError(ErrorKind::kInvalidData, 136,
                      "expected no number of a basis in version 3, found " + std::to_string(number));
  const char* name = reinterpret_cast<const char*>(p + kBasisName);
  const std::string_view found(name, std::find(name, name + kBasisNameBytes, '\0') - name);
  const auto basis = findBasis(found);
  if (!basis)
    return fieldError(ErrorKind::kUnsupported, kBasisName,
                      "the texture's basis '" + std::string(found) + "' is not known to this program");
  h.texture.basis = *basis;
  if (*basis <= Basis::kAlbedoNormal)
    return fieldError(ErrorKind::kInvalidData, kBasisName,
                      "expected a basis of version 3, found '" + std::string(found) + "'");
  const BasisDescription& known = describe(*basis);
  const size_t n = static_cast<size_t>(known.coefficients);
  const std::array<uint32_t, 4> expected{static_cast<uint32_t>(known.shading), static_cast<uint32_t>(known.planes),
                                         static_cast<uint32_t>(n), static_cast<uint32_t>(n)};
  constexpr std::array<const char*, 4> kWhat{"shading", "planes", "coefficients", "scales and biases"};
  for (size_t i = 0; i < expected.size(); ++i)
    if (const uint32_t value = loadLittle<uint32_t>(p + kBasisCounts + 4 * i); value != expected[i])
      return fieldError(ErrorKind::kUnsupported, kBasisCounts + 4 * i,
                        "the texture's basis '" + std::string(found) + "': expected " + kWhat[i] + " " +
                            std::to_string(expected[i]) + ", found " + std::to_string(value));
  for (size_t k = 0; k < static_cast<size_t>(known.planes); ++k) {
    auto encoding = readEncoding(p, kBasisEncodings + 2 * k, kBasisEncodings + 2 * k + 1, k);
    if (!encoding) return encoding.error();
    h.encodings[k] = *encoding;
  }
  return readNumbers(p, kBasisScales, kBasisScales + 8 * n, n, h.texture);
}

}  // namespace

FlatExtent statedExtent(const PatchDomain& d) {
  if (d.isFlat()) return d.flat();
  return {d.patchCount() * d.patchPx(), d.patchPx()};
}

std::string domainProblem(const PatchDomain& d) {
  const std::string size = d.isFlat() ? flatProblem(d.flat()) : meshProblem(d);
  return size.empty() ? measuresProblem(d) : size;
}

IndexLayout::Patch IndexLayout::layOut(const PatchDomain& domain, const std::array<uint64_t, 2>& covered_px,
                                       int depth) const {
  Patch p;
  for (int l = 0; l <= depth; ++l) {
    Level level;
    level.base = p.bytes;
    level.columns = static_cast<uint32_t>(domain.nodesAlong(covered_px[0], l));
    level.rows = static_cast<uint32_t>(domain.nodesAlong(covered_px[1], l));
    uint64_t nodes = uint64_t{level.columns} * level.rows;
    p.nodes += nodes;
    p.bytes += nodes * node_bytes_ + 8 * blocks(level.columns) * blocks(level.rows);
    p.levels.push_back(level);
  }
  return p;
}

IndexLayout::IndexLayout(const PatchDomain& domain, int depth, uint32_t node_bytes, uint64_t base)
    : patch_count_(domain.patchCount()), node_bytes_(node_bytes), base_(base) {
  kinds_ = {layOut(domain, coveredPx(domain, 0), depth), layOut(domain, coveredPx(domain, patch_count_ - 1), depth)};
  bytes_ = kinds_[0].bytes * (patch_count_ - 1) + kinds_[1].bytes;
  nodes_ = kinds_[0].nodes * (patch_count_ - 1) + kinds_[1].nodes;
}

IndexLayout::IndexLayout(const PatchDomain& domain, std::shared_ptr<const TextureDepths> depths, uint32_t node_bytes,
                         uint64_t base)
    : depths_(std::move(depths)), patch_count_(domain.patchCount()), node_bytes_(node_bytes), base_(base) {
  assert(!domain.isFlat() && depths_->size() == patch_count_);
  for (int depth = kNoTexturePage; depth <= domain.texture_depth; ++depth)
    kinds_.push_back(layOut(domain, coveredPx(domain, 0), depth));
  offsets_.reserve(patch_count_);
  for (uint32_t patch = 0; patch < patch_count_; ++patch) {
    offsets_.push_back(bytes_);
    bytes_ += patchOf(patch).bytes;
    nodes_ += patchOf(patch).nodes;
  }
}

uint32_t IndexLayout::patchAt(uint64_t offset) const {
  const uint64_t in_tree = offset - base_;
  if (!depths_) return static_cast<uint32_t>(std::min<uint64_t>(in_tree / kinds_[0].bytes, patch_count_ - 1));
  return static_cast<uint32_t>(std::upper_bound(offsets_.begin(), offsets_.end(), in_tree) - offsets_.begin() - 1);
}

bool IndexLayout::contains(const NodeId& n) const {
  if (n.patch >= patch_count_) return false;
  const Patch& p = patchOf(n.patch);
  return n.level < p.levels.size() && n.x < p.levels[n.level].columns && n.y < p.levels[n.level].rows;
}

IndexLayout::Place IndexLayout::find(const NodeId& n) const {
  assert(contains(n));
  const Level& level = patchOf(n.patch).levels[n.level];
  uint32_t bx = n.x / kIndexBlockNodes, by = n.y / kIndexBlockNodes;
  uint32_t columns = std::min(kIndexBlockNodes, level.columns - bx * kIndexBlockNodes);
  uint32_t rows = std::min(kIndexBlockNodes, level.rows - by * kIndexBlockNodes);
  uint64_t nodes_before = uint64_t{by} * kIndexBlockNodes * level.columns + uint64_t{bx} * kIndexBlockNodes * rows;
  uint64_t blocks_before = by * blocks(level.columns) + bx;
  Place place;
  place.block_offset = base_ + patchOffset(n.patch) + level.base + nodes_before * node_bytes_ + blocks_before * 8;
  place.block_bytes = columns * rows * node_bytes_ + 8;
  place.node_offset = ((n.y % kIndexBlockNodes) * columns + n.x % kIndexBlockNodes) * node_bytes_;
  return place;
}

uint8_t byteFromError(uint32_t steps) {
  if (steps < 32) return static_cast<uint8_t>(steps);
  int e = std::bit_width(steps) - 4;  // steps >> (e - 1) is 16..31
  uint32_t m = (steps + (1u << (e - 1)) - 1) >> (e - 1);
  return static_cast<uint8_t>(16 * e + static_cast<int>(m) - 16);  // m of 32 is the next e's first
}

PackageLayout packageLayout(const PatchDomain& domain, const TextureFormat& format, uint64_t index_offset,
                            uint32_t detail_bytes, bool finest_detail) {
  PackageLayout layout;
  const uint32_t planes = static_cast<uint32_t>(format.planes());
  const uint32_t texture_bytes = planes * kTextureEntryBytes;
  layout.texture = domain.textureDepths() ? IndexLayout(domain, domain.textureDepths(), texture_bytes, index_offset)
                                          : IndexLayout(domain, domain.texture_depth, texture_bytes, index_offset);
  layout.index_bytes = layout.texture.bytes();
  layout.page_count = layout.texture.nodeCount() * planes;
  if (domain.relief_depth >= 0) {
    layout.relief = IndexLayout(domain, domain.relief_depth, kReliefEntryBytes, index_offset + layout.index_bytes);
    layout.index_bytes += layout.relief.bytes();
    layout.page_count += layout.relief.nodeCount();
    if (detail_bytes > 0) {
      layout.relief_detail = IndexLayout(domain, domain.relief_depth - (finest_detail ? 0 : 1), detail_bytes,
                                         index_offset + layout.index_bytes);
      layout.index_bytes += layout.relief_detail.bytes();
    }
  }
  return layout;
}

std::string textureDepthsProblem(const PackageHeader& h, const TextureDepths& depths) {
  if (!h.texture_depths) return depths.empty() ? "" : "expected no texture levels of single patches, found some";
  if (depths.size() != h.domain.patchCount()) return "expected the texture levels of all patches";
  for (size_t i = 0; i < depths.size(); ++i)
    if (depths[i] < kNoTexturePage || depths[i] > h.domain.texture_depth)
      return "expected at most " + std::to_string(h.domain.texture_depth + 1) + " texture levels of patch " +
             std::to_string(i) + ", found " + std::to_string(depths[i] + 1);
  PatchDomain domain = h.domain;
  domain.setTextureDepths(std::make_shared<const TextureDepths>(depths));
  const PackageLayout layout = packageLayout(domain, h.texture, h.index_offset, h.detailBytes(), !h.compact);
  if (layout.page_count == h.page_count && (h.coded_index || layout.index_bytes == h.index_bytes)) return {};
  if (h.coded_index)
    return "its patches' texture levels make " + std::to_string(layout.page_count) + " pages, the header says " +
           std::to_string(h.page_count);
  return "its patches' texture levels make " + std::to_string(layout.page_count) + " pages and an index of " +
         std::to_string(layout.index_bytes) + " bytes, the header says " + std::to_string(h.page_count) + " and " +
         std::to_string(h.index_bytes);
}

void encodeHeader(const PackageHeader& h, std::span<uint8_t> out) {
  assert(out.size() == kHeaderBytes);
  assert(h.domain.isFlat() == (h.base_bytes == 0));
  std::fill(out.begin(), out.end(), uint8_t{0});
  std::copy(kPackageMagic.begin(), kPackageMagic.end(), out.begin());
  HeaderField f{out.data()};
  f.put(8, packageVersion(h));
  f.put(12, kHeaderBytes);
  f.put(16, h.file_bytes);
  f.put(24, h.manifest_offset);
  f.put(32, h.manifest_bytes);
  f.put(40, h.manifest_hash);
  f.put(48, h.index_offset);
  f.put(56, h.index_bytes);
  f.put(64, h.pages_offset);
  f.put(72, h.pages_bytes);
  f.put(80, h.page_count);
  const FlatExtent stated = statedExtent(h.domain);
  f.put(88, stated.width_px);
  f.put(96, stated.height_px);
  f.put(104, h.domain.mm_per_px);
  f.put(112, h.domain.relief_offset_mm);
  f.put(120, h.domain.relief_scale_mm);
  f.put(128, static_cast<int32_t>(h.domain.texture_depth));
  f.put(132, static_cast<int32_t>(h.domain.relief_depth));
  f.put(140, h.size_known ? 0u : 1u);
  if (h.texture.basis > Basis::kAlbedoNormal) putBasis(f, h);
  else putOldBasis(f, h);
  if (h.compact)
    for (size_t field : kCompactFields) f.put(field, field == kBaseField ? baseKind(h) : 1u);
  if (h.compact && h.texture_depths) f.put(kTextureDepthsField, 1u);
  if (h.compact && h.coded_tails) f.put(kTailsField, h.light_patches ? 2u : 1u);
  if (h.compact && h.coded_texels) f.put(kTexelsField, 1u);
  if (h.compact && h.coded_index) f.put(kIndexField, h.light_patches ? 2u : 1u);
  if (h.cut_patches) f.put(kCutField, 1u);
  if (h.tail_edges) f.put(kTailEdgesField, 1u);
  if (h.showsImages()) {
    f.put(kImagesField, imagesKind(h));
    f.put(kImagesPlaceFields, h.images_offset);
    f.put(kImagesPlaceFields + 8, h.images_bytes);
    f.put(kImagesPlaceFields + 16, h.images_hash);
  }
  f.put(256, h.relief_detail ? static_cast<uint32_t>(kErrorBlocks) : 0u);
  f.put(260, h.relief_shapes ? 1u : 0u);
  f.put(264, h.base_offset);
  f.put(272, h.base_bytes);
  f.put(280, h.base_hash);
  f.put(288, h.base_copy_offset);
  f.put(296, h.tails_offset);
  f.put(304, h.tails_bytes);
  f.put(312, h.tails_hash);
  f.put(kHeaderBytes - 8, static_cast<uint64_t>(XXH3_64bits(out.data(), kHeaderBytes - 8)));
}

namespace {

// Takes a header apart and compares its claims with one another and with the file's length. In the order of the
// methods: each relies on what those before it have checked.
class HeaderDecoder {
 public:
  HeaderDecoder(const uint8_t* bytes, const std::string& path) : p_(bytes), path_(path) {}
  Result<PackageHeader> decode() {
    if (auto done = readIdentity(); !done) return done.error();
    if (auto done = readFields(); !done) return done.error();
    if (auto done = readReliefDetail(); !done) return done.error();
    if (auto done = checkSections(); !done) return done.error();
    if (auto done = readBase(); !done) return done.error();
    if (auto done = checkIndex(); !done) return done.error();
    return h_;
  }

 private:
  template <class T>
  T at(size_t offset) const {
    return loadLittle<T>(p_ + offset);
  }
  Error invalid(uint64_t offset, std::string message) const {
    return {ErrorKind::kInvalidData, path_, std::move(message), "rebuild the package, or get a whole copy", offset};
  }
  Error unsupported(uint64_t offset, std::string message) const {
    Error error = invalid(offset, std::move(message));
    error.kind = ErrorKind::kUnsupported;
    return error;
  }
  // Written so that no sum can overflow.
  bool inside(uint64_t offset, uint64_t size) const {
    return offset <= h_.file_bytes && size <= h_.file_bytes - offset;
  }
  Error outside(uint64_t field, const char* what, uint64_t offset, uint64_t size) const {
    return invalid(field, std::string(what) + " outside the file: expected it within " + std::to_string(h_.file_bytes) +
                              " bytes, found " + std::to_string(size) + " bytes from byte " + std::to_string(offset));
  }

  Result<void> readIdentity() {
    if (!std::equal(kPackageMagic.begin(), kPackageMagic.end(), p_)) {
      return Error{ErrorKind::kInvalidData, path_, "not a Relievo package: its first bytes are not the signature",
                   "make one with `relievo build`", 0};
    }
    version_ = at<uint32_t>(8);
    if (version_ < 1 || version_ > 19) {
      return Error{ErrorKind::kUnsupported, path_,
                   "expected package version 1 to 19, found " + std::to_string(version_),
                   "use a newer relievo, or rebuild the package", 8};
    }
    if (at<uint64_t>(kHeaderBytes - 8) != XXH3_64bits(p_, kHeaderBytes - 8))
      return invalid(kHeaderBytes - 8, "the header is damaged: its checksum does not match");
    return {};
  }

  Result<void> readFields() {
    h_.file_bytes = at<uint64_t>(16);
    h_.manifest_offset = at<uint64_t>(24);
    h_.manifest_bytes = at<uint64_t>(32);
    h_.manifest_hash = at<uint64_t>(40);
    h_.index_offset = at<uint64_t>(48);
    h_.index_bytes = at<uint64_t>(56);
    h_.pages_offset = at<uint64_t>(64);
    h_.pages_bytes = at<uint64_t>(72);
    h_.page_count = at<uint64_t>(80);
    stated_.width_px = at<uint64_t>(88);
    stated_.height_px = at<uint64_t>(96);
    stated_.mm_per_px = at<double>(104);
    stated_.relief_offset_mm = at<double>(112);
    stated_.relief_scale_mm = at<double>(120);
    stated_.texture_depth = at<int32_t>(128);
    stated_.relief_depth = at<int32_t>(132);
    h_.domain = stated_;
    const bool described = version_ == 3 || (version_ >= 4 && at<uint32_t>(136) == kDescribedBasis);
    if (auto read = described ? readBasis(p_, h_) : readOldBasis(p_, version_, h_); !read) {
      Error error = read.error();
      error.file = path_;
      return error;
    }
    // Other values are a newer version's, which says no less than that mm_per_px is not to be trusted.
    h_.size_known = at<uint32_t>(140) == 0;
    return {};
  }

  Result<void> readReliefDetail() {
    const auto blocks = at<uint32_t>(256), shapes = at<uint32_t>(260);
    if (blocks != 0 && blocks != kErrorBlocks)
      return unsupported(256,
                         "expected relief errors of 0 or 16 blocks a page's side, found " + std::to_string(blocks));
    h_.relief_detail = blocks != 0;
    if (shapes > 1 || (shapes == 1 && !h_.relief_detail))
      return unsupported(260, "expected relief errors' shapes of kind 0, or 1 beside errors by block, found " +
                                  std::to_string(shapes));
    h_.relief_shapes = shapes == 1;
    h_.compact = version_ >= 4;
    h_.coded_tails = version_ >= 6;
    h_.coded_base = version_ >= 7;
    h_.coded_texels = version_ >= 8;
    h_.base_by_border = version_ >= 12;
    h_.image_jpegs = version_ >= 15;
    h_.image_tails = version_ >= 16;
    h_.base_parity = version_ >= 17;
    h_.corner_colours = version_ >= 18;
    h_.richer_images = version_ >= 19;
    h_.tail_edges = version_ == 14 || (version_ >= 15 && at<uint32_t>(kTailEdgesField) != 0);
    h_.cut_patches = version_ == 11 || (version_ >= 12 && at<uint32_t>(kCutField) != 0);
    h_.light_patches = version_ >= 11 ? at<uint32_t>(kIndexField) != 0 : version_ >= 10;
    h_.coded_index = version_ >= 11 ? h_.light_patches : version_ >= 9;
    h_.texture_depths = version_ == 5 || (version_ >= 6 && at<uint32_t>(kTextureDepthsField) != 0);
    if (!h_.compact) return {};
    for (size_t field : kCompactFields)
      if (const uint32_t kind = at<uint32_t>(field), expected = field == kBaseField ? baseKind(h_) : 1;
          kind != expected)
        return unsupported(field, "expected storage of kind " + std::to_string(expected) + " in version " +
                                      std::to_string(version_) + ", found " + std::to_string(kind));
    if (const auto kind = at<uint32_t>(kTextureDepthsField); h_.texture_depths && kind != 1)
      return unsupported(kTextureDepthsField, "expected patches' texture levels of kind 1 in version " +
                                                  std::to_string(version_) + ", found " + std::to_string(kind));
    if (const uint32_t kind = at<uint32_t>(kTailsField), expected = h_.light_patches ? 2 : 1;
        h_.coded_tails && kind != expected)
      return unsupported(kTailsField, "expected tails of kind " + std::to_string(expected) + " in version " +
                                          std::to_string(version_) + ", found " + std::to_string(kind));
    if (const auto kind = at<uint32_t>(kTexelsField); h_.coded_texels && kind != 1)
      return unsupported(kTexelsField, "expected texture pages of kind 1 in version " + std::to_string(version_) +
                                           ", found " + std::to_string(kind));
    if (const uint32_t kind = at<uint32_t>(kIndexField), expected = h_.light_patches ? 2 : 1;
        h_.coded_index && kind != expected)
      return unsupported(kIndexField, "expected an index of kind " + std::to_string(expected) + " in version " +
                                          std::to_string(version_) + ", found " + std::to_string(kind));
    if (const auto kind = at<uint32_t>(kCutField); h_.cut_patches && kind != 1)
      return unsupported(kCutField, "expected a base mesh interpolated by kind 1 in version " +
                                        std::to_string(version_) + ", found " + std::to_string(kind));
    if (const uint32_t kind = at<uint32_t>(kImagesField), expected = imagesKind(h_);
        mayShowImages() && kind != expected)
      return unsupported(kImagesField, "expected images of kind " + std::to_string(expected) + " in version " +
                                           std::to_string(version_) + ", found " + std::to_string(kind));
    if (const auto kind = at<uint32_t>(kTailEdgesField); h_.tail_edges && kind != 1)
      return unsupported(kTailEdgesField, "expected colours of tails that end by kind 1 in version " +
                                              std::to_string(version_) + ", found " + std::to_string(kind));
    if (h_.tail_edges && (!h_.cut_patches || !hasNormals(h_.texture)))
      return invalid(kTailEdgesField, "expected cut patches with normals in version " + std::to_string(version_));
    if (at<uint64_t>(272) == 0)
      return invalid(272, "expected a base mesh in version " + std::to_string(version_) + ", found none");
    return {};
  }

  Result<void> checkSections() const {
    if (std::string problem = domainProblem(stated_); !problem.empty()) return invalid(88, problem);
    if (constexpr uint64_t kMost = uint64_t{1} << 62; h_.file_bytes > kMost)
      return invalid(
          16, "expected a file of at most " + std::to_string(kMost) + " bytes, found " + std::to_string(h_.file_bytes));
    if (at<uint32_t>(12) != kHeaderBytes) return invalid(12, "expected a header of 4096 bytes");
    if (!inside(h_.manifest_offset, h_.manifest_bytes))
      return outside(24, "the manifest lies", h_.manifest_offset, h_.manifest_bytes);
    if (h_.manifest_bytes > kMaxManifestBytes)
      return invalid(32, "expected a manifest of at most " + std::to_string(kMaxManifestBytes) + " bytes, found " +
                             std::to_string(h_.manifest_bytes));
    if (!inside(h_.index_offset, h_.index_bytes)) return outside(48, "the index lies", h_.index_offset, h_.index_bytes);
    if (!inside(h_.pages_offset, h_.pages_bytes)) return outside(64, "the pages lie", h_.pages_offset, h_.pages_bytes);
    return {};
  }

  bool mayShowImages() const {
    return version_ == 13 || (version_ == 14 && at<uint32_t>(kImagesField) != 0) || version_ >= 15;
  }
  // The tails' place is known.
  Result<void> readImages() {
    h_.images_offset = at<uint64_t>(kImagesPlaceFields);
    h_.images_bytes = at<uint64_t>(kImagesPlaceFields + 8);
    h_.images_hash = at<uint64_t>(kImagesPlaceFields + 16);
    if (!inside(h_.images_offset, h_.images_bytes))
      return outside(kImagesPlaceFields, "the images lie", h_.images_offset, h_.images_bytes);
    if (h_.images_bytes == 0 || h_.images_offset < h_.tilesOffset() || !h_.cut_patches || !h_.texture_depths ||
        !hasNormals(h_.texture))
      return invalid(kImagesPlaceFields,
                     "expected images behind the tails of cut patches with normals, which have "
                     "texture levels of their own");
    return {};
  }

  // Nothing to do for a flat artwork.
  Result<void> readBase() {
    if (version_ == 1 || (version_ == 3 && at<uint64_t>(272) == 0)) return {};
    h_.base_offset = at<uint64_t>(264);
    h_.base_bytes = at<uint64_t>(272);
    h_.base_hash = at<uint64_t>(280);
    h_.base_copy_offset = at<uint64_t>(288);
    h_.tails_offset = at<uint64_t>(296);
    h_.tails_bytes = at<uint64_t>(304);
    h_.tails_hash = at<uint64_t>(312);
    if (!inside(h_.tails_offset, h_.tails_bytes))
      return outside(296, "the patches' tails lie", h_.tails_offset, h_.tails_bytes);
    if (mayShowImages())
      if (auto read = readImages(); !read) return read;
    const FlatDomain& d = stated_;
    if (const uint64_t expected = tailsDirectoryBytes(d.patchCount());
        h_.tails_bytes != 0 && h_.tails_bytes != expected)
      return invalid(304, "expected a directory of tails of " + std::to_string(expected) + " bytes, found " +
                              std::to_string(h_.tails_bytes));
    if (h_.texture_depths && h_.tails_bytes == 0)
      return invalid(304, "expected the patches' tails in version " + std::to_string(version_) + ", found none");
    if (!inside(h_.base_offset, h_.base_bytes))
      return outside(264, "the base mesh lies", h_.base_offset, h_.base_bytes);
    if (!inside(h_.base_copy_offset, h_.baseCopyBytes()))
      return outside(288, h_.base_parity ? "the base mesh's parity lies" : "the base mesh's copy lies",
                     h_.base_copy_offset, h_.baseCopyBytes());
    if (d.height_px != d.patchPx() || d.width_px % d.patchPx() != 0)
      return invalid(88, "an artwork over a base mesh is a strip of whole patches along x");
    if (d.relief_depth < 0) return invalid(132, "an artwork over a base mesh has a relief");
    if (const uint64_t least = h_.coded_base ? kLeastCodedBaseBytes
                               : h_.compact  ? kLeastPackedBaseBytes
                                             : baseSectionBytes(4, d.patchCount(), BaseSectionEnd::kBlocks),
        most = baseSectionBytes(uint64_t{4} * d.patchCount(), d.patchCount(),
                                h_.texture_depths ? BaseSectionEnd::kTextureDepths : BaseSectionEnd::kShapes);
        h_.base_bytes < least || h_.base_bytes > (h_.coded_base ? mostCodedBaseBytes(most)
                                                  : h_.compact  ? mostPackedBaseBytes(most)
                                                                : most)) {
      return invalid(272, "expected a base mesh of " + std::to_string(least) + " to " + std::to_string(most) +
                              " bytes, found " + std::to_string(h_.base_bytes));
    }
    h_.domain = PatchDomain::overMesh(d.patchCount(), d);
    return {};
  }

  Result<void> checkIndex() const {
    // As a double first: the sizes below are exact unless they overflow, and then this is far beyond any file.
    const double coded = h_.coded_index ? double{kLeastCodedEntryBytes} / kReliefEntryBytes : 1;
    const double empty = h_.light_patches ? double{kLeastCodedEntryBytes} * h_.domain.patchCount() : 0;
    if (const double least =
            coded * leastIndexBytes(h_.domain, h_.detailBytes(), !h_.compact, !h_.texture_depths) - empty;
        least > static_cast<double>(h_.file_bytes)) {
      char text[40];
      std::snprintf(text, sizeof text, "%.3g", least);
      return invalid(88, "expected a file of at least " + std::string(text) +
                             " bytes for the index of so many pages, found " + std::to_string(h_.file_bytes));
    }
    const PackageLayout layout = packageLayout(h_);
    // Where the base mesh says which texture pages there are, textureDepthsProblem() compares the exact numbers.
    const uint64_t textures = layout.texture.nodeCount() * static_cast<uint64_t>(h_.texture.planes());
    const uint64_t fewer_bytes = h_.texture_depths ? layout.texture.bytes() : 0,
                   fewer_pages = h_.texture_depths ? textures : 0;
    auto between = [](uint64_t least, uint64_t most) {
      return least == most ? std::to_string(most) : std::to_string(least) + " to " + std::to_string(most);
    };
    if (!h_.coded_index && (h_.index_bytes > layout.index_bytes || h_.index_bytes < layout.index_bytes - fewer_bytes)) {
      return invalid(56, "expected an index of " + between(layout.index_bytes - fewer_bytes, layout.index_bytes) +
                             " bytes, found " + std::to_string(h_.index_bytes));
    }
    if (h_.page_count > layout.page_count || h_.page_count < layout.page_count - fewer_pages) {
      return invalid(80, "expected " + between(layout.page_count - fewer_pages, layout.page_count) + " pages, found " +
                             std::to_string(h_.page_count));
    }
    // Root pages of relief may be empty.
    const uint64_t with_bytes = h_.page_count - (h_.light_patches ? h_.domain.patchCount() : 0);
    if (const uint64_t least = kIndexHeadBytes + kLeastCodedEntryBytes * with_bytes + layout.relief_detail.bytes();
        h_.coded_index && h_.index_bytes < least)
      return invalid(56, "expected an index of at least " + std::to_string(least) + " bytes, found " +
                             std::to_string(h_.index_bytes));
    if (h_.pages_bytes < with_bytes) {
      return invalid(72, "expected at least a byte for each of " + std::to_string(with_bytes) + " pages, found " +
                             std::to_string(h_.pages_bytes) + " bytes of pages");
    }
    return {};
  }

  const uint8_t* p_;  // kHeaderBytes
  const std::string& path_;
  uint32_t version_ = 0;
  FlatDomain stated_;  // the domain in the file's words: the patches over a base mesh are a strip, too
  PackageHeader h_;
};

}  // namespace

Result<PackageHeader> decodeHeader(std::span<const uint8_t> bytes, const std::string& path) {
  assert(bytes.size() == kHeaderBytes);
  return HeaderDecoder(bytes.data(), path).decode();
}

std::string describePage(PageId id) {
  NodeId n = id.node();
  const int number = isTexturePlane(id.plane()) ? texturePlaneIndex(id.plane()) : static_cast<int>(id.plane());
  std::string plane = id.plane() == Plane::kRelief ? "relief" : std::to_string(number);
  return "plane " + plane + " patch " + std::to_string(n.patch) + " level " + std::to_string(n.level) + " x " +
         std::to_string(n.x) + " y " + std::to_string(n.y);
}

}  // namespace relievo
