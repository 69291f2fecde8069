#include "services/superres/training/log.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>
#include <tuple>

#include "common/base/error.hpp"
#include "common/base/html.hpp"
#include "common/base/whole_file.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;

constexpr const char* kHeader =
    "epoch,steps,minutes,learning_rate,total,displacement,normal,velocity,kinematic,psnr_db,psnr_normal_db,"
    "psnr_velocity_db,vmse_m2,rmse_m,best";
// Not in older files.
constexpr const char* kVertexColumns = ",vertices,vertex_normals,edges";
constexpr const char* kWrinkleColumn = ",wrinkles";
constexpr std::size_t kColumns = 15, kVertexEnd = 18, kAllColumns = 19;

/// How many columns a file with this first line has; 0: it is none of ours.
std::size_t columns_of(const std::string& header) {
  if (header == kHeader) return kColumns;
  if (header == std::string(kHeader) + kVertexColumns) return kVertexEnd;
  return header == std::string(kHeader) + kVertexColumns + kWrinkleColumn ? kAllColumns : 0;
}

std::string csv_row(const EpochReport& r) {
  char row[512];
  std::snprintf(row, sizeof row,
                "%d,%lld,%.3f,%.6g,%.9g,%.9g,%.9g,%.9g,%.9g,%.6f,%.6f,%.6f,%.17g,%.9g,%d,%.9g,%.9g,%.9g,%.9g", r.epoch,
                static_cast<long long>(r.steps), r.minutes, r.learning_rate, r.total, r.displacement, r.normal,
                r.velocity, r.kinematic, r.psnr_db, r.psnr_normal_db, r.psnr_velocity_db, r.vmse_m2,
                std::sqrt(r.vmse_m2), r.best ? 1 : 0, r.vertices, r.vertex_normals, r.edges, r.wrinkles);
  return row;
}

}  // namespace

std::string to_json(const EpochReport& r) {
  return json{{"epoch", r.epoch},
              {"steps", r.steps},
              {"minutes", r.minutes},
              {"learning_rate", r.learning_rate},
              {"total", r.total},
              {"displacement", r.displacement},
              {"normal", r.normal},
              {"velocity", r.velocity},
              {"kinematic", r.kinematic},
              {"vertices", r.vertices},
              {"vertex_normals", r.vertex_normals},
              {"edges", r.edges},
              {"wrinkles", r.wrinkles},
              {"validated", r.validated},
              {"psnr_db", r.psnr_db},
              {"psnr_normal_db", r.psnr_normal_db},
              {"psnr_velocity_db", r.psnr_velocity_db},
              {"vmse_m2", r.vmse_m2},
              {"best", r.best}}
      .dump();
}

EpochReport report_from_json(const std::string& text) {
  EpochReport r;
  if (text.empty()) return r;
  const json d = json::parse(text);
  r.epoch = d.at("epoch"), r.steps = d.at("steps"), r.minutes = d.at("minutes");
  r.learning_rate = d.at("learning_rate"), r.total = d.at("total"), r.displacement = d.at("displacement");
  r.normal = d.at("normal"), r.velocity = d.at("velocity"), r.kinematic = d.at("kinematic");
  r.validated = d.at("validated"), r.psnr_db = d.at("psnr_db"), r.vmse_m2 = d.at("vmse_m2"), r.best = d.at("best");
  r.psnr_normal_db = d.at("psnr_normal_db"), r.psnr_velocity_db = d.at("psnr_velocity_db");
  // Not in check-points from before these losses.
  r.vertices = d.value("vertices", 0.0), r.vertex_normals = d.value("vertex_normals", 0.0);
  r.edges = d.value("edges", 0.0), r.wrinkles = d.value("wrinkles", 0.0);
  return r;
}

std::vector<EpochReport> read_log(const std::string& path, int last_epoch) {
  std::vector<EpochReport> reports;
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  const std::size_t columns = columns_of(line);
  if (columns == 0) return reports;
  while (std::getline(file, line)) {
    std::vector<double> values;
    std::istringstream row(line);
    for (std::string cell; std::getline(row, cell, ',');) values.push_back(std::strtod(cell.c_str(), nullptr));
    // A row that was being written when the process was killed comes again.
    if (values.size() != columns || values[0] > last_epoch) continue;
    EpochReport r;
    r.epoch = static_cast<int>(values[0]), r.steps = static_cast<std::int64_t>(values[1]), r.minutes = values[2];
    r.learning_rate = values[3], r.total = values[4], r.displacement = values[5], r.normal = values[6];
    r.velocity = values[7], r.kinematic = values[8], r.psnr_db = values[9], r.psnr_normal_db = values[10];
    r.psnr_velocity_db = values[11], r.vmse_m2 = values[12], r.best = values[14] != 0;
    r.validated = r.psnr_db != 0;
    if (columns >= kVertexEnd) r.vertices = values[15], r.vertex_normals = values[16], r.edges = values[17];
    if (columns >= kAllColumns) r.wrinkles = values[18];
    reports.push_back(r);
  }
  return reports;
}

