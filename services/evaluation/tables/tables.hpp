// The paper's tables with the figures of this machine beside the printed ones. docs/metrics.md, "The paper's tables".
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/mesh/mesh.hpp"

namespace pleat::evaluation {

struct TablesOptions {
  std::filesystem::path draping, hitting, skirt;                ///< data sets of [MFSR]
  std::map<std::string, std::filesystem::path> free_sets = {};  ///< of [DT-S], by free_set_names(); out/dataset/NAME
  std::filesystem::path trained = "out/train";  ///< folders NAME with NAME.pt and log.csv, as pleat-train leaves them
  std::filesystem::path models;                 ///< shipped bundles; empty: default_models_folder()
  std::filesystem::path configurations = "deploy/models";  ///< of the commands that train
  std::filesystem::path out = "out/bench";                 ///< tables.html, logs and files of the services
  std::size_t every = 10;         ///< of the test sequences every n-th frame is measured, n being this
  std::size_t frames = 0;         ///< of each test sequence at most; 0: all
  std::size_t timed_frames = 10;  ///< simulated for Table 1; 0: no times of the simulation
};

/// One figure of the paper and ours.
struct TableEntry {
  std::optional<double> printed;   ///< absent: the paper has none
  std::optional<double> measured;  ///< absent: see `missing`
  std::string missing;             ///< what makes it: a command, or why there is none
};

struct TableRow {
  std::vector<std::string> names;   ///< as many as Table::keys
  std::vector<TableEntry> entries;  ///< as many as Table::columns
};

struct Table {
  std::string name, title;
  std::vector<std::string> keys;     ///< headings of the names
  std::vector<std::string> columns;  ///< headings of the figures, with their units
  std::vector<std::string> formats;  ///< of printf, one a column
  std::vector<TableRow> rows;
  std::string note;  ///< what a reader must know to compare
};

/// True if the paper has a figure in some row of the column.
bool has_printed(const Table& table, std::size_t column);

/// A mesh of a figure.
struct Picture {
  std::string label;
  Positions positions;  ///< (V x 3) metres; empty: see `missing`
  bool coarse = false;  ///< has the coarse mesh's faces
  bool reference = false;
  std::string missing;
};

/// One frame as several methods made it.
struct PictureRow {
  std::string title;
  Faces coarse_faces, fine_faces;
  std::vector<Picture> pictures;  ///< one of them is the reference, if there are any
};

/// A line of Fig. 13.
struct Convergence {
  std::string name;
  std::vector<double> minutes, displacement_db, normal_db, velocity_db;
};

struct PaperTables {
  std::vector<Table> tables;
  std::vector<PictureRow> figure11, figure12;
  std::vector<PictureRow> deform;  ///< the methods of [DT-S] table 2 on each of its sets
  std::vector<Convergence> figure13;
};

/// The sets of [DT-S] (sheet, sheet-64, disk and so on; sheet-tracked beside them), and what tables call them.
std::vector<std::pair<std::string, std::string>> free_set_names();

/// Evaluates what there is. Throws what evaluation throws; a data set or bundle that is not there is no error.
/// `progress` gets the frames done of all and what they belong to.
PaperTables make_tables(const TablesOptions& options,
                        const std::function<void(std::uint64_t, std::uint64_t, const std::string&)>& progress);

/// Reads the columns of pleat-train's log.csv. Empty if there is no such file.
Convergence read_convergence(const std::string& name, const std::filesystem::path& log);

/// For people: printed and measured side by side, and what is missing with its command.
std::string to_text(const PaperTables& tables);
/// table -> list of rows {names, figures: column -> {printed, measured, missing}}.
nlohmann::json to_json(const PaperTables& tables);
/// A self-contained page: the tables, the curves of Fig. 13 and the turning meshes of Figs. 11 and 12, coloured by
/// their distance to the reference.
std::string to_html(const PaperTables& tables);

}  // namespace pleat::evaluation
