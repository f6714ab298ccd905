#include "texturing/package/package_sections.h"

#include <xxhash.h>

#include <algorithm>
#include <functional>
#include <memory>

namespace relievo {
namespace {

constexpr uint64_t kPieceBytes = uint64_t{1} << 20;

std::string at(const char* what, uint64_t offset) { return std::string(what) + " at byte " + std::to_string(offset); }

// A section that is there twice.
struct Copies {
  const char* what;
  std::array<uint64_t, 2> offset{};
  uint64_t bytes = 0;
};
enum class Copy { kSound, kDamaged, kUnreadable, kMissing };

// copy(i, &why) tells of each.
template <class F>
void addCopies(const Copies& c, F&& copy, std::vector<SectionFault>& faults) {
  std::array<std::string, 2> why;
  std::array<Copy, 2> is{};
  for (size_t i = 0; i < 2; ++i) is[i] = copy(i, &why[i]);
  for (size_t i = 0; i < 2; ++i) {
    if (is[i] == Copy::kSound) continue;
    const bool other = is[1 - i] == Copy::kSound;
    SectionFault fault;
    fault.unreadable = is[i] == Copy::kUnreadable;
    fault.what = at(c.what, c.offset[i]) +
                 (is[i] == Copy::kMissing ? " lies beyond the end of the file"
                  : fault.unreadable      ? " cannot be read: " + why[i]
                                          : " is damaged") +
                 (other ? "; " + at("its copy", c.offset[1 - i]) + " is sound" : "");
    if (is[i] == Copy::kDamaged && other) {
      fault.mend = SectionFault::Mend::kCopy;
      fault.offset = c.offset[i];
      fault.bytes = c.bytes;
      fault.from = c.offset[1 - i];
    }
    faults.push_back(std::move(fault));
  }
}

struct Section {
  std::string name;
  uint64_t offset = 0, bytes = 0;
  bool padded = false;  // zeros follow, up to a multiple of kHeaderBytes
};

// xxh3-64 of a range, read piece by piece.
Result<uint64_t> hashOfBytes(uint64_t offset, uint64_t bytes, const ReadBytes& read, const std::atomic<bool>* stop) {
  std::unique_ptr<XXH3_state_t, XXH_errorcode (*)(XXH3_state_t*)> state(XXH3_createState(), XXH3_freeState);
  XXH3_64bits_reset(state.get());
  std::vector<uint8_t> piece(std::min(bytes, kPieceBytes));
  for (uint64_t done = 0; done < bytes; done += piece.size()) {
    if (stop && stop->load()) return Error{ErrorKind::kInterrupted, "", "interrupted", "", {}};
    piece.resize(std::min(bytes - done, kPieceBytes));
    if (auto got = read(offset + done, piece); !got) return got.error();
    XXH3_64bits_update(state.get(), piece.data(), piece.size());
  }
  return static_cast<uint64_t>(XXH3_64bits_digest(state.get()));
}

// The sections in the file's order.
std::vector<Section> sectionsOf(const PackageHeader& h) {
  std::vector<Section> sections{{"the header", 0, kHeaderBytes},
                                {"the manifest", h.manifest_offset, h.manifest_bytes, true},
                                {"the index", h.index_offset, h.index_bytes},
                                {"the pages", h.pages_offset, h.pages_bytes},
                                {"the header's copy", h.file_bytes - kHeaderBytes, kHeaderBytes}};
  if (h.base_bytes > 0) {
    sections.push_back({"the base mesh", h.base_offset, h.base_bytes, true});
    sections.push_back(
        {h.base_parity ? "the base mesh's parity" : "the base mesh's copy", h.base_copy_offset, h.baseCopyBytes()});
  }
  // The tails themselves are checked one by one: they lie from the pages' end to their directory.
  if (const uint64_t pages_end = h.pages_offset + h.pages_bytes; h.tails_bytes > 0 && h.tails_offset >= pages_end)
    sections.push_back({"the patches' tails", pages_end, h.tails_offset - pages_end + h.tails_bytes});
  if (h.showsImages() && h.images_offset >= h.tilesOffset())
    sections.push_back({"the images", h.tilesOffset(), h.images_offset - h.tilesOffset() + h.images_bytes});
  std::stable_sort(sections.begin(), sections.end(), [](const Section& a, const Section& b) {
    return a.offset != b.offset ? a.offset < b.offset : a.bytes < b.bytes;
  });
  return sections;
}

class SectionCheck {
 public:
  SectionCheck(const SectionsOf& package, const ReadBytes& read, const std::atomic<bool>* stop)
      : header_(package.header), length_(package.file_bytes), read_(read), stop_(stop) {}

