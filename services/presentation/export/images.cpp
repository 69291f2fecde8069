#include "services/presentation/export/images.hpp"

#include <zlib.h>

#include <algorithm>
#include <bit>
#include <string>

#include "common/base/error.hpp"
#include "common/base/whole_file.hpp"
#include "services/presentation/export/own_export.hpp"

namespace pleat::presentation {
namespace {

static_assert(std::endian::native == std::endian::little, "EXR is little-endian, and so is what is written here");

constexpr int kExrLines = 16;  // of a block with ZIP
constexpr int kLevel = 4;      // of zlib: half the time of the usual 6, and a few per cent larger

template <class T>
void append(std::string& bytes, T value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

std::string deflated(const std::string& bytes) {
  uLongf size = compressBound(static_cast<uLong>(bytes.size()));
  std::string out(size, '\0');
  if (compress2(reinterpret_cast<Bytef*>(out.data()), &size, reinterpret_cast<const Bytef*>(bytes.data()),
                static_cast<uLong>(bytes.size()), kLevel) != Z_OK) {
    throw Error(ErrorCode::kResourceExhausted, "an image can't be compressed");
  }
  out.resize(size);
  return out;
}

/// What OpenEXR does before zlib: the even bytes, then the odd ones, each less the one before plus 128.
std::string reordered(const std::string& raw) {
  std::string out(raw.size(), '\0');
  const std::size_t half = (raw.size() + 1) / 2;
  for (std::size_t i = 0; i < raw.size(); ++i) out[i / 2 + (i % 2 == 0 ? 0 : half)] = raw[i];
  unsigned char before = out.empty() ? 0 : static_cast<unsigned char>(out[0]);
  for (std::size_t i = 1; i < out.size(); ++i) {
    const auto now = static_cast<unsigned char>(out[i]);
    out[i] = static_cast<char>(static_cast<unsigned char>(now - before + 128));
    before = now;
  }
  return out;
}

void attribute(std::string& header, const char* name, const char* type, const std::string& value) {
  header.append(name).push_back('\0');
  header.append(type).push_back('\0');
  append(header, static_cast<std::int32_t>(value.size()));
  header += value;
}

std::string exr_header(int size) {
  std::string header;
  append(header, std::uint32_t{20000630});
  append(header, std::uint32_t{2});
  std::string channels;
  for (const char* name : {"B", "G", "R"}) {
    channels.append(name).push_back('\0');
    for (const std::int32_t value : {2 /* float */, 0, 1, 1}) append(channels, value);
  }
  channels.push_back('\0');
  std::string window;
  for (const std::int32_t value : {0, 0, size - 1, size - 1}) append(window, value);
  std::string one, centre;
  append(one, 1.0F);
  append(centre, 0.0F);
  append(centre, 0.0F);
  attribute(header, "channels", "chlist", channels);
  attribute(header, "comments", "string", kImageMark);
  attribute(header, "compression", "compression", std::string(1, '\3'));
  attribute(header, "dataWindow", "box2i", window);
  attribute(header, "displayWindow", "box2i", window);
  attribute(header, "lineOrder", "lineOrder", std::string(1, '\0'));
  attribute(header, "pixelAspectRatio", "float", one);
  attribute(header, "screenWindowCenter", "v2f", centre);
  attribute(header, "screenWindowWidth", "float", one);
  header.push_back('\0');
  return header;
}

void png_chunk(WholeFile& file, const std::string& kind, const std::string& content) {
  const auto big = [](std::size_t value) {
    std::string word;
    for (int shift = 24; shift >= 0; shift -= 8) word += static_cast<char>((value >> shift) & 0xffu);
    return word;
  };
  const std::string both = kind + content;
  file.write(big(content.size()));
  file.write(both);
  file.write(big(crc32_z(crc32_z(0, nullptr, 0), reinterpret_cast<const Bytef*>(both.data()), both.size())));
}

}  // namespace

void write_exr(const std::filesystem::path& path, int size, const std::vector<float>& values) {
  std::vector<std::string> blocks;
  const auto width = static_cast<std::size_t>(size);
  for (int first = 0; first < size; first += kExrLines) {
    std::string raw;
    for (int line = first; line < std::min(first + kExrLines, size); ++line) {
      const float* row = values.data() + 3 * width * static_cast<std::size_t>(line);
      for (const std::size_t channel : {2, 1, 0}) {
        for (std::size_t x = 0; x < width; ++x) append(raw, row[3 * x + channel]);
      }
    }
    std::string packed = deflated(reordered(raw));
    if (packed.size() >= raw.size()) packed = std::move(raw);  // readers tell them by their size
    std::string block;
    append(block, static_cast<std::int32_t>(first));
    append(block, static_cast<std::int32_t>(packed.size()));
    blocks.push_back(block + packed);
  }
  std::string head = exr_header(size);
  std::uint64_t place = head.size() + 8 * blocks.size();
  for (const std::string& block : blocks) {
    append(head, place);
    place += block.size();
  }
  WholeFile file(path);
  file.write(head);
  for (const std::string& block : blocks) file.write(block);
  file.commit();
}

void write_png(const std::filesystem::path& path, int size, const std::vector<std::uint16_t>& values) {
  constexpr std::size_t kTexel = 6;
  const std::size_t row = kTexel * static_cast<std::size_t>(size);
  std::string header;
  for (int i = 0; i < 2; ++i) {
    for (int shift = 24; shift >= 0; shift -= 8) header += static_cast<char>((size >> shift) & 0xff);
  }
  header += std::string("\x10\2\0\0\0", 5);  // 16 bits, RGB
  std::string lines;
  std::string line(row, '\0');
  for (std::size_t y = 0; y < static_cast<std::size_t>(size); ++y) {
    for (std::size_t i = 0; i < row / 2; ++i) {
      const std::uint16_t value = values[y * row / 2 + i];
      line[2 * i] = static_cast<char>(value >> 8);
      line[2 * i + 1] = static_cast<char>(value & 0xff);
    }
    lines += '\1';  // every byte less the one of the texel before
    for (std::size_t i = 0; i < row; ++i) lines += static_cast<char>(line[i] - (i < kTexel ? 0 : line[i - kTexel]));
  }
  WholeFile file(path);
  file.write("\x89PNG\r\n\x1a\n");
  png_chunk(file, "IHDR", header);
  png_chunk(file, "tEXt", std::string("Comment\0", 8) + kImageMark);
  png_chunk(file, "IDAT", deflated(lines));
  png_chunk(file, "IEND", {});
  file.commit();
}

}  // namespace pleat::presentation
