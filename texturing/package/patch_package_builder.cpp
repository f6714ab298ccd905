// How a build runs: several times over the patches, which are independent in each pass
// (texturing/package/package_writer.h).
//
//   heights   asks the source for the patch's heights and their errors: the base mesh's section stands before the pages
//   texels    asks the source for the patch's texels; keeps them, of its levels and of the tail, as bytes, and of each
//             level and side the 4 rows of texels that the neighbour's pages have as their border; but for channels
//             that are the same everywhere, of which one texel is kept
//   depths    looks for texture levels that show nothing which coarser ones do not (texture_depths.h). The base mesh's
//             section says which levels there are, and the index, before the pages, has entries for these only
//   relief    asks the source for the patch's heights again and writes its relief pages, which need no other patch
//   texture   writes the texture pages, their borders from the neighbours' strips, turned as the sides lie, and
//             interpolated where a neighbour has no texels that fine
//
// Where the border lies diagonally beyond a patch's corner there is one patch only if four meet there. Any number may,
// so what stands there is what makes the mean of the four texels around the corner the same from all patches: that of
// all their corner texels.
//
// So the source is asked for each patch's texels once, and no page waits for a neighbour's.
#include "texturing/package/patch_package_builder.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstring>
#include <memory>
#include <nlohmann/json.hpp>

#include "src/base/worker_threads.h"
#include "texturing/package/base_code.h"
#include "texturing/package/build_reporter.h"
#include "texturing/package/package_base.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_writer.h"
#include "texturing/package/patch_relief.h"
#include "texturing/package/patch_texels.h"

