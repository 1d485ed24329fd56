// Lets the plug-in move the exported arm, simulated by arm_forward_dynamics at 10 kHz, and prints
// the largest tracking error. The controller and the simulated arm have the same model, so that only
// the control law, the plug-in and the sampling are tested.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "identified_arm/controller.hpp"

using identified_arm::Controller;
using controller_interface::CallbackReturn;
using controller_interface::return_type;

namespace
{

constexpr int n = ARM_JOINTS, steps = 10;  // of the simulation in one cycle
constexpr double period = 1e-3, duration = 2.0;  // s
const double pi = std::acos(-1.0);

int fail(const char * what)
{
  std::fprintf(stderr, "%s\n", what);
  return 1;
}

}  // namespace

int main()
{
  Controller controller;
  if (controller.on_init() != CallbackReturn::SUCCESS) return fail("on_init");
  std::fprintf(stderr, "expected refusal: ");  // the plug-in logs why
  if (controller.on_configure({}) != CallbackReturn::ERROR) return fail("no joints: not refused");
  std::vector<std::string> joints;
  for (int j = 0; j < n; j++) joints.push_back("joint" + std::to_string(j + 1));
  controller.get_node()->parameters.at("joints") = rclcpp::Parameter(joints);
  if (controller.on_configure({}) != CallbackReturn::SUCCESS) return fail("on_configure");
  if (controller.command_interface_configuration().names.front() != "joint1/effort" ||
    controller.state_interface_configuration().names.size() != 2 * n) {
    return fail("interfaces");
  }

  arm_sample sample{};
  arm_state state;
  arm_begin(&state);
  double effort[n] = {}, width[n], acceleration[n];
  std::fill(width, width + n, 0.01);
  for (int j = 0; j < n; j++) sample.q[j] = 0.1 * (j + 1);
  std::vector<hardware_interface::LoanedCommandInterface> commands;
  std::vector<hardware_interface::LoanedStateInterface> states;
  for (int j = 0; j < n; j++) commands.emplace_back(&effort[j]);
  for (int j = 0; j < n; j++) states.emplace_back(&sample.q[j]);
  for (int j = 0; j < n; j++) states.emplace_back(&sample.dq[j]);
  controller.assign_interfaces(commands, states);
  if (controller.on_activate({}) != CallbackReturn::SUCCESS) return fail("on_activate");

  const auto subscription = std::static_pointer_cast<rclcpp::Subscription<Controller::Point>>(
    controller.get_node()->subscription);
  double worst = 0.0;
  for (double t = 0.0; t < duration; t += period) {
    Controller::Point point;  // q0 + (1 - cos(pi t)) / 5: at rest at both ends
    for (int j = 0; j < n; j++) {
      point.positions.push_back(0.1 * (j + 1) + 0.2 * (1.0 - std::cos(pi * t)));
      point.velocities.push_back(0.2 * pi * std::sin(pi * t));
      point.accelerations.push_back(0.2 * pi * pi * std::cos(pi * t));
    }
    subscription->callback(point);
    for (int j = 0; j < n; j++) worst = std::max(worst, std::abs(sample.q[j] - point.positions[j]));
    if (controller.update({}, {0, 1000000}) != return_type::OK) return fail("update");
    for (int s = 0; s < steps; s++) {
      arm_advance(&state, &sample, width);
      arm_forward_dynamics(&sample, effort, &state, width, acceleration);
      for (int j = 0; j < n; j++) {
        sample.dq[j] += period / steps * acceleration[j];
        sample.q[j] += period / steps * sample.dq[j];
      }
      sample.time += period / steps;
    }
  }
  std::printf("largest tracking error: %.2e\n", worst);

  const double before = effort[0], measured = sample.q[0];
  sample.q[0] = std::numeric_limits<double>::quiet_NaN();
  if (controller.update({}, {0, 1000000}) != return_type::ERROR || effort[0] != before) {
    return fail("a position that is not finite: not refused");
  }
  sample.q[0] = measured;
  controller.on_deactivate({});
  if (std::any_of(effort, effort + n, [](double x) { return x != 0.0; })) return fail("deactivate");
  return worst < 5e-3 ? 0 : fail("the tracking error is above 5e-3");
}
