// Model bundles as files. Inside services/superres only: this header needs LibTorch.
#pragma once

#include <torch/script.h>

#include <map>
#include <string>
#include <vector>

#include "services/superres/bundle/metadata.hpp"

namespace pleat::superres {

/// Writes module and metadata to `path` with write_whole_file(). (LibTorch's own writer ends the process when the disk
/// is full.) Errors: kResourceExhausted or kInvalidArgument naming the file.
void save_bundle(const torch::jit::Module& module, const Metadata& metadata, const std::string& path);

/// The module, and in `metadata` the text of pleat.json. kDataLoss for a truncated, damaged or unreadable archive,
/// kInvalidArgument without pleat.json.
torch::jit::Module load_module(const std::string& path, std::string& metadata);

/// Loads both. Errors as load_module and metadata_from_json.
torch::jit::Module load_bundle(const std::string& path, Metadata& metadata);

/// The values of a module's floating-point parameters and buffers by their names.
std::map<std::string, std::vector<float>> values_of(const torch::jit::Module& module);

}  // namespace pleat::superres
