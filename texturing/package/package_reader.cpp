#include <xxhash.h>

#include <algorithm>
#include <atomic>
#include <cassert>
#include <cmath>
#include <deque>
#include <mutex>
#include <nlohmann/json.hpp>
#include <unordered_map>

#include "src/base/file.h"
#include "src/base/json_parse.h"
#include "src/base/parallel_for.h"
#include "texturing/codec/image_jpeg.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/tail_code.h"
#include "texturing/package/base_code.h"
#include "texturing/package/index_code.h"
#include "texturing/package/package.h"
#include "texturing/package/package_base.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_tails.h"
#include "texturing/package/patch_images.h"

namespace relievo {
namespace {

constexpr uint64_t kIndexCacheBytes = uint64_t{32} << 20;
using IndexBytes = std::shared_ptr<const std::vector<uint8_t>>;
// A block of the index, from its first byte on.
struct Block {
  IndexBytes bytes;
  const uint8_t* at = nullptr;
};

}  // namespace

struct Package::Impl {
  InputFile file;
  PackageHeader header;
  PackageLayout layout;
  Manifest manifest;
  std::string manifest_json;
  std::optional<Error> manifest_problem;
  std::vector<std::string> warnings;

  // Of a coded index: its chunks, or why there are none; and where its errors by block begin, in the file.
  std::vector<IndexChunk> index_chunks;
  std::optional<Error> index_problem;
  uint64_t detail_offset = 0;

  // Of images that patches show: what the directory says, or why it is not known; and the images that were read.
  PatchImages images;
  std::vector<TangentFrame> frames;  // framesOfHalves()
  std::optional<Error> images_problem;
  struct ReadImage {
    std::mutex mutex;
    std::shared_ptr<const ShownImage> image;
  };
  mutable std::unique_ptr<ReadImage[]> read_images;

  // Parts of the index by their offset, dropped in the order of their arrival beyond kIndexCacheBytes.
  mutable std::mutex mutex;
  mutable std::unordered_map<uint64_t, IndexBytes> parts;
  mutable std::deque<uint64_t> arrivals;
  mutable uint64_t cached_bytes = 0;
  mutable PageFailures read_failures;

  explicit Impl(InputFile f) : file(std::move(f)) {}

  // The part that begins there, by whoever reads it: a Result<std::vector<uint8_t>>.
  template <class Read>
  Result<IndexBytes> part(uint64_t offset, Read&& read) const {
    {
      std::lock_guard lock(mutex);
      if (auto found = parts.find(offset); found != parts.end()) return found->second;
    }
    Result<std::vector<uint8_t>> made = read();
    if (!made) return made.error();
    auto bytes = std::make_shared<const std::vector<uint8_t>>(std::move(*made));
    std::lock_guard lock(mutex);
    if (parts.emplace(offset, bytes).second) {
      arrivals.push_back(offset);
      cached_bytes += bytes->size();
      while (cached_bytes > kIndexCacheBytes) {
        auto oldest = parts.find(arrivals.front());
        cached_bytes -= oldest->second->size();
        parts.erase(oldest);
        arrivals.pop_front();
      }
    }
    return bytes;
  }

  Error damagedIndex(const char* what, uint64_t offset) const {
    return {ErrorKind::kInvalidData, file.path(), what, "rebuild the package, or get a whole copy", offset};
  }

  Result<Block> block(const IndexLayout::Place& place) const {
    if (header.coded_index) {
      const uint64_t first = place.block_offset - header.index_offset;
      if (first < entriesBytes()) return codedBlock(first);
    }
    const uint64_t offset = header.coded_index
                                ? detail_offset + (place.block_offset - header.index_offset - entriesBytes())
                                : place.block_offset;
    auto found = part(offset, [&]() -> Result<std::vector<uint8_t>> {
      std::vector<uint8_t> bytes(place.block_bytes);
      if (auto read = file.read(offset, bytes); !read) return read.error();
      const size_t entries = bytes.size() - 8;
      if (loadLittle<uint64_t>(bytes.data() + entries) != XXH3_64bits(bytes.data(), entries))
        return damagedIndex("an index block is damaged: its checksum does not match", offset);
      return bytes;
    });
    if (!found) return found.error();
    return Block{*found, (*found)->data()};
  }

  // What pages' entries take in the index that a coded one stands for.
  uint64_t entriesBytes() const { return layout.texture.bytes() + layout.relief.bytes(); }

