// Frames for the benchmarks of conversion and refinement: those of a data set, or made on the spot.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/frame/frame.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "services/evaluation/bench.hpp"
#include "services/simulation/scene.hpp"
#include "services/simulation/simulation.hpp"

namespace pleat::evaluation {

/// A frame of both meshes, velocities included.
struct FramePair {
  Frame coarse, fine;
};

/// The scene of a file, `frames` frames long after the initial state.
simulation::Scene load_bench_scene(const std::filesystem::path& file, std::size_t frames);

/// The same of a data set's sequence, whose scene this is: its files are among the shipped ones.
simulation::Scene parse_bench_scene(const std::string& json, std::size_t frames);

/// The median time of `frames` frames of a data set's sequence, from its first one on. scene: its JSON.
Figure frame_time(const std::string& scene, simulation::Mode mode, std::size_t frames);

/// The coarse mesh bent over folds of 80 cm, and the fine one on it with wrinkles of 5 mm.
FramePair wrinkled_pair(const Topology& coarse, const Subdivision& subdivision, double phase);

/// A place in a data set.
struct FramePlace {
  SequenceInfo sequence;
  std::uint64_t index = 0;
};

/// `count` frames, or all if there are fewer, evenly over the split "test" (all sequences if there is none). Throws
/// kNotFound if there are no frames.
std::vector<FramePlace> choose_frames(const DatasetReader& dataset, std::size_t count);

/// A frame with its velocities: backward differences over a frame's time, 0 for the first.
FramePair read_pair(const DatasetReader& dataset, const FramePlace& place);

/// What stays the same while frames are refined.
struct RefinementSetting {
  Topology coarse;
  Subdivision subdivision;
  std::vector<ObstacleShape> shapes;
  std::optional<ChannelRanges> range;  ///< of a data set, for the PSNR
};

struct RefinementInput {
  std::string name;                    ///< of the frame, for messages
  Positions coarse, fine;              ///< fine: not refined
  std::optional<Positions> reference;  ///< the simulated fine mesh
  std::vector<ObstacleFrame> obstacles;
};

/// Frames to refine. With options.dataset, those of choose_frames(), enhanced by the bundle (pleat-superres runs as a
/// child) through the code of the conversion service; else those of the scene, upsampled, with wrinkles of 4 mm that
/// reach into its obstacle. `begin` gets the setting of the frames that follow, once or, with a data set, for every
/// sequence.
void visit_refinement_inputs(const BenchOptions& options, const std::function<void(const RefinementSetting&)>& begin,
                             const std::function<void(const RefinementInput&)>& visit);

}  // namespace pleat::evaluation
