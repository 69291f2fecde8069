#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <Eigen/Geometry>
#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <sstream>

#include "common/base/error.hpp"
#include "common/mesh/closest_points.hpp"
#include "common/mesh/subdivision.hpp"
#include "services/presentation/report/capsule_surface.hpp"
#include "services/presentation/report/encode.hpp"
#include "services/presentation/report/report.hpp"
#include "tests/support/temporary_folder.hpp"

namespace pleat::presentation {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::Not;

std::vector<std::uint8_t> bytes_of(const std::string& text) { return {text.begin(), text.end()}; }

/// A decoder of its own: looks every character up.
std::vector<std::uint8_t> decode_base64(const std::string& text) {
  const std::string alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::vector<std::uint8_t> out;
  std::uint32_t bits = 0;
  int count = 0;
  for (const char c : text) {
    if (c == '=') break;
    bits = (bits << 6) | static_cast<std::uint32_t>(alphabet.find(c));
    count += 6;
    if (count >= 8) {
      count -= 8;
      out.push_back(static_cast<std::uint8_t>(bits >> count));
    }
  }
  return out;
}

std::vector<std::uint8_t> inflate_to(const std::vector<std::uint8_t>& deflated, std::size_t size) {
  std::vector<std::uint8_t> out(size);
  uLongf length = static_cast<uLongf>(size);
  EXPECT_EQ(uncompress(out.data(), &length, deflated.data(), static_cast<uLong>(deflated.size())), Z_OK);
  EXPECT_EQ(length, size);
  return out;
}

int wrapped(int difference) { return ((difference % 65536) + 65536 + 32768) % 65536 - 32768; }

/// Positions as docs/report.md says, frame after frame.
std::vector<Positions> decode(const QuantizedSequence& sequence, const Faces& faces) {
  const std::size_t vertices = sequence.vertices;
  const std::size_t values = 3 * vertices;
  const std::vector<std::uint8_t> planes = inflate_to(sequence.deflated, 2 * values * sequence.frames);
  std::vector<std::vector<std::size_t>> mates(vertices);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (const std::uint32_t v : faces.row(f)) {
      for (const std::uint32_t u : faces.row(f)) {
        if (u < v) mates[v].push_back(u);
      }
    }
  }
  std::vector<Positions> out;
  std::vector<int> q(values * sequence.frames);
  std::vector<int> r(q.size());
  for (std::size_t i = 0; i < q.size(); ++i) {
    const std::size_t v = i % vertices;
    double mean = 0;
    for (const std::size_t u : mates[v])
      mean += static_cast<double>(r[i - v + u]) / static_cast<double>(mates[v].size());
    // The sums are exact to far less than the distance of a mean to the next integer.
    int predicted = static_cast<int>(std::floor(mean + 1e-6));
    if (mates[v].empty()) predicted = v == 0 ? 0 : r[i - 1];
    const int zigzag = planes[i] + 256 * planes[q.size() + i];
    r[i] = wrapped(predicted + (zigzag % 2 == 0 ? zigzag / 2 : -(zigzag + 1) / 2));
    const std::size_t frame = i / values;
    const int expected = frame == 0 ? 0 : frame == 1 ? q[i - values] : 2 * q[i - values] - q[i - 2 * values];
    q[i] = (((expected + r[i]) % 65536) + 65536) % 65536;
  }
  for (std::size_t t = 0; t < sequence.frames; ++t) {
    Positions positions(static_cast<Eigen::Index>(sequence.vertices), 3);
    for (Eigen::Index v = 0; v < positions.rows(); ++v) {
      for (Eigen::Index axis = 0; axis < 3; ++axis) {
        const std::size_t slot =
            t * values + static_cast<std::size_t>(axis) * sequence.vertices + static_cast<std::size_t>(v);
        positions(v, axis) =
            sequence.origin[3 * t + static_cast<std::size_t>(axis)] + sequence.step * static_cast<float>(q[slot]);
      }
    }
    out.push_back(positions);
  }
  return out;
}

