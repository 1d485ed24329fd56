// Computed torque with identified dynamics and friction. No ROS, no allocation: may run in any
// control loop.
#pragma once

#include <array>

#include "arm.h"

namespace identified_arm
{

using Joints = std::array<double, ARM_JOINTS>;

struct Reference
{
  Joints q{}, dq{}, ddq{};  // rad, rad/s, rad/s² (m for prismatic joints)
};

struct Settings
{
  double bandwidth = 20.0;  // rad/s, of the closed loop
  double effort_limit = 0.0;  // N·m, of each joint; 0: none
  double velocity_width = 0.01;  // rad/s, within which friction changes its sign smoothly
};

class ComputedTorque
{
public:
  explicit ComputedTorque(const Settings & settings = Settings());

  // Begin a motion at rest.
  void begin();

  // Write the torque for the measured motion; false, and nothing written, if a value is not finite.
  //
  // tau = M(q) a + C(q, dq) dq + G(q) + effects at the reference, with
  // a = ddq_r + 2 w (dq_r - dq) + w² (q_r - q).
  bool cycle(
    double period, const Reference & reference, const Joints & q, const Joints & dq,
    Joints & torque);

private:
  Settings settings_;
  Joints width_{};
  arm_state state_{};
  double time_ = 0.0;
};

}  // namespace identified_arm
