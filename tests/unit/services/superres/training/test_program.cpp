// pleat-train as a program: killed, short of disk, and as several processes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>
#include <vector>

#include "tests/support/temporary_folder.hpp"
#include "tests/unit/services/superres/example_dataset.hpp"

namespace pleat::superres {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

std::string read_file(const fs::path& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

class TrainProgram : public testing::Test {
 protected:
  void SetUp() override {
    write_example_dataset(root_ / "data", example_master());
    std::ofstream(root_ / "train.json")
        << R"({"name": "small", "dataset": ")" << (root_ / "data").string()
        << R"(", "output": "out", "images": {"layout": "detail", "coarse_width": 12, "coarse_height": 9},
      "architecture": {"blocks": 1, "layers": 2, "growth": 8, "features": 8, "upsampling": "subpixel"},
      "losses": {"kinematic": 0, "vertices": 0.5}, "optimizer": {"learning_rate": 1e-3, "average": 0.9},
      "schedule": {"kind": "constant"}, "validation": {"every_frames": 3}, "epochs": 4, "batch": 4, "patch": 0,
      "mirror": true, "steps_per_epoch": 8, "threads": 1, "device": "cpu", "checkpoint_minutes": 0})";
  }

  /// A shell command; pleat-train is $TRAIN, and comes with the configuration.
  int shell(const std::string& command) const {
    const std::string train =
        std::string(std::getenv("PLEAT_BINARY_DIR")) + "/bin/pleat-train " + (root_ / "train.json").string();
    const std::string line = "export TRAIN='" + train + "'; cd " + root_.string() + "; { " + command + "; } >>" +
                             (root_ / "said.txt").string() + " 2>&1";
    const int status = std::system(line.c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  std::string said() const { return read_file(root_ / "said.txt"); }

  /// Rows of log.csv as numbers, without the minutes.
  std::vector<std::vector<double>> rows(const std::string& output) const {
    std::ifstream file(root_ / output / "log.csv");
    std::vector<std::vector<double>> result;
    std::string line;
    std::getline(file, line);
    while (std::getline(file, line)) {
      std::istringstream cells(line);
      auto& row = result.emplace_back();
      for (std::string cell; std::getline(cells, cell, ',');) row.push_back(std::strtod(cell.c_str(), nullptr));
      if (row.size() > 2) row.erase(row.begin() + 2);
    }
    return result;
  }

  /// Of a training that is to be ended from outside: however late that comes, it is not done yet.
  const std::string endless = " --set epochs=1000000";
  /// Lines of shell that wait until the log of a training has so many epochs.
  static std::string wait_for_rows(const std::string& output, int epochs) {
    return "while [ $(cat " + output + "/log.csv 2>/dev/null | wc -l) -le " + std::to_string(epochs) +
           " ]; do sleep 0.02; done; ";
  }
  /// The setting with which a training that was ended goes on for so many epochs.
  std::string epochs_after(const std::string& output, int more) const {
    return " --set epochs=" + std::to_string(static_cast<int>(rows(output).size()) + more);
  }

  const test::TemporaryFolder temporary_;
  const fs::path root_ = temporary_.path();
};

TEST_F(TrainProgram, TokensLearnFromVertexFeatures) {
  const std::string tokens =
      "$TRAIN --set 'architecture={\"kind\": \"tokens\", \"features\": 8, \"heads\": 2, \"blocks\": 1, \"hidden\": "
      "16}' "
      "--set representation=vertex_features --set window=2 --set mirror=false --set epochs=8 "
      "--set optimizer.learning_rate=0.01 --set losses.vertex_normals=0.1 --set output=tokens";
  ASSERT_EQ(shell(tokens), 0) << said();
  const auto curve = rows("tokens");
  ASSERT_EQ(curve.size(), 8U) << said();
  // Column 3: the whole loss.
  EXPECT_LT(curve.back().at(3), 0.7 * curve.front().at(3)) << said();
  EXPECT_TRUE(fs::exists(root_ / "tokens/small.pt"));
}

TEST_F(TrainProgram, KilledAndResumedTrainingHasTheSameCurve) {
  // The process is killed when it has written the rows of two epochs; it can't end before.
  const int killed =
      shell("$TRAIN --set output=parts" + endless + " & " + wait_for_rows("parts", 2) + "kill -9 $!; wait $!");
  EXPECT_EQ(killed, 128 + SIGKILL) << said();
  const std::string two_more = epochs_after("parts", 2);
  ASSERT_EQ(shell("$TRAIN --set output=parts" + two_more), 0) << said();
  EXPECT_THAT(said(), HasSubstr("resumed at epoch"));
  ASSERT_EQ(shell("$TRAIN --set output=whole" + two_more), 0) << said();
  EXPECT_EQ(rows("parts"), rows("whole"));
}

TEST_F(TrainProgram, SeveralProcessesHaveTheCurveOfOne) {
  ASSERT_EQ(shell("$TRAIN --set output=one"), 0) << said();
  ASSERT_EQ(shell("$TRAIN --set output=two --processes 2"), 0) << said();
  const auto one = rows("one"), two = rows("two");
  ASSERT_EQ(one.size(), two.size());
  for (std::size_t i = 0; i < one.size(); ++i) {
    ASSERT_EQ(one[i].size(), two[i].size());
    for (std::size_t k = 0; k + 1 < one[i].size(); ++k) {
      EXPECT_NEAR(two[i][k], one[i][k], 1e-4 * std::abs(one[i][k])) << "row " << i << ", column " << k;
    }
  }
  EXPECT_EQ(shell("$TRAIN --set output=many --processes 5"), 2);
  EXPECT_THAT(said(), HasSubstr("'batch' = 4"));
}

/// A port of this host that nobody has at the moment.
int free_port() {
  const int socket = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  ::bind(socket, reinterpret_cast<sockaddr*>(&address), size);
  ::getsockname(socket, reinterpret_cast<sockaddr*>(&address), &size);
  ::close(socket);
  return ntohs(address.sin_port);
}

// As on several machines, each of which has one process: started by somebody else, and one of them lost.
TEST_F(TrainProgram, ProcessesThatMeetAtAnAddressGoOnAfterOneIsLost) {
  const auto both = [](const std::string& settings, const std::string& between) {
    const std::string train =
        "$TRAIN --set output=two" + settings + " --processes 2 --rendezvous 127.0.0.1:" + std::to_string(free_port());
    return train + " --rank 1 & second=$!; " + train + " --rank 0 & first=$!; " + between + " wait $first";
  };
  EXPECT_EQ(shell(both(endless, wait_for_rows("two", 1) + "kill -9 $second;")), 75) << said();
  EXPECT_THAT(said(), HasSubstr("a training process is gone"));
  const std::string two_more = epochs_after("two", 2);
  ASSERT_EQ(shell(both(two_more, "")), 0) << said();
  ASSERT_EQ(shell("$TRAIN --set output=one" + two_more), 0) << said();
  const auto one = rows("one"), two = rows("two");
  ASSERT_EQ(one.size(), two.size());
  for (std::size_t i = 0; i < one.size(); ++i) {
    for (std::size_t k = 0; k + 1 < one[i].size(); ++k) {
      EXPECT_NEAR(two[i][k], one[i][k], 1e-4 * std::abs(one[i][k])) << "row " << i << ", column " << k;
    }
  }
  EXPECT_EQ(shell(both(two_more, "") + "; wait $second"), 0) << "what is done stays done";
}

TEST_F(TrainProgram, ASignalToAllProcessesOfADistributedTrainingEndsItAtACheckpoint) {
  const std::string train =
      "$TRAIN --set output=two" + endless + " --processes 2 --rendezvous 127.0.0.1:" + std::to_string(free_port());
  EXPECT_EQ(shell(train + " --rank 1 & second=$!; " + train + " --rank 0 & first=$!; " + wait_for_rows("two", 1) +
                  "kill $first $second; wait $first; code=$?; wait $second && exit $code"),
            75)
      << said();
  EXPECT_TRUE(fs::exists(root_ / "two/checkpoint.pt"));
}

TEST_F(TrainProgram, FullDiskKeepsTheLastCheckpoint) {
  ASSERT_EQ(shell("$TRAIN --set output=whole"), 0) << said();
  ASSERT_EQ(shell("$TRAIN --set output=short --set epochs=2"), 0) << said();
  const std::string before = read_file(root_ / "short/checkpoint.pt");
  // No file may grow beyond 16 KiB; the signal is ignored, so that writing fails as on a full disk.
  EXPECT_EQ(shell("trap '' XFSZ; ulimit -f 16; $TRAIN --set output=short"), 1) << said();
  EXPECT_THAT(said(), HasSubstr("can't be written"));
  EXPECT_EQ(read_file(root_ / "short/checkpoint.pt"), before);
  ASSERT_EQ(shell("$TRAIN --set output=short"), 0) << said();
  EXPECT_EQ(rows("short"), rows("whole"));
}

TEST_F(TrainProgram, TooLittleMemoryMakesPassesSmaller) {
  // What the program takes by itself is half of 1.3 GB; a step's images in one pass far above.
  const std::string one_step = "$TRAIN --set epochs=1 --set steps_per_epoch=1 --set batch=1024";
  for (const char* kernels : {"own", "libtorch"}) {
    const std::string output = std::string("little_") + kernels;
    const std::string set = " --set kernels=" + std::string(kernels) + " --set output=" + output;
    EXPECT_EQ(shell("ulimit -v 1300000; " + one_step + set), 0) << said();
    EXPECT_THAT(said(), HasSubstr("out of memory: passes take "));
    EXPECT_EQ(rows(output).size(), 1u);
    fs::remove(root_ / "said.txt");
  }
}

TEST_F(TrainProgram, SaysWhatIsWrong) {
  EXPECT_EQ(shell("$TRAIN --set dataset=nowhere"), 2);
  EXPECT_THAT(said(), HasSubstr("nowhere"));
  EXPECT_EQ(shell("$TRAIN --set batch=0"), 2);
  EXPECT_EQ(shell("$TRAIN --faster"), 2);
  EXPECT_EQ(shell("$TRAIN --processes none"), 2);
  EXPECT_EQ(shell("$TRAIN --help"), 0);
  fs::resize_file(root_ / "data/sequences/b.h5", 100);
  EXPECT_EQ(shell("$TRAIN --strict"), 2);
  EXPECT_THAT(said(), HasSubstr("sequence b"));
}

}  // namespace
}  // namespace pleat::superres
