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
  std::vector<std::string> scenes;   ///< scene files, instead of the set
  int sequences = 0;                 ///< of scenes; 0: 12
  double garment_scale = 1;
  double frequency = 0;
  int frames = 0, rounds = 0, train = -1, test = -1, extra = 0, workers = 0;
  std::uint64_t seed = 1;
  bool deflate = true;
  std::string shard;    ///< I/N or none; empty: as the environment says
  double lease_s = 60;  ///< a worker that is silent for so long has died
};

/// All but the folder.
void add_generate_options(CLI::App& app, GenerateChoice& choice);

/// What `choice` asks for. Throws kInvalidArgument (unknown set).
GenerateOptions generate_options(const GenerateChoice& choice, const std::string& git_revision);

/// Makes the data set, or this worker's part of it: choose_shard() decides, and what it chose is said. Returns an exit
/// code: kExitRunAgain if there is more to do.
int generate_chosen(const GenerateChoice& choice, const std::string& git_revision,
                    const std::function<void(const Progress&)>& progress);

/// Merges the shards, with lines on stdout, or stderr with `json`; then prints the description. Returns an exit code.
int merge_and_print(const std::string& folder, bool json = false);

/// What is in the data set, on stdout; with `json` as describe() has it.
void print_description(const std::string& folder, bool json = false);

/// Judges the data set and prints what was found on stdout; with `json` as one object. Throws kInternal with the first
/// problem if there is one.
void verify_and_print(const std::string& folder, std::uint64_t stride, bool json = false);

}  // namespace pleat::dataset