namespace relievo {
namespace {

using namespace patch_build;

constexpr int kBaseZstdLevel = 19;  // a few hundred KiB at most for a scan of some thousand patches

double meanSideMm(const BaseMesh& base) {
  double sum = 0;
  for (const auto& p : base.patches)
    for (const auto& side : kSideCorners)
      sum += glm::length(glm::dvec3(base.corners[p[static_cast<size_t>(side[0])]].position_mm) -
                         glm::dvec3(base.corners[p[static_cast<size_t>(side[1])]].position_mm));
  return sum / (4.0 * static_cast<double>(base.patches.size()));
}

Result<PatchDomain> planDomain(const PatchSource& source) {
  if (std::string problem = baseMeshProblem(source.base()); !problem.empty()) return usage("the base mesh: " + problem);
  if (source.base().corners.size() > 4 * source.base().patches.size())
    return usage("the base mesh: there are more corners than its patches can name");
  PatchMeasures d;
  d.texture_depth = source.textureDepth();
  d.relief_depth = source.reliefDepth();
  const int deepest = static_cast<int>(kMaxNodeLevel);
  if (d.texture_depth < 0 || d.texture_depth > deepest || d.relief_depth < 0)
    return usage("the patches' depth is out of range");
  d.mm_per_px = std::max(meanSideMm(source.base()) / static_cast<double>(d.patchPx()), 1e-12);
  d.relief_offset_mm = source.reliefOffsetMm();
  d.relief_scale_mm = source.reliefScaleMm();
  const auto domain = PatchDomain::overMesh(static_cast<uint32_t>(source.base().patches.size()), d);
  if (std::string problem = domainProblem(domain); !problem.empty()) return usage("cannot build this: " + problem);
  if (!std::isfinite(source.errorUnitMm()) || source.errorUnitMm() < 0)
    return usage("the unit of errors is not a number of mm");
  return domain;
}

Result<std::string> manifestOf(const PackageHeader& h, const PatchSource& source, const BuildOptions& options) {
  nlohmann::ordered_json json = manifestJson(h, options.tool_version);
  const BaseMesh& base = source.base();
  json["base"] = {{"corners", base.corners.size()},
                  {"patches", base.patches.size()},
                  {"origin_mm", {base.origin_mm.x, base.origin_mm.y, base.origin_mm.z}},
                  {"error_unit_mm", source.errorUnitMm()}};
  if (base.cut) json["base"]["cut"] = true;
  auto extra =
      nlohmann::ordered_json::parse(options.manifest_extra.empty() ? "{}" : options.manifest_extra, nullptr, false);
  if (extra.is_object()) json.update(extra);
  const char* role = "mesh";
  for (const Provenance& p : source.provenance()) {
    if (auto added = addSource(json, p, role); !added) return added.error();
    role = "texture";
  }
  return manifestText(json);
}

// The tails of patches first .. first + count, as a chunk's bytes.
Result<std::vector<uint8_t>> tailsChunk(const Context& c, const BuildOptions& options, uint32_t first, uint32_t count) {
  PatchTails tails(count, c.store.channels);
  std::vector<uint8_t> bytes(count * c.tailBytes()), neutral(tails.patchTexels());
  neutralTail(c.header.texture, neutral);
  bool kept = !c.even_patches;  // anything of these patches
  for (uint32_t patch = first; patch < first + count; ++patch) kept = kept || !c.tailIsMade(patch);
  if (kept)
    if (auto read = c.tails->read(first * c.tailBytes(), bytes.data(), bytes.size()); !read) return read.error();
  for (uint32_t i = 0; i < count; ++i) {
    const uint8_t* of_patch = bytes.data() + i * c.tailBytes();
    if (c.even_patches) std::copy(c.even_tail.begin(), c.even_tail.end(), tails.heightsOf(i).begin());
    else std::memcpy(tails.heightsOf(i).data(), of_patch, 2 * kTailHeights);
    if (c.tailIsMade(first + i)) std::copy(neutral.begin(), neutral.end(), tails.texelsOf(i).begin());
    else std::copy_n(of_patch + 2 * kTailHeights, tails.patchTexels(), tails.texelsOf(i).begin());
  }
  const auto corners = std::span(c.source.base().patches).subspan(first, count);
  return encodeTailsChunk(tails, 0, count, tailsStorage(c.header), corners, options.zstd_level);
}

Result<void> writeTails(const Context& c, const BuildOptions& options, int workers, PackageWriter& writer) {
  const auto patches = static_cast<uint32_t>(c.source.base().patches.size());
  const size_t chunks = tailsChunks(patches), at_once = size_t{2} * static_cast<size_t>(std::max(workers, 1));
  for (size_t begin = 0; begin < chunks; begin += at_once) {
    std::vector<Result<std::vector<uint8_t>>> made(std::min(at_once, chunks - begin), std::vector<uint8_t>());
    const bool whole = parallelFor(made.size(), workers, options.interrupted, [&](size_t i) {
      const auto first = static_cast<uint32_t>((begin + i) * kTailsChunkPatches);
      made[i] = tailsChunk(c, options, first, std::min(kTailsChunkPatches, patches - first));
    });
    if (!whole) return Error{ErrorKind::kInterrupted, options.output, "interrupted", "nothing was written", {}};
    for (const auto& chunk : made) {
      if (!chunk) return chunk.error();
      if (auto written = writer.appendTails(*chunk); !written) return written;
    }
  }
  return {};
}

// Samples on shared sides and corners are the same from all sides, or the surface has a crack.
Result<void> checkBorders(const Context& c) {
  if (c.even_patches) return {};
  const BaseMesh& base = c.source.base();
  auto differ = [](uint32_t a, uint32_t b, const std::string& where) {
    return Error{ErrorKind::kInvalidData,
                 "",
                 "the heights of patches " + std::to_string(a) + " and " + std::to_string(b) + " differ " + where,
                 "",
                 {}};
  };
  std::vector<uint32_t> first(base.corners.size(), PatchNeighbour::kNone);
  std::vector<uint16_t> height(base.corners.size());
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    for (size_t s = 0; s < 4; ++s) {
      const PatchNeighbour& n = c.neighbours[p][s];
      if (n.patch != PatchNeighbour::kNone && c.side_hash[p][s] != c.side_hash[n.patch][n.side])
        return differ(p, n.patch, "along the side that they share");
    }
    for (size_t k = 0; k < 4; ++k) {
      const uint32_t corner = base.patches[p][k];
      if (first[corner] == PatchNeighbour::kNone) first[corner] = p, height[corner] = c.corner_height[p][k];
      if (height[corner] != c.corner_height[p][k])
        return differ(first[corner], p, "at corner " + std::to_string(corner));
    }
  }
  return {};
}

void makeRoom(Context& context, const BuildOptions& options) {
  const PatchDomain& d = context.header.domain;
  const uint32_t patches = d.patchCount();
  context.even_patches = context.source.patchesAreEven();
  const size_t described = context.even_patches ? 1 : patches;
  context.coarse_errors.resize(described);
  context.slopes.resize(described);
  context.coarse_blocks.resize(described);
  context.coarse_shapes.resize(described);
  context.side_hash.resize(described);
  context.corner_height.resize(described);
  context.corner_texels.resize(context.cornerPlace(patches, kTail, 0));
  context.even.resize(context.levelPlace(patches, kTail));
  context.texture_depths.resize(patches);
  // Where no level may be left out, all patches have all.
  const bool own = context.header.compact && options.texture_tolerance >= 0;
  for (uint32_t p = 0; p < patches; ++p)
    context.own_depth.push_back(static_cast<int8_t>(own ? context.source.textureDepthOf(p) : d.texture_depth));
}

// Those of the source, and what patches show of them.
Result<void> takeImages(Context& context, PackageHeader& h, const BuildOptions& options) {
  if (!context.source.showsImages()) return {};
  const std::vector<SourceImage> images = context.source.images();
  context.image_of_patch.reserve(h.domain.patchCount());
  if (!h.base_by_border || !h.cut_patches || options.texture_tolerance < 0 || !hasNormals(h.texture))
    return usage("patches that show images need a package of version 13");
  uint64_t texels = 0;
  for (const SourceImage& image : images) {
    h.richer_images |= image.is_normals;
    texels += static_cast<uint64_t>(image.width) * static_cast<uint64_t>(image.height);
  }
  h.richer_images |= texels > kMostTexelsBefore19;
  if (texels > kMostShownTexels)
    return usage("images that patches show have at most " + std::to_string(kMostShownTexels >> 20) + " Mi texels");
  if (h.richer_images && !h.base_parity)
    return usage("images with maps of normals, or of more than " + std::to_string(kMostTexelsBefore19 >> 20) +
                 " Mi texels, need a package of version 19");
  for (uint32_t p = 0; p < h.domain.patchCount(); ++p) {
    PatchImage& patch = context.image_of_patch.emplace_back(context.source.imageOf(p));
    if ((patch.in_tail && !h.image_tails) || (patch.hasColours() && !h.base_parity)) patch = {};
    if (!patch.shows()) continue;
    h.corner_colours |= patch.hasColours();
    assert(context.own_depth[p] == kTail && patch.depth <= std::min(kMostShownDepth, h.domain.texture_depth) &&
           (!patch.in_tail || patch.depth == kNoTexturePage) &&
           std::all_of(patch.image.begin(), patch.image.end(), [&](uint16_t image) {
             return image == kCornerColours || (image < images.size() && !images[image].is_normals);
           }));
  }
  for (size_t i = 0; i < images.size(); ++i) {
    const SourceImage& image = images[i];
    const size_t number = image.is_normals ? i - 1 : i;
    const glm::ivec2 places = placeSize(images, number);
    std::vector<uint8_t> rgb = ShownImage::withRoom(image.rgb);
    if (image.fill) fillImage(image, number, places, context.image_of_patch, rgb);
    context.shown_images.emplace_back(image, places, std::move(rgb));
  }
  context.frames = framesOfHalves(normalsOfImages(images), context.image_of_patch, context.source.base());
  return {};
}

// The images' tiles and the directory of them, for the writer. Without patches that show images empty.
struct EncodedImages {
  std::vector<std::vector<uint8_t>> tiles;
  std::vector<uint8_t> directory;
  bool jpegs = false;
};
struct TilePlace {
  size_t image;
  uint32_t number, column, row;
};
// Once an image's tiles take more than the JPEG that it came as, no more of them are needed; nor, of one with many,
// where a few that lie all over it say so clearly.
class TilesOrJpegs {
 public:
  TilesOrJpegs(std::span<const SourceImage> images, std::span<const StoredImage> stored)
      : images_(images), stored_(stored), taken_(images.size()), clearly_(images.size()) {}
  bool isSample(const TilePlace& place) const {
    return !images_[place.image].jpeg.empty() && stored_[place.image].tileCount() >= kMany &&
           place.number % kEvery == 0;
  }
  void add(const TilePlace& place, size_t bytes) { taken_[place.image] += bytes; }
  void chooseBySamples() {
    for (size_t i = 0; i < images_.size(); ++i)
      clearly_[i] = isSample({i, 0, 0, 0}) && kEvery * taken_[i] > kClearly * images_[i].jpeg.size();
  }
  bool isJpeg(size_t image) const {
    const size_t bytes = images_[image].jpeg.size();
    return bytes > 0 && (clearly_[image] || bytes < taken_[image]);
  }

