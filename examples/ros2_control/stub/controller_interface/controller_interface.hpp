// Stub of the part of ros2_control that the example uses, so that it can be compiled and tested
// without ROS 2. Names and signatures are those of ROS 2 Humble and Jazzy.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "rclcpp/rclcpp.hpp"

namespace rclcpp_lifecycle
{

class State
{
};

// Parameters and subscriptions by name.
class LifecycleNode
{
public:
  rclcpp::Parameter get_parameter(const std::string & name) const { return parameters.at(name); }
  rclcpp::Logger get_logger() const { return {}; }

  template <class Message, class Callback>
  typename rclcpp::Subscription<Message>::SharedPtr create_subscription(
    const std::string & topic, const rclcpp::SystemDefaultsQoS &, Callback callback)
  {
    auto made = std::make_shared<rclcpp::Subscription<Message>>();
    made->topic = topic;
    made->callback = std::move(callback);
    subscription = made;
    return made;
  }

  std::map<std::string, rclcpp::Parameter> parameters;
  std::shared_ptr<void> subscription;
};

}  // namespace rclcpp_lifecycle

namespace hardware_interface
{

// A value of the hardware.
class LoanedStateInterface
{
public:
  explicit LoanedStateInterface(double * value) : value_(value) {}
  double get_value() const { return *value_; }

protected:
  double * value_;
};

class LoanedCommandInterface : public LoanedStateInterface
{
public:
  using LoanedStateInterface::LoanedStateInterface;
  void set_value(double value) { *value_ = value; }
};

}  // namespace hardware_interface

namespace controller_interface
{

enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };

struct InterfaceConfiguration
{
  interface_configuration_type type;
  std::vector<std::string> names;
};

class ControllerInterface
{
public:
  virtual ~ControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State & previous) = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State & previous) = 0;
  virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous) = 0;
  virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;

  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return node_; }

  // In ROS 2 the controller manager does this.
  void assign_interfaces(
    std::vector<hardware_interface::LoanedCommandInterface> commands,
    std::vector<hardware_interface::LoanedStateInterface> states)
  {
    command_interfaces_ = std::move(commands);
    state_interfaces_ = std::move(states);
  }

protected:
  template <class Value> void auto_declare(const std::string & name, const Value & value)
  {
    node_->parameters.emplace(name, rclcpp::Parameter(value));
  }

  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ =
    std::make_shared<rclcpp_lifecycle::LifecycleNode>();
};

}  // namespace controller_interface
