#include "services/simulation/material.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "common/base/error.hpp"
#include "common/base/json.hpp"
#include "common/base/text_file.hpp"

namespace pleat::simulation {
namespace {

using nlohmann::json;

double read_number(const json& value, const std::string& what) {
  if (!value.is_number()) throw_invalid_argument(what + " is not a number");
  const double number = value.get<double>();
  if (!std::isfinite(number) || std::abs(number) > 1e9) throw_invalid_argument(what + " is out of range");
  return number;
}

template <std::size_t Rows, std::size_t Columns>
void read_table(const json& value, const std::string& what, std::array<std::array<double, Columns>, Rows>& table) {
  if (!value.is_array() || value.size() != Rows) {
    throw_invalid_argument(what + " must have " + std::to_string(Rows) + " rows");
  }
  for (std::size_t r = 0; r < Rows; ++r) {
    const std::string row = what + " row " + std::to_string(r);
    if (!value[r].is_array() || value[r].size() != Columns) {
      throw_invalid_argument(row + " must have " + std::to_string(Columns) + " numbers");
    }
    for (std::size_t c = 0; c < Columns; ++c) table[r][c] = read_number(value[r][c], row);
  }
}

}  // namespace

Material parse_material(std::string_view text, const std::string& name) {
  const json document = parse_json(text, name);
  if (!document.is_object()) throw_invalid_argument(name + ": a material is a JSON object");
  for (const char* key : {"density", "stretching", "bending"}) {
    if (!document.contains(key)) throw_invalid_argument(name + ": key '" + key + "' is missing");
  }
  for (const auto& [key, value] : document.items()) {
    if (key != "density" && key != "stretching" && key != "bending") {
      throw_invalid_argument(name + ": unknown key '" + key + "'");
    }
  }
  Material material;
  material.density = read_number(document["density"], name + ": density");
  if (material.density <= 0) throw_invalid_argument(name + ": density must be positive");
  read_table(document["stretching"], name + ": stretching", material.stretching);
  read_table(document["bending"], name + ": bending", material.bending);
  const auto& rest = material.stretching[0];
  if (rest[0] <= 0 || rest[2] <= 0 || rest[3] <= 0) {
    throw_invalid_argument(name + ": stretching row 0 needs positive c11, c22 and c33");
  }
  return material;
}

Material read_material(const std::filesystem::path& path) {
  return parse_material(read_text_file(path), path.string());
}

Material isotropic_material(const IsotropicConstants& constants, const std::string& name) {
  const auto check = [&](double value, const char* key) {
    if (!(value > 0) || !std::isfinite(value)) throw_invalid_argument(name + ": " + key + " must be positive");
  };
  check(constants.density, "density");
  check(constants.youngs_modulus, "Young's modulus");
  check(constants.thickness, "thickness");
  const double ratio = constants.poissons_ratio;
  if (!(ratio >= 0 && ratio <= 0.5)) throw_invalid_argument(name + ": Poisson's ratio must be 0 to 0.5");
  const double membrane = constants.youngs_modulus * constants.thickness;
  const double rigidity = membrane * constants.thickness * constants.thickness / (12 * (1 - ratio * ratio));
  Material material;
  material.density = constants.density * constants.thickness;
  // Half of what counts against Green strain: the tables are doubled where they are used.
  const double c11 = membrane / (2 * (1 - ratio * ratio));
  for (auto& row : material.stretching) row = {c11, ratio * c11, c11, membrane / (2 * (1 + ratio))};
  // A hinge's energy at stiffness k is that of a plate of rigidity k/4.
  for (auto& row : material.bending) row.fill(4 * rigidity);
  return material;
}

Moduli StretchingTable::exact(const Material& material, double g00, double g11, double g01) {
  // Largest principal stretch and its direction, from C = 2 G + I.
  const double c00 = 2 * g00 + 1, c11 = 2 * g11 + 1, c01 = 2 * std::abs(g01);
  const double middle = (c00 + c11) / 2, half_difference = (c00 - c11) / 2;
  const double radius = std::hypot(half_difference, c01);
  const double stretch = std::sqrt(std::max(middle + radius, 0.0));
  double angle = std::atan2(c01, half_difference) / 2;  // 0 to pi/2
  if (c01 == 0) angle = half_difference >= 0 ? 0 : std::numbers::pi / 2;

  const double a = std::clamp(8 * angle / std::numbers::pi, 0.0, 4.0);
  const double s = std::clamp(6 * (stretch - 1), 0.0, 1.0);
  const int column = std::min(static_cast<int>(a), 3);
  const double fraction = a - column;
  const auto& rest = material.stretching[0];
  const auto& low = material.stretching[static_cast<std::size_t>(1 + column)];
  const auto& high = material.stretching[static_cast<std::size_t>(2 + column)];
  std::array<double, 4> value{};
  for (std::size_t k = 0; k < 4; ++k) {
    const double stretched = (1 - fraction) * low[k] + fraction * high[k];
    value[k] = 2 * std::max((1 - s) * rest[k] + s * stretched, 0.0);
  }
  value[1] = std::min(value[1], std::sqrt(value[0] * value[2]));
  return {static_cast<float>(value[0]), static_cast<float>(value[1]), static_cast<float>(value[2]),
          static_cast<float>(value[3])};
}

StretchingTable::StretchingTable(const Material& material, double multiplier) {
  samples_.reserve(kSamples * kSamples * kSamples);
  const auto factor = static_cast<float>(multiplier);
  for (int i = 0; i < kSamples; ++i) {
    for (int j = 0; j < kSamples; ++j) {
      for (int k = 0; k < kSamples; ++k) {
        const double step = 1.0 / kSamples;
        Moduli m = exact(material, kLowestStrain + i * step, kLowestStrain + j * step, k * step);
        m = {m.c11 * factor, m.c12 * factor, m.c22 * factor, m.c33 * factor};
        samples_.push_back(m);
      }
    }
  }
}

Moduli StretchingTable::at(double g00, double g11, double g01) const {
  const auto locate = [](double coordinate, int& index, float& fraction) {
    const double x = std::clamp(coordinate * kSamples, 0.0, kSamples - 1.0);
    index = std::min(static_cast<int>(x), kSamples - 2);
    fraction = static_cast<float>(x - index);
  };
  int i, j, k;
  float fi, fj, fk;
  locate(g00 - kLowestStrain, i, fi);
  locate(g11 - kLowestStrain, j, fj);
  locate(std::abs(g01), k, fk);
  Moduli result{0, 0, 0, 0};
  for (int di = 0; di < 2; ++di) {
    for (int dj = 0; dj < 2; ++dj) {
      for (int dk = 0; dk < 2; ++dk) {
        const float w = (di ? fi : 1 - fi) * (dj ? fj : 1 - fj) * (dk ? fk : 1 - fk);
        const Moduli& m = samples_[static_cast<std::size_t>(((i + di) * kSamples + j + dj) * kSamples + k + dk)];
        result.c11 += w * m.c11;
        result.c12 += w * m.c12;
        result.c22 += w * m.c22;
        result.c33 += w * m.c33;
      }
    }
  }
  return result;
}

double bending_stiffness(const Material& material, double du, double dv, double kappa) {
  const double q = std::min(0.2 * std::abs(kappa) / 2, 4.0);
  const int column = std::min(static_cast<int>(q), 3);
  const double fq = q - column;
  double b = std::abs(std::atan2(dv, du)) * 4 / std::numbers::pi;  // 0 to 4 for 0 to 180 degrees
  if (b > 2) b = 4 - b;
  const int row = std::clamp(static_cast<int>(b), 0, 1);
  const double fb = b - row;
  const auto value = [&](int r, int c) {
    return material.bending[static_cast<std::size_t>(r)][static_cast<std::size_t>(c)];
  };
  const double low = (1 - fq) * value(row, column) + fq * value(row, column + 1);
  const double high = (1 - fq) * value(row + 1, column) + fq * value(row + 1, column + 1);
  return std::max((1 - fb) * low + fb * high, 0.0);
}

}  // namespace pleat::simulation
