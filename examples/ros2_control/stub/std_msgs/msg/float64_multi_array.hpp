// Stub, see controller_interface/chainable_controller_interface.hpp.
#pragma once

#include <vector>

namespace std_msgs::msg
{

struct Float64MultiArray
{
  std::vector<double> data;
};

}  // namespace std_msgs::msg