Topology quad() {
  Topology topology;
  topology.rest_positions.resize(4, 3);
  topology.rest_positions << 0, 0, 0, 1, 0, 0, 1, 0, -1, 0, 0, -1;
  topology.faces.resize(2, 3);
  topology.faces << 0, 1, 2, 0, 2, 3;
  return topology;
}

/// A frame that sinks and swings, with every vertex on a path of its own.
Positions moved(const Positions& rest, std::size_t frame) {
  Positions out = rest;
  for (Eigen::Index v = 0; v < rest.rows(); ++v) {
    const float phase = 0.3f * static_cast<float>(frame) + static_cast<float>(v);
    out(v, 1) -= 0.5f * static_cast<float>(frame * frame) + 0.1f * std::sin(phase);
    out(v, 0) += 0.05f * std::cos(phase);
  }
  return out;
}

ReportInput make_input(bool reference) {
  const Subdivision subdivision = subdivide(quad());
  ReportInput input;
  input.coarse_topology = quad();
  input.fine_topology = subdivision.fine;
  input.frame_count = 4;
  input.coarse = [](std::size_t t) { return moved(quad().rest_positions, t); };
  input.enhanced = [subdivision](std::size_t t) { return moved(subdivision.fine.rest_positions, t); };
  if (reference) {
    // 3 and 4 mm away: 5 mm for every vertex of every frame.
    input.reference = [subdivision](std::size_t t) {
      Positions positions = moved(subdivision.fine.rest_positions, t);
      positions.col(0).array() += 0.003f;
      positions.col(2).array() += 0.004f;
      return positions;
    };
  }
  input.obstacles.push_back({{"ball", {}}, [](std::size_t) {
                               ObstacleFrame frame;
                               frame.radius = 0.25f;
                               return frame;
                             }});
  input.stages = {{"simulation", {1, 2, 3, 10}}, {"superres", {5, 5, 5, 5}}};
  input.counts = {{"penetrations", {0, 2, 0, 1}}, {"fold_steps", {20, 20, 20, 20}}};
  input.summary.title = "A </script> <b>cloth</b>";
  input.summary.model = "default";
  input.summary.wall_s = 2;
  input.summary.frame_time_s = 0.04;
  return input;
}

TEST(CapsuleSurface, IsClosedOutwardAndOnTheCapsules) {
  ObstacleFrame frame;
  frame.capsule_ends.resize(4, 3);
  frame.capsule_ends << 0, 0, 0, 0, 2, 1, 5, 1, 1, 5, 1, 1;  // the second is a ball
  frame.capsule_radii = {0.5f, 0.25f};
  const Positions x = capsule_surface(frame);
  const Faces faces = capsule_surface_faces(2);
  EXPECT_NO_THROW(validate_topology({x, faces, {}, {}}, "capsules"));
  const auto vertices = x.rows() / 2;
  for (Eigen::Index v = 0; v < x.rows(); ++v) {
    const auto c = v / vertices;
    const auto end = [&](Eigen::Index k) -> Eigen::Vector3d {
      return frame.capsule_ends.row(2 * c + k).cast<double>().transpose();
    };
    const Eigen::Vector3d p = x.row(v).cast<double>().transpose();
    const double t = closest_on_segment(p, end(0), end(1));
    EXPECT_NEAR((p - end(0) - t * (end(1) - end(0))).norm(), static_cast<double>(frame.capsule_radii[c]), 1e-5);
  }
  double volume = 0;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    const Eigen::Vector3d a = x.row(faces(f, 0)).cast<double>(), b = x.row(faces(f, 1)).cast<double>(),
                          c = x.row(faces(f, 2)).cast<double>();
    volume += a.dot(b.cross(c)) / 6;
  }
  const double pi = 3.14159265358979;
  const double exact = pi * 0.25 * std::sqrt(5.0) + 4 * pi / 3 * (0.125 + 0.015625);
  EXPECT_LT(volume, exact);
  EXPECT_GT(volume, 0.93 * exact);
  // Closed: every edge has two faces.
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) ++edges[std::minmax(faces(f, k), faces(f, (k + 1) % 3))];
  }
  for (const auto& [edge, count] : edges) EXPECT_EQ(count, 2);
}

