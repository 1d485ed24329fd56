// Control law of an arm with an identified model: a reference within limits, computed torque, and a
// safe torque after a fault. No ROS, no allocation, no lock: it may run in any control loop.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <type_traits>

#include "arm.h"

// The argument of functions whose numbers may change at run time (lieid export --payload).
#if defined(ARM_RUNTIME_PAYLOAD)
#define IDENTIFIED_ARM_NUMBERS &numbers_,
#define IDENTIFIED_ARM_LAST_NUMBERS , &numbers_
#else
#define IDENTIFIED_ARM_NUMBERS
#define IDENTIFIED_ARM_LAST_NUMBERS
#endif

namespace identified_arm
{

using Joints = std::array<double, ARM_JOINTS>;
using Body = std::array<double, 10>;  // m, m·c (3), Ixx, Ixy, Iyy, Ixz, Iyz, Izz in the tool frame

static_assert(
  std::is_same_v<std::remove_cv_t<std::remove_reference_t<decltype(arm_torque_limit[0])>>, double>,
  "the arm was exported with float; export it without --float32");

template <class Values> bool finite(const Values & values)
{
  return std::all_of(values.begin(), values.end(), [](double x) { return std::isfinite(x); });
}

struct Reference
{
  Joints q{}, dq{}, ddq{};  // rad, rad/s, rad/s² (m for prismatic joints)
};

inline bool finite(const Reference & r) { return finite(r.q) && finite(r.dq) && finite(r.ddq); }

struct Limits
{
  Joints lower, upper, velocity, acceleration, effort;
};

// The limits of the robot's description; infinite where it states none.
inline Limits robot_limits()
{
  Limits made;
  std::copy_n(arm_position_lower, ARM_JOINTS, made.lower.begin());
  std::copy_n(arm_position_upper, ARM_JOINTS, made.upper.begin());
  std::copy_n(arm_velocity_limit, ARM_JOINTS, made.velocity.begin());
  std::copy_n(arm_acceleration_limit, ARM_JOINTS, made.acceleration.begin());
  std::copy_n(arm_torque_limit, ARM_JOINTS, made.effort.begin());
  return made;
}

struct Settings
{
  Limits limits = robot_limits();
  double bandwidth = 20.0;  // rad/s, of the closed loop
  double velocity_width = 0.01;  // rad/s, within which friction changes its sign smoothly
  double reference_timeout = 0.1;  // s without a new reference, after which the arm stops; 0: never
  double following_error = 0.5;  // rad, largest distance of the limited reference from the arm
  double takeover_time = 0.1;  // s, from the torque before the activation to that of the law
  double payload_time = 0.5;  // s, from one payload to the next
  double fault_rate = 10.0;  // 1/s, at which the safe torque damps motion
  double fault_hold_time = 1.0;  // s with gravity and damping after a fault
  double fault_release_time = 0.5;  // s, in which that torque falls to zero afterwards
};

// A motion that follows a reference as closely as limits permit: exactly where it is within them.
class LimitedMotion
{
public:
  void begin(const Joints & q, const Joints & dq) { now_ = {q, dq, {}}; }

  const Reference & now() const { return now_; }

