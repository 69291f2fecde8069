#include "services/superres/training/pair_file.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/error.hpp"
#include "common/base/own_file.hpp"
#include "common/base/whole_file.hpp"

namespace pleat::superres {
namespace {

constexpr char kMagic[16] = "pleat.pairs.v2";
constexpr std::string_view kMarks[] = {"pleat.pairs."};  // of all versions

struct Header {
  char magic[16];
  std::uint64_t content, frames;
  std::int32_t input_channels, answer_channels, height, width, scale, reserved;
  FixedPoint fixed_point;
};

ImageStore inputs_of(const PairFileKey& key) { return {key.input_channels, key.height, key.width, {}}; }
ImageStore answers_of(const PairFileKey& key) {
  return {key.answer_channels, key.scale * key.height, key.scale * key.width, key.fixed_point};
}

/// Where things lie in a file, in bytes.
struct Layout {
  std::size_t input_image, answer_image;  ///< of one
  std::size_t rotations, inputs, answers, end;

  explicit Layout(const PairFileKey& key)
      : input_image(inputs_of(key).image_bytes()), answer_image(answers_of(key).image_bytes()) {
    const auto frames = static_cast<std::size_t>(key.frames);
    rotations = sizeof(Header);
    inputs = rotations + frames * sizeof(RotationRows);
    answers = inputs + frames * input_image;
    end = answers + frames * answer_image;
  }
};

Header header_of(const PairFileKey& key) {
  Header header{};
  std::memcpy(header.magic, kMagic, sizeof kMagic);
  header.content = key.content, header.frames = key.frames;
  header.input_channels = key.input_channels, header.answer_channels = key.answer_channels;
  header.height = key.height, header.width = key.width, header.scale = key.scale;
  header.fixed_point = key.fixed_point;
  return header;
}

}  // namespace

PairFileWriter::PairFileWriter(const std::filesystem::path& path, const PairFileKey& key) : path_(path), key_(key) {
  std::error_code error;
  std::filesystem::create_directories(path.parent_path(), error);
  const std::string partial = path.string() + ".partial";
  // What has one of these names and was not made here is somebody's.
  for (const std::string& name : {path.string(), partial}) {
    if (!has_mark(name, kMarks)) set_aside(name);
  }
  file_ = ::open(partial.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (file_ < 0) throw Error(ErrorCode::kResourceExhausted, partial + ": can't write: " + std::strerror(errno));
  const Header header = header_of(key);
  write(&header, sizeof header, 0);
}

PairFileWriter::~PairFileWriter() {
  if (file_ >= 0) ::close(file_);
}

void PairFileWriter::write(const void* data, std::size_t bytes, std::size_t offset) {
  const char* place = static_cast<const char*>(data);
  while (bytes > 0) {
    const ssize_t written = ::pwrite(file_, place, bytes, static_cast<off_t>(offset));
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) {
      throw Error(ErrorCode::kResourceExhausted, path_.string() + ".partial: can't write: " + std::strerror(errno));
    }
    place += written;
    offset += static_cast<std::size_t>(written);
    bytes -= static_cast<std::size_t>(written);
  }
}

void PairFileWriter::append(std::span<const float> input, std::span<const float> answer, const RotationRows& rotation) {
  const Layout layout(key_);
  if (count_ >= key_.frames || input.size_bytes() != layout.input_image) throw_internal("pair file: another size");
  ImageStore store = answers_of(key_);
  store.append(answer);
  write(rotation.data(), sizeof rotation, layout.rotations + count_ * sizeof rotation);
  write(input.data(), input.size_bytes(), layout.inputs + count_ * layout.input_image);
  write(store.data(), layout.answer_image, layout.answers + count_ * layout.answer_image);
  ++count_;
}

void PairFileWriter::finish() {
  if (count_ != key_.frames) throw_internal("pair file: frames are missing");
  publish_file(path_.string() + ".partial", path_);
}

bool map_pair_file(const std::filesystem::path& path, const PairFileKey& key, PairSequence& sequence) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return false;
  const Layout layout(key);
  struct stat status {};
  void* memory = MAP_FAILED;
  if (::fstat(file, &status) == 0 && static_cast<std::size_t>(status.st_size) == layout.end) {
    memory = ::mmap(nullptr, layout.end, PROT_READ, MAP_SHARED, file, 0);
  }
  ::close(file);
  if (memory == MAP_FAILED) return false;
  const std::shared_ptr<const char> owner(static_cast<const char*>(memory), [size = layout.end](const char* begin) {
    ::munmap(const_cast<char*>(begin), size);
  });
  const Header expected = header_of(key);
  if (std::memcmp(owner.get(), &expected, sizeof expected) != 0) return false;
  const auto frames = static_cast<std::size_t>(key.frames);
  sequence.rotations.resize(frames);
  std::memcpy(sequence.rotations.data(), owner.get() + layout.rotations, frames * sizeof(RotationRows));
  sequence.input =
      ImageStore(key.input_channels, key.height, key.width, {}, frames, {owner, owner.get() + layout.inputs});
  sequence.answer = ImageStore(key.answer_channels, key.scale * key.height, key.scale * key.width, key.fixed_point,
                               frames, {owner, owner.get() + layout.answers});
  return true;
}

}  // namespace pleat::superres
