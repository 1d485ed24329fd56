#include "identified_arm/controller.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <string>
#include <type_traits>
#include <utility>

#include "pluginlib/class_list_macros.hpp"

namespace identified_arm
{

namespace
{

using controller_interface::interface_configuration_type;

constexpr double UNKNOWN = std::numeric_limits<double>::quiet_NaN();
const char * const KINDS[] = {"position", "velocity", "acceleration"};

template <class Interface, class = void> struct has_optional : std::false_type
{
};
template <class Interface>
struct has_optional<Interface, std::void_t<decltype(std::declval<Interface>().get_optional())>>
: std::true_type
{
};

// The value of an interface, NaN if it cannot be read now: get_value() of Jazzy became
// get_optional() in later distributions.
template <class Interface> double value_of(const Interface & interface)
{
  if constexpr (has_optional<Interface>::value) {
    return interface.get_optional().value_or(UNKNOWN);
  } else {
    return interface.get_value();
  }
}

const char * text_of(Fault fault)
{
  switch (fault) {
    case Fault::state: return "a position or velocity of the hardware is not finite";
    case Fault::reference: return "the reference is not finite";
    case Fault::torque: return "the effort of the control law is not finite";
    default: return "none";
  }
}

bool ends_with(const std::string & text, const std::string & end)
{
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

}  // namespace

CallbackReturn Controller::on_init()
{
  try {
    listener_ = std::make_shared<ParamListener>(get_node());
    parameters_ = listener_->get_params();
  } catch (const std::exception & error) {
    RCLCPP_ERROR(get_node()->get_logger(), "%s", error.what());
    return CallbackReturn::ERROR;
  }
  return CallbackReturn::SUCCESS;
}

controller_interface::InterfaceConfiguration Controller::command_interface_configuration() const
{
  controller_interface::InterfaceConfiguration made{interface_configuration_type::INDIVIDUAL, {}};
  for (const auto & joint : parameters_.joints) made.names.push_back(joint + "/effort");
  return made;
}

controller_interface::InterfaceConfiguration Controller::state_interface_configuration() const
{
  controller_interface::InterfaceConfiguration made{interface_configuration_type::INDIVIDUAL, {}};
  for (const auto & joint : parameters_.joints) made.names.push_back(joint + "/position");
  for (const auto & joint : parameters_.joints) made.names.push_back(joint + "/velocity");
  return made;
}

CallbackReturn Controller::on_configure(const rclcpp_lifecycle::State &)
{
  parameters_ = listener_->get_params();
  Settings settings;
  if (!check_joints() || !read_settings(settings)) return CallbackReturn::FAILURE;
  law_ = std::make_unique<ControlLaw>(settings);
  reference_interfaces_.assign(3 * ARM_JOINTS, UNKNOWN);
  reference_subscription_ = get_node()->create_subscription<Point>(
    "~/reference", rclcpp::SystemDefaultsQoS(),
    [this](const Point & point) { receive_reference(point); });
  payload_subscription_ = get_node()->create_subscription<Payload>(
    "~/payload", rclcpp::SystemDefaultsQoS(),
    [this](const Payload & message) { receive_payload(message); });
  timer_ = get_node()->create_wall_timer(std::chrono::milliseconds(50), [this]() { report(); });
  return CallbackReturn::SUCCESS;
}

// The joints are those of the model, in its order; names may have a prefix.
bool Controller::check_joints() const
{
  const auto & joints = parameters_.joints;
  if (joints.size() != ARM_JOINTS) {
    RCLCPP_ERROR(
      get_node()->get_logger(), "parameter joints: %zu names; expected %d, the joints of the model",
      joints.size(), ARM_JOINTS);
    return false;
  }
  for (std::size_t j = 0; j < ARM_JOINTS; j++) {
    if (!ends_with(joints[j], arm_joint_names[j])) {
      RCLCPP_ERROR(
        get_node()->get_logger(),
        "parameter joints: %s at place %zu; expected %s, or that name with a prefix",
        joints[j].c_str(), j + 1, arm_joint_names[j]);
      return false;
    }
  }
  return true;
}

// Write the settings that the parameters state; false, and a message, if they do not fit the arm.
bool Controller::read_settings(Settings & settings) const
{
  const auto & p = parameters_;
  settings.bandwidth = p.bandwidth;
  settings.velocity_width = p.velocity_width;
  settings.reference_timeout = p.reference_timeout;
  settings.following_error = p.following_error;
  settings.takeover_time = p.takeover_time;
  settings.payload_time = p.payload_time;
  settings.fault_hold_time = p.fault.hold_time;
  settings.fault_release_time = p.fault.release_time;
  settings.fault_rate = p.fault.damping_rate;
  struct Kind
  {
    const char * name;
    const std::vector<double> & given;
    Joints & limit;
    bool below_robot;
  } kinds[] = {
    {"effort", p.limits.effort, settings.limits.effort, true},
    {"velocity", p.limits.velocity, settings.limits.velocity, true},
    {"acceleration", p.limits.acceleration, settings.limits.acceleration, false}};
  for (auto & kind : kinds) {
    if (!kind.given.empty() && kind.given.size() != ARM_JOINTS) {
      RCLCPP_ERROR(
        get_node()->get_logger(), "parameter limits.%s: %zu numbers; expected none or %d", kind.name,
        kind.given.size(), ARM_JOINTS);
      return false;
    }
    for (std::size_t j = 0; j < ARM_JOINTS; j++) {
      const double robot = kind.limit[j];
      if (!kind.given.empty()) kind.limit[j] = kind.given[j];
      if (!std::isfinite(kind.limit[j]) || !(kind.limit[j] > 0.0)) {
        RCLCPP_ERROR(
          get_node()->get_logger(), "joint %s has no limit of %s; give a positive limits.%s",
          arm_joint_names[j], kind.name, kind.name);
        return false;
      }
      if (kind.below_robot && kind.limit[j] > robot) {
        RCLCPP_ERROR(
          get_node()->get_logger(), "limits.%s: %g for joint %s is above the robot's %g", kind.name,
          kind.limit[j], arm_joint_names[j], robot);
        return false;
      }
      kind.limit[j] *= p.limits.fraction;
    }
  }
  return true;
}

void Controller::receive_reference(const Point & point)
{
  const auto fits = [](const std::vector<double> & values, bool needed) {
    return values.size() == ARM_JOINTS || (values.empty() && !needed);
  };
  if (!fits(point.positions, true) || !fits(point.velocities, false) ||
    !fits(point.accelerations, false)) {
    RCLCPP_ERROR(
      get_node()->get_logger(),
      "reference: %zu positions, %zu velocities, %zu accelerations; expected %d of each, or no "
      "velocities and accelerations",
      point.positions.size(), point.velocities.size(), point.accelerations.size(), ARM_JOINTS);
    return;
  }
  Reference made;
  std::copy(point.positions.begin(), point.positions.end(), made.q.begin());
  std::copy(point.velocities.begin(), point.velocities.end(), made.dq.begin());
  std::copy(point.accelerations.begin(), point.accelerations.end(), made.ddq.begin());
  const std::lock_guard<std::mutex> lock(mutex_);
  received_ = made;
  fresh_ = true;
}

void Controller::receive_payload(const Payload & message)
{
  if (message.data.size() != body_.size()) {
    RCLCPP_ERROR(
      get_node()->get_logger(),
      "payload: %zu numbers; expected 10: m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the "
      "origin of the tool frame", message.data.size());
    return;
  }
  Body body;
  std::copy(message.data.begin(), message.data.end(), body.begin());
  if (!ControlLaw(Settings()).set_payload(body)) {  // tried on a law of its own
    RCLCPP_ERROR(
      get_node()->get_logger(),
      "payload: refused, because it is no rigid body, or the arm was exported without "
      "--payload");
    return;
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  body_ = body;
  fresh_body_ = true;
}

void Controller::forget_references()
{
  const std::lock_guard<std::mutex> lock(mutex_);
  fresh_ = new_reference_ = commanded_ = false;
  std::fill(reference_interfaces_.begin(), reference_interfaces_.end(), UNKNOWN);
}

std::vector<hardware_interface::CommandInterface> Controller::on_export_reference_interfaces()
{
  std::vector<hardware_interface::CommandInterface> made;
  made.reserve(3 * ARM_JOINTS);
  reference_interfaces_.assign(3 * ARM_JOINTS, UNKNOWN);
  for (std::size_t kind = 0; kind < 3; kind++) {
    for (std::size_t j = 0; j < ARM_JOINTS; j++) {
      made.emplace_back(
        std::string(get_node()->get_name()) + "/" + parameters_.joints[j], KINDS[kind],
        &reference_interfaces_[kind * ARM_JOINTS + j]);
    }
  }
  return made;
}

bool Controller::on_set_chained_mode(bool)
{
  forget_references();
  return true;
}

CallbackReturn Controller::on_activate(const rclcpp_lifecycle::State &)
{
  forget_references();
  Joints q, dq, before;
  for (std::size_t j = 0; j < ARM_JOINTS; j++) {
    q[j] = value_of(state_interfaces_[j]);
    dq[j] = value_of(state_interfaces_[ARM_JOINTS + j]);
    before[j] = value_of(command_interfaces_[j]);
  }
  if (!law_->begin(q, dq, before)) {
    RCLCPP_ERROR(
      get_node()->get_logger(), "not activated: %s", text_of(Fault::state));
    return CallbackReturn::FAILURE;
  }
  mode_ = reported_mode_ = Mode::holding;
  fault_ = reported_fault_ = Fault::none;
  return CallbackReturn::SUCCESS;
}

// After this nothing controls the arm: without brakes, or another controller that the same switch
// activates, it falls.
CallbackReturn Controller::on_deactivate(const rclcpp_lifecycle::State &)
{
  Joints effort{};
  if (parameters_.deactivation_torque == "gravity" && !law_->released()) effort = law_->gravity();
  write(effort);
  report();
  return CallbackReturn::SUCCESS;
}

CallbackReturn Controller::on_cleanup(const rclcpp_lifecycle::State &)
{
  reference_subscription_.reset();
  payload_subscription_.reset();
  timer_.reset();
  law_.reset();
  return CallbackReturn::SUCCESS;
}

CallbackReturn Controller::on_error(const rclcpp_lifecycle::State & previous)
{
  write(Joints{});
  return on_cleanup(previous);
}

return_type Controller::update_reference_from_subscribers(
  const rclcpp::Time &, const rclcpp::Duration &)
{
  new_reference_ = false;
  const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
  if (!lock || !fresh_) return return_type::OK;
  std::copy(received_.q.begin(), received_.q.end(), reference_interfaces_.begin());
  std::copy(received_.dq.begin(), received_.dq.end(), reference_interfaces_.begin() + ARM_JOINTS);
  std::copy(
    received_.ddq.begin(), received_.ddq.end(), reference_interfaces_.begin() + 2 * ARM_JOINTS);
  fresh_ = false;
  new_reference_ = true;
  return return_type::OK;
}

return_type Controller::update_and_write_commands(
  const rclcpp::Time &, const rclcpp::Duration & period)
{
  if (const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock); lock && fresh_body_) {
    law_->set_payload(body_);
    fresh_body_ = false;
  }
  Joints q, dq, effort;
  Reference reference;
  for (std::size_t j = 0; j < ARM_JOINTS; j++) {
    q[j] = value_of(state_interfaces_[j]);
    dq[j] = value_of(state_interfaces_[ARM_JOINTS + j]);
    reference.q[j] = reference_interfaces_[j];
    reference.dq[j] = reference_interfaces_[ARM_JOINTS + j];
    reference.ddq[j] = reference_interfaces_[2 * ARM_JOINTS + j];
  }
  bool given = new_reference_;
  if (is_in_chained_mode()) {
    // velocities and accelerations that nobody commands are NaN
    const auto unknown = [](double x) { return std::isnan(x); };
    for (auto & x : reference.dq) x = unknown(x) ? 0.0 : x;
    for (auto & x : reference.ddq) x = unknown(x) ? 0.0 : x;
    given = commanded_ || !std::all_of(reference.q.begin(), reference.q.end(), unknown);
    commanded_ = given;
  }
  const Mode mode = law_->cycle(period.seconds(), given ? &reference : nullptr, q, dq, effort);
  mode_ = mode;
  fault_ = law_->fault();
  const bool written = write(effort);
  const bool failed = mode == Mode::fault && (!parameters_.fault.keep_active || law_->released());
  return written && !failed ? return_type::OK : return_type::ERROR;
}

bool Controller::write(const Joints & effort)
{
  bool written = true;
  for (std::size_t j = 0; j < command_interfaces_.size() && j < ARM_JOINTS; j++) {
    if constexpr (std::is_void_v<decltype(command_interfaces_[j].set_value(effort[j]))>) {
      command_interfaces_[j].set_value(effort[j]);
    } else {
      written = command_interfaces_[j].set_value(effort[j]) && written;
    }
  }
  return written;
}

// Log what has changed; not in the control loop.
void Controller::report()
{
  const Fault fault = fault_;
  const Mode mode = mode_;
  if (fault != reported_fault_ && fault != Fault::none) {
    RCLCPP_ERROR(
      get_node()->get_logger(), "%s: gravity and damping, then no effort, until the next activation",
      text_of(fault));
  }
  if (mode != reported_mode_ && mode == Mode::holding) {
    RCLCPP_WARN(
      get_node()->get_logger(), "no reference for %g s: the arm stops and holds its position",
      parameters_.reference_timeout);
  }
  reported_fault_ = fault;
  reported_mode_ = mode;
}

}  // namespace identified_arm

PLUGINLIB_EXPORT_CLASS(
  identified_arm::Controller, controller_interface::ChainableControllerInterface)
