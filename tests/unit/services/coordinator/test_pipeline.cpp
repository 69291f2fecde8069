#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstring>
#include <mutex>
#include <thread>

#include "common/frame/messages.hpp"
#include "common/frame/representation_messages.hpp"
#include "common/rpc/channel.hpp"
#include "services/coordinator/pipeline.hpp"
#include "tests/support/errors.hpp"
#include "tests/support/fake_stages.hpp"

namespace pleat::coordinator {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using testing::FakeService;
using testing::Faults;

LinkOptions fast_link() {
  LinkOptions link;
  link.connect = [](const std::string& address) { return rpc::create_channel(address); };
  link.give_up = 1500ms;
  link.open_timeout = 5s;
  link.answer_timeout = 300ms;
  return link;
}

class PipelineTest : public ::testing::Test {
 protected:
  PipelineTest() : coarse_(testing::sheet()), subdivision_(subdivide(coarse_, 2)) {
    addresses_ = {{fakes_.simulation().address()},
                  {fakes_.conversion().address()},
                  {fakes_.superres().address()},
                  {fakes_.refinement().address()},
                  {fakes_.fold().address()}};
    session_.coarse = to_message(coarse_);
    session_.model = fakes_.bundle().describe();
  }

  std::unique_ptr<EnhancementPipeline> make(EnhancementPipeline::Sink sink = {}, LinkOptions link = fast_link()) {
    if (!sink) {
      sink = [this](std::unique_ptr<PipelineFrame> frame) {
        const std::lock_guard lock(mutex_);
        out_.push_back(std::move(frame));
      };
    }
    return std::make_unique<EnhancementPipeline>(addresses_, link, session_,
                                                 static_cast<std::size_t>(subdivision_.fine.vertex_count()),
                                                 topology_hash(subdivision_.fine), std::move(sink));
  }

  std::unique_ptr<PipelineFrame> frame(std::uint64_t index) {
    auto made = std::make_unique<PipelineFrame>();
    made->sequence = made->index = index;
    made->coarse = testing::fake_coarse_frame(coarse_, index);
    return made;
  }

  /// The window before a frame: the first frame stands for those before it.
  std::vector<v1::Frame> earlier_of(std::uint64_t index) const {
    std::vector<v1::Frame> earlier;
    for (std::uint64_t back = std::max(1U, session_.representation.window()) - 1; back > 0; --back) {
      earlier.push_back(testing::fake_coarse_frame(coarse_, index - std::min(index, back)));
    }
    return earlier;
  }

  /// Sends frames and waits for all of them.
  void run(std::uint64_t frames) {
    const auto pipeline = make();
    pipeline->wait_open();
    for (std::uint64_t i = 0; i < frames; ++i) ASSERT_TRUE(pipeline->push(frame(i)));
    pipeline->close();
    pipeline->wait();
  }

  void expect_right(std::uint64_t frames, const std::vector<std::uint64_t>& failed = {}) {
    ASSERT_EQ(out_.size(), frames);
    for (std::uint64_t i = 0; i < frames; ++i) {
      ASSERT_EQ(out_[i]->index, i);
      if (std::find(failed.begin(), failed.end(), i) != failed.end()) {
        EXPECT_TRUE(out_[i]->error.has_value()) << i;
        continue;
      }
      ASSERT_FALSE(out_[i]->error.has_value()) << i << ": " << out_[i]->error->message();
      const Positions expected =
          testing::fake_enhanced(subdivision_, coarse_.faces, testing::fake_coarse_frame(coarse_, i),
                                 !session_.skip_refinement, earlier_of(i));
      ASSERT_EQ(positions_from_message(out_[i]->fine), expected) << i;
    }
  }

