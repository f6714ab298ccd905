#include "tools/sample_kinds.h"
namespace relievo::sample {
std::unique_ptr<Kind> makeCoin(const SampleOptions& options) { return makeInscription(options); }
}
