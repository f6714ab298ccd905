#include "geometry/scan/gltf_buffers.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <filesystem>

#include "geometry/scan/gltf_compression.h"

namespace relievo::mesh_file {
namespace {

constexpr uint64_t kMaxJsonBytes = uint64_t{256} << 20;
constexpr uint32_t kGlb = 0x46546C67, kJsonChunk = 0x4E4F534A, kBinaryChunk = 0x004E4942;
constexpr uint64_t kHeadBytes = 12, kChunkHeadBytes = 8;

uint32_t word(const uint8_t* p) {
  return p[0] | static_cast<uint32_t>(p[1]) << 8 | static_cast<uint32_t>(p[2]) << 16 |
         static_cast<uint32_t>(p[3]) << 24;
}

Error damaged(const InputFile& file, std::string message, uint64_t offset) {
  return {ErrorKind::kInvalidData, file.path(), std::move(message),
          "it is truncated, or states more than it holds; get a whole copy", offset};
}

Result<std::string> readText(const InputFile& file, uint64_t offset, uint64_t bytes) {
  if (bytes > kMaxJsonBytes)
    return Error{ErrorKind::kUnsupported,
                 file.path(),
                 "expected at most " + std::to_string(kMaxJsonBytes >> 20) + " MiB of JSON, found " +
                     std::to_string(bytes >> 20),
                 "write it as a .glb, whose numbers lie outside the JSON",
                 {}};
  std::string text(static_cast<size_t>(bytes), '\0');
  if (auto got = file.read(offset, {reinterpret_cast<uint8_t*>(text.data()), text.size()}); !got) return got.error();
  return text;
}

int sextet(char c) {
  if (c >= 'A' && c <= 'Z') return c - 'A';
  if (c >= 'a' && c <= 'z') return c - 'a' + 26;
  if (c >= '0' && c <= '9') return c - '0' + 52;
  return c == '+' || c == '-' ? 62 : c == '/' || c == '_' ? 63 : -1;
}

int hexDigit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  const char lower = static_cast<char>(c | 0x20);
  return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
}

double decode(const uint8_t* p, GltfComponent c, bool normalized) {
  const auto low = static_cast<uint16_t>(p[0]);
  switch (c) {
    case GltfComponent::kInt8: {
      const double v = static_cast<int8_t>(p[0]);
      return normalized ? std::max(v / 127, -1.0) : v;
    }
    case GltfComponent::kUint8:
      return normalized ? low / 255.0 : low;
    case GltfComponent::kInt16: {
      const double v = static_cast<int16_t>(low | p[1] << 8);
      return normalized ? std::max(v / 32767, -1.0) : v;
    }
    case GltfComponent::kUint16: {
      const double v = low | p[1] << 8;
      return normalized ? v / 65535 : v;
    }
    case GltfComponent::kUint32:
      return word(p);
    case GltfComponent::kFloat:
      return std::bit_cast<float>(word(p));
  }
  return 0;
}

}  // namespace

Result<GltfParts> readGltfParts(const InputFile& file) {
  std::array<uint8_t, kHeadBytes + kChunkHeadBytes> head{};
  GltfParts parts;
  const bool long_enough = file.size() >= head.size();
  if (long_enough)
    if (auto got = file.read(0, head); !got) return got.error();
  if (!long_enough || word(head.data()) != kGlb) {
    auto text = readText(file, 0, file.size());
    if (!text) return text.error();
    parts.json = std::move(*text);
    if (parts.json.starts_with("\xEF\xBB\xBF")) parts.json.erase(0, 3);
    return parts;
  }
  if (const uint32_t version = word(head.data() + 4); version != 2)
    return Error{ErrorKind::kUnsupported, file.path(), "expected a .glb of version 2, found " + std::to_string(version),
                 "write it as glTF 2.0", uint64_t{4}};
  const uint64_t stated = word(head.data() + 8), json_bytes = word(head.data() + 12);
  if (stated > file.size())
    return damaged(
        file,
        "expected " + std::to_string(stated) + " bytes as its header states, found " + std::to_string(file.size()), 8);
  if (word(head.data() + 16) != kJsonChunk || json_bytes > stated - std::min<uint64_t>(stated, head.size()))
    return damaged(file, "expected a JSON chunk within the " + std::to_string(stated) + " bytes of the file", 12);
  auto text = readText(file, head.size(), json_bytes);
  if (!text) return text.error();
  parts.json = std::move(*text);
  const uint64_t next = head.size() + json_bytes;
  if (stated - next < kChunkHeadBytes) return parts;
  std::array<uint8_t, kChunkHeadBytes> chunk{};
  if (auto got = file.read(next, chunk); !got) return got.error();
  if (word(chunk.data() + 4) != kBinaryChunk) return parts;
  parts.binary_offset = next + kChunkHeadBytes;
  parts.binary_bytes = word(chunk.data());
  if (parts.binary_bytes > stated - parts.binary_offset)
    return damaged(file,
                   "expected a binary chunk of " + std::to_string(parts.binary_bytes) + " bytes, found " +
                       std::to_string(stated - parts.binary_offset),
                   next);
  return parts;
}