 private:
  static constexpr uint64_t kMany = 512, kEvery = 17;  // no divisor of a row's tiles, as a rule
  static constexpr uint64_t kClearly = 2;              // times as many bytes
  std::span<const SourceImage> images_;
  std::span<const StoredImage> stored_;
  std::vector<std::atomic<uint64_t>> taken_;
  std::vector<uint8_t> clearly_;
};
Result<EncodedImages> encodeImages(const Context& context, const BuildOptions& options, int workers) {
  if (context.image_of_patch.empty()) return EncodedImages{};
  std::vector<SourceImage> images = context.source.images();
  for (size_t i = 0; i < images.size(); ++i) images[i].rgb = context.shown_images[i].texels();  // filled
  const auto tolerances = channelTolerances(context.header.texture, options.texture_tolerance);
  std::vector<StoredImage> stored;
  std::vector<TilePlace> places;
  for (const SourceImage& image : images) {
    StoredImage& s = stored.emplace_back();
    s.width = static_cast<uint32_t>(image.width), s.height = static_cast<uint32_t>(image.height);
    s.repeats = image.repeats;
    s.is_normals = image.is_normals;
    s.normals_downwards = image.normals_downwards;
    for (uint32_t i = 0; i < s.tileCount(); ++i)
      places.push_back({stored.size() - 1, i, i % s.columns(), i / s.columns()});
  }
  struct Worker {
    explicit Worker(int zstd_level) : encoder(zstd_level) {}
    PageEncoder encoder;
    std::vector<uint8_t> channels = std::vector<uint8_t>(kTexturePageBytes);
  };
  std::vector<std::vector<uint8_t>> tiles(places.size());
  TilesOrJpegs choice(images, stored);
  auto encode = [&](bool of_samples) {
    return parallelForWith(
        places.size(), workers, options.interrupted, [&] { return std::make_unique<Worker>(options.zstd_level); },
        [&](std::unique_ptr<Worker>& worker, size_t i) {
          const TilePlace& place = places[i];
          if (choice.isSample(place) != of_samples || choice.isJpeg(place.image)) return;
          cutTile(images[place.image], place.column, place.row, worker->channels);
          const size_t plane = images[place.image].is_normals ? 1 : 0;
          const PageEncoding encoding = context.header.encodings[plane];
          const auto bytes = encoding.codec == PageCodec::kLossless
                                 ? worker->encoder.encodeTextureWithin(
                                       worker->channels, std::span(tolerances).subspan(3 * plane, 3), true)
                                 : worker->encoder.encodeTexture(worker->channels, encoding);
          tiles[i].assign(bytes.begin(), bytes.end());
          choice.add(place, bytes.size());
        });
  };
  const bool samples = std::any_of(places.begin(), places.end(), [&](const auto& p) { return choice.isSample(p); });
  bool whole = !samples || encode(true);
  choice.chooseBySamples();
  whole = whole && encode(false);
  if (!whole) return Error{ErrorKind::kInterrupted, options.output, "interrupted", "nothing was written", {}};
  // Of an image that came as a JPEG this takes fewer bytes, as a rule: not where hardly any of an atlas is shown.
  std::vector<std::vector<uint8_t>> kept;
  for (size_t image = 0, begin = 0; image < images.size(); ++image) {
    StoredImage& s = stored[image];
    const size_t end = begin + s.tileCount();
    const std::span<const uint8_t> jpeg = images[image].jpeg;
    s.is_jpeg = choice.isJpeg(image);
    s.fill = s.is_jpeg && images[image].fill;
    if (s.is_jpeg) kept.emplace_back(jpeg.begin(), jpeg.end());
    else
      for (size_t i = begin; i < end; ++i) kept.push_back(std::move(tiles[i]));
    for (size_t i = kept.size() - s.tileCount(); i < kept.size(); ++i)
      s.tiles.push_back({static_cast<uint32_t>(kept[i].size()), encodedHash(kept[i])});
    begin = end;
  }
  const bool jpegs = std::any_of(stored.begin(), stored.end(), [](const StoredImage& s) { return s.is_jpeg; });
  auto directory = encodePatchImages(stored, context.image_of_patch, context.source.base(), context.header.base_parity);
  return EncodedImages{std::move(kept), std::move(directory), jpegs};
}

// A worker's share: texels and a coarser level twice, or a level with and without border; heights, errors, and its
// finished parts.
uint64_t workerBytes(const Context& context) {
  const PatchStore& store = context.store;
  const uint64_t cells = uint64_t{kPagePx} << context.header.domain.relief_depth;
  const uint64_t part_bytes = store.levelBytes() + cells * cells * 3 * reliefPatchesAPart(context.header);
  return store.levelBytes() * 2 + cells * cells * 3 + part_bytes * (1 + kPartsAhead);
}

Result<PackageHeader> planHeader(const PatchSource& source, const BuildOptions& options) {
  auto planned = planDomain(source);
  if (!planned) return planned.error();
  PackageHeader header;
  header.domain = *planned;
  header.texture = source.format();
  header.encodings = planeEncodings(header.texture, options.coefficients, options.colour);
  header.relief_detail = header.relief_shapes = true;
  header.compact = options.compact;
  header.coded_tails = options.compact && options.coded_tails;
  header.coded_base = header.coded_tails && options.coded_base;
  header.coded_texels = header.coded_base && options.coded_texels;
  header.light_patches = header.coded_texels && options.coded_index && options.light_patches;
  header.cut_patches = source.base().cut;
  if (header.cut_patches && (!header.coded_texels || header.light_patches != options.coded_index))
    return usage("patches that are cut need a package of version 11");
  header.base_by_border = header.coded_texels && header.light_patches == options.coded_index && options.base_by_border;
  header.tail_edges = header.base_by_border && header.cut_patches && options.tail_edges && hasNormals(header.texture);
  header.page_count = packageLayout(header.domain, header.texture, 0, 0).page_count;
  header.base_bytes = baseSectionBytes(source.base().corners.size(), header.domain.patchCount());
  return header;
}

// What waits for its neighbours.
Result<void> makeSpills(Context& context, SpillBudget& spills) {
  const uint32_t patches = context.header.domain.patchCount();
  uint64_t levels = 0, strips = 0;
  for (uint32_t p = 0; p < patches; ++p) {
    context.levels_at.push_back(levels);
    context.strips_at.push_back(strips);
    levels += context.storeOf(p).levelBytes();
    strips += context.storeOf(p).guttersBytes();
  }
  for (auto [kept, bytes] :
       {std::pair<std::unique_ptr<SpillStore>*, uint64_t>{&context.tails, context.tailBytes() * patches},
        {&context.strips, strips},
        {&context.levels, levels}}) {
    auto made = spills.create(bytes);
    if (!made) return made.error();
    *kept = std::move(*made);
  }
  return {};
}

// Where levels may be left out, of the patches' own texels; those of images are nowhere.
int mostStoredDepth(const PatchSource& source, const PackageHeader& header, const BuildOptions& options) {
  if (!header.compact || options.texture_tolerance < 0) return header.domain.texture_depth;
  int depth = 0;
  for (uint32_t p = 0; p < header.domain.patchCount(); ++p) depth = std::max(depth, source.textureDepthOf(p));
  return depth;
}

// The base mesh's section as the package has it.
std::vector<uint8_t> storedBase(Context& context, const PatchSource& source) {
  const PackageHeader& header = context.header;
  BaseSection section{source.base(),
                      std::move(context.coarse_errors),
                      std::move(context.coarse_blocks),
                      std::move(context.slopes),
                      std::move(context.coarse_shapes),
                      source.errorUnitMm(),
                      std::move(context.texture_depths)};
  if (header.coded_base)
    return encodeBaseCode(std::move(section), source.baseStepMm(), header.baseCodeKind(), header.cut_patches);
  const std::vector<uint8_t> bytes = encodeBaseSection(section);
  return header.compact ? packBaseSection(bytes, kBaseZstdLevel) : bytes;
}

// Each of these patches once, by workers of this kind, so many of them a part.
template <class PatchWorker>
Result<void> passOver(Context& context, const BuildOptions& options, int workers, PackageWriter& writer,
                      BuildReporter& reporter, std::span<const uint32_t> patches, size_t a_part) {
  using Patches = std::span<const uint32_t>;
  Patches left = patches;
  OrderedWorkers<Patches> runner(
      workers, kPartsAhead, options.interrupted,
      [&](Patches* part) {
        if (left.empty()) return false;
        *part = left.first(std::min(left.size(), a_part));
        left = left.subspan(part->size());
        return true;
      },
      [&] {
        auto worker = std::make_shared<PatchWorker>(context, options);
        return [worker](const Patches& of_part) {
          BuildPart out;
          for (size_t i = 0; i < of_part.size() && out.status.ok(); ++i) out.status = worker->run(of_part[i], out);
          return out;
        };
      });
  return writeParts(runner, (patches.size() + a_part - 1) / a_part, writer, options,
                    [&](const BuildPart* part) { reporter.report(part); });
}

// Relief pages, of all patches, then texture pages, of those that have any.
Result<void> writePages(Context& context, const BuildOptions& options, int workers, PackageWriter& writer,
                        BuildReporter& reporter) {
  std::vector<uint32_t> all, textured;
  for (uint32_t p = 0; p < context.header.domain.patchCount(); ++p) {
    all.push_back(p);
    if (context.header.domain.textureDepthOf(p) >= 0) textured.push_back(p);
  }
  if (auto ran =
          passOver<ReliefWriter>(context, options, workers, writer, reporter, all, reliefPatchesAPart(context.header));
      !ran)
    return ran;
  return passOver<TextureWriter>(context, options, workers, writer, reporter, textured, 1);
}

}  // namespace

