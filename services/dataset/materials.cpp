#include "services/dataset/materials.hpp"

#include <cmath>
#include <nlohmann/json.hpp>

namespace pleat::dataset {
namespace {

double between(double from, double to, double share) {
  if (share == 0) return from;
  if (from > 0 && to > 0) return from * std::exp(share * std::log(to / from));
  return from + share * (to - from);
}

}  // namespace

simulation::Material between(const simulation::Material& from, const simulation::Material& to, double share) {
  simulation::Material result = from;
  result.density = between(from.density, to.density, share);
  for (std::size_t r = 0; r < from.stretching.size(); ++r) {
    for (std::size_t c = 0; c < from.stretching[r].size(); ++c) {
      result.stretching[r][c] = between(from.stretching[r][c], to.stretching[r][c], share);
    }
  }
  for (std::size_t r = 0; r < from.bending.size(); ++r) {
    for (std::size_t c = 0; c < from.bending[r].size(); ++c) {
      result.bending[r][c] = between(from.bending[r][c], to.bending[r][c], share);
    }
  }
  return result;
}

std::string to_json(const simulation::Material& material) {
  return nlohmann::ordered_json{
      {"density", material.density}, {"stretching", material.stretching}, {"bending", material.bending}}
      .dump();
}

}  // namespace pleat::dataset
