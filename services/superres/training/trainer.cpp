#include "services/superres/training/trainer.hpp"

#include <ATen/Parallel.h>
#include <torch/script.h>
#include <torch/torch.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <new>
#include <nlohmann/json.hpp>

#include "common/base/error.hpp"
#include "common/base/own_file.hpp"
#include "common/base/parallel.hpp"
#include "common/base/statistics.hpp"
#include "common/base/whole_file.hpp"
#include "common/features/channels.hpp"
#include "services/superres/bundle/bundle.hpp"
#include "services/superres/bundle/folder.hpp"
#include "services/superres/networks/torch_threads.hpp"
#include "services/superres/training/checkpoint.hpp"
#include "services/superres/training/communicator.hpp"
#include "services/superres/training/initial.hpp"
#include "services/superres/training/log.hpp"
#include "services/superres/training/remembering.hpp"
#include "services/superres/training/sampler.hpp"

namespace pleat::superres {
namespace {

using nlohmann::json;
using Clock = std::chrono::steady_clock;

/// Values that the processes share after each step: the losses, the first one's wish to stop, and its clock.
constexpr std::int64_t kStop = kLossParts, kMinutes = kStop + 1, kShared = kMinutes + 1;

bool out_of_memory(const std::exception& error) {
  if (dynamic_cast<const std::bad_alloc*>(&error) != nullptr) return true;
  const std::string text = error.what();
  return text.find("out of memory") != std::string::npos || text.find("can't allocate memory") != std::string::npos;
}

/// Seconds that all threads of this process have computed.
double processor_seconds() {
  timespec t{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

/// Finite, for the log.
double decibel(double mean_square) { return std::min(psnr_db(mean_square), 200.0); }

/// The configuration and what it was applied to: a training can't go on with a data set that has grown meanwhile.
std::string identity(const TrainConfig& config, const PairData& data) {
  json result = json::parse(pleat::superres::to_json(config));
  json sequences = json::object();
  for (const PairSequence& sequence : data.sequences) sequences[sequence.name] = sequence.input.size();
  const auto ranges = [](const ChannelRanges& r) { return json{{"offset", r.offset}, {"scale", r.scale}}; };
  result["data"] = {{"sequences", std::move(sequences)},
                    {"input", ranges(data.input_ranges)},
                    {"output", ranges(data.output_ranges)}};
  return result.dump();
}

constexpr std::size_t kMeasuredFrames = 256;

torch::Tensor read_image(const ImageStore& store, std::size_t frame) {
  const auto image = torch::empty({1, store.channels(), store.height(), store.width()});
  store.read(frame, 0, 0, store.height(), store.width(), image.data_ptr<float>());
  return image;
}

/// The answer of no network: nothing, to be added to the upsampled mesh; or the newest frame, bilinearly upsampled.
torch::Tensor plain_answer(const PairData& data, const PairSequence& sequence, std::size_t frame) {
  const ImageStore& answer = sequence.answer;
  const int frame_channels = static_cast<int>(data.input_ranges.channels());
  if (data.detail() || frame_channels != answer.channels()) {
    return torch::zeros({1, answer.channels(), answer.height(), answer.width()});
  }
  const auto input = read_image(sequence.input, frame);
  return upsample_bilinear(input.slice(1, input.size(1) - frame_channels), data.scale());
}

/// Deviation of what that lacks, per channel, on some frames of the training sequences.
std::vector<float> measure_deviation(const PairData& data) {
  const torch::NoGradGuard no_grad;
  const std::size_t stride = std::max<std::size_t>(1, data.training_frames() / kMeasuredFrames);
  const auto channels = static_cast<std::size_t>(data.sequences.front().answer.channels());
  RangeMeasure measure(channels);
  std::size_t index = 0;
  for (const PairSequence& sequence : data.sequences) {
    if (sequence.validation) continue;
    for (std::size_t f = 0; f < sequence.answer.size(); ++f, ++index) {
      if (index % stride != 0) continue;
      const auto lack = (read_image(sequence.answer, f) - plain_answer(data, sequence, f)).contiguous();
      measure.add({lack.data_ptr<float>(), static_cast<std::size_t>(lack.numel())}, data.mesh_of(sequence).answer_mask);
    }
  }
  auto deviation = measure.moments().scale;
  for (float& d : deviation) d = std::max(d, 1e-6F);
  return deviation;
}

/// By which the losses of each mesh are multiplied: the less detail it has the more, so that what can be known of a
/// quiet garment is not lost beside a lively one. 1 of a single one.
std::vector<double> mesh_weights(const PairData& data, const std::vector<float>& deviation) {
  constexpr double kMost = 8;
  constexpr std::size_t kFrames = 8;  // of a sequence
  std::vector<double> squares(data.meshes.size(), 0), counts(data.meshes.size(), 0);
  for (const PairSequence& sequence : data.sequences) {
    if (sequence.validation) continue;
    const auto& mask = data.mesh_of(sequence).answer_mask;
    const std::size_t frames = sequence.answer.size(), stride = std::max<std::size_t>(1, frames / kFrames);
    for (std::size_t f = stride / 2; f < frames; f += stride) {
      const auto lack = (read_image(sequence.answer, f) - plain_answer(data, sequence, f)).contiguous();
      const float* values = lack.data_ptr<float>();
      for (std::size_t i = 0; i < static_cast<std::size_t>(lack.numel()); ++i) {
        if (mask[i % mask.size()] == 0) continue;
        squares[sequence.mesh] += std::pow(static_cast<double>(values[i] / deviation[i / mask.size()]), 2);
        counts[sequence.mesh] += 1;
      }
    }
  }
  double mean = 0, known = 0;
  for (std::size_t m = 0; m < squares.size(); ++m) {
    if (counts[m] > 0) mean += squares[m] / counts[m], known += 1;
  }
  std::vector<double> weights(data.meshes.size(), 1);
  for (std::size_t m = 0; known > 1 && m < weights.size(); ++m) {
    if (squares[m] > 0) weights[m] = std::clamp(mean / known * counts[m] / squares[m], 1 / kMost, kMost);
  }
  return weights;
}

class Trainer {
 public:
  Trainer(const TrainConfig& config, const PairData& data, MeshJudge* judge, const TrainHooks& hooks)
      : config_(config),
        data_(data),
        judge_(judge),
        hooks_(hooks),
        network_(describe(config.architecture, ports_of(data)), config.seed),
        averaged_(network_.description(), config.seed),
        sampler_(config, data, network_.description().remembered),
        type_(config.precision == "bfloat16" ? torch::kBFloat16 : torch::kFloat32),
        remembering_(config, network_, sampler_, type_),
        device_(choose_device()),
        config_json_(pleat::superres::to_json(config)),
        identity_(identity(config, data)),
        checkpoint_(config.output + "/checkpoint.pt"),
        log_(config.output + "/log.csv"),
        bundle_(config.output + "/" + config.name + ".pt"),
        communicator_(hooks.rank, hooks.processes, hooks.rendezvous, device_) {
    if (network_.description().ends_only) {
      throw_invalid_argument("key 'architecture.kind' = '" + config.architecture.kind +
                             "': needs the meshes of 'representation' = 'vertex_features'");
    }
    if (!network_.description().twins.empty() && config.autoencoders.epochs == 0) {
      throw_invalid_argument("key 'autoencoders.epochs': the network has autoencoders, which need some");
    }
    if (hooks.processes > config.batch) {
      throw_invalid_argument("key 'batch' = " + std::to_string(config.batch) + ": " + std::to_string(hooks.processes) +
                             " processes need as many windows a step");
    }
    if (data.meshes.size() > 1 && network_.description().remembers()) {
      throw_invalid_argument("key 'architecture': a network that remembers needs sequences of one mesh");
    }
    const int processors = std::max(1, static_cast<int>(available_processors()) / hooks.processes);
    set_torch_threads(config.threads > 0 ? config.threads : processors);
    micro_batch_ = config.micro_batch > 0 ? std::min(config.micro_batch, config.batch) : config.batch;
  }

  TrainResult run() {
    std::error_code error;
    std::filesystem::create_directories(config_.output, error);
    if (error)
      throw Error(ErrorCode::kResourceExhausted, config_.output + ": can't make the folder: " + error.message());
    if (first()) require_own_output();
    network_.to(device_);
    averaged_.to(device_);
    if (device_.is_cpu() && config_.kernels == "own") {
      network_.use_own_kernels(at::get_num_threads());
      averaged_.use_own_kernels(at::get_num_threads());
    }
    Adam adam(network_.parameter_values(), config_.optimizer);
    if (std::filesystem::exists(checkpoint_)) {
      load_checkpoint(checkpoint_, identity_, network_, adam, state_);
      say("resumed at epoch " + std::to_string(state_.epoch + 1) + ", step " + std::to_string(state_.step));
    } else if (!config_.initial.empty()) {
      take_initial_weights(config_, data_, network_);
      for (std::size_t i = 0; i < adam.parameters.size(); ++i) adam.average[i] = adam.parameters[i].detach().clone();
      say("weights begin as those of " + config_.initial);
    }
    history_ = read_log(log_, state_.epoch);
    if (first()) write_log(log_, history_);
    set_constants();
    result_.best = report_from_json(state_.best_report);
    if (state_.best_epoch >= 0) result_.bundle = bundle_;
    if (first()) measure_baseline();
    say("network of " + std::to_string(network_.parameter_count()) + " parameters, " +
        std::to_string(sampler_.steps_per_epoch()) + " steps an epoch, on " + device_.str());

    started_ = Clock::now();
    started_processor_ = processor_seconds();
    saved_ = started_;
    while (state_.epoch < config_.epochs) {
      remembering_.hold_autoencoders(state_.epoch, adam);
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
    if (!available || config_.device == "cpu") return {torch::kCPU};
    return {torch::kCUDA, static_cast<c10::DeviceIndex>(hooks_.rank % static_cast<int>(torch::cuda::device_count()))};
  }

  void say(const std::string& text) const {
    if (hooks_.line && first()) hooks_.line(text);
  }

  double minutes() const {
    const double seconds = config_.clock == "processor"
                               ? processor_seconds() - started_processor_
                               : std::chrono::duration<double>(Clock::now() - started_).count();
    return state_.minutes + seconds / 60;
  }

  void set_constants() {
    LossConstants shared;
    shared.offset = torch::tensor(data_.output_ranges.offset).to(device_);
    shared.scale = torch::tensor(data_.output_ranges.scale).to(device_);
    const std::vector<float> deviation = measure_deviation(data_);
    weights_ = mesh_weights(data_, deviation);
    shared.deviation = torch::tensor(deviation).to(device_);
    shared.normal = find_frame_channels(data_.answer_channels, kNormalChannel);
    shared.velocity = find_frame_channels(data_.answer_channels, kVelocityChannel);
    shared.frame_time_s = data_.frame_time_s;
    constants_.assign(data_.meshes.size(), shared);
    for (std::size_t m = 0; config_.losses.needs_vertices() && m < data_.meshes.size(); ++m) {
      constants_[m].set_vertices(data_.meshes[m].mesh_read, device_);
    }
  }

  double learning_rate(std::int64_t step) const {
    const ScheduleConfig& s = config_.schedule;
    double rate = config_.optimizer.learning_rate;
    if (s.kind == "step") {
      rate *= std::pow(0.1, std::min(state_.epoch, s.fixed_after) / s.step_epochs);
    } else if (s.kind == "cosine") {
      const double all = static_cast<double>(config_.epochs) * sampler_.steps_per_epoch();
      double done = static_cast<double>(step) / all;
      if (s.progress == "minutes") done = std::max(done, shared_minutes_ / config_.max_minutes);
      const double wave = 0.5 * (1 + std::cos(3.14159265358979323846 * std::clamp(done, 0.0, 1.0)));
      rate *= s.final_factor + (1 - s.final_factor) * wave;
    }
    if (step < s.warm_up_steps) rate *= static_cast<double>(step + 1) / s.warm_up_steps;
    return rate;
  }

  bool first() const { return communicator_.rank() == 0; }
  bool out_of_time() const { return config_.max_minutes > 0 && minutes() >= config_.max_minutes; }
  bool stopped() const { return hooks_.stop != nullptr && hooks_.stop->load(); }

  const Description& description() const { return network_.description(); }

  /// Losses of this process's windows, weighted by their share of the step's valid texels; gradients are added up.
  void accumulate(int begin, int end, double texels, torch::Tensor& values) {
    Batch batch = sampler_.batch(state_.epoch, state_.step, begin, end);
    const double share = weights_[batch.mesh] * batch.mask.sum().item<double>() / texels;
    batch.to(device_);
    if (remembering_.in_autoencoders(state_.epoch)) {
      const auto loss = remembering_.autoencoder_loss(batch);
      values[0] += share * loss.detach().to(torch::kCPU, torch::kFloat64);
      (loss * share).backward();
      return;
    }
    torch::Tensor codes;
    const auto synthesized = description().remembers()
                                 ? remembering_.answers(batch, state_.epoch, state_.step, begin, codes)
                                 : sampler_.unmirrored(network_.forward(batch.input, type_), batch);
    Losses losses = compute_losses(synthesized, batch, constants_[batch.mesh], config_.losses);
    if (codes.defined()) losses.total = losses.total + config_.losses.codes * codes;
    const auto parts =
        torch::stack({losses.total, losses.displacement, losses.normal, losses.velocity, losses.kinematic,
                      losses.vertices, losses.vertex_normals, losses.edges, losses.wrinkles})
            .detach()
            .to(torch::kCPU, torch::kFloat64);
    values.slice(0, 0, kLossParts) += share * parts;
    (losses.total * share).backward();
  }

  /// All windows of a step that belong to this process. Returns the shared values before they are summed.
  torch::Tensor gradients() {
    const int windows = config_.batch, rank = communicator_.rank(), size = communicator_.size();
    const int begin = windows * rank / size, end = windows * (rank + 1) / size;
    const double texels = sampler_.valid_texels(state_.epoch, state_.step);
    for (;;) {
      auto values = torch::zeros({kShared}, torch::kFloat64);
      try {
        int first = begin;
        for (const int last : sampler_.passes(state_.epoch, state_.step, begin, end, micro_batch_)) {
          accumulate(first, last, texels, values);
          first = last;
        }
        return values;
      } catch (const Error&) {
        throw;
      } catch (const std::exception& error) {
        if (!out_of_memory(error)) throw;
        if (micro_batch_ == 1) {
          throw Error(ErrorCode::kResourceExhausted, "the device has too little memory for one window of a step");
        }
      }
      // Not in the handler: the exception may hold what has to be freed.
      for (const auto& [name, parameter] : network_.parameters()) parameter.mutable_grad() = torch::Tensor();
      micro_batch_ = std::min(micro_batch_, end - begin) / 2;
      say("out of memory: passes take " + std::to_string(micro_batch_) + " windows from now on");
    }
  }

  void sum_gradients(const Adam& adam) {
    if (communicator_.size() == 1) return;
    std::vector<torch::Tensor> parts;
    for (const auto& p : adam.parameters) {
      if (p.requires_grad()) parts.push_back(p.grad().defined() ? p.grad().flatten() : torch::zeros_like(p).flatten());
    }
    const auto all = torch::cat(parts);
    communicator_.sum(all);
    std::int64_t place = 0;
    for (const auto& p : adam.parameters) {
      if (!p.requires_grad()) continue;
      p.mutable_grad() = all.slice(0, place, place + p.numel()).view(p.sizes());
      place += p.numel();
    }
  }

  /// False if the training has to end before the epoch does.
  bool train_epoch(Adam& adam) {
    const int steps = sampler_.steps_per_epoch();
    while (state_.step < steps) {
      if (communicator_.size() == 1) {
        stop_ = stopped() || out_of_time();
        shared_minutes_ = minutes();
      }
      if (stop_) {
        result_.reason = stopped() ? StopReason::kStopped : StopReason::kMinutes;
        return false;
      }
      auto values = gradients();
      if (communicator_.size() > 1) {
        if (first()) {
          values[kStop] = stopped() || out_of_time() ? 1.0 : 0.0;
          values[kMinutes] = minutes();
        }
        communicator_.sum(values);
        stop_ = values[kStop].item<double>() > 0;
        shared_minutes_ = values[kMinutes].item<double>();
      }
      const double* v = values.data_ptr<double>();
      if (!std::isfinite(v[0])) {
        throw Error(ErrorCode::kInternal, "loss is not finite at epoch " + std::to_string(state_.epoch + 1) +
                                              ", step " + std::to_string(state_.step + 1) +
                                              "; windows (sequence:frame) " +
                                              sampler_.describe(state_.epoch, state_.step));
      }
      sum_gradients(adam);
      rate_ = learning_rate(adam.steps);
      adam.step(rate_);
      for (int i = 0; i < kLossParts; ++i) state_.sums[i] += v[i];
      ++state_.step;
      if (hooks_.progress && first()) hooks_.progress(state_.epoch + 1, static_cast<double>(state_.step) / steps, v[0]);
      if (config_.checkpoint_minutes > 0 && state_.step < steps &&
          std::chrono::duration<double>(Clock::now() - saved_).count() > 60 * config_.checkpoint_minutes) {
        save(adam);
      }
    }
    return true;
  }

  void save(const Adam& adam) {
    if (!first()) return;
    TrainState state = state_;
    state.minutes = minutes();
    save_checkpoint(checkpoint_, identity_, network_, adam, state);
    saved_ = Clock::now();
  }

  void finish_epoch(const Adam& adam, int steps) {
    if (!first()) return;
    EpochReport report;
    report.epoch = state_.epoch + 1;
    report.steps = adam.steps;
    report.learning_rate = rate_;
    const double n = std::max(1, steps);
    report.total = state_.sums[0] / n, report.displacement = state_.sums[1] / n, report.normal = state_.sums[2] / n;
    report.velocity = state_.sums[3] / n, report.kinematic = state_.sums[4] / n;
    report.vertices = state_.sums[5] / n, report.vertex_normals = state_.sums[6] / n, report.edges = state_.sums[7] / n;
    report.wrinkles = state_.sums[8] / n;
    const bool last = report.epoch == config_.epochs || steps < sampler_.steps_per_epoch();
    if (last || report.epoch % config_.validation.every_epochs == 0) validate(adam, report);
    report.minutes = minutes();
    history_.push_back(report);
    if (report.best) {
      result_.best = report;
      state_.best_report = to_json(report);
      write_bundle(report);
    }
    result_.last = report;
    write_log(log_, history_);
    write_curves();
    char text[256];
    std::snprintf(text, sizeof text, "epoch %d  %.1f min  rate %.2e  loss %.4e", report.epoch, report.minutes,
                  report.learning_rate, report.total);
    std::string line = text;
    if (report.validated) {
      std::snprintf(text, sizeof text, "  PSNR %.2f dB  VMSE %.3e m2  RMSE %.2f mm", report.psnr_db, report.vmse_m2,
                    1e3 * std::sqrt(report.vmse_m2));
      line += text;
      std::snprintf(text, sizeof text, "  gain %.2f dB", report.gain_db);
      if (data_.meshes.size() > 1 && judge_ != nullptr) line += text;
      if (report.best) line += "  best";
    }
    say(line);
  }

  std::string curves_file() const { return config_.output + "/log.html"; }

  /// What a training replaces must be a training's. A check-point that is none ends it anyway.
  void require_own_output() const {
    require_replaceable(log_, kLogMarks);
    require_replaceable(curves_file(), kCurvesMarks);
    bool bundle = true;
    try {
      if (std::filesystem::exists(bundle_)) read_metadata(config_.output, config_.name);
    } catch (const Error&) {
      bundle = false;
    }
    require_absent_or(bundle, bundle_);
  }

  void write_curves() const { write_whole_file(curves_file(), curves_page(config_.name, history_, result_.baseline)); }

  template <typename Body>
  void for_validation_frames(const Body& body) const {
    for (std::size_t s = 0; s < data_.sequences.size(); ++s) {
      if (!data_.sequences[s].validation) continue;
      for (std::size_t f = 0; f < data_.sequences[s].input.size();
           f += static_cast<std::size_t>(config_.validation.every_frames)) {
        body(s, f);
      }
    }
  }

  /// Mean squared errors over valid texels and the three channels of displacement, normal and velocity; 0 for those
  /// that the answer does not have.
  torch::Tensor feature_errors(const torch::Tensor& image, std::size_t sequence, std::size_t frame) const {
    const auto& answer = data_.sequences[sequence].answer;
    const auto& valid = data_.mesh_of(data_.sequences[sequence]).answer_mask;
    const auto mask = torch::from_blob(const_cast<std::uint8_t*>(valid.data()), {1, 1, answer.height(), answer.width()},
                                       torch::kUInt8)
                          .to(torch::kFloat32);
    const auto error = (image - read_image(answer, frame)).square() * mask;
    auto result = torch::zeros({3}, torch::kFloat64);
    const std::int64_t triples = answer.channels() / 3;
    const auto sums = error.slice(1, 0, 3 * triples).reshape({triples, -1}).sum(1).to(torch::kFloat64).slice(0, 0, 3);
    result.slice(0, 0, sums.size(0)) += sums / (3 * mask.sum().item<double>());
    return result;
  }
  double displacement_error(const torch::Tensor& image, std::size_t sequence, std::size_t frame) const {
    return feature_errors(image, sequence, frame)[0].item<double>();
  }

  void measure_baseline() {
    double plain = 0, barycentric = 0, vmse = 0, count = 0;
    upsampling_errors_.assign(data_.sequences.size(), 0);
    for_validation_frames([&](std::size_t s, std::size_t f) {
      const auto& sequence = data_.sequences[s];
      plain += displacement_error(plain_answer(data_, sequence, f), s, f);
      if (judge_ != nullptr) {
        const auto values = judge_->barycentric_answer(s, f);
        const ImageStore& answer = sequence.answer;
        const auto image = torch::from_blob(const_cast<float*>(values.data()),
                                            {1, answer.channels(), answer.height(), answer.width()});
        barycentric += displacement_error(image, s, f);
        const double error = judge_->barycentric_squared_error(s, f);
        vmse += error;
        upsampling_errors_[s] += error;
      }
      count += 1;
    });
    if (count == 0) throw_invalid_argument("data set: no frames to validate on");
    BaselineReport& b = result_.baseline;
    b.plain_psnr_db = decibel(plain / count);
    if (judge_ != nullptr) b.barycentric_psnr_db = decibel(barycentric / count), b.barycentric_vmse_m2 = vmse / count;
    char text[256];
    std::snprintf(
        text, sizeof text,
        "validation on %.0f frames; without a network PSNR %.2f dB; barycentric mesh PSNR %.2f dB, VMSE %.3e m2, "
        "RMSE %.2f mm",
        count, b.plain_psnr_db, b.barycentric_psnr_db, b.barycentric_vmse_m2, 1e3 * std::sqrt(b.barycentric_vmse_m2));
    say(text);
  }

  /// The mean over the validation sequences of how far their errors, sums over the same frames, are below upsampling's.
  double mean_gain_db(const std::vector<double>& errors) const {
    constexpr double kNothing = 1e-12;  // m^2: a cloth that does not move
    double sum = 0, count = 0;
    for (std::size_t s = 0; s < errors.size(); ++s) {
      if (!data_.sequences[s].validation) continue;
      sum += 10 * std::log10((upsampling_errors_[s] + kNothing) / (errors[s] + kNothing));
      count += 1;
    }
    return sum / count;
  }

  /// (1, inputs, h, w)
  torch::Tensor validation_input(std::size_t s, std::size_t f) const {
    const PairSequence& sequence = data_.sequences[s];
    auto input = read_image(sequence.input, f);
    if (data_.constant_channels() > 0) {
      const auto constants = torch::tensor(data_.mesh_of(sequence).constants.values);
      input = torch::cat({input, constants.view({1, -1, sequence.input.height(), sequence.input.width()})}, 1);
    }
    return input.to(device_);
  }

  void validate(const Adam& adam, EpochReport& report) {
    const torch::NoGradGuard no_grad;
    for (std::size_t i = 0; i < adam.average.size(); ++i) {
      auto value = averaged_.parameters()[i].second;
      value.copy_(adam.average[i]);
    }
    auto errors = torch::zeros({3}, torch::kFloat64);
    double mesh_error = 0, count = 0;
    std::vector<double> sequence_errors(data_.sequences.size(), 0);
    const auto judge = [&](const torch::Tensor& answer, std::size_t s, std::size_t f) {
      const auto output = answer.to(torch::kCPU, torch::kFloat32).contiguous();
      errors += feature_errors(output, s, f);
      if (judge_ != nullptr) {
        const double error =
            judge_->squared_error(s, f, {output.data_ptr<float>(), static_cast<std::size_t>(output.numel())});
        mesh_error += error;
        sequence_errors[s] += error;
      }
      count += 1;
    };
    if (description().remembers() && !remembering_.in_autoencoders(state_.epoch)) {
      for (std::size_t s = 0; s < data_.sequences.size(); ++s) {
        if (!data_.sequences[s].validation) continue;
        run_on_own_answers(
            averaged_, data_.sequences[s].input.size(), type_, [&](std::size_t f) { return validation_input(s, f); },
            [&](const torch::Tensor& answer, std::size_t f) {
              if (f % static_cast<std::size_t>(config_.validation.every_frames) == 0) judge(answer, s, f);
            });
      }
    } else {
      for_validation_frames([&](std::size_t s, std::size_t f) {
        const auto input = validation_input(s, f);
        if (!remembering_.in_autoencoders(state_.epoch)) return judge(averaged_.forward(input, type_), s, f);
        const auto truth = read_image(data_.sequences[s].answer, f).to(device_);
        judge(averaged_.values({input, {}, truth}, {description().reconstructed}, type_).front(), s, f);
      });
    }
    report.validated = true;
    const double image_error = errors[0].item<double>();
    report.psnr_db = decibel(image_error / count);
    if (constants_.front().normal >= 0 && constants_.front().velocity >= 0) {
      report.psnr_normal_db = decibel(errors[1].item<double>() / count);
      report.psnr_velocity_db = decibel(errors[2].item<double>() / count);
    }
    report.vmse_m2 = mesh_error / count;
    const bool several = data_.meshes.size() > 1 && judge_ != nullptr;
    if (several) report.gain_db = mean_gain_db(sequence_errors);
    const double mesh_score = several ? -report.gain_db : report.vmse_m2;
    const double score = judge_ != nullptr ? mesh_score : image_error / count;
    if (!std::isfinite(score))
      throw Error(ErrorCode::kInternal, "validation error is not finite at epoch " + std::to_string(report.epoch));
    report.best = !remembering_.in_autoencoders(state_.epoch) && (state_.best_epoch < 0 || score < state_.best_score);
    if (report.best) state_.best_epoch = state_.epoch, state_.best_score = score;
  }

  void write_bundle(const EpochReport& report) {
    Metadata m;
    m.name = config_.name;
    m.architecture = config_.architecture;
    m.representation = data_.representation;
    m.input = data_.input_ranges, m.output = data_.output_ranges;
    m.constants = data_.constant_channels();
    if (description().remembers()) m.input_size = {data_.height(), data_.width()};
    if (description().remembers()) m.memory = averaged_.description().memory_shape({data_.height(), data_.width()});
    m.topology_hash = data_.meshes.front().topology_hash;
    m.rest_positions = data_.meshes.front().rest_positions;
    if (config_.serves == "any") forget_mesh(m);
    m.float32_parameters = averaged_.float32_parameters();
    json training = json::parse(data_.description);
    training["config"] = json::parse(config_json_);
    training["epoch"] = report.epoch;
    training["steps"] = report.steps;
    training["minutes"] = report.minutes;
    training["device"] = device_.str();
    training["processes"] = communicator_.size();
    // Convergence of the three features, as [MFSR] figure 13 shows it.
    json curve = json::array();
    for (const EpochReport& r : history_) {
      if (r.validated) curve.push_back({r.epoch, r.minutes, r.psnr_db, r.psnr_normal_db, r.psnr_velocity_db});
    }
    training["curve"] = std::move(curve);
    m.training = training.dump();
    m.metrics = {{"psnr_db", report.psnr_db}, {"plain_psnr_db", result_.baseline.plain_psnr_db}};
    if (judge_ != nullptr) {
      m.metrics["vmse_m2"] = report.vmse_m2;
      m.metrics["rmse_m"] = std::sqrt(report.vmse_m2);
      m.metrics["barycentric_psnr_db"] = result_.baseline.barycentric_psnr_db;
      m.metrics["barycentric_vmse_m2"] = result_.baseline.barycentric_vmse_m2;
      m.metrics["barycentric_rmse_m"] = std::sqrt(result_.baseline.barycentric_vmse_m2);
      if (data_.meshes.size() > 1) m.metrics["gain_db"] = report.gain_db;
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
  Network network_, averaged_;
  Sampler sampler_;
  torch::ScalarType type_;
  Remembering remembering_;
  torch::Device device_;
  std::string config_json_, identity_, checkpoint_, log_, bundle_;
  Communicator communicator_;
  int micro_batch_ = 1;
  bool stop_ = false;
  double shared_minutes_ = 0;
  std::vector<EpochReport> history_;
  std::vector<LossConstants> constants_;   ///< of each mesh
  std::vector<double> weights_;            ///< of each mesh, of its losses
  std::vector<double> upsampling_errors_;  ///< of each validation sequence, the sum over its frames, m^2
  TrainState state_;
  TrainResult result_;
  double rate_ = 0;
  Clock::time_point started_ = Clock::now(), saved_ = started_;
  double started_processor_ = 0;
};

}  // namespace

TrainResult train(const TrainConfig& config, const PairData& data, MeshJudge* judge, const TrainHooks& hooks) {
  return Trainer(config, data, judge, hooks).run();
}

}  // namespace pleat::superres
