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

}  // namespace

Result<std::vector<SectionFault>> sectionFaults(const SectionsOf& package, const ReadBytes& read,
                                                const std::atomic<bool>* stop) {
  const PackageHeader& h = package.header;
  const uint64_t length = package.file_bytes;
  std::vector<SectionFault> faults;
  auto say = [&](std::string what, bool unreadable = false) {
    faults.emplace_back();
    faults.back().what = std::move(what);
    faults.back().unreadable = unreadable;
  };
  if (length < h.file_bytes) {
    say("expected a file of " + std::to_string(h.file_bytes) + " bytes, found " + std::to_string(length) +
        ": its end is missing");
  } else if (length > h.file_bytes) {
    say("expected a file of " + std::to_string(h.file_bytes) + " bytes, found " + std::to_string(length) +
        ": the last " + std::to_string(length - h.file_bytes) + " belong to nothing");
  }
  auto inFile = [&](uint64_t offset, uint64_t bytes) { return offset <= length && bytes <= length - offset; };

  const Copies headers{"the header", {0, h.file_bytes - kHeaderBytes}, kHeaderBytes};
  std::array<std::vector<uint8_t>, 2> sound_header;
  addCopies(
      headers,
      [&](size_t i, std::string* why) {
        if (!inFile(headers.offset[i], kHeaderBytes)) return Copy::kMissing;
        std::vector<uint8_t> bytes(kHeaderBytes);
        if (auto got = read(headers.offset[i], bytes); !got) {
          *why = got.error().message;
          return got.error().kind == ErrorKind::kIo ? Copy::kUnreadable : Copy::kMissing;
        }
        auto header = decodeHeader(bytes, "");
        if (!header || header->file_bytes != h.file_bytes) return Copy::kDamaged;
        sound_header[i] = std::move(bytes);
        return Copy::kSound;
      },
      faults);
  if (!sound_header[0].empty() && !sound_header[1].empty() && sound_header[0] != sound_header[1])
    say("the header's two copies tell different things, though the checksums of both match");

  if (h.base_bytes > 0) {
    const Copies bases{"the base mesh", {h.base_offset, h.base_copy_offset}, h.base_bytes};
    Result<void> stopped;
    addCopies(
        bases,
        [&](size_t i, std::string* why) {
          if (!inFile(bases.offset[i], bases.bytes)) return Copy::kMissing;
          auto hash = hashOfBytes(bases.offset[i], bases.bytes, read, stop);
          if (hash) return *hash == h.base_hash ? Copy::kSound : Copy::kDamaged;
          if (hash.error().kind == ErrorKind::kInterrupted) stopped = hash.error();
          *why = hash.error().message;
          return hash.error().kind == ErrorKind::kIo ? Copy::kUnreadable : Copy::kMissing;
        },
        faults);
    if (!stopped) return stopped.error();
  }

  // What lies between the sections.
  std::vector<Section> sections{{"the header", 0, kHeaderBytes},
                                {"the manifest", h.manifest_offset, h.manifest_bytes, true},
                                {"the index", h.index_offset, h.index_bytes},
                                {"the pages", h.pages_offset, h.pages_bytes},
                                {"the header's copy", h.file_bytes - kHeaderBytes, kHeaderBytes}};
  if (h.base_bytes > 0) {
    sections.push_back({"the base mesh", h.base_offset, h.base_bytes, true});
    sections.push_back({"the base mesh's copy", h.base_copy_offset, h.base_bytes});
  }
  // The tails themselves are checked one by one: they lie from the pages' end to their directory.
  if (const uint64_t pages_end = h.pages_offset + h.pages_bytes; h.tails_bytes > 0 && h.tails_offset >= pages_end)
    sections.push_back({"the patches' tails", pages_end, h.tails_offset - pages_end + h.tails_bytes});
  std::stable_sort(sections.begin(), sections.end(), [](const Section& a, const Section& b) {
    return a.offset != b.offset ? a.offset < b.offset : a.bytes < b.bytes;
  });
  bool overlap = false;
  for (size_t i = 0; i + 1 < sections.size(); ++i) {
    const Section &before = sections[i], &behind = sections[i + 1];
    const uint64_t end = before.offset + before.bytes;
    if (behind.offset < end) {
      say(before.name + " and " + behind.name + " overlap at byte " + std::to_string(behind.offset));
      overlap = true;
      continue;
    }
    const uint64_t gap = behind.offset - end;
    if (gap == 0 || !inFile(end, gap)) continue;
    if (!before.padded || gap >= kHeaderBytes || behind.offset % kHeaderBytes != 0) {
      say(std::to_string(gap) + " bytes at byte " + std::to_string(end) + " belong to nothing, between " + before.name +
          " and " + behind.name);
      continue;
    }
    std::vector<uint8_t> bytes(gap);
    if (auto got = read(end, bytes); !got) {
      say(at("the padding", end) + " cannot be read: " + got.error().message, got.error().kind == ErrorKind::kIo);
    } else if (const auto wrong =
                   bytes.size() - static_cast<size_t>(std::count(bytes.begin(), bytes.end(), uint8_t{0}));
               wrong > 0) {
      say(at("the padding", end) + ", between " + before.name + " and " + behind.name + ", is damaged: expected " +
          std::to_string(gap) + " zeros, found " + std::to_string(wrong) + " other bytes");
      faults.back().mend = SectionFault::Mend::kZeros;
      faults.back().offset = end;
      faults.back().bytes = gap;
    }
  }
  // Then what mends one section damages another.
  for (SectionFault& fault : faults)
    if (overlap) fault.mend = SectionFault::Mend::kNone;
  return faults;
}

}  // namespace relievo