  // first: where the block's entries begin in that index.
  Result<Block> codedBlock(uint64_t first) const {
    if (index_problem) return *index_problem;
    auto chunk = std::upper_bound(index_chunks.begin(), index_chunks.end(), first,
                                  [](uint64_t at, const IndexChunk& c) { return at < c.first; });
    --chunk;  // the first one begins at 0
    const uint64_t end = chunk + 1 == index_chunks.end() ? entriesBytes() : chunk[1].first;
    // Keyed by a place that no plain block has: within the code.
    auto found = part(header.index_offset + chunk->offset, [&] { return readChunk(*chunk, end - chunk->first); });
    if (!found) return found.error();
    return Block{*found, (*found)->data() + (first - chunk->first)};
  }
  Result<std::vector<uint8_t>> readChunk(const IndexChunk& chunk, uint64_t bytes) const {
    const uint64_t offset = header.index_offset + chunk.offset;
    std::vector<uint8_t> code(chunk.size);
    if (auto read = file.read(offset, code); !read) return read.error();
    if (XXH3_64bits(code.data(), code.size()) != chunk.hash)
      return damagedIndex("a part of the index is damaged: its checksum does not match", offset);
    const bool relief = chunk.first >= layout.texture.bytes();
    const uint64_t begin = header.index_offset + chunk.first, end = begin + bytes;
    std::vector<IndexLayout::Block> blocks;
    (relief ? layout.relief : layout.texture).forEachBlockFrom(begin, [&](const IndexLayout::Block& b) {
      if (b.offset >= end) return false;
      blocks.push_back(b);
      return true;
    });
    std::vector<uint8_t> out;
    // Before the allocation: so many entries take no fewer bytes, but for a chunk's of empty pages.
    const uint64_t of_empty = header.light_patches ? 2 * kIndexChunkEntries : 0;
    if (bytes / kReliefEntryBytes <= std::max<uint64_t>(code.size(), of_empty)) out.resize(bytes);
    if (out.empty() || !decodeIndexBlocks(code, {header.texture.planes(), header.pages_offset, header.light_patches},
                                          relief, blocks, out))
      return damagedIndex("a part of the index is damaged: it is no code of its entries", offset);
    return out;
  }
  // Whoever opens a package whose index is damaged sees what needs none of it.
  void readIndexDirectory() {
    const uint64_t detail = layout.relief_detail.bytes();
    auto read = [&]() -> Result<void> {
      const Error damaged = damagedIndex("the index is damaged: its directory does not fit it", header.index_offset);
      if (header.index_bytes < detail || header.index_bytes - detail < kIndexHeadBytes) return damaged;
      const uint64_t section = header.index_bytes - detail;
      std::vector<uint8_t> bytes(kIndexHeadBytes);
      if (auto got = file.read(header.index_offset, bytes); !got) return got;
      bytes.resize(indexDirectoryBytes(bytes, section));
      if (auto got = file.read(header.index_offset, bytes); !got) return got;
      auto chunks = decodeIndexDirectory(bytes, section, entriesBytes());
      if (!chunks) return damaged;
      index_chunks = std::move(*chunks);
      return {};
    };
    detail_offset = header.index_offset + header.index_bytes - std::min(header.index_bytes, detail);
    if (auto done = read(); !done) index_problem = done.error();
  }

  Result<EncodedPage> readPage(const Package& package, PageId id) const;

