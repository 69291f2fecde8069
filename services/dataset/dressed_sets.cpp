#include "services/dataset/dressed_sets.hpp"

#include <algorithm>
#include <cstdio>
#include <iterator>

#include "common/base/error.hpp"
#include "services/dataset/poses.hpp"
#include "services/dataset/random.hpp"
#include "services/simulation/body/animated_body.hpp"
#include "services/simulation/body/retarget.hpp"

namespace pleat::dataset {
namespace {

namespace fs = std::filesystem;

constexpr double kBodyFriction = 0.6;  // of cloth on skin, as in deploy/scenes/dancer.json
constexpr int kStepsPerFrame = 4;      // likewise
// rad/s. A hem that turns with a dancer is thrown outwards by as much as weight and more: at the default of 7 the fine
// one was 0.3 m from the coarse one.
constexpr double kTrackingFrequency = 20;
constexpr double kShortest = 1.0;         // s: of a clip that is worth a sequence
constexpr int kEaseFrames = 15;           // [DT-S]
constexpr int kPublishedEaseFrames = 17;  // the time of [MFSR]'s 80 frames, which are captures of 120 a second
// CMU's names of the test motions of [MFSR], and what their files are called here.
constexpr const char* kTestClips[] = {"55_02", "05_04", "lambada", "005_04"};

struct Clip {
  fs::path file;
  body::Motion motion;  // of the body's skeleton
  bool test = false;
};

struct Piece {
  std::size_t clip;
  int first, end;  // frames of the data set, within the clip
};

bool is_motion(const fs::path& file) {
  const std::string extension = file.extension().string();
  return extension == ".amc" || extension == ".bvh";
}

std::vector<fs::path> motion_files(const std::vector<fs::path>& sources) {
  std::vector<fs::path> files;
  for (const fs::path& source : sources) {
    std::error_code error;
    if (!fs::is_directory(source, error)) {
      files.push_back(source);
      continue;
    }
    for (const fs::directory_entry& entry : fs::directory_iterator(source)) {
      if (is_motion(entry.path())) files.push_back(entry.path());
    }
  }
  // The order in a folder is the file system's.
  std::sort(files.begin(), files.end(), [](const fs::path& a, const fs::path& b) {
    return std::pair(a.filename(), a) < std::pair(b.filename(), b);
  });
  return files;
}

std::vector<Clip> read_clips(const SceneOptions& options, const body::SkinnedMesh& body,
                             std::vector<std::string>& notes) {
  std::vector<Clip> clips;
  for (const fs::path& file : motion_files(options.motions)) {
    std::vector<std::string> unasked;
    const body::Motion captured = body::read_motion(file, unasked);
    if (captured.duration_s() < kShortest) {
      notes.push_back(file.filename().string() + " is left out: shorter than a second");
      continue;
    }
    body::Motion motion = body::retarget(captured, body.skeleton, file.string(), options.body.string()).motion;
    const std::string stem = file.stem().string();
    const bool test = std::find(std::begin(kTestClips), std::end(kTestClips), stem) != std::end(kTestClips);
    clips.push_back({file, std::move(motion), test});
  }
  if (clips.empty()) throw_invalid_argument("data set: no motions (BVH, AMC) of a second at least");
  Random random(options.seed);
  for (std::size_t i = clips.size(); i > 1; --i) std::swap(clips[i - 1], clips[random.below(i)]);
  return clips;
}

body::MotionOptions motion_options(const BodyMotion& motion, double frame_time_s) {
  body::MotionOptions options;
  options.frame_time_s = frame_time_s;
  options.start_s = motion.start_s;
  options.end_s = motion.end_s;
  options.ease_frames = motion.ease_frames;
  options.mirrored = motion.mirrored;
  return options;
}

/// The frames [first, end) of a clip between those that cloth can't be worn in, where they are long enough.
std::vector<std::pair<int, int>> good_stretches(const Clip& clip, const PoseJudge& judge, const body::Skeleton& body,
                                                double frame_time_s, std::vector<std::string>& notes) {
  std::vector<std::string> unasked;
  const std::string name = clip.file.filename().string();
  const body::Motion motion =
      body::fit_motion(clip.motion, body, motion_options({}, frame_time_s), name, "the body", unasked);
  const std::vector<std::string> faults = judge.faults(motion);
  std::vector<std::pair<int, int>> stretches;
  const int frames = static_cast<int>(faults.size()), shortest = static_cast<int>(kShortest / frame_time_s);
  for (int k = 0, first = 0; k <= frames; ++k) {
    const bool end = k == frames, bad = !end && !faults[static_cast<std::size_t>(k)].empty();
    if (!end && !bad) continue;
    if (k - first >= shortest) stretches.emplace_back(first, k);
    first = k + 1;
  }
  for (int k = 0; k < frames; ++k) {
    const auto at = static_cast<std::size_t>(k);
    if (faults[at].empty() || (k > 0 && !faults[at - 1].empty())) continue;
    char time[32];
    std::snprintf(time, sizeof time, ", %.2f s: ", k * frame_time_s);
    notes.push_back(name + time + faults[at] + "; left out");
  }
  return stretches;
}

/// Equal pieces of at most `most` frames: the first one of every clip, then the second ones, ...
std::vector<Piece> cut(const std::vector<std::vector<std::pair<int, int>>>& stretches, int most) {
  std::vector<std::vector<Piece>> of_clips(stretches.size());
  std::size_t rounds = 0;
  for (std::size_t c = 0; c < stretches.size(); ++c) {
    for (const auto& [first, end] : stretches[c]) {
      const int count = (end - first + most - 1) / most;
      for (int k = 0; k < count; ++k) {
        of_clips[c].push_back({c, first + (end - first) * k / count, first + (end - first) * (k + 1) / count});
      }
    }
    rounds = std::max(rounds, of_clips[c].size());
  }
  std::vector<Piece> pieces;
  for (std::size_t k = 0; k < rounds; ++k) {
    for (const std::vector<Piece>& of_clip : of_clips) {
      if (k < of_clip.size()) pieces.push_back(of_clip[k]);
    }
  }
  return pieces;
}

/// The next `count` pieces of a split that cloth can be worn in.
class Choice {
 public:
  Choice(const SceneOptions& options, const std::vector<Clip>& clips, const PoseJudge& judge,
         const body::Skeleton& body, double frame_time_s, int ease_frames, std::vector<std::string>& notes)
      : options_(options),
        clips_(clips),
        judge_(judge),
        body_(body),
        frame_time_s_(frame_time_s),
        ease_frames_(ease_frames),
        notes_(notes) {
    std::vector<std::vector<std::pair<int, int>>> stretches;
    for (const Clip& clip : clips) stretches.push_back(good_stretches(clip, judge, body, frame_time_s, notes));
    for (const bool mirrored : {false, true}) {
      for (const Piece& piece : cut(stretches, options.frames - ease_frames)) {
        const bool test = clips[piece.clip].test;
        if (!(test && mirrored)) (test ? test_ : train_).emplace_back(piece, mirrored);
      }
    }
  }

