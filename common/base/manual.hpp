// Manual pages and shell completions of a program, from the description of its command line.
#pragma once

#include <CLI/CLI.hpp>
#include <filesystem>
#include <string>
#include <vector>

namespace pleat {

/// The options of `app` and of its option groups; hidden ones are left out.
std::vector<const CLI::Option*> visible_options(const CLI::App& app);

/// The commands of `app` that `--help` shows.
std::vector<const CLI::App*> visible_commands(const CLI::App& app);

/// The values between which an option chooses (CLI::IsMember); empty: any.
std::vector<std::string> choices(const CLI::Option& option);

struct ManualFile {
  std::filesystem::path path;  ///< below share/: "man/man1/pleat-run.1"
  std::string text;
};

/// A page in man(7)'s language for the program and each of its commands ("pleat-dataset-generate"), then completions
/// for bash, zsh and fish. `root` has the program's name; `version` stands in the pages.
std::vector<ManualFile> manual(const CLI::App& root, const std::string& version);

/// Writes them below `folder`. Throws kInvalidArgument where that can't be.
void write_manual(const CLI::App& root, const std::string& version, const std::filesystem::path& folder);

/// "PROGRAM --write-manual FOLDER" is for builds: the folder, or empty for any other command line.
std::filesystem::path manual_folder(int argc, const char* const* argv);

}  // namespace pleat
