#include "tools/bench_groups.h"

namespace relievo {

Result<void> pageLatencyBench(BenchContext&) { return {}; }
Result<void> decodeBench(BenchContext&) { return {}; }
Result<void> streamingBench(BenchContext&) { return {}; }

}  // namespace relievo
