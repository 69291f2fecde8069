// A stream's work, message by message: what the service does between the stream and the library.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/limits.hpp"
#include "pleat/v1/fold.pb.h"
#include "services/fold/fold_step.hpp"

namespace pleat::fold {

struct SessionOptions {
  std::int64_t max_vertices = kDefaultMaxFineVertices;  ///< of the fine mesh of a session
};

/// Not for several threads. Every member throws Error for input that is wrong, and stays usable.
class Session {
 public:
  Session(const v1::FoldOpen& open, const SessionOptions& options);

  void describe(v1::FoldOpened* opened) const { opened->set_fine_hash(fine_hash_); }
  /// Continues the state in the request; without one that of the frame before, if that was the last one answered; else
  /// begins anew.
  FoldReport fold(const v1::FoldFrame& request, v1::FoldedFrame* response);

 private:
  struct Hold {
    std::vector<std::uint32_t> vertices;
    double start_s = 0, end_s = 0;
  };

  static std::vector<Hold> holds_from(const v1::FoldOpen& open, Eigen::Index vertices);
  std::vector<std::uint32_t> held_at(double time_s) const;

  std::vector<ObstacleShape> obstacles_;
  std::vector<Hold> holds_;
  Eigen::Index coarse_vertices_ = 0, fine_vertices_ = 0;
  std::string fine_hash_;
  std::unique_ptr<FoldStep> step_;
  FoldState state_;  ///< of the last frame that was answered
  std::optional<std::uint64_t> last_index_;
};

}  // namespace pleat::fold
