// What the tables of both papers are made of: every method on one data set. Internal to this folder.
#pragma once

#include <array>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "services/evaluation/evaluation.hpp"
#include "services/evaluation/tables/tables.hpp"

namespace pleat::evaluation {

/// A bundle that a table asks for.
struct Wanted {
  std::string name;  ///< of the bundle; also of its folder and configuration
  std::string label;
  std::string command;   ///< that makes it
  bool shipped = false;  ///< looked for among the shipped ones first
  bool refined = false;  ///< measured through the whole pipeline
};

struct Request {
  std::string name;  ///< of the data set, as tables print it
  std::filesystem::path dataset;
  std::string missing;  ///< the command that makes it
  std::vector<Wanted> bundles;
  /// Of the same scenes, with a fine cloth that follows the coarse one: examples for "zurdo2013-tracked". May be empty.
  std::filesystem::path tracked;
};

/// One data set on this machine.
struct Benchmark {
  Request request;
  std::string missing;                           ///< the command that makes the data set, if it is not there
  std::map<std::string, MethodFigures> figures;  ///< by method: "barycentric", "zurdo2013", or a bundle
  std::optional<double> coarse_ms, fine_ms;      ///< of the simulations
  PictureRow frame;                              ///< the frame of the figures; pictures by method in `positions`
  std::map<std::string, Positions> positions;    ///< "coarse" and "reference" among them
};

using TablesProgress = std::function<void(std::uint64_t, std::uint64_t, const std::string&)>;

/// Runs upsampling, wrinkles by example and the bundles that are there. Throws what evaluation throws.
Benchmark measure(const TablesOptions& options, Request request, const TablesProgress& progress);

/// The command that trains a configuration.
std::string training(const TablesOptions& options, const std::string& name);

/// What a paper prints of sizes and times, in the order of the columns; 0: nothing. Times in ms.
struct PrintedTimes {
  double coarse_vertices, fine_vertices, fine_ms, ours_ms, speedup, coarse_ms, conversion_ms, network_ms, refinement_ms;
};
/// The row of a table of times: printed and measured figures of a data set. `bundle`: whose stages are "ours"; null: no
/// bundle ran. `command` makes one.
TableRow row_of_times(const Benchmark& benchmark, const PrintedTimes& printed, const Wanted* bundle,
                      const std::string& command);

/// (label, name of the positions, command)
using Panels = std::vector<std::array<std::string, 3>>;
PictureRow pictures(const Benchmark& benchmark, const Panels& panels);

/// Tables 1 to 3 and figures 11 to 13 of [MFSR].
void add_mfsr_tables(const TablesOptions& options, const TablesProgress& progress, PaperTables& result);
/// Tables 1 and 3 and the ablations of [DT-S]; in place of its user study, wrinkles and jitter.
void add_deform_tables(const TablesOptions& options, const TablesProgress& progress, PaperTables& result);

}  // namespace pleat::evaluation