void write_log(const std::string& path, const std::vector<EpochReport>& reports) {
  std::ostringstream rows;
  rows << kHeader << kVertexColumns << kWrinkleColumn << "\n";
  for (const EpochReport& report : reports) rows << csv_row(report) << "\n";
  write_whole_file(path, rows.str());
}

std::string curves_page(const std::string& name, const std::vector<EpochReport>& reports,
                        const BaselineReport& baseline) {
  const auto values = [&](auto member, bool validated, double factor = 1) {
    std::vector<double> result;
    for (const EpochReport& r : reports) {
      result.push_back(validated && !r.validated ? std::nan("") : factor * static_cast<double>(r.*member));
    }
    return result;
  };
  std::vector<double> rmse;
  for (const EpochReport& r : reports) rmse.push_back(r.validated ? 1e3 * std::sqrt(r.vmse_m2) : std::nan(""));
  const std::vector<double> plain(reports.size(), baseline.barycentric_psnr_db),
      plain_rmse(reports.size(), 1e3 * std::sqrt(baseline.barycentric_vmse_m2));
  std::vector<double> epochs;
  for (const EpochReport& r : reports) epochs.push_back(r.epoch);
  std::vector<LineChart> charts{
      {"Training loss",
       "mean over the epoch, unweighted parts",
       true,
       {{"total", "#111111", epochs, values(&EpochReport::total, false)},
        {"displacement", "#0072b2", epochs, values(&EpochReport::displacement, false)},
        {"normal", "#009e73", epochs, values(&EpochReport::normal, false)},
        {"velocity", "#d55e00", epochs, values(&EpochReport::velocity, false)},
        {"kinematic", "#cc79a7", epochs, values(&EpochReport::kinematic, false)}}},
      {"PSNR on the validation frames",
       "dB",
       false,
       {{"displacement", "#0072b2", epochs, values(&EpochReport::psnr_db, true)},
        {"normal", "#009e73", epochs, values(&EpochReport::psnr_normal_db, true)},
        {"velocity", "#d55e00", epochs, values(&EpochReport::psnr_velocity_db, true)}}},
      {"RMSE of the mesh on the validation frames", "mm", false, {{"network", "#0072b2", epochs, rmse}}},
      {"Learning rate", "", true, {{"rate", "#111111", epochs, values(&EpochReport::learning_rate, false)}}}};
  if (baseline.barycentric_vmse_m2 > 0) {
    charts[1].lines.push_back({"displacement, upsampled mesh", "#999999", epochs, plain});
    charts[2].lines.push_back({"upsampled mesh", "#999999", epochs, plain_rmse});
  }
  for (const auto& [label, color, member] : {std::tuple{"vertices", "#e69f00", &EpochReport::vertices},
                                             std::tuple{"vertex normals", "#56b4e9", &EpochReport::vertex_normals},
                                             std::tuple{"edges", "#b8a800", &EpochReport::edges},
                                             std::tuple{"wrinkles", "#882255", &EpochReport::wrinkles}}) {
    const std::vector<double> line = values(member, false);
    if (std::any_of(line.begin(), line.end(), [](double v) { return v > 0; }))
      charts[0].lines.push_back({label, color, epochs, line});
  }
  std::ostringstream out;
  out << "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">" << kCurvesMarks[0] << "<title>Training of "
      << escape_html(name)
      << "</title>\n<style>body{font:15px/1.4 system-ui,sans-serif;max-width:720px;margin:2em auto;padding:0 1em;"
         "color:#222;background:#fff}h1{font-size:1.4em}h2{font-size:1.05em;margin:1.6em 0 .3em}"
      << kChartStyle << "</style></head>\n<body><h1>Training of " << escape_html(name) << "</h1>\n";
  if (!reports.empty()) {
    const EpochReport& last = reports.back();
    char text[160];
    std::snprintf(text, sizeof text, "<p>%d epochs, %lld steps, %.1f minutes.</p>\n", last.epoch,
                  static_cast<long long>(last.steps), last.minutes);
    out << text;
    for (const LineChart& chart : charts) out << line_chart(chart);
  }
  out << "</body></html>\n";
  return out.str();
}

}  // namespace pleat::superres
