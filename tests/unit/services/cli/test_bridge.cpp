// Point caches that grow, and requests that are wrong. tests/integration/test_bridge.py has whole sessions.
#include "services/cli/bridge.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "common/base/text_file.hpp"
#include "services/presentation/input/point_sequence.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;

class Pc2SamplesTest : public testing::Test {
 protected:
  std::vector<float> sample(float value) const { return std::vector<float>(6, value); }
  /// The first coordinate of each sample that a reader finds.
  std::vector<float> read() const {
    const auto points = presentation::open_points(path_.string());
    std::vector<float> values;
    for (std::size_t k = 0; k < points->frame_count(); ++k) values.push_back(points->positions(k)(0, 0));
    return values;
  }

  const pleat::test::TemporaryFolder temporary_;
  const fs::path path_ = temporary_.path() / "fine.pc2";
};

TEST_F(Pc2SamplesTest, AFileGrowsAndIsGivenUpFromASampleOn) {
  {
    Pc2Samples samples(path_, 2, 0);
    for (const float value : {1, 2, 3}) samples.add(sample(value));
    samples.flush();
    EXPECT_THAT(read(), testing::ElementsAre(1, 2, 3));
    samples.add(sample(4));
    samples.flush();
    EXPECT_THAT(read(), testing::ElementsAre(1, 2, 3, 4));
  }
  {
    Pc2Samples samples(path_, 2, 2);
    samples.add(sample(7));
    samples.flush();
    EXPECT_THAT(read(), testing::ElementsAre(1, 2, 7));
  }
  Pc2Samples samples(path_, 2, 0);
  samples.add(sample(9));
  samples.flush();
  EXPECT_THAT(read(), testing::ElementsAre(9));
}

TEST_F(Pc2SamplesTest, OtherFilesStay) {
  EXPECT_THROW(Pc2Samples(path_, 2, 1), Error);  // nothing to go on from
  { Pc2Samples(path_, 2, 0).flush(); }
  EXPECT_THROW(Pc2Samples(path_, 3, 1), Error);
  EXPECT_THROW(Pc2Samples(path_, 2, 1), Error);
  const fs::path mine = temporary_.path() / "mine.pc2", link = temporary_.path() / "link.pc2";
  std::ofstream(mine) << "mine";
  fs::create_symlink(path_, link);
  EXPECT_THROW(Pc2Samples(mine, 2, 0), Error);
  EXPECT_THROW(Pc2Samples(link, 2, 0), Error);
  EXPECT_EQ(read_text_file(mine), "mine");
}

TEST(Bridge, AWrongRequestIsNamed) {
  const client::Client client("unix:/nowhere/coordinator.sock");
  Bridge bridge(client, {});
  const auto cause = [&](const char* request) -> std::string {
    try {
      bridge.answer(
          nlohmann::json::parse(request), [](const nlohmann::json&) {}, [] { return false; });
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(cause("[]"), testing::HasSubstr("an object with one member"));
  EXPECT_THAT(cause(R"({"close": {}})"), testing::HasSubstr("unknown request 'close'"));
  EXPECT_THAT(cause(R"({"open": []})"), testing::HasSubstr("open: not an object"));
  EXPECT_THAT(cause(R"({"open": {"rset": "x"}})"), testing::HasSubstr("unknown key 'rset'"));
  EXPECT_THAT(cause(R"({"open": {}})"), testing::HasSubstr("open: rest is missing"));
  EXPECT_THAT(cause(R"({"open": {"rest": 3}})"), testing::HasSubstr("rest: a value of another kind"));
  EXPECT_THAT(cause(R"({"enhance": {}})"), testing::HasSubstr("nothing was opened"));
}

}  // namespace
}  // namespace pleat::cli
