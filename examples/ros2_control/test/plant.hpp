// The exported arm as a simulated one, at 10 kHz, with a controller on its interfaces.
#pragma once

#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "identified_arm/controller.hpp"

namespace plant
{

using identified_arm::Controller;
using controller_interface::CallbackReturn;
using controller_interface::return_type;

constexpr int n = ARM_JOINTS, substeps = 10;
constexpr double period = 1e-3;  // s

inline std::vector<std::string> names()
{
  std::vector<std::string> made;
  for (const auto & name : arm_joint_names) made.emplace_back(name);
  return made;
}

// Counts allocations while it is above zero; see abuse.cpp.
inline thread_local int counting = 0;

class Bench
{
public:
  explicit Bench(std::map<std::string, rclcpp::ParameterValue> parameters = {})
  {
    parameters.emplace("joints", names());
    controller.get_node()->overrides = std::move(parameters);
    arm_begin(&state);
    std::fill(effort, effort + n, 0.0);
    std::fill(width, width + n, 0.01);
#ifdef ARM_RUNTIME_PAYLOAD
    arm_nominal(&numbers);
#endif
  }

  bool configure()
  {
    return controller.on_init() == CallbackReturn::SUCCESS &&
           controller.on_configure({}) == CallbackReturn::SUCCESS;
  }

  bool activate()
  {
    std::vector<hardware_interface::LoanedCommandInterface> commands;
    std::vector<hardware_interface::LoanedStateInterface> states;
    for (int j = 0; j < n; j++) commands.emplace_back(&effort[j]);
    for (int j = 0; j < n; j++) states.emplace_back(&q_read[j]);
    for (int j = 0; j < n; j++) states.emplace_back(&dq_read[j]);
    controller.assign_interfaces(std::move(commands), std::move(states));
    read();
    return controller.on_activate({}) == CallbackReturn::SUCCESS;
  }

  bool start() { return configure() && activate(); }

  void read()
  {
    std::copy_n(arm.q, n, q_read);
    std::copy_n(arm.dq, n, dq_read);
  }

  void reference(const double * q, const double * dq = nullptr, const double * ddq = nullptr)
  {
    Controller::Point point;
    point.positions.assign(q, q + n);
    if (dq != nullptr) point.velocities.assign(dq, dq + n);
    if (ddq != nullptr) point.accelerations.assign(ddq, ddq + n);
    controller.get_node()->publish("~/reference", point);
  }

  // One cycle of the controller alone.
  return_type update()
  {
    counting = 1;
    const return_type result = controller.update({}, {0, 1000000});
    counting = 0;
    for (int j = 0; j < n; j++) {
      largest = std::max(largest, std::abs(effort[j]) / arm_torque_limit[j]);
    }
    return result;
  }

  // The arm moves for one period with the effort of the interfaces.
  void move()
  {
    double acceleration[n];
    for (int s = 0; s < substeps; s++) {
#ifdef ARM_RUNTIME_PAYLOAD
      arm_advance(&state, &arm, width, &numbers);
      arm_forward_dynamics(&arm, effort, &state, width, &numbers, acceleration);
#else
      arm_advance(&state, &arm, width);
      arm_forward_dynamics(&arm, effort, &state, width, acceleration);
#endif
      for (int j = 0; j < n; j++) {
        arm.dq[j] += period / substeps * acceleration[j];
        arm.q[j] += period / substeps * arm.dq[j];
      }
      arm.time += period / substeps;
    }
    for (int j = 0; j < n; j++) fastest = std::max(fastest, std::abs(arm.dq[j]) / arm_velocity_limit[j]);
  }

  return_type cycle()
  {
    read();
    const return_type result = update();
    move();
    return result;
  }

  Controller controller;
  arm_sample arm{};
  arm_state state{};
#ifdef ARM_RUNTIME_PAYLOAD
  arm_numbers numbers{};
#endif
  double effort[n], width[n], q_read[n], dq_read[n];
  double largest = 0.0, fastest = 0.0;  // effort and speed in parts of the limits
};

}  // namespace plant
