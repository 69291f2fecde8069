#include "services/superres/training/trainer.hpp"

#include <ATen/Parallel.h>
#include <torch/script.h>
#include <torch/torch.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>

#include "common/base/error.hpp"
#include "common/base/parallel.hpp"
#include "services/superres/bundle.hpp"
#include "services/superres/cpu/texels.hpp"
#include "services/superres/training/checkpoint.hpp"
#include "services/superres/training/sampler.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;
using Clock = std::chrono::steady_clock;

constexpr std::size_t kConditioningFrames = 256;
constexpr const char* kLogHeader =
    "epoch,steps,minutes,learning_rate,total,displacement,normal,velocity,kinematic,psnr_db,vmse_m2,rmse_m,best";

double decibel(double mean_square) { return mean_square > 0 ? -10 * std::log10(mean_square) : 200; }

json to_json(const EpochReport& r) {
  return {{"epoch", r.epoch},
          {"steps", r.steps},
          {"minutes", r.minutes},
          {"learning_rate", r.learning_rate},
          {"total", r.total},
          {"displacement", r.displacement},
          {"normal", r.normal},
          {"velocity", r.velocity},
          {"kinematic", r.kinematic},
          {"validated", r.validated},
          {"psnr_db", r.psnr_db},
          {"vmse_m2", r.vmse_m2},
          {"best", r.best}};
}

EpochReport report_from_json(const std::string& text) {
  EpochReport r;
  if (text.empty()) return r;
  const json d = json::parse(text);
  r.epoch = d.at("epoch"), r.steps = d.at("steps"), r.minutes = d.at("minutes");
  r.learning_rate = d.at("learning_rate"), r.total = d.at("total"), r.displacement = d.at("displacement");
  r.normal = d.at("normal"), r.velocity = d.at("velocity"), r.kinematic = d.at("kinematic");
  r.validated = d.at("validated"), r.psnr_db = d.at("psnr_db"), r.vmse_m2 = d.at("vmse_m2"), r.best = d.at("best");
  return r;
}

std::string csv_row(const EpochReport& r) {
  char row[512];
  std::snprintf(row, sizeof row, "%d,%lld,%.3f,%.6g,%.9g,%.9g,%.9g,%.9g,%.9g,%.6f,%.9g,%.9g,%d", r.epoch,
                static_cast<long long>(r.steps), r.minutes, r.learning_rate, r.total, r.displacement, r.normal,
                r.velocity, r.kinematic, r.psnr_db, r.vmse_m2, std::sqrt(r.vmse_m2), r.best ? 1 : 0);
  return row;
}

/// Keeps the rows of the epochs before `epoch`: those after the check-point will come again.
void cut_log(const std::string& path, int epoch) {
  std::string kept = std::string(kLogHeader) + "\n";
  std::ifstream old(path);
  std::string line;
  std::getline(old, line);
  while (std::getline(old, line)) {
    if (std::atoi(line.c_str()) <= epoch) kept += line + "\n";
  }
  old.close();
  std::ofstream file(path, std::ios::trunc);
  file << kept;
  if (!file.flush()) throw Error(ErrorCode::kResourceExhausted, path + ": can't write");
}

/// Mean and deviation per channel, gathered image by image.
class Statistics {
 public:
  explicit Statistics(int channels) : sum_(torch::zeros({channels}, torch::kFloat64)), squares_(sum_.clone()) {}

  /// values: (1, C, h, w); mask: (1, 1, h, w) of 0 and 1.
  void add(const torch::Tensor& values, const torch::Tensor& mask) {
    const auto weighted = values.to(torch::kFloat64) * mask;
    sum_ += weighted.sum(torch::IntArrayRef{0, 2, 3});
    squares_ += weighted.square().sum(torch::IntArrayRef{0, 2, 3});
    count_ += mask.sum().item<double>();
  }
  std::vector<float> mean() const { return to_vector(sum_ / count_); }
  std::vector<float> deviation() const {
    return to_vector((squares_ / count_ - (sum_ / count_).square()).clamp_min(0).sqrt().clamp_min(1e-6));
  }

 private:
  static std::vector<float> to_vector(const torch::Tensor& t) {
    const auto values = t.to(torch::kFloat32).contiguous();
    return {values.data_ptr<float>(), values.data_ptr<float>() + values.numel()};
  }
  torch::Tensor sum_, squares_;
  double count_ = 0;
};