  Error damagedImages(const std::string& what, uint64_t offset) const {
    return {ErrorKind::kInvalidData, file.path(), what, "rebuild the package, or get a whole copy", offset};
  }
  // Whoever opens a package whose images are damaged sees the tails of patches that show them; from version 16 on these
  // are neutral.
  void readImagesDirectory() {
    auto read = [&]() -> Result<PatchImages> {
      const uint64_t offset = header.images_offset, size = header.images_bytes;
      // Checked before the allocation: the file may be truncated.
      if (offset > file.size() || size > file.size() - offset)
        return damagedImages("the images that patches show lie beyond the end of the file", offset);
      std::vector<uint8_t> bytes(size);
      if (auto got = file.read(offset, bytes); !got) return got.error();
      if (XXH3_64bits(bytes.data(), bytes.size()) != header.images_hash)
        return damagedImages("the images that patches show are damaged: their directory's checksum does not match",
                             offset);
      auto decoded = decodePatchImages(bytes, *manifest.base, offset - header.tilesOffset(),
                                       {.jpegs = header.image_jpegs,
                                        .in_tails = header.image_tails,
                                        .by_base = header.base_parity,
                                        .colours = header.corner_colours,
                                        .richer = header.richer_images});
      if (!decoded) return damagedImages(decoded.error().message, offset);
      for (const PatchImage& patch : decoded->of_patch)
        if (patch.depth > header.domain.texture_depth)
          return damagedImages(
              "the images that patches show are damaged: a patch has more texture levels than there are", offset);
      return decoded;
    };
    auto decoded = read();
    if (decoded) images = std::move(*decoded);
    else images_problem = decoded.error();
    frames = framesOfHalves(normalsOfImages(images.images), images.of_patch, *manifest.base);
    read_images = std::make_unique<ReadImage[]>(images.images.size());
  }
  bool showsPages(uint32_t patch) const {
    return patch < images.of_patch.size() && images.of_patch[patch].depth != kNoTexturePage;
  }
  // Reads the image, tile by tile: into rgb, all of it, or where that is empty to see whether it is sound.
  // Until *stop is set or a tile is damaged.
  Result<void> readImage(size_t number, PageDecoder& decoder, const std::atomic<bool>* stop,
                         std::span<uint8_t> rgb) const {
    const StoredImage& image = images.images[number];
    uint64_t offset = header.tilesOffset();
    for (size_t i = 0; i < number; ++i)
      for (const ImageTile& tile : images.images[i].tiles) offset += tile.size;
    std::vector<uint8_t> bytes, channels(kTexturePageBytes);
    for (size_t i = 0; i < image.tiles.size() && !(stop && stop->load()); ++i) {
      const ImageTile& tile = image.tiles[i];
      const std::string what = "tile " + std::to_string(i) + " of image " + std::to_string(number);
      bytes.resize(tile.size);
      if (auto read = file.read(offset, bytes); !read) return read;
      if (XXH3_64bits(bytes.data(), bytes.size()) != tile.hash)
        return damagedImages(what + ": its checksum does not match", offset);
      auto decoded = image.is_jpeg ? readJpeg(image, bytes, stop, rgb) : decoder.decodeTexture(bytes, channels);
      if (!decoded) return damagedImages(what + ": " + decoded.error().message, offset);
      if (!image.is_jpeg && !rgb.empty())
        pasteTile(image, static_cast<uint32_t>(i % image.columns()), static_cast<uint32_t>(i / image.columns()),
                  channels, rgb);
      offset += tile.size;
    }
    return {};
  }
  static Result<void> readJpeg(const StoredImage& image, std::span<const uint8_t> bytes, const std::atomic<bool>* stop,
                               std::span<uint8_t> rgb) {
    auto jpeg = ImageJpegReader::open(bytes, image.width, image.height);
    if (!jpeg) return jpeg.error();
    const size_t row_bytes = size_t{3} * image.width;
    std::vector<uint8_t> row(rgb.empty() ? row_bytes : 0);
    for (uint32_t y = 0; y < image.height && !(stop && stop->load()); ++y)
      if (auto read = jpeg->read(1, rgb.empty() ? std::span(row) : rgb.subspan(y * row_bytes, row_bytes)); !read)
        return read;
    return {};
  }
  Result<std::shared_ptr<const ShownImage>> shownImage(size_t number) const {
    ReadImage& read = read_images[number];
    std::lock_guard lock(read.mutex);
    if (read.image) return read.image;
    const StoredImage& stored = images.images[number];
    const size_t texel_bytes = size_t{3} * stored.width * stored.height;
    std::vector<uint8_t> rgb;
    rgb.reserve(texel_bytes + 1);  // as ShownImage::withRoom()
    rgb.resize(texel_bytes);
    PageDecoder decoder;
    if (auto done = readImage(number, decoder, nullptr, rgb); !done) return done.error();
    const SourceImage image{.width = static_cast<int>(stored.width),
                            .height = static_cast<int>(stored.height),
                            .repeats = stored.repeats,
                            .is_normals = stored.is_normals};
    const size_t named = stored.is_normals ? number - 1 : number;
    const glm::ivec2 places = placeSize(images.images, named);
    if (stored.fill) fillImage(image, named, places, images.of_patch, rgb);
    read.image = std::make_shared<const ShownImage>(image, places, std::move(rgb));
    return read.image;
  }
  // A map that cannot be read is said to be damaged where images are read; without it the surface is smooth.
  NormalsOfHalves normalsOf(uint32_t patch) const {
    NormalsOfHalves normals;
    for (size_t half = 0; half < 2 && !frames.empty(); ++half) {
      const TangentFrame& frame = frames[2 * patch + half];
      if (!frame.isKnown()) continue;
      if (const auto map = shownImage(images.of_patch[patch].image[half] + size_t{1}))
        normals[half] = {map->get(), frame};  // it stays while the package is open
    }
    return normals;
  }
  // Of halves with colours none.
  Result<std::array<std::shared_ptr<const ShownImage>, 2>> imagesOf(const PatchImage& patch) const {
    std::array<std::shared_ptr<const ShownImage>, 2> shown;
    for (size_t half = 0; half < 2; ++half) {
      if (patch.hasColours(half)) continue;
      auto image = shownImage(patch.image[half]);
      if (!image) return image.error();
      shown[half] = std::move(*image);
    }
    return shown;
  }
  // Images that tails are made of, by number: why one cannot be had. Read before the tails are.
  using LostImages = std::vector<std::optional<Error>>;
  LostImages readImagesOfTails(int workers, std::vector<std::string>* problems, const std::atomic<bool>* stop) const {
    LostImages lost(header.image_tails ? images.images.size() : 0);
    parallelFor(lost.size(), std::max(workers, 1), stop, [&](size_t i) {
      if (auto image = shownImage(i); !image) lost[i] = image.error();
    });
    if (problems)
      for (const auto& error : lost)
        if (error) problems->push_back(error->text() + " (neutral texels stand in)");
    return lost;
  }
  // Nothing that is stored of these tails matters: they show images, and heights are all the same.
  bool isMadeOfImages(uint32_t first, uint32_t count) const {
    const auto& patches = images.of_patch;
    return header.image_tails && header.domain.relief_scale_mm == 0 && first + count <= patches.size() &&
           std::all_of(patches.begin() + first, patches.begin() + first + count,
                       [](const PatchImage& patch) { return patch.shows(); });
  }
  // Makes those of the tails of patches from `first` on that are made of images; where these are lost they become
  // neutral.
  void showTails(uint32_t first, const MipFilter& mip, const LostImages& lost, PatchTails& tails) const {
    if (!header.image_tails) return;
    for (uint32_t i = 0; i < tails.patches && first + i < images.of_patch.size(); ++i) {
      const PatchImage& patch = images.of_patch[first + i];
      if (!patch.shows()) continue;
      const auto lost_half = std::find_if(patch.image.begin(), patch.image.end(),
                                          [&](uint16_t image) { return image < lost.size() && lost[image]; });
      if (lost_half != patch.image.end()) {
        neutralTail(header.texture, tails.texelsOf(i));
        tails.failures.add(PageId(texturePlane(0), {first + i, 0, 0, 0}), *lost[*lost_half]);
      } else if (auto shown = imagesOf(patch)) {
        tailOfImages(patch, {(*shown)[0].get(), (*shown)[1].get()}, mip, tails.texelsOf(i), normalsOf(first + i));
      }
    }
  }
  // Of a patch that shows images.
  Result<EncodedPage> shownPage(PageId id) const {
    const NodeId node = id.node();
    const PatchImage& patch = images.of_patch[node.patch];
    const ShownTexels which{kPageCellsLog2 + static_cast<int>(node.level), int64_t{node.x} * kPagePx - kPageBorderPx,
                            int64_t{node.y} * kPagePx - kPageBorderPx, kPageFullPx};
    std::vector<uint8_t> channels(kTexturePageBytes);
    if (texturePlaneIndex(id.plane()) == 0) {
      auto shown = imagesOf(patch);
      if (!shown) return shown.error();
      showImages(patch, {(*shown)[0].get(), (*shown)[1].get()}, which, channels);
    } else {
      showNormals(patch, which, channels, normalsOf(node.patch));
    }
    EncodedPage page;
    page.bytes = plainTexturePage(channels);
    page.from_tail = page.bytes.size();
    return page;
  }
  // Those have no errors, and nothing in the index that says so.
  bool finestOfCompact(const NodeId& node) const {
    return header.compact && static_cast<int>(node.level) == header.domain.relief_depth && layout.relief.contains(node);
  }