Result<std::vector<uint8_t>> decodeDataUri(std::string_view uri, const std::string& path) {
  const auto bad = [&](const char* message) {
    return Error{ErrorKind::kInvalidData, path, message, "the file is damaged; get a whole copy, or write it anew", {}};
  };
  const size_t comma = uri.find(',');
  if (comma == uri.npos) return bad("expected a comma in a data URI, found none");
  const bool base64 = uri.substr(0, comma).ends_with(";base64");
  std::string_view text = uri.substr(comma + 1);
  std::vector<uint8_t> out;
  if (!base64) return bad("expected a data URI in base64");
  out.reserve(text.size() / 4 * 3 + 3);
  while (text.ends_with('=')) text.remove_suffix(1);
  uint32_t bits = 0;
  int have = 0;
  for (const char c : text) {
    const int six = sextet(c);
    if (six < 0) return bad("expected letters of base64 in a data URI, found another");
    bits = bits << 6 | static_cast<uint32_t>(six);
    have += 6;
    if (have < 8) continue;
    have -= 8;
    out.push_back(static_cast<uint8_t>(bits >> have));
  }
  return out;
}

Result<std::string> fileOfUri(const std::string& uri, const std::string& path) {
  const size_t colon = uri.find(':');
  if (colon != uri.npos && uri.find('/') > colon)
    return Error{ErrorKind::kUnsupported,
                 path,
                 "it names " + inQuotes(uri) + ", which is no file beside it",
                 "save what it names beside it, or write it as a .glb",
                 {}};
  std::string name;
  for (size_t i = 0; i < uri.size(); ++i) {
    const int high = uri[i] == '%' && i + 2 < uri.size() ? hexDigit(uri[i + 1]) : -1,
              low = high >= 0 ? hexDigit(uri[i + 2]) : -1;
    if (low < 0) {
      name.push_back(uri[i]);
      continue;
    }
    name.push_back(static_cast<char>(high * 16 + low));
    i += 2;
  }
  if (name.find('\0') != name.npos)
    return Error{ErrorKind::kInvalidData, path, "it names a file with a zero in its name", "", {}};
  return name;
}

Error GltfBuffers::invalid(std::string message) const {
  Error error = damaged(file_, std::move(message), 0);
  error.offset.reset();
  return error;
}

uint64_t GltfBuffers::bytes() const {
  uint64_t sum = file_.size();
  for (const Source& s : sources_)
    if (s.file != &file_) sum += s.own ? s.bytes : 0;
  for (const auto& [view, unpacked] : unpacked_) sum += unpacked.size();
  for (const auto& [of, decoded] : decoded_) sum += decoded.size();
  return sum;
}

std::vector<std::string> GltfBuffers::namedFiles() const {
  std::vector<std::string> out;
  for (const GltfBuffer& b : document_.buffers)
    if (!b.uri.empty() && !b.uri.starts_with("data:"))
      if (auto name = fileOfUri(b.uri, file_.path()); name) out.push_back(*name);
  return out;
}

