#include "texturing/stream/subslot_cache.h"

#include <algorithm>
#include <cassert>

namespace relievo {
namespace {

constexpr uint32_t partsOf(int level) { return kPartsOfSlot[static_cast<size_t>(level)]; }  // parts of a slot

}  // namespace

SubslotCache::SubslotCache(uint32_t slot_count) {
  for (int level = 0; level < kPartLevels; ++level) {
    levels_.emplace_back(PageCache(level == 0 ? slot_count : 0));
    if (level > 0) at(level).parts = partsOf(level) / partsOf(parentLevel(level));
  }
}

uint32_t SubslotCache::pageCount() const {
  uint32_t count = 0;
  for (int level = 0; level < kPartLevels; ++level) count += pageCount(level);
  return count;
}

uint32_t SubslotCache::pageCount(int level) const {
  uint32_t count = at(level).pages.residentCount();
  for (int below = level + 1; below < kPartLevels; ++below)
    if (parentLevel(below) == level) count -= at(below).bundles();
  return count;
}

// --- names ---

SlotIndex SubslotCache::slotIndexAt(int level, uint32_t index) const {
  SlotPart p{.slot = 0, .level = level, .part = 0};
  for (uint32_t parts = 1; level > 0; parts *= at(level).parts, level = parentLevel(level)) {
    p.part += index % at(level).parts * parts;
    index = at(level).parent[index / at(level).parts];
  }
  p.slot = index;
  return slotIndexOf(p);
}

std::array<uint32_t, kPartLevels> SubslotCache::indices(SlotIndex slot) const {
  const SlotPart p = partOf(slot);
  std::array<uint32_t, kPartLevels> out{p.slot};
  for (int level = p.level == 0 ? 1 : isThird(p.level) ? kThirds : kHalves; level <= p.level; ++level) {
    const int above = parentLevel(level);
    const PageId parent = at(above).pages.pageIn(out[static_cast<size_t>(above)]);
    assert(parent.plane() == kBundle && parent.node().level == static_cast<uint32_t>(level));
    out[static_cast<size_t>(level)] =
        parent.node().patch * at(level).parts + p.part / (partsOf(p.level) / partsOf(level)) % at(level).parts;
  }
  return out;
}

SlotIndex SubslotCache::find(PageId id) const {
  if (id.plane() != Plane::kRelief) return at(0).pages.find(id);
  for (int level = 1; level < kPartLevels; ++level) {
    if (at(level).pages.residentCount() == 0) continue;
    if (const SlotIndex index = at(level).pages.find(id); index != kNoSlot) return slotIndexAt(level, index);
  }
  return kNoSlot;
}

PageId SubslotCache::pageIn(SlotIndex slot) const {
  const int level = partOf(slot).level;
  return at(level).pages.pageIn(indices(slot)[static_cast<size_t>(level)]);
}

bool SubslotCache::isPinned(SlotIndex slot) const {
  const int level = partOf(slot).level;
  return at(level).pages.isPinned(indices(slot)[static_cast<size_t>(level)]);
}

// --- use ---

void SubslotCache::touch(SlotIndex slot, uint64_t tick) {
  const auto index = indices(slot);
  for (int level = partOf(slot).level; level > 0; level = parentLevel(level))
    at(level).pages.touch(index[static_cast<size_t>(level)], tick);
  at(0).pages.touch(index[0], tick);
}

void SubslotCache::pin(SlotIndex slot) {
  const auto index = indices(slot);
  const int last = partOf(slot).level;
  pinned_halved_slots_ += last > 0 && !isThird(last) && !at(0).pages.isPinned(index[0]);
  for (int level = last; level > 0; level = parentLevel(level)) at(level).pages.pin(index[static_cast<size_t>(level)]);
  at(0).pages.pin(index[0]);
}

void SubslotCache::unpin(SlotIndex slot) {
  const auto index = indices(slot);
  const int last = partOf(slot).level;
  for (int level = last; level > 0; level = parentLevel(level))
    at(level).pages.unpin(index[static_cast<size_t>(level)]);
  at(0).pages.unpin(index[0]);
  pinned_halved_slots_ -= last > 0 && !isThird(last) && !at(0).pages.isPinned(index[0]);
}

void SubslotCache::remove(PageId id) {
  assert(id.plane() != Plane::kRelief);
  at(0).pages.remove(id);
}

// --- who leaves ---

// Links have 16 bits.
bool SubslotCache::canDivideInto(int level) const {
  return !at(level).free_bundles.empty() || at(level).pages.slotCount() + at(level).parts <= kMaxSlots;
}

uint32_t SubslotCache::allocateBundle(int level) {
  Level& l = at(level);
  if (l.free_bundles.empty()) {  // grows by a quarter, since the index is rebuilt each time
    const auto now = static_cast<uint32_t>(l.parent.size());
    const uint32_t more = std::min(now / 4 + 1, (kMaxSlots - l.pages.slotCount()) / l.parts);
    l.pages.addClosed(more * l.parts);
    l.parent.resize(now + more);
    for (uint32_t b = now + more; b-- > now;) l.free_bundles.push_back(static_cast<uint16_t>(b));
  }
  const uint32_t bundle = l.free_bundles.back();
  l.free_bundles.pop_back();
  return bundle;
}

// A bundle was evicted, or is about to be: so are its parts.
void SubslotCache::releaseBundle(int level, uint32_t bundle, Placement& out) {
  Level& l = at(level);
  for (uint32_t index = bundle * l.parts; index < (bundle + 1) * l.parts; ++index) {
    if (l.pages.holdsPage(index)) {
      const PageId page = l.pages.pageIn(index);
      if (page.plane() == kBundle) releaseBundle(static_cast<int>(page.node().level), page.node().patch, out);
      else out.evicted.push_back({level, index, page});
      l.pages.remove(page);
    }
    l.pages.close(index);
  }
  l.free_bundles.push_back(static_cast<uint16_t>(bundle));
}

// --- placement ---

uint32_t SubslotCache::recordEvicted(int level, const PageCache::Placement& placed, Placement& out) {
  if (placed.evicted && placed.evicted->plane() == kBundle)
    releaseBundle(static_cast<int>(placed.evicted->node().level), placed.evicted->node().patch, out);
  else if (placed.evicted) out.evicted.push_back({level, placed.slot, *placed.evicted});
  return placed.slot;
}

bool SubslotCache::isUsedNow(uint32_t slot, uint64_t tick) const {
  const PageCache& slots = at(0).pages;
  return slots.holdsPage(slot) && (slots.isPinned(slot) || slots.lastUse(slot) == static_cast<uint32_t>(tick));
}

// Divides places from level `from`, which has room (`part`, if given), down to the page's own level.
SubslotCache::Placement SubslotCache::placeFrom(int from, std::optional<uint32_t> part, PageId id, uint64_t tick,
                                                uint32_t min_age, int level) {
  Placement out;
  out.emptied = out.opened_slot = from == 0;
  for (int l = from, next;; l = next) {
    const bool last = l == level;
    next = l > 0 ? l + 1 : isThird(level) ? kThirds : kHalves;
    const uint32_t bundle = last ? 0 : allocateBundle(next);
    const PageId what = last ? id : bundleId(next, bundle);
    const auto placed =
        part && l == from ? at(l).pages.placeAt(*part, what, tick) : at(l).pages.place(what, tick, min_age);
    assert(placed);
    const uint32_t index = recordEvicted(l, *placed, out);
    if (last) {
      out.slot = slotIndexAt(level, index);
      break;
    }
    Level& below = at(next);
    below.parent[bundle] = static_cast<uint16_t>(index);
    for (uint32_t k = below.parts; k-- > 0;) below.pages.open(bundle * below.parts + k);
  }
  if (level == 0) return out;
  out.opened_slot = out.opened_slot || !isUsedNow(partOf(out.slot).slot, tick);
  touch(out.slot, tick);
  return out;
}

std::optional<SubslotCache::Placement> SubslotCache::place(PageId id, uint64_t tick, uint32_t min_age, int level) {
  assert((level > 0) == (id.plane() == Plane::kRelief));
  min_age = std::max(1u, min_age);
  if (const SlotIndex slot = find(id); slot != kNoSlot) {
    touch(slot, tick);
    return Placement{slot, false, false, {}};
  }
  int from = freePart(level).first;
  if (from < 0) {
    uint32_t oldest = 0;
    for (int l = level;; l = parentLevel(l)) {
      const uint32_t age = at(l).pages.oldestAge(tick);
      if (age >= min_age && age > oldest) {
        oldest = age;
        from = l;
      }
      if (l == 0 || !canDivideInto(l)) break;
    }
  }
  if (from < 0) return std::nullopt;
  return placeFrom(from, std::nullopt, id, tick, min_age, level);
}

// The deepest free place for a page of that level, in its own level or one above. Level -1: there is none.
std::pair<int, SlotIndex> SubslotCache::freePart(int level) const {
  for (int l = level;; l = parentLevel(l)) {
    if (const SlotIndex free = at(l).pages.firstFree(); free != kNoSlot) return {l, free};
    if (l == 0 || !canDivideInto(l)) return {-1, kNoSlot};
  }
}

SubslotCache::Placement SubslotCache::placeInPart(SlotIndex part, PageId id, uint64_t tick, int level) {
  const int from = partOf(part).level;
  assert((from == kHalves || from == kThirds) && isThird(from) == isThird(level) && find(id) == kNoSlot);
  for (int l = from + 1; l <= level; ++l)
    if (!canDivideInto(l)) level = from;  // levels between do not suit every page (relief_subslots.h)
  return placeFrom(from, indices(part)[static_cast<size_t>(from)], id, tick, 1, level);
}

bool SubslotCache::hasPartToFill(uint64_t tick, int level) const {
  const auto [l, free] = freePart(level);
  return l > 0 && isUsedNow(partOf(slotIndexAt(l, free)).slot, tick);
}

bool SubslotCache::isIdle(SlotIndex part, uint64_t tick, uint32_t min_age) const {
  const auto level = static_cast<size_t>(partOf(part).level);
  const PageCache& parts = levels_[level].pages;
  const uint32_t index = indices(part)[level];
  return !parts.holdsPage(index) ||
         (!parts.isPinned(index) && static_cast<uint32_t>(tick) - parts.lastUse(index) >= min_age);
}

void SubslotCache::idleParts(int level, uint64_t tick, std::vector<SlotIndex>& out) const {
  std::vector<std::pair<uint32_t, SlotIndex>> found;
  const Level& l = at(level);
  at(0).pages.forEach([&](PageId id) {
    if (id.plane() != kBundle || id.node().level != static_cast<uint32_t>(level) ||
        !isUsedNow(l.parent[id.node().patch], tick))
      return;
    for (uint32_t k = 0; k < l.parts; ++k) {
      const uint32_t index = id.node().patch * l.parts + k;
      const SlotIndex part = slotIndexAt(level, index);
      if (isIdle(part, tick, 1))
        found.emplace_back(l.pages.holdsPage(index) ? static_cast<uint32_t>(tick) - l.pages.lastUse(index) : ~0u, part);
    }
  });
  std::sort(found.begin(), found.end(),
            [](const auto& a, const auto& b) { return a.first != b.first ? a.first > b.first : a.second < b.second; });
  out.clear();
  for (const auto& [age, part] : found) out.push_back(part);
}

// --- accounts and tests ---

size_t SubslotCache::metadataBytes() const {
  size_t bytes = sizeof *this + (levels_.capacity() - levels_.size()) * sizeof(Level);
  for (const Level& l : levels_)
    bytes += l.pages.metadataBytes() + sizeof(Level) - sizeof(PageCache) +
             (l.parent.capacity() + l.free_bundles.capacity()) * sizeof(uint16_t);
  return bytes;
}

bool SubslotCache::checkInvariants(std::string* why) const {
  auto fail = [&](const std::string& text) {
    if (why) *why = text;
    return false;
  };
  uint32_t pinned_halved_slots = 0;
  for (int level = 0; level < kPartLevels; ++level) {
    if (!at(level).pages.checkInvariants(why)) return false;
    if (level == 0) continue;
    const Level &l = at(level), &above = at(parentLevel(level));
    uint32_t bundles = 0;
    std::string wrong;
    above.pages.forEach([&](PageId id) {
      if (id.plane() != kBundle || id.node().level != static_cast<uint32_t>(level)) return;
      ++bundles;
      const uint32_t bundle = id.node().patch, parent = above.pages.find(id);
      if (l.parent[bundle] != parent) wrong = "a bundle is not where its parts say";
      uint32_t held = 0;
      bool pinned = false;
      for (uint32_t part = bundle * l.parts; part < (bundle + 1) * l.parts; ++part) {
        if (!l.pages.holdsPage(part)) continue;
        ++held;
        pinned = pinned || l.pages.isPinned(part);
        if (!above.pages.isPinned(parent) && above.pages.lastUse(parent) < l.pages.lastUse(part))
          wrong = "a part was used later than its bundle";
      }
      if (held == 0) wrong = "an empty bundle";
      if (pinned != above.pages.isPinned(parent)) wrong = "a bundle is pinned, or not, unlike its parts";
      pinned_halved_slots += level == kHalves && pinned;
    });
    if (!wrong.empty()) return fail(wrong);
    if (bundles != l.bundles()) return fail("a bundle's parts are in no slot");
  }
  if (pinned_halved_slots != pinned_halved_slots_) return fail("the number of pinned slots in two is wrong");
  return true;
}

}  // namespace relievo
