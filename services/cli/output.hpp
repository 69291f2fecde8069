// What `run` and `enhance` leave in their folder, and what they print at the end.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "common/frame/detail.hpp"
#include "services/presentation/input/scene_file.hpp"
#include "services/presentation/report/report.hpp"

namespace pleat::cli {

/// Makes the folder, and makes sure that result and report take no other file's place. Throws kInvalidArgument if it
/// can't be made or written, kAlreadyExists for a file there that is no result or report; it is named.
void make_output_folder(const std::filesystem::path& folder);

/// `text` where there is such a file or it is a path; else what comes with Pleat under that name: "draping" is
/// scenes/draping.json for the folder "scenes".
std::string shipped_or(const std::string& text, const std::string& folder);

/// Prints what is worth knowing about the input on stderr, three lines at most (verbose: all; quiet: none).
void print_notes(const std::vector<std::string>& notes);

/// The W3C trace context of what the command asks for: $TRACEPARENT if it is valid, else a new one. Says the id on
/// stderr (verbose only).
std::string traceparent();

/// Writes report.json and report.html from FOLDER/result.h5 and prints the figures on stdout, with
/// `json` as report.json has them. Returns the exit code:
/// kExitNotClean, with a line on stderr, if penetrations or self-intersections are left. bodies: of the scene, which
/// the page skins itself.
int write_reports(const std::filesystem::path& folder, presentation::ReportSummary summary, bool json = false,
                  const std::vector<presentation::SceneBody>& bodies = {});

/// "draping" and, if the text is a path, its folder: "deploy/models/draping.pt" -> {draping, deploy/models}.
struct ModelChoice {
  std::string name;
  std::filesystem::path folder;  ///< empty: the default folder
};
/// What --detail says, checked; `--model none` is `--detail none`, and leaves `model` empty. Throws kInvalidArgument if
/// a bundle is named and none is used.
v1::Detail choose_detail(std::string& text, std::string& model);
/// Throws kNotFound if the bundle (or, with an empty text, any bundle) is not there; the file is named.
ModelChoice choose_model(const std::string& text);

}  // namespace pleat::cli
