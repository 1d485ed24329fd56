// What a controller on hardware must withstand, through the public interface of the plug-in: prints
// a line for each case, and fails at the first that is wrong. The arm is the exported one, so that
// errors of following are those of the law and of sampling alone.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <random>

#include "plant.hpp"

using plant::Bench;
using plant::n;
using plant::period;
using plant::return_type;

// ---- allocations: every one of the process passes here -------------------------------------------

static long allocations = 0;

extern "C" {
void * __libc_malloc(std::size_t);
void * __libc_calloc(std::size_t, std::size_t);
void * __libc_realloc(void *, std::size_t);
void * malloc(std::size_t size)
{
  allocations += plant::counting;
  return __libc_malloc(size);
}
void * calloc(std::size_t count, std::size_t size)
{
  allocations += plant::counting;
  return __libc_calloc(count, size);
}
void * realloc(void * old, std::size_t size)
{
  allocations += plant::counting;
  return __libc_realloc(old, size);
}
}

namespace
{

const double nan_ = std::numeric_limits<double>::quiet_NaN();
const double inf = std::numeric_limits<double>::infinity();
const double pi = std::acos(-1.0);

void require(bool condition, const char * what)
{
  if (condition) return;
  std::fprintf(stderr, "FAILED: %s\n", what);
  std::exit(1);
}

using Parameters = std::map<std::string, rclcpp::ParameterValue>;

void parameters_are_validated()
{
  std::fprintf(stderr, "expected refusals:\n");
  auto swapped = plant::names();
  std::reverse(swapped.begin(), swapped.end());
  auto other = plant::names();
  other[0] = "wheel";
  const std::vector<double> large(n, 1e4), zero(n, 0.0), few(n + 1, 1.0);
  const Parameters refused[] = {
    {{"joints", std::vector<std::string>()}}, {{"joints", other}}, {{"joints", swapped}},
    {{"joints", std::vector<std::string>(n + 1, "a")}}, {{"bandwidth", 0.0}}, {{"bandwidth", 1e6}},
    {{"bandwidth", std::string("20")}}, {{"limits.effort", large}}, {{"limits.effort", zero}},
    {{"limits.effort", few}}, {{"limits.velocity", large}}, {{"limits.fraction", 1.5}},
    {{"deactivation_torque", std::string("brake")}}, {{"reference_timeout", -1.0}},
    {{"effort_limit", 80.0}}};
  for (const auto & given : refused) {
    require(!Bench(given).configure(), given.begin()->first.c_str());
  }
  auto prefixed = plant::names();
  for (auto & name : prefixed) name = "left_" + name;
  Bench bench({{"joints", prefixed}, {"limits.fraction", 0.5}});
  require(bench.configure(), "valid parameters");
  const auto & c = bench.controller;
  require(c.command_interface_configuration().names.front() == prefixed[0] + "/effort", "commands");
  require(c.state_interface_configuration().names.back() == prefixed[n - 1] + "/velocity", "states");
  std::printf("wrong parameters and joints: %zu of %zu refused\n", std::size(refused),
    std::size(refused));
}

void follows_a_reference()
{
  Bench bench;
  for (int j = 0; j < n; j++) bench.arm.q[j] = 0.1 * (j + 1);
  require(bench.start(), "start");
  double worst = 0.0;
  for (double t = 0.0; t < 2.0; t += period) {
    double q[n], dq[n], ddq[n];  // q0 + (1 - cos(pi t)) / 5: at rest at both ends
    for (int j = 0; j < n; j++) {
      q[j] = 0.1 * (j + 1) + 0.2 * (1.0 - std::cos(pi * t));
      dq[j] = 0.2 * pi * std::sin(pi * t);
      ddq[j] = 0.2 * pi * pi * std::cos(pi * t);
    }
    bench.reference(q, dq, ddq);
    for (int j = 0; j < n; j++) worst = std::max(worst, std::abs(bench.arm.q[j] - q[j]));
    require(bench.cycle() == return_type::OK, "update");
  }
  std::printf("largest tracking error: %.2e\n", worst);
  require(worst < 5e-3, "tracking error");
}

// Efforts, speeds and overshoot of a jump; the goal may be outside of the joint's range.
void a_jump(const char * name, double goal_of_first, double seconds)
{
  Bench bench({{"reference_timeout", 0.0}});
  require(bench.start(), "start");
  double goal[n] = {}, highest = -inf;
  goal[0] = goal_of_first;
  bench.reference(goal);
  for (double t = 0.0; t < seconds; t += period) {
    require(bench.cycle() == return_type::OK, "update");
    highest = std::max(highest, bench.arm.q[0]);
  }
  const double reached = std::min(goal_of_first, arm_position_upper[0]);
  std::printf("%s: effort %.2f of the limit, speed %.2f, overshoot %.3f rad, at the goal within %.1e\n",
    name, bench.largest, bench.fastest, highest - reached, std::abs(bench.arm.q[0] - reached));
  require(bench.largest <= 1.0, "effort");
  require(bench.fastest < 1.1, "speed");
  require(highest - reached < 0.02, "overshoot");
  require(std::abs(bench.arm.q[0] - reached) < 1e-2, "goal");
}

void references_that_stop()
{
  Bench bench;
  require(bench.start(), "start");
  double q[n] = {}, dq[n] = {};
  dq[0] = 0.5;
  for (double t = 0.0; t < 1.0; t += period) {
    q[0] = 0.5 * t;
    bench.reference(q, dq);
    require(bench.cycle() == return_type::OK, "update");
  }
  const double then = bench.arm.q[0], speed = bench.arm.dq[0];
  double fastest_change = 0.0;
  for (double t = 0.0; t < 1.0; t += period) {
    const double before = bench.arm.dq[0];
    require(bench.cycle() == return_type::OK, "update");
    fastest_change = std::max(fastest_change, std::abs(bench.arm.dq[0] - before) / period);
  }
  std::printf("references stop at %.2f rad/s: rest after %.3f rad, %.1f rad/s² at most\n", speed,
    bench.arm.q[0] - then, fastest_change);
  require(std::abs(speed - 0.5) < 0.05 && std::abs(bench.arm.dq[0]) < 1e-3, "not at rest");
  require(bench.arm.q[0] - then < 0.15, "hold");
  require(fastest_change < 1.5 * arm_acceleration_limit[0], "braking");
}

double gravity_error(const Bench & bench, const double * q)
{
  double expected[n], worst = 0.0;
#ifdef ARM_RUNTIME_PAYLOAD
  arm_gravity(q, &bench.numbers, expected);
#else
  arm_gravity(q, expected);
#endif
  for (int j = 0; j < n; j++) worst = std::max(worst, std::abs(bench.effort[j] - expected[j]));
  return worst;
}

void faults()
{
  const char * names[] = {"NaN position", "NaN velocity", "infinite position", "NaN reference",
    "infinite reference"};
  for (int kind = 0; kind < 5; kind++) {
    Bench bench({{"fault.hold_time", 0.3}, {"fault.release_time", 0.2}});
    for (int j = 0; j < n; j++) bench.arm.q[j] = 0.3;
    require(bench.start(), "start");
    double goal[n], pose[n];
    std::fill(goal, goal + n, 0.3);
    for (int k = 0; k < 20; k++) {
      bench.reference(goal);
      require(bench.cycle() == return_type::OK, "update");
    }
    bench.read();
    std::copy_n(bench.q_read, n, pose);
    if (kind == 0) bench.q_read[0] = nan_;
    if (kind == 1) bench.dq_read[0] = nan_;
    if (kind == 2) bench.q_read[n - 1] = inf;
    if (kind == 3) goal[0] = nan_;
    if (kind == 4) goal[0] = inf;
    if (kind > 2) bench.reference(goal);
    require(bench.update() == return_type::ERROR, "an error at once");
    const double at_once = gravity_error(bench, pose);
    require(at_once < 0.2, "gravity at once");
    std::fill(goal, goal + n, 0.3);
    int cycles = 0;  // finite values again: the fault stays
    while (std::any_of(bench.effort, bench.effort + n, [](double x) { return x != 0.0; })) {
      bench.reference(goal);
      bench.move();
      require(bench.cycle() == return_type::ERROR, "an error until the next activation");
      require(++cycles < 1000, "release");
    }
    std::printf("%s: gravity within %.2g N·m and an error in one cycle, zero after %.2f s\n",
      names[kind], at_once, cycles * period);
    require(cycles > 400, "released too early");
    bench.read();
    require(bench.controller.on_deactivate({}) == plant::CallbackReturn::SUCCESS, "deactivate");
    std::fill(bench.arm.dq, bench.arm.dq + n, 0.0);
    require(bench.activate() && bench.cycle() == return_type::OK, "next activation");
    bench.q_read[0] = nan_;
    require(bench.controller.on_activate({}) == plant::CallbackReturn::FAILURE, "NaN at activation");
  }
}

void a_fault_in_motion()
{
  Bench bench({{"fault.keep_active", true}, {"fault.hold_time", 0.5}});
  bench.arm.dq[0] = 1.0;
  require(bench.start(), "start");
  bench.q_read[0] = nan_;
  double last = 1.0;
  for (double t = 0.0; t < 0.4; t += period) {
    require(bench.update() == return_type::OK, "keep_active");
    bench.move();
    bench.read();
    last = bench.arm.dq[0];
  }
  for (double t = 0.0; t < 1.0; t += period) {
    bench.update();
    bench.read();
  }
  std::printf("a fault at 1 rad/s: %.2f rad/s after 0.4 s\n", last);
  require(std::abs(last) < 0.2, "damping");
  require(bench.update() == return_type::ERROR, "an error after the release");
}

void takes_over_a_motion()
{
  Bench bench;
  bench.arm.dq[0] = 0.8;
  for (int j = 0; j < n; j++) bench.effort[j] = 0.2 * arm_torque_limit[j];
  double before[n], largest_step = 0.0;
  require(bench.start(), "start");
  for (double t = 0.0; t < 1.0; t += period) {
    std::copy_n(bench.effort, n, before);
    require(bench.cycle() == return_type::OK, "update");
    for (int j = 0; j < n; j++) {
      largest_step = std::max(largest_step, std::abs(bench.effort[j] - before[j]) / arm_torque_limit[j]);
    }
  }
  std::printf("activated at 0.8 rad/s: largest step of effort %.3f of the limit, rest at %.2f rad\n",
    largest_step, bench.arm.q[0]);
  require(largest_step < 0.05, "a step of effort");
  require(std::abs(bench.arm.dq[0]) < 1e-3, "not at rest");
}

void life_cycle()
{
  Bench bench({{"deactivation_torque", std::string("gravity")}});
  for (int j = 0; j < n; j++) bench.arm.q[j] = 0.3;
  require(bench.start() && bench.cycle() == return_type::OK, "start");
  bench.controller.on_deactivate({});
  require(gravity_error(bench, bench.q_read) < 1e-9, "gravity stays on the interfaces");
  require(bench.controller.on_cleanup({}) == plant::CallbackReturn::SUCCESS, "cleanup");
  require(bench.controller.get_node()->subscriptions["~/reference"].expired(), "subscriptions");
  require(bench.controller.on_configure({}) == plant::CallbackReturn::SUCCESS, "configured again");
  require(bench.activate() && bench.cycle() == return_type::OK, "active again");
  require(bench.controller.on_error({}) == plant::CallbackReturn::SUCCESS, "on_error");
  require(bench.effort[0] == 0.0, "no effort after an error");
  Bench plain;
  require(plain.start() && plain.cycle() == return_type::OK, "start");
  plain.controller.on_deactivate({});
  require(plain.effort[0] == 0.0, "no effort after the deactivation");
  std::printf("cleanup, errors, deactivation: as documented\n");
}

void chained()
{
  Bench bench({{"limits.acceleration", std::vector<double>(n, 5.0)}});
  require(bench.configure(), "configure");
  auto references = bench.controller.export_reference_interfaces();
  require(references.size() == 3 * n, "reference interfaces");
  require(references[0].get_name() == "identified_arm/" + plant::names()[0] + "/position", "name");
  require(bench.controller.set_chained_mode(true) && bench.activate(), "chained mode");
  for (int k = 0; k < 50; k++) require(bench.cycle() == return_type::OK, "nothing commanded yet");
  require(std::abs(bench.arm.q[0]) < 1e-3, "hold");
  for (int j = 0; j < n; j++) references[j].set(0.0);
  for (double t = 0.0; t < 2.0; t += period) {  // velocities stay NaN
    references[0].set(std::min(0.3, 0.3 * t));
    require(bench.cycle() == return_type::OK, "update");
  }
  std::printf("chained: at the reference within %.1e\n", std::abs(bench.arm.q[0] - 0.3));
  require(std::abs(bench.arm.q[0] - 0.3) < 5e-3, "follow");
  references[0].set(nan_);
  require(bench.cycle() == return_type::ERROR, "NaN after a command");
}

void periods()
{
  Bench bench;
  require(bench.start(), "start");
  const rclcpp::Duration given[] = {{0, 0}, {-1, 0}, {100, 0}, {0, 1}};
  for (const auto & each : given) {
    require(bench.controller.update({}, each) == return_type::OK, "period");
    require(std::abs(bench.effort[0]) <= arm_torque_limit[0], "effort");
  }
  std::printf("periods of 0, -1, 100 and 1e-9 s: efforts within the limits\n");
}

// Any bits in every input: efforts stay finite and within the limits, in every cycle.
void any_bits()
{
  std::mt19937_64 random(1);
  const auto value = [&random]() {
    double made;
    const std::uint64_t bits = random();
    if (bits % 3 == 0) return std::uniform_real_distribution<>(-3.0, 3.0)(random);
    std::memcpy(&made, &bits, sizeof made);
    return made;
  };
  long cycles = 0, failed = 0;
  for (int trial = 0; trial < 400; trial++) {
    Bench bench({{"reference_timeout", 0.01 * (trial % 5)}});
    if (!bench.start()) continue;
    for (int k = 0; k < 50; k++) {
      double q[n], dq[n], ddq[n];
      const bool wild = k > 20;
      for (int j = 0; j < n; j++) {
        bench.q_read[j] = wild ? value() : std::remainder(value(), 3.0);
        if (!std::isfinite(bench.q_read[j])) bench.q_read[j] = wild ? bench.q_read[j] : 0.0;
        bench.dq_read[j] = wild ? value() : 0.1;
        q[j] = value(), dq[j] = value(), ddq[j] = value();
        if (!wild) q[j] = dq[j] = ddq[j] = std::isfinite(q[j]) ? q[j] : 1e300;
      }
      bench.reference(q, dq, ddq);
      failed += bench.update() == return_type::ERROR;
      for (int j = 0; j < n; j++) {
        require(std::abs(bench.effort[j]) <= arm_torque_limit[j], "an effort beyond its limit");
      }
      cycles++;
    }
  }
  std::printf("any bits in all inputs: %ld cycles, %ld with an error, all efforts within the limits\n",
    cycles, failed);
}

#ifdef ARM_RUNTIME_PAYLOAD
double droop(bool told)
{
  Bench bench;
  const std::vector<double> body{1.0, 0.02, 0.0, 0.05, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01};
  if (told) {
    require(bench.configure(), "configure");
    std_msgs::msg::Float64MultiArray message;
    std::fprintf(stderr, "expected refusals:\n");
    for (const auto & wrong : {std::vector<double>(3, 1.0), std::vector<double>(10, -1.0),
           std::vector<double>{0.1, 5.0, 0, 0, 0, 0, 0, 0, 0, 0}}) {
      message.data = wrong;
      bench.controller.get_node()->publish("~/payload", message);
    }
    message.data = body;
    require(bench.activate(), "activate");
    bench.controller.get_node()->publish("~/payload", message);
  } else {
    require(bench.start(), "start");
  }
  for (double t = 0.0; t < 2.0; t += period) {  // a hand takes the weight over half a second
    for (int k = 0; k < 10; k++) bench.numbers.payload[k] = body[k] * std::min(1.0, 2.0 * t);
    require(bench.cycle() == return_type::OK, "update");
  }
  double worst = 0.0;
  for (int j = 0; j < n; j++) worst = std::max(worst, std::abs(bench.arm.q[j]));
  return worst;
}
#endif

}  // namespace

// The count of allocations counts those of the library, too.
void allocations_are_counted()
{
  Bench bench;
  require(bench.start(), "start");
  const double q[n] = {};
  plant::counting = 1;
  bench.reference(q);
  plant::counting = 0;
  require(allocations > 0, "no allocation was counted");
  allocations = 0;
}

int main()
{
  allocations_are_counted();
  parameters_are_validated();
  follows_a_reference();
  a_jump("a reference jump of 1 rad", 1.0, 3.0);
  a_jump("a reference 100 rad beyond the range", arm_position_upper[0] + 100.0, 6.0);
  references_that_stop();
  faults();
  a_fault_in_motion();
  takes_over_a_motion();
  life_cycle();
  chained();
  periods();
  any_bits();
#ifdef ARM_RUNTIME_PAYLOAD
  const double without = droop(false), with = droop(true);
  std::printf("1 kg at the tool: %.2e rad without the payload, %.2e rad with it\n", without, with);
  require(with < 0.1 * without, "payload");
#endif
  std::printf("allocations in update(): %ld\n", allocations);
  require(allocations == 0, "update() allocates");
  return 0;
}
