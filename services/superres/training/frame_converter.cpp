#include "services/superres/training/frame_converter.hpp"

#include <algorithm>
#include <optional>
#include <utility>

#include "common/base/error.hpp"
#include "common/features/frame_features.hpp"

namespace pleat::superres {
namespace {

constexpr std::uint64_t kChunk = 8;  ///< frames read and converted together: a fraction of a second

}  // namespace

FrameConverter::FrameConverter(const DatasetReader& reader, const conversion::Representation& representation,
                               ThreadPool& pool, std::function<bool()> stopped)
    : reader_(reader), representation_(representation), pool_(pool), stopped_(std::move(stopped)) {}

void FrameConverter::run(const SequenceInfo& sequence, std::size_t stride,
                         const std::function<void(std::uint64_t, Converted&)>& use) const {
  const double frame_time_s = reader_.master().frame_time_s;
  const auto window = static_cast<std::size_t>(representation_.spec().window);
  const auto step = static_cast<std::size_t>(representation_.spec().window_stride);
  const std::size_t kept = (window - 1) * step + 2;  // velocities need one more than the window
  std::vector<Positions> coarse_before;
  Positions fine_before;
  for (std::uint64_t first = 0; first < sequence.frames_complete; first += kChunk) {
    if (stopped_()) throw Error(ErrorCode::kCancelled, "stopped on request while images were converted");
    const std::uint64_t end = std::min(first + kChunk, sequence.frames_complete);
    std::vector<Positions> coarse = reader_.coarse(sequence.name, first, end);
    const bool reads_obstacles = representation_.reads_obstacles() && !sequence.obstacles.empty();
    std::vector<std::vector<ObstacleFrame>> obstacles;
    if (reads_obstacles) obstacles = reader_.obstacles(sequence.name, first, end);
    const auto fine = reader_.fine(sequence.name, first, end);
    const std::size_t known = coarse_before.size();
    coarse.insert(coarse.begin(), std::make_move_iterator(coarse_before.begin()),
                  std::make_move_iterator(coarse_before.end()));
    const auto frame_of = [&](const std::vector<Positions>& positions, std::size_t i, const Positions& previous) {
      Frame frame;
      frame.positions = positions[i];
      frame.velocities = backward_velocities(positions[i], i > 0 ? positions[i - 1] : previous, frame_time_s);
      return frame;
    };
    std::vector<Converted> results(fine.size());
    pool_.parallel_for(results.size(), 1, [&](std::size_t begin, std::size_t stop) {
      std::optional<ObstacleField> field;
      if (reads_obstacles) field.emplace(sequence.obstacles);
      for (std::size_t i = begin; i < stop; ++i) {
        if ((first + i) % stride != 0) continue;
        std::vector<Frame> frames;
        for (std::size_t t = window; t-- > 0;) {
          const std::size_t at = known + i;
          frames.push_back(frame_of(coarse, at - std::min(at, t * step), {}));
        }
        Converted& result = results[i];
        result.alignment = representation_.align(frames.back().positions);
        if (field) field->update(obstacles[i]);
        representation_.encode(frames, result.alignment, result.input, field ? &*field : nullptr);
        representation_.target(frames.back(), frame_of(fine, i, fine_before), result.alignment, result.answer);
      }
    });
    for (std::size_t i = 0; i < results.size(); ++i) {
      if ((first + i) % stride == 0) use(first + i, results[i]);
    }
    fine_before = fine.back();
    coarse_before.assign(
        std::make_move_iterator(coarse.end() - static_cast<std::ptrdiff_t>(std::min(coarse.size(), kept))),
        std::make_move_iterator(coarse.end()));
  }
}

}  // namespace pleat::superres
