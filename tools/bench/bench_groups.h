// bench_groups.h - the groups of `relievo bench`, in the order in which they run: name, function NAMEBench, purpose.
#pragma once

#include "tools/bench/bench.h"

#define RELIEVO_BENCH_GROUPS(G)                                                                                \
  G("cold-start", coldStart, "from the program's start to a first and to a settled 1280x720 picture")          \
  G("feedback", feedback, "the feedback pass at 1/8 of 1280x720: issue, read, analyse")                        \
  G("request-source", requestSource, "which pages a view requests: feedback, edge LOD on the CPU, both")       \
  G("page-table", pageTable, "updates of the page table, and what a resident page costs beside its texels")    \
  G("page-latency", pageLatency, "one page, from wanted to visible")                                           \
  G("decode", decode, "reading, decoding and uploading pages, sustained")                                      \
  G("streaming", streaming, "frame time while pages stream")                                                   \
  G("frame-time", frameTime, "a moving frame along a flight, exact and held at 33 ms; what its parts take")    \
  G("shader", shader, "the virtual texture's shader against the same shader with dense textures")              \
  G("replacement", replacement, "hit rates of replacement policies on three flights")                          \
  G("prefetch", prefetch, "pixels a level too coarse with and without prefetch, at 20 MB/s and 50 ms latency") \
  G("encodings", encodings, "page encodings: what accuracy costs in size and time")                            \
  G("relief-memory", reliefMemory, "what the finest triangles take of the page cache; of scans, too")          \
  G("mesh-lod", meshLod, "edge LOD of many patches over a base mesh")                                          \
  G("mesh-patches", patches, "a scene of 24,300 patches at 1280x720")                                          \
  G("mesh-build", meshBuild, "a scan into a package: time and memory; and what it takes to draw it")

namespace relievo {

#define RELIEVO_DECLARE(name, function, purpose) Result<void> function##Bench(BenchContext& context);
RELIEVO_BENCH_GROUPS(RELIEVO_DECLARE)
#undef RELIEVO_DECLARE

}  // namespace relievo