  Result<std::vector<uint8_t>> readWhole(const char* what, uint64_t offset, uint64_t size) const {
    // Checked before the allocation: the file may be truncated.
    if (offset > file.size() || size > file.size() - offset)
      return Error{ErrorKind::kInvalidData, file.path(), std::string(what) + " lies beyond the end of the file",
                   "get a whole copy", offset};
    std::vector<uint8_t> bytes(size);
    if (auto read = file.read(offset, bytes); !read) return read.error();
    return bytes;
  }

  // Nothing can be drawn without it, so it is there twice, or is made good by its parity.
  Result<void> readBase() {
    auto readAt = [&](uint64_t offset, bool mend) -> Result<BaseSection> {
      auto read = readWhole("the base mesh", offset, header.base_bytes);
      if (!read) return read.error();
      std::vector<uint8_t>& bytes = *read;
      if (mend) {
        const auto parity = readWhole("the base mesh's parity", header.base_copy_offset, header.baseCopyBytes());
        if (!parity) return parity.error();
        mendByParity(*parity, bytes);
      }
      if (XXH3_64bits(bytes.data(), bytes.size()) != header.base_hash)
        return Error{ErrorKind::kInvalidData, file.path(), "the base mesh is damaged: its checksum does not match",
                     "rebuild the package, or get a whole copy", offset};
      auto section = readBaseSection(header, bytes);
      if (section) {
        const std::string problem = textureDepthsProblem(header, section->texture_depths);
        if (problem.empty()) return section;
        return Error{ErrorKind::kInvalidData, file.path(), "the base mesh is damaged: " + problem,
                     "rebuild the package, or get a whole copy", offset};
      }
      Error error = section.error();
      error.file = file.path();
      error.offset = offset + error.offset.value_or(0);
      return error;
    };
    auto section = readAt(header.base_offset, false);
    if (!section) {
      const Error first = section.error();
      section = readAt(header.base_parity ? header.base_offset : header.base_copy_offset, header.base_parity);
      if (!section) return first;
      warnings.push_back("the base mesh at byte " + std::to_string(header.base_offset) +
                         (first.kind == ErrorKind::kIo ? " cannot be read: " + first.message : " is damaged") +
                         (header.base_parity ? "; its parity makes it good" : "; its copy is used"));
    }
    section->mesh.cut = header.cut_patches;
    manifest.tail_edges = header.tail_edges;
    manifest.base = std::make_shared<const BaseMesh>(std::move(section->mesh));
    manifest.coarse_errors = std::move(section->coarse_errors);
    manifest.coarse_blocks = std::move(section->coarse_blocks);
    manifest.height_slopes = std::move(section->slopes);
    manifest.coarse_shapes = std::move(section->shapes);
    manifest.error_unit_mm = section->error_unit_mm;
    if (header.texture_depths)
      header.domain.setTextureDepths(std::make_shared<const TextureDepths>(std::move(section->texture_depths)));
    return {};
  }

  Result<std::vector<TailsChunk>> tailsDirectory() const {
    std::vector<uint8_t> bytes(header.tails_bytes);
    if (auto read = file.read(header.tails_offset, bytes); !read) return read.error();
    auto at = [&](Error error) {
      error.file = file.path();
      error.offset = header.tails_offset + error.offset.value_or(0);
      return error;
    };
    if (XXH3_64bits(bytes.data(), bytes.size()) != header.tails_hash) {
      return at({ErrorKind::kInvalidData, "",
                 "the patches' tails are damaged: their directory's checksum does not match",
                 "rebuild the package, or get a whole copy", 0});
    }
    auto chunks = decodeTailsDirectory(bytes, header.domain.patchCount(), header.texture.channels());
    if (!chunks) return at(chunks.error());
    return chunks;
  }
  PatchCorners tailsCorners(uint32_t first, uint32_t count) const {
    return header.light_patches ? PatchCorners(manifest.base->patches).subspan(first, count) : PatchCorners{};
  }
  // The heights of a patch's tail.
  Result<void> tailHeights(uint32_t patch, std::span<uint16_t> out) const {
    auto directory = part(header.tails_offset, [&]() -> Result<std::vector<uint8_t>> {
      auto chunks = tailsDirectory();
      if (!chunks) return chunks.error();
      return encodeTailsDirectory(header.domain.patchCount(), header.texture.channels(), *chunks);
    });
    if (!directory) return directory.error();
    const uint32_t number = patch / kTailsChunkPatches, first = number * kTailsChunkPatches,
                   count = std::min(kTailsChunkPatches, header.domain.patchCount() - first);
    const TailsChunk chunk = tailsChunkAt(**directory, number);
    auto heights = part(chunk.offset, [&]() -> Result<std::vector<uint8_t>> {
      auto bytes = readTailsChunk(chunk, first, count);
      if (!bytes) return bytes.error();
      std::vector<uint16_t> decoded(count * kTailHeights);
      if (!decodeTailHeights(*bytes, tailsCorners(first, count), decoded))
        return damagedTails(chunk, first, count, " are damaged: expected the codes of so many patches");
      std::vector<uint8_t> kept(2 * decoded.size());
      std::memcpy(kept.data(), decoded.data(), kept.size());
      return kept;
    });
    if (!heights) return heights.error();
    std::memcpy(out.data(), (*heights)->data() + 2 * kTailHeights * (patch - first), out.size_bytes());
    return {};
  }
  Error damagedTails(const TailsChunk& chunk, uint32_t first, uint32_t count, const std::string& what) const {
    return {ErrorKind::kInvalidData, file.path(),
            "the tails of patches " + std::to_string(first) + " to " + std::to_string(first + count - 1) + what,
            "rebuild the package, or get a whole copy", chunk.offset};
  }
  Result<std::vector<uint8_t>> readTailsChunk(const TailsChunk& chunk, uint32_t first, uint32_t count) const {
    // Checked before the allocation.
    if (chunk.offset > file.size() || chunk.size > file.size() - chunk.offset)
      return damagedTails(chunk, first, count, " lie beyond the end of the file");
    std::vector<uint8_t> bytes(chunk.size);
    if (auto read = file.read(chunk.offset, bytes); !read) return read.error();
    if (XXH3_64bits(bytes.data(), bytes.size()) != chunk.hash)
      return damagedTails(chunk, first, count, " are damaged: their checksum does not match");
    return bytes;
  }
  // The chunk of patches first .. first + tails.patches.
  Result<void> readTails(const TailsChunk& chunk, uint32_t first, PatchTails& tails) const {
    const uint32_t count = tails.patches;
    auto bytes = readTailsChunk(chunk, first, count);
    if (!bytes) return bytes.error();
    auto decoded = decodeTailsChunk(*bytes, 0, count, tailsStorage(header), tailsCorners(first, count), tails);
    return decoded ? decoded : damagedTails(chunk, first, count, " are damaged: " + decoded.error().message);
  }

