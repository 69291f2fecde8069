#include "services/superres/bundle.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <sstream>

#include "common/base/error.hpp"

namespace pleat::superres {
namespace {

constexpr const char* kMetadataFile = "pleat.json";

/// LibTorch's messages have a stack trace below; the first line names the cause.
std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

}  // namespace

void publish_file(const std::string& bytes, const std::string& path) {
  const std::string partial = path + ".partial";
  const auto fail = [&](int cause) {
    throw Error(ErrorCode::kResourceExhausted, partial + ": can't write: " + std::strerror(cause));
  };
  const int file = ::open(partial.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (file < 0) fail(errno);
  int cause = 0;
  for (std::size_t done = 0; done < bytes.size() && cause == 0;) {
    const ssize_t written = ::write(file, bytes.data() + done, bytes.size() - done);
    if (written >= 0) done += static_cast<std::size_t>(written);
    if (written < 0 && errno != EINTR) cause = errno;
  }
  if (cause == 0 && ::fsync(file) != 0) cause = errno;
  ::close(file);
  if (cause != 0) fail(cause);
  std::error_code error;
  std::filesystem::rename(partial, path, error);
  if (error) throw Error(ErrorCode::kResourceExhausted, path + ": can't rename: " + error.message());
}

void save_bundle(const torch::jit::Module& module, const Metadata& metadata, const std::string& path) {
  std::ostringstream archive;
  module.save(archive, {{kMetadataFile, to_json(metadata)}});
  publish_file(archive.str(), path);
}

torch::jit::Module load_bundle(const std::string& path, Metadata& metadata) {
  torch::jit::ExtraFilesMap extra{{kMetadataFile, ""}};
  torch::jit::Module module;
  try {
    module = torch::jit::load(path, torch::kCPU, extra);
  } catch (const c10::Error& error) {
    throw_data_loss(path +
                    ": no readable TorchScript archive (truncated?): " + first_line(error.what_without_backtrace()));
  } catch (const std::exception& error) {
    throw_data_loss(path + ": no readable TorchScript archive: " + first_line(error.what()));
  }
  const std::string& text = extra[kMetadataFile];
  if (text.empty()) throw_invalid_argument(path + ": a TorchScript file without pleat.json is no model bundle");
  metadata = metadata_from_json(text, path);
  return module;
}

cpu::Arrays arrays_of(const torch::jit::Module& module) {
  cpu::Arrays arrays;
  const auto add = [&](const std::string& name, const torch::Tensor& tensor) {
    cpu::Array& array = arrays[name];
    array.shape = tensor.sizes().vec();
    if (tensor.is_floating_point()) {
      const auto values = tensor.to(torch::kCPU, torch::kFloat32).contiguous();
      array.values.assign(values.data_ptr<float>(), values.data_ptr<float>() + values.numel());
    } else {
      const auto values = tensor.to(torch::kCPU, torch::kInt64).contiguous();
      array.indices.assign(values.data_ptr<std::int64_t>(), values.data_ptr<std::int64_t>() + values.numel());
    }
  };
  for (const auto& entry : module.named_parameters()) add(entry.name, entry.value);
  for (const auto& entry : module.named_buffers()) add(entry.name, entry.value);
  return arrays;
}

}  // namespace pleat::superres
