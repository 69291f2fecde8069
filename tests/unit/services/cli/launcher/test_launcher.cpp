// `pleat up` with services that only answer health checks: starting, stopping, and never leaving a process behind.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <fstream>
#include <thread>

#include "tests/support/executable.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::test {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class LauncherTest : public testing::Test {
 protected:
  void SetUp() override {
    fs::create_directories(folder_ / "bin");
    fs::create_directories(folder_ / "run");
    fs::create_directories(folder_ / "models");
    fs::copy(built("pleat"), folder_ / "bin" / "pleat");
    const fs::path fake = built("pleat").parent_path().parent_path() / "tests" / "fake_service";
    for (const char* service : {"simulation", "conversion", "superres", "fold", "refinement", "coordinator"})
      fs::create_symlink(fake, folder_ / "bin" / (std::string("pleat-") + service));
  }

  std::vector<std::string> up(const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments{"up", "--data", (folder_ / "data").string(), "--models",
                                       (folder_ / "models").string()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  }
  std::map<std::string, std::string> environment() const { return {{"XDG_RUNTIME_DIR", (folder_ / "run").string()}}; }
  fs::path pleat() const { return folder_ / "bin" / "pleat"; }
  fs::path output() const { return folder_ / "up"; }

  std::size_t private_folders() const {
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder_ / "run"), fs::directory_iterator()));
  }
  /// Waits until no process of this test remains; the CTest timeout is the limit.
  void expect_no_process_remains() const {
    while (!processes_with(folder_.string()).empty()) std::this_thread::sleep_for(std::chrono::milliseconds(20));
    EXPECT_TRUE(processes_with(folder_.string()).empty());
  }

  const pleat::test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
};

TEST_F(LauncherTest, StartsAllServicesAndStopsThemOnInterrupt) {
  Background program(pleat(), up(), output(), environment());
  const std::string ready = program.wait_for_line("ready ");
  ASSERT_THAT(ready, HasSubstr("unix:"));
  EXPECT_EQ(processes_with(folder_.string()).size(), 7u);
  EXPECT_EQ(private_folders(), 1u);
  program.send(SIGINT);
  const Outcome outcome = program.wait();
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  for (const char* service : {"simulation", "conversion", "superres", "fold", "refinement", "coordinator"}) {
    EXPECT_THAT(outcome.out, HasSubstr(service));
    EXPECT_TRUE(fs::exists(folder_ / "data" / "logs" / (std::string(service) + ".log"))) << service;
  }
  expect_no_process_remains();
  EXPECT_EQ(private_folders(), 0u);
}

TEST_F(LauncherTest, StopsOnTermination) {
  Background program(pleat(), up(), output(), environment());
  ASSERT_NE(program.wait_for_line("ready "), "");
  program.send(SIGTERM);
  EXPECT_EQ(program.wait().exit_code, 0);
  expect_no_process_remains();
  EXPECT_EQ(private_folders(), 0u);
}

TEST_F(LauncherTest, LeavesNoProcessWhenKilled) {
  Background program(pleat(), up(), output(), environment());
  ASSERT_NE(program.wait_for_line("ready "), "");
  program.send(SIGKILL);
  EXPECT_EQ(program.wait().exit_code, 128 + SIGKILL);
  expect_no_process_remains();
}

TEST_F(LauncherTest, LeavesNoProcessWhenKilledWhileStarting) {
  Background program(pleat(), up(), output(), environment());
  while (processes_with((folder_ / "bin" / "pleat-simulation").string()).empty())
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  program.send(SIGKILL);
  EXPECT_EQ(program.wait().exit_code, 128 + SIGKILL);
  expect_no_process_remains();
}

