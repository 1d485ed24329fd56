// A ros2_control plug-in: computed torque with an identified model that lieid exported to C.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"
#include "identified_arm/control_law.hpp"
#include "identified_arm/identified_arm_parameters.hpp"
#include "rclcpp/rclcpp.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"
#include "trajectory_msgs/msg/joint_trajectory_point.hpp"

namespace identified_arm
{

using controller_interface::CallbackReturn;
using controller_interface::return_type;

// Claims the effort of the joints and reads their position and velocity. The reference is the topic
// `~/reference`, or, in chained mode, the interfaces JOINT/position, JOINT/velocity and
// JOINT/acceleration of this controller. Until there is one, and when none has come for the
// time-out, the arm holds its position.
class Controller : public controller_interface::ChainableControllerInterface
{
public:
  using Point = trajectory_msgs::msg::JointTrajectoryPoint;
  using Payload = std_msgs::msg::Float64MultiArray;

  CallbackReturn on_init() override;
  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;
  CallbackReturn on_configure(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_activate(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_cleanup(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_error(const rclcpp_lifecycle::State & previous) override;

protected:
  std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override;
  bool on_set_chained_mode(bool chained) override;
  return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;
  return_type update_and_write_commands(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  bool check_joints() const;
  bool read_settings(Settings & settings) const;
  void receive_reference(const Point & point);
  void receive_payload(const Payload & message);
  void report();
  void forget_references();
  bool write(const Joints & effort);

  std::shared_ptr<ParamListener> listener_;
  Params parameters_;
  std::unique_ptr<ControlLaw> law_;
  rclcpp::Subscription<Point>::SharedPtr reference_subscription_;
  rclcpp::Subscription<Payload>::SharedPtr payload_subscription_;
  rclcpp::TimerBase::SharedPtr timer_;

  // Of the topics; the control loop only tries to take the mutex.
  std::mutex mutex_;
  Reference received_;
  Body body_{};
  bool fresh_ = false, fresh_body_ = false;

  bool new_reference_ = false;  // of the topic, in this cycle
  bool commanded_ = false;  // whether the reference interfaces have had values
  // Written by the control loop, logged by a timer: logging allocates.
  std::atomic<Mode> mode_{Mode::holding};
  std::atomic<Fault> fault_{Fault::none};
  Mode reported_mode_ = Mode::holding;
  Fault reported_fault_ = Fault::none;
};

}  // namespace identified_arm
