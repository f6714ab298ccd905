// request_source.h - where the list of a view's texture pages comes from.
#pragma once

namespace relievo {

// kFeedback: a small picture of requests is drawn and read back (src/render/feedback_pass.h).
// kGeometry: the LOD worker derives the pages from the view and the heights' bounds, without a pass
// (geometry/lod/texture_select.h); exact for flat artworks, too fine in slanted views of relief.
// kBoth: the union. Artworks over a base mesh use kFeedback, whatever is asked for.
enum class RequestSource { kFeedback, kGeometry, kBoth };

}  // namespace relievo
