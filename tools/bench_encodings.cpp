#include "tools/bench_groups.h"

namespace relievo {

Result<void> encodingsBench(BenchContext&) { return {}; }

}  // namespace relievo
