#include "services/cli/bridge.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <bit>
#include <cerrno>
#include <cstring>
#include <deque>
#include <set>

#include "common/base/own_file.hpp"
#include "common/base/text_file.hpp"
#include "common/client/adapter/adapter.hpp"
#include "common/mesh/garment.hpp"
#include "common/mesh/holes.hpp"
#include "common/mesh/mesh_file.hpp"
#include "common/mesh/obj.hpp"
#include "services/cli/output.hpp"
#include "services/presentation/input/sequence_input.hpp"

namespace pleat::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

static_assert(std::endian::native == std::endian::little, "PC2 files are written in memory's byte order");

constexpr std::string_view kMagic("POINTCACHE2\0", 12);
constexpr std::string_view kMarks[] = {kMagic};
constexpr long kHeaderBytes = 32, kCountAt = 28;

/// The members of `request`, which has no others than `known`.
class Members {
 public:
  Members(const json& request, const std::string& name, const std::set<std::string>& known)
      : request_(request), name_(name) {
    if (!request.is_object()) throw_invalid_argument(name + ": not an object");
    for (const auto& [key, value] : request.items())
      if (known.count(key) == 0) throw_invalid_argument(name + ": unknown key '" + key + "'");
  }

  template <class T>
  T required(const std::string& key) const {
    if (!request_.contains(key)) throw_invalid_argument(name_ + ": " + key + " is missing");
    return value<T>(key);
  }
  template <class T>
  T optional(const std::string& key, T standard) const {
    return request_.contains(key) ? value<T>(key) : standard;
  }

 private:
  template <class T>
  T value(const std::string& key) const {
    try {
      return request_.at(key).get<T>();
    } catch (const json::exception&) {
      throw_invalid_argument(name_ + ": " + key + ": a value of another kind is needed");
    }
  }

  const json& request_;
  std::string name_;
};

json report_of(const client::EnhancedFrame& frame, std::uint64_t sample) {
  double ms = 0;
  for (const client::StageTime& time : frame.stage_times)
    if (time.stage.find('.') == std::string::npos) ms += time.ms;
  json report = {{"sample", sample},
                 {"ms", ms},
                 {"penetrations", frame.report.penetrations_after},
                 {"self_intersections", frame.report.self_intersections_after},
                 {"input_intersects", frame.report.input_intersects}};
  if (frame.error) report["error"] = frame.error->what();
  return report;
}

}  // namespace

Pc2Samples::Pc2Samples(const fs::path& path, std::size_t vertices, std::uint64_t first)
    : path_(path), file_(nullptr, &std::fclose), vertices_(vertices), samples_(first) {
  require_replaceable(path, kMarks);
  // No link is followed: what it points to need not be ours.
  const int descriptor =
      ::open(path.c_str(), O_RDWR | O_CLOEXEC | O_NOFOLLOW | (first == 0 ? O_CREAT | O_TRUNC : 0), 0644);
  if (descriptor < 0) throw_invalid_argument(path.string() + ": can't be written: " + std::strerror(errno));
  file_.reset(::fdopen(descriptor, "r+b"));
  std::array<std::int32_t, 5> header{1, static_cast<std::int32_t>(vertices), 0, 0, 0};
  header[3] = std::bit_cast<std::int32_t>(1.0f);  // a sample a frame
  if (first == 0) {
    std::fwrite(kMagic.data(), 1, kMagic.size(), file());
    check(std::fwrite(header.data(), sizeof header, 1, file()) == 1);
    return;
  }
  std::array<std::int32_t, 5> found{};
  std::fseek(file(), static_cast<long>(kMagic.size()), SEEK_SET);
  const bool whole = std::fread(found.data(), sizeof found, 1, file()) == 1;
  if (!whole || found[1] != header[1] || found[4] < 0 || static_cast<std::uint64_t>(found[4]) < first)
    throw_invalid_argument(path.string() + ": has no " + std::to_string(first) + " samples of " +
                           std::to_string(vertices) + " vertices to go on from");
  const auto end = static_cast<long>(static_cast<std::uint64_t>(kHeaderBytes) + first * vertices * 3 * sizeof(float));
  check(::ftruncate(::fileno(file()), end) == 0 && std::fseek(file(), end, SEEK_SET) == 0);
}

