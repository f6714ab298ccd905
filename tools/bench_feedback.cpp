#include "tools/bench_groups.h"

namespace relievo {

Result<void> feedbackBench(BenchContext&) { return {}; }
Result<void> determinationBench(BenchContext&) { return {}; }

}  // namespace relievo
