// Obstacles of a scene as moving points: what they are checked for, and where their scripts put them.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "common/frame/frame.hpp"
#include "services/simulation/scene.hpp"

namespace pleat::simulation {

/// What is wrong with an obstacle, in words that follow its name; empty if nothing is. O(F log F).
std::string obstacle_fault(const Obstacle& obstacle);

/// The points that carry an obstacle: a mesh's vertices, the two ends of every capsule in turn, a sphere's centre.
std::size_t point_count(const Obstacle& obstacle);

/// Where the script puts the points at a time. O(points).
std::vector<Eigen::Vector3d> points_at(const Obstacle& obstacle, double time_s);
/// The same into point_count() points that are there.
void points_at(const Obstacle& obstacle, double time_s, std::span<Eigen::Vector3d> points);

ObstacleShape shape_of(const Obstacle& obstacle);

/// The obstacle of a frame whose points are there.
ObstacleFrame frame_of(const Obstacle& obstacle, std::span<const Eigen::Vector3d> points);

}  // namespace pleat::simulation