  // take(first, tails) on several threads, for each chunk of patches. What cannot be read is made of root pages, and
  // named in problems.
  template <class Take>
  void forTails(const Package& package, int workers, std::vector<std::string>* problems, const std::atomic<bool>* stop,
                Take&& take) const;

  // What the header does not hold: where the data came from.
  Result<void> readManifest() {
    auto invalid = [&](std::string what) {
      return Error{ErrorKind::kInvalidData, file.path(), std::move(what), "", header.manifest_offset};
    };
    // A truncated file can be shorter than what the header promises.
    if (header.manifest_offset > file.size() || header.manifest_bytes > file.size() - header.manifest_offset)
      return invalid("the manifest lies beyond the end of the file");
    std::string bytes(header.manifest_bytes, '\0');
    auto read = file.read(header.manifest_offset, {reinterpret_cast<uint8_t*>(bytes.data()), bytes.size()});
    if (!read) {
      Error error = read.error();
      error.message = "the manifest cannot be read: " + error.message;
      return error;
    }
    const std::string where = "the manifest at byte " + std::to_string(header.manifest_offset);
    if (XXH3_64bits(bytes.data(), bytes.size()) != header.manifest_hash)
      return invalid(where + " is damaged: its checksum does not match; provenance is unknown");
    auto json = parseJson(bytes, file.path());
    if (!json) return invalid(where + " is damaged: " + json.error().message + "; provenance is unknown");
    if (!json->is_object()) return invalid(where + " is damaged: expected a JSON object; provenance is unknown");
    manifest_json = std::move(bytes);
    auto text = [](const nlohmann::ordered_json& object, const char* key) {
      auto it = object.find(key);
      return it != object.end() && it->is_string() ? it->get<std::string>() : std::string();
    };
    manifest.tool_version = text(*json, "tool_version");
    if (auto sources = json->find("sources"); sources != json->end() && sources->is_array()) {
      for (const auto& s : *sources)
        if (s.is_object()) manifest.sources.push_back({text(s, "name"), text(s, "xxh3"), text(s, "generator")});
    }
    return {};
  }
};

Package::Package(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Package::~Package() = default;

Result<std::shared_ptr<Package>> Package::open(const std::string& path) {
  auto file = InputFile::open(path);
  if (!file) return file.error();
  if (file->size() < kHeaderBytes) {
    return Error{ErrorKind::kInvalidData, path,
                 "expected a header of 4096 bytes, found a file of " + std::to_string(file->size()),
                 "not a Relievo package, or a truncated one", 0};
  }
  auto impl = std::make_unique<Impl>(std::move(*file));
  std::vector<uint8_t> bytes(kHeaderBytes);
  if (auto read = impl->file.read(0, bytes); !read) return read.error();
  auto header = decodeHeader(bytes, path);
  if (!header) {
    // The same bytes stand at the end of the file. (A newer version has that version there, too.)
    if (auto read = impl->file.read(impl->file.size() - kHeaderBytes, bytes); !read) return read.error();
    auto copy = decodeHeader(bytes, path);
    if (!copy || copy->file_bytes != impl->file.size()) return header.error();
    impl->warnings.push_back("the header is damaged; its copy at the end of the file is used");
    header = std::move(copy);
  }
  impl->header = *header;
  const PackageHeader& h = impl->header;
  // Pages lie behind the index: who ends within it has none. Whatever is walked from here on is bounded by the file's
  // own length.
  if (h.index_offset > impl->file.size() || h.index_bytes > impl->file.size() - h.index_offset) {
    return Error{ErrorKind::kInvalidData, path,
                 "expected an index of " + std::to_string(h.index_bytes) + " bytes from byte " +
                     std::to_string(h.index_offset) + ", found a file of " + std::to_string(impl->file.size()) +
                     " bytes: it holds no page",
                 "it is truncated or forged; get a whole copy", 56};
  }
  if (impl->file.size() < h.file_bytes) {
    impl->warnings.push_back("expected a file of " + std::to_string(h.file_bytes) + " bytes, found " +
                             std::to_string(impl->file.size()) + ": pages are missing");
  } else if (impl->file.size() > h.file_bytes) {
    impl->warnings.push_back("expected a file of " + std::to_string(h.file_bytes) + " bytes, found " +
                             std::to_string(impl->file.size()) + ": the rest belongs to nothing");
  }
  if (auto read = impl->readManifest(); !read) {
    impl->warnings.push_back(read.error().message);
    impl->manifest_problem = read.error();
  }
  if (h.base_bytes > 0) {
    if (auto read = impl->readBase(); !read) return read.error();
  }
  impl->layout = packageLayout(h);
  if (h.coded_index) impl->readIndexDirectory();
  impl->manifest.domain = h.domain;
  if (h.showsImages()) {
    impl->readImagesDirectory();
    if (impl->images_problem) {
      impl->warnings.push_back(impl->images_problem->message + "; patches that show them " +
                               (h.image_tails ? "are grey" : "have few texels"));
    } else {
      TextureDepths depths = *h.domain.textureDepths();
      for (size_t p = 0; p < depths.size(); ++p) depths[p] = std::max(depths[p], impl->images.of_patch[p].depth);
      impl->manifest.domain.setTextureDepths(std::make_shared<const TextureDepths>(std::move(depths)));
    }
  }
  impl->manifest.texture = h.texture;
  impl->manifest.encodings = h.encodings;
  impl->manifest.size_known = h.size_known;
  impl->manifest.page_count = h.page_count;
  if (h.domain.isFlat()) impl->manifest.error_unit_mm = h.domain.relief_scale_mm;
  return std::shared_ptr<Package>(new Package(std::move(impl)));
}

const std::string& Package::path() const { return impl_->file.path(); }
uint64_t Package::fileBytes() const { return impl_->file.size(); }
const Manifest& Package::manifest() const { return impl_->manifest; }
const std::string& Package::manifestJson() const { return impl_->manifest_json; }
const std::optional<Error>& Package::manifestProblem() const { return impl_->manifest_problem; }
const PackageHeader& Package::header() const { return impl_->header; }
const std::vector<std::string>& Package::warnings() const { return impl_->warnings; }
Result<void> Package::readBytes(uint64_t offset, std::span<uint8_t> out) const { return impl_->file.read(offset, out); }

Result<void> Package::checkIndex(PageId id) const {
  const IndexLayout& tree = id.plane() == Plane::kRelief ? impl_->layout.relief : impl_->layout.texture;
  if (!tree.contains(id.node()))
    return Error{ErrorKind::kInvalidData, path(), "there is no page " + describePage(id), "", {}};
  auto block = impl_->block(tree.find(id.node()));
  if (!block) return block.error();
  return {};
}

Result<void> Package::checkReliefDetail(const NodeId& node) const {
  const IndexLayout& tree = impl_->layout.relief_detail;
  if (!impl_->header.relief_detail || !tree.contains(node)) return {};
  auto block = impl_->block(tree.find(node));
  if (!block) return block.error();
  return {};
}

Package::ShownImages Package::shownImages() const {
  const PackageHeader& h = impl_->header;
  if (!h.showsImages()) return {};
  const auto& [images, patches] = impl_->images;
  ShownImages shown;
  shown.normal_maps = static_cast<size_t>(
      std::count_if(images.begin(), images.end(), [](const StoredImage& image) { return image.is_normals; }));
  shown.images = images.size() - shown.normal_maps;
  shown.patches =
      static_cast<uint32_t>(std::count_if(patches.begin(), patches.end(), [](const auto& p) { return p.shows(); }));
  shown.bytes = h.images_offset - h.tilesOffset() + h.images_bytes;
  shown.corner_colours = impl_->images.anyColours();
  shown.one_colour = images.size() == 1 && images[0].width * images[0].height == 1 && !shown.corner_colours;
  return shown;
}

void Package::checkImages(const std::function<void(const Error&)>& problem, const std::atomic<bool>* stop) const {
  if (impl_->images_problem) problem(*impl_->images_problem);
  PageDecoder decoder;
  for (size_t i = 0; i < impl_->images.images.size() && !(stop && stop->load()); ++i)
    if (auto read = impl_->readImage(i, decoder, stop, {}); !read) problem(read.error());
}

bool Package::hasTails() const { return impl_->header.tails_bytes > 0; }

template <class Take>
void Package::Impl::forTails(const Package& package, int workers, std::vector<std::string>* problems,
                             const std::atomic<bool>* stop, Take&& take) const {
  const uint32_t patches = header.domain.patchCount();
  std::mutex reading;
  auto name = [&](const Error& error) {
    const bool over_tails = header.coded_index;  // what root pages lack of their heights is lost, too
    if (problems)
      problems->push_back(error.text() +
                          (over_tails ? " (texels are made of the root pages)" : " (made of the root pages)"));
  };
  const LostImages lost = readImagesOfTails(workers, problems, stop);
  const MipFilter mip(header.texture);
  const auto chunks = tailsDirectory();
  if (!chunks) name(chunks.error());
  auto makePart = [] { return PatchTails(); };
  parallelForWith(tailsChunks(patches), std::max(workers, 1), stop, makePart, [&](PatchTails& part, size_t i) {
    const auto first = static_cast<uint32_t>(i) * kTailsChunkPatches,
               count = std::min(kTailsChunkPatches, patches - first);
    if (part.patches != count) part = PatchTails(count, header.texture.channels());
    part.failures = {};
    Result<void> read;
    if (isMadeOfImages(first, count)) std::fill(part.heights.begin(), part.heights.end(), uint16_t{0});
    else read = chunks ? readTails((*chunks)[i], first, part) : Result<void>(chunks.error());
    if (!read) {
      std::lock_guard lock(reading);
      if (chunks) name(read.error());
      tailsFromPages(package, header.texture, true, first, 1, part, problems, stop);
    }
    showTails(first, mip, lost, part);
    take(first, part);
  });
}

KeptTails Package::tails(int workers, std::vector<std::string>* problems, const std::atomic<bool>* stop,
                         int tolerance) const {
  const TextureFormat& format = manifest().texture;
  KeptTails out(manifest().domain.patchCount(), format.channels(), {tolerance, hasNormals(format)});
  std::mutex mutex;
  impl_->forTails(*this, workers, problems, stop, [&](uint32_t first, const PatchTails& part) {
    out.keep(first, part);
    std::lock_guard lock(mutex);
    out.addFailures(part.failures);
  });
  return out;
}

PatchTails Package::wholeTails(int workers, std::vector<std::string>* problems, const std::atomic<bool>* stop) const {
  PatchTails out(manifest().domain.patchCount(), manifest().texture.channels());
  std::mutex mutex;
  impl_->forTails(*this, workers, problems, stop, [&](uint32_t first, const PatchTails& part) {
    std::copy(part.heights.begin(), part.heights.end(), out.heightsOf(first).begin());
    std::copy(part.texels.begin(), part.texels.end(), out.texelsOf(first).begin());
    std::lock_guard lock(mutex);
    out.failures.add(part.failures);
  });
  return out;
}

Result<TailBytes> Package::tailBytes() const {
  TailBytes out;
  if (!hasTails()) return out;
  auto chunks = impl_->tailsDirectory();
  if (!chunks) return chunks.error();
  out.all = impl_->header.tails_bytes;
  if (impl_->header.coded_tails) out.heights = 0;
  for (const TailsChunk& chunk : *chunks) {
    out.all += chunk.size;
    std::array<uint8_t, kTailCodeHeadBytes> head;
    if (!out.heights) continue;
    if (chunk.offset > fileBytes() || chunk.size > fileBytes() - chunk.offset || chunk.size < head.size())
      return Error{ErrorKind::kInvalidData, path(), "tails lie beyond the end of the file, or take no bytes",
                   "rebuild the package, or get a whole copy", chunk.offset};
    if (auto read = readBytes(chunk.offset, head); !read) return read.error();
    *out.heights += std::min<uint64_t>(tailCodeHeightBytes(head), chunk.size);
  }
  return out;
}

void Package::checkTails(const std::function<void(const Error&)>& problem, const std::atomic<bool>* stop) const {
  if (!hasTails()) return;
  auto chunks = impl_->tailsDirectory();
  if (!chunks) return problem(chunks.error());
  const Manifest& m = manifest();
  const PackageHeader& h = impl_->header;
  // One after the other, from the pages' end to the directory.
  uint64_t expected = h.pages_offset + h.pages_bytes;
  for (uint32_t i = 0; i < chunks->size() && !(stop && stop->load()); ++i) {
    const TailsChunk& chunk = (*chunks)[i];
    const uint32_t count = std::min(kTailsChunkPatches, m.domain.patchCount() - i * kTailsChunkPatches);
    PatchTails part(count, m.texture.channels());
    auto read = impl_->readTails(chunk, i * kTailsChunkPatches, part);
    if (!read) {
      problem(read.error());
    } else if (chunk.offset != expected) {
      problem({ErrorKind::kInvalidData, path(),
               "expected the tails of patches from " + std::to_string(i * kTailsChunkPatches) + " on at byte " +
                   std::to_string(expected) + ", found them at byte " + std::to_string(chunk.offset),
               "rebuild the package, or get a whole copy", h.tails_offset});
    }
    expected = chunk.offset + chunk.size;
  }
  if (expected != h.tails_offset && !(stop && stop->load())) {
    problem({ErrorKind::kInvalidData, path(),
             "expected the patches' tails to end at byte " + std::to_string(h.tails_offset) +
                 ", found their end at byte " + std::to_string(expected),
             "rebuild the package, or get a whole copy", h.tails_offset});
  }
}

std::vector<std::string> Package::tailProblems() const {
  std::vector<std::string> out;
  checkTails([&](const Error& error) { out.push_back(error.text()); });
  return out;
}

bool Package::reliefErrors(const NodeId& node, std::span<float> error_mm) const {
  assert(error_mm.size() == kReliefDetailBytes);
  if (impl_->finestOfCompact(node)) {
    std::fill(error_mm.begin(), error_mm.end(), 0.0f);
    return true;
  }
  const IndexLayout& tree = impl_->layout.relief_detail;
  if (!impl_->header.relief_detail || !tree.contains(node)) return false;
  IndexLayout::Place place = tree.find(node);
  auto block = impl_->block(place);
  if (!block) return false;  // the page's own error holds
  const uint8_t* bytes = block->at + place.node_offset;
  for (size_t i = 0; i < error_mm.size(); ++i) {
    double mm = errorFromByte(bytes[i]) * impl_->manifest.error_unit_mm;
    error_mm[i] = std::nextafter(static_cast<float>(mm), INFINITY);
    if (bytes[i] == 0) error_mm[i] = 0;
  }
  return true;
}

bool Package::reliefShapes(const NodeId& node, std::span<DeviationShape> shapes) const {
  assert(shapes.size() == kReliefDetailBytes);
  if (impl_->finestOfCompact(node)) {
    std::fill(shapes.begin(), shapes.end(), DeviationShape{0, 0, 0, 0, 0});
    return true;
  }
  const IndexLayout& tree = impl_->layout.relief_detail;
  if (!impl_->header.relief_shapes || !tree.contains(node)) return false;
  const IndexLayout::Place place = tree.find(node);
  auto block = impl_->block(place);
  if (!block) return false;
  std::memcpy(shapes.data(), block->at + place.node_offset + kReliefDetailBytes, kReliefShapesBytes);
  return true;
}

Result<PageRecord> Package::record(PageId id) const {
  const NodeId node = id.node();
  const bool relief = id.plane() == Plane::kRelief;
  const IndexLayout& tree = relief ? impl_->layout.relief : impl_->layout.texture;
  const int plane = texturePlaneIndex(id.plane());
  if ((!relief && (!isTexturePlane(id.plane()) || plane >= impl_->manifest.texture.planes())) || !tree.contains(node)) {
    return Error{ErrorKind::kInvalidData, path(), "there is no page " + describePage(id), "", {}};
  }
  IndexLayout::Place place = tree.find(node);
  auto block = impl_->block(place);
  if (!block) {
    Error error = block.error();
    error.message = "page " + describePage(id) + ": " + error.message;
    return error;
  }
  const uint8_t* entry = block->at + place.node_offset + (relief ? 0 : plane * kTextureEntryBytes);
  PageRecord record;
  record.offset = loadLittle<uint64_t>(entry);
  record.size = loadLittle<uint32_t>(entry + 8);
  record.checksum = {loadLittle<uint64_t>(entry + 12), impl_->header.coded_index ? 0xFFFFFFFF : ~uint64_t{0}};
  const PackageHeader& h = impl_->header;
  const bool may_be_empty = relief && node.level == 0 && h.light_patches;
  if ((record.size == 0 && !may_be_empty) || record.size > kMaxEncodedPageBytes || record.offset < h.pages_offset ||
      record.offset - h.pages_offset > h.pages_bytes ||
      record.size > h.pages_bytes - (record.offset - h.pages_offset)) {
    return Error{ErrorKind::kInvalidData, path(),
                 "page " + describePage(id) + ": its index entry points outside the pages",
                 "rebuild the package, or get a whole copy", place.block_offset + place.node_offset};
  }
  if (relief) {
    // Outwards, so that the floats stay bounds.
    auto mm = [&](int i) {
      return h.domain.relief_offset_mm + loadLittle<uint16_t>(entry + 20 + 2 * i) * h.domain.relief_scale_mm;
    };
    auto below = [](double v) {
      float f = static_cast<float>(v);
      return static_cast<double>(f) > v ? std::nextafter(f, -INFINITY) : f;
    };
    auto above = [](double v) {
      float f = static_cast<float>(v);
      return static_cast<double>(f) < v ? std::nextafter(f, INFINITY) : f;
    };
    record.relief.min_mm = below(mm(0));
    record.relief.max_mm = above(mm(1));
    record.relief.error_mm = above(loadLittle<uint16_t>(entry + 24) * impl_->manifest.error_unit_mm);
  }
  return record;
}

Result<EncodedPage> Package::read(PageId id) const {
  auto page = impl_->readPage(*this, id);
  if (!page && page.error().offset) {  // else there is no such page
    std::lock_guard lock(impl_->mutex);
    impl_->read_failures.add(id, page.error());
  }
  return page;
}

PageFailures Package::readFailures() const {
  std::lock_guard lock(impl_->mutex);
  return impl_->read_failures;
}

Result<EncodedPage> Package::Impl::readPage(const Package& package, PageId id) const {
  if (isTexturePlane(id.plane()) && texturePlaneIndex(id.plane()) < header.texture.planes() &&
      showsPages(id.node().patch) && manifest.domain.hasTexturePage(id.node()))
    return shownPage(id);
  auto found = package.record(id);
  if (!found) return found.error();
  auto failed = [&](std::string what, ErrorKind kind) {
    return Error{kind, file.path(), "page " + describePage(id) + ": " + what,
                 kind == ErrorKind::kIo ? "check the disk, or copy the package to another one"
                                        : "rebuild the package, or get a whole copy",
                 found->offset};
  };
  // Checked before the allocation: the file may be truncated.
  if (found->offset > file.size() || found->size > file.size() - found->offset)
    return failed("it lies beyond the end of the file", ErrorKind::kInvalidData);
  EncodedPage page;
  page.bytes.resize(found->size);
  if (auto read = file.read(found->offset, page.bytes); !read) return failed(read.error().message, read.error().kind);
  if (!found->checksum.matches(XXH3_64bits(page.bytes.data(), page.bytes.size())))
    return failed("its checksum does not match", ErrorKind::kInvalidData);
  const bool empty = page.bytes.empty();
  if (empty) page.bytes = emptyReliefPage();
  if (id.plane() == Plane::kRelief && needsTailHeights(page.bytes)) {
    std::array<uint16_t, kTailHeights> heights;
    if (id.node().level > 0 || header.tails_bytes == 0 || !header.coded_tails)
      return failed("it is stored over a tail that it does not have", ErrorKind::kInvalidData);
    if (auto known = tailHeights(id.node().patch, heights); !known)
      return failed(known.error().message, known.error().kind);
    addTailHeights(heights, page.bytes);
    page.from_tail = kTailHeightsBytes + (empty ? emptyReliefPage().size() : 0);
  }
  return page;
}

Result<PlaneUsage> planeUsage(const Package& package, Plane plane, const std::atomic<bool>* stop) {
  const Manifest& m = package.manifest();
  PackageLayout layout = packageLayout(package.header().domain, m.texture, 0, 0);
  PlaneUsage usage;
  std::optional<Error> unreadable;
  (plane == Plane::kRelief ? layout.relief : layout.texture).forEachBlock([&](const IndexLayout::Block& block) {
    for (uint32_t i = 0; i < block.columns * block.rows; ++i) {
      NodeId node = block.first;
      node.x += i % block.columns;
      node.y += i / block.columns;
      auto record = package.record(PageId(plane, node));
      ++usage.pages;
      usage.unknown_pages += !record;
      if (record) usage.bytes += record->size;
      else if (record.error().kind == ErrorKind::kIo) unreadable = record.error();
    }
    return !unreadable && !(stop && stop->load());
  });
  if (stop && stop->load()) return Error{ErrorKind::kInterrupted, package.path(), "interrupted", "", {}};
  if (unreadable) return *unreadable;
  return usage;
}

Result<uint64_t> reliefBytes(const Package& package) {
  auto pages = planeUsage(package, Plane::kRelief);
  if (!pages) return pages.error();
  uint64_t bytes = pages->bytes + package.header().base_bytes;
  if (!package.header().coded_index) return bytes;
  auto tails = package.tailBytes();
  if (!tails) return tails.error();
  return bytes + tails->heights.value_or(0);
}

}  // namespace relievo
