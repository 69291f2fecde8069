// Pieces of pages that our programs write: escaped text and line charts.
#pragma once

#include <string>
#include <vector>

namespace pleat {

/// The text as it stands between tags or in a quoted attribute.
std::string escape_html(const std::string& text);

/// A line of a chart: y over x, as long as each other. A value that is not finite leaves a gap.
struct ChartLine {
  std::string name, color;  ///< colour as in CSS
  std::vector<double> x, y;
};

struct LineChart {
  std::string title;
  std::string unit;          ///< of y; goes into the legend
  bool logarithmic = false;  ///< in y; values that are not above 0 leave gaps
  std::vector<ChartLine> lines;
};

/// The rules that line_chart() needs in a page's style sheet.
extern const char* const kChartStyle;

/// Heading, SVG with round ticks, legend. Without a value to show: a sentence that says so.
std::string line_chart(const LineChart& chart);

}  // namespace pleat
