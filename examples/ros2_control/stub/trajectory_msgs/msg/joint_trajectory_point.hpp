// Stub, see controller_interface/chainable_controller_interface.hpp.
#pragma once

#include <vector>

namespace trajectory_msgs::msg
{

struct JointTrajectoryPoint
{
  std::vector<double> positions, velocities, accelerations;
};

}  // namespace trajectory_msgs::msg