Conditioning measure(const PairData& data, const Architecture& architecture) {
  const bool local = architecture.axes == "local";
  std::optional<cpu::UpsampledMesh> mesh;
  if (architecture.residual == "mesh") mesh.emplace(data.mesh_base, data.coarse_height(), data.coarse_width());
  const torch::NoGradGuard no_grad;
  const int h = data.coarse_height(), w = data.coarse_width();
  const std::size_t stride = std::max<std::size_t>(1, data.training_frames() / kConditioningFrames);
  const auto all = torch::ones({1, 1, h, w}, torch::kFloat64);
  const auto mask =
      torch::from_blob(const_cast<std::uint8_t*>(data.fine_mask.data()), {1, 1, kScale * h, kScale * w}, torch::kUInt8)
          .to(torch::kFloat64);
  torch::Tensor minimum, range, rest;
  if (local) {
    minimum = torch::tensor(std::vector<float>(data.normalization.minimum.begin(), data.normalization.minimum.end()));
    range = torch::tensor(std::vector<float>(data.normalization.maximum.begin(), data.normalization.maximum.end()));
    minimum = minimum.view({1, kChannels, 1, 1});
    range = range.view({1, kChannels, 1, 1}) - minimum;
    rest = torch::tensor(data.mesh_base.rest).view({1, 3, h, w});
  }
  Statistics input(kChannels), detail(kChannels), output(kChannels), features(kLocalChannels), local_output(kChannels);
  std::size_t index = 0;
  for (const auto& sequence : data.sequences) {
    if (sequence.validation) continue;
    for (std::size_t f = 0; f < sequence.coarse.size(); ++f, ++index) {
      if (index % stride != 0) continue;
      const auto coarse = torch::empty({1, kChannels, h, w}),
                 fine = torch::empty({1, kChannels, kScale * h, kScale * w});
      sequence.coarse.read(f, 0, 0, h, w, coarse.data_ptr<float>());
      sequence.fine.read(f, 0, 0, kScale * h, kScale * w, fine.data_ptr<float>());
      auto base = upsample_bilinear(coarse);
      if (mesh) mesh->image({coarse.data_ptr<float>(), h, w}, base.data_ptr<float>());
      input.add(coarse, all);
      detail.add(local_detail(coarse), all);
      output.add(fine - base, mask);
      if (local) {
        const auto frame = local_frame(coarse, minimum, range, rest);
        features.add(frame.features, all);
        local_output.add(to_local((fine - base) * range, upsample_bilinear(frame.axes)), mask);
      }
    }
  }
  Conditioning result;
  result.input_mean = input.mean(), result.input_deviation = input.deviation();
  result.detail_deviation = detail.deviation();
  result.output_deviation = output.deviation();
  if (local) {
    result.local_mean = features.mean(), result.local_deviation = features.deviation();
    result.local_output = local_output.deviation();
  }
  return result;
}

class Trainer {
 public:
  Trainer(const TrainConfig& config, const PairData& data, MeshJudge* judge, const TrainHooks& hooks)
      : config_(config),
        data_(data),
        judge_(judge),
        hooks_(hooks),
        sampler_(config, data),
        network_(config.architecture, config.seed),
        averaged_(config.architecture, config.seed),
        device_(choose_device()),
        config_json_(pleat::superres::to_json(config)),
        checkpoint_(config.output + "/checkpoint.pt"),
        log_(config.output + "/log.csv"),
        bundle_(config.output + "/" + config.name + ".pt") {
    at::set_num_threads(config.threads > 0 ? config.threads : static_cast<int>(available_processors()));
    type_ = config.precision == "bfloat16" ? torch::kBFloat16 : torch::kFloat32;
  }

  TrainResult run() {
    std::error_code error;
    std::filesystem::create_directories(config_.output, error);
    if (error)
      throw Error(ErrorCode::kResourceExhausted, config_.output + ": can't make the folder: " + error.message());
    const Conditioning conditioning = measure(data_, config_.architecture);
    for (Network* network : {&network_, &averaged_}) {
      network->set_conditioning(conditioning);
      network->set_mesh_base(data_.mesh_base, data_.normalization, data_.coarse_height(), data_.coarse_width());
    }
    network_.to(device_);
    averaged_.to(device_);
    Adam adam(network_.parameter_values(), config_.optimizer);
    if (std::filesystem::exists(checkpoint_)) {
      load_checkpoint(checkpoint_, config_json_, network_, adam, state_);
      say("resumed at epoch " + std::to_string(state_.epoch + 1) + ", step " + std::to_string(state_.step));
    } else if (!config_.initial.empty()) {
      load_initial(config_.initial, network_);
      for (std::size_t i = 0; i < adam.parameters.size(); ++i) adam.average[i] = adam.parameters[i].detach().clone();
      say("weights begin as those of " + config_.initial);
    }
    cut_log(log_, state_.epoch);
    set_constants(conditioning);
    result_.best = report_from_json(state_.best_report);
    if (state_.best_epoch >= 0) result_.bundle = bundle_;
    measure_baseline();
    say("network of " + std::to_string(network_.parameter_count()) + " parameters, " +
        std::to_string(sampler_.steps_per_epoch()) + " steps an epoch, on " + device_.str());

    started_ = Clock::now();
    saved_ = started_;
    while (state_.epoch < config_.epochs) {
      if (!train_epoch(adam)) {
        save(adam);
        if (result_.reason == StopReason::kMinutes && state_.step > 0) {
          // The part of an epoch that was trained counts too.
          finish_epoch(adam, state_.step);
        }
        return result_;
      }
      finish_epoch(adam, sampler_.steps_per_epoch());
      ++state_.epoch;
      state_.step = 0;
      std::fill(std::begin(state_.sums), std::end(state_.sums), 0.0);
      save(adam);
    }
    result_.reason = StopReason::kEpochs;
    return result_;
  }

