// compare_merge.h - several comparisons, of other artworks or on other machines, as one report: what
// `relievo compare --merge` writes from the report.json files of earlier ones.
#pragma once

#include <string>
#include <vector>

#include "src/base/result.h"
#include "tools/compare/compare_rows.h"

namespace relievo {

struct MergedPart {
  std::string file;     // as given
  std::string artwork;  // the package's name
  std::string renderer, view;
  CompareOrigin origin;
  std::vector<CompareRow> rows;
};
// Safe for untrusted text. kIo: it cannot be read. kInvalidData: it is no report of relievo compare, or lacks a member.
Result<MergedPart> readComparison(const std::string& path);
Result<MergedPart> parseComparison(const std::string& text, const std::string& path);

// In sentences, over all parts: who draws least, and by how much on the geometric mean of those that all have.
std::string mergedConclusion(const std::vector<MergedPart>& parts);
// One file that needs no other one; light and dark.
std::string mergedHtml(const std::vector<MergedPart>& parts, const std::string& command, const std::string& date);
std::string mergedCsv(const std::vector<MergedPart>& parts);
std::string mergedLatex(const std::vector<MergedPart>& parts);

}  // namespace relievo