Result<void> GltfBuffers::open(uint32_t buffer) {
  Source& s = sources_[buffer];
  if (s.open) return {};
  const GltfBuffer& b = document_.buffers[buffer];
  const std::string name = "buffers[" + std::to_string(buffer) + "]";
  if (b.uri.empty()) {
    if (buffer != 0 || parts_.binary_bytes == 0) return invalid("expected the data of " + name + ", found none");
    s.file = &file_;
    s.offset = parts_.binary_offset;
    s.bytes = parts_.binary_bytes;
  } else if (b.uri.starts_with("data:")) {
    auto decoded = decodeDataUri(b.uri, file_.path());
    if (!decoded) return decoded.error();
    s.decoded = std::move(*decoded);
    s.bytes = s.decoded.size();
  } else {
    auto named = fileOfUri(b.uri, file_.path());
    if (!named) return named.error();
    const std::string path = (std::filesystem::path(file_.path()).parent_path() / *named).string();
    if (!options_.allow_outside)
      if (auto beside = checkBesideMesh(file_.path(), path, "the buffer"); !beside) return beside;
    auto own = InputFile::open(path);
    if (!own) return own.error();
    s.own.emplace(std::move(*own));
    s.file = &*s.own;
    s.bytes = s.own->size();
  }
  if (s.bytes < b.bytes)
    return invalid("expected " + std::to_string(b.bytes) + " bytes of " + name + ", found " + std::to_string(s.bytes));
  s.bytes = b.bytes;
  s.open = true;
  return {};
}

Result<void> GltfBuffers::read(uint32_t buffer, uint64_t offset, std::span<uint8_t> out) {
  const Source& s = sources_[buffer];
  if (offset > s.bytes || out.size() > s.bytes - offset) return invalid("a buffer ends before what it is to hold");
  if (s.file) return s.file->read(s.offset + offset, out);
  std::memcpy(out.data(), s.decoded.data() + offset, out.size());
  return {};
}

Result<std::vector<uint8_t>> GltfBuffers::bytesOf(uint32_t view) {
  const GltfView& v = document_.views[view];
  if (auto opened = open(v.buffer); !opened) return opened.error();
  const uint64_t all = sources_[v.buffer].bytes;
  if (v.offset > all || v.bytes > all - v.offset)
    return invalid("expected bufferViews[" + std::to_string(view) + "] within its buffer of " + std::to_string(all) +
                   " bytes");
  std::vector<uint8_t> out(static_cast<size_t>(v.bytes));
  if (auto got = read(v.buffer, v.offset, out); !got) return got.error();
  return out;
}

Result<void> GltfBuffers::readView(uint32_t view, uint64_t offset, std::span<uint8_t> out) {
  const auto unpacked = unpacked_.find(view);
  if (unpacked == unpacked_.end())
    return read(document_.views[view].buffer, document_.views[view].offset + offset, out);
  std::memcpy(out.data(), unpacked->second.data() + offset, out.size());
  return {};
}

Result<void> GltfBuffers::unpack(uint32_t view, const std::string& what) {
  const GltfPacking& p = *document_.views[view].packed;
  if (unpacked_.contains(view)) return {};
  // Vertices that do not differ take a bit for four bytes; nothing takes less. Checked before the allocation.
  constexpr uint64_t kMostTimes = 64;
  if (p.count > kMostTimes * p.bytes / p.stride)
    return invalid("expected at most " + std::to_string(kMostTimes * p.bytes / p.stride) + " elements of " + what +
                   " in " + std::to_string(p.bytes) + " compressed bytes, found " + std::to_string(p.count));
  if (auto opened = open(p.buffer); !opened) return opened;
  if (const uint64_t all = sources_[p.buffer].bytes; p.offset > all || p.bytes > all - p.offset)
    return invalid("expected the compressed bytes of " + what + " within their buffer of " + std::to_string(all) +
                   " bytes");
  std::vector<uint8_t> code(static_cast<size_t>(p.bytes));
  if (auto got = read(p.buffer, p.offset, code); !got) return got;
  std::vector<uint8_t> out(static_cast<size_t>(p.count * p.stride));
  if (!decompressMeshopt(p, code, out))
    return invalid("the compressed bytes of " + what + " are no code of " + std::to_string(p.count) + " elements");
  unpacked_[view] = std::move(out);
  return {};
}

