#include "tools/sample_kinds.h"
namespace relievo::sample {
std::unique_ptr<Kind> makePainting(const SampleOptions& options) { return makeInscription(options); }
}
