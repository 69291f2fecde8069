// What a result file holds, as the events that watchers get.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "common/store/result.hpp"
#include "pleat/v1/coordinator.pb.h"
#include "services/coordinator/pipeline_frame.hpp"

namespace pleat::coordinator {

using EventPtr = std::shared_ptr<const v1::JobEvent>;

EventPtr make_opened_event(const MeshPair& topology, const std::vector<ObstacleShape>& obstacles);

/// Of a frame that is stored; takes its arrays. Velocities are left out, as in the file.
EventPtr make_event(PipelineFrame& frame);

/// One stored frame, complete.
ResultFrame read_result_frame(const ResultReader& reader, std::uint64_t index);

/// Of a frame in a file, equal to what make_event gave when it was new, as far as the file keeps it.
EventPtr read_event(const ResultReader& reader, std::uint64_t index);

/// Sums over the complete frames of a file; zeros where it can't be read.
struct Counts {
  std::uint32_t penetrations = 0;
  std::uint32_t self_intersections = 0;
  std::uint32_t frame_errors = 0;
};
Counts counts_of(const std::filesystem::path& file);

}  // namespace pleat::coordinator
