// bake_texels.h - the texture of a patch: the scan's colours and normals, or the channels of its image.
// Shape: a patch has texelsASide(its depth) texels a side; one plane for each channel, rows of v from 0. Const: any
// thread.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/bake/bake_context.h"
#include "geometry/bake/baked_heights.h"
#include "geometry/bake/mip_image.h"
#include "src/artwork/patch_domain.h"
#include "src/artwork/tangent_frames.h"

namespace relievo {

struct PatchResolution {
  int depth = 0;
  int sample_grid_log2 = 0;  // colours and normals are sampled on a grid of 2^this cells and interpolated, but for
                             // cells that a crease or a border of plain colours crosses; at least the texels: at each
                             // texel
  bool plain = false;        // its colours are those of whole triangles, not of an image
  // Where it shows images itself (ImagesOnPatch), and needs no texels: its finest level, kNoTexturePage where its tail
  // shows all of them. Else none.
  std::optional<int> shown_depth;
};
struct BakeTexture {
  struct Image {
    MipImage texels;
    bool palette = false;   // of colours that whole triangles have
    bool has_file = false;  // MeshBake::Image::has_file
    bool shown = false;     // by patches themselves
    MipImage normals;       // MeshBake::Image::normals; or empty
    bool normals_downwards = false;
    glm::ivec2 places{0};  // texels of image or normals, along x and along y, whichever has more
  };
  std::vector<Image> images;  // that TriMesh::image_of names
  bool planes = false;        // the channels of the one image become the texture, in place of colour and normal
  bool one_colour = false;    // the one image is a palette of one colour, which all triangles have
  // The image that a triangle shows, or nullptr.
  const Image* imageOf(const TriMesh& mesh, uint32_t triangle) const {
    if (images.empty()) return nullptr;
    const uint16_t image = mesh.image_of.empty() ? uint16_t{0} : mesh.image_of[triangle];
    return image == kNoImage ? nullptr : &images[image];
  }
  // A triangle's coordinates in its image.
  std::array<glm::vec2, 3> coordinates(const TriMesh& mesh, uint32_t triangle) const {
    return one_colour ? std::array<glm::vec2, 3>{} : mesh.corner_uv[triangle];
  }
  // Those of the mesh's triangles, where images have maps of normals and patches have texels; or none.
  std::vector<TangentFrame> frames;
  // texture_resolution.h
  int depth = 0;                          // the largest of all patches, shown ones included
  std::vector<PatchResolution> of_patch;  // one for each
};

// The frames of triangles whose image has a map of normals. Empty: no image has one.
std::vector<TangentFrame> tangentFrames(const BakeContext& context, const BakeTexture& texture);

// Fills the texels of one patch. deviation_mm: the distance between baked surface and scan, which bounds the search.
// False: the bake was interrupted.
bool bakeTexels(const BakeContext& context, const BakedHeights& baked, const BakeTexture& texture, double deviation_mm,
                uint32_t patch, std::span<uint8_t> out);

}  // namespace relievo
