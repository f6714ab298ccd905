#include "tools/bench_groups.h"

namespace relievo {

Result<void> pageTableBench(BenchContext&) { return {}; }

}  // namespace relievo