  // Advance by a period (s) towards a reference; without one, brake to rest.
  void advance(double period, const Reference * reference, const Limits & limits)
  {
    for (std::size_t j = 0; j < ARM_JOINTS; j++) {
      const double most = limits.acceleration[j];
      double & q = now_.q[j], & dq = now_.dq[j];
      double a = -dq * std::min(RATE, 1.0 / period);
      if (reference != nullptr) {
        const double feed = reference->ddq[j];
        const double goal = std::clamp(reference->q[j], limits.lower[j], limits.upper[j]);
        const double error = goal - (q + dq * period + 0.5 * feed * period * period);
        const double fastest = limits.velocity[j];
        const double wanted = std::clamp(
          reference->dq[j] + approach(error, most), -fastest, fastest);
        a = feed + std::min(DAMPING, 0.5 / period) * (wanted - (dq + feed * period));
        a = std::clamp(a, (-fastest - dq) / period, (fastest - dq) / period);
      }
      // in front of a limit no faster than braking permits; beyond it only back
      const double next = q + dq * period;
      a = std::min(a, (approach(limits.upper[j] - next, most) - dq) / period);
      a = std::max(a, (approach(limits.lower[j] - next, most) - dq) / period);
      a = std::clamp(a, -most, most);
      const double change = most * period / RISE;
      a = std::clamp(a, now_.ddq[j] - change, now_.ddq[j] + change);
      const bool inside = q >= limits.lower[j] && q <= limits.upper[j];
      q += dq * period + 0.5 * a * period * period;
      dq += a * period;
      now_.ddq[j] = a;
      if (inside && (q < limits.lower[j] || q > limits.upper[j])) {  // by rounding
        q = std::clamp(q, limits.lower[j], limits.upper[j]);
        dq = now_.ddq[j] = 0.0;
      }
    }
  }

  // Keep within a distance (rad) of the arm, which cannot follow where its torque is limited.
  void keep_near(const Joints & q, const Joints & dq, double distance)
  {
    for (std::size_t j = 0; j < ARM_JOINTS; j++) {
      const double near = std::clamp(now_.q[j], q[j] - distance, q[j] + distance);
      if (near != now_.q[j]) now_.q[j] = near, now_.dq[j] = dq[j];
    }
  }

private:
  static constexpr double RATE = 20.0, DAMPING = 4.0 * RATE;  // 1/s: critically damped
  static constexpr double BRAKING = 0.7;  // part of the acceleration that braking is planned with
  static constexpr double RISE = 0.02;  // s, from no acceleration to the largest: no steps of effort

  // The velocity that closes a distance: in proportion to a small one, else such that braking ends
  // there.
  static double approach(double error, double acceleration)
  {
    const double a = BRAKING * acceleration, size = std::abs(error);
    const double near = a / (RATE * RATE);
    if (!(size > near)) return RATE * error;
    return std::copysign(std::sqrt(2.0 * a * (size - 0.5 * near)), error);
  }

  Reference now_;
};

enum class Mode { following, holding, fault };
enum class Fault { none, state, reference, torque };

class ControlLaw
{
public:
  explicit ControlLaw(const Settings & settings = Settings()) : settings_(settings)
  {
    width_.fill(settings.velocity_width);
#if defined(ARM_RUNTIME_PAYLOAD)
    arm_nominal(&numbers_);
#endif
  }

  // Begin at the measured motion, with the torque that the drives had before (NaN or 0: unknown).
  // False, and nothing begun, if a measured value is not finite.
  bool begin(const Joints & q, const Joints & dq, const Joints & before)
  {
    if (!finite(q) || !finite(dq)) return false;
    motion_.begin(q, dq);
    arm_begin(&state_);
    before_ = before;
    last_q_ = q;
    time_ = fault_time_ = age_ = 0.0;
    has_reference_ = false;
    fault_ = Fault::none;
    mode_ = Mode::holding;
    return true;
  }

  // A body at the tool from now on, in place of the one before; false if it is no rigid body, or
  // the arm was exported without --payload.
  bool set_payload(const Body & body)
  {
#if defined(ARM_RUNTIME_PAYLOAD)
    if (!is_rigid_body(body)) return false;
    std::copy(body.begin(), body.end(), goal_.begin());
    std::copy_n(numbers_.payload, 10, start_.begin());
    blended_ = 0.0;
    return true;
#else
    (void)body;
    return false;
#endif
  }

