#include "services/evaluation/tables/tables.hpp"

#include <cmath>
#include <fstream>
#include <map>
#include <sstream>

#include "services/evaluation/tables/measure.hpp"

namespace pleat::evaluation {

Convergence read_convergence(const std::string& name, const std::filesystem::path& log) {
  Convergence curve{name, {}, {}, {}, {}};
  std::ifstream file(log);
  std::string line;
  std::map<std::string, std::size_t> columns;
  const auto split = [](const std::string& text) {
    std::vector<std::string> cells;
    std::istringstream stream(text);
    for (std::string cell; std::getline(stream, cell, ',');) cells.push_back(cell);
    return cells;
  };
  if (!std::getline(file, line)) return curve;
  const auto header = split(line);
  for (std::size_t i = 0; i < header.size(); ++i) columns[header[i]] = i;
  const std::pair<const char*, std::vector<double>*> wanted_columns[] = {{"minutes", &curve.minutes},
                                                                         {"psnr_db", &curve.displacement_db},
                                                                         {"psnr_normal_db", &curve.normal_db},
                                                                         {"psnr_velocity_db", &curve.velocity_db}};
  while (std::getline(file, line)) {
    const auto cells = split(line);
    double values[4];
    bool whole = true;
    for (std::size_t k = 0; k < 4; ++k) {
      const auto found = columns.find(wanted_columns[k].first);
      whole = whole && found != columns.end() && found->second < cells.size();
      values[k] = whole ? std::strtod(cells[found->second].c_str(), nullptr) : 0;
    }
    // An epoch without validation has no PSNR.
    if (!whole || !std::isfinite(values[1]) || values[1] == 0) continue;
    for (std::size_t k = 0; k < 4; ++k) wanted_columns[k].second->push_back(values[k]);
  }
  return curve;
}

PaperTables make_tables(const TablesOptions& options,
                        const std::function<void(std::uint64_t, std::uint64_t, const std::string&)>& progress) {
  PaperTables result;
  add_mfsr_tables(options, progress, result);
  add_deform_tables(options, progress, result);
  return result;
}

}  // namespace pleat::evaluation