  void add(const std::string& split, int count, std::vector<SequencePlan>& plans) {
    auto& candidates = split == "test" ? test_ : train_;
    std::size_t& next = split == "test" ? next_test_ : next_train_;
    int added = 0;
    for (; added < count && next < candidates.size(); ++next) {
      const auto& [piece, mirrored] = candidates[next];
      const Clip& clip = clips_[piece.clip];
      SequencePlan plan;
      plan.split = split;
      // The last frame that is not after the end is the last one: a quarter of a frame on, so that rounding is nothing.
      plan.body = BodyMotion{options_.body, clip.file, piece.first * frame_time_s_, (piece.end - 0.75) * frame_time_s_,
                             ease_frames_,  mirrored};
      std::vector<std::string> unasked;
      const body::Motion motion = body::fit_motion(clip.motion, body_, motion_options(*plan.body, frame_time_s_),
                                                   clip.file.string(), options_.body.string(), unasked);
      const std::vector<std::string> faults = judge_.faults(motion);
      const auto bad = std::find_if(faults.begin(), faults.end(), [](const auto& fault) { return !fault.empty(); });
      if (bad != faults.end()) {  // on the way from the rest pose
        char range[64];
        std::snprintf(range, sizeof range, "%.2f to %.2f s", plan.body->start_s, plan.body->end_s);
        notes_.push_back(clip.file.filename().string() + ", " + range + (mirrored ? ", mirrored" : "") + ": " + *bad +
                         "; left out");
        continue;
      }
      plan.scene.frames = static_cast<int>(motion.frames.size());
      plans.push_back(std::move(plan));
      ++added;
    }
    if (added < count) {
      notes_.push_back(std::to_string(added) + " of " + std::to_string(count) + " sequences (" + split +
                       "): the motions give no more");
    }
  }