 private:
  torch::Device choose_device() const {
    const bool available = torch::cuda::is_available();
    if (config_.device == "cuda" && !available) {
      throw Error(ErrorCode::kFailedPrecondition, "key 'device' = 'cuda': LibTorch sees no CUDA device");
    }
    return available && config_.device != "cpu" ? torch::Device(torch::kCUDA, 0) : torch::Device(torch::kCPU);
  }

  void say(const std::string& text) const {
    if (hooks_.line) hooks_.line(text);
  }

  double minutes() const {
    return state_.minutes + std::chrono::duration<double>(Clock::now() - started_).count() / 60;
  }

  void set_constants(const Conditioning& conditioning) {
    std::vector<float> minimum(kChannels), range(kChannels);
    for (std::size_t c = 0; c < kChannels; ++c) {
      minimum[c] = data_.normalization.minimum[c];
      range[c] = data_.normalization.maximum[c] - minimum[c];
    }
    constants_.minimum = torch::tensor(minimum).to(device_);
    constants_.range = torch::tensor(range).to(device_);
    constants_.deviation = torch::tensor(conditioning.output_deviation).to(device_);
    constants_.frame_time_s = data_.frame_time_s;
  }

  double learning_rate(std::int64_t step) const {
    const ScheduleConfig& s = config_.schedule;
    double rate = config_.optimizer.learning_rate;
    if (s.kind == "step") {
      rate *= std::pow(0.1, std::min(state_.epoch, s.fixed_after) / s.step_epochs);
    } else if (s.kind == "cosine") {
      const double all = static_cast<double>(config_.epochs) * sampler_.steps_per_epoch();
      double done = static_cast<double>(step) / all;
      if (s.progress == "minutes") done = std::max(done, minutes() / config_.max_minutes);
      const double wave = 0.5 * (1 + std::cos(3.14159265358979323846 * std::clamp(done, 0.0, 1.0)));
      rate *= s.final_factor + (1 - s.final_factor) * wave;
    }
    if (step < s.warm_up_steps) rate *= static_cast<double>(step + 1) / s.warm_up_steps;
    return rate;
  }

  bool out_of_time() const { return config_.max_minutes > 0 && minutes() >= config_.max_minutes; }
  bool stopped() const { return hooks_.stop != nullptr && hooks_.stop->load(); }

  /// False if the training has to end before the epoch does.
  bool train_epoch(Adam& adam) {
    const int steps = sampler_.steps_per_epoch();
    while (state_.step < steps) {
      if (stopped() || out_of_time()) {
        result_.reason = stopped() ? StopReason::kStopped : StopReason::kMinutes;
        return false;
      }
      Batch batch = sampler_.batch(state_.epoch, state_.step);
      for (auto* t : {&batch.coarse, &batch.fine, &batch.mask, &batch.rotations}) *t = t->to(device_);
      if (batch.base.defined()) batch.base = batch.base.to(device_), batch.structure = batch.structure.to(device_);
      const auto synthesized = batch.base.defined() ? network_.forward(batch.coarse, batch.base, batch.structure, type_)
                                                    : network_.forward(batch.coarse, type_);
      const Losses losses = compute_losses(synthesized, batch, constants_, config_.losses);
      const auto values =
          torch::stack({losses.total, losses.displacement, losses.normal, losses.velocity, losses.kinematic})
              .detach()
              .to(torch::kCPU, torch::kFloat64);
      const double* v = values.data_ptr<double>();
      if (!std::isfinite(v[0])) {
        throw Error(ErrorCode::kInternal, "loss is not finite at epoch " + std::to_string(state_.epoch + 1) +
                                              ", step " + std::to_string(state_.step + 1) +
                                              "; windows (sequence:frame) " +
                                              sampler_.describe(state_.epoch, state_.step));
      }
      losses.total.backward();
      rate_ = learning_rate(adam.steps);
      adam.step(rate_);
      for (int i = 0; i < 5; ++i) state_.sums[i] += v[i];
      ++state_.step;
      if (hooks_.progress) hooks_.progress(state_.epoch + 1, static_cast<double>(state_.step) / steps, v[0]);
      if (config_.checkpoint_minutes > 0 && state_.step < steps &&
          std::chrono::duration<double>(Clock::now() - saved_).count() > 60 * config_.checkpoint_minutes) {
        save(adam);
      }
    }
    return true;
  }