TEST(Base64, MatchesTheExamplesOfRfc4648) {
  EXPECT_EQ(base64(bytes_of("")), "");
  EXPECT_EQ(base64(bytes_of("f")), "Zg==");
  EXPECT_EQ(base64(bytes_of("fo")), "Zm8=");
  EXPECT_EQ(base64(bytes_of("foo")), "Zm9v");
  EXPECT_EQ(base64(bytes_of("foob")), "Zm9vYg==");
  EXPECT_EQ(base64(bytes_of("fooba")), "Zm9vYmE=");
  EXPECT_EQ(base64(bytes_of("foobar")), "Zm9vYmFy");
  std::vector<std::uint8_t> all(256);
  for (std::size_t i = 0; i < all.size(); ++i) all[i] = static_cast<std::uint8_t>(i);
  EXPECT_EQ(decode_base64(base64(all)), all);
}

TEST(BytePlanes, PutsEqualBytesTogether) {
  const std::vector<std::uint32_t> words = {0x04030201u, 0x14131211u};
  EXPECT_THAT(byte_planes(words), testing::ElementsAre(0x01, 0x11, 0x02, 0x12, 0x03, 0x13, 0x04, 0x14));
}

TEST(QuantizeSequence, IsWithinHalfAStepOfEveryVertex) {
  const Topology fine = subdivide(quad(), 3).fine;
  const Positions& rest = fine.rest_positions;
  const Faces& faces = fine.faces;
  const auto frame = [&](std::size_t t) { return moved(rest, t); };
  const QuantizedSequence sequence = quantize_sequence(frame, 7, 1, rest.rows(), faces, "enhanced");
  ASSERT_EQ(sequence.frames, 7u);
  const std::vector<Positions> decoded = decode(sequence, faces);
  for (std::size_t t = 0; t < 7; ++t) {
    // Half a step, and the float32 rounding of coordinates of up to 25 m.
    EXPECT_LE((decoded[t] - moved(rest, t)).cwiseAbs().maxCoeff(), 0.5f * sequence.step + 4e-6f) << t;
  }
  EXPECT_LT(sequence.step, 2.0f / 65535);
}

TEST(QuantizeSequence, WrapsAroundWhereMotionJumps) {
  // Vertices that change between both ends of the box overflow 16 bits in time and among mates.
  const Topology fine = subdivide(quad(), 2).fine;
  const auto frame = [&](std::size_t t) {
    Positions positions = fine.rest_positions;
    for (Eigen::Index v = 0; v < positions.rows(); ++v) {
      for (Eigen::Index axis = 0; axis < 3; ++axis) {
        positions(v, axis) = (static_cast<std::size_t>(v * 7 + axis * 5) + t * t * 3) % 4 < 2 ? -1.0f : 1.0f;
      }
    }
    return positions;
  };
  const QuantizedSequence sequence = quantize_sequence(frame, 9, 1, fine.vertex_count(), fine.faces, "jumping");
  const std::vector<Positions> decoded = decode(sequence, fine.faces);
  for (std::size_t t = 0; t < 9; ++t) EXPECT_LE((decoded[t] - frame(t)).cwiseAbs().maxCoeff(), sequence.step) << t;
}

TEST(QuantizeSequence, TakesEveryNthFrame) {
  const Positions rest = quad().rest_positions;
  const QuantizedSequence sequence =
      quantize_sequence([&](std::size_t t) { return moved(rest, t); }, 7, 3, rest.rows(), quad().faces, "coarse");
  ASSERT_EQ(sequence.frames, 3u);
  EXPECT_LE((decode(sequence, quad().faces)[2] - moved(rest, 6)).cwiseAbs().maxCoeff(), sequence.step);
}

TEST(QuantizeSequence, BearsAMeshWithoutExtent) {
  const Positions still = Positions::Constant(5, 3, 2.5f);
  const QuantizedSequence sequence = quantize_sequence([&](std::size_t) { return still; }, 2, 1, 5, Faces(0, 3), "dot");
  for (const Positions& positions : decode(sequence, Faces(0, 3))) EXPECT_EQ(positions, still);
}

