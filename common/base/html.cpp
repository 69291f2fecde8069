#include "common/base/html.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace pleat {
namespace {

constexpr double kWidth = 640, kHeight = 240, kLeft = 70, kRight = 20, kTop = 12, kBottom = 30;

struct Range {
  double low = std::numeric_limits<double>::infinity(), high = -low;

  void add(double value) {
    low = std::min(low, value);
    high = std::max(high, value);
  }
  bool empty() const { return !(low <= high); }
};

/// About four round values between low and high; of a logarithmic axis these are exponents of ten.
std::vector<double> ticks(const Range& range, bool logarithmic) {
  std::vector<double> result;
  if (logarithmic) {
    const double step = std::max(1.0, std::ceil((range.high - range.low) / 5));
    for (double v = std::ceil(range.low); v <= range.high; v += step) result.push_back(v);
    if (result.size() >= 2) return result;
    result.clear();
  }
  const double raw = (range.high - range.low) / 4, power = std::pow(10, std::floor(std::log10(raw)));
  const double step = power * (raw / power < 1.5 ? 1 : raw / power < 3.5 ? 2 : raw / power < 7.5 ? 5 : 10);
  for (double v = std::ceil(range.low / step) * step; v <= range.high + 1e-9 * step; v += step) result.push_back(v);
  return result;
}

/// Where values lie in the picture.
class Axes {
 public:
  explicit Axes(const LineChart& chart) : logarithmic_(chart.logarithmic) {
    for (const ChartLine& line : chart.lines) {
      for (std::size_t i = 0; i < line.y.size(); ++i) {
        if (!shown(line.y[i])) continue;
        x_.add(line.x[i]);
        y_.add(place(line.y[i]));
      }
    }
    if (empty()) return;
    if (x_.low == x_.high) x_.high = x_.low + 1;
    const double margin = y_.high > y_.low ? 0.05 * (y_.high - y_.low) : std::max(1e-12, 0.1 * std::abs(y_.high));
    y_.low -= margin;
    y_.high += margin;
  }

  bool empty() const { return y_.empty(); }
  bool shown(double y) const { return std::isfinite(y) && (!logarithmic_ || y > 0); }
  double place(double y) const { return logarithmic_ ? std::log10(y) : y; }
  double horizontal(double x) const { return kLeft + (x - x_.low) / (x_.high - x_.low) * (kWidth - kLeft - kRight); }
  double vertical(double placed) const {
    return kTop + (y_.high - placed) / (y_.high - y_.low) * (kHeight - kTop - kBottom);
  }
  const Range& x() const { return x_; }
  const Range& y() const { return y_; }

 private:
  bool logarithmic_;
  Range x_, y_;
};

std::string grid(const Axes& axes, bool logarithmic) {
  std::string out;
  char text[256];
  for (const double tick : ticks(axes.y(), logarithmic)) {
    const double y = axes.vertical(tick);
    std::snprintf(text, sizeof text,
                  "<line class=\"grid\" x1=\"%g\" y1=\"%.1f\" x2=\"%g\" y2=\"%.1f\"/>"
                  "<text x=\"%g\" y=\"%.1f\" text-anchor=\"end\">%.4g</text>\n",
                  kLeft, y, kWidth - kRight, y, kLeft - 6, y + 4, logarithmic ? std::pow(10, tick) : tick);
    out += text;
  }
  for (const double tick : ticks(axes.x(), false)) {
    std::snprintf(text, sizeof text, "<text x=\"%.1f\" y=\"%g\" text-anchor=\"middle\">%g</text>\n",
                  axes.horizontal(tick), kHeight - kBottom + 16, tick);
    out += text;
  }
  return out;
}

std::string path(const Axes& axes, const ChartLine& line) {
  std::string out = "<path class=\"line\" stroke=\"" + line.color + "\" d=\"";
  bool joined = false;
  for (std::size_t i = 0; i < line.y.size(); ++i) {
    if (!axes.shown(line.y[i])) {
      joined = false;
      continue;
    }
    char text[64];
    std::snprintf(text, sizeof text, "%s%.1f %.1f", joined ? "L" : "M", axes.horizontal(line.x[i]),
                  axes.vertical(axes.place(line.y[i])));
    out += text;
    joined = true;
  }
  return out + "\"><title>" + escape_html(line.name) + "</title></path>\n";
}

}  // namespace

const char* const kChartStyle =
    ".chart{max-width:720px;width:100%;height:auto}.chart text{font:11px system-ui,sans-serif;fill:#555}"
    ".chart .grid{stroke:#ddd}.chart .line{fill:none;stroke-width:1.8}.legend{margin:.1em 0;font-size:13px;color:#555}";

std::string escape_html(const std::string& text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

std::string line_chart(const LineChart& chart) {
  std::string out = "<h2>" + escape_html(chart.title) + "</h2>\n";
  const Axes axes(chart);
  if (axes.empty()) return out + "<p>No values yet.</p>\n";
  char text[64];
  std::snprintf(text, sizeof text, "<svg class=\"chart\" viewBox=\"0 0 %g %g\"", kWidth, kHeight);
  out += std::string(text) + " role=\"img\" aria-label=\"" + escape_html(chart.title) + "\">\n";
  out += grid(axes, chart.logarithmic);
  for (const ChartLine& line : chart.lines) out += path(axes, line);
  out += "</svg>\n<p class=\"legend\">";
  for (const ChartLine& line : chart.lines) {
    out += "<span style=\"color:" + line.color + "\">&#9632;</span> " + escape_html(line.name) + " &ensp; ";
  }
  return out + escape_html(chart.unit) + "</p>\n";
}

}  // namespace pleat
