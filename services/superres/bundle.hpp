// Writing model bundles. Inside services/superres only: this header needs LibTorch.
#pragma once

#include <torch/script.h>

#include <string>

#include "services/superres/cpu/executor.hpp"
#include "services/superres/metadata.hpp"

namespace pleat::superres {

/// Writes module and metadata to `path` with write_whole_file(). (LibTorch's own writer ends the process when the disk
/// is full.) Errors: kResourceExhausted or kInvalidArgument naming the file.
void save_bundle(const torch::jit::Module& module, const Metadata& metadata, const std::string& path);

/// Loads both. Errors as read_metadata.
torch::jit::Module load_bundle(const std::string& path, Metadata& metadata);

/// The module's parameters and buffers.
cpu::Arrays arrays_of(const torch::jit::Module& module);

}  // namespace pleat::superres