TEST(QuantizeSequence, NamesTheFrameThatIsWrong) {
  const auto bad = [](std::size_t t) {
    Positions positions = quad().rest_positions;
    if (t == 2) positions(1, 1) = std::numeric_limits<float>::infinity();
    return positions;
  };
  EXPECT_THROW(
      {
        try {
          quantize_sequence(bad, 4, 1, 4, quad().faces, "enhanced");
        } catch (const Error& error) {
          EXPECT_EQ(error.code(), ErrorCode::kInvalidArgument);
          EXPECT_THAT(error.what(), testing::AllOf(HasSubstr("enhanced"), HasSubstr("frame 2")));
          throw;
        }
      },
      Error);
  EXPECT_THROW(quantize_sequence(bad, 1, 1, 5, quad().faces, "enhanced"), Error);
  Faces out_of_range = quad().faces;
  out_of_range(1, 2) = 4;
  EXPECT_THROW(quantize_sequence(bad, 1, 1, 4, out_of_range, "enhanced"), Error);
}

TEST(ReportJson, HasTheContractsFields) {
  const nlohmann::json report = make_report_json(make_input(true));
  EXPECT_EQ(report["frames"], 4);
  EXPECT_EQ(report["coarse_vertices"], 4);
  EXPECT_EQ(report["fine_vertices"], 25);
  EXPECT_EQ(report["wall_s"], 2.0);
  EXPECT_EQ(report["frames_per_s"], 2.0);
  EXPECT_EQ(report["stages"]["simulation"]["median_ms"], 2.5);
  EXPECT_NEAR(report["stages"]["simulation"]["p95_ms"].get<double>(), 3 + 0.85 * 7, 1e-12);
  EXPECT_EQ(report["stages"]["superres"]["p95_ms"], 5.0);
  EXPECT_EQ(report["penetrations"], 3);
  EXPECT_EQ(report["self_intersections"], 0);
  EXPECT_EQ(report["model"], "default");
  EXPECT_EQ(report["device"], "cpu");
  EXPECT_EQ(report["precision"], "float32");
  EXPECT_NEAR(report["fidelity"]["enhanced"]["rmse_m"].get<double>(), 0.005, 1e-6);
  EXPECT_NEAR(report["fidelity"]["enhanced"]["max_m"].get<double>(), 0.005, 1e-6);
  EXPECT_GT(report["fidelity"]["upsampled"]["rmse_m"].get<double>(), 0.005);
  EXPECT_FALSE(make_report_json(make_input(false)).contains("fidelity"));
}

TEST(ReportJson, RejectsTimesOfAnotherLength) {
  ReportInput input = make_input(false);
  input.stages[1].ms.pop_back();
  EXPECT_THROW(make_report_json(input), Error);
}

class ReportFile : public testing::Test {
 protected:
  std::string page(const ReportInput& input, const ReportHtmlOptions& options = {}) const {
    write_report_html(input, folder_ / "report.html", options);
    std::ifstream file(folder_ / "report.html", std::ios::binary);
    std::ostringstream text;
    text << file.rdbuf();
    return text.str();
  }

  static nlohmann::json meta(const std::string& page) {
    const std::string start = "id=\"pleat-meta\">";
    const std::size_t place = page.find(start) + start.size();
    return nlohmann::json::parse(page.substr(place, page.find("</script>", place) - place));
  }

  static std::vector<std::uint8_t> blob(const std::string& page, const std::string& name) {
    const std::string start = "id=\"pleat-" + name + "\">";
    const std::size_t place = page.find(start) + start.size();
    return decode_base64(page.substr(place, page.find('<', place) - place));
  }

  static std::vector<Positions> sequence_of(const std::string& page, const nlohmann::json& part, const Faces& faces) {
    QuantizedSequence sequence;
    sequence.frames = part["frames"];
    sequence.vertices = part["vertices"];
    sequence.step = part["step"];
    sequence.origin = part["origin"].get<std::vector<float>>();
    sequence.deflated = blob(page, part["blob"]);
    return decode(sequence, faces);
  }

  const test::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path() / "out";
};

