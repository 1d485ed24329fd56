#include "identified_arm/computed_torque.hpp"

#include <algorithm>
#include <cmath>

namespace identified_arm
{

namespace
{

bool finite(const Joints & values)
{
  return std::all_of(values.begin(), values.end(), [](double x) { return std::isfinite(x); });
}

}  // namespace

ComputedTorque::ComputedTorque(const Settings & settings) : settings_(settings)
{
  width_.fill(settings.velocity_width);
  begin();
}

void ComputedTorque::begin()
{
  arm_begin(&state_);
  time_ = 0.0;
}

bool ComputedTorque::cycle(
  double period, const Reference & reference, const Joints & q, const Joints & dq, Joints & torque)
{
  if (!finite(q) || !finite(dq) || !finite(reference.q) || !finite(reference.dq) ||
    !finite(reference.ddq)) {
    return false;
  }
  const double w = settings_.bandwidth;
  arm_sample sample{};  // this example measures no temperatures
  for (std::size_t j = 0; j < q.size(); j++) {
    sample.ddq[j] = reference.ddq[j] + 2.0 * w * (reference.dq[j] - dq[j]) +
      w * w * (reference.q[j] - q[j]);
  }
  Joints rigid, effects;
  arm_rigid_torque(q.data(), dq.data(), sample.ddq, rigid.data());

  // Friction at the reference: with measured velocities it would chatter at rest.
  std::copy(reference.q.begin(), reference.q.end(), sample.q);
  std::copy(reference.dq.begin(), reference.dq.end(), sample.dq);
  sample.time = time_;
  time_ += period;
  arm_advance(&state_, &sample, width_.data());
  arm_effect_torque(&sample, rigid.data(), &state_, width_.data(), effects.data());
  for (std::size_t j = 0; j < q.size(); j++) {
    torque[j] = rigid[j] + effects[j];
    if (settings_.effort_limit > 0.0) {
      torque[j] = std::clamp(torque[j], -settings_.effort_limit, settings_.effort_limit);
    }
  }
  return true;
}

}  // namespace identified_arm