  void save(const Adam& adam) {
    TrainState state = state_;
    state.minutes = minutes();
    save_checkpoint(checkpoint_, config_json_, network_, adam, state);
    saved_ = Clock::now();
  }

  void finish_epoch(const Adam& adam, int steps) {
    EpochReport report;
    report.epoch = state_.epoch + 1;
    report.steps = adam.steps;
    report.learning_rate = rate_;
    const double n = std::max(1, steps);
    report.total = state_.sums[0] / n, report.displacement = state_.sums[1] / n, report.normal = state_.sums[2] / n;
    report.velocity = state_.sums[3] / n, report.kinematic = state_.sums[4] / n;
    const bool last = report.epoch == config_.epochs || steps < sampler_.steps_per_epoch();
    if (last || report.epoch % config_.validation.every_epochs == 0) validate(adam, report);
    report.minutes = minutes();
    if (report.best) {
      result_.best = report;
      state_.best_report = to_json(report).dump();
      write_bundle(report);
    }
    result_.last = report;
    std::ofstream log(log_, std::ios::app);
    log << csv_row(report) << "\n";
    if (!log.flush()) throw Error(ErrorCode::kResourceExhausted, log_ + ": can't write");
    char text[256];
    std::snprintf(text, sizeof text, "epoch %d  %.1f min  rate %.2e  loss %.4e", report.epoch, report.minutes,
                  report.learning_rate, report.total);
    std::string line = text;
    if (report.validated) {
      std::snprintf(text, sizeof text, "  PSNR %.2f dB  VMSE %.3e m2  RMSE %.2f mm%s", report.psnr_db, report.vmse_m2,
                    1e3 * std::sqrt(report.vmse_m2), report.best ? "  best" : "");
      line += text;
    }
    say(line);
  }

  template <typename Body>
  void for_validation_frames(const Body& body) const {
    for (std::size_t s = 0; s < data_.sequences.size(); ++s) {
      if (!data_.sequences[s].validation) continue;
      for (std::size_t f = 0; f < data_.sequences[s].coarse.size();
           f += static_cast<std::size_t>(config_.validation.every_frames)) {
        body(s, f);
      }
    }
  }

  torch::Tensor read(const ImageStore& store, std::size_t frame) const {
    const auto image = torch::empty({1, kChannels, store.height(), store.width()});
    store.read(frame, 0, 0, store.height(), store.width(), image.data_ptr<float>());
    return image;
  }

  /// Mean over valid texels of the squared displacement error, three channels.
  double displacement_error(const torch::Tensor& image, std::size_t sequence, std::size_t frame) const {
    const auto& fine = data_.sequences[sequence].fine;
    const auto mask = torch::from_blob(const_cast<std::uint8_t*>(data_.fine_mask.data()),
                                       {1, 1, fine.height(), fine.width()}, torch::kUInt8)
                          .to(torch::kFloat32);
    const auto error = (image - read(fine, frame)).slice(1, 0, 3).square() * mask;
    return error.sum().item<double>() / (3 * mask.sum().item<double>());
  }

  void measure_baseline() {
    double bilinear = 0, barycentric = 0, vmse = 0, count = 0;
    for_validation_frames([&](std::size_t s, std::size_t f) {
      const auto& sequence = data_.sequences[s];
      bilinear += displacement_error(upsample_bilinear(read(sequence.coarse, f)), s, f);
      if (judge_ != nullptr) {
        const auto values = judge_->barycentric_image(s, f);
        const auto image = torch::from_blob(const_cast<float*>(values.data()),
                                            {1, kChannels, sequence.fine.height(), sequence.fine.width()});
        barycentric += displacement_error(image, s, f);
        vmse += judge_->barycentric_squared_error(s, f);
      }
      count += 1;
    });
    if (count == 0) throw_invalid_argument("data set: no frames to validate on");
    BaselineReport& b = result_.baseline;
    b.bilinear_psnr_db = decibel(bilinear / count);
    if (judge_ != nullptr) b.barycentric_psnr_db = decibel(barycentric / count), b.barycentric_vmse_m2 = vmse / count;
    char text[256];
    std::snprintf(
        text, sizeof text,
        "validation on %.0f frames; bilinear image PSNR %.2f dB; barycentric mesh PSNR %.2f dB, VMSE %.3e m2, "
        "RMSE %.2f mm",
        count, b.bilinear_psnr_db, b.barycentric_psnr_db, b.barycentric_vmse_m2,
        1e3 * std::sqrt(b.barycentric_vmse_m2));
    say(text);
  }

