// A stream's work, message by message: what the service does between the stream and the library.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "common/base/limits.hpp"
#include "pleat/v1/refinement.pb.h"
#include "services/refinement/refiner.hpp"

namespace pleat::refinement {

struct SessionOptions {
  std::int64_t max_vertices = kDefaultMaxFineVertices;  ///< of the fine mesh of a session
  int bisections = 5;                                   ///< weights of impact zones are found to 2^-bisections
  int threads = 0;                                      ///< of a session; 0: as many as there are processors
};

/// Not for several threads. Every member throws Error for input that is wrong, and stays usable.
class Session {
 public:
  Session(const v1::RefineOpen& open, const SessionOptions& options);

  void describe(v1::RefineOpened* opened) const { opened->set_fine_hash(fine_hash_); }
  /// Returns the library's report of the frame, until the next call.
  const RefinementReport& refine(const v1::RefineFrame& request, v1::RefinedFrame* response);

 private:
  void judge(const Positions& coarse, const Positions& fine, const std::vector<ObstacleFrame>& obstacles);

  std::vector<ObstacleShape> obstacles_;
  Eigen::Index coarse_vertices_ = 0, fine_vertices_ = 0;
  std::string fine_hash_;
  std::unique_ptr<Refiner> refiner_;  ///< null: frames are judged alone
  Faces coarse_faces_, fine_faces_;   ///< for that
  RefinedMesh result_;
};

}  // namespace pleat::refinement
