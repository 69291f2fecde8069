#include "services/superres/bundle/bundle.hpp"

#include <sstream>

#include "common/base/error.hpp"
#include "common/base/whole_file.hpp"
#include "services/superres/bundle/archive.hpp"

namespace pleat::superres {
namespace {

constexpr const char* kMetadataFile = "pleat.json";

/// LibTorch's messages have a stack trace below; the first line names the cause.
std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

}  // namespace

void save_bundle(const torch::jit::Module& module, const Metadata& metadata, const std::string& path) {
  std::ostringstream archive;
  module.save(archive, {{kMetadataFile, to_json(metadata)}});
  write_whole_file(path, archive.str());
}

torch::jit::Module load_module(const std::string& path, std::string& metadata) {
  check_archive(path);
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
  metadata = extra[kMetadataFile];
  if (metadata.empty()) throw_invalid_argument(path + ": a TorchScript file without pleat.json is no model bundle");
  return module;
}

torch::jit::Module load_bundle(const std::string& path, Metadata& metadata) {
  std::string text;
  auto module = load_module(path, text);
  metadata = metadata_from_json(text, path);
  return module;
}

std::map<std::string, std::vector<float>> values_of(const torch::jit::Module& module) {
  std::map<std::string, std::vector<float>> values;
  const auto add = [&](const std::string& name, const torch::Tensor& tensor) {
    if (!tensor.is_floating_point()) return;
    const auto flat = tensor.to(torch::kCPU, torch::kFloat32).contiguous();
    values[name].assign(flat.data_ptr<float>(), flat.data_ptr<float>() + flat.numel());
  };
  for (const auto& entry : module.named_parameters()) add(entry.name, entry.value);
  for (const auto& entry : module.named_buffers()) add(entry.name, entry.value);
  return values;
}

}  // namespace pleat::superres
