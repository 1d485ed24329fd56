#include "identified_arm/controller.hpp"

#include <algorithm>

#include "pluginlib/class_list_macros.hpp"

namespace identified_arm
{

using controller_interface::interface_configuration_type;
using controller_interface::return_type;

CallbackReturn Controller::on_init()
{
  auto_declare<std::vector<std::string>>("joints", {});
  auto_declare<double>("bandwidth", Settings().bandwidth);
  auto_declare<double>("effort_limit", Settings().effort_limit);
  auto_declare<double>("velocity_width", Settings().velocity_width);
  return CallbackReturn::SUCCESS;
}

controller_interface::InterfaceConfiguration Controller::command_interface_configuration() const
{
  controller_interface::InterfaceConfiguration made{interface_configuration_type::INDIVIDUAL, {}};
  for (const auto & joint : joints_) made.names.push_back(joint + "/effort");
  return made;
}

controller_interface::InterfaceConfiguration Controller::state_interface_configuration() const
{
  controller_interface::InterfaceConfiguration made{interface_configuration_type::INDIVIDUAL, {}};
  for (const auto & joint : joints_) made.names.push_back(joint + "/position");
  for (const auto & joint : joints_) made.names.push_back(joint + "/velocity");
  return made;
}

CallbackReturn Controller::on_configure(const rclcpp_lifecycle::State &)
{
  joints_ = get_node()->get_parameter("joints").as_string_array();
  if (joints_.size() != ARM_JOINTS) {
    RCLCPP_ERROR(
      get_node()->get_logger(), "parameter joints: %zu names; expected %d, the joints of the model",
      joints_.size(), ARM_JOINTS);
    return CallbackReturn::ERROR;
  }
  Settings settings;
  settings.bandwidth = get_node()->get_parameter("bandwidth").as_double();
  settings.effort_limit = get_node()->get_parameter("effort_limit").as_double();
  settings.velocity_width = get_node()->get_parameter("velocity_width").as_double();
  law_ = std::make_unique<ComputedTorque>(settings);
  subscription_ = get_node()->create_subscription<Point>(
    "~/reference", rclcpp::SystemDefaultsQoS(), [this](const Point & point) { receive(point); });
  return CallbackReturn::SUCCESS;
}

void Controller::receive(const Point & point)
{
  if (point.positions.size() != ARM_JOINTS) {
    RCLCPP_ERROR(
      get_node()->get_logger(), "reference: %zu positions; expected %d", point.positions.size(),
      ARM_JOINTS);
    return;
  }
  Reference made;
  std::copy(point.positions.begin(), point.positions.end(), made.q.begin());
  if (point.velocities.size() == ARM_JOINTS) {
    std::copy(point.velocities.begin(), point.velocities.end(), made.dq.begin());
  }
  if (point.accelerations.size() == ARM_JOINTS) {
    std::copy(point.accelerations.begin(), point.accelerations.end(), made.ddq.begin());
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  received_ = made;
  fresh_ = true;
}

CallbackReturn Controller::on_activate(const rclcpp_lifecycle::State &)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  reference_ = Reference();
  fresh_ = false;
  for (std::size_t j = 0; j < ARM_JOINTS; j++) reference_.q[j] = state_interfaces_[j].get_value();
  law_->begin();
  return CallbackReturn::SUCCESS;
}

CallbackReturn Controller::on_deactivate(const rclcpp_lifecycle::State &)
{
  for (auto & command : command_interfaces_) command.set_value(0.0);
  return CallbackReturn::SUCCESS;
}

return_type Controller::update(const rclcpp::Time &, const rclcpp::Duration & period)
{
  if (const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock); lock && fresh_) {
    reference_ = received_;
    fresh_ = false;
  }
  Joints q, dq, torque;
  for (std::size_t j = 0; j < ARM_JOINTS; j++) {
    q[j] = state_interfaces_[j].get_value();
    dq[j] = state_interfaces_[ARM_JOINTS + j].get_value();
  }
  if (!law_->cycle(period.seconds(), reference_, q, dq, torque)) return return_type::ERROR;
  for (std::size_t j = 0; j < ARM_JOINTS; j++) command_interfaces_[j].set_value(torque[j]);
  return return_type::OK;
}

}  // namespace identified_arm

PLUGINLIB_EXPORT_CLASS(identified_arm::Controller, controller_interface::ControllerInterface)