  testing::FakeStages fakes_;
  Topology coarse_;
  Subdivision subdivision_;
  ServiceAddresses addresses_;
  PipelineSession session_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<PipelineFrame>> out_;
};

TEST_F(PipelineTest, FramesPassEveryStageInOrder) {
  run(30);
  expect_right(30);
  std::string stages;
  for (const auto& time : out_[7]->stage_times) stages += time.stage() + " ";
  EXPECT_EQ(stages, "to_image superres to_mesh refinement ");
  EXPECT_EQ(out_[7]->report.self_intersections_before(), 2U);
  for (const auto* fake : fakes_.all()) EXPECT_EQ(fake->sessions, 0) << fake->address();
}

TEST_F(PipelineTest, AWindowOfFramesSurvivesFaults) {
  session_.representation.set_window(3);
  fakes_.conversion().faults.at(4, Faults::Kind::kBreak);
  fakes_.superres().faults.at(6, Faults::Kind::kBreak, 2);
  run(12);
  expect_right(12);
}

TEST_F(PipelineTest, AWindowGoesOnBehindTheFramesOnDisk) {
  session_.representation.set_window(3);
  session_.first_sequence = 5;
  session_.earlier = {testing::fake_coarse_frame(coarse_, 3), testing::fake_coarse_frame(coarse_, 4)};
  const auto pipeline = make();
  for (std::uint64_t i = 5; i < 9; ++i) ASSERT_TRUE(pipeline->push(frame(i)));
  pipeline->close();
  pipeline->wait();
  ASSERT_EQ(out_.size(), 4U);
  for (std::uint64_t i = 5; i < 9; ++i) {
    EXPECT_EQ(positions_from_message(out_[i - 5]->fine),
              testing::fake_enhanced(subdivision_, coarse_.faces, testing::fake_coarse_frame(coarse_, i), true,
                                     earlier_of(i)));
  }
}

/// Frames of the fold step alone.
/// Of other sessions, too: here they are the test's.
TEST_F(PipelineTest, FramesGoToTheReplicaWithTheLeastInFlight) {
  FakeService& other = fakes_.add_superres();
  addresses_.superres.push_back(other.address());
  LinkOptions link = fast_link();
  link.replicas = std::make_shared<ReplicaDirectory>();
  link.answer_timeout = 20s;
  const auto first_load = link.replicas->load_of(fakes_.superres().address());
  const auto other_load = link.replicas->load_of(other.address());
  std::atomic<std::uint64_t> answered{0};
  const auto pipeline = make([&](std::unique_ptr<PipelineFrame>) { ++answered; }, link);
  pipeline->wait_open();
  std::uint64_t next = 0;
  const auto send_one = [&] {
    ASSERT_TRUE(pipeline->push(frame(next++)));
    for (int i = 0; i < 1000 && answered < next; ++i) std::this_thread::sleep_for(5ms);
    ASSERT_EQ(answered, next);
  };
  for (const bool busy_first : {true, false, true}) {
    const LoadShare elsewhere(busy_first ? first_load : other_load, &ReplicaLoad::frames);
    FakeService &busy = busy_first ? fakes_.superres() : other, &idle = busy_first ? other : fakes_.superres();
    // Its stream may still be on its way.
    for (const int before = idle.frames; idle.frames == before && next < 500 && !HasFatalFailure();) send_one();
    const int before = busy.frames;
    for (int i = 0; i < 10; ++i) send_one();
    EXPECT_EQ(busy.frames, before);
  }
  EXPECT_EQ(first_load->frames + other_load->frames, 0) << "what was answered counts no more";
  for (FakeService* fake : {&fakes_.superres(), &other}) {
    for (const std::uint64_t index : {next, next + 1}) fake->faults.at(index, Faults::Kind::kHang);
  }
  for (int i = 0; i < 2; ++i) ASSERT_TRUE(pipeline->push(frame(next++)));
  for (int i = 0; i < 1000 && first_load->frames + other_load->frames < 2; ++i) std::this_thread::sleep_for(5ms);
  EXPECT_EQ(first_load->frames, 1);
  EXPECT_EQ(other_load->frames, 1);
}

class FoldedPipeline : public PipelineTest {
 protected:
  FoldedPipeline() {
    session_.detail = v1::DETAIL_FOLD;
    session_.model.Clear();
  }
  /// began: where the cloth began anew, in ascending order.
  void expect_folded(std::uint64_t frames, std::vector<std::uint64_t> began = {0}) {
    ASSERT_EQ(out_.size(), frames);
    for (const auto& made : out_) {
      if (made->error) continue;
      const auto start = *std::prev(std::upper_bound(began.begin(), began.end(), made->index));
      EXPECT_EQ(made->fold.restarted(), made->index == start) << made->index;
      ASSERT_EQ(positions_from_message(made->fine),
                testing::fake_folded(subdivision_, coarse_.faces, testing::fake_coarse_frame(coarse_, made->index),
                                     made->index - start + 1))
          << made->index;
    }
  }
};

TEST_F(FoldedPipeline, NeedsNoNetwork) {
  fakes_.conversion().stop();
  fakes_.superres().stop();
  run(20);
  expect_folded(20);
  std::string stages;
  for (const auto& time : out_[7]->stage_times) stages += time.stage() + " ";
  EXPECT_EQ(stages, "fold refinement ");
  EXPECT_EQ(out_[7]->fold.steps(), 7U);
}

TEST_F(FoldedPipeline, BrokenStreamsChangeNothing) {
  fakes_.fold().faults.at(0, Faults::Kind::kBreak);
  fakes_.fold().faults.at(5, Faults::Kind::kBreak, 3);
  fakes_.fold().faults.at(9, Faults::Kind::kHang);
  fakes_.refinement().faults.at(7, Faults::Kind::kBreak);
  run(20);
  expect_folded(20);
  EXPECT_EQ(fakes_.fold().opened, 6);
}

TEST_F(FoldedPipeline, AnotherReplicaGoesOnWhereOneBrokeOff) {
  FakeService& other = fakes_.add_fold();
  addresses_.fold.push_back(other.address());
  fakes_.fold().faults.at(6, Faults::Kind::kBreak);
  other.faults.at(11, Faults::Kind::kBreak);
  session_.fold_turn = 2;
  run(20);
  expect_folded(20);
  EXPECT_EQ(fakes_.fold().opened, 2);
  EXPECT_EQ(other.opened, 1);
  // Answers that were on their way when a stream broke may be lost with it; such frames are asked for again.
  EXPECT_GE(fakes_.fold().frames + other.frames, 20);
  EXPECT_GE(other.frames, 1);
}

TEST_F(FoldedPipeline, SessionsThatStayGoWhereFewestAre) {
  FakeService& other = fakes_.add_fold();
  addresses_.fold.push_back(other.address());
  LinkOptions link = fast_link();
  link.replicas = std::make_shared<ReplicaDirectory>();
  const auto open = [&] {
    auto pipeline = make({}, link);
    pipeline->wait_open();
    return pipeline;
  };
  const auto first = open();
  {
    const auto second = open();
    EXPECT_EQ(fakes_.fold().opened, 1);
    EXPECT_EQ(other.opened, 1) << "though it is no session's turn";
  }
  const auto third = open();
  EXPECT_EQ(other.opened, 2) << "the one that ended counts no more";
}

TEST_F(FoldedPipeline, BeginsAnewBehindAFrameThatIsMissing) {
  fakes_.fold().faults.at(4, Faults::Kind::kFrameError);
  fakes_.fold().faults.at(8, Faults::Kind::kBreak, 100);
  fakes_.fold().faults.at(9, Faults::Kind::kWrongSize);
  run(14);
  for (const std::uint64_t index : {4U, 8U, 9U}) EXPECT_TRUE(out_[index]->error) << index;
  EXPECT_NE(out_[9]->error->message().find("fold answered 1 vertices"), std::string::npos);
}

TEST_F(FoldedPipeline, GoesOnFromWhatWasKept) {
  run(5);
  session_.fold_memory = out_[4]->fold_memory;
  session_.first_sequence = 5;
  out_.clear();
  fakes_.fold().faults.at(5, Faults::Kind::kBreak);
  const auto pipeline = make();
  for (std::uint64_t i = 5; i < 9; ++i) ASSERT_TRUE(pipeline->push(frame(i)));
  pipeline->close();
  pipeline->wait();
  expect_folded(4);
}

TEST_F(FoldedPipeline, StartsFromTheNetworksAnswer) {
  session_.detail = v1::DETAIL_BOTH;
  session_.model = fakes_.bundle().describe();
  fakes_.fold().faults.at(3, Faults::Kind::kBreak);
  run(6);
  ASSERT_EQ(out_.size(), 6U);
  for (std::uint64_t i = 0; i < 6; ++i) {
    const v1::Frame coarse = testing::fake_coarse_frame(coarse_, i);
    const Positions network = testing::fake_enhanced(subdivision_, coarse_.faces, coarse, false);
    const Positions folded = testing::fake_folded(subdivision_, coarse_.faces, coarse, i + 1) -
                             upsample(subdivision_, coarse_.faces, positions_from_message(coarse));
    EXPECT_LT((positions_from_message(out_[i]->fine) - network - folded).cwiseAbs().maxCoeff(), 1e-5F) << i;
  }
}

/// Frames of a network that remembers how many it has made.
class RememberingPipeline : public PipelineTest {
 protected:
  RememberingPipeline() {
    fakes_.bundle().replace([](v1::ModelDescription& model) { model.set_state_values(1); });
    session_.model = fakes_.bundle().describe();
    session_.skip_refinement = true;
  }
  /// began: where the network began anew, in ascending order.
  void expect_counted(std::uint64_t first, std::uint64_t frames, std::vector<std::uint64_t> began = {0}) {
    ASSERT_EQ(out_.size(), frames);
    for (std::uint64_t i = 0; i < frames; ++i) {
      const auto& made = out_[i];
      ASSERT_EQ(made->index, first + i);
      if (made->error) continue;
      const auto start = *std::prev(std::upper_bound(began.begin(), began.end(), made->index));
      float since = 0;
      ASSERT_TRUE(made->network_memory && made->network_memory->state.size() == sizeof since);
      std::memcpy(&since, made->network_memory->state.data(), sizeof since);
      EXPECT_EQ(since, static_cast<float>(made->index - start + 1)) << made->index;
      EXPECT_EQ(made->network_memory->sequence, made->sequence);
      EXPECT_TRUE(made->image.state().empty());
    }
  }
};

TEST_F(RememberingPipeline, BrokenStreamsChangeNothing) {
  run(20);
  expect_counted(0, 20);
  const auto calm = std::move(out_);
  out_.clear();
  fakes_.superres().faults.at(0, Faults::Kind::kBreak);
  fakes_.superres().faults.at(5, Faults::Kind::kBreak, 3);
  fakes_.superres().faults.at(9, Faults::Kind::kHang);
  fakes_.conversion().faults.at(7, Faults::Kind::kBreak);
  run(20);
  expect_counted(0, 20);
  for (std::size_t i = 0; i < 20; ++i) {
    EXPECT_EQ(positions_from_message(out_[i]->fine), positions_from_message(calm[i]->fine)) << i;
  }
}

TEST_F(RememberingPipeline, AnotherReplicaGoesOnWhereOneBrokeOff) {
  FakeService& other = fakes_.add_superres();
  addresses_.superres.push_back(other.address());
  fakes_.superres().faults.at(6, Faults::Kind::kBreak);
  other.faults.at(11, Faults::Kind::kBreak);
  run(20);
  expect_counted(0, 20);
  EXPECT_GE(other.frames, 1);
}

TEST_F(RememberingPipeline, BeginsAnewBehindAFrameThatIsMissing) {
  fakes_.conversion().faults.at(4, Faults::Kind::kFrameError);
  run(9);
  EXPECT_TRUE(out_[4]->error);
  expect_counted(0, 9, {0, 5});
}

TEST_F(RememberingPipeline, GoesOnFromWhatWasKept) {
  run(5);
  session_.network_memory = out_[4]->network_memory;
  session_.first_sequence = 5;
  out_.clear();
  fakes_.superres().faults.at(5, Faults::Kind::kBreak);
  const auto pipeline = make();
  for (std::uint64_t i = 5; i < 9; ++i) ASSERT_TRUE(pipeline->push(frame(i)));
  pipeline->close();
  pipeline->wait();
  expect_counted(5, 4);
}

TEST_F(PipelineTest, ConversionSaysWhatASessionGets) {
  session_.representation = session_.model.representation();
  session_.representation.set_subdivision_rounds(1);
  EXPECT_EQ(session_.representation.geometry_image().scale(), 4U);
  session_.conversion = describe_conversion(addresses_, fast_link(), session_, [] { return false; });
  EXPECT_EQ(subdivision_of(session_, coarse_).fine.vertex_count(), subdivide(coarse_, 1).fine.vertex_count());
  session_.representation.set_subdivision_rounds(2);
  EXPECT_EQ(error_of([&] { subdivision_of(session_, coarse_); }).code(), ErrorCode::kInternal);
  session_.representation.set_subdivision_rounds(77);
  EXPECT_EQ(error_of([&] { subdivision_of(session_, coarse_); }).code(), ErrorCode::kInvalidArgument);
}

TEST_F(PipelineTest, AnEmptySessionEndsWell) {
  run(0);
  EXPECT_TRUE(out_.empty());
}

TEST_F(PipelineTest, RefinementCanBeLeftOut) {
  session_.skip_refinement = true;
  run(5);
  expect_right(5);
  EXPECT_EQ(fakes_.refinement().opened, 0);
}

TEST_F(PipelineTest, BrokenStreamsChangeNothing) {
  fakes_.conversion().faults.at(3, Faults::Kind::kBreak, 2);
  fakes_.superres().faults.at(5, Faults::Kind::kBreak);
  fakes_.superres().faults.at(6, Faults::Kind::kBreak);
  fakes_.refinement().faults.at(0, Faults::Kind::kBreak);
  fakes_.refinement().faults.at(19, Faults::Kind::kBreak);
  run(20);
  expect_right(20);
  EXPECT_EQ(fakes_.superres().opened, 3);
}

TEST_F(PipelineTest, AStageThatHangsIsReconnected) {
  fakes_.superres().faults.at(4, Faults::Kind::kHang);
  run(10);
  expect_right(10);
  EXPECT_EQ(fakes_.superres().opened, 2);
}

TEST_F(PipelineTest, AnAnswerThatWasNotAskedForIsABreak) {
  fakes_.refinement().faults.at(2, Faults::Kind::kWrongIndex);
  run(6);
  expect_right(6);
}

TEST_F(PipelineTest, AServiceThatComesBackIsFound) {
  const auto pipeline = make();
  pipeline->wait_open();
  std::jthread killer([this] {
    for (testing::FakeService* fake : {&fakes_.conversion(), &fakes_.superres(), &fakes_.refinement()}) {
      std::this_thread::sleep_for(30ms);
      fake->stop();
      std::this_thread::sleep_for(30ms);
      fake->start();
    }
  });
  fakes_.superres().faults.delay(2ms);
  for (std::uint64_t i = 0; i < 120; ++i) ASSERT_TRUE(pipeline->push(frame(i)));
  pipeline->close();
  pipeline->wait();
  killer.join();
  expect_right(120);
}

TEST_F(PipelineTest, AServiceThatStaysAwayIsNamed) {
  const auto pipeline = make();
  pipeline->wait_open();
  fakes_.refinement().stop();
  pipeline->push(frame(0));
  pipeline->close();
  const Error e = error_of([&] { pipeline->wait(); });
  EXPECT_EQ(e.code(), ErrorCode::kUnavailable);
  const std::string message = e.what();
  EXPECT_NE(message.find("refinement at " + fakes_.refinement().address()), std::string::npos) << message;
  EXPECT_NE(message.find("gave up after 1500 ms"), std::string::npos) << message;
  EXPECT_FALSE(pipeline->push(frame(1)));
}

TEST_F(PipelineTest, ARefusedOpenFailsAtOnce) {
  fakes_.superres().faults.refuse({grpc::StatusCode::FAILED_PRECONDITION, "trained for another mesh"}, 1);
  const auto pipeline = make();
  const Error e = error_of([&] { pipeline->wait_open(); });
  EXPECT_EQ(e.code(), ErrorCode::kFailedPrecondition);
  EXPECT_NE(std::string(e.what()).find("another mesh"), std::string::npos);
}

/// Sends frames; at frame 5 the stream to superres breaks, and meanwhile its bundle is replaced.
class ReplacedBundle : public PipelineTest {
 protected:
  void run_replaced(const std::function<void(v1::ModelDescription&)>& change) {
    session_.model = fakes_.bundle().describe();
    const auto pipeline = make();
    pipeline->wait_open();
    fakes_.bundle().replace(change);
    fakes_.superres().faults.at(5, Faults::Kind::kBreak);
    for (std::uint64_t i = 0; i < 20 && pipeline->push(frame(i)); ++i) {
    }
    pipeline->close();
    pipeline->wait();
  }

