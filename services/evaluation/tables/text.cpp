#include "services/evaluation/tables/tables.hpp"

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

namespace pleat::evaluation {
namespace {

constexpr std::size_t kGap = 2;  ///< spaces between columns of text

std::string joined(const std::vector<std::string>& names) {
  std::string text = names.front();
  for (std::size_t i = 1; i < names.size(); ++i) text += ", " + names[i];
  return text;
}

}  // namespace

bool has_printed(const Table& table, std::size_t column) {
  return std::any_of(table.rows.begin(), table.rows.end(),
                     [&](const TableRow& row) { return row.entries[column].printed.has_value(); });
}

std::string to_text(const PaperTables& tables) {
  std::string text;
  char cell[64];
  const auto figure = [&](const std::optional<double>& value, const std::string& format) {
    if (!value) return std::string("-");
    std::snprintf(cell, sizeof cell, format.c_str(), *value);
    return std::string(cell);
  };
  for (const Table& table : tables.tables) {
    // Two lines of headings; a figure that the paper has too takes two columns.
    std::vector<std::vector<std::string>> lines(2);
    std::vector<std::size_t> pair(table.keys.size(), 1);  // columns below one heading
    for (const std::string& key : table.keys) lines[0].push_back(key), lines[1].emplace_back();
    for (std::size_t i = 0; i < table.columns.size(); ++i) {
      const bool both = has_printed(table, i);
      lines[0].push_back(table.columns[i]);
      if (both) lines[0].emplace_back(), lines[1].emplace_back("paper");
      lines[1].emplace_back("here");
      pair.push_back(both ? 2 : 1);
    }
    std::vector<std::string> commands;
    for (const TableRow& row : table.rows) {
      auto& line = lines.emplace_back(row.names);
      for (std::size_t i = 0; i < row.entries.size(); ++i) {
        const TableEntry& entry = row.entries[i];
        if (has_printed(table, i)) line.push_back(figure(entry.printed, table.formats[i]));
        line.push_back(figure(entry.measured, table.formats[i]));
        if (entry.measured || entry.missing.empty()) continue;
        const std::string command = joined(row.names) + ": " + entry.missing;
        if (std::find(commands.begin(), commands.end(), command) == commands.end()) commands.push_back(command);
      }
    }
    std::vector<std::size_t> widths(lines[1].size(), 0);
    for (std::size_t l = 1; l < lines.size(); ++l) {
      for (std::size_t i = 0; i < widths.size(); ++i) widths[i] = std::max(widths[i], lines[l][i].size());
    }
    for (std::size_t i = 0, group = 0; i < widths.size(); i += pair[group++]) {
      const std::size_t heading = lines[0][i].size(), rest = pair[group] == 2 ? widths[i + 1] + kGap : 0;
      if (widths[i] + rest < heading) widths[i] = heading - rest;
    }
    text += table.title + "\n";
    for (std::size_t l = 0; l < lines.size(); ++l) {
      std::string line;
      for (std::size_t i = 0, group = 0; i < widths.size(); i += pair[group++]) {
        for (std::size_t k = 0; k < pair[group]; ++k) {
          if (l == 0 && k > 0) continue;
          std::size_t width = widths[i + k];
          if (l == 0 && pair[group] == 2) width += widths[i + 1] + kGap;
          const std::string& value = lines[l][i + k];
          const std::string space(width > value.size() ? width - value.size() : 0, ' ');
          line += std::string(kGap, ' ') + (i < table.keys.size() ? value + space : space + value);
        }
      }
      text += line.substr(0, line.find_last_not_of(' ') + 1) + "\n";
    }
    text += "  " + table.note + "\n";
    for (const std::string& command : commands) text += "  missing: " + command + "\n";
    text += "\n";
  }
  return text;
}

nlohmann::json to_json(const PaperTables& tables) {
  nlohmann::json json = nlohmann::json::object();
  const auto value = [](const std::optional<double>& v) { return v ? nlohmann::json(*v) : nlohmann::json(nullptr); };
  for (const Table& table : tables.tables) {
    nlohmann::json rows = nlohmann::json::array();
    for (const TableRow& row : table.rows) {
      nlohmann::json figures = nlohmann::json::object();
      for (std::size_t i = 0; i < row.entries.size(); ++i) {
        nlohmann::json& entry = figures[table.columns[i]];
        entry = {{"printed", value(row.entries[i].printed)}, {"measured", value(row.entries[i].measured)}};
        if (!row.entries[i].measured) entry["missing"] = row.entries[i].missing;
      }
      rows.push_back({{"names", row.names}, {"figures", std::move(figures)}});
    }
    json[table.name] = {{"title", table.title}, {"rows", std::move(rows)}, {"note", table.note}};
  }
  return json;
}

}  // namespace pleat::evaluation
