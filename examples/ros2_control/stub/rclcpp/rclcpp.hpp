// Stub, see controller_interface/chainable_controller_interface.hpp.
#pragma once

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace rclcpp
{

class Time
{
};

class Duration
{
public:
  Duration(std::int32_t seconds, std::uint32_t nanoseconds)
  : seconds_(seconds + 1e-9 * nanoseconds)
  {
  }
  double seconds() const { return seconds_; }

private:
  double seconds_;
};

class Logger
{
};

class SystemDefaultsQoS
{
};

using ParameterValue =
  std::variant<bool, double, std::string, std::vector<std::string>, std::vector<double>>;

template <class Message> struct Subscription
{
  using SharedPtr = std::shared_ptr<Subscription>;
  std::function<void(const Message &)> callback;
};

struct TimerBase
{
  using SharedPtr = std::shared_ptr<TimerBase>;
  std::function<void()> callback;
};

}  // namespace rclcpp

namespace rclcpp_lifecycle
{

enum class CallbackReturn { SUCCESS, FAILURE, ERROR };

class State
{
};

// Subscriptions by topic, and the values of parameters that a launch file would give.
class LifecycleNode
{
public:
  rclcpp::Logger get_logger() const { return {}; }
  const char * get_name() const { return "identified_arm"; }

  template <class Message, class Callback>
  typename rclcpp::Subscription<Message>::SharedPtr create_subscription(
    const std::string & topic, const rclcpp::SystemDefaultsQoS &, Callback callback)
  {
    auto made = std::make_shared<rclcpp::Subscription<Message>>();
    made->callback = std::move(callback);
    subscriptions[topic] = made;
    return made;
  }

  template <class Callback>
  rclcpp::TimerBase::SharedPtr create_wall_timer(std::chrono::milliseconds, Callback callback)
  {
    auto made = std::make_shared<rclcpp::TimerBase>();
    made->callback = std::move(callback);
    return made;
  }

  // Publish a message.
  template <class Message> void publish(const std::string & topic, const Message & message)
  {
    std::static_pointer_cast<rclcpp::Subscription<Message>>(subscriptions.at(topic).lock())
      ->callback(message);
  }

  std::map<std::string, rclcpp::ParameterValue> overrides;
  std::map<std::string, std::weak_ptr<void>> subscriptions;
};

}  // namespace rclcpp_lifecycle

#define STUB_LOG(logger, ...) \
  ((void)(logger), std::fprintf(stderr, __VA_ARGS__), (void)std::fputc('\n', stderr))
#define RCLCPP_ERROR(logger, ...) STUB_LOG(logger, __VA_ARGS__)
#define RCLCPP_WARN(logger, ...) STUB_LOG(logger, __VA_ARGS__)
