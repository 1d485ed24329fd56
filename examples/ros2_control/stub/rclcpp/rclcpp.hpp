// Stub, see controller_interface/controller_interface.hpp.
#pragma once

#include <cstdint>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
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

class Parameter
{
public:
  template <class Value> explicit Parameter(Value value) : value_(value) {}
  double as_double() const { return std::get<double>(value_); }
  std::vector<std::string> as_string_array() const
  {
    return std::get<std::vector<std::string>>(value_);
  }

private:
  std::variant<double, std::vector<std::string>> value_;
};

template <class Message> struct Subscription
{
  using SharedPtr = std::shared_ptr<Subscription>;
  std::string topic;
  std::function<void(const Message &)> callback;
};

}  // namespace rclcpp

#define RCLCPP_ERROR(logger, ...) \
  ((void)(logger), std::fprintf(stderr, __VA_ARGS__), (void)std::fputc('\n', stderr))
