#include "texturing/package/build_checkpoint.h"

#include <xxhash.h>

#include <algorithm>
#include <cstring>
#include <type_traits>

namespace relievo {
namespace {

constexpr size_t kRecordHead = 4 + 8 + 8;  // type, bytes, checksum
constexpr uint64_t kMaxPageBytes = uint64_t{1} << 24;
constexpr uint64_t kMaxRecordBytes = uint64_t{1} << 26;  // a part's is below 2 MiB

uint64_t recordHash(uint32_t type, uint64_t serial, const std::vector<uint8_t>& body) {
  return XXH3_64bits_withSeed(body.data(), body.size(), serial << 32 ^ type ^ body.size());
}

// The journal is read by the program that wrote it, so plain structs are kept as they lie in memory.
class Bytes {
 public:
  template <class T>
  void put(const T& value) {
    static_assert(std::is_trivially_copyable_v<T>);
    put(&value, sizeof value);
  }
  void put(const void* from, size_t size) {
    const auto* p = static_cast<const uint8_t*>(from);
    out.insert(out.end(), p, p + size);
  }
  void put(const SpillBlock& block) {
    put(block.offset);
    put(uint64_t{block.bytes.size()});
    put(block.bytes.data(), block.bytes.size());
  }
  std::vector<uint8_t> out;
};

class Taker {
 public:
  explicit Taker(const std::vector<uint8_t>& from) : from_(from) {}
  template <class T>
  T take() {
    T value{};
    take(&value, sizeof value);
    return value;
  }
  void take(void* to, size_t size) {
    if (size > from_.size() - at_) {
      good = false;
      return;
    }
    if (size > 0) std::memcpy(to, from_.data() + at_, size);
    at_ += size;
  }
  void take(SpillBlock& block) {
    block.offset = take<uint64_t>();
    const auto size = take<uint64_t>();
    if (size > left()) {
      good = false;
      return;
    }
    block.bytes.resize(size);
    take(block.bytes.data(), size);
  }
  size_t left() const { return from_.size() - at_; }
  bool good = true;

