#include "texturing/package/package_writer.h"

#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>

#include "texturing/package/index_code.h"

namespace relievo {

Result<std::unique_ptr<SpillStore>> SpillStore::create(uint64_t size, bool in_memory, const std::string& beside) {
  auto store = std::unique_ptr<SpillStore>(new SpillStore);
  store->path_ = beside;
  store->size_ = size;
  if (in_memory) {
    store->memory_ = std::make_unique_for_overwrite<uint8_t[]>(std::max<uint64_t>(size, 1));
    return store;
  }
  std::string folder = beside.substr(0, beside.find_last_of('/') + 1);
  if (folder.empty()) folder = "./";
  store->fd_ = ::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (store->fd_ < 0) {
    std::string name = folder + ".relievo-XXXXXX";
    store->fd_ = ::mkostemp(name.data(), O_CLOEXEC);
    if (store->fd_ >= 0) ::unlink(name.c_str());
  }
  if (store->fd_ < 0) return store->failed("creating a temporary file beside it", errno);
  // What nobody writes may be read.
  if (::ftruncate(store->fd_, static_cast<off_t>(size)) != 0)
    return store->failed("making a temporary file beside it as large as it gets", errno);
  return store;
}

SpillStore::~SpillStore() {
  if (fd_ >= 0) ::close(fd_);
}

// Offsets may come from a checkpoint, which is a file.
Result<void> SpillStore::holds(uint64_t offset, size_t size) const {
  if (offset <= size_ && size <= size_ - offset) return {};
  return Error{
      ErrorKind::kRuntime, path_, "a part of the build lies outside its place", "build again without --resume", {}};
}

Result<void> SpillStore::write(uint64_t offset, const void* bytes, size_t size) {
  if (auto held = holds(offset, size); !held) return held;
  if (memory_) {
    std::memcpy(memory_.get() + offset, bytes, size);
    return {};
  }
  const uint8_t* p = static_cast<const uint8_t*>(bytes);
  while (size > 0) {
    ssize_t n = ::pwrite(fd_, p, size, static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return failed("writing a temporary file beside it", n < 0 ? errno : ENOSPC);
    p += n, offset += static_cast<uint64_t>(n), size -= static_cast<size_t>(n);
  }
  return {};
}

Result<void> SpillStore::read(uint64_t offset, void* bytes, size_t size) const {
  if (memory_) {
    std::memcpy(bytes, memory_.get() + offset, size);
    return {};
  }
  uint8_t* p = static_cast<uint8_t*>(bytes);
  while (size > 0) {
    ssize_t n = ::pread(fd_, p, size, static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return failed("reading a temporary file beside it", n < 0 ? errno : EIO);
    p += n, offset += static_cast<uint64_t>(n), size -= static_cast<size_t>(n);
  }
  return {};
}

Error SpillStore::failed(const char* doing, int error_number) const {
  return {ErrorKind::kIo,
          path_,
          std::string(doing) + " failed: " + std::strerror(error_number),
          error_number == ENOSPC ? "free some disk space, or write to another disk" : "check the folder's permissions",
          {}};
}

uint64_t encodedHash(std::span<const uint8_t> encoded) { return XXH3_64bits(encoded.data(), encoded.size()); }

Error usage(std::string message, std::string hint) {
  return {ErrorKind::kUsage, "", std::move(message), std::move(hint), {}};
}

nlohmann::ordered_json manifestJson(const PackageHeader& h, const std::string& tool_version) {
  const PatchDomain& d = h.domain;
  const FlatExtent stated = statedExtent(d);
  // Objects and arrays from the beginning: where the memory for turning a null into one is not to be had, the library
  // ends the process as it takes the null away.
  auto json = nlohmann::ordered_json::object();
  json["format"] = "relievo-package";
  json["version"] = packageVersion(h);
  json["tool_version"] = tool_version;
  json["width_px"] = stated.width_px;
  json["height_px"] = stated.height_px;
  json["mm_per_px"] = d.mm_per_px;
  if (!h.size_known) json["size_known"] = false;
  json["page_px"] = kPagePx;
  json["page_border_px"] = kPageBorderPx;
  json["texture_depth"] = d.texture_depth;
  json["patches"] = d.patchCount();
  json["basis"] = basisName(h.texture.basis);
  json["texture_planes"] = h.texture.planes();
  json["encodings"] = nlohmann::ordered_json::array();
  for (int k = 0; k < h.texture.planes(); ++k)
    json["encodings"].push_back(encodingName(h.encodings[static_cast<size_t>(k)]));
  if (h.texture.coefficients() > 0) {
    const auto scales = h.texture.scales(), biases = h.texture.biases();
    json["scale"] = std::vector(scales.begin(), scales.end());
    json["bias"] = std::vector(biases.begin(), biases.end());
  }
  if (d.relief_depth >= 0) {
    json["relief"] = {{"depth", d.relief_depth}, {"offset_mm", d.relief_offset_mm}, {"scale_mm", d.relief_scale_mm}};
  }
  json["pages"] = h.page_count;
  return json;
}

Result<void> addSource(nlohmann::ordered_json& manifest, const Provenance& p, const char* role) {
  if (p.failure) return *p.failure;
  auto s = nlohmann::ordered_json::object();
  s["role"] = role;
  s["name"] = p.name;
  if (!p.xxh3.empty()) s["xxh3"] = p.xxh3;
  if (!p.generator.empty()) s["generator"] = p.generator;
  if (!manifest.contains("sources")) manifest["sources"] = nlohmann::ordered_json::array();
  manifest["sources"].push_back(s);
  return {};
}

std::string manifestText(const nlohmann::ordered_json& manifest) {
  return manifest.dump(1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

Workforce workersThatFit(uint64_t worker_bytes, const BuildOptions& options, uint64_t jobs) {
  const uint64_t most = std::min(static_cast<uint64_t>(workerCount(options.workers)), jobs);
  const uint64_t workers = std::clamp<uint64_t>(options.memory_budget_bytes / 4 * 3 / worker_bytes, 1, most);
  const uint64_t working = worker_bytes * workers;
  return {static_cast<int>(workers),
          options.memory_budget_bytes > working ? (options.memory_budget_bytes - working) / 4 * 3 : 0};
}

Result<void> placeSections(PackageHeader& h, const std::string& manifest, std::span<const uint8_t> base) {
  if (manifest.size() > kMaxManifestBytes) return usage("the sources' names are too long");
  auto aligned = [](uint64_t offset) { return (offset + kHeaderBytes - 1) / kHeaderBytes * kHeaderBytes; };
  h.manifest_bytes = manifest.size();
  h.manifest_hash = XXH3_64bits(manifest.data(), manifest.size());
  h.index_offset = aligned(h.manifest_offset + h.manifest_bytes);
  if (!base.empty()) {
    h.base_offset = h.index_offset;
    h.base_bytes = base.size();
    h.index_offset = aligned(h.base_offset + h.base_bytes);
  }
  const PackageLayout layout = packageLayout(h);
  h.page_count = layout.page_count;
  h.index_bytes = layout.index_bytes;
  h.pages_offset = h.index_offset + h.index_bytes;
  if (h.coded_index) h.pages_offset += kHeaderBytes + 4 * h.page_count;  // whatever the code takes
  return {};
}

Result<std::unique_ptr<PackageWriter>> PackageWriter::create(const std::string& output, const PackageHeader& header,
                                                             std::string manifest, std::vector<uint8_t> base,
                                                             SpillBudget& spills) {
  auto file = OutputFile::create(output);
  if (!file) return file.error();
  auto made = resume(std::move(*file), header, std::move(manifest), spills);
  if (!made) return made.error();
  std::unique_ptr<PackageWriter> writer = std::move(*made);
  writer->base_ = std::move(base);
  // What stands before the pages is filled in at the end.
  std::vector<uint8_t> zeros(size_t{1} << 20);
  for (uint64_t left = header.pages_offset; left > 0;) {
    size_t n = static_cast<size_t>(std::min<uint64_t>(left, zeros.size()));
    if (auto appended = writer->file_.append({zeros.data(), n}); !appended) return appended.error();
    left -= n;
  }
  return writer;
}

Result<std::unique_ptr<PackageWriter>> PackageWriter::resume(OutputFile file, const PackageHeader& header,
                                                             std::string manifest, SpillBudget& spills) {
  auto index = spills.create(header.index_bytes);
  if (!index) return index.error();
  auto writer = std::unique_ptr<PackageWriter>(new PackageWriter(std::move(file)));
  writer->header_ = header;
  writer->manifest_ = std::move(manifest);
  writer->index_ = std::move(*index);
  writer->offset_ = header.pages_offset;
  return writer;
}

Result<void> PackageWriter::append(const BuildPart& part) {
  if (auto appended = file_.append(part.bytes); !appended) return appended;
  return place(part);
}

Result<void> PackageWriter::place(const BuildPart& part) {
  for (const Placed& p : part.pages) {
    uint8_t entry[kReliefEntryBytes];
    storeLittle(entry, offset_);
    storeLittle(entry + 8, p.size);
    storeLittle(entry + 12, p.checksum);
    storeLittle(entry + 20, p.range.min);
    storeLittle(entry + 22, p.range.max);
    storeLittle(entry + 24, p.range.error);
    auto written =
        index_->write(p.index_offset - header_.index_offset, entry, p.relief ? kReliefEntryBytes : kTextureEntryBytes);
    if (!written) return written;
    if (p.relief && p.detail_offset > 0) {
      uint8_t detail[kReliefDetailBytes + kReliefShapesBytes];
      for (size_t i = 0; i < kReliefDetailBytes; ++i) {
        const BlockError& b = p.range.blocks[i];
        detail[i] = byteFromError(b.error);
        const DeviationShape shape = shapeOf({double(errorFromByte(detail[i])), double(b.below), double(b.above),
                                              double(b.aside), double(b.between), double(b.apart)});
        std::memcpy(detail + kReliefDetailBytes + sizeof shape * i, &shape, sizeof shape);
      }
      if (written = index_->write(p.detail_offset - header_.index_offset, detail, header_.detailBytes()); !written)
        return written;
    }
    offset_ += p.size;
  }
  return {};
}

Result<void> PackageWriter::appendTails(std::span<const uint8_t> chunk) {
  tails_.push_back({offset_, static_cast<uint32_t>(chunk.size()), encodedHash(chunk)});
  offset_ += chunk.size();
  return file_.append(chunk);
}

// The entries of pages become a code, and the pages move to its end.
Result<void> PackageWriter::codeIndex(const std::atomic<bool>* interrupted) {
  PackageHeader& h = header_;
  const PackageLayout layout = packageLayout(h);
  const IndexCodeOf of{h.texture.planes(), h.pages_offset, h.light_patches};
  std::vector<IndexChunk> chunks;
  std::vector<uint8_t> codes, entries;
  std::vector<IndexLayout::Block> blocks;
  Result<void> status;
  uint64_t nodes = 0;
  auto close = [&](bool relief) {
    if (blocks.empty() || !status.ok()) return;
    const uint64_t first = blocks.front().offset;
    entries.resize(blocks.back().offset + blocks.back().bytes - first);
    // The last checksum is not there yet.
    status = index_->read(first - h.index_offset, entries.data(), entries.size() - sizeof(uint64_t));
    auto code = status.ok() ? encodeIndexBlocks(of, relief, blocks, entries) : std::nullopt;
    if (status.ok() && !code)
      status = Error{ErrorKind::kRuntime, file_.path(), "the index cannot be coded", "build again without it", {}};
    if (!status.ok()) return;
    chunks.push_back({first - h.index_offset, 0, static_cast<uint32_t>(code->size()), encodedHash(*code)});
    codes.insert(codes.end(), code->begin(), code->end());
    blocks.clear();
    nodes = 0;
  };
  for (const bool relief : {false, true}) {
    const uint64_t a_node = relief ? 1 : static_cast<uint64_t>(h.texture.planes());
    (relief ? layout.relief : layout.texture).forEachBlock([&](const IndexLayout::Block& block) {
      blocks.push_back(block);
      nodes += uint64_t{block.columns} * block.rows;
      if (nodes * a_node >= kIndexChunkEntries) close(relief);
      return status.ok();
    });
    close(relief);
  }
  if (!status.ok()) return status;
  index_code_ = encodeIndexDirectory(chunks);
  index_code_.insert(index_code_.end(), codes.begin(), codes.end());
  h.index_bytes = index_code_.size() + layout.relief_detail.bytes();
  return movePages(h.index_offset + h.index_bytes, interrupted);
}

// To where the index ends; towards the file's beginning.
Result<void> PackageWriter::movePages(uint64_t to, const std::atomic<bool>* interrupted) {
  assert(to <= header_.pages_offset);
  const uint64_t by = header_.pages_offset - to;
  std::vector<uint8_t> piece;
  for (uint64_t at = header_.pages_offset; at < offset_; at += piece.size()) {
    if (interrupted && interrupted->load())
      return Error{ErrorKind::kInterrupted, file_.path(), "interrupted", "nothing was written", {}};
    piece.resize(std::min<uint64_t>(offset_ - at, uint64_t{4} << 20));
    if (auto read = file_.readBack(at, piece); !read) return read;
    if (auto written = file_.writeAt(at - by, piece); !written) return written;
  }
  header_.pages_offset = to;
  offset_ -= by;
  for (TailsChunk& chunk : tails_) chunk.offset -= by;
  return file_.truncate(offset_);
}

// Block after block with its checksum, in pieces of a few MiB.
Result<void> PackageWriter::writeIndex() {
  const PackageHeader& h = header_;
  const PackageLayout layout = packageLayout(h);
  Result<void> status;
  std::vector<uint8_t> piece;
  uint64_t piece_offset = h.index_offset;
  auto flush = [&] {
    status = file_.writeAt(piece_offset, piece);
    piece_offset += piece.size();
    piece.clear();
  };
  auto put = [&](const IndexLayout::Block& block) {
    const size_t at = piece.size();
    piece.resize(at + block.bytes);
    status = index_->read(block.offset - h.index_offset, piece.data() + at, block.bytes - 8);
    storeLittle(piece.data() + at + block.bytes - 8,
                static_cast<uint64_t>(XXH3_64bits(piece.data() + at, block.bytes - 8)));
    if (status.ok() && piece.size() >= (size_t{4} << 20)) flush();
    return status.ok();
  };
  if (h.coded_index) piece = std::move(index_code_);
  for (const IndexLayout* tree : {&layout.texture, &layout.relief, &layout.relief_detail}) {
    if (h.coded_index && tree != &layout.relief_detail) continue;
    tree->forEachBlock(put);
    if (!status.ok()) return status;
  }
  flush();
  return status;
}

Result<uint64_t> PackageWriter::finish(const std::atomic<bool>* interrupted) {
  PackageHeader& h = header_;
  if (h.coded_index)
    if (auto coded = codeIndex(interrupted); !coded) return coded.error();
  h.pages_bytes = (tails_.empty() ? offset_ : tails_.front().offset) - h.pages_offset;
  if (!tails_.empty()) {
    const std::vector<uint8_t> directory = encodeTailsDirectory(h.domain.patchCount(), h.texture.channels(), tails_);
    h.tails_offset = offset_;
    h.tails_bytes = directory.size();
    h.tails_hash = encodedHash(directory);
    if (auto appended = file_.append(directory); !appended) return appended.error();
    offset_ += directory.size();
  }
  if (!images_.empty()) {
    tiles_.push_back(std::move(images_));
    for (const std::vector<uint8_t>& piece : tiles_) {
      if (auto appended = file_.append(piece); !appended) return appended.error();
      offset_ += piece.size();
    }
    h.images_bytes = tiles_.back().size();
    h.images_offset = offset_ - h.images_bytes;
    h.images_hash = encodedHash(tiles_.back());
  }
  if (!base_.empty()) {
    h.base_copy_offset = offset_;
    h.base_hash = XXH3_64bits(base_.data(), base_.size());
    const std::vector<uint8_t> copy = h.base_parity ? parityOf(base_) : base_;
    if (auto appended = file_.append(copy); !appended) return appended.error();
    offset_ += copy.size();
  }
  h.file_bytes = offset_ + kHeaderBytes;
  std::vector<uint8_t> head(kHeaderBytes);
  encodeHeader(h, head);
  if (auto appended = file_.append(head); !appended) return appended.error();

  if (auto written = writeIndex(); !written) return written.error();
  if (!base_.empty())
    if (auto w = file_.writeAt(h.base_offset, base_); !w) return w.error();
  if (auto w = file_.writeAt(h.manifest_offset, {reinterpret_cast<const uint8_t*>(manifest_.data()), manifest_.size()});
      !w)
    return w.error();
  if (auto w = file_.writeAt(0, head); !w) return w.error();
  if (interrupted && interrupted->load())
    return Error{ErrorKind::kInterrupted, file_.path(), "interrupted", "nothing was written", {}};
  if (auto committed = file_.commit(); !committed) return committed.error();
  return h.file_bytes;
}

}  // namespace relievo
