// request_source.h - who says which texture pages a view needs.
#pragma once

namespace relievo {

// How the texture pages that a view wants are found. kFeedback: a small picture of requests, read back
// (src/render/feedback_pass.h). kGeometry: from the view and the heights' bounds on the LOD worker, without a pass
// (geometry/lod/texture_select.h); exact for flat artworks, too fine at a slant with relief. kBoth: the union. Over a
// base mesh it is kFeedback, whatever is asked for.
enum class RequestSource { kFeedback, kGeometry, kBoth };

}  // namespace relievo
