// Stub of the part of ros2_control that the example uses, so that it can be compiled and tested
// without ROS 2. Names and signatures are those of the documentation of Jazzy; with STUB_ROLLING
// values are read by get_optional(), as in Rolling.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rclcpp/rclcpp.hpp"

namespace hardware_interface
{

class CommandInterface
{
public:
  CommandInterface(const std::string & prefix, const std::string & name, double * value)
  : prefix_(prefix), name_(name), value_(value)
  {
  }
  std::string get_name() const { return prefix_ + "/" + name_; }
  // In ROS 2 another controller sets it through a loan.
  void set(double value) { *value_ = value; }

private:
  std::string prefix_, name_;
  double * value_;
};

// A value of the hardware.
class LoanedStateInterface
{
public:
  explicit LoanedStateInterface(double * value) : value_(value) {}
#ifdef STUB_ROLLING
  [[nodiscard]] std::optional<double> get_optional() const { return *value_; }
#else
  double get_value() const { return *value_; }
#endif

protected:
  double * value_;
};

class LoanedCommandInterface : public LoanedStateInterface
{
public:
  using LoanedStateInterface::LoanedStateInterface;
  [[nodiscard]] bool set_value(double value)
  {
    *value_ = value;
    return true;
  }
};

}  // namespace hardware_interface

namespace controller_interface
{

using CallbackReturn = rclcpp_lifecycle::CallbackReturn;
enum class return_type { OK, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };

struct InterfaceConfiguration
{
  interface_configuration_type type;
  std::vector<std::string> names = {};
};

class ChainableControllerInterface
{
public:
  virtual ~ChainableControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_cleanup(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_error(const rclcpp_lifecycle::State &) = 0;

  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period)
  {
    if (!chained_ && update_reference_from_subscribers(time, period) != return_type::OK) {
      return return_type::ERROR;
    }
    return update_and_write_commands(time, period);
  }
  std::vector<hardware_interface::CommandInterface> export_reference_interfaces()
  {
    return on_export_reference_interfaces();
  }
  bool set_chained_mode(bool chained)
  {
    if (on_set_chained_mode(chained)) chained_ = chained;
    return chained_ == chained;
  }
  bool is_in_chained_mode() const { return chained_; }

  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return node_; }
  std::shared_ptr<const rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }

  // In ROS 2 the controller manager does this.
  void assign_interfaces(
    std::vector<hardware_interface::LoanedCommandInterface> && commands,
    std::vector<hardware_interface::LoanedStateInterface> && states)
  {
    command_interfaces_ = std::move(commands);
    state_interfaces_ = std::move(states);
  }

protected:
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
  virtual bool on_set_chained_mode(bool chained) = 0;
  virtual return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period) = 0;
  virtual return_type update_and_write_commands(
    const rclcpp::Time & time, const rclcpp::Duration & period) = 0;

  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;
  std::vector<double> reference_interfaces_;

private:
  bool chained_ = false;
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ =
    std::make_shared<rclcpp_lifecycle::LifecycleNode>();
};

}  // namespace controller_interface
