// compare_tables.h - rows of a comparison as tables: of a page, as CSV, and as LaTeX (booktabs). Pure.
#pragma once

#include "tools/compare/compare_rows.h"

namespace relievo {

// Two tables, each narrow enough for a page of 1,200 px: what is off, and what it costs.
std::string errorTableHtml(const std::vector<CompareRow>& rows);
std::string costTableHtml(const std::vector<CompareRow>& rows);
std::string equalErrorTableHtml(const EqualError& equal);

// artwork: the first column's text in each row, or empty: no such column.
std::string rowsCsv(const std::vector<CompareRow>& rows, const std::string& artwork, bool head);
std::string rowsLatex(const std::vector<CompareRow>& rows, const std::string& caption);

}  // namespace relievo