void Pc2Samples::check(bool good) const {
  if (!good) throw Error(ErrorCode::kResourceExhausted, path_.string() + ": " + std::strerror(errno));
}

void Pc2Samples::add(const std::vector<float>& positions) {
  if (positions.size() != 3 * vertices_) throw_internal(path_.string() + ": a sample of another size");
  check(std::fwrite(positions.data(), sizeof(float), positions.size(), file()) == positions.size());
  ++samples_;
}

void Pc2Samples::flush() {
  const long end = std::ftell(file());
  const auto count = static_cast<std::int32_t>(samples_);
  // The samples go first: a reader of the header finds all that it counts.
  check(std::fflush(file()) == 0 && std::fseek(file(), kCountAt, SEEK_SET) == 0 &&
        std::fwrite(&count, sizeof count, 1, file()) == 1 && std::fseek(file(), end, SEEK_SET) == 0);
}

void Bridge::answer(const json& request, const Say& say, const Stop& stop) {
  if (!request.is_object() || request.size() != 1)
    throw_invalid_argument("a request is an object with one member, \"open\" or \"enhance\"");
  const std::string kind = request.begin().key();
  if (kind == "open")
    open(request.begin().value(), say);
  else if (kind == "enhance")
    enhance(request.begin().value(), say, stop);
  else
    throw_invalid_argument("unknown request '" + kind + "': there are open and enhance");
}

void Bridge::open(const json& request, const Say& say) {
  const Members members(request, "open", {"rest", "mesh", "frame_time_s", "material", "held", "rounds", "obstacles"});
  session_.reset();
  subdivision_.reset();
  obstacles_.clear();
  std::vector<std::string> notes;
  rest_name_ = members.required<std::string>("rest");
  rest_ = read_garment(rest_name_, notes);
  session_options_ = {};
  session_options_.coarse = client::from_topology(rest_);
  session_options_.model = options_.model;
  session_options_.detail = options_.detail;
  session_options_.frame_time_s = members.optional("frame_time_s", session_options_.frame_time_s);
  if (!(session_options_.frame_time_s > 0)) throw_invalid_argument("open: frame_time_s must be positive");
  const std::string material = members.optional<std::string>("material", "");
  if (!material.empty()) session_options_.material_json = read_text_file(shipped_or(material, "materials"));
  session_options_.held = members.optional<std::vector<std::uint32_t>>("held", {});
  if (const auto rounds = members.optional<std::int64_t>("rounds", -1); rounds >= 0)
    session_options_.subdivision_rounds = static_cast<std::uint32_t>(rounds);
  for (const json& each : members.optional<json>("obstacles", json::array())) {
    const Members parts(each, "open: obstacle", {"name", "mesh", "moved"});
    const auto name = parts.required<std::string>("name"), mesh = parts.required<std::string>("mesh");
    Obstacle obstacle;
    obstacle.open = read_mesh(mesh, MeshUse::kObstacle);
    const Topology closed = close_holes(obstacle.open, parts.optional("moved", false), mesh, notes);
    obstacle.shape.name = name;
    obstacle.shape.faces = closed.faces;
    obstacle.rest = closed.rest_positions;
    if (!obstacles_.emplace(name, std::move(obstacle)).second)
      throw_invalid_argument("open: two obstacles have the name " + name);
  }
  std::vector<ObstacleShape> shapes;
  for (const auto& [name, obstacle] : obstacles_) shapes.push_back(obstacle.shape);
  session_options_.obstacles = client::from_shapes(shapes);
  begin_session();
  const client::SessionInfo& info = session_->info();
  const Topology fine = client::to_topology(info.fine);
  const auto spec = find_subdivision(rest_, fine);
  if (!spec) throw_internal("the session's fine mesh is not a subdivision of the coarse one");
  subdivision_ = subdivide(rest_, *spec);
  const fs::path mesh = members.required<std::string>("mesh");
  write_obj(mesh, fine);
  say({{"opened",
        {{"mesh", mesh.string()},
         {"vertices", fine.vertex_count()},
         {"faces", fine.face_count()},
         {"rounds", spec->rounds},
         {"detail", name_of(info.detail)},
         {"model", info.model},
         {"notes", notes}}}});
}

