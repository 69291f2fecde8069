// Figures of methods on the sequences of a data set.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "common/mesh/subdivision.hpp"
#include "common/store/dataset.hpp"
#include "services/evaluation/metrics.hpp"

namespace pleat::evaluation {

/// One frame as a method made it.
struct MethodFrame {
  Positions positions;                             ///< (V_fine x 3) metres
  std::vector<std::pair<std::string, double>> ms;  ///< per stage, in the order of the stages
  bool refined = false;
  std::uint64_t penetrations_before = 0, self_intersections_before = 0;  ///< where it was refined
};

/// What a method gets: the coarse frames of one sequence with their obstacles.
struct MethodInput {
  std::string sequence;
  std::shared_ptr<const MeshPair> meshes;
  std::uint64_t frames = 0;
  double frame_time_s = 0;
  std::string scene;     ///< JSON of the sequence, as the data set has it
  std::string material;  ///< the material file's text; empty in older data sets
  std::vector<ObstacleShape> obstacle_shapes;
  std::function<Positions(std::uint64_t)> coarse;
  std::function<std::vector<ObstacleFrame>(std::uint64_t)> obstacles;
};

/// A way to make fine frames. `run` gives each frame of a sequence to `sink`, in order.
struct Method {
  std::string name;  ///< "barycentric", "pleat:draping", "fold", "both:draping"
  std::function<void(const MethodInput&, const std::function<void(std::uint64_t, const MethodFrame&)>& sink)> run;
};

struct MethodFigures {
  std::string name;
  MetricValues metrics;
  std::vector<std::pair<std::string, double>> median_ms;  ///< per stage
};

struct EvaluationOptions {
  std::vector<std::string> sequences;  ///< empty: the split "test", or all if there is none
  std::uint64_t frames = 0;            ///< of each sequence at most; 0: all
  /// Every n-th frame is measured, n being this, though methods make all. Figures over time (jitter, STED's temporal
  /// part) then are of frames so far apart.
  std::uint64_t every = 1;
};

/// What methods have on one garment: all sequences of one pair of meshes.
struct GarmentFigures {
  std::vector<std::string> sequences;
  std::shared_ptr<const MeshPair> meshes;
  std::vector<MethodFigures> methods;
};

/// The sequences with frames that are named, or those of the split "test", or all if there are none. Throws kNotFound.
std::vector<SequenceInfo> chosen_sequences(const DatasetReader& dataset, const std::vector<std::string>& names);

/// Barycentric upsampling of the coarse frames. Runs throw kInvalidArgument where the fine mesh is not the subdivision
/// of the coarse mesh.
Method barycentric_method();

/// Wrinkles by example, from the data set's training split (services/superres/zurdo.hpp), without refinement, which the
/// method does not have.
Method zurdo_method(const DatasetReader& dataset);

/// How the fine mesh comes from the coarse one; kInvalidArgument if it is no subdivision.
SubdivisionSpec subdivision_of(const MeshPair& topology);

/// Runs every method on every sequence, garment by garment in the order of their first sequences. PSNR is of the data
/// set's own garment alone, whose ranges it has. Penetrations and self-intersections are counted by the judge of
/// services/refinement on what the method gave, whatever it reports itself; only the counts before refinement are the
/// method's own. `progress` gets the frames done of all.
/// Throws kNotFound (an unknown sequence, or none), and what methods throw.
std::vector<GarmentFigures> evaluate_garments(const DatasetReader& dataset, const std::vector<Method>& methods,
                                              const EvaluationOptions& options,
                                              const std::function<void(std::uint64_t, std::uint64_t)>& progress);

/// The same where all sequences have the same meshes; kInvalidArgument where they have not.
std::vector<MethodFigures> evaluate(const DatasetReader& dataset, const std::vector<Method>& methods,
                                    const EvaluationOptions& options,
                                    const std::function<void(std::uint64_t, std::uint64_t)>& progress);

/// 10 log10 of upsampling's VMSE over the method's, decibels; absent without upsampling among the methods, or where
/// either error is 0.
std::optional<double> gain_db(const GarmentFigures& garment, const std::string& method);

/// method -> metric -> value; a PSNR that does not exist is null.
nlohmann::json to_json(const std::vector<MethodFigures>& figures);
/// Of one garment as above. Of several: "garments", a list of objects (sequences, coarse_vertices, fine_vertices,
/// methods as above), and "gain_db": method -> mean, least and least_of, the first sequence of the garment that has it.
nlohmann::json to_json(const std::vector<GarmentFigures>& garments);
/// A table for people; of several garments one each, and one of the gains.
std::string to_table(const std::vector<MethodFigures>& figures);
std::string to_table(const std::vector<GarmentFigures>& garments);

}  // namespace pleat::evaluation
