#include "services/superres/training/checkpoint.hpp"

#include <torch/serialize.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "common/base/whole_file.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;

constexpr int kCheckpointVersion = 1;

std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

json to_json(const TrainState& state) {
  return {{"version", kCheckpointVersion},
          {"epoch", state.epoch},
          {"step", state.step},
          {"minutes", state.minutes},
          {"sums", std::vector<double>(std::begin(state.sums), std::end(state.sums))},
          {"best_score", state.best_score},
          {"best_epoch", state.best_epoch},
          {"best_report", state.best_report}};
}

struct Loaded {
  torch::serialize::InputArchive archive;
  std::string path;

  explicit Loaded(const std::string& file) : path(file) {
    if (!std::filesystem::exists(file)) throw_not_found(file + ": no such check-point");
    guarded([&] { archive.load_from(file, torch::kCPU); });
  }

  template <typename Body>
  void guarded(const Body& body) {
    try {
      body();
    } catch (const Error&) {
      throw;
    } catch (const c10::Error& error) {
      throw_data_loss(path + ": check-point can't be read: " + first_line(error.what_without_backtrace()));
    } catch (const std::exception& error) {
      throw_data_loss(path + ": check-point can't be read: " + first_line(error.what()));
    }
  }

  std::string text(const std::string& key) {
    std::string result;
    guarded([&] {
      c10::IValue value;
      archive.read(key, value);
      result = value.toStringRef();
    });
    return result;
  }

  void tensor(const std::string& key, torch::Tensor& target) {
    guarded([&] {
      const torch::NoGradGuard no_grad;
      torch::Tensor value;
      archive.read(key, value);
      if (value.sizes() != target.sizes()) throw_data_loss(path + ": check-point: " + key + " has another shape");
      target.copy_(value);
    });
  }
};

}  // namespace

void save_checkpoint(const std::string& path, const std::string& config_json, const Network& network, const Adam& adam,
                     const TrainState& state) {
  torch::serialize::OutputArchive archive;
  archive.write("config", c10::IValue(config_json));
  archive.write("state", c10::IValue(to_json(state).dump()));
  archive.write("steps", c10::IValue(adam.steps));
  const auto& parameters = network.parameters();
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    const std::string& name = parameters[i].first;
    archive.write("value_" + name, parameters[i].second.detach());
    archive.write("first_" + name, adam.first[i]);
    archive.write("second_" + name, adam.second[i]);
    archive.write("average_" + name, adam.average[i]);
  }
  std::string bytes;
  archive.save_to([&bytes](const void* data, std::size_t size) {
    bytes.append(static_cast<const char*>(data), size);
    return size;
  });
  write_whole_file(path, bytes);
}

void load_checkpoint(const std::string& path, const std::string& config_json, Network& network, Adam& adam,
                     TrainState& state) {
  Loaded loaded(path);
  const std::string difference = first_difference(config_json, loaded.text("config"));
  if (!difference.empty()) {
    throw Error(ErrorCode::kFailedPrecondition,
                path + ": made with another value of '" + difference + "'; remove it or choose another output folder");
  }
  loaded.guarded([&] {
    const json document = json::parse(loaded.text("state"));
    if (document.at("version").get<int>() != kCheckpointVersion)
      throw_data_loss(path + ": check-point of another version");
    state.epoch = document.at("epoch").get<int>();
    state.step = document.at("step").get<int>();
    state.minutes = document.at("minutes").get<double>();
    const auto sums = document.at("sums").get<std::vector<double>>();
    // Those from before the losses on vertices hold five, those from before that on wrinkles eight.
    if (sums.size() != std::size(state.sums) && sums.size() != 5 && sums.size() != 8)
      throw_data_loss(path + ": check-point: wrong number of sums");
    std::copy(sums.begin(), sums.end(), std::begin(state.sums));
    state.best_score = document.at("best_score").get<double>();
    state.best_epoch = document.at("best_epoch").get<int>();
    state.best_report = document.at("best_report").get<std::string>();
    c10::IValue steps;
    loaded.archive.read("steps", steps);
    adam.steps = steps.toInt();
  });
  for (std::size_t i = 0; i < network.parameters().size(); ++i) {
    auto [name, value] = network.parameters()[i];
    loaded.tensor("value_" + name, value);
    loaded.tensor("first_" + name, adam.first[i]);
    loaded.tensor("second_" + name, adam.second[i]);
    loaded.tensor("average_" + name, adam.average[i]);
  }
}

void load_initial(const std::string& path, Network& network) {
  Loaded loaded(path);
  for (auto [name, value] : network.parameters()) loaded.tensor("average_" + name, value);
}

}  // namespace pleat::superres
