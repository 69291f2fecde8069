// Frames of a data set as what a network reads and should answer, on all threads.
#pragma once

#include <functional>

#include "common/base/parallel.hpp"
#include "common/store/dataset.hpp"
#include "services/conversion/representation.hpp"

namespace pleat::superres {

/// Physical values.
struct Converted {
  Tensor input;   ///< (T C, h, w)
  Tensor answer;  ///< (C, H, W)
  RigidTransform alignment;
};

class FrameConverter {
 public:
  /// stopped: asked after every few frames; true ends run() with kCancelled.
  FrameConverter(const DatasetReader& reader, const conversion::Representation& representation, ThreadPool& pool,
                 std::function<bool()> stopped);

  /// Calls use(frame index, converted) in frame order, for one frame in `stride`. The first frame of a sequence stands
  /// for those before it in a window. Throws kDataLoss for frames that the file does not hold.
  void run(const SequenceInfo& sequence, std::size_t stride,
           const std::function<void(std::uint64_t, Converted&)>& use) const;

 private:
  const DatasetReader& reader_;
  const conversion::Representation& representation_;
  ThreadPool& pool_;
  std::function<bool()> stopped_;
};

}  // namespace pleat::superres