 private:
  const std::vector<uint8_t>& from_;
  size_t at_ = 0;
};

std::vector<uint8_t> bodyOf(uint32_t stage, const BuildPart& part) {
  Bytes b;
  b.put(stage);
  b.put(part.texels);
  b.put(part.texture_spill);
  b.put(part.relief_spill);
  b.put(part.spill_node);
  b.put(part.spill_range);
  b.put(static_cast<uint32_t>(part.pages.size()));
  for (const Placed& p : part.pages) {
    b.put(static_cast<uint8_t>(p.relief));
    b.put(p.index_offset);
    b.put(p.size);
    b.put(p.checksum);
    if (!p.relief) continue;
    b.put(p.detail_offset);
    b.put(p.range);
  }
  return std::move(b.out);
}

// The stage, or nothing where the record is not one. Index places lie in the index.
std::optional<uint32_t> partFrom(const std::vector<uint8_t>& body, BuildPart& part) {
  Taker t(body);
  const auto stage = t.take<uint32_t>();
  part.texels = t.take<uint64_t>();
  t.take(part.texture_spill);
  t.take(part.relief_spill);
  part.spill_node = t.take<uint64_t>();
  part.spill_range = t.take<NodeRange>();
  const auto pages = t.take<uint32_t>();
  for (uint32_t i = 0; i < pages && t.good; ++i) {
    Placed p;
    p.relief = t.take<uint8_t>() != 0;
    p.index_offset = t.take<uint64_t>();
    p.size = t.take<uint32_t>();
    p.checksum = t.take<uint64_t>();
    if (p.relief) {
      p.detail_offset = t.take<uint64_t>();
      p.range = t.take<NodeRange>();
    }
    t.good &= p.size <= kMaxPageBytes;
    part.pages.push_back(p);
  }
  if (!t.good || t.left() != 0) return std::nullopt;
  return stage;
}

uint64_t pageBytes(const BuildPart& part) {
  uint64_t bytes = 0;
  for (const Placed& p : part.pages) bytes += p.size;
  return bytes;
}

std::string fileName(const std::string& path) { return path.substr(path.find_last_of('/') + 1); }

std::vector<uint8_t> headerOf(uint64_t identity, const std::string& pages_part) {
  Bytes b;
  b.put(identity);
  const std::string name = fileName(pages_part);
  b.put(name.data(), name.size());
  return std::move(b.out);
}

}  // namespace

Result<void> BuildJournal::write(Type type, const std::vector<uint8_t>& body) {
  Bytes head;
  head.put(static_cast<uint32_t>(type));
  head.put(uint64_t{body.size()});
  head.put(recordHash(type, serial_, body));
  if (auto written = file_.append(head.out); !written) return written;
  if (auto written = file_.append(body); !written) return written;
  at_ += head.out.size() + body.size();
  ++serial_;
  return {};
}

std::optional<BuildJournal::Record> BuildJournal::read() {
  std::vector<uint8_t> head(kRecordHead);
  const uint64_t end = file_.size();
  if (at_ + head.size() > end || !file_.readBack(at_, head)) return std::nullopt;
  Taker t(head);
  Record record;
  record.type = t.take<uint32_t>();
  const auto bytes = t.take<uint64_t>();
  const auto checksum = t.take<uint64_t>();
  if (bytes > kMaxRecordBytes || bytes > end - at_ - head.size()) return std::nullopt;
  record.body.resize(bytes);
  if (!file_.readBack(at_ + head.size(), record.body) || recordHash(record.type, serial_, record.body) != checksum)
    return std::nullopt;
  at_ += head.size() + bytes;
  ++serial_;
  return record;
}

Result<BuildJournal> BuildJournal::create(const std::string& output, uint64_t identity, const std::string& pages_part) {
  auto file = OutputFile::create(output);
  if (!file) return file.error();
  BuildJournal journal(std::move(*file));
  if (auto written = journal.write(kHeader, headerOf(identity, pages_part)); !written) return written.error();
  return journal;
}

Result<void> BuildJournal::add(uint32_t stage, const BuildPart& part) { return write(kPart, bodyOf(stage, part)); }

Result<void> BuildJournal::checkpoint(uint64_t pages_end) {
  Bytes b;
  b.put(pages_end);
  if (auto written = write(kCheckpoint, b.out); !written) return written;
  return file_.finish();
}

Result<std::unique_ptr<BuildPart>> BuildJournal::replay(uint32_t stage) {
  while (parts_left_ > 0) {
    const uint64_t at = at_, serial = serial_;
    auto record = read();
    if (!record)
      return Error{
          ErrorKind::kIo, file_.path(), "its checkpoint can no longer be read", "build again without --resume", {}};
    if (record->type != kPart) continue;
    auto part = std::make_unique<BuildPart>();
    const auto found = partFrom(record->body, *part);
    if (!found || *found < stage)
      return Error{ErrorKind::kIo, file_.path(), "its checkpoint is not in order", "build again without --resume", {}};
    if (*found > stage) {
      at_ = at, serial_ = serial;
      return std::unique_ptr<BuildPart>();
    }
    if (--parts_left_ == 0)
      while (at_ < file_.size() && read()) {
      }  // the last checkpoint; from here on records are appended
    return part;
  }
  return std::unique_ptr<BuildPart>();
}

Result<BuildJournal::Found> BuildJournal::find(const std::string& output, uint64_t identity,
                                               const PackageHeader& header, const std::atomic<bool>* interrupted) {
  Found out;
  auto orphans = OutputFile::orphans(output);
  if (!orphans) return orphans.error();
  out.why = "there is no checkpoint to go on from";
  for (OutputFile& candidate : *orphans) {
    BuildJournal journal(std::move(candidate));
    const auto head = journal.read();
    if (!head || head->type != kHeader || head->body.size() < sizeof identity) {
      candidate = std::move(journal.file_);  // the part file with the pages, perhaps
      continue;
    }
    Taker t(head->body);
    const bool same = t.take<uint64_t>() == identity;
    const std::string name(head->body.begin() + sizeof identity, head->body.end());
    const auto pages = std::find_if(orphans->begin(), orphans->end(), [&](const OutputFile& f) {
      return f.ownsPart() && fileName(f.partPath()) == name;
    });
    if (!same) {
      out.why = "the inputs, the options or the program are not those of the checkpoint";
      continue;
    }
    if (pages == orphans->end()) {
      out.why = "the checkpoint's pages are not there";
      continue;
    }

    // Parts up to the last checkpoint whose pages are as they were written.
    out.why = "the checkpoint is damaged";
    const uint64_t first_at = journal.at_, first_serial = journal.serial_;
    uint64_t parts = 0, done = 0, offset = header.pages_offset;
    uint64_t good_parts = 0, good_done = 0, good_offset = 0, good_at = 0;
    std::vector<uint8_t> bytes(size_t{1} << 20);
    while (pages->size() >= header.pages_offset) {
      if (interrupted && interrupted->load()) {
        journal.file_.keep(), pages->keep();
        return Error{
            ErrorKind::kInterrupted, output, "interrupted", "the checkpoint is kept: build again with --resume", {}};
      }
      const auto record = journal.read();
      if (!record) break;
      if (record->type == kCheckpoint) {
        Taker c(record->body);
        if (c.take<uint64_t>() != offset || !c.good) break;
        good_parts = parts, good_done = done, good_offset = offset, good_at = journal.at_;
        continue;
      }
      BuildPart part;
      if (record->type != kPart || !partFrom(record->body, part) || pageBytes(part) > pages->size() - offset) break;
      bytes.resize(std::max<size_t>(bytes.size(), pageBytes(part)));
      if (!pages->readBack(offset, {bytes.data(), static_cast<size_t>(pageBytes(part))})) break;
      bool whole = true;
      const uint8_t* page = bytes.data();
      const uint64_t index_end = header.index_offset + header.index_bytes;
      auto inIndex = [&](uint64_t place, uint64_t size) {
        return place >= header.index_offset && place <= index_end && size <= index_end - place;
      };
      for (const Placed& p : part.pages) {
        whole &= encodedHash({page, p.size}) == p.checksum &&
                 inIndex(p.index_offset, p.relief ? kReliefEntryBytes : kTextureEntryBytes) &&
                 (!p.relief || inIndex(p.detail_offset, header.detailBytes()));
        page += p.size;
      }
      if (!whole) break;
      offset += pageBytes(part), ++parts, done += part.pages.size();
    }
    if (good_parts == 0) continue;
    if (!pages->truncate(good_offset) || !journal.file_.truncate(good_at)) continue;
    // A build that was stopped at its very end has begun to fill in what stands before the pages.
    bool blank = true;
    std::fill(bytes.begin(), bytes.end(), uint8_t{0});
    for (uint64_t at = 0; blank && at < header.pages_offset; at += bytes.size())
      blank = pages
                  ->writeAt(at, {bytes.data(),
                                 static_cast<size_t>(std::min<uint64_t>(bytes.size(), header.pages_offset - at))})
                  .ok();
    if (!blank) continue;
    journal.at_ = first_at, journal.serial_ = first_serial, journal.parts_left_ = good_parts;
    out.pages_done = good_done;
    out.why.clear();
    out.found.emplace(Found::Both{std::move(journal), std::move(*pages)});
    return out;
  }
  return out;
}

}  // namespace relievo
