// Cloth materials in ARCSim's JSON format: measured anisotropic stretching and bending (Wang et al. 2011).
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace pleat::simulation {

/// The figures of a material file, as measured. The file has exactly these three keys.
struct Material {
  double density = 0;  ///< kg/m^2, > 0

  /// N/m: columns c11, c12, c22, c33. Row 0 belongs to zero strain, rows 1..5 to a principal stretch of 1 + 1/6 at 0,
  /// 22.5, 45, 67.5, 90 degrees from the u axis of the material coordinates.
  std::array<std::array<double, 4>, 6> stretching{};

  /// N m: rows are edge directions 0, 45, 90 degrees from u; columns are curvature samples 0, 5, 10, 15, 20 1/m.
  std::array<std::array<double, 5>, 3> bending{};
};

/// Parses a material. Throws kInvalidArgument, naming `name` and the key, on bad JSON, missing or unknown keys, wrong
/// sizes, values that are not finite, density <= 0, or a zero-strain row without resistance (c11, c22, c33 all <= 0).
Material parse_material(std::string_view json, const std::string& name);

/// parse_material on a file; throws kNotFound if it can't be read.
Material read_material(const std::filesystem::path& path);

/// A sheet of one elastic substance.
struct IsotropicConstants {
  double density = 0;         ///< kg/m^3, of the substance
  double youngs_modulus = 0;  ///< Pa
  double poissons_ratio = 0;  ///< 0 to 0.5
  double thickness = 0;       ///< metres
};

/// The tables of such a sheet: stretching and shearing of a plate in plane stress, bending of a thin one. The formula
/// is in deploy/materials/README.md. Throws kInvalidArgument, naming `name` and the key, unless the constants are
/// finite, positive and the ratio 0 to 0.5.
Material isotropic_material(const IsotropicConstants& constants, const std::string& name);

/// Effective moduli (N/m) against Green strain: S = [[c11 G00 + c12 G11, c33 G01], [., c12 G00 + c22 G11]].
struct Moduli {
  float c11, c12, c22, c33;
};

/// The stretching moduli as a function of Green strain, tabulated once per material: a 30^3 grid over
/// G00, G11 in [-0.25, 0.7167] and |G01| in [0, 0.9667], trilinear in between, clamped outside. Negative measured
/// entries count as 0, c12 is limited to sqrt(c11 c22) so that the energy is convex in strain, and all entries carry
/// the factor 2 of ARCSim against the measured figures (docs/simulation.md).
class StretchingTable {
 public:
  StretchingTable(const Material& material, double multiplier);
  Moduli at(double g00, double g11, double g01) const;
  /// The grid, for code that interpolates several strains at once: kSamples values of G00 by G11 by |G01|, in steps of
  /// 1 / kSamples from kLowestStrain (G01: from 0).
  const Moduli* samples() const { return samples_.data(); }
  static constexpr int kSamples = 30;
  static constexpr double kLowestStrain = -0.25;
  /// The model before tabulation, for tests and for building the table.
  static Moduli exact(const Material& material, double g00, double g11, double g01);

 private:
  std::vector<Moduli> samples_;
};

/// Bending stiffness (N m) of an edge whose direction in material coordinates is (du, dv), at curvature kappa (1/m).
/// Symmetric in the sign of kappa, constant above |kappa| = 40 1/m, never negative.
double bending_stiffness(const Material& material, double du, double dv, double kappa);

}  // namespace pleat::simulation