  /// The session ends with this difference, and what came out before is right.
  void expect_ended(const std::string& difference, const std::function<void(v1::ModelDescription&)>& change) {
    SCOPED_TRACE(difference);
    out_.clear();
    const Error e = error_of([&] { run_replaced(change); });
    EXPECT_EQ(e.code(), ErrorCode::kFailedPrecondition);
    EXPECT_EQ(e.what(), "superres at " + fakes_.superres().address() +
                            ": bundle fake was replaced meanwhile by one with another " + difference + "; begin anew");
    EXPECT_LE(out_.size(), 5U);
    expect_right(out_.size());
  }
};

TEST_F(ReplacedBundle, EndsTheSessionAndSaysWhatDiffers) {
  using Model = v1::ModelDescription;
  expect_ended("representation", [](Model& m) { m.mutable_representation()->mutable_input()->add_scale(2); });
  expect_ended("representation", [](Model& m) { m.mutable_representation()->mutable_geometry_image()->set_width(60); });
  expect_ended("mesh", [](Model& m) { m.set_topology_hash("0123456789abcdef"); });
  expect_ended("architecture", [](Model& m) { m.set_parameters(1234); });
  expect_ended("training", [](Model& m) { m.set_metadata_json("{}"); });
}

TEST_F(ReplacedBundle, ThatRunsElsewhereIsTheSameBundle) {
  run_replaced([](v1::ModelDescription& m) {
    m.set_device("cuda:0");
    m.set_precision("bfloat16");
  });
  expect_right(20);
  EXPECT_EQ(fakes_.superres().opened, 2);
}

TEST_F(ReplacedBundle, BeforeTheFirstStreamEndsTheSession) {
  session_.model = fakes_.bundle().describe();
  fakes_.bundle().replace([](v1::ModelDescription& m) { m.mutable_representation()->set_window(2); });
  const auto pipeline = make();
  EXPECT_EQ(error_of([&] { pipeline->wait_open(); }).code(), ErrorCode::kFailedPrecondition);
}

TEST_F(PipelineTest, AFrameErrorConcernsItsFrameOnly) {
  fakes_.superres().faults.at(4, Faults::Kind::kFrameError);
  fakes_.refinement().faults.at(6, Faults::Kind::kFrameError);
  fakes_.conversion().faults.at(8, Faults::Kind::kFrameError);
  run(12);
  expect_right(12, {4, 6, 8});
  EXPECT_EQ(out_[4]->error->code(), 3);
  EXPECT_EQ(out_[4]->error->message(), "superres: a bad frame, on purpose");
  EXPECT_EQ(out_[4]->error->index(), 4U);
}

TEST_F(PipelineTest, AWrongSizeIsAFrameErrorAndReachesNobody) {
  fakes_.refinement().faults.at(3, Faults::Kind::kWrongSize);
  run(5);
  expect_right(5, {3});
}

TEST_F(PipelineTest, AFrameThatAlwaysKillsItsStageIsGivenUp) {
  fakes_.superres().faults.at(2, Faults::Kind::kBreak, 1000);
  run(6);
  expect_right(6, {2});
  EXPECT_NE(out_[2]->error->message().find("superres at "), std::string::npos) << out_[2]->error->message();
}

TEST_F(PipelineTest, ReplicasShareTheFramesAndTheLossOfOneIsNoLoss) {
  testing::FakeService& second = fakes_.add_superres();
  addresses_.superres.push_back(second.address());
  fakes_.superres().faults.delay(2ms);
  second.faults.delay(2ms);
  std::uint64_t count = 0;
  {
    const auto pipeline = make();
    pipeline->wait_open();
    // The second one may open late, so frames come until it has had some.
    for (; count < 30 || (second.frames == 0 && count < 10'000); ++count) ASSERT_TRUE(pipeline->push(frame(count)));
    second.stop();
    for (const std::uint64_t end = count + 30; count < end; ++count) ASSERT_TRUE(pipeline->push(frame(count)));
    pipeline->close();
    pipeline->wait();
  }
  expect_right(count);
  EXPECT_GT(fakes_.superres().frames, 0);
  EXPECT_GT(second.frames, 0);
}

TEST_F(PipelineTest, ReplicasBehindANameComeAndGoWhileFramesFlow) {
  testing::FakeService& first = fakes_.superres();
  testing::FakeService& second = fakes_.add_superres();
  first.faults.delay(2ms);
  second.faults.delay(2ms);
  std::mutex mutex;
  std::vector<std::string> known = {first.address()};
  const auto set = [&](std::vector<std::string> addresses) {
    const std::lock_guard lock(mutex);
    known = std::move(addresses);
  };
  LinkOptions link = fast_link();
  link.replicas = std::make_shared<ReplicaDirectory>(1ms, [&](const std::string&, const std::string&) {
    const std::lock_guard lock(mutex);
    return known;
  });
  addresses_.superres = {"dns:///superres:50053"};
  std::uint64_t count = 0;
  {
    const auto pipeline = make({}, link);
    pipeline->wait_open();
    for (; count < 20; ++count) ASSERT_TRUE(pipeline->push(frame(count)));
    EXPECT_EQ(second.frames, 0) << "nobody knows it";
    set({first.address(), second.address()});
    for (; second.frames == 0 && count < 10'000; ++count) ASSERT_TRUE(pipeline->push(frame(count)));
    EXPECT_GT(second.frames, 0) << "it came";
    set({second.address()});
    for (; first.sessions > 0 && count < 20'000; ++count) ASSERT_TRUE(pipeline->push(frame(count)));
    EXPECT_EQ(first.sessions, 0) << "it went";
    const int had = first.frames;
    for (const std::uint64_t end = count + 20; count < end; ++count) ASSERT_TRUE(pipeline->push(frame(count)));
    // All of them at once, as when a new version is rolled out.
    set({first.address()});
    second.stop();
    for (const std::uint64_t end = count + 20; count < end; ++count) ASSERT_TRUE(pipeline->push(frame(count)));
    pipeline->close();
    pipeline->wait();
    EXPECT_GT(first.frames, had);
  }
  expect_right(count);
}

TEST_F(PipelineTest, MetricsTellHowFullTheWindowsAre) {
  telemetry::Metrics metrics("coordinator");
  LinkOptions link = fast_link();
  link.metrics = &metrics;
  link.answer_timeout = 60s;
  const auto line = [](const std::string& name, int value) {
    return "pleat_" + name + "{service=\"coordinator\",stage=\"superres\"} " + std::to_string(value) + "\n";
  };
  fakes_.superres().faults.at(2, Faults::Kind::kHang);
  {
    const auto pipeline = make({}, link);
    pipeline->wait_open();
    for (std::uint64_t i = 0; i < 4; ++i) ASSERT_TRUE(pipeline->push(frame(i)));
    // Frames 0 and 1 come back, 2 and 3 don't.
    bool full = false;
    for (int i = 0; i < 10'000 && !full; ++i) {
      std::this_thread::sleep_for(1ms);
      const std::lock_guard lock(mutex_);
      full = out_.size() == 2 && metrics.text().find(line("inflight_frames", 2)) != std::string::npos;
    }
    EXPECT_TRUE(full) << metrics.text();
    EXPECT_NE(metrics.text().find(line("window_frames", 4)), std::string::npos) << metrics.text();
    pipeline->fail(Error(ErrorCode::kCancelled, "cancelled"));
  }
  EXPECT_NE(metrics.text().find(line("inflight_frames", 0)), std::string::npos) << metrics.text();
  EXPECT_NE(metrics.text().find(line("window_frames", 0)), std::string::npos) << metrics.text();
}

TEST_F(PipelineTest, ASlowSinkSlowsTheSource) {
  std::atomic<int> taken{0};
  std::atomic<bool> go{false};
  session_.window = 2;
  const auto pipeline = make([&](std::unique_ptr<PipelineFrame>) {
    while (!go) std::this_thread::sleep_for(1ms);
    ++taken;
  });
  std::atomic<int> pushed{0};
  std::jthread producer([&] {
    for (std::uint64_t i = 0; i < 40; ++i) {
      pipeline->push(frame(i));
      ++pushed;
    }
    pipeline->close();
  });
  std::this_thread::sleep_for(300ms);
  // Four stages with two frames each, and one in the producer's hand.
  EXPECT_LE(pushed, 8);
  go = true;
  producer.join();
  pipeline->wait();
  EXPECT_EQ(taken, 40);
}

TEST_F(PipelineTest, ASinkThatThrowsFailsTheSession) {
  const auto pipeline = make([](std::unique_ptr<PipelineFrame> done) {
    if (done->index == 2) throw Error(ErrorCode::kResourceExhausted, "disk full: result.h5");
  });
  for (std::uint64_t i = 0; i < 50 && pipeline->push(frame(i)); ++i) {
  }
  pipeline->close();
  EXPECT_STREQ(error_of([&] { pipeline->wait(); }).what(), "disk full: result.h5");
}

TEST_F(PipelineTest, CancellingFreesEveryStage) {
  fakes_.superres().faults.at(1, Faults::Kind::kHang);
  LinkOptions patient = fast_link();
  patient.answer_timeout = 60s;
  auto pipeline = make({}, patient);
  pipeline->wait_open();
  for (std::uint64_t i = 0; i < 4; ++i) pipeline->push(frame(i));
  pipeline->fail(Error(ErrorCode::kCancelled, "cancelled"));
  EXPECT_THROW(pipeline->wait(), Error);
  pipeline.reset();
  for (int i = 0; i < 1000; ++i) {
    int open = 0;
    for (const auto* fake : fakes_.all()) open += fake->sessions;
    if (open == 0) break;
    std::this_thread::sleep_for(5ms);
  }
  for (const auto* fake : fakes_.all()) EXPECT_EQ(fake->sessions, 0) << fake->address();
}

TEST(SplitAddresses, CommasSeparateReplicas) {
  EXPECT_EQ(split_addresses("superres", "a:1,,unix:/b"), (std::vector<std::string>{"a:1", "unix:/b"}));
  EXPECT_THROW(split_addresses("superres", ","), Error);
}

TEST_F(PipelineTest, AnUnknownBundleIsNamedByTheService) {
  const auto never = [] { return false; };
  EXPECT_EQ(describe_model(addresses_, fast_link(), "", never).model(), "fake");
  const Error e = error_of([&] { describe_model(addresses_, fast_link(), "nobody", never); });
  EXPECT_EQ(e.code(), ErrorCode::kNotFound);
  EXPECT_NE(std::string(e.what()).find("no bundle 'nobody'"), std::string::npos);
}

}  // namespace
}  // namespace pleat::coordinator