  Result<std::vector<SectionFault>> run() {
    checkLength();
    checkHeaders();
    if (auto checked = checkBases(); !checked) return checked.error();
    checkBetween(sectionsOf(header_));
    return std::move(faults_);
  }

 private:
  void say(std::string what, bool unreadable = false) {
    faults_.emplace_back();
    faults_.back().what = std::move(what);
    faults_.back().unreadable = unreadable;
  }
  bool inFile(uint64_t offset, uint64_t bytes) const { return offset <= length_ && bytes <= length_ - offset; }

  void checkLength() {
    if (length_ == header_.file_bytes) return;
    const std::string unlike =
        "expected a file of " + std::to_string(header_.file_bytes) + " bytes, found " + std::to_string(length_);
    if (length_ < header_.file_bytes) say(unlike + ": its end is missing");
    else say(unlike + ": the last " + std::to_string(length_ - header_.file_bytes) + " belong to nothing");
  }

  void checkHeaders() {
    const Copies headers{"the header", {0, header_.file_bytes - kHeaderBytes}, kHeaderBytes};
    std::array<std::vector<uint8_t>, 2> sound;
    addCopies(
        headers,
        [&](size_t i, std::string* why) {
          if (!inFile(headers.offset[i], kHeaderBytes)) return Copy::kMissing;
          std::vector<uint8_t> bytes(kHeaderBytes);
          if (auto got = read_(headers.offset[i], bytes); !got) {
            *why = got.error().message;
            return got.error().kind == ErrorKind::kIo ? Copy::kUnreadable : Copy::kMissing;
          }
          auto header = decodeHeader(bytes, "");
          if (!header || header->file_bytes != header_.file_bytes) return Copy::kDamaged;
          sound[i] = std::move(bytes);
          return Copy::kSound;
        },
        faults_);
    if (!sound[0].empty() && !sound[1].empty() && sound[0] != sound[1])
      say("the header's two copies tell different things, though the checksums of both match");
  }

  Result<void> checkBases() {
    if (header_.base_bytes == 0) return {};
    if (header_.base_parity) return checkParity();
    const Copies bases{"the base mesh", {header_.base_offset, header_.base_copy_offset}, header_.base_bytes};
    Result<void> stopped;
    addCopies(
        bases,
        [&](size_t i, std::string* why) {
          if (!inFile(bases.offset[i], bases.bytes)) return Copy::kMissing;
          auto hash = hashOfBytes(bases.offset[i], bases.bytes, read_, stop_);
          if (hash) return *hash == header_.base_hash ? Copy::kSound : Copy::kDamaged;
          if (hash.error().kind == ErrorKind::kInterrupted) stopped = hash.error();
          *why = hash.error().message;
          return hash.error().kind == ErrorKind::kIo ? Copy::kUnreadable : Copy::kMissing;
        },
        faults_);
    return stopped;
  }

