#include "texturing/import/tiff_frame.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

namespace relievo {
namespace {

constexpr int64_t kStripBytes = int64_t{1} << 20;  // readers decode strip by strip
constexpr int kShort = 3, kLong = 4, kRational = 5, kLong8 = 16;

template <class T>
void store(std::vector<uint8_t>& out, T value) {
  const size_t at = out.size();
  out.resize(at + sizeof value);
  std::memcpy(out.data() + at, &value, sizeof value);
}

struct Layout {
  uint64_t row_bytes, data_bytes, head_bytes, directory;
  int64_t strip_rows, strips;
  bool big;
  explicit Layout(const TiffFrame& f) {
    row_bytes = static_cast<uint64_t>(f.width) * static_cast<uint64_t>(f.channels * f.sample_bytes);
    data_bytes = row_bytes * static_cast<uint64_t>(f.height);
    strip_rows = std::clamp<int64_t>(kStripBytes / static_cast<int64_t>(row_bytes), 1, f.height);
    strips = (f.height + strip_rows - 1) / strip_rows;
    big = data_bytes + 16 * static_cast<uint64_t>(strips) + 4096 > 0xFFFFFFFFu;  // with all that stands behind
    head_bytes = big ? 16 : 8;
    directory = (head_bytes + data_bytes + 1) / 2 * 2;  // on an even place
  }
};

// One entry of the directory: its values, which stand in the entry where they fit, else behind the directory.
struct Entry {
  uint16_t tag;
  int type;
  uint64_t count;
  std::vector<uint8_t> values;
};

}  // namespace

std::vector<uint8_t> tiffHead(const TiffFrame& frame) {
  const Layout layout(frame);
  std::vector<uint8_t> out(2, std::endian::native == std::endian::little ? 'I' : 'M');
  store<uint16_t>(out, layout.big ? 43 : 42);
  if (layout.big) {
    store<uint16_t>(out, 8);  // bytes an offset
    store<uint16_t>(out, 0);
    store<uint64_t>(out, layout.directory);
  } else {
    store<uint32_t>(out, static_cast<uint32_t>(layout.directory));
  }
  return out;
}

std::vector<uint8_t> tiffTail(const TiffFrame& frame) {
  const Layout layout(frame);
  std::vector<Entry> entries;
  const auto shorts = [&](uint16_t tag, int value, int count = 1) {
    Entry e{tag, kShort, static_cast<uint64_t>(count), {}};
    for (int i = 0; i < count; ++i) store(e.values, static_cast<uint16_t>(value));
    entries.push_back(std::move(e));
  };
  const auto offsets = [&](uint16_t tag, int64_t count, auto value) {
    Entry e{tag, layout.big ? kLong8 : kLong, static_cast<uint64_t>(count), {}};
    for (int64_t i = 0; i < count; ++i)
      layout.big ? store<uint64_t>(e.values, value(i)) : store(e.values, static_cast<uint32_t>(value(i)));
    entries.push_back(std::move(e));
  };
  const auto one = [](uint64_t value) { return [value](int64_t) { return value; }; };
  const auto rational = [&](uint16_t tag, double value) {
    // Six places behind the point where the number leaves room for them.
    double below = 1e6;
    while (below > 1 && value * below >= 4e9) below /= 10;
    Entry e{tag, kRational, 1, {}};
    store(e.values, static_cast<uint32_t>(std::lround(std::min(value * below, 4e9))));
    store(e.values, static_cast<uint32_t>(below));
    entries.push_back(std::move(e));
  };
  const bool colour = frame.channels >= 3, sized = frame.px_per_cm > 0;
  offsets(256, 1, one(static_cast<uint64_t>(frame.width)));
  offsets(257, 1, one(static_cast<uint64_t>(frame.height)));
  shorts(258, 8 * frame.sample_bytes, frame.channels);  // bits a sample
  shorts(259, 1);                                       // uncompressed
  shorts(262, colour ? 2 : 1);                          // RGB; 0 is black
  offsets(273, layout.strips, [&](int64_t i) {
    return layout.head_bytes + static_cast<uint64_t>(i * layout.strip_rows) * layout.row_bytes;
  });
  shorts(274, 1);  // the first row is the top one
  shorts(277, frame.channels);
  offsets(278, 1, one(static_cast<uint64_t>(layout.strip_rows)));
  offsets(279, layout.strips, [&](int64_t i) {
    return static_cast<uint64_t>(std::min(layout.strip_rows, frame.height - i * layout.strip_rows)) * layout.row_bytes;
  });
  if (sized) rational(282, frame.px_per_cm), rational(283, frame.px_per_cm);
  shorts(284, 1);             // channels side by side
  if (sized) shorts(296, 3);  // a centimetre
  if (frame.channels % 2 == 0) shorts(338, 2);
  shorts(339, frame.floats ? 3 : 1, frame.channels);

  const size_t inside = layout.big ? 8 : 4, entry_bytes = layout.big ? 20 : 12;
  uint64_t behind = layout.directory + (layout.big ? 16 : 6) + entries.size() * entry_bytes;
  std::vector<uint8_t> out(layout.directory - layout.head_bytes - layout.data_bytes, 0), values;
  const auto offset = [&](uint64_t value) {
    layout.big ? store(out, value) : store(out, static_cast<uint32_t>(value));
  };
  if (layout.big) store<uint64_t>(out, entries.size());
  else store(out, static_cast<uint16_t>(entries.size()));
  for (Entry& e : entries) {
    store(out, e.tag);
    store(out, static_cast<uint16_t>(e.type));
    offset(e.count);
    if (e.values.size() <= inside) {
      e.values.resize(inside, 0);
      out.insert(out.end(), e.values.begin(), e.values.end());
    } else {
      offset(behind + values.size());
      values.insert(values.end(), e.values.begin(), e.values.end());
      values.resize((values.size() + 7) / 8 * 8, 0);
    }
  }
  offset(0);  // no other directory
  out.insert(out.end(), values.begin(), values.end());
  return out;
}

}  // namespace relievo