  // Write the torque of one cycle, within the limits of effort whatever is given.
  //
  // tau = M(q) a + C(q, dq) dq + G(q) + effects at the limited reference r, with
  // a = ddq_r + 2 w (dq_r - dq) + w² (q_r - q).
  // `reference` is a new one, or null. A fault lasts until the next `begin`: then gravity and
  // damping for a time, then zero.
  Mode cycle(
    double period, const Reference * reference, const Joints & q, const Joints & dq,
    Joints & torque)
  {
    const double dt = std::isfinite(period) ? std::clamp(period, 0.0, LONGEST) : 0.0;
    time_ += dt;
    blend_payload(dt);
    if (!finite(q) || !finite(dq)) fail(Fault::state);
    if (reference != nullptr && !finite(*reference)) fail(Fault::reference);
    if (fault_ == Fault::none) {
      last_q_ = q;
      follow(dt, reference, q, dq);
      if (computed_torque(q, dq, torque)) {
        limit(torque);
        return mode_;
      }
      fail(Fault::torque);
    }
    mode_ = Mode::fault;
    safe_torque(dt, q, dq, torque);
    return mode_;
  }

  // Torque at rest at the last measured pose, within the limits; 0 where there is none.
  Joints gravity() const
  {
    Joints torque{};
    arm_gravity(last_q_.data(), IDENTIFIED_ARM_NUMBERS torque.data());
    if (!finite(torque)) torque.fill(0.0);
    limit(torque);
    return torque;
  }

  Mode mode() const { return mode_; }
  Fault fault() const { return fault_; }
  // Whether the safe torque of a fault has fallen to zero.
  bool released() const { return fault_ != Fault::none && share_ == 0.0; }
  const Reference & limited_reference() const { return motion_.now(); }

private:
  static constexpr double LONGEST = 0.05;  // s, of a cycle: a longer one counts as this

  void fail(Fault fault)
  {
    if (fault_ == Fault::none) fault_ = fault, fault_time_ = 0.0;
  }

  void follow(double dt, const Reference * reference, const Joints & q, const Joints & dq)
  {
    age_ = reference != nullptr ? 0.0 : age_ + dt;
    if (reference != nullptr) received_ = *reference, has_reference_ = true;
    if (settings_.reference_timeout > 0.0 && age_ > settings_.reference_timeout) {
      has_reference_ = false;
    }
    mode_ = has_reference_ ? Mode::following : Mode::holding;
    motion_.keep_near(q, dq, settings_.following_error);
    if (dt > 0.0) motion_.advance(dt, has_reference_ ? &received_ : nullptr, settings_.limits);
  }

  bool computed_torque(const Joints & q, const Joints & dq, Joints & torque)
  {
    const Reference & r = motion_.now();
    const double w = settings_.bandwidth;
    arm_sample sample{};  // no temperatures are measured
    for (std::size_t j = 0; j < ARM_JOINTS; j++) {
      sample.ddq[j] = r.ddq[j] + 2.0 * w * (r.dq[j] - dq[j]) + w * w * (r.q[j] - q[j]);
    }
    Joints rigid, effects;
    arm_rigid_torque(
      q.data(), dq.data(), sample.ddq, IDENTIFIED_ARM_NUMBERS rigid.data());
    // friction at the reference: with measured velocities it would chatter at rest
    std::copy(r.q.begin(), r.q.end(), sample.q);
    std::copy(r.dq.begin(), r.dq.end(), sample.dq);
    sample.time = time_;
    arm_advance(&state_, &sample, width_.data() IDENTIFIED_ARM_LAST_NUMBERS);
    arm_effect_torque(
      &sample, rigid.data(), &state_, width_.data(), IDENTIFIED_ARM_NUMBERS effects.data());
    const double share =
      settings_.takeover_time > 0.0 ? std::min(1.0, time_ / settings_.takeover_time) : 1.0;
    for (std::size_t j = 0; j < ARM_JOINTS; j++) {
      torque[j] = rigid[j] + effects[j];
      if (share < 1.0 && std::isfinite(before_[j]) && before_[j] != 0.0) {
        torque[j] = share * torque[j] + (1.0 - share) * before_[j];
      }
    }
    return finite(torque);
  }