 private:
  const SceneOptions& options_;
  const std::vector<Clip>& clips_;
  const PoseJudge& judge_;
  const body::Skeleton& body_;
  double frame_time_s_;
  int ease_frames_;
  std::vector<std::string>& notes_;
  std::vector<std::pair<Piece, bool>> train_, test_;  // and whether it is mirrored
  std::size_t next_train_ = 0, next_test_ = 0;
};

}  // namespace

std::vector<SequencePlan> plan_dressed(const SceneOptions& options, const Topology& cloth,
                                       std::vector<std::string>& notes) {
  const int ease_frames = options.set == "skirt" ? kPublishedEaseFrames : kEaseFrames;
  if (options.frames < ease_frames + 2) {
    throw_invalid_argument("data set: at least " + std::to_string(ease_frames + 2) +
                           " frames per sequence are needed, " + std::to_string(ease_frames) +
                           " of them lead into the motion");
  }
  const double frame_time_s = simulation::Scene().frame_time_s;
  const body::CharacterFile file = body::read_character_file(options.body);
  if (!file.body) throw_invalid_argument(options.body.string() + ": a skeleton without a mesh");
  const std::vector<Clip> clips = read_clips(options, *file.body, notes);
  const PoseJudge judge(*file.body, cloth.rest_positions);
  Choice choice(options, clips, judge, file.body->skeleton, frame_time_s, ease_frames, notes);
  std::vector<SequencePlan> plans;
  choice.add("train", options.train, plans);
  choice.add("test", options.test, plans);
  choice.add("train", options.extra, plans);
  if (plans.empty()) throw_invalid_argument("data set: no motion is left that cloth can be worn in");
  for (SequencePlan& plan : plans) {
    plan.scene.garment = cloth;
    plan.scene.steps_per_frame = kStepsPerFrame;
    plan.scene.contact.obstacle_friction = kBodyFriction;
    plan.scene.tracking.frequency = kTrackingFrequency;
    simulation::Obstacle body;
    body.name = "body";
    plan.scene.obstacles = {body};
  }
  return plans;
}

void put_body(simulation::Scene& scene, const BodyMotion& motion) {
  const body::AnimatedBody animated({motion.body, motion.motion, {}}, motion_options(motion, scene.frame_time_s),
                                    body::Skinning::kLinear);
  simulation::Obstacle& obstacle = scene.obstacles.front();
  obstacle.mesh = animated.mesh().mesh;
  obstacle.mesh.rest_positions = animated.positions(0);
  obstacle.animation.sample_time_s = scene.frame_time_s;
  for (std::size_t k = 0; k < animated.frame_count(); ++k) obstacle.animation.samples.push_back(animated.positions(k));
}

}  // namespace pleat::dataset