TEST_F(ReportFile, JsonIsWrittenWhole) {
  const ReportInput input = make_input(true);
  write_report_json(input, folder_ / "report.json");
  std::ifstream file(folder_ / "report.json");
  EXPECT_EQ(nlohmann::json::parse(file), make_report_json(input));
  EXPECT_FALSE(fs::exists(folder_ / "report.json.tmp"));
}

TEST_F(ReportFile, PageHoldsDataThatDecode) {
  const ReportInput input = make_input(true);
  const std::string text = page(input);
  EXPECT_THAT(text, testing::StartsWith("<!doctype html>"));
  EXPECT_THAT(text, Not(HasSubstr("PLEAT_TITLE")));
  EXPECT_THAT(text, Not(HasSubstr("<!-- PLEAT_DATA -->")));
  const nlohmann::json parts = meta(text);
  EXPECT_EQ(parts["stride"], 1);
  EXPECT_EQ(parts["report"], make_report_json(input));
  EXPECT_EQ(parts["stages"][0]["name"], "simulation");
  EXPECT_EQ(parts["obstacles"][0]["radii"].size(), 4u);
  const std::vector<Positions> decoded = sequence_of(text, parts["enhanced"], input.fine_topology.faces);
  ASSERT_EQ(decoded.size(), 4u);
  for (std::size_t t = 0; t < 4; ++t) {
    EXPECT_LE((decoded[t] - input.enhanced(t)).cwiseAbs().maxCoeff(), parts["enhanced"]["step"]);
  }
}

/// Three joints in a row, each vertex between two of them, and one that turns and rises.
std::shared_ptr<const ReportSkin> worm(std::size_t frames) {
  auto skin = std::make_shared<ReportSkin>();
  body::SkinnedMesh& mesh = skin->mesh;
  mesh.skeleton.joints = {
      {"tail", -1, {0.1, 0.2, 0.3}},
      {"middle", 0, {1, 0, 0}, Eigen::Quaterniond(Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitY()))},
      {"head", 1, {1, 0, 0}}};
  mesh.mesh = subdivide(quad(), 2).fine;
  mesh.joints.setZero(mesh.mesh.vertex_count(), body::kInfluences);
  mesh.weights.setZero(mesh.mesh.vertex_count(), body::kInfluences);
  for (Eigen::Index v = 0; v < mesh.mesh.vertex_count(); ++v) {
    mesh.joints.row(v) << static_cast<std::uint16_t>(v % 2), static_cast<std::uint16_t>(v % 2 + 1), 0, 0;
    mesh.weights(v, 1) = static_cast<float>(v % 5) / 5;
    mesh.weights(v, 0) = 1 - mesh.weights(v, 1);
  }
  skin->motion = {mesh.skeleton, 0.04, {}};
  for (std::size_t t = 0; t < frames; ++t) {
    body::Pose pose = body::rest_pose(mesh.skeleton);
    pose.rotations[1] =
        pose.rotations[1] * Eigen::AngleAxisd(0.3 * static_cast<double>(t), Eigen::Vector3d(1, 2, 2) / 3);
    pose.translations[0].y() += 0.1 * static_cast<double>(t);
    skin->motion.frames.push_back(pose);
  }
  return skin;
}

