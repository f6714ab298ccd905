// Files that appear whole or not at all: what stands at the target, what is left by processes that were killed, and
// what is no file.
#include <fcntl.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "src/base/file.h"

namespace relievo {
namespace output_file_test {

namespace fs = std::filesystem;

std::span<const uint8_t> bytes(const std::string& text) {
  return {reinterpret_cast<const uint8_t*>(text.data()), text.size()};
}

class OutputFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "relievo-output-XXXXXX").string();
    folder_ = mkdtemp(pattern.data());
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string at(const std::string& name) const { return (folder_ / name).string(); }
  void put(const std::string& name, const std::string& text) const {
    std::ofstream(at(name), std::ios::binary) << text;
  }
  std::string get(const std::string& name) const {
    std::ifstream in(at(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  std::vector<std::string> partFiles() const {
    std::vector<std::string> names;
    for (const auto& e : fs::directory_iterator(folder_))
      if (e.path().filename().string().find(".part-") != std::string::npos)
        names.push_back(e.path().filename().string());
    return names;
  }
  mode_t modeOf(const std::string& name) const {
    struct stat st {};
    EXPECT_EQ(::stat(at(name).c_str(), &st), 0) << std::strerror(errno);
    return st.st_mode & 07777;
  }
  // Another process that writes half of a file and waits. It ends with the pipe that keeps it, or by the signal that
  // the test sends.
  pid_t writerOf(const std::string& name) const {
    std::array<int, 2> ready{};
    EXPECT_EQ(::pipe(ready.data()), 0);
    const pid_t child = ::fork();
    if (child == 0) {
      Result<OutputFile> file = OutputFile::create(at(name));
      if (file.ok() && file->append(bytes("half")).ok() && ::write(ready[1], "x", 1) == 1) ::pause();
      ::_exit(9);
    }
    ::close(ready[1]);
    char byte = 0;
    EXPECT_EQ(::read(ready[0], &byte, 1), 1) << "the other process could not create its file";
    ::close(ready[0]);
    return child;
  }
  static void kill(pid_t child) {
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);
  }
  fs::path folder_;
};

TEST_F(OutputFiles, KeepTheModeOfWhatTheyReplace) {
  for (const mode_t mode : {0600u, 0640u, 0755u, 0444u}) {
    put("out", "before");
    ASSERT_EQ(::chmod(at("out").c_str(), mode), 0);
    {
      Result<OutputFile> file = OutputFile::create(at("out"));
      ASSERT_TRUE(file.ok());
      struct stat st {};
      ASSERT_EQ(::stat(file->partPath().c_str(), &st), 0);
      EXPECT_EQ(st.st_mode & 07777 & ~mode, 0u)
          << "while it is written others may read what they may not read in the end";
      ASSERT_TRUE(file->append(bytes("after")).ok());
      ASSERT_TRUE(file->commit().ok());
    }
    EXPECT_EQ(modeOf("out"), mode);
    EXPECT_EQ(get("out"), "after");
    fs::remove(at("out"));
  }
  const mode_t mask = ::umask(027);
  ASSERT_TRUE(writeFile(at("new"), bytes("x")).ok());
  ::umask(mask);
  EXPECT_EQ(modeOf("new"), 0640u) << "a new file: what the umask leaves";
}

TEST_F(OutputFiles, KeepTheGroupOfWhatTheyReplace) {
  if (::geteuid() != 0) GTEST_SKIP() << "only root may give files away";
  put("out", "before");
  ASSERT_EQ(::chown(at("out").c_str(), 65534, 65533), 0);
  ASSERT_EQ(::chmod(at("out").c_str(), 0660), 0);
  ASSERT_TRUE(writeFile(at("out"), bytes("after")).ok());
  struct stat st {};
  ASSERT_EQ(::stat(at("out").c_str(), &st), 0);
  EXPECT_EQ(st.st_uid, 65534u);
  EXPECT_EQ(st.st_gid, 65533u);
  EXPECT_EQ(st.st_mode & 07777, 0660u);
}

TEST_F(OutputFiles, FollowASymbolicLinkAndLeaveIt) {
  fs::create_directory(at("there"));
  put("there/real", "before");
  fs::create_symlink("there/real", at("link"));
  fs::create_symlink(at("link"), at("again"));
  ASSERT_TRUE(writeFile(at("again"), bytes("after")).ok());
  EXPECT_EQ(get("there/real"), "after");
  EXPECT_TRUE(fs::is_symlink(at("link")) && fs::is_symlink(at("again")));
  fs::create_symlink("there/new", at("dangling"));
  ASSERT_TRUE(writeFile(at("dangling"), bytes("made")).ok());
  EXPECT_EQ(get("there/new"), "made");
  EXPECT_TRUE(fs::is_symlink(at("dangling")));
  fs::create_symlink("loop", at("loop"));
  EXPECT_FALSE(writeFile(at("loop"), bytes("x")).ok());
  fs::create_symlink("there", at("folder"));
  EXPECT_FALSE(writeFile(at("folder"), bytes("x")).ok());
}

// Who knows the name that the file beside will have could make the program write elsewhere.
TEST_F(OutputFiles, ArePlantedNowhere) {
  put("victim", "precious");
  const std::string guess = at("out") + ".part-" + std::to_string(::getpid());
  fs::create_symlink(at("victim"), guess);
  for (int n = 0; n < 20; ++n) fs::create_symlink(at("victim"), guess + "-" + std::to_string(n));
  ASSERT_TRUE(writeFile(at("out"), bytes("attack")).ok());
  EXPECT_EQ(get("victim"), "precious");
  EXPECT_EQ(get("out"), "attack");
  EXPECT_FALSE(fs::is_symlink(at("out")));
  // No two names are alike.
  Result<OutputFile> one = OutputFile::create(at("out")), two = OutputFile::create(at("out"));
  ASSERT_TRUE(one.ok() && two.ok());
  EXPECT_NE(one->partPath(), two->partPath());
  EXPECT_GE(one->partPath().size(), guess.size() + 17);
}

TEST_F(OutputFiles, LeftByAProcessThatWasKilledGoWithTheNextOne) {
  for (const pid_t child : {writerOf("out"), writerOf("out"), writerOf("other")}) kill(child);
  ASSERT_EQ(partFiles().size(), 3u);
  ASSERT_TRUE(writeFile(at("out"), bytes("after")).ok());
  ASSERT_EQ(partFiles().size(), 1u) << "of the same target both, of another one none";
  EXPECT_EQ(partFiles()[0].rfind("other", 0), 0u);
  EXPECT_EQ(get("out"), "after");
}

// Targets whose names are never written again: only those that are asked for, and none that is still written.
TEST_F(OutputFiles, LeftUnderOtherNamesGoWhenAskedFor) {
  for (const pid_t child : {writerOf("new-1"), writerOf("new-2"), writerOf("other")}) kill(child);
  const pid_t living = writerOf("new-3");
  put("new-4", "not a part file");
  ASSERT_EQ(partFiles().size(), 4u);
  OutputFile::removeOrphans(folder_.string(), [](std::string_view target) { return target.substr(0, 4) == "new-"; });
  std::vector<std::string> left = partFiles();
  std::sort(left.begin(), left.end());
  ASSERT_EQ(left.size(), 2u);
  EXPECT_EQ(left[0].rfind("new-3.", 0), 0u) << "it is still written";
  EXPECT_EQ(left[1].rfind("other.", 0), 0u) << "it was not asked for";
  EXPECT_TRUE(fs::exists(at("new-4")));
  kill(living);
}

TEST_F(OutputFiles, OfAProcessThatLivesStay) {
  const pid_t child = writerOf("out");
  ASSERT_EQ(partFiles().size(), 1u);
  ASSERT_TRUE(writeFile(at("out"), bytes("mine")).ok());
  EXPECT_EQ(partFiles().size(), 1u) << "the file of a process that still writes it was taken away";
  kill(child);
  ASSERT_TRUE(writeFile(at("out"), bytes("mine")).ok());
  EXPECT_EQ(partFiles().size(), 0u);
}

// Whatever is not exactly a part file of ours is not taken away, however alike its name is.
TEST_F(OutputFiles, OfOthersAreLeftAlone) {
  const std::string digits = "0123456789abcdef";
  const std::vector<std::string> names{"out.part-12",
                                       "out.part-12-" + digits + "0",
                                       "out.part-12-" + digits.substr(1),
                                       "out.part--" + digits,
                                       "out.part-x12-" + digits,
                                       "out.part-12-" + std::string(16, 'G'),
                                       "xout.part-12-" + digits,
                                       "out.part-12-" + digits + ".tif"};
  for (const std::string& name : names) put(name, "not ours");
  fs::create_directory(at("out.part-13-" + digits));
  put("elsewhere", "not ours");
  fs::create_symlink(at("elsewhere"), at("out.part-14-" + digits));
  ASSERT_EQ(::mkfifo(at("out.part-15-" + digits).c_str(), 0600), 0);
  put("out.part-16-" + digits, "an orphan");
  ASSERT_TRUE(writeFile(at("out"), bytes("x")).ok());
  EXPECT_FALSE(fs::exists(at("out.part-16-" + digits))) << "the control: a file of this very name is one";
  for (const std::string& name : names) EXPECT_EQ(get(name), "not ours") << name;
  EXPECT_TRUE(fs::is_directory(at("out.part-13-" + digits)));
  EXPECT_TRUE(fs::is_symlink(at("out.part-14-" + digits)));
  EXPECT_TRUE(fs::is_fifo(at("out.part-15-" + digits)));
  EXPECT_EQ(get("elsewhere"), "not ours");
}

TEST_F(OutputFiles, OfTheLongestNames) {
  for (const size_t size : {200u, 224u, 225u, 240u, 255u}) {
    const std::string name(size, 'n');
    ASSERT_TRUE(writeFile(at(name), bytes("x")).ok()) << size;
    EXPECT_EQ(get(name), "x");
  }
  EXPECT_FALSE(writeFile(at(std::string(256, 'n')), bytes("x")).ok());
  EXPECT_TRUE(partFiles().empty());
}

// A write that failed leaves a hole; whatever is written after it, the file does not take its place.
TEST_F(OutputFiles, WithAHoleAreNeverCommitted) {
  put("out", "before");
  Result<OutputFile> file = OutputFile::create(at("out"));
  ASSERT_TRUE(file.ok());
  ASSERT_FALSE(file->writeAt(uint64_t{1} << 62, bytes("too far")).ok());
  ASSERT_TRUE(file->append(bytes("after")).ok());
  EXPECT_FALSE(file->commit().ok());
  EXPECT_EQ(get("out"), "before");
}

TEST_F(OutputFiles, ChangedByOthersAreNotCommitted) {
  put("out", "before");
  for (const char* change : {"longer", ""}) {
    Result<OutputFile> file = OutputFile::create(at("out"));
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE(file->writeAt(0, bytes("aft")).ok());
    std::ofstream(file->partPath(), std::ios::binary) << change;
    Result<void> committed = file->commit();
    ASSERT_FALSE(committed.ok());
    EXPECT_EQ(committed.error().kind, ErrorKind::kIo);
    EXPECT_EQ(get("out"), "before");
  }
  EXPECT_TRUE(partFiles().empty());
}

// Devices and pipes get the bytes; they are never replaced.
TEST_F(OutputFiles, ToDevicesAreWrittenStraight) {
  std::string null = "/dev/null", full = "/dev/full";
  if (::geteuid() == 0) {
    // Devices of the test's own: a root whose program replaces them would replace the machine's.
    null = at("null"), full = at("full");
    if (::mknod(null.c_str(), S_IFCHR | 0666, makedev(1, 3)) != 0 ||
        ::mknod(full.c_str(), S_IFCHR | 0666, makedev(1, 7)) != 0 || ::access(null.c_str(), W_OK) != 0)
      GTEST_SKIP() << "root may make no devices here: " << std::strerror(errno);
    const int fd = ::open(null.c_str(), O_WRONLY | O_CLOEXEC);
    if (fd < 0) GTEST_SKIP() << "devices do not work in " << folder_ << ": " << std::strerror(errno);
    ::close(fd);
  }
  struct stat before {
  }, after{};
  ASSERT_EQ(::stat(null.c_str(), &before), 0);
  ASSERT_TRUE(writeFile(null, bytes("x")).ok());
  ASSERT_EQ(::stat(null.c_str(), &after), 0);
  EXPECT_TRUE(S_ISCHR(after.st_mode) && before.st_ino == after.st_ino) << "the device was replaced";
  Result<void> written = writeFile(full, bytes("x"));
  ASSERT_FALSE(written.ok());
  EXPECT_EQ(written.error().kind, ErrorKind::kIo);
  EXPECT_EQ(written.error().file, full);
  ASSERT_EQ(::stat(full.c_str(), &after), 0);
  EXPECT_TRUE(S_ISCHR(after.st_mode));
}

TEST_F(OutputFiles, ToPipesAreWrittenStraightOnceTheyAreWhole) {
  ASSERT_EQ(::mkfifo(at("pipe").c_str(), 0600), 0);
  Result<void> unread = writeFile(at("pipe"), bytes("x"));
  ASSERT_FALSE(unread.ok()) << "and does not wait";
  EXPECT_NE(unread.error().text().find("nobody reads"), std::string::npos) << unread.error().text();
  const int reader = ::open(at("pipe").c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  ASSERT_GE(reader, 0);
  {
    Result<OutputFile> file = OutputFile::create(at("pipe"));
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE(file->append(bytes("hello world")).ok());
    ASSERT_TRUE(file->writeAt(0, bytes("H")).ok());
    char text[64];
    EXPECT_LE(::read(reader, text, sizeof text), 0) << "nothing before it is whole";
    ASSERT_TRUE(file->commit().ok());
    const ssize_t size = ::read(reader, text, sizeof text);
    EXPECT_EQ(std::string(text, size > 0 ? static_cast<size_t>(size) : 0), "Hello world");
  }
  {
    Result<OutputFile> file = OutputFile::create(at("pipe"));  // given up: the pipe sees nothing of it
    ASSERT_TRUE(file.ok() && file->append(bytes("half")).ok());
  }
  char byte = 0;
  EXPECT_LE(::read(reader, &byte, 1), 0);
  ::close(reader);
  EXPECT_TRUE(fs::is_fifo(at("pipe")));
}

// A socket in the folder, for what opens neither.
void makeSocket(const std::string& path) {
  const int fd = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  ASSERT_LT(path.size(), sizeof name.sun_path);
  std::memcpy(name.sun_path, path.c_str(), path.size() + 1);
  ASSERT_EQ(::bind(fd, reinterpret_cast<const sockaddr*>(&name), sizeof name), 0) << std::strerror(errno);
  ::close(fd);
}

TEST_F(OutputFiles, TargetsThatAreNoFilesAreRefusedByName) {
  makeSocket(at("socket"));
  for (const auto& [path, what] : {std::pair{at("socket"), "socket"}, {folder_.string(), "folder"}}) {
    Result<void> written = writeFile(path, bytes("x"));
    ASSERT_FALSE(written.ok());
    EXPECT_EQ(written.error().kind, ErrorKind::kIo);
    EXPECT_NE(written.error().text().find(what), std::string::npos) << written.error().text();
    EXPECT_FALSE(OutputFile::check(path).ok());
  }
  EXPECT_TRUE(fs::is_socket(at("socket")));
  EXPECT_TRUE(OutputFile::check(at("new")).ok());
  EXPECT_FALSE(OutputFile::check(at("none/new")).ok());
  EXPECT_TRUE(OutputFile::check("/dev/null").ok());
}

// Opening a pipe waits for its writer, opening a device may make it act: neither is opened.
TEST_F(OutputFiles, InputsThatAreNoFilesAreRefusedByNameWithoutWaiting) {
  ASSERT_EQ(::mkfifo(at("pipe").c_str(), 0600), 0);
  makeSocket(at("socket"));
  fs::create_symlink("pipe", at("link"));
  for (const auto& [path, what] : {std::pair{at("pipe"), "a pipe"},
                                   {at("link"), "a pipe"},
                                   {at("socket"), "a socket"},
                                   {std::string("/dev/null"), "a character device"},
                                   {std::string("/dev/zero"), "a character device"},
                                   {folder_.string(), "a folder"}}) {
    Result<InputFile> file = InputFile::open(path);
    ASSERT_FALSE(file.ok()) << path;
    EXPECT_EQ(file.error().kind, ErrorKind::kIo);
    EXPECT_EQ(file.error().file, path);
    EXPECT_NE(file.error().text().find(what), std::string::npos) << file.error().text();
    EXPECT_FALSE(readTextFile(path, 100).ok());
    EXPECT_FALSE(hashFile(path).ok());
  }
  put("file", "text");
  fs::create_symlink("file", at("good"));
  EXPECT_TRUE(InputFile::open(at("good")).ok()) << "the control: a link to a file is a file";
}

}  // namespace output_file_test
}  // namespace relievo