void Bridge::begin_session() {
  session_.reset();
  session_ = client_.enhance(session_options_);
  next_index_ = 0;
}

void Bridge::enhance(const json& request, const Say& say, const Stop& stop) {
  const Members members(request, "enhance", {"coarse", "obstacles", "fine", "first", "count", "restart"});
  if (!subdivision_) throw Error(ErrorCode::kFailedPrecondition, "enhance: nothing was opened");
  const auto first = members.optional<std::uint64_t>("first", 0);
  const auto coarse_name = members.required<std::string>("coarse");
  const auto coarse = presentation::open_frame_sequence(coarse_name, rest_);
  const std::uint64_t known = coarse->frame_count();
  if (first >= known) throw_invalid_argument(coarse_name + ": no sample " + std::to_string(first));
  const auto count = std::min(members.optional<std::uint64_t>("count", known - first), known - first);
  std::map<std::string, std::unique_ptr<presentation::FrameSequence>> moved;
  for (const auto& [name, source] : members.optional<std::map<std::string, std::string>>("obstacles", {})) {
    const auto found = obstacles_.find(name);
    if (found == obstacles_.end()) throw_invalid_argument("enhance: no obstacle " + name + " was opened");
    moved[name] = presentation::open_frame_sequence(source, found->second.open);
  }
  require_frame_of(coarse->positions(first), rest_, coarse_name + " sample " + std::to_string(first), rest_name_);
  Pc2Samples fine(members.required<std::string>("fine"), static_cast<std::size_t>(subdivision_->fine.vertex_count()),
                  first);
  if (members.optional("restart", false) || !session_) begin_session();

  std::deque<Positions> waiting;  // inputs without an answer, bounded by the window
  std::uint64_t sent = 0;
  client::CoarseFrame frame;
  bool filled = false;  // `frame` did not fit into the window
  try {
    for (std::uint64_t answered = 0; answered < count; ++answered) {
      while (sent < count) {
        if (!filled) {
          const std::uint64_t sample = first + sent;
          waiting.push_back(coarse->positions(sample));
          frame.index = next_index_;
          frame.time_s = session_options_.frame_time_s * static_cast<double>(next_index_);
          frame.positions = client::from_positions(waiting.back());
          std::vector<ObstacleFrame> obstacles;
          for (const auto& [name, obstacle] : obstacles_) {
            obstacles.emplace_back();
            obstacles.back().name = name;
            obstacles.back().positions = obstacle.rest;
            if (const auto motion = moved.find(name); motion != moved.end()) {
              const std::uint64_t last = motion->second->frame_count() - 1;
              obstacles.back().positions = motion->second->positions(std::min(sample, last));
            }
          }
          frame.obstacles = client::from_obstacles(obstacles);
        }
        filled = !session_->try_push(frame);
        if (filled) break;
        ++sent;
        ++next_index_;
      }
      if (stop()) throw Error(ErrorCode::kCancelled, "cancelled after " + std::to_string(answered) + " frames");
      const std::optional<client::EnhancedFrame> answer = session_->pop();
      if (!answer) throw Error(ErrorCode::kUnavailable, client_.address() + ": the session was ended early");
      fine.add(answer->error ? client::from_positions(upsample(*subdivision_, rest_.faces, waiting.front()))
                             : answer->positions);
      waiting.pop_front();
      say({{"frame", report_of(*answer, first + answered)}});
    }
  } catch (...) {
    session_.reset();
    fine.flush();
    throw;
  }
  fine.flush();
  say({{"enhanced", {{"first", first}, {"count", count}}}});
}

}  // namespace pleat::cli
