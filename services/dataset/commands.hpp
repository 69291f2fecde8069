// What `pleat dataset` and pleat-generate do, and the options that both have.
#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "services/dataset/generate.hpp"

namespace pleat::dataset {

struct GenerateChoice {
  std::string folder, set = "draping", scale = "small";
  std::string fine;                  ///< empty: as the set's is
  std::string garment, material;     ///< empty: the set's own, its fabric
  std::string body;                  ///< empty: the young woman
  std::vector<std::string> motions;  ///< empty: all that are shipped
  double garment_scale = 1;
  double frequency = 0;
  int frames = 0, rounds = 0, train = -1, test = -1, extra = 0, workers = 0;
  std::uint64_t seed = 1;
  bool deflate = true;
};

/// All but the folder.
void add_generate_options(CLI::App& app, GenerateChoice& choice);

/// What `choice` asks for. Throws kInvalidArgument (unknown set).
GenerateOptions generate_options(const GenerateChoice& choice, const std::string& git_revision);

/// What is in the data set, on stdout; with `json` as describe() has it.
void print_description(const std::string& folder, bool json = false);

/// Judges the data set and prints what was found on stdout; with `json` as one object. Throws kInternal with the first
/// problem if there is one.
void verify_and_print(const std::string& folder, std::uint64_t stride, bool json = false);

}  // namespace pleat::dataset
