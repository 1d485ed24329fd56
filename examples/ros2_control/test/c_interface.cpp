// The plug-in with a C interface, for a simulation in another language: one controller a process.
#include "plant.hpp"

static plant::Bench * bench = nullptr;

extern "C" {

int controller_start(const double * q, const double * dq, double timeout)
{
  delete bench;
  bench = new plant::Bench({{"reference_timeout", timeout}});
  std::copy_n(q, ARM_JOINTS, bench->arm.q);
  std::copy_n(dq, ARM_JOINTS, bench->arm.dq);
  return bench->start() ? 0 : 1;
}

void controller_reference(const double * q, const double * dq, const double * ddq)
{
  bench->reference(q, dq, ddq);
}

int controller_update(const double * q, const double * dq, double * effort)
{
  std::copy_n(q, ARM_JOINTS, bench->q_read);
  std::copy_n(dq, ARM_JOINTS, bench->dq_read);
  const auto result = bench->update();
  std::copy_n(bench->effort, ARM_JOINTS, effort);
  return result == controller_interface::return_type::OK ? 0 : 1;
}

}
