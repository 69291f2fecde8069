// The writers behind export_frames, one per format. Frames that `next` returns are checked already.
#pragma once

#include <filesystem>
#include <functional>

#include "services/presentation/export/export.hpp"

namespace pleat::presentation {

/// Frame k of the input, checked; reports progress.
using FrameSource = std::function<Positions(std::size_t frame)>;

void write_ply(const std::filesystem::path& path, const Topology& topology, const Positions& positions);
void write_pc2(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame);
void write_mdd(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame);
void write_glb(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame);
void write_alembic(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame);
void write_usdz(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame);
void write_usda(const std::filesystem::path& path, const ExportInput& input, const FrameSource& frame);

}  // namespace pleat::presentation