  void validate(const Adam& adam, EpochReport& report) {
    const torch::NoGradGuard no_grad;
    for (std::size_t i = 0; i < adam.average.size(); ++i) {
      auto value = averaged_.parameters()[i].second;
      value.copy_(adam.average[i]);
    }
    for (std::size_t i = 0; i < network_.buffers().size(); ++i) {
      auto value = averaged_.buffers()[i].second;
      value.copy_(network_.buffers()[i].second);
    }
    double image_error = 0, mesh_error = 0, count = 0;
    for_validation_frames([&](std::size_t s, std::size_t f) {
      const auto input = read(data_.sequences[s].coarse, f).to(device_);
      const auto output = averaged_.forward(input, type_).to(torch::kCPU).contiguous();
      image_error += displacement_error(output, s, f);
      if (judge_ != nullptr) {
        mesh_error += judge_->squared_error(s, f, {output.data_ptr<float>(), static_cast<std::size_t>(output.numel())});
      }
      count += 1;
    });
    report.validated = true;
    report.psnr_db = decibel(image_error / count);
    report.vmse_m2 = mesh_error / count;
    const double score = judge_ != nullptr ? report.vmse_m2 : image_error / count;
    if (!std::isfinite(score))
      throw Error(ErrorCode::kInternal, "validation error is not finite at epoch " + std::to_string(report.epoch));
    report.best = state_.best_epoch < 0 || score < state_.best_score;
    if (report.best) state_.best_epoch = state_.epoch, state_.best_score = score;
  }

  void write_bundle(const EpochReport& report) {
    Metadata m;
    m.name = config_.name;
    m.architecture = config_.architecture;
    m.normalization = data_.normalization;
    m.coarse_width = data_.coarse_width(), m.coarse_height = data_.coarse_height();
    m.fine_width = kScale * m.coarse_width, m.fine_height = kScale * m.coarse_height;
    m.image_spec = data_.image_spec;
    m.topology_hash = data_.topology_hash;
    m.float32_parameters = Network::float32_parameters();
    json training = json::parse(data_.description);
    training["config"] = json::parse(config_json_);
    training["epoch"] = report.epoch;
    training["steps"] = report.steps;
    training["minutes"] = report.minutes;
    training["device"] = device_.str();
    m.training = training.dump();
    m.metrics = {{"psnr_db", report.psnr_db}, {"bilinear_psnr_db", result_.baseline.bilinear_psnr_db}};
    if (judge_ != nullptr) {
      m.metrics["vmse_m2"] = report.vmse_m2;
      m.metrics["rmse_m"] = std::sqrt(report.vmse_m2);
      m.metrics["barycentric_psnr_db"] = result_.baseline.barycentric_psnr_db;
      m.metrics["barycentric_vmse_m2"] = result_.baseline.barycentric_vmse_m2;
      m.metrics["barycentric_rmse_m"] = std::sqrt(result_.baseline.barycentric_vmse_m2);
    }
    m.git_revision = hooks_.git_revision;
    m.parameters = averaged_.parameter_count();
    save_bundle(averaged_.to_script(), m, bundle_);
    result_.bundle = bundle_;
  }

  const TrainConfig& config_;
  const PairData& data_;
  MeshJudge* judge_;
  const TrainHooks& hooks_;
  Sampler sampler_;
  Network network_, averaged_;
  torch::Device device_;
  torch::ScalarType type_ = torch::kFloat32;
  std::string config_json_, checkpoint_, log_, bundle_;
  LossConstants constants_;
  TrainState state_;
  TrainResult result_;
  double rate_ = 0;
  Clock::time_point started_ = Clock::now(), saved_ = started_;
};

}  // namespace

TrainResult train(const TrainConfig& config, const PairData& data, MeshJudge* judge, const TrainHooks& hooks) {
  return Trainer(config, data, judge, hooks).run();
}

}  // namespace pleat::superres
