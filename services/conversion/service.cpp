#include "services/conversion/service.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

#include "common/base/error.hpp"
#include "common/frame/messages.hpp"
#include "common/mesh/subdivision.hpp"
#include "common/rpc/stream.hpp"
#include "services/conversion/image_map.hpp"
#include "services/conversion/normalization.hpp"

namespace pleat::conversion {
namespace {

constexpr std::uint32_t kDefaultRounds = 2;

// What a stream keeps; its frames are converted one after the other, so that the buffers may be reused.
struct Session {
  Topology fine;
  std::vector<std::uint32_t> feature_vertices;  // empty if the fine mesh is not a subdivision made here
  std::unique_ptr<ImageMap> map;
  Normalization normalization;  // empty: values stay physical
  Eigen::Index coarse_vertices = 0;
  Tensor image;
  Positions positions;
};

void check_size(double vertices, std::int64_t limit, const char* what) {
  if (vertices <= static_cast<double>(limit)) return;
  throw Error(ErrorCode::kResourceExhausted, std::string(what) + ": about " +
                                                 std::to_string(static_cast<std::int64_t>(vertices)) +
                                                 ", more than this service's limit of " + std::to_string(limit));
}

Normalization normalization_from(const v1::Normalization& message) {
  Normalization n;
  n.minimum.assign(message.minimum().begin(), message.minimum().end());
  n.maximum.assign(message.maximum().begin(), message.maximum().end());
  if (n.minimum.empty() && n.maximum.empty()) return n;
  if (n.minimum.size() != kImageChannels || n.maximum.size() != kImageChannels) {
    throw_invalid_argument("open.setup.normalization: " + std::to_string(n.minimum.size()) + " minima and " +
                           std::to_string(n.maximum.size()) + " maxima, expected 9 of each");
  }
  for (std::size_t c = 0; c < kImageChannels; ++c) {
    if (std::isfinite(n.minimum[c]) && std::isfinite(n.maximum[c]) && n.minimum[c] <= n.maximum[c]) continue;
    throw_invalid_argument("open.setup.normalization: the range of " + image_channel_names()[c] +
                           " is not finite or inverted");
  }
  return n;
}

ImageSpec spec_from(const v1::ConversionSetup& setup, std::int64_t max_texels) {
  ImageSpec spec;
  const auto extent = [](std::uint32_t value) { return static_cast<int>(std::min(value, 1u << 20)); };
  spec.coarse_width = extent(setup.coarse_width());
  spec.coarse_height = extent(setup.coarse_height());
  if (setup.texels_per_fine_vertex() != 0)
    spec.texels_per_fine_vertex = static_cast<double>(setup.texels_per_fine_vertex());
  if (setup.scale() != 0) spec.scale = extent(setup.scale());
  spec.max_fine_texels = max_texels;
  return spec;
}

std::shared_ptr<Session> open_session(const v1::ConversionSetup& setup, const ServiceOptions& options) {
  auto session = std::make_shared<Session>();
  const Topology coarse = from_message(setup.coarse(), "open.setup.coarse");
  session->coarse_vertices = coarse.vertex_count();
  session->normalization = normalization_from(setup.normalization());
  const ImageSpec spec = spec_from(setup, options.max_texels);
  if (setup.has_fine() && setup.fine().faces_size() > 0) {
    session->fine = from_message(setup.fine(), "open.setup.fine");
  } else {
    const std::uint32_t rounds = setup.has_subdivision_rounds() ? setup.subdivision_rounds() : kDefaultRounds;
    if (rounds > 5) throw_invalid_argument("open.setup.subdivision_rounds: at most 5, not " + std::to_string(rounds));
    check_size(static_cast<double>(coarse.vertex_count()) * std::pow(4.0, rounds), options.max_vertices,
               "open.setup: vertices of the fine mesh");
    Subdivision subdivision = subdivide(coarse, static_cast<int>(rounds));
    session->fine = std::move(subdivision.fine);
    session->feature_vertices = std::move(subdivision.feature_vertices);
  }
  check_size(static_cast<double>(session->fine.vertex_count()), options.max_vertices,
             "open.setup.fine: vertices of the fine mesh");
  session->map = std::make_unique<ImageMap>(coarse, session->fine, spec);
  spdlog::info("session: {} coarse and {} fine vertices, images of {} x {} and {} x {} texels", coarse.vertex_count(),
               session->fine.vertex_count(), session->map->coarse_width(), session->map->coarse_height(),
               session->map->fine_width(), session->map->fine_height());
  return session;
}

void describe(const Session& session, bool with_fine, v1::ConversionOpened* opened) {
  opened->set_coarse_width(static_cast<std::uint32_t>(session.map->coarse_width()));
  opened->set_coarse_height(static_cast<std::uint32_t>(session.map->coarse_height()));
  opened->set_fine_width(static_cast<std::uint32_t>(session.map->fine_width()));
  opened->set_fine_height(static_cast<std::uint32_t>(session.map->fine_height()));
  if (!with_fine) return;
  *opened->mutable_fine() = to_message(session.fine);
  opened->mutable_feature_vertices()->Add(session.feature_vertices.begin(), session.feature_vertices.end());
}

void to_image(Session& session, const v1::Frame& request, v1::ImageFrame* response) {
  const Frame frame = from_message(request, session.coarse_vertices, "frame");
  const RigidTransform transform = session.map->align(frame.positions);
  session.map->coarse_image(frame, transform, session.image);
  if (!session.normalization.minimum.empty()) {
    response->set_out_of_range(static_cast<std::uint32_t>(normalize(session.image, session.normalization)));
  }
  response->set_index(frame.index);
  response->set_time_s(frame.time_s);
  to_message(session.image, response->mutable_image());
  *response->mutable_alignment() = to_message(transform);
}

void to_mesh(Session& session, const v1::ImageFrame& request, v1::MeshFrame* response) {
  Tensor image = from_message(request.image(), "frame.image");
  const RigidTransform transform = from_message(request.alignment(), "frame.alignment");
  if (image.shape.size() != 3 || image.shape[0] < 3 || image.shape[0] > kImageChannels) {
    throw_invalid_argument("frame.image: expected 3 to 9 channels, height and width");
  }
  if (!session.normalization.minimum.empty()) {
    // Positions need the three displacement channels only.
    image.values.resize(image.values.size() / static_cast<std::size_t>(image.shape[0]) * 3);
    image.shape[0] = 3;
    const Normalization& n = session.normalization;
    denormalize(image, {{n.minimum.begin(), n.minimum.begin() + 3}, {n.maximum.begin(), n.maximum.begin() + 3}});
  }
  session.map->to_mesh(image, transform, session.positions);
  v1::Frame* fine = response->mutable_fine();
  fine->set_index(request.index());
  fine->set_time_s(request.time_s());
  to_message(session.positions, fine->mutable_positions());
  *response->mutable_stage_times() = request.stage_times();
}

}  // namespace

grpc::Status ConversionService::ToImage(grpc::ServerContext* context,
                                        grpc::ServerReaderWriter<v1::ToImageResponse, v1::ToImageRequest>* stream) {
  return rpc::serve_frames<v1::ToImageRequest, v1::ToImageResponse>(
      context, stream, {"to_image", &metrics_}, [this](const v1::ToImageOpen& open, v1::ConversionOpened* opened) {
        auto session = open_session(open.setup(), options_);
        describe(*session, false, opened);
        return [session](const v1::Frame& request, v1::ImageFrame* response) { to_image(*session, request, response); };
      });
}

grpc::Status ConversionService::ToMesh(grpc::ServerContext* context,
                                       grpc::ServerReaderWriter<v1::ToMeshResponse, v1::ToMeshRequest>* stream) {
  return rpc::serve_frames<v1::ToMeshRequest, v1::ToMeshResponse>(
      context, stream, {"to_mesh", &metrics_}, [this](const v1::ToMeshOpen& open, v1::ConversionOpened* opened) {
        auto session = open_session(open.setup(), options_);
        describe(*session, true, opened);
        return
            [session](const v1::ImageFrame& request, v1::MeshFrame* response) { to_mesh(*session, request, response); };
      });
}

}  // namespace pleat::conversion
