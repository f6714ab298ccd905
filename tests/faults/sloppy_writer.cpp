// sloppy_writer - takes the place of the program as the negative control of fault_driver: it writes straight into the
// target, looks at no result, and says that all went well.
#include <fcntl.h>
#include <unistd.h>

#include <cstring>
#include <string>

int main(int argc, char** argv) {
  std::string path;
  for (int i = 1; i + 1 < argc; ++i)
    if (std::strcmp(argv[i], "-o") == 0) path = argv[i + 1];
  const int fd = open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
  const std::string page(size_t{1} << 16, 'p');
  ssize_t unlooked_at = 0;
  for (int i = 0; i < 40; ++i) unlooked_at += write(fd, page.data(), page.size());
  unlooked_at += fsync(fd);
  unlooked_at += close(fd);
  return 0;
}
