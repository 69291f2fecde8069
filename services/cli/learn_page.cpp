#include "services/cli/learn_page.hpp"

#include <cstdio>
#include <functional>
#include <sstream>

#include "common/base/html.hpp"

namespace pleat::cli {
namespace {

using evaluation::MethodFigures;

constexpr const char* kStyle =
    "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:900px;padding:0 1rem;color:#1d2630;"
    "background:#fff}h1{font-size:1.5rem}h2{font-size:1.1rem;margin:1.6em 0 .3em}"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums}"
    "th,td{padding:.25rem .8rem;text-align:right;border-bottom:1px solid #dfe4ea}"
    "th:first-child{text-align:left}td:last-child{font-weight:600}.scroll{overflow-x:auto}.note{color:#4a5561}";

std::string number(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

struct Row {
  const char* name;
  std::function<std::string(const MethodFigures&)> value;
};

double milliseconds(const MethodFigures& figures) {
  double sum = 0;
  for (const auto& [stage, ms] : figures.median_ms) sum += ms;
  return sum;
}

std::vector<Row> rows() {
  std::vector<Row> rows{
      {"PSNR, dB",
       [](const MethodFigures& f) {
         return f.metrics.psnr_db ? number("%.2f", *f.metrics.psnr_db) : std::string("&ndash;");
       }},
      {"VMSE, m&sup2;", [](const MethodFigures& f) { return number("%.2e", f.metrics.vmse_m2); }},
      {"RMSE, mm", [](const MethodFigures& f) { return number("%.2f", 1e3 * f.metrics.rmse_m); }},
      {"normals, degrees off", [](const MethodFigures& f) { return number("%.2f", f.metrics.normal_angle_deg); }},
      {"shaking, 1 is right", [](const MethodFigures& f) { return number("%.2f", f.metrics.jitter_ratio); }}};
  static constexpr const char* kBands[] = {"wrinkles, finest band, 1 is right", "wrinkles, band 2", "wrinkles, band 3",
                                           "wrinkles, band 4"};
  for (std::size_t band = 0; band < std::size(kBands); ++band) {
    rows.push_back({kBands[band], [band](const MethodFigures& f) {
                      return band < f.metrics.wrinkles.size() ? number("%.2f", f.metrics.wrinkles.at(band))
                                                              : std::string("&ndash;");
                    }});
  }
  rows.push_back({"penetrations and self-intersections", [](const MethodFigures& f) {
                    return std::to_string(f.metrics.counts.penetrations + f.metrics.counts.self_intersections);
                  }});
  rows.push_back({"ms a frame, all stages", [](const MethodFigures& f) {
                    return f.median_ms.empty() ? std::string("&ndash;") : number("%.1f", milliseconds(f));
                  }});
  return rows;
}

std::string list(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + escape_html(word);
  return text;
}

}  // namespace

std::string to_html(const LearnPage& page) {
  std::ostringstream out;
  const std::string name = escape_html(page.name);
  out << "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" "
         "content=\"width=device-width\">"
      << kLearnPageMarks[0] << "<title>What " << name << " learned</title>\n<style>" << kStyle << kChartStyle
      << "</style></head>\n<body><h1>What " << name << " learned</h1>\n<p>" << escape_html(page.verdict)
      << "</p>\n<p class=\"note\">Scenes: " << list(page.scenes) << ". Training began with "
      << escape_html(page.begun_with) << ".</p>\n<h2>On sequences that the training did not see</h2>\n"
      << "<div class=\"scroll\"><table><tr><th></th>";
  for (const MethodFigures& method : page.figures) out << "<th>" << escape_html(method.name) << "</th>";
  out << "</tr>\n";
  for (const Row& row : rows()) {
    out << "<tr><th>" << row.name << "</th>";
    for (const MethodFigures& method : page.figures) out << "<td>" << row.value(method) << "</td>";
    out << "</tr>\n";
  }
  out << "</table></div>\n<p class=\"note\">" << list(page.judged) << "; "
      << (page.figures.empty() ? 0 : page.figures.front().metrics.frames)
      << " frames. The scenes as they are, and variations of them.</p>\n";
  LineChart chart{"PSNR over minutes of training, on a variation that is left out of it", "dB", false, {}};
  chart.lines.push_back({page.name, "#0072b2", page.curve.minutes, page.curve.displacement_db});
  out << line_chart(chart) << "</body></html>\n";
  return out.str();
}

}  // namespace pleat::cli
