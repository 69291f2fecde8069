// What a training leaves to look at: log.csv, and the same as a page of curves.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "services/superres/training/trainer.hpp"

namespace pleat::superres {

std::string to_json(const EpochReport& report);
/// Of to_json()'s text; "" gives an empty report.
EpochReport report_from_json(const std::string& text);

/// By which both files are known as a training's (own_file.hpp).
inline constexpr std::string_view kLogMarks[] = {"epoch,steps,minutes,learning_rate,"};
inline constexpr std::string_view kCurvesMarks[] = {"<meta name=\"generator\" content=\"pleat.training\">",
                                                    "<title>Training of "};

/// Reads the rows of log.csv up to `last_epoch`; those after a check-point will come again. No file, no rows.
std::vector<EpochReport> read_log(const std::string& path, int last_epoch);

/// Writes all rows. kResourceExhausted naming the file.
void write_log(const std::string& path, const std::vector<EpochReport>& reports);

/// A self-contained HTML page: losses, PSNR of the three features, RMSE of the mesh and learning rate over the epochs.
std::string curves_page(const std::string& name, const std::vector<EpochReport>& reports,
                        const BaselineReport& baseline);

}  // namespace pleat::superres
