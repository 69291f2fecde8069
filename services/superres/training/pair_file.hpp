// The images of one sequence in a file, which is mapped into memory: a data set may be larger than that, several
// processes share it, and the next training need not convert it again.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "services/superres/training/pairs.hpp"

namespace pleat::superres {

/// What a file has to hold to be used.
struct PairFileKey {
  std::uint64_t content = 0;  ///< hash of everything that decides the images
  std::uint64_t frames = 0;
  int input_channels = 0, answer_channels = 0;
  int height = 0, width = 0, scale = 0;  ///< of the inputs, in texels; answers are `scale` times as high and wide
  FixedPoint fixed_point;                ///< of the answers; inputs are float32
};

/// Writes PATH.partial, then renames it. All throw kResourceExhausted naming the file if the disk is full.
class PairFileWriter {
 public:
  PairFileWriter(const std::filesystem::path& path, const PairFileKey& key);
  ~PairFileWriter();
  PairFileWriter(const PairFileWriter&) = delete;
  PairFileWriter& operator=(const PairFileWriter&) = delete;

  /// The next frame: input (C, h, w), answer (C', H, W).
  void append(std::span<const float> input, std::span<const float> answer, const RotationRows& rotation);
  /// Needs all frames.
  void finish();

 private:
  void write(const void* data, std::size_t bytes, std::size_t offset);
  std::filesystem::path path_;
  PairFileKey key_;
  int file_ = -1;
  std::uint64_t count_ = 0;
};

/// Fills a sequence's images and rotations from a finished file. False if there is none, or it holds something else.
bool map_pair_file(const std::filesystem::path& path, const PairFileKey& key, PairSequence& sequence);

}  // namespace pleat::superres
