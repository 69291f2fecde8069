// Images of three values a texel, as files.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

namespace pleat::presentation {

/// OpenEXR: channels R, G and B of 32-bit floats, scan lines of the whole image, ZIP compression without loss.
/// values: (size x size x 3), the upper row first. Throws as WholeFile.
void write_exr(const std::filesystem::path& path, int size, const std::vector<float>& values);

/// PNG: RGB of 16 bits. values: as above.
void write_png(const std::filesystem::path& path, int size, const std::vector<std::uint16_t>& values);

}  // namespace pleat::presentation