Result<void> GltfBuffers::decodeDraco(const GltfPrimitive& p, const std::string& what) {
  std::vector<DracoPart> parts;
  std::vector<uint32_t> accessors;
  const auto add = [&](uint32_t accessor, uint32_t attribute) {
    if (accessor == kNoIndex || decoded_.contains({p.draco->view, accessor})) return;
    const GltfAccessor& a = document_.accessors[accessor];
    if (a.view != kNoIndex || a.sparse) return;
    parts.push_back({attribute, a, {}});
    accessors.push_back(accessor);
  };
  add(p.positions, p.draco->positions), add(p.colours, p.draco->colours), add(p.uv, p.draco->uv);
  add(p.normals, p.draco->normals), add(p.tangents, p.draco->tangents);
  const size_t attributes = parts.size();
  add(p.indices, kNoIndex);
  if (parts.empty()) return {};
  if (p.mode != GltfPrimitive::Mode::kTriangles || p.indices == kNoIndex)
    return Error{ErrorKind::kUnsupported,
                 file_.path(),
                 what + " is stored by KHR_draco_mesh_compression in another way than as triangles with indices",
                 "write the file without compression",
                 {}};
  auto code = bytesOf(p.draco->view);
  if (!code) return code.error();
  const std::string problem = decompressDraco(*code, attributes, parts);
  if (!problem.empty()) return invalid("the compressed mesh of " + what + ": " + problem);
  for (size_t i = 0; i < parts.size(); ++i) decoded_[{p.draco->view, accessors[i]}] = std::move(parts[i].bytes);
  return {};
}

Result<void> GltfBuffers::check(uint32_t accessor, const std::string& what) {
  const GltfAccessor& a = document_.accessors[accessor];
  const auto unsupported = [&](const std::string& by) {
    return Error{ErrorKind::kUnsupported,
                 file_.path(),
                 what + " is stored by " + by + ", which this program does not read",
                 "write the file without compression",
                 {}};
  };
  if (a.sparse) return unsupported("a sparse accessor");
  if (decoded_.contains({code_, accessor})) return {};
  if (a.view == kNoIndex) return invalid("expected the data of " + what + ", found none");
  const GltfView& v = document_.views[a.view];
  if (v.packed) {
    if (auto done = unpack(a.view, what); !done) return done;
  } else if (auto opened = open(v.buffer); !opened) {
    return opened;
  }
  const uint64_t element = a.components * bytesOfComponent(a.component), stride = v.stride ? v.stride : element,
                 all = v.packed ? unpacked_[a.view].size() : sources_[v.buffer].bytes;
  const bool view_fits = v.packed ? v.bytes <= all : v.offset <= all && v.bytes <= all - v.offset;
  // count < 2^53 and stride < 2^8: the product stays below 2^61.
  const bool fits = view_fits && stride >= element && a.offset <= v.bytes &&
                    (a.count == 0 || (a.count - 1) * stride + element <= v.bytes - a.offset);
  if (fits) return {};
  return invalid("expected " + std::to_string(a.count) + " elements of " + std::to_string(element) + " bytes of " +
                 what + " within its part of the buffer, found " + std::to_string(v.bytes) + " bytes at byte " +
                 std::to_string(v.offset) + " of " + std::to_string(all));
}

Result<void> GltfBuffers::forEach(uint32_t accessor, const One& one) {
  const GltfAccessor& a = document_.accessors[accessor];
  const auto decoded = decoded_.find({code_, accessor});
  const bool has_view = decoded == decoded_.end();
  const size_t component = bytesOfComponent(a.component), element = a.components * component;
  const uint64_t own_stride = has_view ? document_.views[a.view].stride : 0, stride = own_stride ? own_stride : element;
  constexpr uint64_t kPieceBytes = uint64_t{1} << 18;
  const uint64_t piece = std::max<uint64_t>(kPieceBytes / stride, 1);
  std::vector<uint8_t> bytes;
  std::array<double, 4> values{};
  for (uint64_t first = 0; first < a.count; first += piece) {
    if (options_.interrupted && *options_.interrupted)
      return Error{ErrorKind::kInterrupted, file_.path(), "interrupted", "", {}};
    const uint64_t n = std::min(piece, a.count - first);
    bytes.resize(static_cast<size_t>((n - 1) * stride + element));
    if (has_view) {
      if (auto got = readView(a.view, a.offset + first * stride, bytes); !got) return got;
    } else {
      std::memcpy(bytes.data(), decoded->second.data() + first * stride, bytes.size());
    }
    for (uint64_t i = 0; i < n; ++i) {
      const uint8_t* p = bytes.data() + i * stride;
      for (size_t c = 0; c < std::min<size_t>(a.components, 4); ++c)
        values[c] = decode(p + c * component, a.component, a.normalized);
      if (auto done = one(first + i, values); !done) return done;
    }
  }
  return {};
}

}  // namespace relievo::mesh_file