TEST_F(LauncherTest, StartsAServiceAgainThatWasKilled) {
  Background program(pleat(), up(), output(), environment());
  ASSERT_NE(program.wait_for_line("ready "), "");
  const std::string refinement = (folder_ / "bin" / "pleat-refinement").string();
  const pid_t first = processes_with(refinement).at(0);
  ::kill(first, SIGKILL);
  while (true) {
    const auto now = processes_with(refinement);
    if (now.size() == 1 && now[0] != first) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  program.send(SIGINT);
  const Outcome outcome = program.wait();
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_THAT(outcome.err, HasSubstr("refinement ended (signal 9)"));
  expect_no_process_remains();
}

TEST_F(LauncherTest, ReplacesAServiceThatHangs) {
  Background program(pleat(), up({"--answer-timeout-s", "1"}), output(), environment());
  ASSERT_NE(program.wait_for_line("ready "), "");
  const std::string refinement = (folder_ / "bin" / "pleat-refinement").string();
  const pid_t first = processes_with(refinement).at(0);
  ::kill(first, SIGSTOP);
  while (true) {
    const auto now = processes_with(refinement);
    if (now.size() == 1 && now[0] != first) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  program.send(SIGINT);
  const Outcome outcome = program.wait();
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_THAT(outcome.err, HasSubstr("refinement does not answer"));
  expect_no_process_remains();
}

TEST_F(LauncherTest, AServiceThatKeepsEndingIsStartedAgainAfterPauses) {
  Background program(pleat(), up(), output(), environment());
  ASSERT_NE(program.wait_for_line("ready "), "");
  const std::string refinement = (folder_ / "bin" / "pleat-refinement").string();
  pid_t last = -1;
  for (int kills = 0; kills < 5; ++kills) {
    std::vector<int> now;
    while (now.size() != 1 || now[0] == last) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
      const auto pids = processes_with(refinement);
      now.assign(pids.begin(), pids.end());
    }
    last = now[0];
    if (kills < 4) ::kill(last, SIGKILL);
  }
  program.send(SIGINT);
  const Outcome outcome = program.wait();
  EXPECT_EQ(outcome.exit_code, 0) << "`up` outlives its services";
  EXPECT_THAT(outcome.err, HasSubstr("is started again in 2000 ms"));
  expect_no_process_remains();
}

TEST_F(LauncherTest, ShowsWhyAServiceEndedAtStart) {
  auto variables = environment();
  variables["FAKE_SERVICE_FAILS"] = "superres";
  const Outcome outcome = run(pleat(), up(), output(), variables);
  EXPECT_EQ(outcome.exit_code, 1);
  ASSERT_EQ(outcome.error_lines().size(), 1u) << outcome.err;
  EXPECT_THAT(outcome.err, HasSubstr("superres"));
  EXPECT_THAT(outcome.err, HasSubstr("bundle.pt: truncated on purpose"));
  expect_no_process_remains();
  EXPECT_EQ(private_folders(), 0u);
}

TEST_F(LauncherTest, NamesAMissingService) {
  fs::remove(folder_ / "bin" / "pleat-conversion");
  const Outcome outcome = run(pleat(), up(), output(), environment());
  EXPECT_NE(outcome.exit_code, 0);
  ASSERT_EQ(outcome.error_lines().size(), 1u) << outcome.err;
  EXPECT_THAT(outcome.err, HasSubstr("pleat-conversion"));
  expect_no_process_remains();
}

TEST_F(LauncherTest, NamesATakenPort) {
  const int taken = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  ASSERT_EQ(::bind(taken, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  ASSERT_EQ(::listen(taken, 1), 0);
  socklen_t size = sizeof address;
  ASSERT_EQ(::getsockname(taken, reinterpret_cast<sockaddr*>(&address), &size), 0);
  const std::string listen = "127.0.0.1:" + std::to_string(ntohs(address.sin_port));
  const Outcome outcome = run(pleat(), up({"--listen", listen}), output(), environment());
  ::close(taken);
  EXPECT_EQ(outcome.exit_code, 1);
  ASSERT_EQ(outcome.error_lines().size(), 1u) << outcome.err;
  EXPECT_THAT(outcome.err, HasSubstr(listen));
  expect_no_process_remains();
}

TEST_F(LauncherTest, ForeignFilesInAnOutputFolderSurvive) {
  const fs::path out = folder_ / "out";
  const std::string garment =
      "v 0 0 0\nv 1 0 0\nv 0 0 1\nv 1 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\nf 1/1 2/2 3/3\nf 2/2 4/4 3/3\n";
  std::ofstream(folder_ / "cloth.obj") << garment;
  std::ofstream(folder_ / "scene.json")
      << R"({"name": "fall", "garment_file": "cloth.obj", "isotropic": {"density": 375, "youngs_modulus": 7.5e5, "poissons_ratio": 0.3, "thickness": 4e-4}, "frames": 2})";
  std::ofstream(folder_ / "models" / "draping.pt") << "x";
  std::vector<fs::path> kept;
  for (const char* name : {"services/precious.txt", "services/jobs/a/job.json", "logs/notes.txt", "report.json.tmp",
                           "result.h5.partial.new", ".pleat-work-mine/precious.txt"}) {
    kept.push_back(out / name);
    fs::create_directories(kept.back().parent_path());
    std::ofstream(kept.back()) << "mine";
  }
  auto variables = environment();
  variables["PLEAT_MODELS"] = (folder_ / "models").string();
  const std::vector<std::vector<std::string>> commands = {
      {"run", (folder_ / "scene.json").string(), "--out", out.string()},
      {"enhance", "--rest", (folder_ / "cloth.obj").string(), "--frames", (folder_ / "cloth.obj").string(), "--out",
       out.string()}};
  for (const auto& command : commands) {
    EXPECT_EQ(run(pleat(), command, output(), variables).exit_code, 1);  // the services only answer health checks
    EXPECT_TRUE(fs::exists(out / "logs" / "coordinator.log"));
    for (const fs::path& path : kept) EXPECT_TRUE(fs::exists(path) && fs::file_size(path) == 4) << path;
    // Nothing of the run's own is left.
    for (const auto& entry : fs::directory_iterator(out)) {
      const std::string name = entry.path().filename();
      EXPECT_TRUE(!name.starts_with(".pleat-work-") || name == ".pleat-work-mine") << name;
    }
    // Files in the place of the results are refused before anything begins.
    for (const char* name : {"result.h5", "result.h5.partial", "report.json", "report.html", "logs/fold.log"}) {
      const fs::path path = out / name;
      fs::remove(path);
      std::ofstream(path) << "mine";
      const Outcome outcome = run(pleat(), command, output(), variables);
      EXPECT_EQ(outcome.exit_code, 2) << name;
      ASSERT_EQ(outcome.error_lines().size(), 1u) << outcome.err;
      EXPECT_THAT(outcome.err, HasSubstr(path.string() + ": is there and was not made by Pleat"));
      EXPECT_EQ(fs::file_size(path), 4u);
      fs::remove(path);
    }
  }
}

TEST_F(LauncherTest, FindsAFreePort) {
  Background program(pleat(), up({"--listen", "127.0.0.1:0"}), output(), environment());
  const std::string ready = program.wait_for_line("ready ");
  ASSERT_THAT(ready, testing::MatchesRegex("ready 127\\.0\\.0\\.1:[1-9][0-9]*"));
  const Outcome health =
      run(pleat(), {"health", ready.substr(6), "pleat.v1.Coordinator", "--timeout", "10"}, folder_ / "health");
  EXPECT_EQ(health.exit_code, 0) << health.err;
  const Outcome other =
      run(pleat(), {"health", ready.substr(6), "pleat.v1.Refinement", "--timeout", "0.5"}, folder_ / "health");
  EXPECT_EQ(other.exit_code, 1);
  EXPECT_THAT(other.err, HasSubstr("pleat.v1.Refinement"));
  program.send(SIGINT);
  EXPECT_EQ(program.wait().exit_code, 0);
}

}  // namespace
}  // namespace pleat::test