  // Gravity and damping -rate M dq at the last pose that was measured, then a fall to zero.
  void safe_torque(double dt, const Joints & q, const Joints & dq, Joints & torque)
  {
    const double over = fault_time_ - settings_.fault_hold_time;
    fault_time_ += dt;
    share_ = 1.0;
    if (over >= 0.0) {
      const double time = settings_.fault_release_time;
      share_ = time > 0.0 ? std::max(0.0, 1.0 - over / time) : 0.0;
    }
    if (finite(q)) last_q_ = q;
    Joints rest{}, braking{}, moving, still;
    if (finite(dq)) {
      for (std::size_t j = 0; j < ARM_JOINTS; j++) braking[j] = -settings_.fault_rate * dq[j];
    }
    const double * pose = last_q_.data();
    arm_gravity(pose, IDENTIFIED_ARM_NUMBERS torque.data());
    arm_rigid_torque(pose, rest.data(), braking.data(), IDENTIFIED_ARM_NUMBERS moving.data());
    arm_rigid_torque(pose, rest.data(), rest.data(), IDENTIFIED_ARM_NUMBERS still.data());
    for (std::size_t j = 0; j < ARM_JOINTS; j++) {
      torque[j] = share_ * (torque[j] + moving[j] - still[j]);
    }
    if (!finite(torque)) torque.fill(0.0);
    limit(torque);
  }

  void limit(Joints & torque) const
  {
    for (std::size_t j = 0; j < ARM_JOINTS; j++) {
      torque[j] = std::clamp(torque[j], -settings_.limits.effort[j], settings_.limits.effort[j]);
    }
  }

  void blend_payload(double dt)
  {
#if defined(ARM_RUNTIME_PAYLOAD)
    if (blended_ >= 1.0) return;
    blended_ = settings_.payload_time > 0.0 ? std::min(1.0, blended_ + dt / settings_.payload_time)
                                            : 1.0;
    for (std::size_t k = 0; k < start_.size(); k++) {
      numbers_.payload[k] = start_[k] + blended_ * (goal_[k] - start_[k]);
    }
#else
    (void)dt;
#endif
  }

  // Whether link parameters are those of some distribution of mass: the matrix
  // [[½ tr(I)·1 - I, m·c], [(m·c)ᵀ, m]] is positive semidefinite (by its Cholesky decomposition).
  static bool is_rigid_body(const Body & b)
  {
    if (!finite(b)) return false;
    const double half = 0.5 * (b[4] + b[6] + b[9]);
    double a[4][4] = {
      {half - b[4], -b[5], -b[7], b[1]},
      {-b[5], half - b[6], -b[8], b[2]},
      {-b[7], -b[8], half - b[9], b[3]},
      {b[1], b[2], b[3], b[0]}};
    const double size = std::abs(half) + std::abs(b[0]);
    // from the mass on, so that a point mass (inertia of its offset alone) passes
    for (int k = 3; k >= 0; k--) {
      if (a[k][k] < -1e-9 * size) return false;
      if (a[k][k] <= 1e-9 * size) {
        for (int i = 0; i < k; i++) {
          if (std::abs(a[i][k]) > 1e-6 * size) return false;
        }
        continue;
      }
      for (int i = 0; i < k; i++) {
        for (int j = 0; j < k; j++) a[i][j] -= a[i][k] * a[k][j] / a[k][k];
      }
    }
    return true;
  }

  Settings settings_;
  Joints width_{}, before_{}, last_q_{};
  LimitedMotion motion_;
  Reference received_;
  arm_state state_{};
  double time_ = 0.0, age_ = 0.0, fault_time_ = 0.0, share_ = 1.0;
  bool has_reference_ = false;
  Mode mode_ = Mode::holding;
  Fault fault_ = Fault::none;
#if defined(ARM_RUNTIME_PAYLOAD)
  arm_numbers numbers_{};
#endif
#if defined(ARM_RUNTIME_PAYLOAD)
  Body start_{}, goal_{};
  double blended_ = 1.0;
#endif
};

}  // namespace identified_arm

#undef IDENTIFIED_ARM_NUMBERS
#undef IDENTIFIED_ARM_LAST_NUMBERS
