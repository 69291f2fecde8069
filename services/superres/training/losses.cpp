#include "services/superres/training/losses.hpp"

#include "common/mesh/wrinkles.hpp"

namespace pleat::superres {
namespace {

using torch::indexing::Slice;

constexpr double kEdgeUnit = 0.01;  ///< strain that counts 1
constexpr double kFlat = 1e-4;      ///< energy of normals in a band

/// (B, F, 3, H, W) rotated by the inverse of (B, F, 3, 3).
torch::Tensor rotate_back(const torch::Tensor& vectors, const torch::Tensor& rotations) {
  return torch::einsum("bfji,bfjhw->bfihw", {rotations, vectors});
}

/// Mean extent of three channels, in physical units; what interpolation lacks of it with scaling "deviation".
torch::Tensor mean_range(int first, const LossConstants& constants, const LossConfig& config) {
  // Without normals of their own, those of the mesh count as they are.
  if (first < 0) return torch::ones({}, constants.scale.options());
  const auto channels = Slice(first, first + 3);
  const auto range = constants.scale.index({channels});
  return config.scaling == "deviation" ? (range * constants.deviation.index({channels})).mean() : range.mean();
}

torch::Tensor kinematic_loss(const torch::Tensor& synthesized, const Batch& batch, const LossConstants& constants,
                             const LossConfig& config) {
  const std::int64_t frames = batch.frames, windows = synthesized.size(0) / frames;
  const auto shape = [&](const torch::Tensor& t, int first) {
    const auto channels = Slice(first, first + 3);
    const auto minimum = constants.offset.index({channels}).view({1, 3, 1, 1});
    const auto range = constants.scale.index({channels}).view({1, 3, 1, 1});
    const auto part = t.index({Slice(), channels}) * range + minimum;
    return part.view({windows, frames, 3, t.size(2), t.size(3)});
  };
  const bool exact = config.alignment == "exact";
  torch::Tensor d = shape(synthesized, 0), v = shape(synthesized, constants.velocity);
  const torch::Tensor true_d = shape(batch.answer, 0), true_v = shape(batch.answer, constants.velocity);
  torch::Tensor target = config.target == "ground_truth" ? true_d : d;
  if (exact) {
    // The simulated frames satisfy the relation exactly, so the errors alone have to; the rest positions and
    // translations cancel, and only rotations remain.
    const auto rotations = batch.rotations.view({windows, frames, 3, 3});
    target = rotate_back(target - true_d, rotations);
    d = rotate_back(d - true_d, rotations);
    v = rotate_back(v - true_v, rotations);
  }
  // Frames of a window share the mask: (B, 1, 1, H, W), counted once for each k.
  const auto mask =
      batch.mask.view({windows, frames, 1, synthesized.size(2), synthesized.size(3)}).index({Slice(), Slice(0, 1)});
  const auto steps = torch::cumsum(v.index({Slice(), Slice(1)}), 1) * constants.frame_time_s;
  const auto residual = target.index({Slice(), Slice(1)}) - (d.index({Slice(), Slice(0, 1)}) + steps);
  // Eq. 5 sums over k.
  return (residual / mean_range(0, constants, config)).square().mul(mask).sum() / (mask.sum() * 3);
}

/// Vectors (N, 3, H, W) in the alignment's axes at the vertices, (N, 3, V).
torch::Tensor read_vertices(const torch::Tensor& values, const LossConstants& constants) {
  const std::int64_t images = values.size(0), reads = constants.vertex_weights.size(0);
  const auto places = constants.vertex_texels.expand({images, 3, -1});
  return (values.flatten(2).gather(2, places).view({images, 3, reads, -1}) * constants.vertex_weights).sum(2);
}

/// Vectors in the cloth's own axes -> in the alignment's. axes: (N, 3 x 3, h, w), enlarged bilinearly.
torch::Tensor turned(const torch::Tensor& vectors, const torch::Tensor& axes) {
  if (!axes.defined()) return vectors;
  const auto fine = torch::upsample_bilinear2d(axes, {vectors.size(2), vectors.size(3)}, false);
  return vectors.slice(1, 0, 1) * fine.slice(1, 0, 3) + vectors.slice(1, 1, 2) * fine.slice(1, 3, 6) +
         vectors.slice(1, 2, 3) * fine.slice(1, 6);
}

/// Values (N, 3, V) at vertex `row` of each face or edge, (N, 3, F).
torch::Tensor at_corner(const torch::Tensor& values, const torch::Tensor& rows, std::int64_t row) {
  return values.gather(2, rows[row].expand({values.size(0), 3, -1}));
}

torch::Tensor length(const torch::Tensor& vectors) { return vectors.norm(2, {1}, true); }

/// Area-weighted unit normals (N, 3, V) of positions (N, 3, V); zero for a vertex without area.
torch::Tensor mesh_normals(const torch::Tensor& positions, const torch::Tensor& faces) {
  const auto a = at_corner(positions, faces, 0);
  const auto areas = torch::cross(at_corner(positions, faces, 1) - a, at_corner(positions, faces, 2) - a, 1);
  const auto places = faces.flatten().expand({positions.size(0), 3, -1});
  const auto sums = torch::zeros_like(positions).scatter_add(2, places, areas.repeat({1, 1, 3}));
  return sums / length(sums).clamp_min(1e-12);
}

torch::Tensor edge_lengths(const torch::Tensor& positions, const torch::Tensor& edges) {
  return length(at_corner(positions, edges, 1) - at_corner(positions, edges, 0));
}

/// (bands, N) mean over the vertices of |S^j n - S^k n|^2 for normals (N, 3, V).
torch::Tensor wrinkle_energies(const torch::Tensor& normals, const torch::Tensor& ring_average) {
  const std::int64_t images = normals.size(0), vertices = normals.size(2);
  torch::Tensor smooth = normals.reshape({images * 3, vertices}).t().contiguous();
  std::vector<torch::Tensor> bands;
  for (std::size_t band = 0; band < kWrinkleLossBands; ++band) {
    const torch::Tensor before = smooth;
    for (int round = kBandRounds[band]; round < kBandRounds[band + 1]; ++round) {
      smooth = torch::_sparse_mm(ring_average, smooth);
    }
    bands.push_back((before - smooth).square().sum(0).view({images, 3}).sum(1) / vertices);
  }
  return torch::stack(bands);
}

void add_vertex_losses(Losses& losses, const torch::Tensor& synthesized, const Batch& batch,
                       const LossConstants& constants, const LossConfig& config) {
  const auto channels = Slice(0, 3);
  const auto range = constants.scale.index({channels}).view({1, 3, 1, 1});
  const auto minimum = constants.offset.index({channels}).view({1, 3, 1, 1});
  const auto images = [&](const torch::Tensor& t) { return t.index({Slice(), channels}); };
  // The error is read alone: it is small beside the displacements, which float32 would round.
  const auto error = read_vertices(turned((images(synthesized) - images(batch.answer)) * range, batch.axes), constants);
  if (config.vertices > 0) {
    losses.vertices = (error / (constants.unit_m * mean_range(0, constants, config))).square().mean();
    losses.total = losses.total + config.vertices * losses.vertices;
  }
  if (!config.needs_normals() && config.edges <= 0) return;
  const auto truth =
      batch.vertex_base + read_vertices(turned(images(batch.answer) * range + minimum, batch.axes), constants);
  const auto answer = truth + error;
  torch::Tensor answer_normals, true_normals;
  if (config.needs_normals()) {
    answer_normals = mesh_normals(answer, constants.faces);
    true_normals = mesh_normals(truth, constants.faces);
  }
  if (config.vertex_normals > 0) {
    const auto difference = answer_normals - true_normals;
    losses.vertex_normals = (difference / mean_range(constants.normal, constants, config)).square().mean();
    losses.total = losses.total + config.vertex_normals * losses.vertex_normals;
  }
  if (config.edges > 0) {
    const auto difference = edge_lengths(answer, constants.edges) - edge_lengths(truth, constants.edges);
    losses.edges = (difference / (kEdgeUnit * constants.edge_lengths)).square().mean();
    losses.total = losses.total + config.edges * losses.edges;
  }
  if (config.wrinkles > 0) {
    const auto energies = wrinkle_energies(answer_normals, constants.ring_average);
    const auto truths = wrinkle_energies(true_normals, constants.ring_average);
    losses.wrinkles = ((energies + kFlat).log() - (truths + kFlat).log()).square().mean();
    losses.total = losses.total + config.wrinkles * losses.wrinkles;
  }
}

}  // namespace

void Batch::to(torch::Device device) {
  for (auto* t : {&input, &answer, &mask, &rotations, &vertex_base, &axes, &before, &known, &lead, &lead_known}) {
    if (t->defined()) *t = t->to(device);
  }
}

void LossConstants::set_vertices(const MeshRead& read, const torch::Device& device) {
  const std::int64_t vertices = read.vertex_count();
  unit_m = static_cast<double>(read.unit_m);
  vertex_texels = torch::tensor(read.texels, torch::kInt64).to(device);
  vertex_weights = torch::tensor(read.weights).view({-1, vertices}).to(device);
  faces = torch::tensor(read.faces, torch::kInt64).view({3, -1}).to(device);
  edges = torch::tensor(read.edges, torch::kInt64).view({2, -1}).to(device);
  const auto rest = torch::tensor(read.rest).view({1, 3, vertices}).to(device);
  edge_lengths = pleat::superres::edge_lengths(rest, edges).flatten();
  const auto itself = torch::arange(vertices, torch::kInt64).to(device);
  const auto places = torch::cat({edges, edges.flip(0), itself.expand({2, -1})}, 1);
  const auto counts = torch::bincount(places[0], {}, vertices).to(torch::kFloat32);
  ring_average =
      torch::sparse_coo_tensor(places, counts.reciprocal().index_select(0, places[0]), {vertices, vertices}).coalesce();
}

Losses compute_losses(const torch::Tensor& synthesized, const Batch& batch, const LossConstants& constants,
                      const LossConfig& config) {
  auto error = (synthesized - batch.answer).square();
  if (config.scaling == "deviation") error = error / constants.deviation.square().view({1, -1, 1, 1});
  error = error * batch.mask;
  const auto texels = batch.mask.sum() * 3;
  // What further channels there are belongs to the last three.
  const auto part = [&](int first) {
    const auto last = first == 6 ? error.size(1) : first + 3;
    return first < error.size(1) ? error.index({Slice(), Slice(first, last)}).sum() / texels
                                 : torch::zeros({}, error.options());
  };
  Losses losses;
  losses.displacement = part(0);
  losses.normal = part(3);
  losses.velocity = part(6);
  losses.total =
      config.displacement * losses.displacement + config.normal * losses.normal + config.velocity * losses.velocity;
  if (batch.frames > 1 && config.kinematic > 0 && constants.velocity >= 0) {
    losses.kinematic = kinematic_loss(synthesized, batch, constants, config);
    losses.total = losses.total + config.kinematic * losses.kinematic;
  } else {
    losses.kinematic = torch::zeros_like(losses.total);
  }
  losses.vertices = losses.vertex_normals = losses.edges = losses.wrinkles = torch::zeros_like(losses.total);
  if (config.needs_vertices()) add_vertex_losses(losses, synthesized, batch, constants, config);
  return losses;
}

}  // namespace pleat::superres
