// The control of the runner: reads beyond a buffer for a few inputs, which it must find and report as a failure.
#include <cstdint>
#include <cstring>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size < 5 || std::memcmp(data, "RLV", 3) != 0) return 0;
  const std::vector<uint8_t> values(data + 4, data + size);
  volatile uint8_t sink = values.data()[data[3]];  // an index that nobody checked
  (void)sink;
  return 0;
}