Result<BuildReport> buildPatchPackage(const PatchSource& source, const BuildOptions& options) {
  BuildReporter reporter(options);
  auto planned = planHeader(source, options);
  if (!planned) return planned.error();
  PackageHeader& header = *planned;
  const PatchDomain& d = header.domain;
  const uint32_t patches = d.patchCount();
  reporter.expect(header.page_count, patches * d.patchPx() * d.patchPx());

  Context context{source,
                  header,
                  {},
                  MipFilter(header.texture),
                  {header.texture.channels(), mostStoredDepth(source, header, options)},
                  patchNeighbours(source.base())};
  makeRoom(context, options);
  header.image_tails = options.image_tails && source.showsImages();
  header.base_parity = header.image_tails && options.base_parity;
  if (auto taken = takeImages(context, header, options); !taken) return taken.error();
  listCorners(context);
  const Workforce force = workersThatFit(workerBytes(context), options, patches);
  auto described = forEachPatch(
      context, options, force.workers, [&] { return PatchRelief(context); },
      [](PatchRelief& relief, uint32_t patch) { return relief.describe(patch); }, [](size_t) {});
  if (!described) return described.error();
  if (auto sound = checkBorders(context); !sound) return sound.error();
  // Before the longest part, not behind it.
  if (auto writable = OutputFile::check(options.output); !writable) return writable.error();
  SpillBudget spills{std::min(force.left_bytes, options.kept_bytes), options.output};
  if (auto made = makeSpills(context, spills); !made) return made.error();
  const uint64_t patch_texels = d.patchPx() * d.patchPx();
  auto kept = forEachPatch(
      context, options, force.workers, [&] { return TexelKeeper(context); },
      [](TexelKeeper& keeper, uint32_t patch) { return keeper.run(patch); },
      [&](size_t done) { reporter.reportTexels(done * patch_texels); });
  if (!kept) return kept.error();
  if (auto found = findTextureDepths(context, header, options, force.workers); !found) return found.error();
  const uint64_t without_bytes = source.patchesAreEven() ? patches : 0;  // relief that tails show
  header.coded_index =
      header.coded_texels && options.coded_index && header.page_count - without_bytes <= options.most_coded_pages;
  header.light_patches = header.light_patches && header.coded_index;
  reporter.expect(header.page_count, patches * patch_texels);
  // Beside the base mesh, the pages and the tails, which need one thread for long.
  BackgroundTask<Result<EncodedImages>> images(
      "relievo-images", [&] { return encodeImages(context, options, force.workers); },
      force.workers > 1 && !context.image_of_patch.empty());

  std::vector<uint8_t> base = storedBase(context, source);
  const auto manifest = manifestOf(header, source, options);
  if (!manifest) return manifest.error();
  if (auto placed = placeSections(header, *manifest, base); !placed) return placed.error();
  context.layout = packageLayout(header);
  auto writer = PackageWriter::create(options.output, header, *manifest, std::move(base), spills);
  if (!writer) return writer.error();

  if (auto done = writePages(context, options, force.workers, **writer, reporter); !done) return done.error();
  if (auto written = writeTails(context, options, force.workers, **writer); !written) return written.error();
  Result<EncodedImages>& encoded = images.get();
  if (!encoded) return encoded.error();
  (*writer)->setImages(std::move(encoded->tiles), std::move(encoded->directory), encoded->jpegs);
  auto file_bytes = (*writer)->finish(options.interrupted);
  if (!file_bytes) return file_bytes.error();
  reporter.reportEnd();
  return BuildReport{header.page_count, *file_bytes, reporter.seconds()};
}

}  // namespace relievo