TEST_F(ReportFile, ABodyIsThereAsJointsAndWeightsAndWhereItIsElsewhereAsPoints) {
  ReportInput input = make_input(false);
  const auto skin = worm(4);
  const body::SkinnedMesh& mesh = skin->mesh;
  const auto at = [&](std::size_t t) {
    ObstacleFrame frame;
    frame.positions =
        body::skin(mesh, body::world_transforms(mesh.skeleton, skin->motion.frames[t]), body::Skinning::kLinear);
    if (t == 2) frame.positions.col(0).array() += 0.01f;
    return frame;
  };
  input.obstacles.push_back({{"worm", mesh.mesh.faces}, at, skin});
  const std::string text = page(input);
  const nlohmann::json parts = meta(text), obstacle = parts["obstacles"][1];
  ASSERT_TRUE(obstacle.contains("skin"));
  EXPECT_EQ(obstacle["sequence_frames"], nlohmann::json::array({2}));
  const auto points = sequence_of(text, obstacle["sequence"], mesh.mesh.faces);
  ASSERT_EQ(points.size(), 1u);
  EXPECT_LE((points[0] - at(2).positions).cwiseAbs().maxCoeff(), 1e-4f);
  const auto rest = sequence_of(text, obstacle["skin"]["rest"], mesh.mesh.faces),
             pivots = sequence_of(text, obstacle["skin"]["joints_at_rest"], Faces()),
             joints = sequence_of(text, obstacle["skin"]["joints"], Faces());
  ASSERT_EQ(joints.size(), 4u);
  EXPECT_EQ(joints[0].rows(), 9);
  const auto words = [&](const std::string& name) {
    const auto planes = inflate_to(blob(text, obstacle["skin"][name]), 16 * static_cast<std::size_t>(rest[0].rows()));
    std::vector<std::uint32_t> out(planes.size() / 4);
    for (std::size_t i = 0; i < out.size(); ++i)
      for (std::size_t plane = 0; plane < 4; ++plane) out[i] |= planes[plane * out.size() + i] << (8 * plane);
    return out;
  };
  const std::vector<std::uint32_t> influences = words("influences"), weights = words("weights");
  // As docs/report.md says.
  for (const std::size_t t : {0u, 1u, 3u}) {
    for (Eigen::Index v = 0; v < rest[0].rows(); ++v) {
      Eigen::Vector3d place = Eigen::Vector3d::Zero();
      for (std::size_t k = 4 * static_cast<std::size_t>(v); k < 4 * static_cast<std::size_t>(v + 1); ++k) {
        const Eigen::Index j = 3 * static_cast<Eigen::Index>(influences[k]);
        const auto row = [&](const Positions& x, Eigen::Index i) -> Eigen::Vector3d {
          return x.row(i).transpose().cast<double>();
        };
        const Eigen::Vector3d origin = row(joints[t], j), x = (row(joints[t], j + 1) - origin).normalized(),
                              y = (row(joints[t], j + 2) - origin).normalized();
        const Eigen::Vector3d local = row(rest[0], v) - row(pivots[0], j);
        place += weights[k] / 65535.0 * (origin + local.x() * x + local.y() * y + local.z() * x.cross(y));
      }
      EXPECT_LE((place - at(t).positions.row(v).transpose().cast<double>()).norm(), 3e-4) << t << " " << v;
    }
  }
}

TEST_F(ReportFile, ABodyThatIsElsewhereInMostFramesIsThereAsPoints) {
  ReportInput input = make_input(false);
  const auto skin = worm(4);
  const Positions still = skin->mesh.mesh.rest_positions;
  input.obstacles.push_back({{"worm", skin->mesh.mesh.faces},
                             [still](std::size_t) {
                               ObstacleFrame frame;
                               frame.positions = still;
                               return frame;
                             },
                             skin});
  const std::string text = page(input);
  const nlohmann::json obstacle = meta(text)["obstacles"][1];
  EXPECT_FALSE(obstacle.contains("skin"));
  EXPECT_EQ(sequence_of(text, obstacle["sequence"], skin->mesh.mesh.faces).size(), 4u);
}

TEST_F(ReportFile, NamesCannotBreakThePage) {
  const std::string text = page(make_input(false));
  EXPECT_THAT(text, HasSubstr("<title>A &lt;/script&gt; &lt;b&gt;cloth&lt;/b&gt;</title>"));
  EXPECT_EQ(meta(text)["report"]["title"], "A </script> <b>cloth</b>");
}

TEST_F(ReportFile, LeavesFramesOutAboveTheLimit) {
  const ReportInput input = make_input(false);
  const std::size_t whole = page(input).size();
  EXPECT_GT(meta(page(input, {whole - 200}))["stride"], 1);
  EXPECT_EQ(meta(page(input, {whole - 200}))["stages"][0]["ms"].size(), 4u);
  EXPECT_THROW(page(input, {1000}), Error);
}

TEST_F(ReportFile, NeedsAFrame) {
  ReportInput input = make_input(false);
  input.frame_count = 0;
  input.stages.clear();
  input.counts.clear();
  EXPECT_THROW(page(input), Error);
}

}  // namespace
}  // namespace pleat::presentation
