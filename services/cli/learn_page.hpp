// What `pleat learn` leaves to look at.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "services/evaluation/evaluation.hpp"
#include "services/evaluation/tables/tables.hpp"

namespace pleat::cli {

/// By which the page is known as ours (own_file.hpp).
inline constexpr std::string_view kLearnPageMarks[] = {"<meta name=\"generator\" content=\"pleat.learn\">"};

struct LearnPage {
  std::string name;                                ///< of the bundle
  std::vector<std::string> scenes;                 ///< file names
  std::string begun_with;                          ///< "the bundle any", "fresh weights"
  std::vector<evaluation::MethodFigures> figures;  ///< the learned one last
  evaluation::Convergence curve;
  std::vector<std::string> judged;  ///< names of the sequences of `figures`
  std::string verdict;              ///< the result in a line
};

/// A self-contained page: the figures side by side and the curve of the training.
std::string to_html(const LearnPage& page);

}  // namespace pleat::cli
