#include "tools/bench_groups.h"

namespace relievo {

Result<void> coldStartBench(BenchContext&) { return {}; }

}  // namespace relievo
