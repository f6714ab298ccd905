#include "tools/bench_groups.h"

namespace relievo {

Result<void> replacementBench(BenchContext&) { return {}; }
Result<void> prefetchBench(BenchContext&) { return {}; }

}  // namespace relievo
