// A ros2_control plug-in: computed torque with an identified model that lieid exported to C.
#pragma once

#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "controller_interface/controller_interface.hpp"
#include "identified_arm/computed_torque.hpp"
#include "trajectory_msgs/msg/joint_trajectory_point.hpp"

namespace identified_arm
{

using controller_interface::CallbackReturn;

// Claims the effort of the joints of the parameter `joints`, in the order of the exported model, and
// reads their position and velocity. Follows the last point of the topic `~/reference`; until there
// is one it holds the position of its activation.
class Controller : public controller_interface::ControllerInterface
{
public:
  using Point = trajectory_msgs::msg::JointTrajectoryPoint;

  CallbackReturn on_init() override;
  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;
  CallbackReturn on_configure(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_activate(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous) override;
  controller_interface::return_type update(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  void receive(const Point & point);

  std::vector<std::string> joints_;
  std::unique_ptr<ComputedTorque> law_;
  rclcpp::Subscription<Point>::SharedPtr subscription_;
  std::mutex mutex_;  // of received_; the control loop only tries to take it
  Reference received_;
  bool fresh_ = false;
  Reference reference_;
};

}  // namespace identified_arm
