// The program's own large arrays lie in memory that asks for huge pages: what /proc/self/smaps says of them.
#include <gtest/gtest.h>

#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <new>
#include <sstream>
#include <string>
#include <vector>

namespace relievo::large_blocks_test {
namespace {

// The flags of the mapping that has the address; empty: none has it.
std::string flagsAt(const void* address) {
  const auto at = reinterpret_cast<uintptr_t>(address);
  std::ifstream maps("/proc/self/smaps");
  bool here = false;
  for (std::string line; std::getline(maps, line);) {
    uintptr_t begin = 0, end = 0;
    char dash = 0;
    std::istringstream range(line);
    if (line.find(':') > line.find('-') && range >> std::hex >> begin >> dash >> end) here = begin <= at && at < end;
    if (here && line.starts_with("VmFlags:")) return line + " ";
  }
  return "";
}
bool asksForHugePages(const void* address) { return flagsAt(address).find(" hg ") != std::string::npos; }
bool systemHasHugePages() {
  return std::ifstream("/sys/kernel/mm/transparent_hugepage/enabled").is_open() && !flagsAt(&errno).empty();
}

constexpr size_t kMiB = size_t{1} << 20;

TEST(LargeBlocks, AskForHugePages) {
  if (!systemHasHugePages()) GTEST_SKIP() << "the system has no huge pages, or does not say where they are";
  std::vector<uint8_t> large(9 * kMiB + 123, 1), small(3 * kMiB, 1);
  const auto array = std::make_unique<uint32_t[]>(2 * kMiB);
  EXPECT_TRUE(asksForHugePages(large.data()));
  EXPECT_TRUE(asksForHugePages(large.data() + 9 * kMiB - 8192));
  EXPECT_TRUE(asksForHugePages(array.get()));
  EXPECT_FALSE(asksForHugePages(small.data())) << "control";
}

// A library's own: memory that malloc gives.
TEST(LargeBlocks, ThoseOfLibrariesAreMallocs) {
  if (!systemHasHugePages()) GTEST_SKIP() << "the system has no huge pages, or does not say where they are";
  const std::unique_ptr<void, decltype(&std::free)> block(std::malloc(40 * kMiB), &std::free);
  EXPECT_FALSE(asksForHugePages(block.get()));
}

TEST(LargeBlocks, TooLargeOnesAreRefusedAsEver) {
  const volatile size_t most = SIZE_MAX / 2;
  EXPECT_THROW(std::vector<uint8_t>().reserve(most), std::bad_alloc);
  EXPECT_THROW(std::make_unique<uint8_t[]>(most), std::bad_alloc);
}

}  // namespace
}  // namespace relievo::large_blocks_test
