// gltf_buffers.h - where the numbers of a glTF file lie: the chunks of a .glb, the files that a .gltf names, data URIs.
// Every access is checked against what is there. Internal to mesh_read_gltf.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "geometry/scan/gltf_document.h"
#include "geometry/scan/mesh_file.h"
#include "src/base/file.h"

namespace relievo::mesh_file {

// A file's JSON, and the place of its binary chunk.
struct GltfParts {
  std::string json;
  uint64_t binary_offset = 0, binary_bytes = 0;
};
// By its first bytes a .glb, else a .gltf, whatever its name says.
Result<GltfParts> readGltfParts(const InputFile& file);

// "data:[type][;base64],..." decoded; kInvalidData where it is none.
Result<std::vector<uint8_t>> decodeDataUri(std::string_view uri, const std::string& path);
// A relative URI as a file's name beside the mesh: %20 is a blank. kUnsupported: it has a scheme (http:).
Result<std::string> fileOfUri(const std::string& uri, const std::string& path);

class GltfBuffers {
 public:
  GltfBuffers(const InputFile& file, const GltfDocument& document, const GltfParts& parts,
              const MeshReadOptions& options)
      : file_(file), document_(document), parts_(parts), options_(options), sources_(document.buffers.size()) {}

  // Bytes of the file and of the buffers that were opened so far: what memory may follow.
  uint64_t bytes() const;
  // The files that buffers name, opened or not.
  std::vector<std::string> namedFiles() const;
  // All of a view.
  Result<std::vector<uint8_t>> bytesOf(uint32_t view);
  // Whether an accessor's elements lie in its buffer; what: for errors ("POSITION of mesh 2"). It opens the buffer, and
  // decompresses the view.
  Result<void> check(uint32_t accessor, const std::string& what);
  // Decodes what accessors without a view stand for, for check() and forEach(). Primitives may share an accessor that
  // each has a code of its own for.
  Result<void> decodeDraco(const GltfPrimitive& primitive, const std::string& what);
  // Whose accessors check() and forEach() are asked for from now on.
  void select(const GltfPrimitive& primitive) { code_ = primitive.draco ? primitive.draco->view : kNoIndex; }
  // Calls one(index, components) for each element of a checked accessor, in order. Of a normalized one they are 0..1
  // or -1..1.
  using One = std::function<Result<void>(uint64_t, const std::array<double, 4>&)>;
  Result<void> forEach(uint32_t accessor, const One& one);

 private:
  struct Source {
    std::optional<InputFile> own;
    std::vector<uint8_t> decoded;  // of a data URI
    const InputFile* file = nullptr;
    uint64_t offset = 0, bytes = 0;
    bool open = false;
  };
  Result<void> open(uint32_t buffer);
  Result<void> unpack(uint32_t view, const std::string& what);
  // Of a view that was checked.
  Result<void> readView(uint32_t view, uint64_t offset, std::span<uint8_t> out);
  Result<void> read(uint32_t buffer, uint64_t offset, std::span<uint8_t> out);
  Error invalid(std::string message) const;

  const InputFile& file_;
  const GltfDocument& document_;
  const GltfParts& parts_;
  const MeshReadOptions& options_;
  std::vector<Source> sources_;
  std::map<uint32_t, std::vector<uint8_t>> unpacked_;                // by view
  std::map<std::array<uint32_t, 2>, std::vector<uint8_t>> decoded_;  // by the code's view and accessor, without gaps
  uint32_t code_ = kNoIndex;                                         // the view of the selected primitive's
};

}  // namespace relievo::mesh_file
