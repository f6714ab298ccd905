// One writer of files (src/base/output_file) and one of standard output (src/base/standard_output): nothing else in the
// program opens a file to write or prints, so that no error of writing is overlooked.
#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

namespace relievo {
namespace one_writer_test {

namespace fs = std::filesystem;

struct Rule {
  std::vector<std::string> words;
  std::vector<std::string> allowed;  // files that may
};

const std::vector<Rule> kRules = {
    {{"ofstream", "std::fstream"}, {}},
    {{"fopen("}, {"tools/build_mesh.cpp"}},  // of /proc/self, for peak memory
    {{"O_CREAT", "creat(", "rename("}, {"src/base/output_file.cpp"}},
    {{"O_TMPFILE", "mkstemp(", "mkstemps(", "mkostemp("},
     {"src/base/output_file.cpp", "texturing/package/package_writer.cpp"}},  // files without a name
    {{"printf(", "vprintf(", "puts(", "putchar(", "cout", "stdout"}, {}},
    {{"ImageOutput::create("}, {"texturing/import/image_encode_oiio.cpp"}},
};

// Without comments and without what stands in quotes.
std::string code(const std::string& text) {
  std::string out;
  for (size_t i = 0; i < text.size(); ++i) {
    if (text.compare(i, 2, "//") == 0) {
      i = std::min(text.find('\n', i), text.size()) - 1;
    } else if (text[i] == '"' && (i == 0 || text[i - 1] != '\'')) {
      for (++i; i < text.size() && text[i] != '"' && text[i] != '\n'; ++i) i += text[i] == '\\';
      out += '"';
    } else {
      out += text[i];
    }
  }
  return out;
}

bool hasWord(const std::string& text, const std::string& word) {
  const auto letter = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_'; };
  for (size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) {
    const size_t end = at + word.size();
    if ((at == 0 || !letter(text[at - 1])) && (word.back() == '(' || end == text.size() || !letter(text[end])))
      return true;
  }
  return false;
}

std::vector<std::string> offences(const std::string& name, const std::string& text) {
  std::vector<std::string> found;
  const std::string cleaned = code(text);
  for (const Rule& rule : kRules) {
    if (std::find(rule.allowed.begin(), rule.allowed.end(), name) != rule.allowed.end()) continue;
    for (const std::string& word : rule.words)
      if (hasWord(cleaned, word)) found.push_back(name + ": " + word);
  }
  return found;
}

TEST(OneWriter, NothingElseWritesOrPrints) {
  int files = 0;
  for (const char* folder : {"src", "geometry", "texturing", "tools"}) {
    for (const auto& entry : fs::recursive_directory_iterator(fs::path(RELIEVO_SOURCES) / folder)) {
      if (entry.path().extension() != ".cpp" && entry.path().extension() != ".h") continue;
      std::ifstream in(entry.path(), std::ios::binary);
      const std::string text{std::istreambuf_iterator<char>(in), {}};
      for (const std::string& offence : offences(fs::relative(entry.path(), RELIEVO_SOURCES).string(), text))
        ADD_FAILURE() << offence;
      ++files;
    }
  }
  EXPECT_GT(files, 100) << "the sources were not found";
}

TEST(OneWriter, SeesWhatItLooksFor) {
  for (const char* offence :
       {"std::printf(\"x\");", "printf(x);", "puts(x);", "std::fputs(x, stdout);", "std::cout << 1;",
        "std::ofstream out(path);", "FILE* f = fopen(path, mode);", "open(path, O_WRONLY | O_CREAT);",
        "::rename(a, b);", "std::filesystem::rename(a, b);", "mkstemp(name);"})
    EXPECT_EQ(offences("tools/x.cpp", offence).size(), 1u) << offence;
  for (const char* fine : {"std::fprintf(stderr, \"x\");", "std::snprintf(text, 3, \"x\");", "printOutf(\"printf(\");",
                           "// printf(x)", "std::ifstream in(path);"})
    EXPECT_TRUE(offences("tools/x.cpp", fine).empty()) << fine;
}

}  // namespace one_writer_test
}  // namespace relievo