  // Of a base mesh that is not there twice. Either tells what belongs at the other's place.
  Result<void> checkParity() {
    struct Part {
      const char* what;
      uint64_t offset;
      std::vector<uint8_t> bytes;
      bool is_there = false;
    };
    Part base{"the base mesh", header_.base_offset, {}}, parity{"the base mesh's parity", header_.base_copy_offset, {}};
    auto readPart = [&](Part& part, uint64_t bytes) {
      if (!inFile(part.offset, bytes)) return say(at(part.what, part.offset) + " lies beyond the end of the file");
      part.bytes.resize(bytes);
      auto got = read_(part.offset, part.bytes);
      part.is_there = got.ok();
      if (!got)
        say(at(part.what, part.offset) + " cannot be read: " + got.error().message, got.error().kind == ErrorKind::kIo);
    };
    auto damaged = [&](const Part& part, std::vector<uint8_t> sound, const Part& by) {
      SectionFault fault;
      fault.what = at(part.what, part.offset) + " is damaged";
      if (!sound.empty()) {
        fault.what += "; " + at(by.what, by.offset) + " makes it good";
        fault.mend = SectionFault::Mend::kBytes;
        fault.offset = part.offset;
        fault.bytes = sound.size();
        fault.sound = std::move(sound);
      }
      faults_.push_back(std::move(fault));
    };
    readPart(base, header_.base_bytes);
    if (stop_ && stop_->load()) return Error{ErrorKind::kInterrupted, "", "interrupted", "", {}};
    readPart(parity, header_.baseCopyBytes());
    auto isSound = [&](std::span<const uint8_t> bytes) {
      return XXH3_64bits(bytes.data(), bytes.size()) == header_.base_hash;
    };
    if (!base.is_there) return {};
    bool sound = isSound(base.bytes);
    if (!sound) {
      if (parity.is_there) mendByParity(parity.bytes, base.bytes);
      sound = isSound(base.bytes);
      damaged(base, sound ? base.bytes : std::vector<uint8_t>(), parity);
    }
    // Of a base mesh that is lost nothing tells whether its parity is sound.
    if (!sound || !parity.is_there) return {};
    if (std::vector<uint8_t> expected = parityOf(base.bytes); expected != parity.bytes)
      damaged(parity, std::move(expected), base);
    return {};
  }

  // What lies between the sections.
  void checkBetween(const std::vector<Section>& sections) {
    bool overlap = false;
    for (size_t i = 0; i + 1 < sections.size(); ++i) {
      const Section &before = sections[i], &behind = sections[i + 1];
      if (behind.offset < before.offset + before.bytes) {
        say(before.name + " and " + behind.name + " overlap at byte " + std::to_string(behind.offset));
        overlap = true;
      } else {
        checkGap(before, behind);
      }
    }
    // Then what mends one section damages another.
    for (SectionFault& fault : faults_)
      if (overlap) fault.mend = SectionFault::Mend::kNone;
  }

  void checkGap(const Section& before, const Section& behind) {
    const uint64_t end = before.offset + before.bytes, gap = behind.offset - end;
    const std::string between = "between " + before.name + " and " + behind.name;
    if (gap == 0 || !inFile(end, gap)) return;
    if (!before.padded || gap >= kHeaderBytes || behind.offset % kHeaderBytes != 0) {
      say(std::to_string(gap) + " bytes at byte " + std::to_string(end) + " belong to nothing, " + between);
      return;
    }
    std::vector<uint8_t> bytes(gap);
    if (auto got = read_(end, bytes); !got) {
      say(at("the padding", end) + " cannot be read: " + got.error().message, got.error().kind == ErrorKind::kIo);
      return;
    }
    const auto zeros = static_cast<size_t>(std::count(bytes.begin(), bytes.end(), uint8_t{0}));
    if (zeros == gap) return;
    say(at("the padding", end) + ", " + between + ", is damaged: expected " + std::to_string(gap) + " zeros, found " +
        std::to_string(gap - zeros) + " other bytes");
    faults_.back().mend = SectionFault::Mend::kZeros;
    faults_.back().offset = end;
    faults_.back().bytes = gap;
  }

  const PackageHeader& header_;
  const uint64_t length_;
  const ReadBytes& read_;
  const std::atomic<bool>* stop_;
  std::vector<SectionFault> faults_;
};

}  // namespace

Result<std::vector<SectionFault>> sectionFaults(const SectionsOf& package, const ReadBytes& read,
                                                const std::atomic<bool>* stop) {
  return SectionCheck(package, read, stop).run();
}

}  // namespace relievo
