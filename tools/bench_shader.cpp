#include "tools/bench_groups.h"

namespace relievo {

Result<void> shaderBench(BenchContext&) { return {}; }

}  // namespace relievo
